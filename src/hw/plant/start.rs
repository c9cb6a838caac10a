//! Parts of the plant at the start of a run, each with its own stream of chance.
//!
//! - in: the configuration, the seed
//! - out: arms, jaws, sensors, layers, the operator's hand, and the cube's pose

use super::arm::PlantArm;
use super::config::{PlantConfig, Start};
use super::cube::Puzzle;
use super::frame::Frame;
use super::hand::OperatorHand;
use super::jaw::PlantJaw;
use super::objects::Objects;
use super::sensor::WristSensor;
use crate::hw::port::PortFault;
use crate::motion::AXES;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// Stream of the layers' friction.
const FRICTION: u64 = 1;
/// Stream of the operator's hand.
const HAND: u64 = 2;
/// Stream of the cube's place on the table.
const TABLE: u64 = 3;
/// First stream of the wrist sensors, which have one each.
const SENSORS: u64 = 10;
/// First stream of the objects, which have one each.
const OBJECTS: u64 = 100;

/// Distance of the open jaws from their stroke's end where the other arm holds the cube (m).
const SHORT_OF_END: f64 = 0.005;

/// Returns the random generator of one part of the plant, `which`, in a run with this seed.
fn stream(seed: u64, which: u64) -> Pcg64 {
    // A stream for each source: a new draw in one of them leaves the others alone.
    Pcg64::new(u128::from(seed), 0xcafe_f00d + u128::from(which))
}

/// Returns the arms in their start poses.
pub(super) fn arms(config: &PlantConfig) -> Vec<PlantArm> {
    (config.cell.arms.iter().zip(&config.arms))
        .zip(config.synchronised)
        .map(|((arm, dynamics), synchronised)| PlantArm::new(arm, dynamics, synchronised))
        .collect()
}

/// Returns the jaws: closed on a cube that their arm holds, wide open if the other arm holds it,
/// else at motor angle 0.
pub(super) fn jaws(config: &PlantConfig) -> Vec<PlantJaw> {
    // Each pad is a spring of half the stiffness: the grip compresses both.
    let pad = 0.5 * config.jaws.stiffness[1];
    let closed = config.cell.cube.edge - 2.0 * config.start_grip / pad;
    let jaws = config.cell.arms.iter().enumerate().map(|(i, arm)| {
        let gripper = &arm.gripper;
        let opening = match config.start {
            // These jaws begin at motor angle 0.
            Start::Hand | Start::Table(_) => gripper.opening_of_motor[0] + gripper.opening_offset,
            Start::Held { arm, .. } if arm == i => closed,
            Start::Held { .. } => gripper.opening.1 - SHORT_OF_END,
        };
        PlantJaw::new(gripper, &config.jaws, opening, config.synchronised[i])
    });
    jaws.collect()
}

/// Returns the wrist sensors.
pub(super) fn sensors(config: &PlantConfig, seed: u64) -> Vec<WristSensor> {
    let arms = config.cell.arms.iter().zip(&config.arms).zip(SENSORS..);
    arms.map(|((arm, dynamics), which)| {
        let last = &dynamics.links[AXES - 1];
        WristSensor::new(&arm.sensor, last, &config.noise, config.period, stream(seed, which))
    })
    .collect()
}

/// Returns the cube's stickers and layers; the friction of each layer is drawn at random.
pub(super) fn puzzle(config: &PlantConfig, seed: u64) -> Puzzle {
    let mut friction = stream(seed, FRICTION);
    let spread = config.cube.spread;
    let factors = std::array::from_fn(|_| {
        std::array::from_fn(|_| {
            let x: f64 = StandardNormal.sample(&mut friction);
            // The clip at two standard deviations keeps each factor positive.
            1.0 + spread * x.clamp(-2.0, 2.0)
        })
    });
    Puzzle::new(config.facelets, config.cube, factors)
}

/// Returns the objects and the persons who lead a tool.
pub(super) fn objects(config: &PlantConfig, seed: u64) -> Objects {
    let parts = (&config.objects[..], &config.leads[..]);
    let table = config.cell.table_height;
    Objects::new(parts, config.probes, table, |which| stream(seed, OBJECTS + which))
}

/// Returns the operator's hand.
pub(super) fn hand(config: &PlantConfig, seed: u64) -> OperatorHand {
    let cell = &config.cell;
    OperatorHand::new(&config.hand, &cell.hand, cell.cube.edge, &mut stream(seed, HAND))
}

/// Returns the cube's initial frame in the world. A `hand` that does not bring the cube is kept out
/// of the cell.
///
/// # Errors
/// [`PortFault`] when an arm that does not exist is to hold the cube.
pub(super) fn cube(
    config: &PlantConfig,
    seed: u64,
    hand: &mut OperatorHand,
    arms: &[PlantArm],
) -> Result<Frame, PortFault> {
    match config.start {
        Start::Hand => Ok(hand.hold(0.0).unwrap_or(Frame::IDENTITY)),
        Start::Table(lying) => {
            hand.keep_out();
            Ok(lying.drawn(&config.cell, &mut stream(seed, TABLE)))
        }
        Start::Held { arm, tool_from_cube } => {
            let Some(arm) = arms.get(arm) else {
                let reason =
                    "the cell lacks this arm, which is to hold the cube at the start".to_owned();
                return Err(PortFault { effector: arm, reason });
            };
            hand.stay_away();
            Ok(arm.world_from_tool.times(&Frame::from_pose(&tool_from_cube)))
        }
    }
}
