//! The keys of the task `follow_contour`.

use crate::scenario::section::section;

section! {
    /// Task `follow_contour`. All places are those that the controller believes, in the world.
    pub Keys {
        /// Centre of the probe's ball in the tool of the first arm.
        probe_xyz [mm]: [f64; 3] = [-80.0, 0.0, 45.0], -300.0..=300.0;
        /// Place above the contour at which it begins; the ball moves down from here until it
        /// touches.
        contour_xyz [mm]: [f64; 3] = [800.0, 400.0, 840.0], -5000.0..=5000.0;
        /// Length along the contour, in direction y of the world.
        length [mm]: f64 = 230.0, 10.0..=1000.0;
        /// Normal force on the contour.
        force [n]: f64 = 8.0, 1.0..=15.0;
        /// Speed along the contour.
        speed [mm_s]: f64 = 20.0, 1.0..=100.0;
        /// Greatest coefficient of friction of the contour.
        friction: f64 = 0.4, 0.0..=1.0;
        /// Size of a part: its length along y of the world, its width between the jaws, its height.
        part_size [mm]: [f64; 3] = [260.0, 57.0, 30.0], 10.0..=600.0;
        /// Centres of the parts that the second arm picks; it hands over the last one.
        parts_xyz [mm]: Vec<[f64; 3]> = vec![
            [670.0, 2300.0, 865.0],
            [790.0, 2300.0, 865.0],
            [910.0, 2300.0, 865.0],
        ], -5000.0..=5000.0;
        /// Centres of the places for these parts, in the same order; the first arm lays down the
        /// last one.
        goals_xyz [mm]: Vec<[f64; 3]> = vec![
            [670.0, 1850.0, 865.0],
            [790.0, 1850.0, 865.0],
            [750.0, 1090.0, 865.0],
        ], -5000.0..=5000.0;
        /// Centre of the part while it is handed over.
        handover_xyz [mm]: [f64; 3] = [750.0, 1470.0, 990.0], -5000.0..=5000.0;
        /// Distance between both hands at the part that is handed over, along y of the world.
        apart [mm]: f64 = 180.0, 165.0..=500.0;
        /// Speed of free motions, as a share of the full one.
        pace: f64 = 0.3, 0.05..=1.0;
    }
}
