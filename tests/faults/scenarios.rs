//! Everything under `scenarios/faults/`: what the plant then does, what the operator is told, and the exit code.
//!
//! The plant is looked at after each period by a judge that no part of the controller knows of; exit codes and messages
//! are those of the program itself. `FAULT_SEEDS=100 cargo test --release --test faults scenarios::` tries a hundred seeds of each.

use crate::program::program;
use crate::seeds::{Seed, each_seed};
use nalgebra::Vector3;
use rubik_robot::hw::plant::{Incident, Verdict, Whereabouts};
use rubik_robot::record::summary::{Outcome, Summary};
use rubik_robot::run::{self, RunContext, RunOptions};
use rubik_robot::scenario::{self, Override};
use rubik_robot::spatial::Pose;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// What a judge notes each period.
#[derive(Debug, Clone)]
struct Moment {
    period: u64,
    tools: [Pose; 2],
    powered: [bool; 2],
    openings: [f64; 2],
    /// Angle of the turning layer (rad).
    turned: f64,
    /// Centre of the cube in the world (m).
    cube: Vector3<f64>,
    /// Largest force between the hands so far (N).
    peak: f64,
}

struct Seen {
    summary: Summary,
    moments: Vec<Moment>,
    /// The plant's account at the end.
    verdict: Verdict,
}

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/faults").join(format!("{name}.toml"))
}

impl Seed {
    fn seen(self, name: &str, keys: &[&str]) -> Seen {
        let seed = format!("seed={}", self.0);
        let keys = keys.iter().copied().chain([seed.as_str()]);
        seen(name, &keys.map(|key| Override::parse(key).unwrap()).collect::<Vec<_>>())
    }

    /// The period in which the layer passes 30 deg: where most faults of a turn begin.
    fn turned_30(self) -> u64 {
        self.turned_30_by(&[])
    }

    fn turned_30_by(self, keys: &[&str]) -> u64 {
        let keys: Vec<&str> = ["fault.0.magnitude=0"].iter().chain(keys).copied().collect();
        let seen = self.seen("jam", &keys);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        let passes = |m: &&Moment| m.turned.to_degrees().abs() >= 30.0;
        seen.moments.iter().find(passes).unwrap().period
    }
}

fn seen(name: &str, keys: &[Override]) -> Seen {
    let scenario = scenario::load(&path(name), keys).unwrap_or_else(|e| panic!("{e}"));
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
    fn at(&self, period: u64) -> &Moment {
        let first = self.moments[0].period;
        &self.moments[(period - first) as usize]
    }

    /// The first period without power in an arm.
    fn cut(&self, arm: usize) -> Option<u64> {
        let on = self.moments.iter().position(|m| m.powered[arm]).unwrap();
        self.moments[on..].iter().find(|m| !m.powered[arm]).map(|m| m.period)
    }

    /// Path of a tool between two periods (m).
    fn way(&self, arm: usize, from: u64, to: u64) -> f64 {
        (from..to)
            .map(|p| {
                let at = |p: u64| self.at(p).tools[arm].translation.vector;
                (at(p + 1) - at(p)).norm()
            })
            .sum()
    }

    /// How far a tool comes from where it is in period `from` (m).
    fn away(&self, arm: usize, from: u64, to: u64) -> f64 {
        let place = |p: u64| self.at(p).tools[arm].translation.vector;
        (from..to).map(|p| (place(p) - place(from)).norm()).fold(0.0, f64::max)
    }

    fn last(&self) -> u64 {
        self.moments.last().unwrap().period
    }

    /// A fatal stop of one arm: its drives go off by `trip`, it hardly moves from there on, and the other one is powered
    /// and stands at the end.
    fn stops(&self, arm: usize, trip: std::ops::RangeInclusive<u64>) {
        let cut = self.cut(arm).unwrap();
        assert!(trip.contains(&cut), "the drives go off in period {cut}, not in {trip:?}");
        // Brakes take their way, and the drive trains ring on in place.
        let (away, speed) = (self.away(arm, cut, self.last()), self.way(arm, cut - 1, cut) / 2e-3);
        let most = 0.5e-3 + 0.05 * speed;
        assert!(away < most, "arm {arm} goes {away} m from {speed} m/s after its power is off");
        let other = 1 - arm;
        assert_eq!(self.cut(other), None, "the other arm holds under power");
        assert!(self.last() - cut > 250, "there is time for it to come to a stand");
        let stand = self.way(other, self.last() - 25, self.last());
        assert!(stand < 1e-4, "the other arm still moves: {stand}");
        assert_eq!(self.verdict.counts.drops, 0);
        assert!(self.summary.peak_force_n.unwrap() < 20.0, "{:?}", self.summary.peak_force_n);
    }

    fn is_held_by(&self, arms: [bool; 2]) {
        assert_eq!(self.verdict.cube, Whereabouts::Arms(arms));
    }
}

#[test]
fn a_frozen_counter_stops_its_arm_and_the_other_one_holds_the_cube() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("encoder_freeze", &[]);
        // The fault table's ten periods: from the reading on, which is a period old.
        seen.stops(0, begin..=begin + 10);
        seen.is_held_by([true, true]);
    });
}

#[test]
fn a_jumping_counter_stops_its_arm_at_once() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("encoder_jump", &[]);
        seen.stops(0, begin..=begin + 2);
        seen.is_held_by([true, true]);
    });
}

#[test]
fn over_current_and_a_limit_switch_take_the_power_off_one_arm_only() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen_current = seed.seen("over_current", &[]);
        seen_current.stops(1, begin..=begin + 2);
        seen_current.is_held_by([true, true]);

        let seen = seed.seen("limit_switch", &[]);
        seen.stops(0, 950..=952);
        seen.is_held_by([false, true]);
    });
}

#[test]
fn a_force_that_is_none_moves_nothing() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        for name in ["force_dropout", "force_nan", "force_saturation"] {
            let seen = seed.seen(name, &[]);
            // The reading after the one at 30 deg is bad, in the next period its arm is off.
            seen.stops(0, begin..=begin + 2);
            seen.is_held_by([true, true]);
            // From the reading on: less than the way of two periods of the turn.
            assert!(
                seen.way(0, begin, begin + 4) < 2e-4,
                "{name}: {}",
                seen.way(0, begin, begin + 4)
            );
        }
    });
}

/// On the way to the operator's hand nothing but the force tells of what is met there.
#[test]
fn an_arm_whose_force_sensor_is_silent_goes_nowhere() {
    each_seed(|seed| {
        let seen = seed.seen("force_silent", &[]);
        seen.stops(0, 2100..=2102);
        assert!(seen.way(0, 1900, 2100) > 2e-3, "it was on its way");
    });
}

#[test]
fn a_sudden_bias_breaks_the_turn_off_before_it_has_moved_an_arm() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("force_bias", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
        assert!(seen.way(1, begin, seen.last()) < 2e-3, "{}", seen.way(1, begin, seen.last()));
        assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        seen.is_held_by([true, true]);
    });
}

#[test]
fn pads_without_friction_slip_and_the_plant_knows() {
    each_seed(|seed| {
        let seen = seed.seen("slip", &[]);
        assert!(seen.verdict.counts.slips > 0);
        assert!(seen.summary.turned_deg.unwrap() < 80.0, "{:?}", seen.summary.turned_deg);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
    });
}

#[test]
fn a_hand_that_loses_the_cube_lets_it_fall_onto_the_tray() {
    each_seed(|seed| {
        let seen = seed.seen("drop", &[]);
        assert_eq!(seen.verdict.counts.drops, 1);
        assert!(matches!(seen.verdict.cube, Whereabouts::Tray { .. }), "{:?}", seen.verdict.cube);
        let events = &seen.verdict.events;
        let dropped = events.iter().find(|e| matches!(e.what, Incident::Drop { .. })).unwrap();
        assert!((1000..1005).contains(&dropped.period), "{dropped:?}");
        assert_ne!(seen.summary.outcome, Outcome::Solved);
    });
}

#[test]
fn a_jam_lets_no_layer_turn_and_forces_stay_within_limits() {
    each_seed(|seed| {
        let seen = seed.seen("jam", &[]);
        let turned = seen.summary.turned_deg.unwrap();
        assert!((29.0..33.0).contains(&turned), "{turned}");
        // The turn is broken off and eased back long before a layer has stood still for 3 s.
        assert!(seen.summary.reason.contains("stands still"), "{}", seen.summary.reason);
        assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
    });
}

#[test]
fn a_turn_that_did_not_happen_leaves_the_cube_as_it_was_and_is_felt_by_nobody() {
    each_seed(|seed| {
        let fine = seed.seen("turn_undone", &["fault.0.turned_deg=179"]);
        assert_eq!(fine.summary.outcome, Outcome::Solved);
        let seen = seed.seen("turn_undone", &[]);
        assert_eq!(seen.summary.cube_end, seen.summary.cube_start);
        assert!(seen.summary.turned_deg.unwrap().abs() < 5.0);
        assert_eq!((seen.verdict.counts.slips, seen.verdict.counts.drops), (0, 0));
        let (with, without) =
            (seen.summary.peak_force_n.unwrap(), fine.summary.peak_force_n.unwrap());
        assert!((with - without).abs() < 1.0, "{with} {without}");
        assert!(seen.moments.iter().all(|m| m.openings.iter().all(|o| *o > 0.05)));
    });
}

#[test]
fn one_missed_period_is_counted_and_twenty_stop_both_arms_as_a_jump_of_the_clock_does() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let one = seed.seen("missed_period", &[]);
        assert_eq!(one.summary.outcome, Outcome::Solved, "{}", one.summary.reason);

        for name in ["missed_periods", "clock_jump"] {
            let seen = seed.seen(name, &[]);
            // 0.1 s to come to a stand under power, and the drives off after 0.2 s.
            for arm in [0, 1] {
                let cut = seen.cut(arm).unwrap();
                assert!((begin + 90..begin + 130).contains(&cut), "{name}: arm {arm} at {cut}");
                assert!(seen.way(arm, cut, seen.last()) < 1e-3);
            }
            assert!(seen.summary.peak_force_n.unwrap() < 20.0);
            seen.is_held_by([true, true]);
        }
    });
}

#[test]
fn an_emergency_stop_takes_the_power_off_both_arms_and_they_stay_where_they_are() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("emergency_stop", &[]);
        for arm in [0, 1] {
            assert!((begin..=begin + 2).contains(&seen.cut(arm).unwrap()), "{:?}", seen.cut(arm));
            assert!(seen.way(arm, begin + 5, seen.last()) < 1e-3);
        }
        seen.is_held_by([true, true]);
    });
}

/// The run is over 0.1 s after the trouble began, and the period in which it is told.
fn noticed(seen: &Seen, begin: u64) {
    let period = (seen.summary.sim_time_s / 0.002).round() as u64;
    assert!((begin..=begin + 51).contains(&period), "noticed in period {period}, begun in {begin}");
}

/// Both arms are under power and stand, at most so many periods after the trouble began.
fn both_hold(seen: &Seen, begin: u64, within: u64) {
    for arm in [0, 1] {
        assert_eq!(seen.cut(arm), None);
        let still = seen.away(arm, begin + within, begin + within + 60);
        assert!(still < 5e-4, "arm {arm} still moves {within} periods later: {still}");
    }
    assert_eq!(seen.verdict.counts.drops, 0);
    assert!(seen.summary.peak_force_n.unwrap() < 20.0);
}

#[test]
fn arms_hold_when_an_actor_panics_or_hangs_or_no_heart_beats() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        // 0.1 s until it is noticed, where it is not at once, and 0.25 s until regulators and layer are at rest.
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
            noticed(&seen, begin);
            both_hold(&seen, begin, within);
            seen.is_held_by([true, true]);
        }
        let seen = seed.seen("hang_mp", &["coordination=continuous"]);
        noticed(&seen, seed.turned_30_by(&["coordination=continuous"]));
        for name in ["hang_vsp", "panic_vsp"] {
            // While the arm follows the cube, from 4 s on.
            let seen = seed.seen(name, &[]);
            noticed(&seen, 2000);
            both_hold(&seen, 2000, 190);
        }
        for name in ["panic_ecp", "panic_mp"] {
            // While the track approaches the cube, from 2 s on.
            let seen = seed.seen(name, &[]);
            noticed(&seen, 1000);
            // From the full speed of an approach.
            both_hold(&seen, 1000, 220);
            seen.is_held_by([false, true]);
        }
    });
}

#[test]
fn messages_that_come_late_or_twice_change_no_result() {
    each_seed(|seed| {
        for name in ["late_message", "duplicated_message"] {
            let seen = seed.seen(name, &[]);
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
            assert!((seen.summary.turned_deg.unwrap() - 90.0).abs() < 2.0);
        }
        // What comes late is waited for: the arm slows down where it would have gone on.
        let (late, never) =
            (seed.seen("late_message", &[]), seed.seen("late_message", &["fault.0.at_s=1000"]));
        assert_ne!(late.summary.hash, never.summary.hash);
        let (slow, fast) = (late.way(0, 1015, 1030), never.way(0, 1015, 1030));
        assert!(slow < 0.85 * fast, "{slow} m instead of {fast}");
        // What comes twice is obeyed once: nothing is moved by it.
        let never = seed.seen("duplicated_message", &["fault.0.turned_deg=180"]);
        assert_eq!(seed.seen("duplicated_message", &[]).summary.hash, never.summary.hash);
    });
}

#[test]
fn a_push_breaks_the_turn_off_within_a_tenth_of_a_second() {
    each_seed(|seed| {
        let begin = seed.turned_30();
        let seen = seed.seen("push", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Failed);
        // Nothing turns any more, whatever else there is to be done before the run is over.
        let turned = |period: u64| seen.at(period).turned.to_degrees().abs();
        // Or it is over by then.
        let later = turned(seen.last()) - turned((begin + 50).min(seen.last()));
        assert!(later.abs() < 1.5, "{later} deg");
        assert!(turned(seen.last()) < 35.0, "{}", turned(seen.last()));
        assert_eq!(seen.verdict.counts.drops, 0);
        // The hand gives way to what pushes it, and the force between the hands rises no more after 0.04 s.
        let x = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let yields = x(seen.last()) - x(begin);
        assert!(yields > 2e-4, "it yields by {yields} m");
        let (soon, end) = (seen.at((begin + 20).min(seen.last())).peak, seen.at(seen.last()).peak);
        assert!(end - soon < 0.5, "{soon} N, then {end} N");
        let never = seed.seen("push", &["fault.0.magnitude=0"]);
        assert!((never.at(seen.last()).tools[0].translation.vector.x - x(begin)).abs() < 5e-5);
    });
}

#[test]
fn wrong_calibrations_are_taken_up_and_fingers_of_wrong_length_judged_by_the_plant() {
    each_seed(|seed| {
        for name in ["jaw_calibration", "base_calibration", "under_constrained"] {
            let seen = seed.seen(name, &[]);
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
            assert!(seen.summary.peak_force_n.unwrap() < 20.0);
        }
        // Each of them is there, in the plant.
        let pair = |name: &str, fine: &str| {
            (seed.seen(name, &[]), seed.seen(fine, &["fault.0.magnitude=0"]))
        };
        let (wide, fine) = pair("jaw_calibration", "jaw_calibration");
        let by = wide.at(1000).openings[0] - fine.at(1000).openings[0];
        assert!((by - 1e-3).abs() < 3e-4, "the open jaws are {by} m wider");
        let (aside, fine) = pair("base_calibration", "base_calibration");
        let at = |seen: &Seen| seen.moments[0].tools[1].translation.vector;
        let by: Vector3<f64> = at(&aside) - at(&fine);
        assert!((by - Vector3::new(3e-3, 0.0, 0.0)).norm() < 1e-6, "{by}");
        // The middle layer is dragged along, away from the one below it.
        let (short, fine) = pair("under_constrained", "jam");
        let dragged = |seen: &Seen| seen.verdict.layer_angles[0].abs();
        // In one seed of ten by half a degree or one only.
        let (short, fine) = (dragged(&short), dragged(&fine));
        assert!(fine < 0.01 && short > 3.0 * fine.max(0.002), "{short} rad, else {fine} rad");
        let over = seed.seen("over_constrained", &[]);
        // Broken off, or ended by the range of the wrist's sensor: fingers meet fingers, and two layers hold out against
        // closing jaws.
        let (code, why) = (over.summary.exit_code(), &over.summary.reason);
        let broken_off = code == 1 && why.contains("over-force");
        assert!(broken_off || code == 3 && why.contains("end of its range"), "{why}");
        assert_eq!(over.summary.cube_end, over.summary.cube_start, "nothing turns");
        assert_eq!(over.verdict.counts.drops, 0);
    });
}

#[test]
fn an_arm_that_is_blind_stands_within_a_tenth_of_a_second_and_goes_on_when_it_sees() {
    each_seed(|seed| {
        for name in ["camera_blackout", "camera_silent", "late_frames"] {
            let seen = seed.seen(name, &[]);
            // From 4 s on, for 2 s; a pose of 0.1 s is still followed, and then the arm brakes.
            let blind = seen.away(0, 2100, 2990);
            let sees = seen.way(0, 3010, 3900);
            assert!(blind < 1e-3, "{name}: the arm goes {blind} m blindly");
            assert!(sees > 0.01, "{name}: it goes on, {sees} m");
            assert_eq!(seen.summary.outcome, Outcome::Solved, "{name}: {}", seen.summary.reason);
        }
    });
}

#[test]
fn a_hand_that_meets_something_on_its_way_stops_draws_back_and_comes_again() {
    each_seed(|seed| {
        let seen = seed.seen("contact", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        // Against its own approach, 30 N from 9 s on for 0.5 s: it stands within a tenth of a second ...
        let along = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let stood = along(4550);
        let nearer = (4550..4800).map(|p| along(p) - stood).fold(0.0, f64::max);
        assert!(nearer < 2e-3, "{nearer} m nearer to the operator");
        // ... and is well away before it comes again.
        let farthest = (4800..6500).map(|p| along(p) - stood).fold(0.0, f64::min);
        assert!(farthest < -0.05, "it draws back by {farthest} m");
        assert_eq!(seen.verdict.counts.drops, 0);

        // What is felt wherever the hand is, is the sensor's own: zeroed away from everything, and the cube taken.
        let lasts = seed.seen("contact", &["fault.0.duration_s=500"]);
        assert_eq!(lasts.summary.outcome, Outcome::Solved, "{}", lasts.summary.reason);
        assert!(lasts.summary.peak_force_n.unwrap() < 20.0);
        assert_eq!(lasts.verdict.counts.drops, 0);
    });
}

#[test]
fn what_is_in_the_way_of_a_cube_that_is_handed_back_is_given_way_to_and_no_cube_let_go_for_it() {
    each_seed(|seed| {
        let seen = seed.seen("contact_back", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        assert_eq!((seen.verdict.counts.drops, seen.summary.returned), (0, Some(true)));
        assert!(seen.summary.sensors[0].force_n.unwrap() < 20.0);
        let never = seed.seen("contact_back", &["fault.0.magnitude=0"]);
        let longer = seen.summary.sim_time_s - never.summary.sim_time_s;
        assert!(longer > 2.0, "it was held out once more: {longer} s longer");

        // What stays in the way: the cube stays in the hand, or goes to whom it was pushed to; it does not fall.
        let lasts = seed.seen("contact_back", &["fault.0.duration_s=500"]);
        assert_eq!(lasts.verdict.counts.drops, 0, "{}", lasts.summary.reason);
    });
}

#[test]
fn a_camera_that_stays_dark_ends_the_run_and_says_so() {
    each_seed(|seed| {
        let seen = seed.seen("camera_blackout", &["fault.0.duration_s=3000"]);
        assert_eq!(seen.summary.exit_code(), 1);
        let told = "no cube in sight of the stand-alone camera for 60";
        assert!(seen.summary.reason.contains(told), "{}", seen.summary.reason);
        let last = seen.last();
        assert!(seen.away(0, 2100, last) < 2e-3, "it moves blindly");
    });
}

#[test]
fn an_operator_who_draws_back_is_not_followed_into_the_cell_and_gets_rid_of_the_cube_later() {
    each_seed(|seed| {
        let seen = seed.seen("withdraw", &[]);
        assert_eq!(seen.summary.outcome, Outcome::Solved, "{}", seen.summary.reason);
        assert_eq!(seen.verdict.counts.drops, 0);
        // From 8 s on the cube is drawn back, and comes again 3 s later: it is not followed closely, and makes room for.
        let cube = |seen: &Seen, period: u64| seen.at(period).cube.x;
        let tool = |period: u64| seen.at(period).tools[0].translation.vector.x;
        let never = seed.seen("withdraw", &["fault.0.at_s=1000"]);
        let drawn = cube(&seen, 4600) - cube(&never, 4600);
        assert!(drawn > 0.1, "drawn back by {drawn} m");
        let gap = |period: u64| cube(&seen, period) - tool(period);
        // Where it comes again it is the cube that comes near.
        let comes = (4600..5700).find(|p| cube(&seen, *p) < cube(&seen, 4600) - 0.01);
        let away = (4300..comes.unwrap_or(5700)).map(gap).fold(f64::INFINITY, f64::min);
        assert!(away > 0.07, "followed to within {away} m");
        // Whoever comes at a hand faster than it may go may touch its fingers; then it stands where it waits, at 12 cm.
        let stands = (6000..7200).filter(|period| gap(*period) > 0.08).count();
        assert!(stands > 250, "so far off for {stands} periods only when it comes again");
        let felt = seen.summary.sensors[0].force_n.unwrap();
        assert!(felt < 20.0, "{felt} N");
        let (longer, usual) = (seen.summary.sim_time_s, never.summary.sim_time_s);
        assert!(longer > usual + 1.0, "{longer} s instead of {usual}");
    });
}

/// In the last 4 cm the gripper hides the cube, and what it goes to is where the cube was seen last.
#[test]
fn a_cube_that_is_drawn_out_of_the_fingers_is_given_way_to_before_it_is_followed() {
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
        assert!(furthest(&never) > 0.025, "it was nearly there: {}", furthest(&never));
        assert!(furthest(&seen) < 0.012, "{} m on after a cube that has gone", furthest(&seen));
        let back = (hidden..hidden + 1500).map(|p| on(&seen, p)).fold(0.0, f64::min);
        assert!(back < -0.05, "{back} m back");
        assert!(seen.summary.sensors[0].force_n.unwrap() < 20.0);
    });
}

/// File, exit code, and what the operator reads.
const TOLD: &[(&str, i32, &[&str])] = &[
    ("encoder_freeze", 3, &["fatal", "edp track", "period 2", "axis 6", "encoder stands still"]),
    ("encoder_jump", 3, &["fatal", "edp track", "period 2", "axis 3", "jumped by 3.00 rad"]),
    ("over_current", 3, &["fatal", "edp postument", "axis 4", "over-current, 14.5 A"]),
    ("limit_switch", 3, &["fatal", "edp track", "period 95", "axis 0", "limit switch"]),
    ("force_dropout", 3, &["fatal", "edp track", "force sensor: no reading along x"]),
    ("force_silent", 3, &["fatal", "edp track", "period 21", "force sensor: no reading along x"]),
    ("force_nan", 3, &["fatal", "edp track", "force sensor: no reading along z"]),
    ("force_saturation", 3, &["fatal", "edp track", "130.0 N along z is the end of its range"]),
    ("force_bias", 1, &["over-force of", "along x", "postument"]),
    ("zero_moved", 0, &["non-fatal, edp track", "force sensor of track: zero has moved by"]),
    ("slip", 1, &["slip: the cube has forced the jaws apart", "while turning"]),
    ("drop", 1, &["slipped out of the postument hand"]),
    ("jam", 1, &["stands still"]),
    ("turn_undone", 1, &["turned by 0"]),
    ("missed_period", 0, &["servo: 1 periods missed"]),
    ("missed_periods", 3, &["fatal", "the servo missed 20 periods in a row"]),
    ("clock_jump", 3, &["fatal", "the servo missed 2500 periods in a row"]),
    ("emergency_stop", 3, &["fatal", "edp track", "emergency stop"]),
    ("heart_beat_loss", 4, &["system", "no answer from the actors' heart in 0.1 s"]),
    ("panic_ecp", 4, &["system", "ecp track panicked: a panic was injected"]),
    ("panic_edp", 4, &["system", "edp postument panicked: a panic was injected"]),
    ("panic_mp", 4, &["system", "mp panicked: a panic was injected"]),
    ("actor_hang", 4, &["system", "no answer from edp track in 0.1 s"]),
    ("hang_ecp", 4, &["system", "no answer from ecp track in 0.1 s"]),
    ("hang_vsp", 4, &["system", "no answer from vsp mpc in 0.1 s"]),
    ("panic_vsp", 4, &["system", "vsp mpc panicked: a panic was injected"]),
    ("hang_mp", 4, &["system", "no answer from mp in 0.1 s", "hold"]),
    ("spin_mp", 4, &["system", "no answer from mp in 10.0 s", "told to switch off"]),
    ("lost_message", 4, &["system", "the mailbox of edp track is closed"]),
    ("late_message", 0, &["solved"]),
    ("duplicated_message", 0, &["came twice: obeyed once", "edp track", "period=2"]),
    ("disk_full", 0, &["the recording stops: no storage space", "lost: no storage space"]),
    ("push", 1, &["over-force", "hand while turning"]),
    ("under_constrained", 0, &["solved"]),
    ("jaw_calibration", 0, &["solved"]),
    ("base_calibration", 0, &["solved"]),
    ("camera_blackout", 0, &["non-fatal, vsp mpc", "the picture is black, period 20"]),
    ("camera_silent", 0, &["non-fatal, vsp mpc", "camera standalone: no picture comes, period 20"]),
    ("late_frames", 0, &["non-fatal, vsp mpc", "camera standalone", "period 20"]),
    ("withdraw", 0, &["solved"]),
    ("contact", 0, &["over-force of 30", "while approaching: the hand draws back, try 1"]),
    ("contact_back", 0, &["over-force of", "it goes no farther", "nobody has hold of it"]),
    ("misread", 1, &["this cube cannot exist", "stickers in doubt: D7", "handed back"]),
    ("over_constrained", 1, &["over-force", "track"]),
];

#[test]
fn every_fault_ends_with_the_exit_code_of_its_class_and_is_told_with_its_place() {
    each_seed(|seed| {
        for (name, code, words) in TOLD {
            let mut run = program();
            run.args(["run", "--json", "--seed", &seed.0.to_string()])
                .arg(path(name))
                .env("RUST_LOG", "warn")
                .env("NO_COLOR", "1");
            let file =
                std::env::temp_dir().join(format!("rubik-faults-{}.mcap", std::process::id()));
            if *name == "disk_full" {
                run.arg("--record").arg(&file);
            }
            let run = run.output().unwrap();
            let _ = std::fs::remove_file(file);
            let out = String::from_utf8(run.stdout).unwrap();
            let err = String::from_utf8(run.stderr).unwrap();
            let last = out.lines().last().unwrap_or_default();
            let exit = run.status.code();
            if (*name, exit) == ("over_constrained", Some(3)) {
                assert!(last.contains("force sensor"), "{last}");
                continue;
            }
            let summary: serde_json::Value = serde_json::from_str(last).unwrap_or_default();
            // Every summary names both arms: places are those of what is told.
            let reason = format!("{} {}", summary["outcome"], summary["reason"]);
            // The colour that is put in, U for F1, may be the sticker's own.
            let shows_u = || summary["cube_start"].as_str().unwrap()[18..].starts_with('U');
            if *name == "misread" && shows_u() {
                assert_eq!((seed.0 == 1, exit), (false, Some(0)), "{last}");
                continue;
            }
            assert_eq!(exit, Some(*code), "{name}: {last}\n{err}");
            // What is told of a cube that goes back is the plant's word, too.
            let goes_back = *code == 0 && summary["task"] == "acquire" || *name == "misread";
            assert!(!goes_back || summary["returned"] == true, "{name}: {last}");
            // What has numbers in it is that of the first seed.
            let told = |word: &&&str| seed.0 == 1 || !word.contains(|c: char| c.is_ascii_digit());
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
fn every_scenario_of_a_fault_is_tested_here() {
    let folder = path("x");
    let files = std::fs::read_dir(folder.parent().unwrap()).unwrap();
    let mut names: Vec<String> = files
        .map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned())
        // Whole missions: missions.rs.
        .filter(|name: &String| !name.starts_with("solve_"))
        .collect();
    names.sort();
    let mut told: Vec<_> = TOLD.iter().map(|(name, ..)| (*name).to_owned()).collect();
    told.sort();
    assert_eq!(names, told);
}

#[test]
fn a_run_with_faults_repeats_to_the_bit_and_a_fault_that_never_comes_changes_nothing() {
    each_seed(|seed| {
        let hash = |keys: &[&str]| seed.seen("encoder_jump", keys).summary.hash;
        assert_eq!(hash(&[]), hash(&[]));
        let never = hash(&["fault.0.turned_deg=180"]);
        assert_eq!(never, seed.seen("over_current", &["fault.0.nth=9"]).summary.hash);
    });
}

/// The fastest that a tool goes, over 20 ms, where the operator's hand may be or within 0.1 m of it
/// (m/s).
fn fastest_near_the_operator(keys: &[&str], seed: u64) -> f64 {
    let seed = format!("seed={seed}");
    let keys = keys.iter().copied().chain([seed.as_str()]);
    let keys: Vec<_> = keys.map(|key| Override::parse(key).unwrap()).collect();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/acquire.toml");
    let scenario = scenario::load(&file, &keys).unwrap();
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
                    zone.off(&(zone.world_from_cube.inverse() * nalgebra::Point3::from(*at)))
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
fn no_tool_is_faster_than_it_may_be_where_the_operators_hand_is() {
    each_seed(|Seed(seed)| {
        let fastest = fastest_near_the_operator(&[], seed);
        assert!(fastest <= 1.2 * 0.25, "{fastest} m/s");
        // As fast as the limit lets it be: where 80 mm/s are allowed, and at the usual limit it would be faster.
        let slow = fastest_near_the_operator(&["control.hand_speed_mm_s=80"], seed);
        assert!(slow > 0.02 && slow <= 1.2 * 0.08, "{slow} m/s");
        assert!(fastest > 1.2 * 0.08, "{fastest} m/s");
    });
}
