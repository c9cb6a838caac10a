//! The keys of the task `carry_bar`.

use crate::scenario::section::{section, words};

words! {
    /// Way in which the second hand follows the first one.
    pub Partner {
        /// It yields to forces along the bar and across it.
        Compliant = "compliant",
        /// It keeps its own way, whatever the forces.
        Stiff = "stiff",
    }
}

section! {
    /// Task `carry_bar`.
    pub Keys {
        /// Believed place of the bar's centre in the world at the start.
        bar_xyz [mm]: [f64; 3] = [600.0, 1055.0, 900.0], -5000.0..=5000.0;
        /// Believed direction of the bar about the vertical: 0 along x of the world, 90 along y.
        bar_yaw [deg]: f64 = 90.0, -180.0..=180.0;
        /// Distance between the places where the hands grip the bar.
        span [mm]: f64 = 480.0, 100.0..=2000.0;
        /// Width of the bar between the jaws.
        width [mm]: f64 = 57.0, 10.0..=80.0;
        /// Mass of the bar.
        mass [kg]: f64 = 0.8, 0.0..=10.0;
        /// Height by which the bar is lifted.
        lift [mm]: f64 = 100.0, 10.0..=500.0;
        /// Points of the way after the lift, as places of the bar's centre beside its start.
        way [mm]: Vec<[f64; 2]> = vec![[60.0, 0.0], [100.0, 20.0], [100.0, 0.0]], -1000.0..=1000.0;
        /// Turn of the bar about the vertical at each point of the way; the last one must be the
        /// turn in which the bar is laid down.
        turns [deg]: Vec<f64> = vec![10.0, -8.0, 0.0], -90.0..=90.0;
        /// Speed of the bar's centre.
        speed [mm_s]: f64 = 100.0, 5.0..=500.0;
        /// Distance from a corner of the way within which the bar leaves the straight line.
        radius [mm]: f64 = 20.0, 1.0..=200.0;
        /// Whether the second hand yields.
        partner: Partner = Partner::Compliant;
        /// Force of a hand at which both stop, at most `control.force_limit_n`.
        stop_force [n]: f64 = 20.0, 5.0..=65.0;
        /// Bound on the internal force of the bar, which must hold in 99 % of the time that both
        /// hands hold it.
        internal [n]: f64 = 15.0, 1.0..=100.0;
        /// Number of rounds that each further arm goes by itself meanwhile, as in `patrol`.
        rounds: u32 = 0, 0.0..=1000.0;
        /// Angle by which the stops of such a round lie to both sides of the arm's start.
        angle [deg]: f64 = 10.0, 3.0..=20.0;
    }
}
