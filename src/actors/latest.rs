//! The latest values of every actor and arm, for the UI. A writer replaces the value before and
//! never waits for a reader. The real-time thread of a servo does not write here: its records come
//! by a ring. The thread of a simulated plant gives up a write if a reader holds the lock.

use crate::cell::Cell;
use crate::generators::Behaviour;
use crate::hw::driver::{RecordSink, ServoRecord, Switches};
use crate::kernel::Picture;
use crate::motion::ArmState;
use crate::operator::Question;
use crate::operator::parameter::Courses;
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle on the latest values.
#[derive(Debug, Clone, Default)]
pub struct LatestValues(Arc<Mutex<Latest>>);

/// Latest values of all actors and arms.
#[derive(Debug, Default)]
pub struct Latest {
    /// Latest state of every effector, with its peaks since the last snapshot.
    pub arms: Vec<ArmLatest>,
    /// Activity of MP, in words.
    pub mp: &'static str,
    /// Behaviour of each effector in words; `None` without an order.
    pub orders: Vec<Option<&'static str>>,
    /// The kernel's belief.
    pub picture: Option<Picture>,
    /// Latest reading of each sensor of a user's own, by the name of its VSP.
    pub sensors: BTreeMap<String, Value>,
    /// Pose of each loose object in the world, by name, as the simulated plant has it.
    pub objects: BTreeMap<String, Pose>,
    /// The open question.
    pub question: Option<Question>,
    /// Whether this is a replay; a recording does not hold the orders of the effectors.
    pub replayed: bool,
    /// Courses of the operator's parameters; `None` before the first order.
    pub courses: Option<Courses>,
    /// Whether the operator may move arms by hand now.
    pub manual: bool,
    /// Latest picture of each camera's VSP.
    pub sights: Vec<Option<Sight>>,
    /// Cell as a calibration found it, until the UI has taken it.
    pub calibrated: Option<Box<Cell>>,
    /// Punctuality of the servo of a real-time run, and the length of its period (s).
    pub punctual: Option<(Arc<Switches>, f64)>,
}

/// Latest values of an effector.
#[derive(Debug, Clone, Copy, Default)]
pub struct ArmLatest {
    /// Latest state.
    pub state: ArmState,
    /// Peaks since the last snapshot.
    pub peaks: Peaks,
}

/// The largest values of an effector over some periods.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Peaks {
    /// Norm of the force at the tool (N).
    pub force: f64,
    /// Norm of the torque at the tool (Nm).
    pub torque: f64,
    /// Distance of the tool from its set position (m).
    pub following: f64,
}

impl Peaks {
    /// Raises each peak to the value in the state of one more period, if that is larger.
    pub fn take(&mut self, state: &ArmState) {
        // `f64::max` ignores NaN, so a silent force sensor leaves the peaks as they are.
        let (set, is) = (&state.desired_base_from_tool, &state.base_from_tool);
        self.merge(&Self {
            force: state.wrench_in_tool.force.norm(),
            torque: state.wrench_in_tool.torque.norm(),
            following: (set.translation.vector - is.translation.vector).norm(),
        });
    }

    /// Raises each peak to that of `other`, the peaks over other periods, if that is larger.
    pub fn merge(&mut self, other: &Self) {
        self.force = self.force.max(other.force);
        self.torque = self.torque.max(other.torque);
        self.following = self.following.max(other.following);
    }
}

/// A picture of a camera's VSP with the result of vision.
#[derive(Debug, Clone)]
pub struct Sight {
    /// Servo period of the exposure.
    pub period: u64,
    /// Pixels, until the UI has taken them.
    pub image: Option<RgbImage>,
    /// Result of vision.
    pub found: Found,
}

/// Result of vision in one picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Found {
    /// The cube: `world_from_cube`, speed of its centre (m/s).
    Cube(Pose, f64),
    /// A face.
    Face(Box<FaceReading>),
    /// No cube and no face, with the reason.
    Nothing(String),
}

impl LatestValues {
    /// Locks the values for reading or writing; hold the lock for moments only.
    pub fn lock(&self) -> MutexGuard<'_, Latest> {
        // A writer that panicked leaves values that are still good enough to be shown.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces the poses of the loose objects. The servo's thread calls this, so it skips them
    /// while another thread holds the lock.
    pub(crate) fn placed(&self, objects: impl Iterator<Item = (String, Pose)>) {
        if let Ok(mut latest) = self.0.try_lock() {
            latest.objects.extend(objects);
        }
    }

    /// Raises the peaks of the arm with the index `arm` to those in `peaks`, where these are
    /// larger. A replay shows only some of the recorded states, and `peaks` cover all of them. Does
    /// nothing for an arm without a state.
    pub fn peaked(&self, arm: usize, peaks: &Peaks) {
        // An arm is not shown before its first state, and its peaks are not either.
        if let Some(arm) = self.lock().arms.get_mut(arm) {
            arm.peaks.merge(peaks);
        }
    }

    /// Replaces the latest picture of a camera, with the result of vision in it.
    pub fn saw(&self, camera: usize, sight: Sight) {
        let mut latest = self.lock();
        // The number of cameras is unknown here, so the list grows with the first picture of each.
        if latest.sights.len() <= camera {
            latest.sights.resize(camera + 1, None);
        }
        latest.sights[camera] = Some(sight);
    }

    /// Replaces the texts that name the ordered behaviours of the effectors; `None` stands for an
    /// effector without an order.
    pub fn ordered(&self, orders: &[Option<Behaviour>]) {
        self.lock().orders = orders.iter().map(|order| order.as_ref().map(words)).collect();
    }

    /// Replaces the latest state of the arm with this index, and includes it in the arm's peaks.
    pub(super) fn state(&self, index: usize, state: &ArmState) {
        let mut latest = self.lock();
        if latest.arms.len() <= index {
            latest.arms.resize(index + 1, ArmLatest::default());
        }
        let arm = &mut latest.arms[index];
        // A snapshot shows a single state: the peaks cover those since the snapshot before.
        arm.peaks.take(state);
        arm.state = *state;
    }
}

/// A sink of servo records that copies them to the latest values, if there is a UI, and passes them
/// on.
pub struct Seen<S> {
    /// Sink that gets the records next.
    pub to: S,
    /// Latest values; `None` without a UI.
    pub latest: Option<LatestValues>,
}

impl<S: RecordSink> RecordSink for Seen<S> {
    /// Copies a record to the latest values, if there is a UI, and passes it on.
    fn record(&mut self, record: &ServoRecord) {
        if let Some(latest) = &self.latest {
            latest.state(usize::from(record.arm), &record.state);
        }
        self.to.record(record);
    }
}

/// Returns the short text by which the user interfaces show a behaviour.
fn words(behaviour: &Behaviour) -> &'static str {
    match behaviour {
        Behaviour::Joints { .. } | Behaviour::Legs { .. } => "joint motion",
        Behaviour::Line { .. } => "straight line",
        Behaviour::Jaw { .. } => "moves the jaws",
        Behaviour::Approach { .. } => "approaches",
        Behaviour::Withdraw { .. } => "retracts",
        Behaviour::Grasp { .. } => "grasps",
        Behaviour::Secure { .. } => "seats the cube",
        Behaviour::Turn { .. } => "turns",
        Behaviour::Comply { .. } => "yields",
        Behaviour::Present { .. } => "holds out",
        Behaviour::VisualServo(_) => "visual servo",
        Behaviour::Own(_) => "registered motion",
    }
}
