//! The door of the task `teach`: it reads the file of a way, and gives the kernel the geometry of
//! the arm.

use super::file_keys;
use super::keys::{Keys, Mode};
use super::lesson::{Geometry, Lesson, teach};
use crate::cell::Arm;
use crate::hw::new_file;
use crate::kernel::robot::RobotKernel;
use crate::motion::JointPositions;
use crate::registry::{Setup, Task};
use crate::scenario::ControllerConfig;
use crate::scenario::section::Reader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Task `teach`: an arm is led by hand, and plays the way back.
#[derive(Debug)]
pub struct Teach;

impl Task for Teach {
    type Keys = Keys;
    type Kernel = RobotKernel;

    fn check(keys: &mut Keys, config: &ControllerConfig, reader: &mut Reader) {
        if !keys.file.is_empty() {
            keys.file = beside(&keys.file, reader).display().to_string();
        }
        let Some((_, arm)) = arm_of(keys, config) else {
            let reason = format!("`teach.arm`: there is no effector \"{}\"", keys.arm);
            reader.fault("teach.arm", reason);
            return;
        };
        if keys.mode != Mode::Play {
            // A lesson whose file cannot be written would be lost.
            let writes = !keys.file.is_empty() && !reader.replays;
            if writes && let Err(why) = new_file::check_folder(Path::new(&keys.file)) {
                reader.fault("teach.file", format!("`teach.file`: {why}"));
            }
            return;
        }
        if keys.file.is_empty() {
            reader.fault("teach", "`teach.file` is missing: mode \"play\" needs the file of a way");
        } else if let Err(faults) = file_keys::load(Path::new(&keys.file), arm) {
            reader.faults.0.extend(faults.0);
        }
    }

    fn kernel(setup: Setup<'_, Self>) -> Result<RobotKernel, String> {
        let keys = setup.keys;
        let (index, arm) = arm_of(keys, setup.config).ok_or("there is no such arm")?;
        let file = (!keys.file.is_empty()).then(|| PathBuf::from(&keys.file));
        let given = match (&file, keys.mode) {
            (Some(file), Mode::Play) => {
                Some(file_keys::load(file, arm).map_err(|faults| faults.to_string())?)
            }
            _ => None,
        };
        Ok(teach(Lesson {
            arm: (index, arm.name.clone()),
            given,
            file,
            plays: keys.mode != Mode::Teach,
            by: keys.play,
            speed: keys.speed,
            tolerance: keys.tolerance,
            still: keys.still,
            patience: keys.patience,
            geometry: geometry(arm),
        }))
    }
}

/// Returns the arm that the keys name, with its index.
fn arm_of<'a>(keys: &Keys, config: &'a ControllerConfig) -> Option<(usize, &'a Arm)> {
    config.cell.arms.iter().enumerate().find(|(_, arm)| arm.name == keys.arm)
}

/// Returns the path of the file: a scenario names it relative to its own folder, an option relative
/// to the working directory.
fn beside(file: &str, reader: &Reader) -> PathBuf {
    let place = reader.places.get("teach.file").filter(|place| place.source.is_file);
    let folder = place.and_then(|place| Path::new(&place.source.name).parent());
    folder.map_or_else(|| PathBuf::from(file), |folder| folder.join(file))
}

/// Returns the geometry of an arm as functions.
fn geometry(arm: &Arm) -> Geometry {
    let (one, other) = (arm.clone(), arm.clone());
    Geometry {
        forward: Arc::new(move |joints: &JointPositions| {
            one.model.base_from_flange(joints) * one.flange_from_tool
        }),
        read: Arc::new(move |text: &str| {
            file_keys::read("the taught way", text, &other).map_err(|faults| faults.to_string())
        }),
    }
}
