//! The plant's state in a file, so that it outlives the controller as a real cell does.
//!
//! - what is kept: where arms, jaws, cube, its layers and the operator's hand are, what is grasped, what happened
//! - what is not: speeds (whoever switches the power off puts the brakes on), the sensors' noise, what follows from
//!   scenario and seed
//! - a file that was cut off by a crash cannot be: a new one replaces the old one whole

use super::balance::Split;
use super::encoder::Encoder;
use super::frame::Frame;
use super::grasp::Grasp;
use super::hand::Saved as SavedHand;
use super::verdict::Counts;
use super::{Plant, State};
use crate::motion::{AXES, Depth};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::Path;

/// Counts up whenever the same file means something else.
const VERSION: u32 = 4;

/// What is kept of a plant.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved {
    version: u32,
    seed: u64,
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
    /// It was made with another seed or another cell.
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

    /// Replaces a file.
    ///
    /// # Errors
    /// What the operating system says; the old file is still there then.
    pub fn write(&self, path: &Path) -> Result<(), Unfit> {
        let mut beside = path.as_os_str().to_owned();
        beside.push(".new");
        let mut file = std::fs::File::create(&beside)?;
        file.write_all(&serde_json::to_vec(self)?)?;
        drop(file);
        Ok(std::fs::rename(&beside, path)?)
    }

    /// Turns an outer layer by quarters behind everybody's back: axis 0..3, the positive side or the negative one.
    pub fn meddle(&mut self, axis: usize, positive: bool, quarters: u8) {
        self.angles[axis][usize::from(positive)] +=
            f64::from(quarters) * std::f64::consts::FRAC_PI_2;
    }
}

impl Plant {
    /// What is kept of the present state.
    #[must_use]
    pub fn saved(&self, seed: u64) -> Saved {
        Saved {
            version: VERSION,
            seed,
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
    pub fn restored(mut self, saved: Saved, seed: u64) -> Result<Self, Unfit> {
        if saved.seed != seed {
            return Err(Unfit::Other(format!("its seed is {}, not {seed}", saved.seed)));
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
