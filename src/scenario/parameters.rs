//! Bounds of the parameters that the operator may change in a run of a scenario, and the orders
//! that the scenario itself gives.
//!
//! - in: the values of the scenario's keys, the ranges of [`DECLARED`]
//! - out: [`AllBounds`], of which each combination passes the checks of [`motion`]; the orders of
//!   `[[order]]`
//!
//! The checks compare keys with each other: a faster turn is safe only with enough torque. So the
//! declared ranges are cut until the corners of the box that they span pass all checks. Each check
//! is monotonic in each key, so that all values in the box pass as well, in whatever order the
//! operator changes them. The checks do not know the forces that a task orders itself, so the force
//! limit can only be raised.

use super::check;
use super::draft::Draft;
use super::motion;
use super::order_keys::{OrderKeys, ScriptedOrder};
use super::root::Root;
use super::section::{Reader, units};
use crate::cell::Arm;
use crate::cube::Keeper;
use crate::motion::PERIOD;
use crate::operator::Parameter;
use crate::operator::parameter::{AllBounds, Bounds, DECLARED};

/// Number of times that the distance of a bound to the usual value is halved before it is given up.
const HALVINGS: u32 = 6;

/// Greatest force of a palm that presses the cube, as a multiple of the force of an approach: it
/// presses with twice as much, and overshoots by a quarter.
const PRESS: f64 = 2.5;

/// Parameters that the checks of a scenario compare with each other.
const CHECKED: [Parameter; 6] = [
    Parameter::ApproachForce,
    Parameter::TurnTorque,
    Parameter::TurnSpeed,
    Parameter::LinearAdmittance,
    Parameter::AngularAdmittance,
    Parameter::ForceLimit,
];

/// Returns the value of a parameter in the keys of a scenario, with the factor from its unit to SI.
fn field(root: &mut Root, parameter: Parameter) -> (&mut f64, f64) {
    let Root { control: c, vision, .. } = root;
    match parameter {
        Parameter::Grip => (&mut c.grip, units::n),
        Parameter::ApproachForce => (&mut c.approach_force, units::n),
        Parameter::TurnTorque => (&mut c.turn_torque, units::nm),
        Parameter::TurnSpeed => (&mut c.turn_speed, units::deg_s),
        Parameter::LinearAdmittance => (&mut c.linear_admittance, units::mm_sn),
        Parameter::AngularAdmittance => (&mut c.angular_admittance, units::rad_snm),
        Parameter::ForceLimit => (&mut c.force_limit, units::n),
        Parameter::JawCloseSpeed => (&mut c.jaw_close_speed, units::mm_s),
        Parameter::FreeSpeed => (&mut c.free_speed, units::percent),
        Parameter::Exposure => (&mut vision.exposure, 1.0),
    }
}

/// Returns the bounds of all parameters, and the orders of the scenario by time. Adds a fault for
/// an order that is not possible.
pub(super) fn of(
    draft: &Draft,
    arms: &[Option<Arm>],
    keeper: Keeper,
    reader: &mut Reader,
) -> (AllBounds, Vec<ScriptedOrder>) {
    let bounds = bounds(&draft.root, arms, keeper);
    let orders = orders(&draft.orders, &bounds, reader);
    (bounds, orders)
}

/// Returns the bounds of all parameters in a run of the scenario with these keys.
fn bounds(root: &Root, arms: &[Option<Arm>], keeper: Keeper) -> AllBounds {
    let mut keys = root.clone();
    let mut all = AllBounds(std::array::from_fn(|i| {
        let (value, factor) = field(&mut keys, DECLARED[i].parameter);
        // A quotient like 41.000000000000007 is no number that a person has written.
        Bounds::fixed((*value / factor * 1e9).round() * 1e-9)
    }));
    for declared in &DECLARED {
        let index = declared.parameter as usize;
        let usual = all.0[index].usual;
        // A scenario may have a value of 0, of which no factor makes another one.
        if usual <= 0.0 {
            continue;
        }
        let is_checked = CHECKED.contains(&declared.parameter);
        // A task may order a force of its own up to the limit, so it is never lowered.
        let rises = declared.parameter == Parameter::ForceLimit;
        let start = if rises { usual } else { *declared.range.start() };
        for end in [start, *declared.range.end()] {
            let cut = (0..HALVINGS).map(|n| usual + (end - usual) * 0.5_f64.powi(n as i32));
            let found = cut.into_iter().find(|bound| {
                let mut wider = all;
                widen(&mut wider.0[index], *bound);
                !is_checked || is_safe(&wider, root, (arms, keeper))
            });
            if let Some(bound) = found {
                widen(&mut all.0[index], bound);
            }
        }
    }
    all
}

/// Widens bounds to a value. A usual value outside the declared range stays within the bounds, so
/// that the operator can return to it.
fn widen(bounds: &mut Bounds, value: f64) {
    (bounds.least, bounds.most) = (bounds.least.min(value), bounds.most.max(value));
}

/// Returns whether each corner of the box that the bounds span passes the checks of a scenario.
fn is_safe(all: &AllBounds, root: &Root, (arms, keeper): (&[Option<Arm>], Keeper)) -> bool {
    let mut root = root.clone();
    let free: Vec<Parameter> = CHECKED.into_iter().filter(|p| all[*p].leave_room()).collect();
    (0..1_u32 << free.len()).all(|corner| {
        for (bit, &parameter) in free.iter().enumerate() {
            let Bounds { least, most, .. } = all[parameter];
            let (value, factor) = field(&mut root, parameter);
            *value = factor * if corner >> bit & 1 == 0 { least } else { most };
        }
        let mut faults = Reader::default();
        motion::checks(&root, arms, &mut faults);
        check::hand_force(&root.control, keeper, &mut faults);
        faults.faults.0.is_empty()
            && PRESS * root.control.approach_force <= root.control.force_limit
    })
}

/// Returns the orders of a scenario by time. Adds a fault for one of an unknown parameter or of a
/// value out of bounds.
fn orders(
    given: &[(String, OrderKeys)],
    bounds: &AllBounds,
    reader: &mut Reader,
) -> Vec<ScriptedOrder> {
    let mut orders = Vec::new();
    for (path, keys) in given {
        let Some(declared) = DECLARED.iter().find(|d| d.name == keys.parameter) else {
            let at = format!("{path}.parameter");
            let reason = format!("`{at}`: there is no parameter \"{}\"", keys.parameter);
            let names: Vec<_> = DECLARED.iter().map(|declared| declared.name).collect();
            reader.fault_with_help(&at, reason, format!("possible: {}", names.join(", ")));
            continue;
        };
        if let Err(why) = bounds[declared.parameter].check(keys.value) {
            let at = format!("{path}.value");
            reader.fault(&at, format!("`{at}`: {}: {why}", declared.name));
        }
        let period = (keys.at / PERIOD).round() as u64;
        orders.push(ScriptedOrder { period, parameter: declared.parameter, value: keys.value });
    }
    orders.sort_by_key(|order| order.period);
    orders
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Override, Scenario};
    use proptest::prelude::*;

    /// Reads a scenario of the task `idle` with these keys.
    fn read(text: &str, set: &[String]) -> Result<Scenario, String> {
        let set: Vec<_> = set.iter().map(|key| Override::parse(key).unwrap()).collect();
        let path = std::path::Path::new("t.toml");
        crate::tasks::read(path, &format!("task = \"idle\"\n{text}"), &set)
            .map_err(|faults| faults.to_string())
    }

    #[test]
    fn bounds_contain_scenario_value_and_keep_key_range() {
        for text in ["", "[control]\nprofile = \"workshop\"", "[control]\ngrip_n = 20"] {
            let bounds = read(text, &[]).unwrap().controller.bounds;
            for declared in &DECLARED {
                let Bounds { usual, least, most } = bounds[declared.parameter];
                assert!((least..=most).contains(&usual), "{}", declared.name);
            }
        }
        let keys = crate::scenario::all_keys(&crate::tasks::built_in().catalogue());
        for declared in &DECLARED {
            let key = keys.iter().find(|key| key.path == declared.key).unwrap();
            let (inner, outer) = (&declared.range, key.range.clone().unwrap());
            assert!(outer.contains(inner.start()) && outer.contains(inner.end()), "{}", key.path);
        }
    }

    #[test]
    fn bound_is_cut_where_a_check_requires_it() {
        let swift = read("", &[]).unwrap().controller.bounds;
        // The motor of the roll limits the speed of a turn, and its speed the least torque.
        assert!(swift[Parameter::TurnSpeed].most < 60.0);
        assert!(swift[Parameter::TurnTorque].least > 1.5);
        // A task may order forces up to the limit, and a palm presses with 2.5 times the force of
        // an approach.
        let limit = swift[Parameter::ForceLimit];
        assert!(limit.least == limit.usual && limit.most > limit.usual);
        assert!(PRESS * swift[Parameter::ApproachForce].most <= limit.least);
    }

    #[test]
    fn orders_of_scenario_are_checked_and_sorted() {
        let order = |name: &str, at: f64, parameter: &str, value: f64| {
            format!(
                "[[order]]\nname = \"{name}\"\nat_s = {at}\nparameter = \"{parameter}\"\n\
                 value = {value}\n"
            )
        };
        let late = order("late", 2.0, "grip_n", 50.0);
        let early = order("early", 1.0, "exposure", 1.5);

        let orders = read(&(late.clone() + &early), &[]).unwrap().orders;

        let periods: Vec<_> = orders.iter().map(|o| (o.period, o.parameter)).collect();
        assert_eq!(periods, [(500, Parameter::Exposure), (1000, Parameter::Grip)]);
        let unknown = read(&order("a", 1.0, "gripp_n", 50.0), &[]).unwrap_err();
        assert!(unknown.contains("`order.a.parameter`: there is no parameter"), "{unknown}");
        let strong = read(&order("a", 1.0, "grip_n", 56.0), &[]).unwrap_err();
        assert!(strong.contains("`order.a.value`: grip_n: 56 is outside 40..55"), "{strong}");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        /// A scenario with any values within the bounds as its keys passes its checks.
        #[test]
        fn each_combination_within_bounds_is_a_valid_scenario(
            shares in prop::array::uniform10(0.0..=1.0_f64),
            workshop: bool,
        ) {
            let profile = if workshop { "workshop" } else { "swift" };
            let profile = format!("[control]\nprofile = \"{profile}\"");
            let bounds = read(&profile, &[]).unwrap().controller.bounds;
            let set: Vec<String> = DECLARED
                .iter()
                .zip(shares)
                .map(|(declared, share)| {
                    let Bounds { least, most, .. } = bounds[declared.parameter];
                    format!("{}={}", declared.key, least + share * (most - least))
                })
                .collect();
            prop_assert!(read(&profile, &set).is_ok(), "{:?}", read(&profile, &set));
        }
    }
}
