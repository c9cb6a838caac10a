//! Parameters that change while a run goes on: their effect in the plant, their recording, and
//! runs on several nodes.

use crate::missions::run;
use crate::program::program;
use crate::recording::recorded;
use rubik_robot::record::summary::{Outcome, Summary};
use rubik_robot::run::{RunContext, RunOptions, run_with};
use rubik_robot::scenario::Override;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Returns the key of one order of a parameter at a time (s).
fn order(at: f64, parameter: &str, value: f64) -> String {
    format!("order=[{{name=\"a\",at_s={at},parameter=\"{parameter}\",value={value}}}]")
}

/// Mean forces of the pads of each hand, and force of its palm, after one period (N).
type Squeeze = [(f64, f64); 2];

/// Runs a shipped scenario with these keys; returns its summary, and the forces of the hands on
/// the cube in each period.
fn squeezed(scenario: &str, set: &[&str]) -> (Summary, Vec<Squeeze>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(scenario);
    let set: Vec<_> = set.iter().map(|key| Override::parse(key).unwrap()).collect();
    let scenario = rubik_robot::tasks::load(&path, &set).unwrap();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let keeps = Arc::clone(&seen);
    let context = RunContext {
        probe: Some(Box::new(move |_, plant| {
            let hand = |arm| {
                let (pads, palm) = plant.squeeze(arm);
                (0.5 * (pads[0] + pads[1]), palm)
            };
            keeps.lock().unwrap().push([hand(0), hand(1)]);
        })),
        ..RunContext::default()
    };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let summary = run_with(&scenario, options, context).unwrap();
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    (summary, seen)
}

/// Returns the means of a value over each tenth of a second.
fn tenths(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let all: Vec<f64> = values.collect();
    all.chunks(50).map(|tenth| tenth.iter().sum::<f64>() / tenth.len() as f64).collect()
}

/// The hand that holds the cube while the other one grasps and turns it is ordered to grip with
/// 50 N instead of 40 N: the true force of its pads rises, and no faster than 5 N/s.
#[test]
fn grip_order_raises_pad_force_at_its_rate() {
    let usual = squeezed("face_turn.toml", &[]);
    let firm = squeezed("face_turn.toml", &[&order(2.0, "grip_n", 50.0)]);

    for (summary, _) in [&usual, &firm] {
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    }
    let body = |seen: &[Squeeze]| tenths(seen.iter().map(|hands| hands[1].0));
    let (usual, firm) = (body(&usual.1), body(&firm.1));
    assert_eq!(usual[..20], firm[..20], "nothing changes before the order");
    // A hand that waits keeps its grip; then each tenth of a second adds half a newton.
    for pair in firm[20..].windows(2) {
        assert!((-0.05..0.55).contains(&(pair[1] - pair[0])), "{pair:?}");
    }
    let last = |all: &[f64]| all[all.len() - 5..].iter().sum::<f64>() / 5.0;
    assert!((last(&firm) - last(&usual) - 10.0).abs() < 0.1, "{} {}", last(&firm), last(&usual));
}

/// The palm presses the cube with twice the force of an approach.
#[test]
fn approach_force_order_raises_pressing_force() {
    let palm = |seen: &[Squeeze]| tenths(seen.iter().map(|hands| hands[0].1));
    let [usual, firm] = [4.0, 6.0].map(|force| {
        let (summary, seen) = squeezed("face_turn.toml", &[&order(0.5, "approach_force_n", force)]);
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        palm(&seen).into_iter().fold(0.0, f64::max)
    });

    // The pads take up the same share of both pressing forces, 8 N and 12 N.
    assert!((firm - usual - 4.0).abs() < 1.0, "{usual} N, {firm} N");
}

/// A recording has the order as an input of the operator, and the change as a notice.
#[test]
fn recorded_order_is_verified_to_the_bit() {
    let change = order(2.0, "grip_n", 50.0);
    let (file, summary) = recorded("ordered.mcap", "scenarios/face_turn.toml", &["--set", &change]);
    let usual = run("face_turn.toml", &[]).servo_hash;
    assert_ne!(summary["servo_hash"], usual, "the order has an effect");
    let replayed = program().args(["replay", "--ui", "none"]).arg(&file).output().unwrap();
    let shown = String::from_utf8_lossy(&replayed.stderr);
    assert!(shown.contains("operator: parameter grip_n to 50"), "{shown}");
    assert!(shown.contains("parameter grip_n: from 40 to 50 N, by the scenario"), "{shown}");

    let verified = program().args(["replay", "--verify"]).arg(&file).output().unwrap();

    let told = String::from_utf8_lossy(&verified.stdout);
    assert!(told.contains("the same: the whole controller"), "{told}");
    std::fs::remove_file(file).unwrap();
}

/// An ECP on another node gets the order over the link.
#[test]
fn order_reaches_ecp_on_another_node() {
    let node = "node=[{name=\"b\",actors=[\"edp postument\",\"ecp postument\",\"vsp gs2\"]}]";
    let keys = [node, "link.delay_ms=20"];
    let change = order(2.0, "grip_n", 50.0);
    let (usual, firm) = (
        squeezed("face_turn.toml", &keys),
        squeezed("face_turn.toml", &[&keys[..], &[&change]].concat()),
    );

    let body = |seen: &[Squeeze]| tenths(seen.iter().map(|hands| hands[1].0));
    let last = |all: &[f64]| all[all.len() - 5..].iter().sum::<f64>() / 5.0;
    let (usual, firm) = (last(&body(&usual.1)), last(&body(&firm.1)));
    assert!((firm - usual - 10.0).abs() < 2.0, "{usual} N, {firm} N");
}

/// Many values far from the usual ones, ordered in mid-mission, leave the mission solved.
#[test]
fn mission_with_all_parameters_changed_solves_cube() {
    let orders = [
        (20.0, "grip_n", 50.0),
        (21.0, "approach_force_n", 5.0),
        (30.0, "free_speed_percent", 60.0),
        (50.0, "turn_speed_deg_s", 30.0),
        (60.0, "turn_torque_nm", 2.8),
        (70.0, "linear_admittance_mm_sn", 0.7),
        (80.0, "angular_admittance_rad_snm", 0.04),
        (90.0, "force_limit_n", 25.0),
        (100.0, "jaw_close_speed_mm_s", 8.0),
        (110.0, "exposure", 1.3),
        (120.0, "free_speed_percent", 100.0),
    ];
    let element = |(i, (at, parameter, value)): (usize, &(f64, &str, f64))| {
        format!("{{name=\"o{i}\",at_s={at},parameter=\"{parameter}\",value={value}}}")
    };
    let all: Vec<String> = orders.iter().enumerate().map(element).collect();

    let summary = run("solve.toml", &[&format!("order=[{}]", all.join(","))]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!((summary.drops, summary.slips), (Some(0), Some(0)));
}
