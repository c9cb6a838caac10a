//! The door of the task `follow_joints`, and its sensor with the topic behind it.

use super::commands::{ArmJoints, Command, Limits, targets};
use super::keys::{Keys, SensorKeys};
use super::{Order, SENSOR, follow_joints};
use crate::generators::follow::Targets;
use crate::kernel::robot::RobotKernel;
use crate::motion::ArmState;
use crate::registry::{Device, Sensor, Setup, Task};
use crate::ros::Listener;
use crate::ros::messages::{JOINTS, JointState, joint_state};
use crate::scenario::declared::Properties;
use crate::scenario::keys::Coordination;
use crate::scenario::section::Reader;
use crate::scenario::{ControllerConfig, Owner};

/// Task `follow_joints`: the arms follow joint commands of another program.
#[derive(Debug)]
pub struct FollowJoints;

impl Task for FollowJoints {
    type Keys = Keys;
    type Kernel = RobotKernel;
    // Under continuous coordination MP makes the set values, and has no sensor of an arm.
    const PROPERTIES: Properties =
        Properties { coordination: &[Coordination::Sporadic], ..Properties::PLAIN };

    fn check(_: &mut Keys, config: &ControllerConfig, reader: &mut Reader) {
        if sensors(config).iter().all(Option::is_none) {
            let reason = format!(
                "`vsp`: the task follow_joints needs a [[vsp]] with kind = \"{SENSOR}\" whose \
                 owner is an effector"
            );
            reader.fault("vsp", reason);
        }
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let Keys { speed, seconds } = *setup.keys;
        let seconds = (seconds > 0.0).then_some(seconds);
        Ok(follow_joints(Order { sensors: sensors(setup.config), speed, seconds }))
    }
}

/// Returns the name of the sensor of each arm; `None` for an arm without one.
fn sensors(config: &ControllerConfig) -> Vec<Option<String>> {
    let of_arm = |arm: usize| {
        let mut vsps = config.vsps.iter().filter(|vsp| vsp.owner == Owner::Ecp(arm));
        let is_ours = |name: &'static str| name == SENSOR;
        vsps.find(|vsp| vsp.own.as_ref().is_some_and(|own| is_ours(own.declaration().name())))
            .map(|vsp| vsp.name.clone())
    };
    (0..config.cell.arms.len()).map(of_arm).collect()
}

/// Sensor `joint_commands`: it makes targets of the arms of a message.
#[derive(Debug)]
pub struct JointCommands {
    limits: Limits,
    arms: Vec<ArmJoints>,
}

/// Message with its age.
#[derive(Debug, Clone)]
pub struct Measured(Result<Command, String>);

impl Sensor for JointCommands {
    type Keys = SensorKeys;
    type Measurement = Measured;
    type Reading = Targets;

    fn new(_: &SensorKeys) -> Result<Self, String> {
        Err("the sensor joint_commands needs a cell".to_owned())
    }

    fn in_cell(keys: &SensorKeys, config: &ControllerConfig) -> Result<Self, String> {
        let arms = config.cell.arms.iter().map(|arm| ArmJoints {
            name: arm.name.clone(),
            has_track: arm.model.has_track,
            limits: arm.model.joint_limits,
        });
        let SensorKeys { stale, jump, track_jump, .. } = *keys;
        Ok(Self { limits: Limits { stale, jump, track_jump }, arms: arms.collect() })
    }

    fn device(_: &SensorKeys) -> Result<Box<dyn Device<Measured>>, String> {
        Err("the sensor joint_commands needs the router of a scenario".to_owned())
    }

    fn device_in_cell(
        keys: &SensorKeys,
        config: &ControllerConfig,
    ) -> Result<Box<dyn Device<Measured>>, String> {
        let listener = Listener::open(&config.ros.place(), &keys.topic, JOINTS)?;
        Ok(Box::new(Topic { listener, decoded: (0, Err(String::new())) }))
    }

    fn reading(&mut self, measured: Measured, arms: &[ArmState]) -> Result<Targets, String> {
        targets(&measured.0?, &self.limits, &self.arms, arms)
    }
}

/// Topic of joint commands.
struct Topic {
    listener: Listener,
    /// Number of the message that was decoded last, and what it has.
    decoded: (u64, Result<JointState, String>),
}

impl Device<Measured> for Topic {
    fn measure(&mut self, _: u64) -> Result<Measured, String> {
        let silent = Measured(Ok(Command { positions: Vec::new(), age: f64::INFINITY }));
        let Some(arrived) = self.listener.latest() else { return Ok(silent) };
        if self.decoded.0 != arrived.number {
            let state = arrived.data.and_then(|data| joint_state(&arrived.kind, &data));
            self.decoded = (arrived.number, state);
        }
        let age = arrived.at.elapsed().as_secs_f64();
        let topic = |why: &String| format!("topic {}: {why}", self.listener.topic());
        let state = self.decoded.1.as_ref().map_err(topic);
        Ok(Measured(state.map(|state| Command { positions: state.positions.clone(), age })))
    }
}
