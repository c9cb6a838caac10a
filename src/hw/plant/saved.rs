//! The plant's state in a file, so that it outlives the controller as a real cell does.
//!
//! - what is kept: where arms, jaws, cube, its layers and the operator's hand are, what is grasped, what happened
//! - what is not: speeds (whoever switches the power off puts the brakes on), the sensors' noise, what follows from
//!   scenario and seed
//! - a file that was cut off by a crash cannot be: a new one replaces the old one whole
//! - it goes with one plant only, see [`Identity`]

use super::balance::Split;
use super::encoder::Encoder;
use super::frame::Frame;
use super::grasp::Grasp;
use super::hand::Saved as SavedHand;
use super::verdict::Counts;
use super::{Plant, PlantConfig, State};
use crate::motion::{AXES, Depth, JointPositions};
use serde::{Deserialize, Serialize};
use std::fmt::Debug;
use std::io::Write as _;
use std::path::Path;

/// Counts up whenever the same file means something else.
const VERSION: u32 = 5;

/// What is kept of a plant.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved {
    version: u32,
    identity: Identity,
    arms: Vec<SavedArm>,
    jaws: Vec<(f64, Encoder)>,
    stops: [Depth; 2],
    stickers: Vec<u8>,
    angles: [[f64; 2]; 3],
    nodes: [Frame; 2],
    split: Option<Split>,
    grasps: [Grasp; 2],
    hand: SavedHand,
    state: State,
    last_holder: Option<usize>,
    operator_has: bool,
    angle_at_split: f64,
    counts: Counts,
    grasped: [u32; 2],
}

/// What a plant is, whatever became of it: a state goes with any plant of the same identity.
///
/// How a run begins is not in it, since the state tells; nor are faults and the period's length, which may be others when
/// a run goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    seed: u64,
    /// CRC-32 over the true cell.
    cell: u32,
    /// CRC-32 over the rest: drives, cube, pads, sensors, the operator's hand.
    mechanics: u32,
}

impl Identity {
    /// Of a plant that is to be made.
    #[must_use]
    pub fn of(config: &PlantConfig, seed: u64) -> Self {
        // Each is named: whoever adds one decides.
        let PlantConfig {
            cell,
            arms,
            cube,
            jaws,
            noise,
            hand,
            start: _,
            start_grip: _,
            facelets: _,
            synchronised: _,
            faults: _,
            period: _,
            substeps,
        } = config;
        let mut cell = cell.clone();
        for arm in &mut cell.arms {
            arm.start = JointPositions::default();
        }
        // All digits of each number, in the order of the fields.
        let sum = |what: &dyn Debug| crc32fast::hash(format!("{what:?}").as_bytes());
        let mechanics = sum(&(arms, cube, jaws, noise, hand, substeps));
        Self { seed, cell: sum(&cell), mechanics }
    }

    /// What hinders a plant of this identity from going on with a state of `other`.
    fn differs(&self, other: &Self) -> Option<String> {
        if self.seed != other.seed {
            return Some(format!("its seed is {}, not {}", other.seed, self.seed));
        }
        if self.cell != other.cell {
            return Some("it was made in another cell, or with other plant.errors".to_owned());
        }
        let same = self.mechanics == other.mechanics;
        (!same).then(|| "it was made with other plant keys".to_owned())
    }
}

/// What is kept of an arm.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedArm {
    pub(super) joints: [f64; AXES],
    pub(super) motors: [f64; AXES],
    pub(super) bristles: [f64; AXES],
    pub(super) counterbalance: [f64; AXES],
    pub(super) encoders: Vec<Encoder>,
}

/// Why a plant cannot go on from a file.
#[derive(Debug, thiserror::Error)]
pub enum Unfit {
    /// It cannot be read or written.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// Something else than a file: a folder, a device.
    #[error("not a file")]
    NoFile,
    /// It is no such file.
    #[error("not the state of a plant: {0}")]
    Format(#[from] serde_json::Error),
    /// It is of another version of the program.
    #[error("the state of a plant of version {0}, this program reads {VERSION}")]
    Version(u32),
    /// Another run keeps its plant in it.
    #[error("another run keeps its plant there")]
    Taken,
    /// It was made with another seed, in another cell, or with other plant keys.
    #[error("the state of another plant: {0}")]
    Other(String),
}

/// What every version has.
#[derive(serde::Deserialize)]
struct Versioned {
    version: u32,
}

impl Saved {
    /// Reads a file; `None` when there is none.
    ///
    /// # Errors
    /// When it cannot be read, or is not what it should be.
    pub fn read(path: &Path) -> Result<Option<Self>, Unfit> {
        match std::fs::metadata(path) {
            Ok(found) if found.is_file() => {}
            // A device may have no end.
            Ok(_) => return Err(Unfit::NoFile),
            Err(why) if why.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(why) => return Err(why.into()),
        }
        let bytes = std::fs::read(path)?;
        // Of another version everything else may be otherwise.
        let Versioned { version } = serde_json::from_slice(&bytes)?;
        if version != VERSION {
            return Err(Unfit::Version(version));
        }
        Ok(Some(serde_json::from_slice(&bytes)?))
    }

    /// Replaces a file; `synced`: the new one is on the disk before it takes the old one's name.
    ///
    /// # Errors
    /// What the operating system says; the old file is still there then.
    pub fn write(&self, path: &Path, synced: bool) -> Result<(), Unfit> {
        let mut beside = path.as_os_str().to_owned();
        beside.push(".new");
        let bytes = serde_json::to_vec(self)?;
        let mut file = std::fs::File::create(&beside)?;
        let written = file
            .write_all(&bytes)
            .and_then(|()| if synced { file.sync_data() } else { Ok(()) })
            .and_then(|()| std::fs::rename(&beside, path));
        if written.is_err() {
            // A part of a state is of no use to anybody.
            let _ = std::fs::remove_file(&beside);
        }
        Ok(written?)
    }

    /// Turns an outer layer by quarters behind everybody's back: axis 0..3, the positive side or the negative one.
    pub fn meddle(&mut self, axis: usize, positive: bool, quarters: u8) {
        self.angles[axis][usize::from(positive)] +=
            f64::from(quarters) * std::f64::consts::FRAC_PI_2;
    }
}

impl Plant {
    /// The same plant under another identity: that of one to which nothing was done beforehand.
    #[must_use]
    pub fn known_as(self, identity: Identity) -> Self {
        Self { identity, ..self }
    }

    /// What this plant is.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// What is kept of the present state.
    #[must_use]
    pub fn saved(&self) -> Saved {
        Saved {
            version: VERSION,
            identity: self.identity,
            arms: self.arms.iter().map(super::PlantArm::saved).collect(),
            jaws: self.jaws.iter().map(super::PlantJaw::saved).collect(),
            stops: self.stops,
            stickers: self.puzzle.stickers().to_vec(),
            angles: self.puzzle.angles,
            nodes: self.balance.nodes,
            split: self.balance.split,
            grasps: self.grasps,
            hand: self.hand.saved(self.time()),
            state: self.state,
            last_holder: self.last_holder,
            operator_has: self.operator_has,
            angle_at_split: self.angle_at_split,
            counts: self.verdict.counts,
            grasped: self.verdict.grasps,
        }
    }

    /// The same plant at rest in a state that was kept.
    ///
    /// # Errors
    /// When the state is that of another plant.
    pub fn restored(mut self, saved: Saved) -> Result<Self, Unfit> {
        if let Some(difference) = self.identity.differs(&saved.identity) {
            return Err(Unfit::Other(difference));
        }
        let fits = saved.arms.len() == self.arms.len()
            && saved.jaws.len() == self.jaws.len()
            && saved.arms.iter().all(|arm| arm.encoders.len() == AXES);
        let stickers = <[u8; 54]>::try_from(saved.stickers.as_slice());
        let (true, Ok(stickers)) = (fits, stickers) else {
            return Err(Unfit::Other(format!("it has {} arms", saved.arms.len())));
        };
        if stickers.iter().any(|&colour| colour > 5) {
            return Err(Unfit::Other("a sticker of no colour".to_owned()));
        }
        for (arm, saved) in self.arms.iter_mut().zip(saved.arms) {
            arm.restore(saved);
        }
        for (jaw, saved) in self.jaws.iter_mut().zip(saved.jaws) {
            jaw.restore(saved);
        }
        self.puzzle.restore(stickers, saved.angles);
        // A layer that somebody turned by whole quarters is where it belongs.
        for axis in 0..3 {
            if saved.split.is_none_or(|split| split.axis != axis) {
                self.puzzle.settle(axis);
            }
        }
        self.balance.restore(saved.nodes, saved.split);
        self.hand.restore(&saved.hand);
        (self.stops, self.grasps, self.state) = (saved.stops, saved.grasps, saved.state);
        (self.last_holder, self.operator_has) = (saved.last_holder, saved.operator_has);
        self.angle_at_split = saved.angle_at_split;
        (self.verdict.counts, self.verdict.grasps) = (saved.counts, saved.grasped);
        self.core = self.balance.core(&self.puzzle);
        self.account();
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fault::{Fault, What, When};
    use super::super::{CubeMechanics, Jaws, testing};
    use super::*;

    fn refused(config: PlantConfig, seed: u64) -> Option<String> {
        let saved = Plant::new(PlantConfig::new(testing::cell()), 1).unwrap().saved();
        match Plant::new(config, seed).unwrap().restored(saved) {
            Ok(_) => None,
            Err(why) => Some(why.to_string()),
        }
    }

    #[test]
    fn a_state_of_another_plant_is_refused_and_what_differs_is_told() {
        let other = |change: fn(&mut PlantConfig)| {
            let mut config = PlantConfig::new(testing::cell());
            change(&mut config);
            refused(config, 1).unwrap_or_default()
        };

        let told = refused(PlantConfig::new(testing::cell()), 2).unwrap();
        assert!(told.ends_with("its seed is 1, not 2"), "{told}");
        let cells: [fn(&mut PlantConfig); 3] = [
            |config| config.cell.cube.edge += 1e-9,
            |config| config.cell.arms[1].world_from_base.translation.vector.x += 1e-9,
            |config| config.cell.arms[0].gripper.finger_tip += 1e-9,
        ];
        for change in cells {
            let told = other(change);
            assert!(told.contains("in another cell"), "{told}");
        }
        let keys: [fn(&mut PlantConfig); 4] = [
            |config| config.cube = CubeMechanics::dry(),
            |config| config.jaws = Jaws::stiff(),
            |config| config.hand.pull += 1.0,
            |config| config.noise.force_bias += 1e-9,
        ];
        for change in keys {
            let told = other(change);
            assert!(told.contains("with other plant keys"), "{told}");
        }
    }

    #[test]
    fn another_beginning_and_other_faults_make_no_other_plant() {
        let mut config = PlantConfig::new(testing::cell());
        config.facelets.swap(0, 10);
        config.synchronised = [false; 2];
        config.start_grip += 1.0;
        config.cell.arms[0].start.0[1] += 0.1;
        config.faults.push(Fault {
            what: What::Withdraw,
            when: When::At(1.0),
            lasts: f64::INFINITY,
        });

        assert_eq!(refused(config, 1), None);
    }
}
