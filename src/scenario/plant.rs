//! The keys under `plant`: what only the simulated plant may read.
//!
//! The controller's types do not contain [`PlantKeys`], so nothing of it can look at the truth.

use super::section::{section, words};

words! {
    /// What the finger pads are made of.
    pub Jaws {
        /// Rubber pads.
        Rubber = "rubber",
        /// Bare metal, ground to fit: stiff.
        Stiff = "stiff",
    }
}

words! {
    /// How a cube's layers turn.
    pub CubeKind {
        /// A cube of the paper's time, moderately stiff.
        Of2007 = "2007",
        /// Light and loose.
        Modern = "modern",
        /// Never oiled.
        Dry = "dry",
    }
}

section! {
    /// The simulated plant.
    pub PlantKeys {
        /// Sideways (seeded direction) and axial error of the grasp that `face_turn` starts from.
        grasp_error [mm]: f64 = 0.0, 0.0..=20.0;
        /// Tilt (seeded sideways axis) of that grasp.
        grasp_tilt as grasp_error [deg]: f64 = 0.0, 0.0..=20.0;
        /// Pads of the fingers.
        jaws: Jaws = Jaws::Rubber;
        /// Friction and play of the cube's layers.
        cube_kind: CubeKind = CubeKind::Of2007;
        /// Current that trips the power stage of each axis: d0, q1..q6 (2012 sources: track arm).
        trip_current [a]: [f64; 7] = [25.0, 15.0, 18.0, 10.0, 10.0, 10.0, 10.0], 0.1..=1000.0;
        /// Steps of the simulation in a servo period.
        substeps: u32 = 4, 1.0..=100.0;
        /// Black images from all cameras.
        lens_cap: bool = false;
    } with {
        /// Spread of truth around belief.
        errors: Errors,
        /// Noise of sensors and cameras.
        noise: Noise,
        /// The operator's hand.
        hand: PlantHand,
        /// How the cube lies on the table, with hand.keeper = "table".
        table: PlantTable,
        /// Light on the cell.
        light: Light,
        /// Faults of the lines of bridge.kind = "wire".
        lines: Lines,
    }
}

section! {
    /// What goes wrong on the lines of bridge.kind = "wire", by chance.
    pub Lines {
        /// Share of the axes' answers that never come.
        missed: f64 = 0.0, 0.0..=1.0;
        /// Share of the axes' answers of which one bit is wrong.
        corrupt: f64 = 0.0, 0.0..=1.0;
        /// Share of the periods in which all axes of an arm fall silent together, both ways.
        stalled: f64 = 0.0, 0.0..=0.05;
        /// For so many periods they do; a bridge gives up after 20.
        stall_periods: u32 = 10, 1.0..=19.0;
        /// Share of the force sensors' records that are lost.
        lost: f64 = 0.0, 0.0..=1.0;
    }
}

section! {
    /// Standard deviations of truth around the controller's belief, drawn from the seed.
    pub Errors {
        /// Places of the bases, each axis.
        base [mm]: f64 = 1.0, 0.0..=50.0;
        /// Orientation of the bases, each axis.
        base_tilt as base [deg]: f64 = 0.5, 0.0..=10.0;
        /// Focal lengths.
        focal [percent]: f64 = 0.3, 0.0..=20.0;
        /// Principal points.
        centre [px]: f64 = 1.0, 0.0..=100.0;
        /// Places of the cameras, each axis.
        camera [mm]: f64 = 1.0, 0.0..=50.0;
        /// Orientation of the cameras, each axis.
        camera_tilt as camera [deg]: f64 = 0.2, 0.0..=10.0;
        /// Zero of the jaws.
        jaw [mm]: f64 = 0.3, 0.0..=5.0;
        /// Edge of the cube.
        cube [mm]: f64 = 0.2, 0.0..=5.0;
        /// Bias of the force sensors, forces.
        sensor_bias [n]: f64 = 1.0, 0.0..=50.0;
        /// Bias of the force sensors, torques.
        sensor_torque_bias as sensor_bias [nm]: f64 = 0.05, 0.0..=5.0;
        /// Weight beyond the force sensors.
        weight [n]: f64 = 0.2, 0.0..=10.0;
        /// Its centre of mass, each axis.
        weight_centre [mm]: f64 = 2.0, 0.0..=50.0;
    }
}

section! {
    /// Noise.
    pub Noise {
        /// Force sensors, r.m.s. of each reading.
        force [n]: f64 = 0.05, 0.0..=5.0;
        /// The same of torques.
        torque [nm]: f64 = 0.003, 0.0..=1.0;
        /// Drift of the force sensors' bias in 10 minutes.
        force_drift [n]: f64 = 0.2, 0.0..=10.0;
        /// Servo periods by which a force reading is late.
        force_delay_periods: u32 = 1, 0.0..=100.0;
        /// Pixels, standard deviation of 255.
        image: f64 = 4.0, 0.0..=60.0;
    }
}

section! {
    /// How the operator's hand moves.
    pub PlantHand {
        /// When it starts to bring the cube.
        appears [s]: f64 = 1.0, 0.0..=600.0;
        /// How long it takes to come to the place.
        arrival [s]: f64 = 4.0, 0.1..=60.0;
        /// From where it comes, relative to the place; it leaves towards there as well.
        start_xyz [mm]: [f64; 3] = [250.0, 120.0, -60.0], -2000.0..=2000.0;
        /// Slow sway on the way and after the arrival, r.m.s. of each axis.
        sway [mm]: f64 = 3.0, 0.0..=50.0;
        /// Typical time in which the sway changes.
        sway_time [s]: f64 = 0.7, 0.05..=10.0;
        /// Fast tremor, amplitude of each axis.
        tremor [mm]: f64 = 0.2, 0.0..=5.0;
        /// After its arrival it calms down over this time.
        stills [s]: f64 = 3.0, 0.0..=600.0;
        /// Spread of the place where it holds the cube, each axis, within the hand-over place.
        place_spread [mm]: f64 = 20.0, 0.0..=200.0;
        /// Spread of the tilt with which it holds the cube, each axis.
        tilt_spread [deg]: f64 = 4.0, 0.0..=45.0;
        /// Whether the cube comes in any of its 24 orientations, or as `hand.cube_rpy_deg` says.
        any_orientation: bool = true;
        /// Times that it draws the cube back before it stays.
        withdrawals: u32 = 0, 0.0..=20.0;
        /// How far it draws back.
        withdrawal [mm]: f64 = 150.0, 0.0..=1000.0;
        /// Stiffness with which it holds the cube.
        stiffness [n_m]: f64 = 300.0, 1.0..=10000.0;
        /// Damping of the same.
        damping [ns_m]: f64 = 10.0, 0.0..=1000.0;
        /// Load of the gripper on the cube at which it lets go.
        release [n]: f64 = 8.0, 0.1..=100.0;
        /// It lets go this long after the jaws closed, at the latest.
        release_time [s]: f64 = 2.0, 0.0..=60.0;
        /// It comes back for the cube when this has passed since it let go; 5 s later for one that
        /// never left the zone.
        return_after [s]: f64 = 20.0, 0.0..=3600.0;
        /// A cube that fell is picked up after this time and held out again; 3600 for never.
        picks_up_after [s]: f64 = 5.0, 0.0..=3600.0;
        /// It comes back for a solved cube only.
        return_solved_only: bool = false;
        /// Pull on the cube when it takes it back.
        pull [n]: f64 = 6.0, 0.0..=100.0;
    }
}

section! {
    /// How the cube lies on the table at first.
    pub PlantTable {
        /// Where the middle of the place really is, beside what `hand` says.
        offset_xy [mm]: [f64; 2] = [0.0, 0.0], -1000.0..=1000.0;
        /// Share of `hand.half_extent_xyz_mm` within which it lies, seeded.
        spread: f64 = 0.9, 0.0..=1.0;
        /// It is turned about the vertical by up to so much either way, seeded.
        yaw [deg]: f64 = 45.0, 0.0..=180.0;
        /// Whether it lies on any of its faces, seeded, or with U up.
        any_face: bool = true;
    }
}

section! {
    /// Light.
    pub Light {
        /// Colour temperature; drawn from 2700..7500 K by the seed when not given.
        temperature [k]: Option<f64> = None, 1500.0..=12000.0;
        /// Brightness; 1 exposes well.
        level: f64 = 1.0, 0.05..=4.0;
        /// Red, orange and yellow things on the walls.
        distractors: u32 = 9, 0.0..=50.0;
    }
}
