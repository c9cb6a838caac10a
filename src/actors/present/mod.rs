//! The presenter: makes the operator's snapshots from notices and the latest values. They show the
//! controller's belief, never the plant's truth, except where loose objects are.
//!
//! - in: notices, messages of a recording, the [`LatestValues`], the operator's control
//! - out: a [`View`]: the snapshot, and stage and pictures if they are new

mod actors;
mod camera;
mod moment;
mod stage;

pub(crate) use stage::{poses, stage};

use super::control::Control;
use super::latest::{ArmLatest, Found, Latest, LatestValues};
use super::notice::{Notice, class};
use crate::cell::Cell;
use crate::cube::{Face, Keeper};
use crate::desk::{Picture as Pixels, Pictures, Pixels as Kind, RunEnd};
use crate::generators::Target;
use crate::kernel::Picture;
use crate::motion::{PERIOD, Synchronisation};
use crate::operator::{
    ActorView, ArmView, CameraView, Class, ControlView, CubeView, HandView, Input, LayerTurn,
    Message, OutcomeView, ParameterStage, ParameterView, Services, Snapshot, Stage, arm_frames,
    joints_of, remedy,
};
use crate::scenario::ControllerConfig;
use crate::scenario::keys::Pace;
use crate::servo::period::Length;
use actors::Actors;
use moment::Moment;
use nalgebra::UnitQuaternion;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Most messages that a snapshot carries. A page that is opened late shows those.
const MESSAGES: usize = 400;
/// Age from which on the cube of the stand-alone camera is not shown (s).
const STALE: f64 = 1.0;
/// Least time over which the speed of the run's time is measured.
const FACTOR: Duration = Duration::from_millis(500);
/// Least time between two pictures of a camera: a person does not need more.
const PICTURE: Duration = Duration::from_millis(120);

/// The values of a run at one moment, for the UIs.
pub struct View {
    /// Stage, if it has changed.
    pub stage: Option<Stage>,
    /// Pictures of all cameras, if one is new.
    pub pictures: Option<Pictures>,
    /// Snapshot of all other values.
    pub snapshot: Snapshot,
}

/// The maker of snapshots, with its memory.
pub struct Presenter {
    latest: LatestValues,
    /// Believed cell; a calibration replaces it.
    cell: Cell,
    /// Name and camera of each VSP.
    vsps: Vec<(String, Option<usize>)>,
    virtual_pace: bool,
    /// Length of the arms' periods; the sensors' periods last 2 ms.
    length: Length,
    /// Whether an arm has published a state.
    begun: bool,
    /// Number of the last snapshot, counted from 1; 0 before the first.
    number: u64,
    /// Name of each phase and time of its beginning (s).
    phases: Vec<(String, f64)>,
    messages: Arc<Vec<Message>>,
    /// Number of the last message.
    said: u64,
    outcome: Option<OutcomeView>,
    /// Whether a fatal error has been reported.
    fatal: bool,
    /// Last measurement of the speed of time: the moment, the run's time then (s), the speed.
    factor: (Instant, f64, f64),
    /// Last picture of each camera.
    pictures: Vec<Option<Arc<Pixels>>>,
    /// View of each camera, with the results of vision in its picture.
    views: Vec<CameraView>,
    /// Moment at which the last picture of each camera was taken over.
    taken_at: Vec<Option<Instant>>,
    /// Newest pose of the cube from the stand-alone camera.
    hand: Option<Target>,
    stage: Stage,
}

impl Presenter {
    /// Creates the presenter of a run. `stage` has the facts that do not change during the run,
    /// `latest` the values that the actors keep up to date.
    #[must_use]
    pub fn new(stage: Stage, config: &ControllerConfig, latest: LatestValues) -> Self {
        let cell = config.cell.clone();
        let views = stage
            .cameras
            .iter()
            .map(|c| CameraView { name: c.name.clone(), size: c.size, ..CameraView::default() })
            .collect();
        Self {
            latest,
            vsps: config.vsps.iter().map(|v| (v.name.clone(), v.camera)).collect(),
            virtual_pace: stage.pace == Pace::Virtual.word(),
            length: Length::of_seconds(stage.limits.period),
            begun: false,
            number: 0,
            phases: Vec::new(),
            messages: Arc::default(),
            said: 0,
            outcome: None,
            fatal: false,
            factor: (Instant::now(), 0.0, 0.0),
            pictures: vec![None; cell.cameras.len()],
            taken_at: vec![None; cell.cameras.len()],
            views,
            hand: None,
            stage,
            cell,
        }
    }

    /// Adds a notice to the next snapshot.
    pub fn notice(&mut self, notice: &Notice) {
        match notice {
            Notice::Phase(time, name) => {
                self.phases.push((name.clone(), *time));
                self.say(*time, Class::Info, "mp", &format!("phase: {name}"));
            }
            Notice::Note(time, text) => self.say(*time, Class::Info, "mp", text),
            Notice::Warning(time, text) => self.say(*time, Class::Warning, "mp", text),
            Notice::Error(time, error) => {
                let (class, actor) = class(error);
                self.fatal |= class == Class::Fatal;
                self.say(*time, class, actor, &error.to_string());
            }
            Notice::Elsewhere(time, class, who, text) => self.recorded(*time, *class, who, text),
            Notice::Over(outcome) => {
                let class = if outcome.good { Class::Info } else { Class::Warning };
                let text = format!("{}: {}", outcome.verdict, outcome.reason);
                self.say(self.time(), class, "ui", &text);
                self.outcome = Some(outcome.clone());
            }
        }
    }

    /// Adds a message of a recording, from the actor `source` at the time `time` (s), to the next
    /// snapshot.
    pub fn recorded(&mut self, time: f64, class: Class, source: &str, text: &str) {
        self.fatal |= class == Class::Fatal;
        self.say(time, class, source, text);
    }

    /// Adds a message about an input of the operator to the next snapshot. `done` says that the
    /// input was obeyed, or why it was refused.
    pub fn obeyed(&mut self, input: &Input, done: &Result<(), Cow<'static, str>>) {
        let input = input.describe();
        let (class, text) = match done {
            Ok(()) => (Class::Info, format!("operator: {input}")),
            Err(why) => (Class::Warning, format!("operator: {input}: not done, {why}")),
        };
        self.say(self.time(), class, "ui", &text);
    }

    /// Adds a message to the list that each snapshot carries. A full list first drops its oldest
    /// quarter.
    fn say(&mut self, time: f64, class: Class, source: &str, text: &str) {
        self.said += 1;
        // Snapshots share the list. It is copied only if one of them is still held.
        let messages = Arc::make_mut(&mut self.messages);
        if messages.len() >= MESSAGES {
            // A quarter at a time: to drop one message would move all others each time.
            messages.drain(..MESSAGES / 4);
        }
        messages.push(Message {
            number: self.said,
            time,
            class,
            source: source.to_owned(),
            text: text.to_owned(),
        });
    }

    /// Returns the time of the run now (s).
    fn time(&self) -> f64 {
        self.time_of(&self.latest.lock())
    }

    /// Returns the time of the run in these values (s): the time of the latest state of any arm.
    fn time_of(&self, latest: &Latest) -> f64 {
        let periods = latest.arms.iter().map(|arm| arm.state.period).max().unwrap_or(0);
        periods as f64 * self.length.seconds()
    }

    /// Publishes a snapshot of the present values on the `desk`, and the stage and the pictures if
    /// they are new. `speed` is the limit of the speed of simulated time.
    pub fn publish(&mut self, desk: &RunEnd, control: Control, speed: f64) {
        let View { stage, pictures, snapshot } = self.view(control, speed);
        // The snapshot comes last: it names the pictures and the cameras of the stage.
        if let Some(stage) = stage {
            desk.stage.send_replace(Arc::new(stage));
        }
        if let Some(pictures) = pictures {
            desk.pictures.send_replace(pictures);
        }
        desk.publish(snapshot);
    }

    /// Returns the present values of the run for the user interfaces. `speed` is the limit of the
    /// speed of simulated time, as a multiple of real time; 0 for no limit.
    pub fn view(&mut self, control: Control, speed: f64) -> View {
        // One lock for all values, so that they are of one moment. The work on them comes after it.
        let values = self.latest.clone();
        let mut latest = values.lock();
        // Before the pictures: they are drawn into by the calibrated camera.
        let stage = latest.calibrated.take().map(|cell| self.calibrated(*cell));
        let is_new = self.take_pictures(&mut latest);
        let time = self.time_of(&latest);
        let moment = Moment::of(&mut latest, time);
        drop(latest);

        self.begun |= !moment.arms.is_empty();
        self.measure_factor(moment.time);
        self.number += 1;
        let snapshot = self.snapshot(moment, control, speed);
        View { stage, pictures: is_new.then(|| self.pictures.clone()), snapshot }
    }

    /// Makes a snapshot from the values of one moment, the operator's control and the limit of the
    /// speed of simulated time.
    fn snapshot(&self, moment: Moment, control: Control, speed: f64) -> Snapshot {
        // A run with an outcome has ended, even if the operator's control still says otherwise.
        let control = match (control, &self.outcome) {
            (_, Some(_)) => ControlView::Ended,
            (Control::Waiting, None) => ControlView::Waiting,
            (Control::Running, None) => ControlView::Running,
            (Control::Paused, None) => ControlView::Paused,
            (Control::Terminated, None) => ControlView::Terminated,
        };
        let arms = self.arms(&moment);
        let cube = self.cube(&arms, moment.picture.as_ref(), moment.time);
        // The hand is shown at the cube that the camera sees, so only while no arm holds it.
        let person = self.cell.keeper == Keeper::Person;
        let hand = self.hand(moment.time).filter(|_| person && cube.held_by.is_empty());
        let actors = self.actors(control, &moment);
        let parameters = self.parameters(&moment);
        let picture = moment.picture.unwrap_or_default();
        // Readings of a user's own sensors are shown beside the facts of the task.
        let mut facts = picture.facts;
        facts.extend(moment.sensors);
        Snapshot {
            number: self.number,
            time: moment.time,
            factor: self.factor.2,
            speed,
            control,
            phase: self.phases.last().map(|p| p.0.clone()).unwrap_or_default(),
            phases: self.phases.clone(),
            actors,
            arms,
            cube,
            objects: moment.objects,
            hand,
            cameras: self.views.clone(),
            net: picture.net,
            plan: picture.plan,
            step: picture.step,
            facts,
            servo: moment.servo,
            question: moment.question,
            // A run with an outcome takes no orders and no speed any more.
            services: Services {
                manual: moment.manual && self.outcome.is_none(),
                parameters: !self.stage.parameters.is_empty() && self.outcome.is_none(),
                speed: self.virtual_pace && self.outcome.is_none(),
                seek_ms: None,
                after: None,
            },
            parameters,
            messages: Arc::clone(&self.messages),
            outcome: self.outcome.clone(),
        }
    }

    /// Returns the present and the ordered value of each parameter.
    fn parameters(&self, moment: &Moment) -> Vec<ParameterView> {
        let period = (moment.time / PERIOD).round() as u64;
        let view = |stage: &ParameterStage| match &moment.courses {
            Some(courses) => ParameterView {
                value: courses.value(stage.parameter, period),
                ordered: courses.ordered(stage.parameter),
            },
            None => ParameterView { value: stage.bounds.usual, ordered: stage.bounds.usual },
        };
        self.stage.parameters.iter().map(view).collect()
    }

    /// Replaces the believed cell by the one that a calibration found. Returns the stage with the
    /// poses of its cameras and the edge of its cube.
    fn calibrated(&mut self, cell: Cell) -> Stage {
        self.stage.cameras = stage::cameras(&cell);
        self.stage.edge = cell.cube.edge;
        self.cell = cell;
        self.stage.clone()
    }

    /// Stores the pose of the cube if vision has found one in a picture that was exposed in
    /// `period`, unless a newer pose is known. The picture itself may be missing.
    pub fn take_sight(&mut self, period: u64, found: &Found) {
        // A sight stays in the latest values and is taken again with each snapshot. It must not
        // replace a newer result that came without a picture.
        if let Found::Cube(world_from_cube, speed) = *found
            && self.hand.is_none_or(|hand| hand.period <= period)
        {
            self.hand = Some(Target { world_from_cube, speed, period });
        }
    }

    /// Measures how fast the run's time passes, as a multiple of real time, each [`FACTOR`].
    fn measure_factor(&mut self, time: f64) {
        let (at, then, _) = self.factor;
        let passed = at.elapsed();
        if passed >= FACTOR {
            self.factor = (Instant::now(), time, (time - then) / passed.as_secs_f64());
        }
    }

    /// Takes the new pictures of all cameras out of the latest values, with the results of vision
    /// to draw over them. Returns whether there was a new picture.
    fn take_pictures(&mut self, latest: &mut Latest) -> bool {
        let mut new = false;
        for (camera, sight) in latest.sights.iter_mut().enumerate() {
            let Some(sight) = sight else { continue };
            self.take_sight(sight.period, &sight.found);
            let soon = self
                .taken_at
                .get(camera)
                .copied()
                .flatten()
                .is_some_and(|at| at.elapsed() < PICTURE);
            // A picture that comes too soon stays in the values, and a newer one may replace it.
            let Some(image) = sight.image.take_if(|_| !soon) else { continue };
            let Some(view) = self.views.get_mut(camera) else { continue };
            view.frame += 1;
            view.time = sight.period as f64 * PERIOD;
            view.size = image.dimensions();
            camera::draw(view, &self.cell, camera, sight);
            self.pictures[camera] =
                Some(Arc::new(Pixels { frame: view.frame, pixels: Kind::Raw(image) }));
            self.taken_at[camera] = Some(Instant::now());
            new = true;
        }
        new
    }

    /// Returns the joints, forces, faults and frames of each arm for the user interfaces.
    fn arms(&self, moment: &Moment) -> Vec<ArmView> {
        // The mission estimates the bases better than the scenario states them.
        let believed = |i: usize| moment.picture.as_ref()?.world_from_base.get(i).copied()?;
        let view = |(i, arm): (usize, &crate::cell::Arm)| {
            let latest = moment.arms.get(i);
            let ArmLatest { state, peaks } = latest.copied().unwrap_or_default();
            let synchronised = state.synchronisation == Synchronisation::Yes && latest.is_some();
            // Before the first state an arm is shown at its start pose.
            let joints = latest.map_or(arm.start, |latest| latest.state.joints);
            ArmView {
                name: arm.name.clone(),
                joints: joints.0,
                motors: state.motors.0,
                frames: arm_frames(arm, &believed(i).unwrap_or(arm.world_from_base), &joints),
                opening: state.jaw_opening,
                grip: state.jaw_force,
                wrench: state.wrench_in_tool.directions(),
                peak: (peaks.force, peaks.torque),
                following: peaks.following,
                synchronised,
                fault: state.fault.map(|fault| fault.to_string()),
                remedy: state.fault.map(|fault| remedy(&fault).to_owned()),
            }
        };
        self.cell.arms.iter().enumerate().map(view).collect()
    }

    /// Returns the state and activity of each actor for the user interfaces.
    fn actors(&self, control: ControlView, moment: &Moment) -> Vec<ActorView> {
        Actors {
            control,
            fatal: self.fatal,
            begun: self.begun,
            cell: &self.cell,
            moment,
            vsps: &self.vsps,
            cameras: &self.views,
        }
        .views()
    }

    /// Returns pose and speed of the cube as the stand-alone camera saw it last, if that was less
    /// than [`STALE`] before `time` (s).
    fn hand(&self, time: f64) -> Option<HandView> {
        let Target { world_from_cube, speed, period } = self.hand?;
        let age = time - period as f64 * PERIOD;
        (age < STALE).then_some(HandView { world_from_cube, speed, age })
    }

    /// Returns the words for the place of a cube that the stand-alone camera sees and no arm holds.
    fn keeper_place(&self) -> &'static str {
        match self.cell.keeper {
            Keeper::Person => "in the operator's hand",
            Keeper::Table => "on the table",
        }
    }

    /// Returns where the cube is and what its facelets are, for the user interfaces. Its pose is
    /// that in the arm that holds it by the kernel's belief; without one, where the camera sees it.
    fn cube(&self, arms: &[ArmView], picture: Option<&Picture>, time: f64) -> CubeView {
        let Some(picture) = picture else {
            // The kernel has no belief yet, or the task handles no cube.
            let seen = self.hand(time).map(|hand| hand.world_from_cube);
            let with = if seen.is_some() { self.keeper_place() } else { "not seen yet" };
            return CubeView {
                world_from_cube: seen,
                with: with.to_owned(),
                facelets: "-".repeat(54),
                ..CubeView::default()
            };
        };
        let tool = |arm: usize| Some(joints_of(&arms.get(arm)?.frames)?.tool);
        let held: Vec<usize> =
            (0..2).filter(|&i| picture.tool_from_cube[i].is_some() && tool(i).is_some()).collect();
        // While a layer turns, the body of the cube moves with the hand that does not turn it.
        let turner = picture.turning.map(|turning| turning.effector);
        let body = held.iter().copied().find(|&i| Some(i) != turner).or(held.first().copied());
        let by_hand = body.and_then(|i| Some(tool(i)? * picture.tool_from_cube[i]?));
        let seen = self.hand(time).map(|hand| hand.world_from_cube);
        // The angle of the layer is the roll of the turning hand since the layer was straight.
        let turned = picture.turning.zip(by_hand).and_then(|(turning, world_from_cube)| {
            let cube_from_tool =
                world_from_cube.rotation.inverse() * tool(turning.effector)?.rotation;
            let angle = roll(&(turning.cube_from_tool.inverse() * cube_from_tool));
            Some(LayerTurn { face: turning.face.index(), angle })
        });
        let names: Vec<&str> =
            held.iter().filter_map(|&i| arms.get(i)).map(|arm| arm.name.as_str()).collect();
        let with = match (names.as_slice(), seen.is_some()) {
            // No arm holds it: the camera's sight counts first, then the kernel's belief.
            ([], true) => self.keeper_place().to_owned(),
            ([], false) if picture.handed_back => match self.cell.keeper {
                Keeper::Person => "handed back".to_owned(),
                Keeper::Table => "laid on the table".to_owned(),
            },
            ([], false) => "at an unknown place".to_owned(),
            (names, _) => format!("held by {}", names.join(" and ")),
        };
        CubeView {
            world_from_cube: by_hand.or(seen),
            held_by: held,
            with,
            facelets: letters(picture),
            turned,
        }
    }
}

/// Returns the angle of a rotation about z (rad), in -pi..pi.
fn roll(rotation: &UnitQuaternion<f64>) -> f64 {
    let angle = 2.0 * rotation.k.atan2(rotation.w);
    (angle + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

/// Returns the letters of the 54 facelets that the kernel believes. While the faces are being read,
/// they are those read so far, with `-` for the others.
fn letters(picture: &Picture) -> String {
    if let Some(facelets) = &picture.facelets {
        return facelets.to_string();
    }
    let letter = |i: usize| {
        let reading = picture.net.facelets.get(i).copied().flatten();
        reading.map_or('-', |r| Face::ALL[usize::from(r.colour.min(5))].letter())
    };
    (0..54).map(letter).collect()
}

#[cfg(test)]
mod tests {
    use super::super::latest::{Peaks, Sight};
    use super::*;
    use crate::cell::Mount;
    use crate::kernel::Turning;
    use crate::motion::ArmState;
    use crate::operator::State;
    use crate::scenario::Override;
    use crate::spatial::Pose;
    use std::path::Path;

    /// Returns a presenter of the built-in scenario, with its stage and its latest values.
    fn presenter() -> (Presenter, Stage, LatestValues) {
        let scenario = crate::tasks::read(Path::new("t.toml"), "", &[]).unwrap();
        let latest = LatestValues::default();
        let stage = stage(&scenario);
        let presenter = Presenter::new(stage.clone(), &scenario.controller, latest.clone());
        (presenter, stage, latest)
    }

    /// Sets the latest states of both arms to their start poses, in period 500.
    fn stand(latest: &LatestValues, presenter: &Presenter) {
        let arms = presenter.cell.arms.iter().map(|arm| ArmLatest {
            state: ArmState { period: 500, joints: arm.start, ..ArmState::default() },
            ..ArmLatest::default()
        });
        latest.lock().arms = arms.collect();
    }

    /// A held cube is shown where the arm holds it, and a layer that is being turned at the angle
    /// of the turning hand.
    #[test]
    fn snapshot_shows_cube_pose_and_turning_layer_angle() {
        let (mut presenter, _, latest) = presenter();
        stand(&latest, &presenter);
        let desk = crate::desk::Desk::default().run_end();
        let tool_from_cube = Pose::translation(0.0, 0.0, 0.019);
        let frames: Vec<Pose> = presenter
            .cell
            .arms
            .iter()
            .map(|arm| arm_frames(arm, &arm.world_from_base, &arm.start))
            .map(|frames| joints_of(&frames).unwrap().tool)
            .collect();
        let world_from_cube = frames[1] * tool_from_cube;
        // The layer was straight 0.3 rad before the present orientation of the track arm's tool.
        let now = world_from_cube.rotation.inverse() * frames[0].rotation;
        let before = now * UnitQuaternion::from_scaled_axis(nalgebra::Vector3::z() * -0.3);
        latest.lock().picture = Some(Picture {
            tool_from_cube: [Some(Pose::identity()), Some(tool_from_cube)],
            turning: Some(Turning { effector: 0, face: Face::R, cube_from_tool: before }),
            ..Picture::default()
        });

        presenter.publish(&desk, Control::Running, 0.0);

        let snapshot = desk.latest();
        assert_eq!(snapshot.time, 1.0, "500 periods of 2 ms");
        assert_eq!(snapshot.cube.held_by, [0, 1]);
        let shown = snapshot.cube.world_from_cube.unwrap();
        assert!((shown.translation.vector - world_from_cube.translation.vector).norm() < 1e-12);
        let turned = snapshot.cube.turned.unwrap();
        assert_eq!(turned.face, Face::R.index());
        assert!((turned.angle - 0.3).abs() < 1e-9, "{}", turned.angle);
        assert_eq!(snapshot.cube.facelets, "-".repeat(54));
    }

    #[test]
    fn snapshot_time_uses_the_configured_servo_period() {
        let set = [Override::parse("real_time.period_ms=1").unwrap()];
        let scenario = crate::tasks::read(Path::new("t.toml"), "", &set).unwrap();
        let latest = LatestValues::default();
        let mut presenter =
            Presenter::new(super::stage(&scenario), &scenario.controller, latest.clone());
        stand(&latest, &presenter);
        let desk = crate::desk::Desk::default().run_end();

        presenter.publish(&desk, Control::Running, 0.0);

        assert_eq!(desk.latest().time, 0.5, "500 periods of 1 ms");
    }

    #[test]
    fn calibration_moves_shown_cube_outlines_and_camera() {
        let (mut presenter, before, latest) = presenter();
        stand(&latest, &presenter);
        let desk = crate::desk::Desk::default().run_end();
        let mut cell = presenter.cell.clone();
        let Mount::World { world_from_camera } = &mut cell.cameras[0].mount else { panic!() };
        let world_from_cube = *world_from_camera * Pose::translation(0.0, 0.0, 1.0);
        world_from_camera.translation.vector.x += 0.05;
        let look = || Sight {
            period: 500,
            image: Some(image::RgbImage::new(4, 4)),
            found: Found::Cube(world_from_cube, 0.0),
        };
        latest.saw(0, look());
        presenter.publish(&desk, Control::Running, 0.0);
        let first = desk.latest().cameras[0].outlines.clone();

        latest.lock().calibrated = Some(Box::new(cell));
        std::thread::sleep(PICTURE);
        latest.saw(0, look());
        presenter.publish(&desk, Control::Running, 0.0);

        let outlines = desk.latest().cameras[0].outlines.clone();
        let is_new = |corner: &(f64, f64)| {
            let far = |old: &(f64, f64)| (corner.0 - old.0).hypot(corner.1 - old.1) > 5.0;
            first.iter().flatten().all(far)
        };
        assert!(!first.is_empty() && !outlines.is_empty(), "{first:?} {outlines:?}");
        assert!(outlines.iter().flatten().all(is_new), "{first:?} {outlines:?}");
        let place = |stage: &Stage| stage.cameras[0].pose.translation.vector;
        let moved = place(&desk.stage.borrow()) - place(&before);
        assert!((moved - nalgebra::Vector3::x() * 0.05).norm() < 1e-12, "{moved}");
    }

    #[test]
    fn force_peak_appears_in_one_snapshot_only() {
        let (mut presenter, _, latest) = presenter();
        stand(&latest, &presenter);
        let desk = crate::desk::Desk::default().run_end();
        latest.lock().arms[0].peaks = Peaks { force: 12.0, torque: 1.5, following: 0.0 };

        presenter.publish(&desk, Control::Running, 0.0);
        assert_eq!(desk.latest().arms[0].peak, (12.0, 1.5));
        presenter.publish(&desk, Control::Running, 0.0);
        assert_eq!(desk.latest().arms[0].peak, (0.0, 0.0));
    }

    #[test]
    fn snapshot_shows_arm_fault_and_its_severity() {
        let (mut presenter, _, latest) = presenter();
        stand(&latest, &presenter);
        let desk = crate::desk::Desk::default().run_end();
        let fault = crate::motion::ArmFault::EmergencyStop;
        latest.lock().arms[1].state.fault = Some(fault);
        let error = crate::error::Error::Fatal {
            actor: "edp postument".into(),
            place: "execute".into(),
            cause: crate::error::Fatal::Arm(fault),
            last: None,
        };

        presenter.notice(&Notice::Error(1.0, error));
        presenter.publish(&desk, Control::Running, 0.0);

        let snapshot = desk.latest();
        let edp = snapshot.actors.iter().find(|a| a.name == "edp postument").unwrap();
        assert_eq!(edp.state, State::Fault);
        assert_eq!(snapshot.messages[0].class, Class::Fatal);
        assert_eq!(snapshot.messages[0].source, "edp postument");
        let text = serde_json::to_string(&*snapshot).unwrap();
        assert_eq!(serde_json::from_str::<Snapshot>(&text).unwrap().messages, snapshot.messages);
    }

    #[test]
    fn static_scene_lists_arms_cameras_and_start_pose() {
        let (_, stage, _) = presenter();

        assert_eq!(stage.arms.len(), 2);
        assert!(stage.arms.iter().all(|arm| arm.poses.contains(&"start".to_owned())));
        assert_eq!(stage.cameras.len(), 3);
        assert!(stage.limits.force > 1.0);
    }
}
