//! The keys under `plant`, which only the simulated plant may read.
//!
//! The types of the controller do not contain [`PlantKeys`], so the controller cannot read the
//! truth.

use super::section::{section, words};

words! {
    /// Material of the finger pads.
    pub Jaws {
        /// Rubber pads.
        Rubber = "rubber",
        /// Bare metal, ground to fit, and stiff.
        Stiff = "stiff",
    }
}

words! {
    /// Friction and play of the layers of a cube.
    pub CubeKind {
        /// Moderately stiff, as cubes were at the paper's time.
        Of2007 = "2007",
        /// Light and loose.
        Modern = "modern",
        /// Never oiled.
        Dry = "dry",
    }
}

section! {
    /// Simulated plant.
    pub PlantKeys {
        /// Sideways (seeded direction) and axial error of the grasp from which `face_turn` starts.
        grasp_error [mm]: f64 = 0.0, 0.0..=20.0;
        /// Tilt of that grasp about a seeded sideways axis.
        grasp_tilt as grasp_error [deg]: f64 = 0.0, 0.0..=20.0;
        /// Material of the finger pads.
        jaws: Jaws = Jaws::Rubber;
        /// Friction and play of the layers of the cube.
        cube_kind: CubeKind = CubeKind::Of2007;
        /// Current that trips the power stage of each axis: d0, q1..q6 (2012 sources: track arm).
        trip_current [a]: [f64; 7] = [25.0, 15.0, 18.0, 10.0, 10.0, 10.0, 10.0], 0.1..=1000.0;
        /// Number of simulation steps in a servo period.
        substeps: u32 = 4, 1.0..=100.0;
        /// Whether all cameras deliver black images.
        lens_cap: bool = false;
    } with {
        /// Spread of the truth around the belief.
        errors: Errors,
        /// Noise of sensors and cameras.
        noise: Noise,
        /// Motion of the operator's hand.
        hand: PlantHand,
        /// Position of the cube on the table, with hand.keeper = "table".
        table: PlantTable,
        /// Light in the cell.
        light: Light,
        /// Random faults of the lines of bridge.kind = "wire".
        lines: Lines,
    }
}

section! {
    /// Random faults of the lines of bridge.kind = "wire".
    pub Lines {
        /// Share of the answers of axes that are lost.
        missed: f64 = 0.0, 0.0..=1.0;
        /// Share of the answers of axes in which one bit is wrong.
        corrupt: f64 = 0.0, 0.0..=1.0;
        /// Share of the periods in which a silence of all axes of an arm begins: no order reaches
        /// them, and none of their answers arrives.
        stalled: f64 = 0.0, 0.0..=0.05;
        /// Length of that silence in periods; a bridge gives up after 20.
        stall_periods: u32 = 10, 1.0..=19.0;
        /// Share of the records of force sensors that are lost.
        lost: f64 = 0.0, 0.0..=1.0;
    }
}

section! {
    /// Standard deviations of the truth around the controller's belief, drawn from the seed.
    pub Errors {
        /// Error of the positions of the bases, per axis. The first arm defines the world, so its
        /// base has none.
        base [mm]: f64 = 1.0, 0.0..=50.0;
        /// Error of the orientations of the bases, per axis, but for the first one.
        base_tilt as base [deg]: f64 = 0.5, 0.0..=10.0;
        /// Error of the focal lengths.
        focal [percent]: f64 = 0.3, 0.0..=20.0;
        /// Error of the principal points.
        centre [px]: f64 = 1.0, 0.0..=100.0;
        /// Error of the positions of the cameras, per axis.
        camera [mm]: f64 = 1.0, 0.0..=50.0;
        /// Error of the orientations of the cameras, per axis.
        camera_tilt as camera [deg]: f64 = 0.2, 0.0..=10.0;
        /// Error of the zero of the jaws.
        jaw [mm]: f64 = 0.3, 0.0..=5.0;
        /// Error of the edge of the cube.
        cube [mm]: f64 = 0.2, 0.0..=5.0;
        /// Bias of the force sensors for forces.
        sensor_bias [n]: f64 = 1.0, 0.0..=50.0;
        /// Bias of the force sensors for torques.
        sensor_torque_bias as sensor_bias [nm]: f64 = 0.05, 0.0..=5.0;
        /// Error of the weight beyond the force sensors.
        weight [n]: f64 = 0.2, 0.0..=10.0;
        /// Error of the centre of mass of that weight, per axis.
        weight_centre [mm]: f64 = 2.0, 0.0..=50.0;
    }
}

section! {
    /// Noise of sensors and cameras.
    pub Noise {
        /// Noise of the force sensors, r.m.s. of each reading of a force.
        force [n]: f64 = 0.05, 0.0..=5.0;
        /// Noise of the force sensors, r.m.s. of each reading of a torque.
        torque [nm]: f64 = 0.003, 0.0..=1.0;
        /// Drift of the bias of the force sensors in 10 minutes.
        force_drift [n]: f64 = 0.2, 0.0..=10.0;
        /// Delay of a force reading in servo periods.
        force_delay_periods: u32 = 1, 0.0..=100.0;
        /// Noise of pixels, standard deviation on a scale of 255.
        image: f64 = 4.0, 0.0..=60.0;
    }
}

section! {
    /// Motion of the operator's hand.
    pub PlantHand {
        // The numbers of the hand are assumptions.
        /// Time at which the hand starts to bring the cube.
        appears [s]: f64 = 1.0, 0.0..=600.0;
        /// Time in which the hand moves to the hand-over place.
        arrival [s]: f64 = 4.0, 0.1..=60.0;
        /// Start of the hand, relative to the hand-over place; it leaves towards there as well.
        start_xyz [mm]: [f64; 3] = [250.0, 120.0, -60.0], -2000.0..=2000.0;
        /// Slow sway during and after the arrival, r.m.s. per axis.
        sway [mm]: f64 = 3.0, 0.0..=50.0;
        /// Typical time in which the sway changes.
        sway_time [s]: f64 = 0.7, 0.05..=10.0;
        /// Fast tremor, amplitude per axis.
        tremor [mm]: f64 = 0.2, 0.0..=5.0;
        /// Time after the arrival in which sway and tremor calm down.
        stills [s]: f64 = 3.0, 0.0..=600.0;
        /// Spread of the position at which the hand holds the cube, per axis, within the hand-over
        /// place.
        place_spread [mm]: f64 = 20.0, 0.0..=200.0;
        /// Spread of the tilt with which the hand holds the cube, per axis.
        tilt_spread [deg]: f64 = 4.0, 0.0..=45.0;
        /// Whether the cube comes in any of its 24 orientations, or as in `hand.cube_rpy_deg`.
        any_orientation: bool = true;
        /// Number of times that the hand withdraws the cube before it stays.
        withdrawals: u32 = 0, 0.0..=20.0;
        /// Distance of a withdrawal.
        withdrawal [mm]: f64 = 150.0, 0.0..=1000.0;
        /// Stiffness with which the hand holds the cube.
        stiffness [n_m]: f64 = 300.0, 1.0..=10000.0;
        /// Damping with which the hand holds the cube.
        damping [ns_m]: f64 = 10.0, 0.0..=1000.0;
        /// Load of the gripper on the cube at which the hand lets go.
        release [n]: f64 = 8.0, 0.1..=100.0;
        /// Longest time from the closing of the jaws until the hand lets go.
        release_time [s]: f64 = 2.0, 0.0..=60.0;
        /// Time after the release at which the hand comes back for the cube; 5 s longer for a cube
        /// that never left the zone.
        return_after [s]: f64 = 20.0, 0.0..=3600.0;
        /// Time after which the hand picks up a cube that fell and holds it out again; 3600 for
        /// never.
        picks_up_after [s]: f64 = 5.0, 0.0..=3600.0;
        /// Whether the hand comes back for a solved cube only.
        return_solved_only: bool = false;
        /// Pull on the cube when the hand takes it back.
        pull [n]: f64 = 6.0, 0.0..=100.0;
    }
}

section! {
    /// Position of the cube on the table at the start.
    pub PlantTable {
        /// True offset of the middle of the place from that in `hand`.
        offset_xy [mm]: [f64; 2] = [0.0, 0.0], -1000.0..=1000.0;
        /// Share of `hand.half_extent_xyz_mm` within which the cube lies, seeded.
        spread: f64 = 0.9, 0.0..=1.0;
        /// Largest seeded angle by which the cube is turned about the vertical, either way.
        yaw [deg]: f64 = 45.0, 0.0..=180.0;
        /// Whether the cube lies on any of its faces, seeded, or with U up.
        any_face: bool = true;
    }
}

section! {
    /// Light in the cell.
    pub Light {
        /// Colour temperature; drawn from 3200..6500 K by the seed if not given.
        temperature [k]: Option<f64> = None, 1500.0..=12000.0;
        /// Brightness; 1 gives a good exposure.
        level: f64 = 1.0, 0.05..=4.0;
        /// Number of red, orange and yellow things on the walls.
        distractors: u32 = 9, 0.0..=50.0;
    }
}
