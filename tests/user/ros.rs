//! The task `follow_joints`, with the commands of a script in place of a topic of ROS 2, under
//! virtual time. `tests/ros` has the topics.

use crate::program::program;
use rubik_robot::generators::follow::Targets;
use rubik_robot::motion::{ArmState, JointPositions};
use rubik_robot::record::summary::Outcome;
use rubik_robot::registry::{Device, NoDevice, Sensor};
use rubik_robot::run::{RunContext, RunOptions, run_with};
use rubik_robot::scenario::{self, Override};
use rubik_robot::tasks;
use rubik_robot::tasks::follow_joints::SensorKeys;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Sensor that leads the postument to the side, holds it, and leads it into the table. No command
/// is refused by it.
struct Script(Option<JointPositions>);

impl Sensor for Script {
    type Keys = SensorKeys;
    type Measurement = ();
    type Reading = Targets;

    fn new(_: &SensorKeys) -> Result<Self, String> {
        Ok(Self(None))
    }

    fn device(_: &SensorKeys) -> Result<Box<dyn Device<()>>, String> {
        Ok(Box::new(NoDevice))
    }

    fn reading(&mut self, (): (), arms: &[ArmState]) -> Result<Targets, String> {
        let arm = &arms[1];
        let home = *self.0.get_or_insert(arm.desired_joints);
        let seconds = arm.period as f64 * 0.002;
        let mut target = home;
        target.0[1] += 0.3;
        // Joint 2 leans the arm forward and down.
        target.0[2] += 0.08 * (seconds - 6.0).max(0.0);
        target.0[3] += 0.06 * (seconds - 6.0).max(0.0);
        match seconds {
            4.0..6.0 => Err("no command".to_owned()),
            1.0..20.0 => Ok(Targets { arms: vec![None, Some(target)] }),
            _ => Ok(Targets { arms: vec![None, None] }),
        }
    }
}

/// Returns the path of the scenario.
fn path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/ros_arms.toml")
}

/// The arm follows, holds where the commands end, and stops above the table without an accident.
/// The other arm stays.
#[test]
fn arm_follows_commands_and_stops_before_table() {
    let registry = tasks::built_in().sensor::<Script>(tasks::follow_joints::SENSOR);
    let overrides = [Override::parse("follow_joints.seconds_s=24").unwrap()];
    let scenario = scenario::load(&path(), &overrides, &registry.catalogue()).unwrap();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let truth = Arc::clone(&seen);
    let context = RunContext {
        probe: Some(Box::new(move |_, plant| {
            let scene = plant.scene();
            let at = [0, 1].map(|arm| scene.arms[arm].world_from_tool.translation.vector);
            truth.lock().unwrap().push(at);
        })),
        ..RunContext::default()
    };
    let options = RunOptions { automatic: true, quiet: true, ..RunOptions::default() };

    let summary = run_with(&scenario, options, context).unwrap();

    assert_eq!(summary.outcome, Outcome::Solved, "{}", summary.reason);
    let accidents = summary.accidents.map(|all| all.len());
    assert_eq!((summary.collisions, accidents), (Some(0), Some(0)));
    let hindered = summary.figures["hindered"][1].as_f64().unwrap();
    assert!(hindered >= 1.0, "{:?}", summary.figures);
    let seen = seen.lock().unwrap();
    let at = |seconds: f64, arm: usize| seen[(seconds / 0.002) as usize][arm];
    let moved = |from: f64, to: f64, arm: usize| (at(to, arm) - at(from, arm)).norm();
    assert!(moved(0.5, 4.0, 1) > 0.1, "it does not follow: {} m", moved(0.5, 4.0, 1));
    assert!(moved(4.5, 6.0, 1) < 0.002, "it does not hold: {} m", moved(4.5, 6.0, 1));
    assert!(moved(6.0, 20.0, 1) > 0.05, "it does not follow on: {} m", moved(6.0, 20.0, 1));
    assert!(moved(0.5, 23.0, 0) < 0.003, "the other arm moves: {} m", moved(0.5, 23.0, 0));
}

#[test]
fn follow_joints_needs_a_sensor_of_an_arm() {
    let refused = |sets: &[&str]| {
        let sets: Vec<_> = sets.iter().map(|set| Override::parse(set).unwrap()).collect();
        tasks::load(&path(), &sets).unwrap_err().to_string()
    };

    let nobody = refused(&["vsp.track_commands.owner=mp", "vsp.postument_commands.owner=mp"]);
    assert!(nobody.contains("needs a [[vsp]] with kind = \"joint_commands\""), "{nobody}");
    let camera = refused(&["camera.standalone.source=ros", "camera.standalone.topic=image"]);
    assert!(camera.contains("`camera.standalone.topic`: \"image\" is no full name"), "{camera}");
    let continuous = refused(&["coordination=continuous"]);
    assert!(continuous.contains("coordination"), "{continuous}");
}

/// Without a router, or in a build without the network, the run is refused with the topic's name.
#[test]
fn topic_without_router_refuses_run() {
    for (set, reason) in [
        ("ros.router=tcp/127.0.0.1:1", "topic /joint_commands over tcp/127.0.0.1:1: "),
        (
            "joint_commands.topic=/a/*",
            "track_commands could not be created: \"/a/*\" is no full name",
        ),
    ] {
        let args = ["--json", "--ui", "none", "--set", set];
        let out = program().arg("run").arg(path()).args(args).output().unwrap();

        let told = String::from_utf8_lossy(&out.stderr);
        assert_ne!(out.status.code(), Some(0), "{set}");
        assert!(told.contains(reason), "{told}");
    }
}
