//! State of the plant in a file, which outlives the controller as a real cell does.
//!
//! - saved: poses of arms, jaws, cube, its layers and the operator's hand, grasps, numbers of
//!   events
//! - not saved: speeds (the brakes hold once the power is off), the sensors' noise, all that
//!   follows from scenario and seed
//! - a file fits one plant only, see [`Identity`]; an impossible state is refused with its place

use super::arm::SavedArm;
use super::balance::Split;
use super::encoder::Encoder;
use super::frame::Frame;
use super::grasp::Grasp;
use super::hand::Saved as SavedHand;
use super::identity::Identity;
use super::objects::{SavedLead, SavedObject};
use super::plausible::{self, Wrong};
use super::verdict::Counts;
use super::{Plant, State};
use crate::cell::MOST_ARMS;
use crate::hw::text;
use crate::motion::{AXES, Depth};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::io::Read as _;
use std::path::Path;

/// Longest saved state (bytes): a typical one has 5000.
const LONGEST: u64 = 1 << 20;

/// Longest distance between a cube and the hand that holds it, and between the cube's two bodies
/// (m).
const AT_HAND: f64 = 0.2;

/// Version of the file: it counts up whenever the same file means something else.
const VERSION: u32 = 5;

/// Saved state of a plant.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved {
    version: u32,
    identity: Identity,
    arms: Vec<SavedArm>,
    jaws: Vec<(f64, Encoder)>,
    stops: Vec<Depth>,
    stickers: Vec<u8>,
    angles: [[f64; 2]; 3],
    nodes: [Frame; 2],
    split: Option<Split>,
    grasps: Vec<Grasp>,
    hand: SavedHand,
    state: State,
    last_holder: Option<usize>,
    operator_has: bool,
    angle_at_split: f64,
    counts: Counts,
    grasped: Vec<u32>,
    /// Objects beside the cube; a cell without any has the same file as before there were objects.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    objects: Vec<SavedObject>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    leads: Vec<SavedLead>,
}

/// Reason why a plant cannot continue from a file.
#[derive(Debug, thiserror::Error)]
pub enum Unfit {
    /// The file cannot be read or written.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// The path is something else than a file: a folder, a device.
    #[error("not a file")]
    NoFile,
    /// The file is not a state of a plant.
    #[error("not the state of a plant: {0}")]
    Format(#[from] serde_json::Error),
    /// The state is of another version of the program.
    #[error("plant state of version {0}; this program reads version {VERSION}")]
    Version(u32),
    /// Another run saves its plant in the file.
    #[error("another run uses this file")]
    Taken,
    /// The file is larger than any state.
    #[error("larger than 1 MiB, so not the state of a plant")]
    Long,
    /// The state has a number that no plant has.
    #[error("{place}: {why}")]
    Value {
        /// Place of the number, as in `arms[0].joints[3]`.
        place: String,
        /// Reason why it is wrong.
        why: String,
    },
    /// The state was made with another seed, in another cell, or with other plant keys.
    #[error("the state of another plant: {0}")]
    Other(String),
}

/// Returns the number of entries of a list with one for each arm, in a cell of `arms` arms: two at
/// least, as before there were cells of more arms.
fn entries(arms: usize) -> usize {
    arms.clamp(2, MOST_ARMS)
}

/// Part of the file that each version has.
#[derive(serde::Deserialize)]
struct Versioned {
    version: u32,
}

impl From<Wrong> for Unfit {
    fn from((place, why): Wrong) -> Self {
        Self::Value { place, why }
    }
}

impl Saved {
    /// Reads the saved state of a plant from a file; returns `None` when there is no such file.
    ///
    /// # Errors
    /// When the file cannot be read, or is not the state of a plant.
    pub fn read(path: &Path) -> Result<Option<Self>, Unfit> {
        match std::fs::metadata(path) {
            Ok(found) if found.is_file() => {}
            // A device may have no end.
            Ok(_) => return Err(Unfit::NoFile),
            Err(why) if why.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(why) => return Err(why.into()),
        }
        let mut bytes = Vec::new();
        text::open(path)?.take(LONGEST + 1).read_to_end(&mut bytes)?;
        Self::parse(&bytes).map(Some)
    }

    /// Parses the bytes of a file with the saved state of a plant.
    ///
    /// # Errors
    /// When they are not the state of a plant.
    pub fn parse(bytes: &[u8]) -> Result<Self, Unfit> {
        if bytes.len() as u64 > LONGEST {
            return Err(Unfit::Long);
        }
        // The version comes first: a file of another version may differ in everything else.
        let Versioned { version } = serde_json::from_slice(bytes)?;
        if version != VERSION {
            return Err(Unfit::Version(version));
        }
        // The numbers are checked as JSON, which gives each of them its place in the file.
        plausible::check_numbers(&serde_json::from_slice(bytes)?)?;
        let saved: Self = serde_json::from_slice(bytes)?;
        saved.check_indices()?;
        Ok(saved)
    }

    /// Checks that all indices (of axes, bodies and arms) and sets of layers are in their ranges.
    fn check_indices(&self) -> Result<(), Wrong> {
        let wrong = |place: &str, why: &str| Err((place.to_owned(), why.to_owned()));
        if let Some(Split { axis, layers: [a, b], hands }) = self.split {
            if axis > 2 {
                return wrong("split.axis", "not an axis of the cube, 0 to 2");
            }
            if a & b != 0 || a | b > 7 || a == 0 || b == 0 {
                return wrong(
                    "split.layers",
                    "not two separate sets of an axis's three layers (bits 1, 2, 4)",
                );
            }
            if hands[0] == hands[1] || hands.into_iter().any(|hand| hand >= self.grasps.len()) {
                return wrong("split.hands", "not the indices of two arms");
            }
        }
        let arms = entries(self.arms.len());
        if [self.stops.len(), self.grasps.len(), self.grasped.len()] != [arms; 3] {
            return wrong("grasps", "not one entry for each arm in stops, grasps and grasped");
        }
        for (i, grasp) in self.grasps.iter().enumerate() {
            if grasp.node > 1 {
                return wrong(&format!("grasps[{i}].node"), "not a body of the cube, 0 or 1");
            }
        }
        if self.last_holder.is_some_and(|arm| arm >= arms) {
            return wrong("last_holder", "not the index of an arm");
        }
        Ok(())
    }

    /// Returns the bytes of a file with the state, which [`Self::parse`] reads.
    ///
    /// # Errors
    /// If a number is not finite, so that JSON cannot hold it.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Unfit> {
        Ok(serde_json::to_vec(self)?)
    }
}

impl Plant {
    /// Replaces the identity of this plant by that of another configuration, for instance one
    /// without the errors that faults add to the cell. A saved state is accepted only if its
    /// identity is the same.
    #[must_use]
    pub fn known_as(self, identity: Identity) -> Self {
        Self { identity, ..self }
    }

    /// Returns the identity of this plant.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Returns the present state, to be saved.
    #[must_use]
    pub fn saved(&self) -> Saved {
        let arms = entries(self.arms.len());
        let (objects, leads) = self.objects.saved(arms);
        Saved {
            objects,
            leads,
            version: VERSION,
            identity: self.identity,
            arms: self.arms.iter().map(super::PlantArm::saved).collect(),
            jaws: self.jaws.iter().map(super::PlantJaw::saved).collect(),
            stops: self.stops[..arms].to_vec(),
            stickers: self.puzzle.stickers().to_vec(),
            angles: self.puzzle.angles,
            nodes: self.balance.nodes,
            split: self.balance.split,
            grasps: self.grasps[..arms].to_vec(),
            hand: self.hand.saved(self.time()),
            state: self.state,
            last_holder: self.last_holder,
            operator_has: self.operator_has,
            angle_at_split: self.angle_at_split,
            counts: self.verdict.counts,
            grasped: self.verdict.grasps[..arms].to_vec(),
        }
    }

    /// Returns the plant in a saved state, at rest.
    ///
    /// # Errors
    /// When the state is that of another plant, or no plant can be in it.
    pub fn restored(mut self, saved: Saved) -> Result<Self, Unfit> {
        if let Some(difference) = self.identity.differs(&saved.identity) {
            return Err(Unfit::Other(difference));
        }
        let fits = saved.arms.len() == self.arms.len()
            && saved.jaws.len() == self.jaws.len()
            && saved.arms.iter().all(|arm| arm.encoders.len() == AXES);
        let stickers = <[u8; 54]>::try_from(saved.stickers.as_slice());
        let (true, Ok(stickers)) = (fits, stickers) else {
            let (arms, jaws) = (saved.arms.len(), saved.jaws.len());
            let parts = format!("{arms} arms, {jaws} jaws, {} stickers", saved.stickers.len());
            let own = format!("{} arms, 54 stickers, {AXES} encoders an arm", self.arms.len());
            return Err(Unfit::Other(format!("it has {parts}; this plant has {own}")));
        };
        if stickers.iter().any(|&colour| colour > 5) {
            return Err(Unfit::Other("a sticker has a colour above 5".to_owned()));
        }
        // Each part is checked before it is restored. If one fails, this function drops the whole
        // plant, so no half-restored one remains.
        for (i, (arm, saved)) in self.arms.iter_mut().zip(saved.arms).enumerate() {
            arm.check_saved(&saved).map_err(|(place, why)| (format!("arms[{i}].{place}"), why))?;
            arm.restore(saved);
        }
        for (i, (jaw, saved)) in self.jaws.iter_mut().zip(saved.jaws).enumerate() {
            jaw.check_saved(&saved).map_err(|(place, why)| (format!("jaws[{i}]{place}"), why))?;
            jaw.restore(saved);
        }
        let tools = std::array::from_fn(|i| self.arms.get(i).map(|arm| arm.world_from_tool));
        self.objects.restore((&saved.objects, &saved.leads), tools)?;
        // A grasp of a distant cube would make forces that no cell has.
        let apart = |a: &Vector3<f64>, b: &Vector3<f64>| (a - b).norm() > AT_HAND;
        for (i, grasp) in saved.grasps.iter().enumerate() {
            if grasp.attached()
                && (i >= self.arms.len() || apart(&self.tool(i).p, &saved.nodes[0].p))
            {
                let why = "the cube is not at the hand that holds it";
                return Err((format!("grasps[{i}]"), why.to_owned()).into());
            }
        }
        if saved.split.is_some() && apart(&saved.nodes[0].p, &saved.nodes[1].p) {
            let why = "the cube's parts are not at one place";
            return Err(("nodes".to_owned(), why.to_owned()).into());
        }
        self.puzzle.restore(stickers, saved.angles);
        // A layer that was turned by whole quarters outside of the run is where it belongs. A turn
        // under way keeps its angle.
        for axis in 0..3 {
            if saved.split.is_none_or(|split| split.axis != axis) {
                self.puzzle.settle(axis);
            }
        }
        self.balance.restore(saved.nodes, saved.split);
        self.hand.restore(&saved.hand);
        // `check_indices` has compared the numbers of entries.
        let arms = saved.grasps.len().min(MOST_ARMS);
        self.stops[..arms].copy_from_slice(&saved.stops[..arms]);
        self.grasps[..arms].copy_from_slice(&saved.grasps[..arms]);
        self.verdict.grasps[..arms].copy_from_slice(&saved.grasped[..arms]);
        self.state = saved.state;
        (self.last_holder, self.operator_has) = (saved.last_holder, saved.operator_has);
        self.angle_at_split = saved.angle_at_split;
        self.verdict.counts = saved.counts;
        self.core = self.balance.core(&self.puzzle);
        // The core is where it was, so the first velocity is 0.
        self.record_period();
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fault::{Fault, What, When};
    use super::super::{CubeMechanics, Jaws, PlantConfig, testing};
    use super::*;

    #[test]
    fn impossible_plant_state_is_refused_naming_its_field() {
        let plant = || Plant::new(PlantConfig::new(testing::cell()), 1).unwrap();
        let whole = serde_json::to_value(plant().saved()).unwrap();
        let told = |pointer: &str, value: serde_json::Value| {
            let mut state = whole.clone();
            *state.pointer_mut(pointer).unwrap() = value;
            let read = Saved::parse(&serde_json::to_vec(&state).unwrap());
            read.and_then(|saved| plant().restored(saved))
                .map(|_| ())
                .map_or_else(|why| why.to_string(), |()| "taken".to_owned())
        };
        assert!(plant().restored(Saved::parse(whole.to_string().as_bytes()).unwrap()).is_ok());

        for (pointer, value, start) in [
            ("/split", serde_json::json!({ "axis": 9, "layers": [1, 6] }), "split.axis: "),
            ("/split", serde_json::json!({ "axis": 1, "layers": [1, 7] }), "split.layers: "),
            ("/grasps/0/node", 99.into(), "grasps[0].node: "),
            ("/arms/0/joints/2", 1e20.into(), "arms[0].joints[2]: "),
            ("/arms/1/joints/2", 5.0.into(), "arms[1].joints[2]: "),
            ("/arms/0/motors/6", 1e308.into(), "arms[0].motors[6]: "),
            ("/arms/0/motors/6", 9000.0.into(), "arms[0].motors[6]: "),
            ("/arms/0/encoders/3/increments", 1e9.into(), "arms[0].encoders[3]: "),
            ("/jaws/1/0", 1e4.into(), "jaws[1][0]: "),
            ("/nodes/1/p/0", 1e308.into(), "nodes[1].p[0]: "),
            ("/nodes/0/r", vec![0.0; 9].into(), "nodes[0].r: "),
            ("/last_holder", 2.into(), "last_holder: "),
            ("/grasps/0/reference/p/1", 0.6.into(), "grasps[0].reference.p[1]: "),
            ("/arms/0/bristles/4", 0.5.into(), "arms[0].bristles[4]: "),
            (
                "/stickers/53",
                6.into(),
                "the state of another plant: a sticker has a colour above 5",
            ),
            ("/stickers", vec![0; 53].into(), "the state of another plant: "),
            ("/arms/1/encoders", serde_json::json!([]), "the state of another plant: "),
            ("/version", 4.into(), "plant state of version 4"),
        ] {
            let told = told(pointer, value);
            assert!(told.starts_with(start), "{pointer}: {told}");
        }
        let mut far = whole.clone();
        far["grasps"][1]["hold"] = "Closed".into();
        far["nodes"][0]["p"] = vec![5.0; 3].into();
        let far = Saved::parse(far.to_string().as_bytes()).unwrap();
        let told = plant().restored(far).map(|_| ()).unwrap_err().to_string();
        assert!(told.starts_with("grasps[1]: the cube is not at the hand"), "{told}");
        let mut parted = whole.clone();
        parted["split"] = serde_json::json!({ "axis": 1, "layers": [1, 6] });
        parted["nodes"][1]["p"] = serde_json::json!([
            whole["nodes"][0]["p"][0].as_f64().unwrap() + 0.3,
            whole["nodes"][0]["p"][1],
            whole["nodes"][0]["p"][2],
        ]);
        let parted = Saved::parse(parted.to_string().as_bytes()).unwrap();
        let told = plant().restored(parted).map(|_| ()).unwrap_err().to_string();
        assert!(told.starts_with("nodes: the cube's parts are not at one place"), "{told}");
        assert!(matches!(Saved::parse(&vec![b' '; 2 << 20]), Err(Unfit::Long)));
    }

    /// Returns the reason why a plant of this configuration and seed refuses the state of the
    /// default plant of seed 1, or `None` if it accepts the state.
    fn refused(config: PlantConfig, seed: u64) -> Option<String> {
        let saved = Plant::new(PlantConfig::new(testing::cell()), 1).unwrap().saved();
        match Plant::new(config, seed).unwrap().restored(saved) {
            Ok(_) => None,
            Err(why) => Some(why.to_string()),
        }
    }

    #[test]
    fn state_of_another_plant_is_refused_naming_difference() {
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
    fn start_and_faults_do_not_change_plant_identity() {
        let mut config = PlantConfig::new(testing::cell());
        config.facelets.swap(0, 10);
        config.synchronised = [false; MOST_ARMS];
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
