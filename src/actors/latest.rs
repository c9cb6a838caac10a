//! The latest values of every actor and arm, for the UI. A writer replaces the value before and never
//! waits for a reader; the real-time thread does not write here, its records come by the ring.

use crate::cell::Cell;
use crate::generators::Behaviour;
use crate::hw::driver::{RecordSink, ServoRecord, Switches};
use crate::motion::ArmState;
use crate::operator::Question;
use crate::spatial::Pose;
use crate::tasks::Picture;
use crate::vision::sensor::FaceReading;
use image::RgbImage;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle on the latest values.
#[derive(Debug, Clone, Default)]
pub struct LatestValues(Arc<Mutex<Latest>>);

/// The values.
#[derive(Debug, Default)]
pub struct Latest {
    /// Every effector's latest state, and what it came to between two looks.
    pub arms: Vec<ArmLatest>,
    /// What MP is doing.
    pub mp: &'static str,
    /// What each effector was ordered.
    pub orders: [Option<&'static str>; 2],
    /// The kernel's belief.
    pub picture: Option<Picture>,
    /// The open question.
    pub question: Option<Question>,
    /// It is a replay: nobody knows what the effectors were ordered.
    pub replayed: bool,
    /// Arms may be moved by hand now.
    pub manual: bool,
    /// What each camera's VSP saw last.
    pub sights: Vec<Option<Sight>>,
    /// The cell as a calibration found it, until the UI has taken it.
    pub calibrated: Option<Box<Cell>>,
    /// How punctual the servo of a real-time run is, and the length of its period (s).
    pub punctual: Option<(Arc<Switches>, f64)>,
}

/// An effector.
#[derive(Debug, Clone, Copy, Default)]
pub struct ArmLatest {
    /// Its state.
    pub state: ArmState,
    /// What it came to since the last look.
    pub peaks: Peaks,
}

/// The largest values of an effector over some periods.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Peaks {
    /// Norm of the force at the tool (N).
    pub force: f64,
    /// Norm of the torque at the tool (Nm).
    pub torque: f64,
    /// Distance of the tool from its set place (m).
    pub following: f64,
}

impl Peaks {
    /// Takes a period in.
    pub fn take(&mut self, state: &ArmState) {
        let (set, is) = (&state.desired_base_from_tool, &state.base_from_tool);
        self.merge(&Self {
            force: state.wrench_in_tool.force.norm(),
            torque: state.wrench_in_tool.torque.norm(),
            following: (set.translation.vector - is.translation.vector).norm(),
        });
    }

    /// Takes other periods' in.
    pub fn merge(&mut self, other: &Self) {
        self.force = self.force.max(other.force);
        self.torque = self.torque.max(other.torque);
        self.following = self.following.max(other.following);
    }
}

/// What a camera's VSP saw.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Servo period of the exposure.
    pub period: u64,
    /// The pixels, until the UI has taken them.
    pub image: Option<RgbImage>,
    /// What was found, or why nothing was.
    pub found: Found,
}

/// What vision found.
#[derive(Debug, Clone)]
pub enum Found {
    /// The cube: `world_from_cube`, speed of its centre (m/s).
    Cube(Pose, f64),
    /// A face.
    Face(Box<FaceReading>),
    /// Nothing, and why.
    Nothing(String),
}

impl LatestValues {
    /// Locks the values for reading or writing; hold the lock for moments only.
    pub fn lock(&self) -> MutexGuard<'_, Latest> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What an effector came to beside the states that are shown.
    pub fn peaked(&self, arm: usize, peaks: &Peaks) {
        if let Some(arm) = self.lock().arms.get_mut(arm) {
            arm.peaks.merge(peaks);
        }
    }

    /// A camera's VSP has looked.
    pub fn saw(&self, camera: usize, sight: Sight) {
        let mut latest = self.lock();
        if latest.sights.len() <= camera {
            latest.sights.resize(camera + 1, None);
        }
        latest.sights[camera] = Some(sight);
    }

    /// What the effectors were ordered.
    pub fn ordered(&self, orders: &[Option<Behaviour>; 2]) {
        self.lock().orders = [0, 1].map(|i| orders[i].as_ref().map(words));
    }

    fn arm(&self, record: &ServoRecord) {
        let (index, state) = (usize::from(record.arm), &record.state);
        let mut latest = self.lock();
        if latest.arms.len() <= index {
            latest.arms.resize(index + 1, ArmLatest::default());
        }
        let arm = &mut latest.arms[index];
        arm.peaks.take(state);
        arm.state = *state;
    }
}

/// A sink of servo records that copies them to the latest values, if there is a UI, and passes them
/// on.
pub struct Seen<S> {
    /// Where they go.
    pub to: S,
    /// Who looks.
    pub latest: Option<LatestValues>,
}

impl<S: RecordSink> RecordSink for Seen<S> {
    fn record(&mut self, record: &ServoRecord) {
        if let Some(latest) = &self.latest {
            latest.arm(record);
        }
        self.to.record(record);
    }
}

fn words(behaviour: &Behaviour) -> &'static str {
    match behaviour {
        Behaviour::Joints { .. } | Behaviour::Legs { .. } => "joint motion",
        Behaviour::Line { .. } => "straight line",
        Behaviour::Jaw { .. } => "moves the jaws",
        Behaviour::Approach { .. } => "approaches",
        Behaviour::Withdraw { .. } => "draws back",
        Behaviour::Grasp { .. } => "grasps",
        Behaviour::Secure { .. } => "seats the cube",
        Behaviour::Turn { .. } => "turns",
        Behaviour::Comply { .. } => "yields",
        Behaviour::Present { .. } => "holds out",
        Behaviour::VisualServo(_) => "visual servo",
    }
}
