//! Parameters that the operator may change while a run goes on.
//!
//! - in: orders of the operator, each with the period from which it counts
//! - out: the [`Factors`] of a period, by which the scenario's values are multiplied
//!
//! The set is bounded: a parameter is a variant of [`Parameter`], declared once in [`DECLARED`].
//! An ordered value is approached with a bounded rate, so that no value jumps. The present value is
//! a function of the number of the period alone: a run with the same orders is the same run.
//!
//! A parameter acts as a factor, because a task may have derived its own orders from the scenario's
//! value: a gentle turn at half of the torque stays at half of it. Without an order each factor is
//! exactly 1, so that a product with it changes no bit.

use crate::motion::PERIOD;
use serde::{Deserialize, Serialize};
use std::ops::{Index, RangeInclusive};

/// A parameter. Its name in JSON is that of [`Declaration::name`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Parameter {
    /// Grip force of the jaws.
    #[serde(rename = "grip_n")]
    Grip,
    /// Contact force of an approach.
    #[serde(rename = "approach_force_n")]
    ApproachForce,
    /// Torque at which a turn stops.
    #[serde(rename = "turn_torque_nm")]
    TurnTorque,
    /// Speed of a turn.
    #[serde(rename = "turn_speed_deg_s")]
    TurnSpeed,
    /// Admittance of a yielding linear direction.
    #[serde(rename = "linear_admittance_mm_sn")]
    LinearAdmittance,
    /// Admittance of a yielding rotation.
    #[serde(rename = "angular_admittance_rad_snm")]
    AngularAdmittance,
    /// Force at which a motion in contact is aborted.
    #[serde(rename = "force_limit_n")]
    ForceLimit,
    /// Speed of jaws that close near the cube.
    #[serde(rename = "jaw_close_speed_mm_s")]
    JawCloseSpeed,
    /// Speed of motions through free space.
    #[serde(rename = "free_speed_percent")]
    FreeSpeed,
    /// Exposure of the cameras.
    #[serde(rename = "exposure")]
    Exposure,
}

/// Declaration of a parameter. All numbers are in `unit`, which is that of the scenario's key.
#[derive(Debug, Clone, PartialEq)]
pub struct Declaration {
    /// The parameter.
    pub parameter: Parameter,
    /// Name by which the operator orders it: the last part of `key`.
    pub name: &'static str,
    /// Dotted name of the scenario's key that gives the value at the beginning.
    pub key: &'static str,
    /// Unit; empty for a number without one.
    pub unit: &'static str,
    /// Smallest and largest value that is safe while a run goes on.
    pub range: RangeInclusive<f64>,
    /// Greatest rate at which the value changes, per second.
    pub rate: f64,
    /// Meaning in one sentence.
    pub meaning: &'static str,
}

/// Number of parameters.
pub const COUNT: usize = 10;

/// All parameters, in the order of the variants of [`Parameter`].
pub const DECLARED: [Declaration; COUNT] = [
    Declaration {
        parameter: Parameter::Grip,
        name: "grip_n",
        key: "control.grip_n",
        unit: "N",
        // Pads under 40 N carry 1.1 Nm about the axis of the jaws, and 1.8 Nm about that of a turn,
        // which is stopped at 1.25 Nm: less grip would slip first.
        range: 40.0..=55.0,
        rate: 5.0,
        meaning: "Grip force of the jaws on the cube.",
    },
    Declaration {
        parameter: Parameter::ApproachForce,
        name: "approach_force_n",
        key: "control.approach_force_n",
        unit: "N",
        // The palm presses the cube with twice this force, which must stay below the force limit.
        range: 2.0..=6.0,
        rate: 1.0,
        meaning: "Contact force that ends the approach of a grasp; the palm presses the cube with \
                  twice as much.",
    },
    Declaration {
        parameter: Parameter::TurnTorque,
        name: "turn_torque_nm",
        key: "control.turn_torque_nm",
        unit: "Nm",
        range: 1.5..=3.0,
        rate: 0.25,
        meaning: "Torque at which the turn of a layer stops.",
    },
    Declaration {
        parameter: Parameter::TurnSpeed,
        name: "turn_speed_deg_s",
        key: "control.turn_speed_deg_s",
        unit: "deg/s",
        range: 10.0..=60.0,
        rate: 10.0,
        meaning: "Speed of a turn in free motion.",
    },
    Declaration {
        parameter: Parameter::LinearAdmittance,
        name: "linear_admittance_mm_sn",
        key: "control.linear_admittance_mm_sn",
        unit: "mm/(s N)",
        range: 0.5..=2.0,
        rate: 0.25,
        meaning: "Reciprocal damping of a yielding linear direction.",
    },
    Declaration {
        parameter: Parameter::AngularAdmittance,
        name: "angular_admittance_rad_snm",
        key: "control.angular_admittance_rad_snm",
        unit: "rad/(s Nm)",
        range: 0.025..=0.1,
        rate: 0.0125,
        meaning: "Reciprocal damping of a yielding rotation.",
    },
    Declaration {
        parameter: Parameter::ForceLimit,
        name: "force_limit_n",
        key: "control.force_limit_n",
        unit: "N",
        // The palm presses with up to 12 N, with an overshoot of a quarter.
        range: 16.0..=30.0,
        rate: 5.0,
        meaning: "Force at which a motion in contact is aborted.",
    },
    Declaration {
        parameter: Parameter::JawCloseSpeed,
        name: "jaw_close_speed_mm_s",
        key: "control.jaw_close_speed_mm_s",
        unit: "mm/s",
        range: 4.0..=16.0,
        rate: 4.0,
        meaning: "Speed of closing jaws near the cube.",
    },
    Declaration {
        parameter: Parameter::FreeSpeed,
        name: "free_speed_percent",
        key: "control.free_speed_percent",
        unit: "%",
        range: 20.0..=100.0,
        // A pause takes 0.6 s from full speed to rest, which is 167 percent in a second.
        rate: 25.0,
        meaning: "Speed of motions through free space, as a share of the planned one.",
    },
    Declaration {
        parameter: Parameter::Exposure,
        name: "exposure",
        key: "vision.exposure",
        unit: "",
        range: 0.5..=2.0,
        rate: 0.5,
        meaning: "Exposure of all cameras, as a multiple of the one that a task orders.",
    },
];

impl Parameter {
    /// Returns the declaration of this parameter.
    #[must_use]
    pub fn declaration(self) -> &'static Declaration {
        &DECLARED[self as usize]
    }
}

/// Bounds of a parameter in one run, in the unit of its declaration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bounds {
    /// Value at the beginning, which is that of the scenario.
    pub usual: f64,
    /// Smallest value that the operator may order.
    pub least: f64,
    /// Largest value that the operator may order.
    pub most: f64,
}

impl Default for Bounds {
    /// Returns the bounds of a parameter that cannot be changed.
    fn default() -> Self {
        Self::fixed(1.0)
    }
}

/// Reason for which the order of a value is refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unordered {
    /// The value is infinite or NaN.
    #[error("the value is not a number")]
    NotANumber,
    /// The value is out of bounds: smallest and largest value.
    #[error("{value} is outside {least}..{most}")]
    OutOfBounds {
        /// Ordered value.
        value: f64,
        /// Smallest value.
        least: f64,
        /// Largest value.
        most: f64,
    },
    /// The scenario leaves no room for a change.
    #[error("this scenario does not let it change")]
    Fixed,
}

impl Bounds {
    /// Returns the bounds of a parameter that keeps its `usual` value.
    #[must_use]
    pub fn fixed(usual: f64) -> Self {
        Self { usual, least: usual, most: usual }
    }

    /// Returns whether the value can be changed.
    #[must_use]
    pub fn leave_room(&self) -> bool {
        self.least < self.most
    }

    /// Checks whether the operator may order this value.
    ///
    /// # Errors
    /// The reason for a refusal.
    pub fn check(&self, value: f64) -> Result<(), Unordered> {
        let Self { least, most, .. } = *self;
        if !value.is_finite() {
            return Err(Unordered::NotANumber);
        }
        if !self.leave_room() {
            return Err(Unordered::Fixed);
        }
        if !(least..=most).contains(&value) {
            return Err(Unordered::OutOfBounds { value, least, most });
        }
        Ok(())
    }
}

/// Bounds of all parameters in one run.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AllBounds(pub [Bounds; COUNT]);

impl Index<Parameter> for AllBounds {
    type Output = Bounds;

    fn index(&self, parameter: Parameter) -> &Bounds {
        &self.0[parameter as usize]
    }
}

/// Course of one parameter: a straight line from a value to the ordered one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Course {
    usual: f64,
    from: f64,
    to: f64,
    /// Period in which the line begins.
    begins: u64,
}

impl Course {
    /// Returns the value in a period, which moves with the greatest `rate` (per second).
    fn value(&self, period: u64, rate: f64) -> f64 {
        let most = rate * period.saturating_sub(self.begins) as f64 * PERIOD;
        let way = self.to - self.from;
        // The end is reached exactly: a sum would leave an error of rounding.
        if way.abs() <= most { self.to } else { self.from + most.copysign(way) }
    }
}

/// Courses of all parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Courses([Course; COUNT]);

impl Courses {
    /// Returns the courses at the beginning of a run: each parameter keeps its usual value.
    #[must_use]
    pub fn new(bounds: &AllBounds) -> Self {
        Self(bounds.0.map(|Bounds { usual, .. }| Course {
            usual,
            from: usual,
            to: usual,
            begins: 0,
        }))
    }

    /// Orders a value, toward which the parameter moves from the period `begins` on. Until then it
    /// moves on as before, by [`Factors::reached_from`]. The caller has checked the value by its
    /// [`Bounds`].
    pub fn order(&mut self, parameter: Parameter, value: f64, begins: u64) {
        let from = self.value(parameter, begins);
        let course = &mut self.0[parameter as usize];
        *course = Course { from, to: value, begins, ..*course };
    }

    /// Returns these courses with the periods in which they begin as another node counts them;
    /// `there` converts a period.
    #[must_use]
    pub fn counted(mut self, there: impl Fn(u64) -> u64) -> Self {
        for course in &mut self.0 {
            course.begins = there(course.begins);
        }
        self
    }

    /// Returns the value of a parameter in a period.
    #[must_use]
    pub fn value(&self, parameter: Parameter, period: u64) -> f64 {
        self.0[parameter as usize].value(period, parameter.declaration().rate)
    }

    /// Returns the ordered value of a parameter.
    #[must_use]
    pub fn ordered(&self, parameter: Parameter) -> f64 {
        self.0[parameter as usize].to
    }

    /// Returns the factors of all parameters in a period.
    #[must_use]
    pub fn factors(&self, period: u64) -> Factors {
        let factor = |i: usize| {
            let course = &self.0[i];
            // A quotient of equal numbers is exactly 1. A value of 0 cannot be changed.
            if course.usual == 0.0 {
                return 1.0;
            }
            course.value(period, DECLARED[i].rate) / course.usual
        };
        Factors(std::array::from_fn(factor))
    }

    /// Returns how far the factor of a parameter may move in one period.
    #[must_use]
    pub fn step(&self, parameter: Parameter) -> f64 {
        let usual = self.0[parameter as usize].usual;
        if usual == 0.0 { 0.0 } else { parameter.declaration().rate * PERIOD / usual }
    }
}

/// Factors by which the scenario's values are multiplied; 1 for an unchanged parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors([f64; COUNT]);

impl Default for Factors {
    fn default() -> Self {
        Self([1.0; COUNT])
    }
}

impl Index<Parameter> for Factors {
    type Output = f64;

    fn index(&self, parameter: Parameter) -> &f64 {
        &self.0[parameter as usize]
    }
}

impl Factors {
    /// Returns these factors with another one for a parameter.
    #[must_use]
    pub fn with(mut self, parameter: Parameter, factor: f64) -> Self {
        self.0[parameter as usize] = factor;
        self
    }

    /// Returns these factors as far as they can be reached from `before` in a number of periods.
    #[must_use]
    pub fn reached_from(&self, before: &Self, courses: &Courses, periods: u64) -> Self {
        let factor = |i: usize| {
            let step = courses.step(DECLARED[i].parameter) * periods as f64;
            // The margin is for rounding: a course that is on time is not clamped.
            let most = step * (1.0 + 1e-9);
            self.0[i].clamp(before.0[i] - most, before.0[i] + most)
        };
        Self(std::array::from_fn(factor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the bounds of a run whose usual values are in the middle of the declared ranges.
    fn bounds() -> AllBounds {
        AllBounds(std::array::from_fn(|i| {
            let (least, most) = (*DECLARED[i].range.start(), *DECLARED[i].range.end());
            Bounds { usual: 0.5 * (least + most), least, most }
        }))
    }

    #[test]
    fn declarations_follow_the_order_of_variants() {
        for (index, declared) in DECLARED.iter().enumerate() {
            assert_eq!(declared.parameter as usize, index);
            let name = serde_json::to_string(&declared.parameter).unwrap();
            assert_eq!(name, format!("\"{}\"", declared.name));
            assert!(declared.key.ends_with(declared.name), "{}", declared.key);
            assert!(declared.rate > 0.0 && declared.range.start() < declared.range.end());
        }
    }

    #[test]
    fn manual_lists_each_parameter_with_its_bounds() {
        let manual = include_str!("../../docs/operating.md");
        for Declaration { name, unit, range, rate, .. } in &DECLARED {
            let space = if unit.is_empty() { "" } else { " " };
            let bounds = format!("{} to {}{space}{unit}", range.start(), range.end());
            let row = format!("| {bounds} | {rate}{space}{unit} |");
            let listed = manual
                .lines()
                .any(|line| line.starts_with(&format!("| `{name}` |")) && line.ends_with(&row));
            assert!(listed, "{name}: {row}");
        }
    }

    /// A scenario may have no admittance at all.
    #[test]
    fn parameter_of_zero_keeps_its_factor() {
        let mut bounds = bounds();
        bounds.0[Parameter::LinearAdmittance as usize] = Bounds::fixed(0.0);
        let courses = Courses::new(&bounds);

        let factors = courses.factors(7).reached_from(&Factors::default(), &courses, 0);

        assert_eq!(factors, Factors::default());
    }

    #[test]
    fn order_outside_bounds_is_refused() {
        let bounds = Bounds { usual: 40.0, least: 30.0, most: 55.0 };
        assert_eq!(bounds.check(30.0), Ok(()));
        assert_eq!(bounds.check(55.0), Ok(()));
        let outside = |value| Err(Unordered::OutOfBounds { value, least: 30.0, most: 55.0 });
        assert_eq!(bounds.check(29.9), outside(29.9));
        assert_eq!(bounds.check(55.1), outside(55.1));
        assert_eq!(bounds.check(f64::NAN), Err(Unordered::NotANumber));
        assert_eq!(bounds.check(f64::INFINITY), Err(Unordered::NotANumber));
        assert_eq!(Bounds::fixed(4.0).check(4.0), Err(Unordered::Fixed));
    }

    #[test]
    fn factors_without_orders_are_exactly_one() {
        let courses = Courses::new(&bounds());
        assert_eq!(courses.factors(0), Factors::default());
        assert_eq!(courses.factors(1_000_000), Factors::default());
    }

    proptest! {
        /// No value moves faster than its rate or leaves its bounds, and each reaches its order in
        /// the end.
        #[test]
        fn values_keep_their_rate_and_bounds(
            orders in prop::collection::vec((0..COUNT, 0.0..=1.0_f64, 0_u64..2000), 1..20),
        ) {
            let bounds = bounds();
            let mut courses = Courses::new(&bounds);
            let mut now = 0;
            for (index, share, wait) in orders {
                let Declaration { parameter, rate, .. } = DECLARED[index];
                let Bounds { least, most, .. } = bounds[parameter];
                let before = courses.value(parameter, now);
                courses.order(parameter, least + share * (most - least), now);
                prop_assert!((courses.value(parameter, now) - before).abs() < 1e-12);
                for period in now..now + wait {
                    let [a, b] = [period, period + 1].map(|p| courses.value(parameter, p));
                    prop_assert!((b - a).abs() <= rate * PERIOD * (1.0 + 1e-6), "{} to {}", a, b);
                    prop_assert!((least - 1e-9..=most + 1e-9).contains(&b), "{}", b);
                }
                now += wait;
            }
            for Declaration { parameter, .. } in DECLARED {
                let reached = courses.value(parameter, now + 60_000);
                prop_assert_eq!(reached, courses.ordered(parameter));
            }
        }

        /// Factors that arrive late, over a link, are approached with the same rate.
        #[test]
        fn late_factors_are_approached_without_jump(
            share in 0.0..=1.0_f64,
            late in 0_u64..2000,
            macrostep in 1_u64..50,
        ) {
            let bounds = bounds();
            let old = Courses::new(&bounds);
            let mut new = old;
            let Bounds { usual, least, most } = bounds[Parameter::Grip];
            new.order(Parameter::Grip, least + share * (most - least), 0);
            let mut factors = old.factors(late);
            let mut period = late;
            for _ in 0..200 {
                let next = new.factors(period + macrostep).reached_from(&factors, &new, macrostep);
                let change = (next[Parameter::Grip] - factors[Parameter::Grip]).abs() * usual;
                prop_assert!(change <= 5.0 * macrostep as f64 * PERIOD * (1.0 + 1e-6));
                factors = next;
                period += macrostep;
            }
        }
    }
}
