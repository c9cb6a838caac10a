//! The keys that the controller may read, section by section.
//!
//! Lengths, angles and times are in SI in the fields and in the unit of the key in a scenario. The
//! default values come from the 2008 sources of the original if they exist there, and were chosen
//! for this cell otherwise.

use super::section::{section, words};
use crate::hw::devices::default_path;

words! {
    /// Keeper of the cube before and after a mission.
    pub Keeper {
        /// A person brings the cube and takes it back.
        Person = "person",
        /// The cube lies on the table, and the robot puts it back there; no person is in the cell.
        Table = "table",
    }
}

words! {
    /// Process that makes the set values of the arms (Zieliński et al. 2007, p. 369).
    pub Coordination {
        /// MP invokes behaviours, and the ECPs run the generators.
        Sporadic = "sporadic",
        /// MP's generators command all arms at each macrostep, and the ECPs transmit.
        Continuous = "continuous",
        /// MP is dormant, and each ECP carries out a programme of its own.
        Absent = "absent",
    }
}

words! {
    /// Clock that drives a run.
    pub Pace {
        /// Virtual time: as fast as the computer allows, and repeatable to the bit.
        Virtual = "virtual",
        /// The wall clock.
        RealTime = "real-time",
    }
}

words! {
    /// Kind of connection behind the hardware port.
    pub BridgeKind {
        /// The simulated plant.
        Plant = "plant",
        /// The simulated plant behind the serial protocol, byte by byte, but without lines and
        /// under any clock.
        Wire = "wire",
        /// The serial axis controllers of the original, one line per axis.
        Serial = "serial",
        /// The ISA boards of the original.
        Isa = "isa",
    }
}

words! {
    /// Arm that yields while both hold the cube.
    pub CompliantArm {
        /// The arm that holds the body and does not turn, as in the paper.
        Body = "body",
        /// The arm that turns, as in the sources of 2008.
        Turner = "turner",
    }
}

words! {
    /// Directions that yield while both arms hold the cube.
    pub Compliance {
        /// No direction: position control.
        None = "none",
        /// x, y, z and the axis of the turn, as in the original.
        Tff = "tff",
        /// All six directions.
        TffTilts = "tff_tilts",
    }
}

words! {
    /// Method that finds the cube in an image.
    pub Detector {
        /// Edges, and a vote of lattices.
        Lattice = "lattice",
        /// Colour thresholds, regions and filters, as in the paper, and a vote of lattices.
        Paper = "paper",
        /// All of the paper: the same regions, and the square whose centre tile has the most
        /// neighbours and whose corner tiles have the fewest.
        Square = "square",
    }
}

words! {
    /// Measurement from which the pose of the cube follows.
    pub PoseBy {
        /// Edges of the tiles of all visible faces.
        Edges = "edges",
        /// Centroids of the four corner tiles of the largest face, as in the paper.
        Corners = "corners",
    }
}

section! {
    /// Connection behind the hardware port.
    pub Bridge {
        /// Simulated plant or real controllers behind the hardware port.
        kind: BridgeKind = BridgeKind::Plant;
        /// File that names the devices of real controllers, relative to the scenario's folder; if
        /// not given, `rubik-robot-devices.toml` in `$XDG_RUNTIME_DIR`, or else in /tmp, where
        /// `rubik-robot emulate` writes it. It must belong to this user or to root, and no other
        /// user may write it, unless `--set` names it.
        devices: Option<String> = None;
        /// Number of answers that an axis misses in a row before the bridge gives up its line.
        missed_answers: u32 = 3, 1.0..=50.0;
    }
}

impl BridgeKind {
    /// Returns whether the bridge leads to something outside this process, whose true state the
    /// program cannot know.
    #[must_use]
    pub(crate) fn is_hardware(self) -> bool {
        matches!(self, Self::Serial | Self::Isa)
    }
}

impl Bridge {
    /// Returns the path of the file that names the devices of real controllers. `path` is that of
    /// the scenario.
    #[must_use]
    pub(crate) fn devices_at(&self, path: &std::path::Path) -> std::path::PathBuf {
        let Some(devices) = &self.devices else { return default_path() };
        path.parent().map_or_else(Default::default, |folder| folder.join(devices))
    }
}

section! {
    /// Parts of the cell other than arms and cameras.
    pub(crate) CellKeys {
        /// Height of the table top, with the tray, above the floor.
        table_height [mm]: f64 = 700.0, 0.0..=2000.0;
    }
}

section! {
    /// Cube: its state belongs to the plant, its size and mass are measured.
    pub(crate) CubeKeys {
        /// State of the cube: "random" (from the seed), or 54 letters URFDLB by faces, each face in
        /// reading order.
        state: String = "random".to_owned();
        /// Length of an edge of the whole cube.
        edge [mm]: f64 = 57.0, 40.0..=80.0;
        /// Mass of the cube.
        mass [g]: f64 = 100.0, 20.0..=500.0;
    }
}

section! {
    /// Place of the hand-over, as the controller believes.
    pub(crate) HandKeys {
        /// Keeper of the cube before and after the mission: a person or the table.
        keeper: Keeper = Keeper::Person;
        /// Centre of the hand-over place in the world: x away from the arms, y from track to
        /// postument, z up; on a table z follows from its height.
        centre_xyz [mm]: [f64; 3] = [950.0, 0.0, 1000.0], -5000.0..=5000.0;
        /// Roll, pitch and yaw of the cube there, with R at +x, B at +y and U at +z for zeros; on a
        /// table roll and pitch are 0.
        cube_rpy [deg]: [f64; 3] = [0.0; 3], -180.0..=180.0;
        /// Half the size of the box in which the cube may be; on a table only x and y count.
        half_extent_xyz [mm]: [f64; 3] = [60.0, 100.0, 80.0], 0.0..=1000.0;
    }
}

words! {
    /// Defaults of the section `control`.
    pub Profile {
        /// Gentle motions that the arms of any workshop can make.
        Workshop = "workshop",
        /// Motions as fast as the motors and the permitted force allow, for the simulated plant
        /// only.
        Swift = "swift",
    }
}

impl Profile {
    /// Returns the profile of speeds that applies if the scenario chooses none.
    #[must_use]
    pub(crate) fn usual(bridge: BridgeKind) -> Self {
        if bridge.is_hardware() { Self::Workshop } else { Self::Swift }
    }

    /// Returns the keys of `control` that this profile changes, as TOML; empty if there are none.
    #[must_use]
    pub(crate) fn text(self) -> &'static str {
        match self {
            Self::Workshop => "",
            Self::Swift => include_str!("../../scenarios/profiles/swift.toml"),
        }
    }
}

words! {
    /// Retraction of the track between two meetings of the hands.
    pub Separation {
        /// The same distance each time.
        Full = "full",
        /// The least distance that the path from grasp to grasp needs.
        Least = "least",
    }
}

section! {
    /// Gains, speeds and limits of the controller.
    pub Control {
        /// Profile of defaults of this section; if not given, "swift" in simulation and "workshop"
        /// on hardware.
        profile: Option<Profile> = None;
        /// Length of one command of a generator, in servo periods of 2 ms.
        macrostep_periods: u32 = 8, 1.0..=100.0;
        /// Arm that yields while both hold the cube.
        compliant_arm: CompliantArm = CompliantArm::Body;
        /// Directions that yield while both arms hold the cube.
        compliance: Compliance = Compliance::Tff;
        // The closed chain of both arms has a stiffness of 8 to 45 kN/m. The original's 5 mm/(s N)
        // oscillates with stiff jaws.
        /// Reciprocal damping b of a yielding linear direction; the contact is stable for b <= 0.4
        /// / (stiffness x delay).
        linear_admittance [mm_sn]: f64 = 1.0, 0.0..=50.0;
        // Without this mass a fast approach excites itself through the inertia of the tool
        // (`scenario::motion`).
        /// Virtual mass m of a yielding linear direction; 0 is the plain scaling of the paper.
        linear_inertia [kg]: f64 = 20.0, 0.0..=1000.0;
        /// Reciprocal damping b of a yielding rotation.
        angular_admittance [rad_snm]: f64 = 0.05, 0.0..=5.0;
        /// Virtual inertia m of a yielding rotation.
        angular_inertia [kgm2]: f64 = 0.5, 0.0..=100.0;
        // The visual servo of the simulated cell oscillated at 31 Hz while it had no virtual mass.
        /// Natural frequency of an arm with a tool, for which each force-controlled direction is
        /// checked.
        resonance [hz]: f64 = 31.0, 5.0..=200.0;
        /// Damping of that vibration, as a share of the critical damping.
        resonance_damping: f64 = 0.05, 0.001..=1.0;
        /// Torque of the turn of a layer.
        turn_torque [nm]: f64 = 2.5, 0.1..=10.0;
        /// Smallest mean torque of a turning layer; a smaller one means that the grip slips.
        turn_least_torque [nm]: f64 = 0.04, 0.0..=1.0;
        /// Speed of a turn in free motion.
        turn_speed [deg_s]: f64 = 25.0, 1.0..=180.0;
        /// Acceleration at both ends of a turn.
        turn_acceleration [deg_s2]: f64 = 57.3, 10.0..=400.0;
        /// Grip force of the jaws on the cube.
        grip [n]: f64 = 40.0, 1.0..=100.0;
        /// Force at which a motion in contact is aborted.
        force_limit [n]: f64 = 20.0, 1.0..=65.0;
        /// Torque at which a motion in contact is aborted.
        torque_limit [nm]: f64 = 4.5, 0.1..=5.0;
        /// Largest speed of an arm near the operator's hand (the reduced speed of ISO 10218).
        // The last centimetres of a visual approach are as fast as 26 mm/s.
        hand_speed [mm_s]: f64 = 250.0, 30.0..=1000.0;
        /// Acceleration of the visual servo, which leads an arm to the operator's hand.
        hand_acceleration [mm_s2]: f64 = 300.0, 10.0..=5000.0;
        /// Speed of straight lines to and from the operator's hand.
        hand_line_speed [mm_s]: f64 = 150.0, 1.0..=500.0;
        /// Force at which any motion of an arm near the operator's hand is aborted.
        hand_force [n]: f64 = 20.0, 1.0..=65.0;
        /// Contact force that ends the last approach of a grasp and of the hand-over.
        approach_force [n]: f64 = 4.0, 0.5..=20.0;
        // The momentum of the arm causes a peak of the contact force of 0.94 N per mm/s.
        /// Speed of the last approach of a grasp.
        approach_speed [mm_s]: f64 = 10.0, 0.5..=50.0;
        /// Retraction of the track between two meetings of the hands.
        separation: Separation = Separation::Full;
        /// Distance from the cube at which the last approach of a grasp begins.
        pre_grasp [mm]: f64 = 12.0, 2.0..=30.0;
        // At 50 mm/s they strike the cube with up to 23 N, and a mission takes no less time.
        /// Speed of closing jaws near the cube (original: 0.05 mm per 16 ms).
        jaw_close_speed [mm_s]: f64 = 12.0, 0.5..=30.0;
        // Jaws that met a cube off the middle at 30 mm/s caused 13 to 14 N; with a slow last 5 mm
        // it is 9 to 10 N. The servo stops a jaw motor at 77 mm/s.
        /// Speed of closing jaws until they are 5 mm wider than the cube.
        jaw_reach_speed [mm_s]: f64 = 12.0, 0.5..=70.0;
        /// Opening of the jaws beyond the edge of a cube that the partner holds.
        jaw_room [mm]: f64 = 31.0, 8.0..=31.0;
        /// Shortest time in which a gripper opens to leave the cube.
        jaw_leave [ms]: f64 = 1200.0, 100.0..=5000.0;
        /// Largest speed of opening jaws (original: 20 mm in 2 s).
        jaw_open_speed [mm_s]: f64 = 30.0, 0.5..=50.0;
        /// Speed of joints in free motion (original: half of 1.5 rad/s).
        joint_speed [deg_s]: f64 = 43.0, 1.0..=200.0;
        /// Largest speed of the tool's roll, whose gear allows half the speed of the other axes.
        roll_speed [deg_s]: f64 = 45.0, 1.0..=90.0;
        /// Acceleration of joints in free motion (original: a tenth of 7 rad/s2).
        joint_acceleration [deg_s2]: f64 = 80.0, 1.0..=400.0;
        // With 5 s all motions of less than 10 s have minimum jerk.
        /// Time in which a free motion reaches its full speed; a motion of less than two of these
        /// times has minimum jerk.
        ramp [ms]: f64 = 5000.0, 50.0..=60000.0;
        /// Speed of the prismatic track.
        track_speed [mm_s]: f64 = 150.0, 1.0..=160.0;
        /// Acceleration of the prismatic track.
        track_acceleration [mm_s2]: f64 = 300.0, 1.0..=2000.0;
        /// Speed of the tool on straight lines.
        linear_speed [mm_s]: f64 = 150.0, 1.0..=500.0;
        /// Acceleration of the tool on straight lines.
        linear_acceleration [mm_s2]: f64 = 300.0, 1.0..=5000.0;
        /// Angular speed of the tool on straight lines.
        angular_speed [deg_s]: f64 = 40.0, 1.0..=180.0;
        // Below a fifth a motion lasts longer than the limits of time of its task.
        /// Speed of motions through free space, as a share of the planned one; the times that the
        /// planner expects are those of 100.
        free_speed [percent]: f64 = 100.0, 20.0..=100.0;
        /// Sign of the force readings: 1, or -1 to make the controller wrong for a test.
        force_sign: i32 = 1, -1.0..=1.0;
        /// Delay of the force readings in servo periods, to make the controller wrong for a test.
        force_delay_periods: u32 = 0, 0.0..=63.0;
    }
}

impl Control {
    /// Returns the speed (m/s) and the force (N) with which the visual servo approaches a cube.
    #[must_use]
    pub(crate) fn visual_approach(&self) -> (f64, f64) {
        // A hand that holds the cube yields: at 300 N/m the arm would push it by 13 mm before 4 N
        // are measured. Half of the force halves that.
        (2.0 * self.approach_speed, 0.5 * self.approach_force)
    }
}

section! {
    /// Generator that follows the cube by the stand-alone camera.
    pub VisualServo {
        /// Distance before the cube at which the gripper waits until the cube is still.
        stand_off [mm]: f64 = 100.0, 20.0..=400.0;
        /// Largest speed while the arm follows the cube.
        linear_speed [mm_s]: f64 = 120.0, 1.0..=500.0;
        /// Largest angular speed while the arm follows the cube.
        angular_speed [deg_s]: f64 = 25.0, 1.0..=180.0;
        /// Largest movement of a cube that counts as still.
        still [mm]: f64 = 6.0, 0.1..=50.0;
        /// Time within that movement after which the cube counts as still.
        still_time [ms]: f64 = 600.0, 40.0..=10000.0;
        /// Movement of the cube at which the arm backs off; for a cube that the gripper hides, at
        /// least 50 mm and less than 300 mm.
        withdraw [mm]: f64 = 50.0, 1.0..=250.0;
        /// Virtual mass of the approach to the cube, which has twice the speed and half the force
        /// of the approach to a partner's cube.
        inertia [kg]: f64 = 20.0, 0.0..=1000.0;
        /// Largest age of a pose of the cube that the arm still follows; the poses have a period of
        /// 40 ms.
        pose_age [ms]: f64 = 100.0, 60.0..=2000.0;
        /// Time without a cube, or with a cube out of reach, after which the task fails; five times
        /// as long for a cube that is never still.
        patience [s]: f64 = 60.0, 1.0..=3600.0;
    }
}

section! {
    /// Vision of all cameras.
    pub VisionKeys {
        /// Method by which the stand-alone camera's sensor finds the cube.
        detector: Detector = Detector::Lattice;
        /// Measurement from which that sensor computes the pose of the cube.
        pose: PoseBy = PoseBy::Edges;
        /// Declared time of one localisation on the virtual clock.
        localisation [ms]: f64 = 6.0, 0.0..=1000.0;
        /// Declared time of reading one face on the virtual clock.
        face [ms]: f64 = 10.0, 0.0..=1000.0;
        /// Exposure of all cameras, as a multiple of the one that a task orders.
        exposure: f64 = 1.0, 0.1..=10.0;
    }
}

section! {
    /// Thread of the servo under the wall clock.
    pub RealTime {
        /// Length of a servo period; the length of `control.macrostep_periods` (of 2 ms) must be a
        /// whole number of them.
        period [ms]: f64 = 2.0, 0.5..=20.0;
        /// Last part of each wait in which the thread spins instead of sleeping; 0 sleeps all of
        /// it.
        spin [us]: f64 = 100.0, 0.0..=1000.0;
        /// Priority of the servo's thread in the first-in, first-out class; the bridge's thread has
        /// 5 less.
        priority: i32 = 85, 6.0..=99.0;
        /// Core to which the servo's thread is bound; the scheduler's choice if not given.
        core: Option<u32> = None, 0.0..=1023.0;
        /// Number of periods missed in a row after which the arms brake and stop; if not given, 20
        /// on hardware, whose controllers stop by themselves 50 ms after the last order, and 50
        /// with the simulated plant, since virtual machines cause gaps of up to 45 ms.
        missed_limit: Option<u32> = None, 1.0..=10000.0;
    }
}

section! {
    /// Regulators of all axes, whose gains are the data of each effector's `servo_profile`.
    pub(crate) Servo {
        /// Factor of the gains b0 and b1 of every axis.
        gain_factor: f64 = 1.0, 0.0..=10.0;
        /// Largest pulse width, of 255; that of the servo profile if not given.
        pwm_limit: Option<f64> = None, 1.0..=255.0;
        /// Following error of the motor angle that stops an arm; that of the servo profile if not
        /// given.
        following_error [rad]: Option<f64> = None, 0.01..=1000.0;
    }
}
