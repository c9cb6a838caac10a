//! The filter that estimates the postument's base and the place of the cube in each hand.
//!
//! - in: arm states; contacts (closed pads, palm stops); faces seen by the cameras in the hands
//! - out: poses of the cube in the hands, of the cube's faces in a camera, of the next grasp
//! - method: an iterated extended Kalman filter over ten numbers: the error of the postument's base
//!   (translation and rotation about the place where the arms were calibrated), and for each hand
//!   the offset of the cube along the finger's width and its tilt about the jaw axis. The rest of a
//!   hold is known: the pads centre the cube across the jaws and align it with them, and the palm's
//!   stops fix its depth. Jacobians are differences: ten columns, some microseconds.
//!
//! | standard deviations | constant | what they cover |
//! |---|---|---|
//! | base before any measurement | `BASE` | the calibration of the arms against each other |
//! | cube taken from the operator | `TAKEN` | it is given by hand |
//! | cube in a hand that has just closed | `CLOSED` | wide: the contact that follows decides |
//! | contact of a secured hold | `CONTACT` | sag of the arms, give of the pads |
//! | a face in a camera's picture | `SIGHT` | mostly the error of the camera's own pose |
//! | depth and tilts of a hold that is found | `FOUND` | nobody has seen how its jaws closed |

use super::hold::{Hand, Hold};
use super::settings::ArmBelief;
use crate::cube::{Face, Rotation24};
use crate::motion::ArmState;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// Numbers of the filter: base error x, y, z (m), about x, y, z (rad); then x (m) and tilt (rad) of
/// the cube in the track's hand and in the postument's.
const STATES: usize = 10;
type State = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;
type Residual = SVector<f64, 6>;

/// Standard deviations of the base's error at first: translation (m), rotation (rad).
const BASE: (f64, f64) = (0.0015, 0.009);
/// Standard deviations of the cube in a hand that has just taken it from the operator: along the
/// finger's width (m), tilt (rad).
const TAKEN: (f64, f64) = (0.004, 0.03);
/// Standard deviations of the cube in a hand that has just closed while the partner held (m, rad),
/// before the contact is taken into account.
const CLOSED: (f64, f64) = (0.03, 0.2);
/// Standard deviations of the place of the cube in a closed and secured hold: x, y, z (m), about x,
/// y, z (rad). They include the arms' sag and the give of the pads.
const CONTACT: [f64; 6] = [0.0007, 0.0005, 0.001, 0.008, 0.008, 0.008];
/// Standard deviations of the place of a face that a camera in a hand sees: across, across, along
/// the line of sight (m), about the same axes (rad). Most of it is the error of the camera's own
/// pose.
const SIGHT: [f64; 6] = [0.0013, 0.0013, 0.002, 0.012, 0.012, 0.006];

/// Standard deviations of a hold that a run finds when it begins, beyond the two numbers that the
/// filter estimates: place (m), tilt (rad). In the run with seed 97047 a cube lay 0.7 mm too far
/// out and was tilted by 9 mrad. The filter took this for an error of the base, and was sure of it.
const FOUND: (f64, f64) = (0.001, 0.01);
/// Number of views of one hold, which all have the same error of it.
const VIEWS: f64 = 3.0;

/// A hold of the cube by one hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    /// The hold as planned.
    pub hold: Hold,
    /// Whether the tool frame is the second of the two equivalent ones.
    pub half_roll: bool,
}

/// The estimated poses of arms and cube.
#[derive(Debug, Clone)]
pub struct Belief {
    /// The two arms as calibrated by the workshop.
    arms: [ArmBelief; 2],
    /// Hold of each hand; `None` for a hand that holds nothing.
    pub held: [Option<Held>; 2],
    /// Whether each hand's hold dates from before the run.
    found: [bool; 2],
    /// Edge of the cube (m).
    edge: f64,
    /// Place about which the error of the postument's base rotates, in the world (m).
    pivot: Point3<f64>,
    /// Estimated numbers, see [`STATES`], and their covariance.
    state: State,
    covariance: Covariance,
}

impl Belief {
    /// Makes a filter in which no hand holds anything. `edge` is that of the cube (m), and `pivot`
    /// the place where the arms were calibrated against each other, in the world (m).
    #[must_use]
    pub fn new(arms: [ArmBelief; 2], edge: f64, pivot: Point3<f64>) -> Self {
        let mut covariance = Covariance::zeros();
        for i in 0..3 {
            covariance[(i, i)] = BASE.0.powi(2);
            covariance[(3 + i, 3 + i)] = BASE.1.powi(2);
        }
        Self {
            arms,
            held: [None, None],
            found: [false; 2],
            edge,
            pivot,
            state: State::zeros(),
            covariance,
        }
    }

    /// Returns `world_from_base` as believed now.
    #[must_use]
    pub fn world_from_base(&self, hand: Hand) -> Pose {
        self.base(&self.state, hand)
    }

    /// Returns `world_from_base` of a hand's arm in this state of the filter.
    fn base(&self, state: &State, hand: Hand) -> Pose {
        // The track's base defines the world: only the error between both bases can be observed.
        let measured = self.arms[hand.index()].world_from_base;
        if hand == Hand::Track {
            return measured;
        }
        // The rotation is about the pivot. About the base, a rotation of 0.009 rad would move the
        // hands, a metre away, by 9 mm, and would be strongly correlated with the translation.
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(state[3], state[4], state[5]));
        let shift = Vector3::new(state[0], state[1], state[2]);
        let about = Translation3::from(self.pivot.coords);
        about * Translation3::from(shift) * turn * about.inverse() * measured
    }

    /// Returns `world_from_tool` of a hand at its set pose. Set poses, unlike measured ones, are
    /// free of the servo's lag.
    fn tool(&self, state: &State, hand: Hand, arms: &[ArmState]) -> Pose {
        self.base(state, hand) * arms[hand.index()].desired_base_from_tool
    }

    /// Returns `tool_from_cube` in this state of the filter, if the hand holds the cube.
    fn in_tool(&self, state: &State, hand: Hand) -> Option<Pose> {
        let held = self.held[hand.index()]?;
        let nominal = held.hold.cube_from_tool(held.half_roll, self.edge).inverse();
        let (x, tilt) = (state[6 + 2 * hand.index()], state[7 + 2 * hand.index()]);
        // Only these two are unknown: the pads and the palm's stops fix the other four.
        let tilt = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, tilt, 0.0));
        let place = nominal.translation.vector + Vector3::new(x, 0.0, 0.0);
        Some(Pose::from_parts(place.into(), tilt * nominal.rotation))
    }

    /// Returns `tool_from_cube` as believed now, if the hand holds the cube.
    #[must_use]
    pub fn tool_from_cube(&self, hand: Hand) -> Option<Pose> {
        self.in_tool(&self.state, hand)
    }

    /// Returns `world_from_cube` of the cube in the hand `holder`, in this state of the filter.
    fn cube(&self, state: &State, holder: Hand, arms: &[ArmState]) -> Option<Pose> {
        Some(self.tool(state, holder, arms) * self.in_tool(state, holder)?)
    }

    /// Returns the `base_from_tool` at which `hand` would have the cube in `hold`; the partner
    /// holds the cube now.
    #[must_use]
    pub fn grasp_pose(
        &self,
        hand: Hand,
        hold: Hold,
        half_roll: bool,
        arms: &[ArmState],
    ) -> Option<Pose> {
        let world_from_cube = self.cube(&self.state, hand.other(), arms)?;
        let world_from_tool = world_from_cube * hold.cube_from_tool(half_roll, self.edge);
        Some(self.world_from_base(hand).inverse() * world_from_tool)
    }

    /// Returns the standard deviations of the place, in the tool of `hand`, of the cube that its
    /// partner holds, if `hand` is to grasp that cube in `hold` (m). They follow from the
    /// covariance of the filter.
    #[must_use]
    pub fn doubt(
        &self,
        hand: Hand,
        hold: Hold,
        half_roll: bool,
        arms: &[ArmState],
    ) -> Option<Vector3<f64>> {
        let seat = self.grasp_pose(hand, hold, half_roll, arms)?;
        let seen = |belief: &Self, state: &State| {
            let cube = belief.cube(state, hand.other(), arms)?;
            Some(difference(
                &Pose::identity(),
                &((belief.base(state, hand) * seat).inverse() * cube),
            ))
        };
        let (_, slope) = self.linearised(&seen, &self.state)?;
        let spread = slope * self.covariance * slope.transpose();
        // The first three rows are the derivatives of the cube's place by each state.
        Some(Vector3::from_fn(|i, _| spread[(i, i)].max(0.0).sqrt()))
    }

    /// Returns the centre of the cube that the partner holds, in the tool of `hand` (m).
    #[must_use]
    pub fn centre_in_tool(&self, hand: Hand, arms: &[ArmState]) -> Option<Vector3<f64>> {
        let world_from_cube = self.cube(&self.state, hand.other(), arms)?;
        let world_from_tool = self.tool(&self.state, hand, arms);
        Some((world_from_tool.inverse() * world_from_cube).translation.vector)
    }

    /// Returns `camera_from_face` of a face of the held cube, for the camera of `viewer`.
    #[must_use]
    pub fn face_in_camera(&self, viewer: Hand, face: Face, arms: &[ArmState]) -> Option<Pose> {
        self.face_at(&self.state, viewer, face, arms)
    }

    /// Returns `camera_from_face` as [`Belief::face_in_camera`] does, in this state of the filter.
    fn face_at(&self, state: &State, viewer: Hand, face: Face, arms: &[ArmState]) -> Option<Pose> {
        let arm = &self.arms[viewer.index()];
        let tool_from_camera = arm.flange_from_tool.inverse() * arm.flange_from_camera?;
        let world_from_camera = self.tool(state, viewer, arms) * tool_from_camera;
        let world_from_cube = self.cube(state, viewer.other(), arms)?;
        Some(world_from_camera.inverse() * world_from_cube * self.cube_from_face(face))
    }

    /// Returns the frame of a face: origin in its centre, x to the next column, y to the next row,
    /// z into the cube.
    #[must_use]
    pub fn cube_from_face(&self, face: Face) -> Pose {
        let (x, y) = face.reading_axes();
        pose_from_axes(x, y, x.cross(&y), Point3::from(face.normal() * self.edge / 2.0))
    }

    /// Returns the axis about which the layer of `turner` turns, in the tool frame of the partner
    /// hand: 0, 1 or 2 for x, y or z.
    #[must_use]
    pub fn turn_axis(&self, turner: Hand) -> Option<usize> {
        let body = self.in_tool(&self.state, turner.other())?;
        let turner = self.in_tool(&self.state, turner)?;
        Some((body.rotation * turner.rotation.inverse() * Vector3::z()).iamax())
    }

    /// Records that `hand` has taken the cube from the operator, or has it in a good hold when the
    /// run begins.
    pub fn taken(&mut self, hand: Hand, hold: Hold, half_roll: bool) {
        self.holds(hand, hold, half_roll);
        self.forget(hand, TAKEN);
    }

    /// Records that `hand` holds the cube when the run begins, in a hold of an earlier run.
    pub fn found(&mut self, hand: Hand, hold: Hold, half_roll: bool) {
        self.taken(hand, hold, half_roll);
        self.found[hand.index()] = true;
    }

    /// Records a hold that begins in this run.
    fn holds(&mut self, hand: Hand, hold: Hold, half_roll: bool) {
        self.held[hand.index()] = Some(Held { hold, half_roll });
        self.found[hand.index()] = false;
    }

    /// Returns the standard deviations of a measurement of the cube in the hand `holder`, those of
    /// the sensor alone being `sigma`.
    fn deviations(&self, holder: Hand, sigma: &[f64; 6]) -> [f64; 6] {
        if !self.found[holder.index()] {
            return *sigma;
        }
        // The mean of all views keeps the error of the hold, so that each view counts for less.
        let (place, tilt) = FOUND;
        std::array::from_fn(|i| sigma[i].hypot(VIEWS.sqrt() * if i < 3 { place } else { tilt }))
    }

    /// Takes into account that `hand` has closed and secured its hold while the partner held.
    ///
    /// Returns the displacement of the cube, as the contact shows it, from the place where it was
    /// expected, in the hand's tool (m). Contact shows no displacement along the finger's width, so
    /// x is 0.
    pub fn secured(
        &mut self,
        hand: Hand,
        hold: Hold,
        half_roll: bool,
        arms: &[ArmState],
    ) -> Vector3<f64> {
        self.holds(hand, hold, half_roll);
        self.forget(hand, CLOSED);
        // There is one cube: its pose by this hand's contact and its pose by the partner must
        // agree.
        let residual = |belief: &Self, state: &State| {
            let by_partner = belief.cube(state, hand.other(), arms)?;
            let by_kinematics = belief.tool(state, hand, arms).inverse() * by_partner;
            Some(difference(&belief.in_tool(state, hand)?, &by_kinematics))
        };
        let miss = residual(self, &self.state)
            .map_or_else(Vector3::zeros, |r| Vector3::new(0.0, r[1], r[2]));
        self.update(&residual, &self.deviations(hand.other(), &CONTACT));
        miss
    }

    /// Records that `hand` has opened.
    pub fn released(&mut self, hand: Hand) {
        self.held[hand.index()] = None;
    }

    /// Records that `hand` has turned the face in its palm. The hold has another rotation relative
    /// to the body of the cube, but the cube's offset and tilt in the tool are unchanged.
    pub fn turned(&mut self, hand: Hand, hold: Hold, half_roll: bool) {
        self.held[hand.index()] = Some(Held { hold, half_roll });
    }

    /// Takes into account that the camera of `viewer` has seen `face` at `camera_from_face`.
    pub fn seen(&mut self, viewer: Hand, face: Face, camera_from_face: &Pose, arms: &[ArmState]) {
        let residual = |belief: &Self, state: &State| {
            Some(difference(&belief.face_at(state, viewer, face, arms)?, camera_from_face))
        };
        self.update(&residual, &self.deviations(viewer.other(), &SIGHT));
    }

    /// Renames the faces once the cube's colours are known; `rotation` carries old directions to
    /// new ones.
    pub fn renamed(&mut self, rotation: Rotation24) {
        for held in self.held.iter_mut().flatten() {
            let (hold, half_roll) = held.hold.renamed(held.half_roll, rotation);
            *held = Held { hold, half_roll };
        }
    }

    /// Resets the offset and the tilt of the cube in a hand to zero, with these standard deviations
    /// (m, rad).
    fn forget(&mut self, hand: Hand, (x, tilt): (f64, f64)) {
        for (offset, sigma) in [(0, x), (1, tilt)] {
            let i = 6 + 2 * hand.index() + offset;
            self.state[i] = 0.0;
            // A new grasp is independent of the last one, so the correlations are dropped as well.
            self.covariance.row_mut(i).fill(0.0);
            self.covariance.column_mut(i).fill(0.0);
            self.covariance[(i, i)] = sigma * sigma;
        }
    }

    /// Takes a measurement into account. `residual` is the measured value minus the predicted one,
    /// and `sigma` are the standard deviations of the measurement.
    fn update(&mut self, residual: &dyn Fn(&Self, &State) -> Option<Residual>, sigma: &[f64; 6]) {
        let prior = self.state;
        let variances = Residual::from_iterator(sigma.iter().map(|s| s * s));
        let noise = SMatrix::<f64, 6, 6>::from_diagonal(&variances);
        let mut state = prior;
        let mut covariance = self.covariance;
        // The measurement is nearly linear in the state, so two iterations suffice.
        for _ in 0..2 {
            let Some((at, slope)) = self.linearised(residual, &state) else { return };
            let spread = slope * self.covariance * slope.transpose() + noise;
            // A singular or undefined measurement leaves the belief as it was.
            let Some(inverse) = spread.try_inverse() else { return };
            let gain = self.covariance * slope.transpose() * inverse;
            // Iterated update: the slope is taken at the new state, the correction from the prior.
            state = prior + gain * (at - slope * (prior - state));
            // Joseph's form keeps the covariance symmetric and positive.
            let left = Covariance::identity() - gain * slope;
            covariance =
                left * self.covariance * left.transpose() + gain * noise * gain.transpose();
        }
        // A NaN in a measurement must not spoil the belief for the rest of the mission.
        if state.iter().all(|c| c.is_finite()) {
            self.state = state;
            self.covariance = covariance;
        }
    }

    /// Returns the residual at a state, and the derivatives of the prediction by the components of
    /// the state there.
    fn linearised(
        &self,
        residual: &dyn Fn(&Self, &State) -> Option<Residual>,
        state: &State,
    ) -> Option<(Residual, SMatrix<f64, 6, STATES>)> {
        const STEP: f64 = 1e-6;
        let at = residual(self, state)?;
        let mut slope = SMatrix::<f64, 6, STATES>::zeros();
        for i in 0..STATES {
            let mut moved = *state;
            moved[i] += STEP;
            // The residual falls where the prediction rises.
            slope.set_column(i, &((at - residual(self, &moved)?) / STEP));
        }
        Some((at, slope))
    }
}

/// Returns `measured` minus `predicted`: the distance vector of the origins (m) and the rotation
/// vector (rad), both in the frame in which the two poses are given.
fn difference(predicted: &Pose, measured: &Pose) -> Residual {
    let shift = measured.translation.vector - predicted.translation.vector;
    let turn = (measured.rotation * predicted.rotation.inverse()).scaled_axis();
    Residual::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::Axis;
    use crate::motion::Depth;

    /// Makes an arm whose base is at `y` (m) in the world, with a camera in its hand.
    fn arm(y: f64) -> ArmBelief {
        ArmBelief {
            world_from_base: Pose::translation(0.0, y, 0.0),
            flange_from_tool: Pose::translation(0.0, 0.0, 0.25),
            flange_from_camera: Some(Pose::translation(0.05, 0.0, 0.13)),
        }
    }

    /// Returns a point between the arms, about which the base of the postument is believed to err.
    fn pivot() -> Point3<f64> {
        Point3::new(0.0, 1.0, 1.3)
    }

    /// Makes an arm state with this set pose.
    fn posed(base_from_tool: Pose) -> ArmState {
        ArmState { desired_base_from_tool: base_from_tool, ..ArmState::default() }
    }

    /// Returns the pose with its origin at `from` whose z points to `at` (m).
    fn look_at(from: Vector3<f64>, at: Vector3<f64>) -> Pose {
        let z = (at - from).normalize();
        let x = z.cross(&Vector3::z()).normalize();
        pose_from_axes(x, z.cross(&x), z, Point3::from(from))
    }

    /// Returns a copy of `belief` that serves as the truth: the base of the postument has the error
    /// `base` (m, rad), and the cube in the track hand has the offset `x` (m).
    fn truth(belief: &Belief, base: [f64; 6], x: f64) -> Belief {
        let mut truth = belief.clone();
        for (i, error) in base.into_iter().enumerate() {
            truth.state[i] = error;
        }
        truth.state[6] = x;
        truth
    }

    /// Shows the cube that `truth` has in the track's hand to the postument's camera at three
    /// places far from each other, and passes what the camera sees to `belief`.
    fn view(belief: &mut Belief, truth: &Belief) {
        for (face, place) in [
            (Face::U, Vector3::new(0.3, 0.9, 1.2)),
            (Face::R, Vector3::new(-0.3, 1.1, 1.5)),
            (Face::L, Vector3::new(0.1, 1.3, 1.0)),
        ] {
            let track = look_at(place, place + Vector3::new(0.2, 0.9, 0.1));
            let mut arms = [posed(track), posed(Pose::identity())];
            let cube = truth.cube(&truth.state, Hand::Track, &arms).unwrap();
            // 0.2 m in front of the face.
            let seen_from = cube * Point3::from(face.normal() * 0.228);
            let camera = look_at(seen_from.coords, cube.translation.vector);
            let tool_from_camera = Pose::translation(0.05, 0.0, -0.12);
            let base = truth.world_from_base(Hand::Postument);
            arms[1] = posed(base.inverse() * camera * tool_from_camera.inverse());
            let measured = truth.face_in_camera(Hand::Postument, face, &arms).unwrap();
            belief.seen(Hand::Postument, face, &measured, &arms);
        }
    }

    /// Three views of one hold have the same error of it, so that they may not count as three
    /// measurements of the base.
    #[test]
    fn views_leave_error_of_found_hold_doubtful() {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        let next = Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One };
        let track = look_at(Vector3::new(0.0, 1.0, 1.3), Vector3::new(0.2, 1.9, 1.4));
        let arms = [posed(track), posed(Pose::identity())];
        let doubt = |found: bool| {
            let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
            if found {
                belief.found(Hand::Track, hold, false);
            } else {
                belief.taken(Hand::Track, hold, false);
            }
            let truth = belief.clone();
            view(&mut belief, &truth);
            belief.doubt(Hand::Postument, next, false, &arms).unwrap()
        };
        let (found, taken) = (doubt(true), doubt(false));
        assert!(found.iter().zip(&taken).all(|(more, less)| *more > 1.1 * less), "{found} {taken}");
    }

    #[test]
    fn hold_that_begins_in_run_is_not_found() {
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
        belief.found(Hand::Track, hold, false);
        let doubted = belief.deviations(Hand::Track, &SIGHT);
        belief.taken(Hand::Track, hold, false);

        assert!(doubted.iter().zip(SIGHT).all(|(more, of_sight)| *more > 1.2 * of_sight));
        assert_eq!(belief.deviations(Hand::Track, &SIGHT), SIGHT);
    }

    #[test]
    fn camera_views_improve_aim_of_next_grasp() {
        let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        belief.taken(Hand::Track, hold, false);
        let truth = truth(&belief, [0.001, -0.002, 0.0015, 0.006, -0.004, 0.008], 0.003);
        // The measure is how well the next grasp is aimed.
        let next = Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One };
        let place = Vector3::new(-0.2, 0.9, 1.4);
        let waiting = [posed(look_at(place, place + Vector3::y())), posed(Pose::identity())];
        let off = |belief: &Belief| {
            let aimed = belief.grasp_pose(Hand::Postument, next, false, &waiting).unwrap();
            let right = truth.grasp_pose(Hand::Postument, next, false, &waiting).unwrap();
            (aimed.translation.vector - right.translation.vector).norm()
        };
        let before = off(&belief);

        view(&mut belief, &truth);

        let after = off(&belief);
        assert!(before > 0.003 && after < 0.001, "{before} m before, {after} m after");
        for i in 0..STATES {
            assert!(belief.covariance[(i, i)] >= 0.0, "a variance is never negative");
        }
    }

    #[test]
    fn completed_grasp_improves_aim_of_next_grasp() {
        let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
        let first = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        let second = Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One };
        belief.taken(Hand::Track, first, false);
        // The postument's base errs by 4 mm along the tool's z and by 3 mm along its x.
        let truth = truth(&belief, [0.0, 0.004, 0.003, 0.0, 0.0, 0.0], 0.0);
        let track = look_at(Vector3::new(0.0, 0.8, 1.3), Vector3::new(0.0, 2.0, 1.3));
        let mut arms = [posed(track), posed(Pose::identity())];
        let there = truth.grasp_pose(Hand::Postument, second, false, &arms).unwrap();
        arms[1] = posed(there);

        let miss = belief.secured(Hand::Postument, second, false, &arms);
        let off = miss.norm();
        assert!((0.0035..0.0045).contains(&off), "4 mm off along z: {miss}");
        assert_eq!(miss.x, 0.0, "along the fingers contact shows nothing");

        let again = belief.grasp_pose(Hand::Postument, second, false, &arms).unwrap();
        let off = (there.inverse() * again).translation.vector;
        assert!(off.yz().norm() < 0.0015, "the next grasp is aimed better: {off}");
        assert!((off.x.abs() - 0.003).abs() < 1e-4, "the width was not measured: {off}");
    }

    /// The standard deviation that the filter predicts is that of states drawn from its covariance.
    #[test]
    fn predicted_deviation_matches_states_sampled_from_covariance() {
        let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
        let first = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        let second = Hold { palm: Face::U, jaws: Axis::X, depth: Depth::One };
        belief.taken(Hand::Track, first, false);
        let track = look_at(Vector3::new(0.0, 0.8, 1.3), Vector3::new(0.0, 2.0, 1.3));
        let mut arms = [posed(track), posed(Pose::identity())];
        // After a grasp the errors depend on each other.
        arms[1] = posed(belief.grasp_pose(Hand::Postument, second, false, &arms).unwrap());
        belief.secured(Hand::Postument, second, false, &arms);
        belief.released(Hand::Postument);
        let third = Hold { palm: Face::R, jaws: Axis::Y, depth: Depth::One };
        let seat = |b: &Belief| b.grasp_pose(Hand::Postument, third, false, &arms).unwrap();
        let doubt = belief.doubt(Hand::Postument, third, false, &arms).unwrap();
        let factor = belief.covariance.cholesky().unwrap().l();

        // True states are drawn as the filter believes them, and the distance to the cube is
        // computed in each.
        let (mut drawn, mut squares) = (Drawn(1), Vector3::zeros());
        for _ in 0..2000 {
            let mut truth = belief.clone();
            truth.state += factor * State::from_fn(|_, _| drawn.normal());
            let off = (seat(&belief).inverse() * seat(&truth)).translation.vector;
            squares += off.component_mul(&off);
        }

        let found = (squares / 2000.0).map(f64::sqrt);
        for (doubt, found) in doubt.iter().zip(&found) {
            assert!((doubt / found - 1.0).abs() < 0.06, "{doubt} m estimated, {found} m found");
        }
    }

    /// Normally distributed numbers from Lehmer's random number generator, with this state.
    struct Drawn(u64);

    impl Drawn {
        /// Returns the next number, of mean 0 and variance 1.
        fn normal(&mut self) -> f64 {
            // Twelve numbers between 0 and 1 have a variance of 1.
            let mut sum = -6.0;
            for _ in 0..12 {
                self.0 = self.0 * 48_271 % 2_147_483_647;
                sum += self.0 as f64 / 2_147_483_647.0;
            }
            sum
        }
    }

    #[test]
    fn face_turn_keeps_cube_position_in_tool_frame() {
        let mut belief = Belief::new([arm(0.0), arm(2.0)], 0.057, pivot());
        let hold = Hold { palm: Face::D, jaws: Axis::Y, depth: Depth::One };
        belief.taken(Hand::Track, hold, false);
        // The cube lies 3 mm off and tilted by 0.02 rad in the hand.
        (belief.state[6], belief.state[7]) = (0.003, 0.02);
        let before = belief.in_tool(&belief.state, Hand::Track).unwrap();

        let (turned, half_roll) = hold.after_turn(false, 1);
        belief.turned(Hand::Track, turned, half_roll);

        let after = belief.in_tool(&belief.state, Hand::Track).unwrap();
        assert!((after.translation.vector - before.translation.vector).norm() < 1e-12);
        let turn = before.rotation.angle_to(&after.rotation);
        assert!((turn - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }
}
