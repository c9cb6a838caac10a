//! Scenarios from one end to the other on the virtual clock: what must succeed, what must fail and say why, and
//! what must repeat to the bit.

use crate::program::program;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rubik_robot::record::summary::{EndedBy, Outcome, Summary};
use rubik_robot::run::{self, RunOptions};
use rubik_robot::scenario::{self, Override};
use rubik_robot::spatial::pose_from_axes;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

const SOLVED: &str = "UUUUUUUUURRRRRRRRRFFFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";

fn run(name: &str, keys: &[&str]) -> Summary {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(name);
    let keys: Vec<Override> = keys.iter().map(|key| Override::parse(key).unwrap()).collect();
    let scenario = scenario::load(&path, &keys).unwrap();
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };
    let summary = run::run(&scenario, options).unwrap();
    println!("{name} {keys:?}:\n{}", summary.table());
    summary
}

#[test]
fn a_face_turns_by_90_degrees_and_below_20_newtons() {
    let summary = run("face_turn.toml", &[]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert!((summary.turned_deg.unwrap() - 90.0).abs() < 5.0);
    let peak = summary.peak_force_n.unwrap();
    assert!(peak > 0.0 && peak < 20.0, "{peak}");
    assert_eq!((summary.jams, summary.slips, summary.drops), (Some(0), Some(0), Some(0)));
    assert_eq!(summary.exit_code(), 0);
    assert_ne!(summary.cube_start, summary.cube_end);
}

/// The whole mission, judged by the plant's cube.
fn solves(keys: &[&str]) -> Summary {
    solves_in("solve.toml", keys)
}

fn solves_in(scenario: &str, keys: &[&str]) -> Summary {
    let summary = run(scenario, keys);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(summary.identified, summary.cube_start);
    assert_eq!(summary.cube_end.as_deref(), Some(SOLVED));
    assert_ne!(summary.cube_start, summary.cube_end);
    assert_eq!((summary.jams, summary.drops), (Some(0), Some(0)));
    let peak = summary.peak_force_n.unwrap();
    assert!(peak > 1.0 && peak < 20.0, "{peak}");
    assert!(summary.turns as usize == summary.executed.split_whitespace().count());
    assert!(summary.grasps < summary.turns && summary.sim_time_s < 900.0);
    summary
}

#[test]
fn the_mission_solves_the_cube_under_sporadic_coordination() {
    let summary = solves(&["seed=2"]);
    let solving = summary.phases.iter().find(|phase| phase.name == "solve").unwrap().sim_time_s;
    let expected = summary.expected_s.unwrap();
    assert!((expected / solving - 1.0).abs() < 0.04, "{expected} s expected, {solving} s needed");
    assert!(summary.sim_time_s < 220.0 && summary.plant_hash.is_some(), "{}", summary.sim_time_s);
}

#[test]
fn the_mission_solves_the_cube_under_continuous_coordination() {
    solves(&["seed=3", "coordination=continuous"]);
}

/// A spoilt controller does not get there, or not gently, and what it did stands in the summary.
fn is_spoilt(keys: &[&str]) -> Summary {
    let summary = run("face_turn.toml", keys);
    assert_ne!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_ne!(summary.exit_code(), 0);
    let broken = summary.peak_force_n > Some(20.0)
        || summary.jams > Some(0)
        || summary.slips > Some(0)
        || summary.sensors.iter().any(|s| s.force_n > Some(20.0) || s.torque_nm > Some(4.5));
    assert!(broken, "nothing in the plant shows the cause: {}", summary.table());
    summary
}

#[test]
fn position_control_does_not_turn_a_face_gently() {
    let summary = is_spoilt(&["control.compliance=none"]);
    let told = summary.reason.contains("over-force") || summary.reason.contains("jam");
    assert!(told, "{}", summary.reason);
}

#[test]
fn a_force_of_the_wrong_sign_runs_away() {
    let summary = is_spoilt(&["control.force_sign=-1"]);
    assert!(summary.reason.contains("over-force"), "{}", summary.reason);
}

#[test]
fn late_forces_swing_up() {
    let summary = is_spoilt(&["control.force_delay_periods=60"]);
    assert!(summary.reason.contains("oscillation"), "{}", summary.reason);
}

#[test]
fn a_weak_grip_slips() {
    let summary = run("face_turn.toml", &["control.grip_n=5", "control.profile=workshop"]);

    assert_eq!(summary.outcome, Outcome::Failed);
    assert!(summary.reason.starts_with("slip"), "{}", summary.reason);
    // The plant's layer has not followed, and the jaws have felt it before much else could happen.
    assert!(summary.turned_deg.unwrap().abs() < 3.0, "{:?}", summary.turned_deg);
    assert!(summary.slips > Some(0), "{:?}", summary.slips);
    assert!(summary.peak_force_n.unwrap() < 20.0);
}

#[test]
fn compliance_without_gain_is_none() {
    let none = ["control.linear_admittance_mm_sn=0", "control.angular_admittance_rad_snm=0"];
    let summary = is_spoilt(&none);
    assert!(summary.reason.contains("over-force"), "{}", summary.reason);
}

#[test]
fn a_half_turn_goes_where_the_wrist_has_room() {
    for angle in ["face_turn.angle_deg=180", "face_turn.angle_deg=-180"] {
        let summary = run("face_turn.toml", &[angle]);
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        assert_eq!(summary.executed, "U2");
    }
}

#[test]
fn a_cube_in_the_dark_or_in_glare_is_found_by_exposing_for_it() {
    for level in ["plant.light.level=0.25", "plant.light.level=3.5"] {
        let summary = run("acquire.toml", &[level]);
        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    }
}

#[test]
fn arms_that_only_hold_need_no_task_and_no_sensors() {
    let summary = run("idle.toml", &["idle.time_s=0.5"]);
    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!((summary.task.as_str(), summary.turns), ("idle", 0));
}

#[test]
fn one_seed_gives_one_hash_and_another_seed_another() {
    let [a, b, c] = ["seed=3", "seed=3", "seed=4"].map(|seed| run("face_turn.toml", &[seed]));

    assert_eq!(a.hash, b.hash);
    assert_eq!(a.cube_end, b.cube_end);
    assert_ne!(a.hash, c.hash);
    assert_ne!(a.cube_start, c.cube_start);
}

#[test]
fn the_cube_is_taken_from_the_hand_and_given_back() {
    let summary = run("acquire.toml", &["plant.hand.withdrawals=0"]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(summary.drops, Some(0));
    assert_eq!(summary.cube_start, summary.cube_end);
}

/// This hand is so near that the elbow meets its limit before the cube is drawn back all the way.
#[test]
fn a_cube_from_a_hand_nearby_is_drawn_back_as_far_as_the_arm_folds() {
    let summary = run("solve.toml", &["task=acquire", "seed=10145"]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!((summary.drops, summary.slips, summary.collisions), (Some(0), Some(0), Some(0)));
}

/// These hands lead the arm to a motor's limit on their way, and turn the cube past 45 deg there.
#[test]
fn an_arm_that_meets_a_limit_while_it_follows_the_hand_goes_on_when_the_cube_comes_back() {
    // Under the one it is the ECP that goes on, under the other MP.
    for (seed, coordination) in [
        ("seed=20027", "coordination=sporadic"),
        ("seed=20078", "coordination=sporadic"),
        ("seed=20027", "coordination=continuous"),
    ] {
        let summary = run("solve.toml", &["task=acquire", seed, coordination]);

        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        assert_eq!((summary.drops, summary.slips, summary.collisions), (Some(0), Some(0), Some(0)));
    }
}

/// This hand takes the cube back so near that the arm cannot draw back all the way without it.
#[test]
fn an_arm_leaves_a_hand_nearby_as_far_as_it_folds() {
    let summary = run("solve.toml", &["task=acquire", "seed=20500"]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!((summary.drops, summary.slips, summary.collisions), (Some(0), Some(0), Some(0)));
}

/// Somewhere in its place, on any face, turned as it may be.
#[test]
fn a_cube_that_lies_on_the_table_is_taken_and_laid_down_again() {
    for seed in 1..=4 {
        let seed = format!("seed={seed}");
        let summary = run("table.toml", &["task=acquire", "plant.table.spread=1", &seed]);

        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        assert_eq!(summary.reason, "the cube is as wanted and on the table");
        assert_eq!((summary.drops, summary.slips, summary.collisions), (Some(0), Some(0), Some(0)));
        assert_eq!(summary.cube_start, summary.cube_end);
        let felt = summary.sensors[0].force_n.unwrap();
        assert!(felt > 1.0 && felt < 20.0, "{felt}");
    }
}

/// Palms that press need holds over two layers, whose stops must stand right before the hand is near; and one over two
/// layers cannot be laid down.
#[test]
fn hands_reach_over_two_layers_where_the_rule_wants_it() {
    let turned = "UUFUUFUUFRRRRRRRRRFFDFFDFFDDDBDDBDDBLLLLLLLLLUBBUBBUBB";
    for (scenario, rule) in
        [("solve.toml", "strict"), ("solve.toml", "original"), ("table.toml", "strict")]
    {
        let (rule, cube) = (format!("planner.rule={rule}"), format!("cube.state={turned}"));
        let summary = run(scenario, &[&rule, &cube]);

        assert_eq!(summary.outcome, Outcome::Solved, "{rule}: {}", summary.reason);
        assert_eq!(summary.cube_end.as_deref(), Some(SOLVED));
        let mishaps = (summary.jams, summary.slips, summary.drops, summary.collisions);
        assert_eq!(mishaps, (Some(0), Some(0), Some(0), Some(0)));
        assert!(summary.peak_force_n.unwrap() < 20.0);
    }
}

/// Folded as it begins, the arm takes the cube wherever it may lie, and draws back with it, without another branch.
#[test]
fn the_place_on_the_table_is_within_reach() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/table.toml");
    let cell = scenario::load(&path, &[]).unwrap().controller.cell;
    let (arm, half) = (&cell.arms[0], cell.hand.half_extent);
    let (z, jaws) = cell.taking();
    let reaches = |x: f64, y: f64, yaw: f64, above: f64| {
        let jaws = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * jaws;
        let cube = cell.hand.world_from_cube * Point3::new(x, y, above + cell.cube.edge / 3.0);
        let tool = pose_from_axes(jaws.cross(&z), jaws, z, cube);
        let flange = arm.world_from_base.inverse() * tool * arm.flange_from_tool.inverse();
        arm.model.inverse(&flange, &arm.start).is_ok_and(|q| arm.model.check(&q).is_ok())
    };

    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0), (0.0, 0.0)] {
        for yaw in [-0.8, 0.0, 0.8] {
            for above in [0.0, 0.15] {
                assert!(reaches(x * half.x, y * half.y, yaw, above), "{x} {y} {yaw} {above}");
            }
        }
    }
    assert!(!reaches(0.25, 0.0, 0.0, 0.0), "the end of its reach");
}

#[test]
fn a_cube_on_the_table_is_solved_without_a_person() {
    solves_in("table.toml", &["seed=5"]);
}

#[test]
fn a_cube_that_lies_beside_its_place_is_not_reached_for() {
    let keys = ["plant.table.offset_xy_mm=[150,0]", "visual_servo.patience_s=3", "task=acquire"];

    let summary = run("table.toml", &keys);

    assert_eq!((summary.outcome, summary.ended_by), (Outcome::Failed, EndedBy::Task));
    assert!(summary.reason.contains("not on the part of the table"), "{}", summary.reason);
    assert_eq!(summary.collisions, Some(0));
}

/// When the operator lets go is felt, not timed.
#[test]
fn a_hand_that_holds_on_is_waited_for_and_not_pulled_at() {
    for seconds in ["0.5", "6"] {
        let time = format!("plant.hand.release_time_s={seconds}");
        let keys = ["plant.hand.withdrawals=0", "plant.hand.release_n=100", &time];
        let summary = run("acquire.toml", &keys);

        assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
        let felt = summary.sensors[0].force_n.unwrap();
        assert!(felt < 12.0, "{felt} N at the operator's hand");
    }
}

#[test]
fn with_caps_on_the_lenses_nothing_is_seen_and_that_is_the_reason() {
    for coordination in ["sporadic", "continuous"] {
        let coordination = format!("coordination={coordination}");
        let keys = ["plant.lens_cap=true", "visual_servo.patience_s=3", &coordination];

        for scenario in ["acquire.toml", "solve.toml"] {
            let summary = run(scenario, &keys);

            assert_eq!(summary.outcome, Outcome::Failed);
            assert_eq!(summary.ended_by, EndedBy::Task);
            assert!(summary.reason.contains("no cube in sight"), "{}", summary.reason);
            assert_eq!(summary.identified, None);
        }
    }
}

#[test]
fn an_interrupt_ends_a_run_with_130_and_a_whole_summary() {
    let mut child = program()
        .args(["run", "scenarios/acquire.toml", "--json", "--set", "plant.lens_cap=true"])
        .args(["--set", "visual_servo.patience_s=3600"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // It moves as soon as it tells its first phase.
    let mut told = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut told).unwrap();

    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();

    assert_eq!(child.wait().unwrap().code(), Some(130), "{told}{printed}");
    let summary: Summary = serde_json::from_str(printed.lines().last().unwrap()).unwrap();
    assert_eq!((summary.outcome, summary.ended_by), (Outcome::Aborted, EndedBy::Interrupt));
}

/// A hand-over; `words` are said on stdin while it acquires. The exit code and what was printed.
fn commanded(words: impl FnOnce(&mut dyn FnMut(&str))) -> (Option<i32>, String) {
    let mut child = program()
        .args(["run", "scenarios/acquire.toml"])
        .args(["--set", "plant.hand.withdrawals=0"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut keys = child.stdin.take().unwrap();
    let mut say = |word: &str| writeln!(keys, "{word}").unwrap();
    let mut told = BufReader::new(child.stderr.take().unwrap()).lines();
    assert!(told.any(|line| line.unwrap().contains("acquire")), "it does not start");
    words(&mut say);
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    (child.wait().unwrap().code(), printed)
}

#[test]
fn a_paused_hand_over_is_resumed_and_done() {
    let before = std::time::Instant::now();
    let pause = std::time::Duration::from_millis(700);

    let (code, printed) = commanded(|say| {
        say("p");
        std::thread::sleep(pause);
        say("r");
    });

    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("DONE"), "{printed}");
    assert!(before.elapsed() > pause);
}

/// Nothing that was not seen is called done.
#[test]
fn a_cube_that_nobody_can_inspect_is_looked_at_again_and_else_goes_back_with_the_reason() {
    let summary = run("faults/solve_blind.toml", &[]);

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    assert_eq!(summary.recoveries, 0);
    let inspections = summary.phases.iter().filter(|phase| phase.name == "inspect").count();
    assert_eq!(inspections, 2);

    let for_good = ["fault.track.duration_s=5000", "fault.postument.duration_s=5000"];
    let summary = run("faults/solve_blind.toml", &for_good);
    assert_eq!((summary.outcome, summary.exit_code()), (Outcome::Failed, 1));
    let why = &summary.reason;
    assert!(why.contains("could not be inspected: the picture is black"), "{why}");
    assert!(why.contains("handed back as it is"), "{why}");
    assert_eq!(summary.returned, Some(true), "the plant's word");
}

#[test]
fn an_end_of_input_leaves_no_trace() {
    let hash = |more: &[&str]| {
        let out = program()
            .args(["run", "scenarios/idle.toml", "--set", "idle.time_s=0.5"])
            .args(more)
            .output()
            .unwrap();
        let printed = String::from_utf8(out.stdout).unwrap();
        let at = printed.find("hash").unwrap();
        let hash: String =
            printed[at + 4..].chars().skip_while(|c| !c.is_ascii_alphanumeric()).take(16).collect();
        assert!(hash.chars().all(|c| c.is_ascii_hexdigit()), "{printed}");
        hash
    };

    assert_eq!(hash(&["--ui", "none"]), hash(&["--json"]));
}

#[test]
fn an_operator_who_terminates_gets_an_aborted_summary_at_once() {
    // In a pause nothing else could end it.
    let (code, printed) = commanded(|say| {
        say("p");
        say("t");
    });

    assert_eq!(code, Some(1), "{printed}");
    assert!(printed.contains("ABORTED"), "{printed}");
    assert!(printed.contains("terminated by the operator"), "{printed}");
}

#[test]
fn the_scenario_of_2007_reads_the_cube_and_ends_with_a_cause() {
    let summary = run("paper2007.toml", &[]);

    assert_eq!(summary.ended_by, EndedBy::Task, "{}", summary.reason);
    assert_eq!(summary.identified, summary.cube_start);
    assert!(summary.solution.is_some_and(|s| !s.is_empty()));
    let causes = ["over-force", "oscillat", "jam", "slip", "stall", "over-turn"];
    let told = causes.iter().any(|cause| summary.reason.contains(cause))
        // By the choices of 2007 nobody may take the cube back: then it is the solved one.
        || summary.reason.contains("not taken back") && summary.cube_end.as_deref() == Some(SOLVED);
    assert!(summary.outcome == Outcome::Solved || told, "{}", summary.reason);
}

#[test]
fn a_run_that_cannot_start_still_prints_a_whole_summary() {
    let out = program()
        .args(["run", "scenarios/face_turn.toml", "--json"])
        // Bases so far apart that the hands cannot meet.
        .args(["--set", "effector.postument.base_xyz_mm=[0,9000,0]"])
        .output()
        .unwrap();

    assert_eq!(out.status.code(), Some(4));
    let printed = String::from_utf8(out.stdout).unwrap();
    let summary: Summary = serde_json::from_str(printed.lines().last().unwrap()).unwrap();
    assert_eq!(summary.outcome, Outcome::Aborted);
    assert!(summary.reason.contains("both hands can hold"), "{}", summary.reason);
    assert_eq!((summary.peak_force_n, summary.peak_torque_nm), (Some(0.0), Some(0.0)));
    assert_eq!(summary.cube_start.unwrap().len(), 54);
}
