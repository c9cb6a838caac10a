//! The keys of the list `[[fault]]`: faults that are injected into a simulated run. Only the side
//! of the plant may read them.
//!
//! - in: kind, time (`at_s`, or `event` with `nth` and `delay_s`), duration, magnitude, and the
//!   part that fails
//! - out: [`FaultKeys`], which `check` compares with each other and with the scenario

use super::lists::{CameraKeys, Effector, Vsp, VspKind};
use super::section::{Reader, section, words};
use crate::cube::Face;

words! {
    /// Kind of a fault, with the unit of its magnitude.
    pub FaultKind {
        /// The counter of an axis stays at its value.
        EncoderFreeze = "encoder_freeze",
        /// The counter of an axis is off by magnitude (rad of the motor).
        EncoderJump = "encoder_jump",
        /// A power stage reports over-current, and magnitude as its current (A).
        OverCurrent = "over_current",
        /// A limit switch is pressed.
        LimitSwitch = "limit_switch",
        /// A force sensor is silent.
        ForceDropout = "force_dropout",
        /// One direction of a force sensor is not a number.
        ForceNan = "force_nan",
        /// One direction of a force sensor is at the end of its range.
        ForceSaturation = "force_saturation",
        /// One direction of a force sensor is off by magnitude (N, Nm).
        ForceBias = "force_bias",
        /// The servo misses as many periods in a row as magnitude says.
        MissedPeriods = "missed_periods",
        /// A camera's pictures are black.
        CameraBlackout = "camera_blackout",
        /// A camera delivers no picture.
        CameraSilent = "camera_silent",
        /// A camera's pictures come late by magnitude (ms).
        LateFrames = "late_frames",
        /// A sensor that the program adds delivers no measurement.
        SensorSilent = "sensor_silent",
        /// A sensor that the program adds repeats its last measurement.
        SensorFrozen = "sensor_frozen",
        /// The measurements of a sensor that the program adds come late by magnitude (ms).
        LateMeasurements = "late_measurements",
        /// A binary input of the parallel interface is set.
        Input = "input",
        /// A gripper has only a share of its friction (magnitude).
        Slip = "slip",
        /// A gripper lets the cube drop.
        Drop = "drop",
        /// Each layer needs more torque by magnitude (Nm).
        Jam = "jam",
        /// The turned layer slips back under the jaws, by a quarter turn in magnitude (s), until
        /// the turn is over.
        TurnUndone = "turn_undone",
        /// A force of magnitude (N) pushes the hand of an arm along a direction of the world.
        Push = "push",
        /// The operator withdraws the cube that he brings or offers, once more.
        Withdraw = "withdraw",
        /// The cameras see a sticker in another colour.
        Misread = "misread",
        /// The fingers of an arm reach one layer less deep than believed.
        UnderConstrained = "under_constrained",
        /// The fingers of an arm reach one layer deeper than believed.
        OverConstrained = "over_constrained",
        /// The jaws of an arm are wider than believed by magnitude (mm).
        JawCalibration = "jaw_calibration",
        /// The base of an arm has an error of magnitude (mm) along a direction of the world.
        BaseCalibration = "base_calibration",
        /// A message to the EDP of an arm, or to `actor`, is late by magnitude (ms).
        LateMessage = "late_message",
        /// A message to the EDP of an arm, or to `actor`, is lost, and with it the channel of its
        /// answer.
        LostMessage = "lost_message",
        /// A message to the servo of an arm arrives twice.
        DuplicatedMessage = "duplicated_message",
        /// An actor panics.
        ActorPanic = "actor_panic",
        /// An actor stops answering.
        ActorHang = "actor_hang",
        /// An actor stops answering and blocks all other actors.
        ActorSpin = "actor_spin",
        /// The heartbeat of the actors stops.
        HeartBeatLoss = "heart_beat_loss",
        /// A node dies, and its link with it.
        NodeDies = "node_dies",
        /// The device of `file` is full.
        DiskFull = "disk_full",
        /// The device of `file` fails: writes end with an error and leave nothing.
        DiskError = "disk_error",
        /// The device of `file` fails halfway: writes end with an error and leave their first half.
        TornWrite = "torn_write",
        /// The device of `file` reports writes as successful, but they leave nothing.
        LostWrite = "lost_write",
        /// The clock jumps ahead by magnitude (ms).
        ClockJump = "clock_jump",
        /// The emergency stop is pressed.
        EmergencyStop = "emergency_stop",
        /// The power fails: the process is killed, and the plant stays as it is.
        PowerCut = "power_cut",
    }
}

words! {
    /// Event in the plant that begins a fault.
    pub FaultEvent {
        /// Jaws close on the cube; only those of `event_arm` if it is given.
        Grasped = "grasped",
        /// Jaws let go of the cube; only those of `event_arm` if it is given.
        Released = "released",
        /// A layer begins to turn between two hands.
        TurnBegins = "turn_begins",
        /// A layer has been turned by `turned_deg`.
        Turned = "turned",
        /// The cube leaves the hand and falls.
        Dropped = "dropped",
        /// The cube lies on the tray.
        Landed = "landed",
        /// The operator has let go of the cube.
        Given = "given",
        /// The operator has taken the cube.
        Taken = "taken",
    }
}

words! {
    /// Actor that can fail.
    pub FaultActor {
        /// The coordinator.
        Mp = "mp",
        /// The control process of an effector.
        Ecp = "ecp",
        /// The driver of an arm.
        Edp = "edp",
        /// A virtual sensor with a camera.
        Vsp = "vsp",
    }
}

words! {
    /// File whose storage can fail.
    pub FaultFile {
        /// The recording of `--record`.
        Recording = "recording",
        /// The journal of `--journal`.
        Journal = "journal",
        /// The state of the simulated world, of `--world`.
        World = "world",
    }
}

section! {
    /// Injected fault.
    pub FaultKeys {
        /// Name for messages and `--set fault.NAME.key`.
        name: String = String::new();
        /// Kind of the fault, which gives the unit of its magnitude.
        kind: Option<FaultKind> = None;
        /// Time in the plant at which the fault begins.
        at [s]: Option<f64> = None, 0.0..=86400.0;
        /// Event in the plant that begins the fault.
        event: Option<FaultEvent> = None;
        /// Occurrence of the event that begins the fault, counted from the start of the run.
        nth: u32 = 1, 1.0..=10000.0;
        /// Delay of the fault after its event.
        delay [s]: f64 = 0.0, 0.0..=3600.0;
        /// Arm of the event; any arm if not given.
        event_arm: Option<String> = None;
        /// Angle by which the layer has turned, for event = "turned".
        turned [deg]: f64 = 45.0, 1.0..=180.0;
        /// Duration of the fault; it stays if not given.
        duration [s]: Option<f64> = None, 0.0..=86400.0;
        /// Size of the fault, in the unit of its kind.
        magnitude: Option<f64> = None, -1e6..=1e6;
        /// Arm that has the fault.
        arm: Option<String> = None;
        /// Axis that has the fault: 0 the track, 1 to 6, 7 the jaw.
        axis: Option<u32> = None, 0.0..=7.0;
        /// Direction: 0, 1, 2 along x, y, z and 3, 4, 5 about them; of the sensor, or of the world
        /// for a push and the base of an arm.
        direction: u32 = 2, 0.0..=5.0;
        /// Camera that has the fault.
        camera: Option<String> = None;
        /// Sensor that has the fault: the name of a VSP whose kind the program adds.
        sensor: Option<String> = None;
        /// Actor that has the fault, of `arm` or `camera`.
        actor: Option<FaultActor> = None;
        /// Node that dies.
        node: Option<String> = None;
        /// File whose storage has the fault.
        file: FaultFile = FaultFile::Recording;
        /// Binary input that is set, by a name in `inputs` of an effector.
        input: Option<String> = None;
        /// Sticker that is misread, in reading order: "U1" to "B9".
        sticker: Option<String> = None;
        /// Colour that it shows: the letter of the face that has this colour.
        colour: Option<String> = None;
    }
}

/// Keys that a kind needs besides its time.
#[allow(clippy::struct_excessive_bools, reason = "each field is a column of the table in `needs`")]
struct Needs {
    arm: bool,
    axis: bool,
    camera: bool,
    sensor: bool,
    /// Smallest and largest magnitude; `None` if it has none.
    magnitude: Option<(f64, f64)>,
    /// Whether the fault exists from the beginning, without a time or an event.
    constant: bool,
}

/// Returns which keys a kind of fault needs besides its time, and the range of its magnitude (in
/// the unit of the kind).
fn needs(kind: FaultKind) -> Needs {
    use FaultKind as K;
    let none = Needs {
        arm: false,
        axis: false,
        camera: false,
        sensor: false,
        magnitude: None,
        constant: false,
    };
    let of_arm = |magnitude| Needs { arm: true, magnitude, ..none };
    match kind {
        // Faults of one axis.
        K::EncoderFreeze | K::LimitSwitch => Needs { arm: true, axis: true, ..none },
        K::EncoderJump => Needs { axis: true, ..of_arm(Some((-1e4, 1e4))) },
        K::OverCurrent => Needs { axis: true, ..of_arm(Some((0.0, 1e3))) },
        // Faults of an arm, of its gripper, its force sensor or its messages.
        K::ForceDropout
        | K::ForceNan
        | K::ForceSaturation
        | K::Drop
        | K::DuplicatedMessage
        | K::LostMessage => of_arm(None),
        K::ForceBias => of_arm(Some((-1e3, 1e3))),
        K::Slip => of_arm(Some((0.0, 1.0))),
        K::Push => of_arm(Some((-200.0, 200.0))),
        K::LateMessage => of_arm(Some((0.0, 1e5))),
        // Faults of a camera.
        K::CameraBlackout | K::CameraSilent => Needs { camera: true, ..none },
        K::LateFrames => Needs { camera: true, magnitude: Some((0.0, 1e4)), ..none },
        // Faults of a sensor that the program adds.
        K::SensorSilent | K::SensorFrozen => Needs { sensor: true, ..none },
        K::LateMeasurements => Needs { sensor: true, magnitude: Some((0.0, 1e5)), ..none },
        // Faults of the servo, of the cube and of the clock.
        K::MissedPeriods => Needs { magnitude: Some((1.0, 1e4)), ..none },
        K::Jam => Needs { magnitude: Some((0.0, 100.0)), ..none },
        K::TurnUndone => Needs { magnitude: Some((0.01, 60.0)), ..none },
        K::ClockJump => Needs { magnitude: Some((1.0, 1e6)), ..none },
        // Errors of the cell, which no event begins.
        K::UnderConstrained | K::OverConstrained => Needs { constant: true, ..of_arm(None) },
        K::JawCalibration => Needs { constant: true, ..of_arm(Some((-20.0, 20.0))) },
        K::BaseCalibration => Needs { constant: true, ..of_arm(Some((-100.0, 100.0))) },
        // The other keys of these are checked in `actor` and `sticker`, or they have none.
        K::Withdraw
        | K::Input
        | K::Misread
        | K::ActorPanic
        | K::ActorHang
        | K::ActorSpin
        | K::HeartBeatLoss
        | K::NodeDies
        | K::DiskFull
        | K::DiskError
        | K::TornWrite
        | K::LostWrite
        | K::EmergencyStop
        | K::PowerCut => none,
    }
}

impl FaultKeys {
    /// Returns which sticker is misread (0..=53) and which colour it shows (0..=5), both in the
    /// order URFDLB. Returns `None` if the keys `sticker` and `colour` do not say so.
    #[must_use]
    pub fn misread(&self) -> Option<(usize, u8)> {
        let letter = |c: char| Face::ALL.iter().position(|f| f.letter() == c);
        let mut sticker = self.sticker.as_deref()?.chars();
        let face = letter(sticker.next()?)?;
        let number = sticker.as_str().parse::<usize>().ok().filter(|n| (1..=9).contains(n))?;
        let mut colour = self.colour.as_deref()?.chars();
        let colour = letter(colour.next()?).filter(|_| colour.as_str().is_empty())?;
        Some((face * 9 + number - 1, colour as u8))
    }
}

/// Parts of a cell that can fail.
#[derive(Clone, Copy)]
pub(super) struct Parts<'a> {
    pub(super) effectors: &'a [Effector],
    pub(super) cameras: &'a [CameraKeys],
    pub(super) vsps: &'a [Vsp],
}

/// Checks an injected fault: its keys against its kind, and the names of `parts` in it. `path` is
/// its dotted name.
pub(super) fn check(fault: &FaultKeys, path: &str, parts: Parts<'_>, reader: &mut Reader) {
    // A key whose value could not be read has its fault already. It must not count as missing too.
    if unread(fault).iter().any(|key| reader.is_given(&format!("{path}.{key}"))) {
        return;
    }
    // The rules below depend on the kind, so none of them applies without it.
    let Some(kind) = fault.kind else {
        reader.fault(path, format!("`{path}.kind` is missing"));
        return;
    };
    let mut check = Check { fault, kind, needs: needs(kind), wrong: Vec::new() };
    check.beginning();
    check.arms(parts.effectors);
    check.camera(parts.cameras);
    check.sensor(parts.vsps);
    check.magnitude();
    check.actor();
    check.direction();
    check.sticker();
    check.file();
    check.input(parts.effectors);
    for (key, reason) in check.wrong {
        reader.fault(&format!("{path}.{key}"), format!("`{path}.{key}`: {reason}"));
    }
}

/// Returns the keys without a value: they are not given, or their value could not be read.
fn unread(fault: &FaultKeys) -> Vec<&'static str> {
    let keys = [
        ("kind", fault.kind.is_none()),
        ("at_s", fault.at.is_none()),
        ("event", fault.event.is_none()),
        ("event_arm", fault.event_arm.is_none()),
        ("duration_s", fault.duration.is_none()),
        ("magnitude", fault.magnitude.is_none()),
        ("arm", fault.arm.is_none()),
        ("axis", fault.axis.is_none()),
        ("camera", fault.camera.is_none()),
        ("sensor", fault.sensor.is_none()),
        ("actor", fault.actor.is_none()),
        ("node", fault.node.is_none()),
        ("input", fault.input.is_none()),
        ("sticker", fault.sticker.is_none()),
        ("colour", fault.colour.is_none()),
    ];
    keys.into_iter().filter(|(_, none)| *none).map(|(key, _)| key).collect()
}

/// State of the check of a fault.
struct Check<'a> {
    fault: &'a FaultKeys,
    kind: FaultKind,
    needs: Needs,
    /// Wrong keys with the reasons.
    wrong: Vec<(&'static str, String)>,
}

impl Check<'_> {
    /// Adds `key` to the list of wrong keys, with the reason for the user.
    fn wrong(&mut self, key: &'static str, reason: impl Into<String>) {
        self.wrong.push((key, reason.into()));
    }

    /// Checks that either a time or an event begins the fault. A fault that exists for the whole
    /// run, such as a wrong calibration, has neither.
    fn beginning(&mut self) {
        let word = self.kind.word();
        match (self.fault.at, self.fault.event, self.needs.constant) {
            (None, None, false) => self.wrong("kind", format!("\"{word}\" needs at_s or event")),
            (Some(_), Some(_), false) => {
                self.wrong("event", "at_s and event are both set; set only one");
            }
            // One beginning, or none for a constant fault.
            (None, None, true) | (Some(_), None, false) | (None, Some(_), false) => {}
            (at, _, true) => {
                let key = if at.is_some() { "at_s" } else { "event" };
                self.wrong(
                    key,
                    format!("\"{word}\" exists from the beginning: it takes no at_s or event"),
                );
            }
        }
    }

    /// Checks the names of arms. An arm and an axis must be given if the kind needs them.
    fn arms(&mut self, effectors: &[Effector]) {
        let FaultKeys { arm, event_arm, axis, .. } = self.fault;
        for (key, name) in [("arm", arm), ("event_arm", event_arm)] {
            let unknown = |name: &&String| !effectors.iter().any(|e| e.name == **name);
            if let Some(name) = name.as_ref().filter(unknown) {
                self.wrong(key, format!("there is no effector \"{name}\""));
            }
        }
        if self.needs.arm && arm.is_none() {
            self.wrong("kind", format!("\"{}\" needs an arm", self.kind.word()));
        }
        if self.needs.axis && axis.is_none() {
            self.wrong("kind", format!("\"{}\" needs an axis", self.kind.word()));
        }
    }

    /// Checks the name of the camera, which must be given if the kind needs it.
    fn camera(&mut self, cameras: &[CameraKeys]) {
        let camera = &self.fault.camera;
        if let Some(name) = camera.as_ref().filter(|n| !cameras.iter().any(|c| c.name == **n)) {
            self.wrong("camera", format!("there is no camera \"{name}\""));
        }
        if self.needs.camera && camera.is_none() {
            self.wrong("kind", format!("\"{}\" needs a camera", self.kind.word()));
        }
    }

    /// Checks the name of the sensor, which must be given if the kind needs it. The other VSPs
    /// have the faults of their cameras and arms.
    fn sensor(&mut self, vsps: &[Vsp]) {
        let sensor = &self.fault.sensor;
        let is_own = |vsp: &&Vsp| VspKind::WORDS.iter().all(|(word, _)| vsp.kind != *word);
        let unknown = |name: &&String| !vsps.iter().filter(is_own).any(|vsp| vsp.name == **name);
        if let Some(name) = sensor.as_ref().filter(unknown) {
            let reason = match vsps.iter().find(|vsp| vsp.name == *name) {
                Some(vsp) => format!("the VSP \"{name}\" is of the built-in kind \"{}\"", vsp.kind),
                None => format!("there is no VSP \"{name}\""),
            };
            self.wrong("sensor", reason);
        }
        if self.needs.sensor && sensor.is_none() {
            self.wrong("kind", format!("\"{}\" needs a sensor", self.kind.word()));
        }
    }

    /// Checks the magnitude against the range of the kind.
    fn magnitude(&mut self) {
        let (word, magnitude) = (self.kind.word(), self.fault.magnitude);
        match (self.needs.magnitude, magnitude) {
            (Some(_), None) => self.wrong("kind", format!("\"{word}\" needs a magnitude")),
            (Some((low, high)), Some(x)) if !(low..=high).contains(&x) => {
                let reason = format!("{x} is outside {low}..{high}, the range of \"{word}\"");
                self.wrong("magnitude", reason);
            }
            (None, Some(_)) => self.wrong("magnitude", format!("\"{word}\" takes no magnitude")),
            _ => {}
        }
        if self.kind == FaultKind::MissedPeriods && magnitude.is_some_and(|x| x != x.trunc()) {
            self.wrong("magnitude", format!("\"{word}\" needs a whole number of periods"));
        }
    }

    /// Checks that the kind of actor can have this fault, and that `arm` or `camera` says which
    /// actor of that kind has it.
    fn actor(&mut self) {
        use FaultActor as A;
        use FaultKind as K;
        let word = self.kind.word();
        match (self.kind, self.fault.actor) {
            (K::ActorPanic | K::ActorHang | K::ActorSpin, None) => {
                self.wrong("kind", format!("\"{word}\" needs an actor"));
            }
            (K::LateMessage | K::LostMessage, Some(A::Mp | A::Vsp)) => {
                self.wrong(
                    "actor",
                    format!("\"{word}\" affects messages to an \"ecp\" or an \"edp\" only"),
                );
            }
            // Each arm has an ECP and an EDP, each camera a VSP; only MP is unique.
            (_, Some(A::Ecp | A::Edp)) if self.fault.arm.is_none() => {
                self.wrong("actor", "each arm has this actor; set `arm`");
            }
            (_, Some(A::Vsp)) if self.fault.camera.is_none() => {
                self.wrong("actor", "each camera has this actor; set `camera`");
            }
            _ => {}
        }
    }

    /// Checks that a push, or the error of a base, has a direction along an axis of the world, not
    /// about it.
    fn direction(&mut self) {
        let kind = self.kind;
        let is_along = matches!(kind, FaultKind::Push | FaultKind::BaseCalibration);
        if is_along && self.fault.direction > 2 {
            let reason = format!("\"{}\" takes directions 0 to 2 only: along x, y, z", kind.word());
            self.wrong("direction", reason);
        }
    }

    /// Checks that the state of the world loses no writes. Its file stands for the real cell, which
    /// cannot go back in time.
    fn file(&mut self) {
        if (self.kind, self.fault.file) == (FaultKind::LostWrite, FaultFile::World) {
            self.wrong("file", "\"lost_write\" takes \"recording\" or \"journal\"");
        }
    }

    /// Checks the name of the binary input, which must be given if the kind needs it.
    fn input(&mut self, effectors: &[Effector]) {
        if self.kind != FaultKind::Input {
            return;
        }
        match &self.fault.input {
            None => self.wrong("kind", "\"input\" needs an input"),
            Some(name) if !effectors.iter().any(|e| e.inputs.contains(name)) => {
                self.wrong("input", format!("no effector has an input \"{name}\""));
            }
            Some(_) => {}
        }
    }

    /// Checks that the sticker and colour of a misread sticker can be parsed.
    fn sticker(&mut self) {
        if self.kind == FaultKind::Misread && self.fault.misread().is_none() {
            let key = if self.fault.sticker.is_some() { "sticker" } else { "kind" };
            let reason =
                "\"misread\" needs a sticker, \"U1\" to \"B9\", and a colour, one of URFDLB";
            self.wrong(key, reason);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Returns the faults of a scenario with one injected fault, whose keys are `text`; or the
    /// number of injected faults and "fine" if there are none.
    fn faults(text: &str) -> String {
        let text = format!("task = \"face_turn\"\n[[fault]]\n{text}");
        match crate::tasks::read(Path::new("f.toml"), &text, &[]) {
            Ok(scenario) => format!("{} fine", scenario.plant.faults.len()),
            Err(faults) => faults.to_string(),
        }
    }

    #[test]
    fn injected_fault_uses_si_units_and_accepts_overrides() {
        let text = "[[fault]]\nname = \"a\"\nkind = \"encoder_jump\"\narm = \"track\"\n\
                    axis = 3\nmagnitude = 2\n\
                    event = \"turned\"\nturned_deg = 90";
        let over = crate::scenario::Override::parse("fault.a.axis=4").unwrap();
        let read = crate::tasks::read(Path::new("f.toml"), text, &[over]).unwrap();

        let fault = &read.plant.faults[0];
        assert_eq!(fault.kind, Some(FaultKind::EncoderJump));
        assert_eq!((fault.axis, fault.magnitude), (Some(4), Some(2.0)));
        assert!((fault.turned - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn wrong_fault_keys_are_reported_with_line_number() {
        let missing = faults("kind = \"over_current\"\nat_s = 1");
        for what in ["f.toml:3:8", "needs an arm", "needs an axis", "needs a magnitude"] {
            assert!(missing.contains(what), "{missing}");
        }
        let unknown = faults("kind = \"drop\"\narm = \"trac\"\nat_s = 1");
        assert!(
            unknown.contains("f.toml:4:7") && unknown.contains("no effector \"trac\""),
            "{unknown}"
        );
        let both = faults("kind = \"drop\"\narm = \"track\"\nat_s = 1\nevent = \"grasped\"");
        assert!(both.contains("set only one"), "{both}");
        assert!(faults("kind = \"drops\"\nat_s = 1").contains("did you mean \"drop\"?"));
        assert!(faults("at_s = 1").contains("kind` is missing"));
        // A value that cannot be read is told once, and does not count as missing too.
        let unread = faults("kind = \"drop\"\narm = \"track\"\nevent = \"touched\"");
        assert!(unread.contains("\"touched\" is not a possible value"), "{unread}");
        assert!(!unread.contains("needs at_s") && unread.starts_with("f.toml:5:"), "{unread}");
        let range = faults("kind = \"slip\"\narm = \"track\"\nat_s = 1\nmagnitude = 3");
        assert!(range.contains("f.toml:6:13") && range.contains("outside 0..1"), "{range}");
        let whose = faults("kind = \"actor_panic\"\nactor = \"ecp\"\nat_s = 1");
        assert!(whose.contains("set `arm`"), "{whose}");
        let way = faults("kind = \"lost_message\"\nactor = \"mp\"\narm = \"track\"\nat_s = 1");
        assert!(way.contains("f.toml:4:9") && way.contains("an \"ecp\" or an \"edp\""), "{way}");
        let part = faults("kind = \"missed_periods\"\nat_s = 1\nmagnitude = 1.5");
        assert!(part.contains("f.toml:5:") && part.contains("whole number"), "{part}");
        let rail = |arm: &str| {
            faults(&format!("kind = \"limit_switch\"\narm = \"{arm}\"\naxis = 0\nat_s = 1"))
        };
        assert!(rail("postument").contains("the postument has no axis 0"), "{}", rail("postument"));
        assert_eq!(rail("track"), "1 fine");
        let never = faults("kind = \"jaw_calibration\"\narm = \"track\"\nmagnitude = 1\nat_s = 1");
        assert!(never.contains("from the beginning"), "{never}");
        let input = faults("kind = \"input\"\ninput = \"door\"\nat_s = 1");
        assert!(input.contains("no effector has an input \"door\""), "{input}");
        let sensor = |name: &str| faults(&format!("kind = \"sensor_silent\"\nat_s = 1{name}"));
        assert!(sensor("").contains("needs a sensor"), "{}", sensor(""));
        let nothing = sensor("\nsensor = \"gap\"");
        assert!(nothing.contains("f.toml:5:") && nothing.contains("no VSP \"gap\""), "{nothing}");
        let force = sensor("\nsensor = \"mpf\"");
        assert!(force.contains("the VSP \"mpf\" is of the built-in kind \"force\""), "{force}");
    }

    #[test]
    fn only_real_cell_loses_no_writes() {
        let lost = |kind: &str, file: &str| {
            faults(&format!("kind = \"{kind}\"\nfile = \"{file}\"\nat_s = 1"))
        };

        assert!(lost("lost_write", "world").contains("takes \"recording\" or \"journal\""));
        for (kind, file) in [("lost_write", "journal"), ("torn_write", "world")] {
            assert_eq!(lost(kind, file), "1 fine", "{kind} {file}");
        }
    }

    #[test]
    fn sticker_is_named_by_face_and_number() {
        let keys = |sticker: &str, colour: &str| FaultKeys {
            sticker: Some(sticker.to_owned()),
            colour: Some(colour.to_owned()),
            ..FaultKeys::default()
        };
        let (sticker, colour) = keys("F3", "R").misread().unwrap();
        let solved = crate::cube::Facelets::solved();
        assert_eq!((sticker, solved.colours()[sticker], colour), (20, 2, 1));
        for (sticker, colour) in [("F0", "R"), ("X1", "R"), ("F10", "R"), ("F1", "RR"), ("", "R")] {
            assert_eq!(keys(sticker, colour).misread(), None, "{sticker} {colour}");
        }
    }
}
