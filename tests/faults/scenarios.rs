//! Tests of single faults, `scenarios/faults/*.toml`: motions of the plant, reports to the operator
//! and exit codes.
//!
//! A probe, which no part of the controller knows, records the plant after each period. Reports and
//! exit codes come from the program itself. A hundred seeds of each scenario:
//! `FAULT_SEEDS=100 cargo test --release --test faults scenarios::`.

use crate::missions::beside;
use crate::program::program;
use crate::seeds::{Seed, each_seed, profile};
use nalgebra::Vector3;
use rubik_robot::hw::plant::{Incident, Verdict, Whereabouts};
use rubik_robot::record::summary::{Outcome, Summary};
use rubik_robot::run::{self, RunContext, RunOptions};
use rubik_robot::scenario::Override;
use rubik_robot::spatial::Pose;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// State of the plant after one period.
#[derive(Debug, Clone)]
struct Moment {
    period: u64,
    /// Poses of both tools in the world.
    tools: [Pose; 2],
    /// Whether the drives of each arm are on.
    powered: [bool; 2],
    /// Openings of both jaws (m).
    openings: [f64; 2],
    /// Angle of the turning layer (rad).
    turned: f64,
    /// Centre of the cube in the world (m).
    cube: Vector3<f64>,
    /// Largest force between the hands until this period (N).
    peak: f64,
}

/// Run with a fault, as the plant saw it.
struct Seen {
    summary: Summary,
    moments: Vec<Moment>,
    /// The plant's account at the end.
    verdict: Verdict,
}

/// Returns the path of the fault scenario `name`.
fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/faults").join(format!("{name}.toml"))
}

impl Seed {
    /// Runs the fault scenario `name` with this seed and the overrides `keys`.
    fn seen(self, name: &str, keys: &[&str]) -> Seen {
        let seed = format!("seed={}", self.0);
        let profile = profile();
        let keys = profile.as_deref().into_iter().chain(keys.iter().copied());
        let keys = keys.chain([seed.as_str()]);
        seen(name, &keys.map(|key| Override::parse(key).unwrap()).collect::<Vec<_>>())
    }

    /// Runs a turn without a fault. Returns the period in which the layer passes 30 deg, at which
    /// most faults of a turn begin.
    fn turned_30(self) -> u64 {
        self.turned_30_by(&[])
    }

    /// Returns the period of [`Seed::turned_30`] under the overrides `keys`.
    fn turned_30_by(self, keys: &[&str]) -> u64 {
        let keys: Vec<&str> = ["fault.0.magnitude=0"].iter().chain(keys).copied().collect();
        let seen = self.seen("jam", &keys);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        let passes = |m: &&Moment| m.turned.to_degrees().abs() >= 30.0;
        seen.moments.iter().find(passes).unwrap().period
    }
}

/// Runs the fault scenario `name` with the overrides `keys`, and records the plant after each
/// period.
fn seen(name: &str, keys: &[Override]) -> Seen {
    let scenario = rubik_robot::tasks::load(&path(name), keys).unwrap_or_else(|e| panic!("{e}"));
    let notes = Arc::new(Mutex::new((Vec::new(), None)));
    let keeps = Arc::clone(&notes);
    let probe: run::PlantProbe = Box::new(move |period, plant| {
        let scene = plant.scene();
        let mut notes = keeps.lock().unwrap();
        notes.0.push(Moment {
            period,
            tools: [0, 1].map(|i: usize| scene.arms[i].world_from_tool),
            powered: [0, 1].map(|i| plant.is_powered(i)),
            openings: [0, 1].map(|i: usize| scene.arms[i].opening),
            turned: plant.verdict().turned,
            cube: scene.cube.world_from_cube.translation.vector,
            peak: plant.verdict().peak_force,
        });
        if period % 10 == 0 {
            notes.1 = Some(plant.verdict());
        }
    });
    let around = RunContext { probe: Some(probe), ..RunContext::default() };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let summary = run::run_with(&scenario, options, around).unwrap();
    println!("{name}: {}", summary.reason);
    let mut notes = notes.lock().unwrap();
    let (moments, verdict) = (std::mem::take(&mut notes.0), notes.1.take().unwrap());
    Seen { summary, moments, verdict }
}

impl Seen {
    /// Returns the plant after this period.
    fn at(&self, period: u64) -> &Moment {
        let first = self.moments[0].period;
        &self.moments[(period - first) as usize]
    }

    /// Returns the first period in which the drives of an arm are off after they have been on.
    fn first_unpowered(&self, arm: usize) -> Option<u64> {
        let on = self.moments.iter().position(|m| m.powered[arm]).unwrap();
        self.moments[on..].iter().find(|m| !m.powered[arm]).map(|m| m.period)
    }

    /// Returns the length of the path of an arm's tool between the periods `from` and `to` (m).
    fn path_length(&self, arm: usize, from: u64, to: u64) -> f64 {
        (from..to)
            .map(|p| {
                let at = |p: u64| self.at(p).tools[arm].translation.vector;
                (at(p + 1) - at(p)).norm()
            })
            .sum()
    }

    /// Returns the largest distance of an arm's tool from its position in the period `from`, until
    /// the period `to` (m).
    fn largest_distance(&self, arm: usize, from: u64, to: u64) -> f64 {
        let place = |p: u64| self.at(p).tools[arm].translation.vector;
        (from..to).map(|p| (place(p) - place(from)).norm()).fold(0.0, f64::max)
    }

    /// Returns the last period of the run.
    fn last(&self) -> u64 {
        self.moments.last().unwrap().period
    }

    /// Checks a fatal stop of one arm: its drives switch off in one of the periods of `trip`, and
    /// it hardly moves after that. The other arm keeps its power and is at rest at the end.
    fn check_fatal_stop(&self, arm: usize, trip: std::ops::RangeInclusive<u64>) {
        let cut = self.first_unpowered(arm).unwrap();
        assert!(trip.contains(&cut), "the drives switch off in period {cut}, not in {trip:?}");
        // The brakes need a distance that grows with the speed, and the drive trains vibrate in
        // place.
        let (away, speed) = (
            self.largest_distance(arm, cut, self.last()),
            self.path_length(arm, cut - 1, cut) / 2e-3,
        );
        let most = 0.5e-3 + 0.05 * speed;
        assert!(away < most, "arm {arm} moves {away} m from {speed} m/s after its power is off");
        let other = 1 - arm;
        assert_eq!(self.first_unpowered(other), None, "the other arm holds under power");
        assert!(self.last() - cut > 250, "the arm has time to stop");
        let stand = self.path_length(other, self.last() - 25, self.last());
        assert!(stand < 1e-4, "the other arm still moves: {stand}");
        assert_eq!(self.verdict.counts.drops, 0);
        assert!(self.summary.peak_force_n.unwrap() < 20.0, "{:?}", self.summary.peak_force_n);
    }

    /// Checks that at the end exactly those of the two arms hold the cube whose entry is `true`.
    fn check_held_by(&self, [track, postument]: [bool; 2]) {
        let arms = [track, postument, false, false];
        assert_eq!(self.verdict.cube, Whereabouts::Arms(arms));
    }
}

#[test]
fn frozen_encoder_stops_arm_and_partner_holds() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("encoder_freeze", &[]);
        // The bound of docs/faults.md is ten periods from the reading, which is a period old.
        seen.check_fatal_stop(0, begin..=begin + 10);
        seen.check_held_by([true, true]);
    });
}

#[test]
fn jumping_encoder_stops_its_arm_at_once() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("encoder_jump", &[]);
        seen.check_fatal_stop(0, begin..=begin + 2);
        seen.check_held_by([true, true]);
    });
}

#[test]
fn over_current_and_limit_switch_stop_one_arm() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen_current = seed.seen("over_current", &[]);
        seen_current.check_fatal_stop(1, begin..=begin + 2);
        seen_current.check_held_by([true, true]);

        let seen = seed.seen("limit_switch", &[]);
        // The switch closes at 1.9 s.
        seen.check_fatal_stop(0, 950..=952);
        seen.check_held_by([false, true]);
    });
}

#[test]
fn invalid_force_reading_moves_no_arm() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        for name in ["force_dropout", "force_nan", "force_saturation"] {
            let seen = seed.seen(name, &[]);
            // The reading after the one at 30 deg is bad; its arm is off in the next period.
            seen.check_fatal_stop(0, begin..=begin + 2);
            seen.check_held_by([true, true]);
            // After the bad reading the tool moves less than in two periods of the turn.
            assert!(
                seen.path_length(0, begin, begin + 4) < 2e-4,
                "{name}: {}",
                seen.path_length(0, begin, begin + 4)
            );
        }
    });
}

/// On the path to the operator's hand only the force shows a contact.
#[test]
fn arm_with_silent_force_sensor_stops() {
    each_seed(|seed| {
        let seen = seed.seen("force_silent", &[]);
        // The fault begins at 4.2 s.
        seen.check_fatal_stop(0, 2100..=2102);
        assert!(seen.path_length(0, 1900, 2100) > 2e-3, "the arm was moving");
    });
}

#[test]
fn force_bias_aborts_turn_before_arm_moves() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("force_bias", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
        assert!(
            seen.path_length(1, begin, seen.last()) < 2e-3,
            "{}",
            seen.path_length(1, begin, seen.last())
        );
        assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        seen.check_held_by([true, true]);
    });
}

#[test]
fn pads_without_friction_slip_in_the_plant() {
    each_seed(|seed| {
        let seen = seed.seen("slip", &[]);
        assert!(seen.verdict.counts.slips > 0);
        assert!(seen.summary.turned_deg.unwrap() < 80.0, "{:?}", seen.summary.turned_deg);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
    });
}

#[test]
fn lost_cube_falls_onto_the_tray() {
    each_seed(|seed| {
        let seen = seed.seen("drop", &[]);
        assert_eq!(seen.verdict.counts.drops, 1);
        assert!(matches!(seen.verdict.cube, Whereabouts::Tray { .. }), "{:?}", seen.verdict.cube);
        let events = &seen.verdict.events;
        let dropped = events.iter().find(|e| matches!(e.what, Incident::Drop { .. })).unwrap();
        // The hand drops the cube at 2 s.
        assert!((1000..1005).contains(&dropped.period), "{dropped:?}");
        assert_ne!(seen.summary.outcome, Outcome::Solved);
    });
}

#[test]
fn jam_stops_the_layer_within_force_limits() {
    each_seed(|seed| {
        let seen = seed.seen("jam", &[]);
        let turned = seen.summary.turned_deg.unwrap();
        assert!((29.0..33.0).contains(&turned), "{turned}");
        // The turn aborts and eases back long before the layer has been still for 3 s.
        assert!(seen.summary.reason.contains("stalled"), "{}", seen.summary.reason);
        assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
    });
}

/// The layer slips back under the closed jaws after its turn, so no sensor of the controller can
/// measure that.
#[test]
fn layer_slipping_back_leaves_cube_and_forces_unchanged() {
    each_seed(|seed| {
        let fine = seed.seen("turn_undone", &["fault.0.turned_deg=179"]);
        assert_eq!((fine.summary.outcome, fine.summary.untrue), (Outcome::Solved, false));
        let seen = seed.seen("turn_undone", &[]);
        // The controller reports a turn that the plant does not have.
        assert_eq!((seen.summary.outcome, seen.summary.untrue), (Outcome::Failed, true));
        assert_eq!(seen.summary.cube_end, seen.summary.cube_start);
        assert!(seen.summary.turned_deg.unwrap().abs() < 5.0);
        assert_eq!((seen.verdict.counts.slips, seen.verdict.counts.drops), (0, 0));
        let (with, without) =
            (seen.summary.peak_force_n.unwrap(), fine.summary.peak_force_n.unwrap());
        assert!((with - without).abs() < 1.0, "{with} {without}");
        assert!(seen.moments.iter().all(|m| m.openings.iter().all(|o| *o > 0.05)));
    });
}

/// A single missed period stops no arm.
#[test]
fn missed_periods_and_clock_jump_stop_both_arms() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let one = seed.seen("missed_period", &[]);
        assert_eq!(one.summary.outcome, Outcome::Solved, "{}", one.summary.reason);

        for name in ["missed_periods", "clock_jump"] {
            let seen = seed.seen(name, &[]);
            // The arms decelerate under power for 0.1 s; the drives switch off after 0.2 s.
            for arm in [0, 1] {
                let cut = seen.first_unpowered(arm).unwrap();
                assert!((begin + 90..begin + 130).contains(&cut), "{name}: arm {arm} at {cut}");
                assert!(seen.path_length(arm, cut, seen.last()) < 1e-3);
            }
            assert!(seen.summary.peak_force_n.unwrap() < 20.0);
            seen.check_held_by([true, true]);
        }
    });
}

#[test]
fn emergency_stop_switches_off_both_arms() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("emergency_stop", &[]);
        for arm in [0, 1] {
            assert!(
                (begin..=begin + 2).contains(&seen.first_unpowered(arm).unwrap()),
                "{:?}",
                seen.first_unpowered(arm)
            );
            assert!(seen.path_length(arm, begin + 5, seen.last()) < 1e-3);
        }
        seen.check_held_by([true, true]);
    });
}

/// Checks that the run ends at most 0.1 s and a period after the fault began.
fn check_detection_time(seen: &Seen, begin: u64) {
    let period = (seen.summary.sim_time_s / 0.002).round() as u64;
    assert!(
        (begin..=begin + 51).contains(&period),
        "detected in period {period}, begun in {begin}"
    );
}

/// Checks that both arms keep their power and are at rest `within` periods after the fault began.
fn check_both_hold(seen: &Seen, begin: u64, within: u64) {
    for arm in [0, 1] {
        assert_eq!(seen.first_unpowered(arm), None);
        let still = seen.largest_distance(arm, begin + within, begin + within + 60);
        assert!(still < 5e-4, "arm {arm} still moves {within} periods later: {still}");
    }
    assert_eq!(seen.verdict.counts.drops, 0);
    assert!(seen.summary.peak_force_n.unwrap() < 20.0);
}

#[test]
fn arms_hold_when_actor_fails_or_heartbeat_stops() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        // The watchdog detects a hanging actor after 0.1 s, a panic at once. Regulators and layer
        // need 0.25 s to come to rest.
        let mid_turn = [
            ("heart_beat_loss", 190),
            ("panic_edp", 140),
            ("actor_hang", 210),
            ("hang_ecp", 210),
            ("hang_mp", 210),
            ("lost_message", 210),
        ];
        for (name, within) in mid_turn {
            let seen = seed.seen(name, &[]);
            check_detection_time(&seen, begin);
            check_both_hold(&seen, begin, within);
            seen.check_held_by([true, true]);
        }
        // The link delays orders, so the turn is later than on one node.
        let node = "node=[{name=\"b\",actors=[\"edp postument\",\"vsp mpc\",\"vsp gs1\",\
                    \"vsp gs2\"]}]";
        let over_link = seed.turned_30_by(&[node]);
        let seen = seed.seen("node_dies", &[]);
        // No beat for 0.12 s, and the last one was up to 0.02 s before the death.
        let found = (seen.summary.sim_time_s / 0.002).round() as u64;
        assert!((over_link + 40..=over_link + 62).contains(&found), "{found} {over_link}");
        check_both_hold(&seen, over_link, 250);
        seen.check_held_by([true, true]);
        let seen = seed.seen("hang_mp", &["coordination=continuous"]);
        check_detection_time(&seen, seed.turned_30_by(&["coordination=continuous"]));
        for name in ["hang_vsp", "panic_vsp"] {
            // The fault begins at 4 s, while the arm follows the cube.
            let seen = seed.seen(name, &[]);
            check_detection_time(&seen, 2000);
            check_both_hold(&seen, 2000, 190);
        }
        for name in ["panic_ecp", "panic_mp"] {
            // The fault begins at 2 s, while the track approaches the cube.
            let seen = seed.seen(name, &[]);
            check_detection_time(&seen, 1000);
            // The arm has to decelerate from the full speed of an approach.
            check_both_hold(&seen, 1000, 220);
            seen.check_held_by([false, true]);
        }
    });
}

#[test]
fn late_and_duplicate_messages_change_no_result() {
    each_seed(|seed| {
        for name in ["late_message", "duplicated_message"] {
            let seen = seed.seen(name, &[]);
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
            assert!((seen.summary.turned_deg.unwrap() - 90.0).abs() < 2.0);
        }
        // The arm waits for a late command: it is slower where it would otherwise have continued.
        let (late, never) =
            (seed.seen("late_message", &[]), seed.seen("late_message", &["fault.0.at_s=1000"]));
        assert_ne!(late.summary.hash, never.summary.hash);
        let (slow, fast) = (late.path_length(0, 1015, 1030), never.path_length(0, 1015, 1030));
        assert!(slow < 0.85 * fast, "{slow} m instead of {fast}");
        // The servo executes a duplicate command once, so the run has the hash of one without it.
        let never = seed.seen("duplicated_message", &["fault.0.turned_deg=180"]);
        assert_eq!(seed.seen("duplicated_message", &[]).summary.hash, never.summary.hash);
    });
}

#[test]
fn push_aborts_turn_within_100_ms() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("push", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
        // The layer does not turn any more 0.1 s after the push, or at the end of the run if that
        // comes before.
        let turned = |period: u64| seen.at(period).turned.to_degrees().abs();
        let later = turned(seen.last()) - turned((begin + 50).min(seen.last()));
        assert!(later.abs() < 1.5, "{later} deg");
        assert!(turned(seen.last()) < 35.0, "{}", turned(seen.last()));
        assert_eq!(seen.verdict.counts.drops, 0);
        // The hand yields to the push, and the force between the hands does not rise after 0.04 s.
        let x = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let yields = x(seen.last()) - x(begin);
        assert!(yields > 2e-4, "the arm yields by {yields} m");
        let (soon, end) = (seen.at((begin + 20).min(seen.last())).peak, seen.at(seen.last()).peak);
        assert!(end - soon < 0.5, "{soon} N, then {end} N");
        let never = seed.seen("push", &["fault.0.magnitude=0"]);
        assert!((never.at(seen.last()).tools[0].translation.vector.x - x(begin)).abs() < 5e-5);
    });
}

/// Compliant arms take up errors of a few millimetres. Fingers of a wrong length reach a wrong
/// layer, and the plant shows the consequence.
#[test]
fn compliance_tolerates_wrong_calibrations() {
    each_seed(|seed| {
        for name in ["jaw_calibration", "base_calibration", "under_constrained"] {
            let seen = seed.seen(name, &[]);
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
            assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        }
        // Each wrong calibration shows in the plant.
        let pair = |name: &str, fine: &str| {
            (seed.seen(name, &[]), seed.seen(fine, &["fault.0.magnitude=0"]))
        };
        let (wide, fine) = pair("jaw_calibration", "jaw_calibration");
        // At 2 s the jaws are still open.
        let by = wide.at(1000).openings[0] - fine.at(1000).openings[0];
        assert!((by - 1e-3).abs() < 3e-4, "the open jaws are {by} m wider");
        let (aside, fine) = pair("base_calibration", "base_calibration");
        let at = |seen: &Seen| seen.moments[0].tools[1].translation.vector;
        let by: Vector3<f64> = at(&aside) - at(&fine);
        assert!((by - Vector3::new(3e-3, 0.0, 0.0)).norm() < 1e-6, "{by}");
        // The turning face drags the middle layer along, away from the layer below it. In one seed
        // of ten it does so by only half a degree or one.
        let (short, fine) = pair("under_constrained", "jam");
        let dragged = |seen: &Seen| seen.verdict.layer_angles[0].abs();
        let (short, fine) = (dragged(&short), dragged(&fine));
        assert!(fine < 0.01 && short > 3.0 * fine.max(0.002), "{short} rad, else {fine} rad");
        let over = seed.seen("over_constrained", &[]);
        // The grasp aborts, or the run ends at the range of the wrist's sensor: the fingers of both
        // hands meet, and two layers resist the closing jaws.
        let (code, why) = (over.summary.exit_code(), &over.summary.reason);
        let broken_off = code == 1 && why.contains("over-force");
        assert!(broken_off || code == 3 && why.contains("limit of its range"), "{why}");
        assert_eq!(over.summary.cube_end, over.summary.cube_start, "no layer turns");
        assert_eq!(over.verdict.counts.drops, 0);
    });
}

#[test]
fn blind_arm_waits_for_new_pictures() {
    each_seed(|seed| {
        for name in ["camera_blackout", "camera_silent", "late_frames"] {
            let seen = seed.seen(name, &[]);
            // There are no usable pictures from 4 s (period 2000) to 6 s. The arm follows a pose
            // that is at most 0.1 s old, and then brakes.
            let blind = seen.largest_distance(0, 2100, 2990);
            let sees = seen.path_length(0, 3010, 3900);
            assert!(blind < 1e-3, "{name}: the arm moves {blind} m without sight");
            assert!(sees > 0.01, "{name}: the arm continues, {sees} m");
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
        }
    });
}

#[test]
fn hand_retracts_from_obstacle_and_returns() {
    each_seed(|seed| {
        let seen = seed.seen("contact", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        // A force of 30 N against the approach acts from 9 s on for 0.5 s. The hand is at rest
        // within 0.1 s ...
        let along = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let stood = along(4550);
        let nearer = (4550..4800).map(|p| along(p) - stood).fold(0.0, f64::max);
        assert!(nearer < 2e-3, "{nearer} m nearer to the operator");
        // ... and retracts well away before it approaches again.
        let farthest = (4800..6500).map(|p| along(p) - stood).fold(0.0, f64::min);
        assert!(farthest < -0.05, "the arm retracts by {farthest} m");
        assert_eq!(seen.verdict.counts.drops, 0);

        // A force that the sensor reads wherever the hand is must be an error of the sensor. The
        // hand zeroes it in free air and takes the cube.
        let lasts = seed.seen("contact", &["fault.0.duration_s=500"]);
        assert_eq!(lasts.summary.outcome, Outcome::Solved, "{}", lasts.summary.reason);
        assert!(lasts.summary.peak_force_n.unwrap() < 20.0);
        assert_eq!(lasts.verdict.counts.drops, 0);
    });
}

/// The hand that returns the cube retracts, keeps hold of the cube, and offers it again.
#[test]
fn hand_yields_to_obstacle_but_keeps_cube() {
    each_seed(|seed| {
        let seen = seed.seen("contact_back", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        assert_eq!((seen.verdict.counts.drops, seen.summary.returned), (0, Some(true)));
        assert!(seen.summary.sensors[0].force_n.unwrap() < 20.0);
        let never = seed.seen("contact_back", &["fault.0.magnitude=0"]);
        let longer = seen.summary.sim_time_s - never.summary.sim_time_s;
        assert!(longer > 2.0, "the cube was held out again: {longer} s longer");

        // If the obstacle stays, the cube stays in the hand, or the person pulls it out; it does
        // not fall.
        let lasts = seed.seen("contact_back", &["fault.0.duration_s=500"]);
        assert_eq!(lasts.verdict.counts.drops, 0, "{}", lasts.summary.reason);
    });
}

#[test]
fn dark_camera_ends_run_with_its_reason() {
    each_seed(|seed| {
        let seen = seed.seen("camera_blackout", &["fault.0.duration_s=3000"]);
        assert_eq!(seen.summary.exit_code(), 1);
        let told = "no cube in sight of the stand-alone camera for 60";
        assert!(seen.summary.reason.contains(told), "{}", seen.summary.reason);
        let last = seen.last();
        assert!(seen.largest_distance(0, 2100, last) < 2e-3, "the arm moves without sight");
    });
}

/// The arm takes the cube when the person offers it again.
#[test]
fn arm_does_not_follow_withdrawn_cube_closely() {
    each_seed(|seed| {
        let seen = seed.seen("withdraw", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        assert_eq!(seen.verdict.counts.drops, 0);
        // At 8 s the person withdraws the cube, and returns it 3 s later. The hand does not follow
        // it closely, and makes room when it returns.
        let cube = |seen: &Seen, period: u64| seen.at(period).cube.x;
        let tool = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let never = seed.seen("withdraw", &["fault.0.at_s=1000"]);
        let drawn = cube(&seen, 4600) - cube(&never, 4600);
        assert!(drawn > 0.1, "retracted by {drawn} m");
        let gap = |period: u64| cube(&seen, period) - tool(period);
        // The check ends where the cube returns, because from there on the cube closes the gap.
        let comes = (4600..5700).find(|p| cube(&seen, *p) < cube(&seen, 4600) - 0.01);
        let away = (4300..comes.unwrap_or(5700)).map(gap).fold(f64::INFINITY, f64::min);
        assert!(away > 0.07, "followed to within {away} m");
        // A cube that returns faster than the hand may move can touch its fingers. Then the hand
        // waits at a distance of 12 cm.
        let stands = (6000..7200).filter(|period| gap(*period) > 0.08).count();
        assert!(stands > 250, "at a distance for {stands} periods only when the cube returns");
        let felt = seen.summary.sensors[0].force_n.unwrap();
        assert!(felt < 20.0, "{felt} N");
        let (longer, usual) = (seen.summary.sim_time_s, never.summary.sim_time_s);
        assert!(longer > usual + 1.0, "{longer} s instead of {usual}");
    });
}

/// In the last 4 cm the gripper hides the cube and moves to the place where the camera saw it last.
/// If the person withdraws the cube then, the hand retracts before it follows.
#[test]
fn hand_retracts_when_hidden_cube_is_withdrawn() {
    each_seed(|seed| {
        let never = seed.seen("withdraw", &["fault.0.at_s=1000"]);
        let gap = |seen: &Seen, period: u64| {
            let at = seen.at(period);
            at.tools[0].inverse_transform_point(&at.cube.into()).z
        };
        let near = |m: &&Moment| gap(&never, m.period) < 0.045;
        let hidden = never.moments.iter().find(near).unwrap().period;

        let at = format!("fault.0.at_s={}", hidden as f64 * 0.002);
        let seen = seed.seen("withdraw", &[&at]);

        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        assert_eq!((seen.verdict.counts.drops, seen.verdict.counts.crushed), (0, 0));
        let x = |seen: &Seen, period: u64| seen.at(period).tools[0].translation.vector.x;
        let on = |seen: &Seen, period: u64| x(seen, period) - x(seen, hidden);
        let furthest =
            |seen: &Seen| (hidden..hidden + 1500).map(|p| on(seen, p)).fold(0.0, f64::max);
        assert!(furthest(&never) > 0.025, "the hand was near the cube: {}", furthest(&never));
        // Pictures come every 40 ms, and the arm needs time to brake: 12 to 14 mm at the profile
        // "swift". The cube would be touched after 25 mm.
        assert!(
            furthest(&seen) < 0.016,
            "{} m farther after the cube disappeared",
            furthest(&seen)
        );
        let back = (hidden..hidden + 1500).map(|p| on(&seen, p)).fold(0.0, f64::min);
        assert!(back < -0.05, "{back} m back");
        assert!(seen.summary.sensors[0].force_n.unwrap() < 20.0);
    });
}

/// Name of the file, exit code, and words that the operator reads.
const REPORTS: &[(&str, i32, &[&str])] = &[
    ("encoder_freeze", 3, &["fatal", "edp track", "period 3", "axis 6", "encoder does not move"]),
    ("encoder_jump", 3, &["fatal", "edp track", "period 3", "axis 3", "jumped by 3.00 rad"]),
    ("over_current", 3, &["fatal", "edp postument", "axis 4", "over-current, 14.5 A"]),
    ("limit_switch", 3, &["fatal", "edp track", "period 95", "axis 0", "limit switch"]),
    ("force_dropout", 3, &["fatal", "edp track", "force sensor: no reading along x"]),
    ("force_silent", 3, &["fatal", "edp track", "period 21", "force sensor: no reading along x"]),
    ("force_nan", 3, &["fatal", "edp track", "force sensor: no reading along z"]),
    ("force_saturation", 3, &["fatal", "edp track", "130.0 N along z is the limit of its range"]),
    ("force_bias", 1, &["over-force of", "along x", "postument"]),
    ("zero_moved", 0, &["non-fatal, edp track", "force sensor of track: zero has moved by"]),
    ("slip", 1, &["slip: the cube has forced the jaws apart", "while turning"]),
    ("drop", 1, &["slipped out of the postument hand"]),
    ("jam", 1, &["stalled"]),
    ("turn_undone", 1, &["turned by 0"]),
    ("missed_period", 0, &["servo: 1 periods missed"]),
    ("missed_periods", 3, &["fatal", "the servo missed 20 periods in a row"]),
    ("clock_jump", 3, &["fatal", "the servo missed 2500 periods in a row"]),
    ("emergency_stop", 3, &["fatal", "edp track", "emergency stop"]),
    ("heart_beat_loss", 4, &["system", "no answer from the actors' heartbeat in 0.1 s"]),
    ("node_dies", 4, &["system", "no answer from node b in 0.1 s"]),
    ("panic_ecp", 4, &["system", "ecp track panicked: a panic was injected"]),
    ("panic_edp", 4, &["system", "edp postument panicked: a panic was injected"]),
    ("panic_mp", 4, &["system", "mp panicked: a panic was injected"]),
    ("actor_hang", 4, &["system", "no answer from edp track in 0.1 s"]),
    ("hang_ecp", 4, &["system", "no answer from ecp track in 0.1 s"]),
    ("hang_vsp", 4, &["system", "no answer from vsp mpc in 0.1 s"]),
    ("panic_vsp", 4, &["system", "vsp mpc panicked: a panic was injected"]),
    ("hang_mp", 4, &["system", "no answer from mp in 0.1 s", "hold"]),
    ("spin_mp", 4, &["system", "no answer from mp in 10.0 s", "commanded to switch off"]),
    ("lost_message", 4, &["system", "the mailbox of edp track is closed"]),
    ("late_message", 0, &["solved"]),
    (
        "duplicated_message",
        0,
        &["reached the servo twice: it was executed once", "edp track", "period=3"],
    ),
    ("disk_full", 0, &["the recording stops: No space left", "lost: No space left"]),
    ("disk_error", 0, &["state can no longer be saved: Input/output error", "it is removed"]),
    ("lost_write", 0, &["the layer was turned by"]),
    ("push", 1, &["over-force", "hand while turning"]),
    ("under_constrained", 0, &["solved"]),
    ("jaw_calibration", 0, &["solved"]),
    ("base_calibration", 0, &["solved"]),
    ("camera_blackout", 0, &["non-fatal, vsp mpc", "the picture is black, period 20"]),
    ("camera_silent", 0, &["non-fatal, vsp mpc", "camera standalone: no picture comes, period 20"]),
    ("late_frames", 0, &["non-fatal, vsp mpc", "camera standalone", "period 20"]),
    ("withdraw", 0, &["solved"]),
    ("contact", 0, &["over-force of 30", "while approaching: the hand retracts, try 1"]),
    ("contact_back", 0, &["over-force of", "the motion stops", "no person holds the cube yet"]),
    ("misread", 1, &["this cube cannot exist", "stickers in doubt: D7", "handed back"]),
    ("over_constrained", 1, &["over-force", "track"]),
];

/// The exit code is that of the class of the fault.
#[test]
fn each_fault_gives_expected_exit_code_and_message() {
    each_seed(|seed| {
        for (name, code, words) in REPORTS {
            let mut run = program();
            run.args(["run", "--json", "--seed", &seed.0.to_string()])
                .args(profile().iter().flat_map(|profile| ["--set", profile]))
                .arg(path(name))
                .env("RUST_LOG", "warn")
                .env("NO_COLOR", "1");
            let file =
                std::env::temp_dir().join(format!("rubik-faults-{}.mcap", std::process::id()));
            match *name {
                "disk_full" | "lost_write" => _ = run.arg("--record").arg(&file),
                "disk_error" => _ = run.arg("--world").arg(&file),
                _ => {}
            }
            let run = run.output().unwrap();
            // A world that failed is removed; its lock and journal stay.
            assert!(*name != "disk_error" || !file.exists(), "a stale world would count as true");
            for file in [file.clone(), beside(&file, "lock"), beside(&file, "journal")] {
                let _ = std::fs::remove_file(file);
            }
            let out = String::from_utf8(run.stdout).unwrap();
            let err = String::from_utf8(run.stderr).unwrap();
            let last = out.lines().last().unwrap_or_default();
            let exit = run.status.code();
            // Two layers resist the closing jaws. With most seeds, the first among them, this loads
            // the wrist's sensor to the end of its range before the grasp is aborted: the exit code
            // is 3 then, instead of the 1 in `REPORTS`, and the words there are not in the report.
            if (*name, exit) == ("over_constrained", Some(3)) {
                assert!(last.contains("force sensor") && last.contains("limit of its range"));
                continue;
            }
            let summary: serde_json::Value = serde_json::from_str(last).unwrap_or_default();
            // Only outcome and reason are searched for places, because every summary names both
            // arms.
            let reason = format!("{} {}", summary["outcome"], summary["reason"]);
            // Exit codes 3 and 4 are those of errors, each of which has a code and a remedy, also
            // if the actors are all blocked.
            let (fault, remedy) = (summary["fault"].as_str(), summary["remedy"].as_str());
            let by_error = exit == Some(3) || exit == Some(4);
            assert_eq!((fault.is_some(), remedy.is_some()), (by_error, by_error), "{name}: {last}");
            assert!(summary["outcome"].is_string() && summary["reason"].is_string(), "{last}");
            // Blocked actors give no account, so the figures are unknown.
            assert_eq!(summary["cube_end"].is_null(), *name == "spin_mp", "{name}: {last}");
            // The colour U that the fault gives to F1 may be its own; then the fault changes
            // nothing.
            let shows_u = || summary["cube_start"].as_str().unwrap()[18..].starts_with('U');
            if *name == "misread" && shows_u() {
                assert_eq!((seed.0 == 1, exit), (false, Some(0)), "{last}");
                continue;
            }
            assert_eq!(exit, Some(*code), "{name}: {last}\n{err}");
            // The plant confirms that a cube went back.
            let goes_back = *code == 0 && summary["task"] == "acquire" || *name == "misread";
            assert!(!goes_back || summary["returned"] == true, "{name}: {last}");
            // Words with numbers are those of the first seed and of the scenario's own profile.
            let first = seed.0 == 1 && profile().is_none();
            let told = |word: &&&str| first || !word.contains(|c: char| c.is_ascii_digit());
            for word in words.iter().filter(told) {
                assert!(
                    reason.contains(word) || err.contains(word),
                    "{name}: no `{word}` in\n{last}\n{err}"
                );
            }
        }
    });
}

#[test]
fn each_fault_scenario_has_a_test() {
    let folder = path("x");
    let files = std::fs::read_dir(folder.parent().unwrap()).unwrap();
    let mut names: Vec<String> = files
        .map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        // The scenarios of whole missions are tested in missions.rs.
        .filter(|name: &String| !name.starts_with("solve_"))
        .collect();
    names.sort();
    let mut told: Vec<_> = REPORTS.iter().map(|(name, ..)| (*name).to_owned()).collect();
    told.sort();
    assert_eq!(names, told);
}

/// Two runs with a fault have the same hash, and so have two runs whose different faults never
/// begin.
#[test]
fn faulty_runs_repeat_exactly_untriggered_faults_change_nothing() {
    each_seed(|seed| {
        let hash = |keys: &[&str]| seed.seen("encoder_jump", keys).summary.hash;
        assert_eq!(hash(&[]), hash(&[]));
        let never = hash(&["fault.0.turned_deg=180"]);
        assert_eq!(never, seed.seen("over_current", &["fault.0.nth=9"]).summary.hash);
    });
}

/// Returns the highest speed of a tool, as a mean over 20 ms, where the operator's hand may be or
/// within 0.1 m of it (m/s).
fn fastest_near_the_operator(keys: &[&str], seed: u64) -> f64 {
    let seed = format!("seed={seed}");
    let keys = keys.iter().copied().chain([seed.as_str()]);
    let keys: Vec<_> = keys.map(|key| Override::parse(key).unwrap()).collect();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/acquire.toml");
    let scenario = rubik_robot::tasks::load(&file, &keys).unwrap();
    let zone = scenario.controller.cell.hand;
    let (mut before, fastest) = (None, Arc::new(Mutex::new(0.0_f64)));
    let told = Arc::clone(&fastest);
    let probe: run::PlantProbe = Box::new(move |period, plant| {
        const PERIODS: u64 = 10;
        if period % PERIODS != 0 {
            return;
        }
        let scene = plant.scene();
        let now = [0, 1].map(|i: usize| scene.arms[i].world_from_tool.translation.vector);
        if let Some(before) = before.replace(now) {
            let before: [Vector3<f64>; 2] = before;
            for (from, to) in before.iter().zip(&now) {
                let off = |at: &Vector3<f64>| {
                    zone.distance(&(zone.world_from_cube.inverse() * nalgebra::Point3::from(*at)))
                };
                if off(from).min(off(to)) < 0.1 {
                    let speed = (to - from).norm() / (PERIODS as f64 * 0.002);
                    let mut fastest = told.lock().unwrap();
                    *fastest = fastest.max(speed);
                }
            }
        }
    });
    let around = RunContext { probe: Some(probe), ..RunContext::default() };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let summary = run::run_with(&scenario, options, around).unwrap();
    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    let fastest = *fastest.lock().unwrap();
    println!("seed {seed}: {fastest:.3} m/s");
    fastest
}

#[test]
fn tools_stay_slow_near_operators_hand() {
    /// The guard reports an arm that is a fifth or more above its limit.
    const GUARD: f64 = 1.2;
    /// Limit if the scenario does not set `control.hand_speed_mm_s` (m/s).
    const USUAL: f64 = 0.25;
    /// Limit that the second run sets (m/s).
    const LOW: f64 = 0.08;
    /// Least top speed of a tool that moves near the operator at all (m/s).
    const MOVES: f64 = 0.02;
    each_seed(|Seed(seed)| {
        let usual = fastest_near_the_operator(&[], seed);
        let low = fastest_near_the_operator(&["control.hand_speed_mm_s=80"], seed);

        assert!(usual <= GUARD * USUAL, "{usual} m/s");
        assert!(low > MOVES && low <= GUARD * LOW, "{low} m/s");
        // The limit is what slows the tool: with the usual limit it is faster than the low one
        // allows.
        assert!(usual > GUARD * LOW, "{usual} m/s");
    });
}
