//! The keys that the controller may read, section by section.
//!
//! Lengths, angles and times are in SI in the fields and in the unit of the key in a scenario.
//! Numbers come from the 2008 sources of the original where they exist, and were chosen for this
//! cell otherwise.

use super::section::{section, words};
use crate::hw::devices::usual_place;

words! {
    /// What a run is to do.
    pub Task {
        /// The mission: take the cube, read it, solve it, give it back.
        Solve = "solve",
        /// Both arms hold the cube and turn one layer.
        FaceTurn = "face_turn",
        /// Take the cube and give it back, and nothing else.
        Acquire = "acquire",
        /// Hold the arms where they are: to try an arm, a bridge or the servo's timing.
        Idle = "idle",
    }
}

words! {
    /// Who or what has the cube at first, and gets it in the end.
    pub Keeper {
        /// A person's hand brings it, and takes it back.
        Person = "person",
        /// It lies on the table, and is put down there; no person is in the cell.
        Table = "table",
    }
}

words! {
    /// Who makes the set values of the arms (Zieliński et al. 2007, p. 369).
    pub Coordination {
        /// MP invokes behaviours; ECPs run the generators.
        Sporadic = "sporadic",
        /// MP's generators command both arms at each macrostep; ECPs transmit.
        Continuous = "continuous",
    }
}

words! {
    /// Which clock drives a run.
    pub Pace {
        /// As fast as it computes; repeatable to the bit.
        Virtual = "virtual",
        /// The wall clock.
        RealTime = "real-time",
    }
}

words! {
    /// What is behind the hardware port.
    pub BridgeKind {
        /// The simulated plant.
        Plant = "plant",
        /// The simulated plant behind the serial protocol, without lines: every byte of it, under
        /// any clock.
        Wire = "wire",
        /// The original's serial axis controllers, one line an axis.
        Serial = "serial",
        /// The original's ISA boards.
        Isa = "isa",
    }
}

words! {
    /// Which arm yields while both hold the cube.
    pub CompliantArm {
        /// The arm that holds the body and does not turn: the paper.
        Body = "body",
        /// The arm that turns: the sources of 2008.
        Turner = "turner",
    }
}

words! {
    /// Which directions yield while both arms hold the cube.
    pub Compliance {
        /// None: position control.
        None = "none",
        /// x, y, z and the turn's axis: the original.
        Tff = "tff",
        /// All six.
        TffTilts = "tff_tilts",
    }
}

words! {
    /// How regrasps are planned.
    pub Rule {
        /// Palms stand off: a finger may lie on the face under the other palm.
        Clearance = "clearance",
        /// Palms press the cube: the face under a palm is forbidden to fingers.
        Strict = "strict",
        /// The original's two operations, face turn and face change.
        Original = "original",
    }
}

words! {
    /// Which solution of the cube is carried out.
    pub Strategy {
        /// Of many that two-phase finds, the one that takes two arms the least time.
        Robot = "robot",
        /// The paper's: Korf's search up to 16 turns, and two-phase where that takes too long; the
        /// shortest counts.
        Paper = "paper",
    }
}

words! {
    /// How the cube is found in an image.
    pub Detector {
        /// Edges and a vote of lattices.
        Lattice = "lattice",
        /// The paper's: colour thresholds, regions, filters, corner tiles.
        Paper = "paper",
    }
}

section! {
    /// What is behind the hardware port.
    pub Bridge {
        /// The simulated plant, or real controllers.
        kind: BridgeKind = BridgeKind::Plant;
        /// File that names the devices of real controllers, from the scenario's folder. When not
        /// given: `rubik-robot-devices.toml` in `$XDG_RUNTIME_DIR`, or else in /tmp, where
        /// `rubik-robot emulate` writes it.
        devices: Option<String> = None;
        /// Answers that one axis misses in a row before its line is given up.
        missed_answers: u32 = 3, 1.0..=50.0;
    }
}

impl BridgeKind {
    /// Whether something outside this process is behind the port, of which nobody here knows the
    /// truth.
    #[must_use]
    pub(crate) fn is_hardware(self) -> bool {
        matches!(self, Self::Serial | Self::Isa)
    }
}

impl Bridge {
    /// Where the file of devices is, for the scenario at `path`.
    #[must_use]
    pub(crate) fn devices_at(&self, path: &std::path::Path) -> std::path::PathBuf {
        let Some(devices) = &self.devices else { return usual_place() };
        path.parent().map_or_else(Default::default, |folder| folder.join(devices))
    }
}

section! {
    /// What the cell is built of, apart from arms and cameras.
    pub(crate) CellKeys {
        /// Height of the table top, with the tray, above the floor.
        table_height [mm]: f64 = 700.0, 0.0..=2000.0;
    }
}

section! {
    /// The cube. Its state is the plant's; its size is measured by the workshop.
    pub(crate) CubeKeys {
        /// "random" (from the seed) or 54 letters URFDLB by faces, each face in reading order.
        state: String = "random".to_owned();
        /// Edge of the whole cube.
        edge [mm]: f64 = 57.0, 40.0..=80.0;
        /// Mass.
        mass [g]: f64 = 100.0, 20.0..=500.0;
    }
}

section! {
    /// Where the cube is handed over, as the controller believes.
    pub(crate) HandKeys {
        /// Who or what has the cube at first, and gets it in the end.
        keeper: Keeper = Keeper::Person;
        /// Centre of the place in the world: x away from the arms, y from track to postument, z up.
        /// On a table z is that of a cube which lies there.
        centre_xyz [mm]: [f64; 3] = [950.0, 0.0, 1000.0], -5000.0..=5000.0;
        /// Roll, pitch, yaw of the cube there: with 0 its R faces +x, B +y, U +z. On a table roll
        /// and pitch are 0.
        cube_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Half the size of the box in which the cube may be; along x and y on a table.
        half_extent_xyz [mm]: [f64; 3] = [60.0, 100.0, 80.0], 0.0..=1000.0;
    }
}

words! {
    /// Which defaults the section `control` has.
    pub Profile {
        /// Gentle: arms of any workshop can do it.
        Workshop = "workshop",
        /// Fast: as fast as motors and permitted force allow, and for the simulated plant only.
        Swift = "swift",
    }
}

impl Profile {
    /// Returns the profile where none is chosen.
    #[must_use]
    pub(crate) fn usual(bridge: BridgeKind) -> Self {
        if bridge.is_hardware() { Self::Workshop } else { Self::Swift }
    }

    /// Returns the keys that differ from the defaults, in TOML.
    #[must_use]
    pub(crate) fn text(self) -> &'static str {
        match self {
            Self::Workshop => "",
            Self::Swift => include_str!("../../scenarios/profiles/swift.toml"),
        }
    }
}

words! {
    /// How far the track draws back between two meetings of the hands.
    pub Separation {
        /// By the same way each time.
        Full = "full",
        /// As far as the way from grasp to grasp needs it.
        Least = "least",
    }
}

section! {
    /// The controller's gains, speeds and limits.
    pub Control {
        /// Which defaults the other keys of this section have. When not given: "swift" in
        /// simulation, "workshop" on hardware.
        profile: Option<Profile> = None;
        /// Servo periods (2 ms) in one command of a generator.
        macrostep_periods: u32 = 8, 1.0..=100.0;
        /// Which arm yields while both hold the cube.
        compliant_arm: CompliantArm = CompliantArm::Body;
        /// Which directions yield while both hold the cube.
        compliance: Compliance = Compliance::Tff;
        /// Reciprocal damping b of a yielding linear direction; stable for b <= 0.4 / (stiffness x
        /// delay).
        linear_admittance [mm_sn]: f64 = 1.0, 0.0..=50.0;
        /// Virtual mass m of a yielding linear direction; 0 is the paper's plain scaling.
        linear_inertia [kg]: f64 = 20.0, 0.0..=1000.0;
        /// Reciprocal damping b of a yielding rotation.
        angular_admittance [rad_snm]: f64 = 0.05, 0.0..=5.0;
        /// Virtual inertia m of a yielding rotation.
        angular_inertia [kgm2]: f64 = 0.5, 0.0..=100.0;
        /// Frequency at which an arm that holds a tool gives way: each direction that a force moves
        /// is checked against it.
        resonance [hz]: f64 = 31.0, 5.0..=200.0;
        /// Damping of that vibration, 1 is critical.
        resonance_damping: f64 = 0.05, 0.001..=1.0;
        /// Torque with which a layer is turned.
        turn_torque [nm]: f64 = 2.5, 0.1..=10.0;
        /// Least mean torque that a turning layer must show: below it a grip slips instead.
        turn_least_torque [nm]: f64 = 0.04, 0.0..=1.0;
        /// Speed of a turn in free motion.
        turn_speed [deg_s]: f64 = 25.0, 1.0..=180.0;
        /// Acceleration at both ends of a turn.
        turn_acceleration [deg_s2]: f64 = 57.3, 10.0..=400.0;
        /// Grip force of the jaws on the cube.
        grip [n]: f64 = 40.0, 1.0..=100.0;
        /// Force at which a step with contact is broken off.
        force_limit [n]: f64 = 20.0, 1.0..=65.0;
        /// Torque at which a step with contact is broken off.
        torque_limit [nm]: f64 = 4.5, 0.1..=5.0;
        /// Largest speed of an arm where the operator's hand may be: what ISO 10218 calls reduced
        /// speed.
        hand_speed [mm_s]: f64 = 250.0, 10.0..=1000.0;
        /// Speed of straight lines to and from the operator's hand.
        hand_line_speed [mm_s]: f64 = 150.0, 1.0..=500.0;
        /// Force at which any motion of an arm is broken off there.
        hand_force [n]: f64 = 20.0, 1.0..=65.0;
        /// Force with which the last approach and the hand-over stop at contact.
        approach_force [n]: f64 = 4.0, 0.5..=20.0;
        /// Speed of the last approach of a grasp.
        approach_speed [mm_s]: f64 = 10.0, 0.5..=50.0;
        /// How far the track draws back between two meetings of the hands.
        separation: Separation = Separation::Full;
        /// Distance from the cube at which the last approach of a grasp begins.
        pre_grasp [mm]: f64 = 12.0, 2.0..=30.0;
        /// Speed of closing jaws near the cube (original: 0.05 mm per 16 ms).
        jaw_close_speed [mm_s]: f64 = 12.0, 0.5..=50.0;
        /// Speed of closing jaws until they are 5 mm wider than the cube.
        jaw_reach_speed [mm_s]: f64 = 12.0, 0.5..=100.0;
        /// How much wider than the cube the jaws open to pass it from hand to hand.
        jaw_room [mm]: f64 = 31.0, 8.0..=31.0;
        /// Least time in which a hand opens to leave its partner.
        jaw_leave [ms]: f64 = 1200.0, 100.0..=5000.0;
        /// Largest speed of opening jaws (original: 20 mm in 2 s).
        jaw_open_speed [mm_s]: f64 = 30.0, 0.5..=50.0;
        /// Speed of joints in free motion (original: half of 1.5 rad/s).
        joint_speed [deg_s]: f64 = 43.0, 1.0..=200.0;
        /// Most of it for the tool's roll, whose gear allows half of what the other axes can do.
        roll_speed [deg_s]: f64 = 45.0, 1.0..=90.0;
        /// Acceleration of joints in free motion (original: a tenth of 7 rad/s2).
        joint_acceleration [deg_s2]: f64 = 80.0, 1.0..=400.0;
        /// Time in which a free motion comes to its full speed. A motion of less than two such
        /// ramps is one of minimum jerk.
        ramp [ms]: f64 = 5000.0, 50.0..=60000.0;
        /// Speed of the prismatic track.
        track_speed [mm_s]: f64 = 150.0, 1.0..=160.0;
        /// Acceleration of the prismatic track.
        track_acceleration [mm_s2]: f64 = 300.0, 1.0..=2000.0;
        /// Speed of the tool on straight lines.
        linear_speed [mm_s]: f64 = 150.0, 1.0..=500.0;
        /// Acceleration of the tool on straight lines.
        linear_acceleration [mm_s2]: f64 = 300.0, 1.0..=5000.0;
        /// Rotation of the tool on straight lines.
        angular_speed [deg_s]: f64 = 40.0, 1.0..=180.0;
        /// 1, or -1 to spoil the controller: the force reading changes its sign.
        force_sign: i32 = 1, -1.0..=1.0;
        /// Servo periods by which force readings are late, to spoil the controller.
        force_delay_periods: u32 = 0, 0.0..=63.0;
    }
}

impl Control {
    /// Returns speed (m/s) and force (N) with which the visual servo approaches a cube. A hand that
    /// holds it gives way: at 300 N/m the arm would push it 13 mm before 4 N are felt.
    #[must_use]
    pub(crate) fn visual_approach(&self) -> (f64, f64) {
        (2.0 * self.approach_speed, 0.5 * self.approach_force)
    }
}

section! {
    /// The generator that follows the cube by the stand-alone camera.
    pub VisualServo {
        /// Distance before the cube at which the gripper waits until the cube stands still.
        stand_off [mm]: f64 = 100.0, 20.0..=400.0;
        /// Largest speed while following.
        linear_speed [mm_s]: f64 = 120.0, 1.0..=500.0;
        /// Largest rotation while following.
        angular_speed [deg_s]: f64 = 25.0, 1.0..=180.0;
        /// The cube stands still when it stays within this distance...
        still [mm]: f64 = 6.0, 0.1..=50.0;
        /// ... for this long.
        still_time [ms]: f64 = 600.0, 40.0..=10000.0;
        /// The arm backs off when the cube moves this far; where the gripper hides it, 50 mm at
        /// least, and 300 at most.
        withdraw [mm]: f64 = 50.0, 1.0..=250.0;
        /// Virtual mass of the approach to the cube. That approach goes twice as fast as the one to
        /// a partner's cube, and stops at half of the force.
        inertia [kg]: f64 = 20.0, 0.0..=1000.0;
        /// A pose older than this is no longer followed; they come each 40 ms.
        pose_age [ms]: f64 = 100.0, 60.0..=2000.0;
        /// The task fails when no cube came within this time, when a limit kept the arm from it for
        /// so long, or when it did not stand still in five times this.
        patience [s]: f64 = 60.0, 1.0..=3600.0;
    }
}

section! {
    /// The vision of all cameras.
    pub VisionKeys {
        /// How the stand-alone camera's sensor finds the cube.
        detector: Detector = Detector::Lattice;
        /// Declared time of one localisation on the virtual clock.
        localisation [ms]: f64 = 6.0, 0.0..=1000.0;
        /// Declared time of reading one face on the virtual clock.
        face [ms]: f64 = 10.0, 0.0..=1000.0;
    }
}

section! {
    /// Solver and regrasp planner.
    pub Planner {
        /// How regrasps are planned.
        rule: Rule = Rule::Clearance;
        /// Which solution is carried out.
        strategy: Strategy = Strategy::Robot;
        /// Nodes that Korf's search may visit before two-phase takes over (strategy "paper").
        korf_node_budget: u64 = 20_000_000, 0.0..=1e12;
        /// Nodes that the search for turns may visit.
        node_budget: u64 = 1_000_000, 1000.0..=1e12;
        /// Solutions that are compared by their regrasps.
        candidates: u32 = 10000, 1.0..=100000.0;
        /// Declared cost of one node on the virtual clock.
        node_cost [us]: f64 = 0.1, 0.0..=1000.0;
    }
}

section! {
    /// What `task = "idle"` does.
    pub Idle {
        /// How long the arms are held.
        time [s]: f64 = 10.0, 0.01..=86400.0;
    }
}

section! {
    /// What `task = "face_turn"` does.
    pub FaceTurn {
        /// How far the layer is turned; positive is clockwise seen from outside.
        angle [deg]: f64 = 90.0, -180.0..=180.0;
    }
}

section! {
    /// The servo's thread under the wall clock.
    pub RealTime {
        /// Length of a servo period; a command of `control.macrostep_periods` (of 2 ms) must last
        /// whole ones.
        period [ms]: f64 = 2.0, 0.5..=20.0;
        /// Length of the last part of each wait that is spun away; 0 sleeps all of it.
        spin [us]: f64 = 100.0, 0.0..=1000.0;
        /// Priority of the servo's thread in the first-in, first-out class; the bridge's thread has
        /// 5 less.
        priority: i32 = 85, 6.0..=99.0;
        /// Core that the servo's thread stays on; the scheduler's choice when not given.
        core: Option<u32> = None, 0.0..=1023.0;
        /// Periods missed in a row after which the arms are brought to a stand and stop. Left out:
        /// 20 on hardware, whose controllers stop by themselves 50 ms after the last order, and 50
        /// with the simulated plant, since gaps of up to 45 ms come from below virtual machines.
        missed_limit: Option<u32> = None, 1.0..=10000.0;
    }
}

section! {
    /// The regulators of all axes; their gains are the data of each effector's `servo_profile`.
    pub(crate) Servo {
        /// Factor of the gains b0 and b1 of every axis.
        gain_factor: f64 = 1.0, 0.0..=10.0;
        /// Largest pulse width, of 255; the profile's when not given.
        pwm_limit: Option<f64> = None, 1.0..=255.0;
        /// Following error that stops an arm, as motor angle; the profile's when not given.
        following_error [rad]: Option<f64> = None, 0.01..=1000.0;
    }
}
