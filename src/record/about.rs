//! The description of a run with which its recording begins.
//!
//! - in: the scenario, the options that override it, the circumstances of the run
//! - out: [`RunInfo`]

use super::sheet::RunInfo;
use super::{build, calibration};
use crate::scenario::keys::Pace;
use crate::scenario::{Override, Scenario};
use crate::servo::period::Length;
use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

/// Circumstances of a recorded run, which its recording names.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Begun {
    /// Whether an operator can be asked.
    pub attended: bool,
    /// Whether the run resumes an interrupted one.
    pub resumed: bool,
}

impl RunInfo {
    /// Makes the description with which a recording of this scenario begins. It does not have the
    /// checksum of the program, for which the file of the program is read: see
    /// [`RunInfo::with_build`].
    ///
    /// ```
    /// use rubik_robot::record::about::Begun;
    /// use rubik_robot::record::sheet::RunInfo;
    /// use rubik_robot::tasks;
    /// use std::path::Path;
    ///
    /// let scenario = tasks::read(Path::new("t.toml"), "task = \"idle\"\nseed = 7\n", &[])?;
    ///
    /// let about = RunInfo::of(&scenario, &[], Begun::default());
    ///
    /// assert_eq!((&*about.facts["task"], &*about.facts["seed"]), ("idle", "7"));
    /// // A recording of simulated time begins at 0, so that it is the same in each run.
    /// assert_eq!((about.start, about.length.nanos()), (0, 2_000_000));
    /// # Ok::<(), rubik_robot::scenario::fault::Faults>(())
    /// ```
    #[must_use]
    pub fn of(scenario: &Scenario, overrides: &[Override], begun: Begun) -> Self {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let config = &scenario.controller;
        let length = Length::of_seconds(scenario.real_time.period);
        let arms: Vec<_> = config.cell.arms.iter().map(|arm| arm.name.as_str()).collect();
        let pace = match scenario.pace {
            Pace::Virtual => "virtual",
            Pace::RealTime => "real-time",
        };
        // Only a simulation knows the true state of the cube.
        let truth = (!scenario.bridge.kind.is_hardware()).then(|| scenario.cube().to_string());
        let program = scenario.task.program();
        let loose = scenario.objects().iter().enumerate().filter(|(_, keys)| !keys.is_fixed());
        // The metadata of MCAP is a map of texts.
        let facts = [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("program", program.program.clone()),
            ("program_version", program.version.clone()),
            ("tasks", program.tasks.join(" ")),
            ("platform", format!("{} {}", std::env::consts::ARCH, std::env::consts::OS)),
            ("scenario", scenario.path.display().to_string()),
            ("task", config.task.word().to_owned()),
            ("coordination", config.coordination.word().to_owned()),
            ("pace", pace.to_owned()),
            ("seed", scenario.seed.to_string()),
            ("cube_start", truth.unwrap_or_default()),
            ("arms", arms.join(" ")),
            ("period_ns", length.nanos().to_string()),
            ("attended", begun.attended.to_string()),
            ("resumed", begun.resumed.to_string()),
            ("started_unix_s", now.as_secs().to_string()),
            ("declared_face_s", config.vision.face.to_string()),
            ("standalone_xyz", calibration::standalone(&config.cell)),
            ("force_limit_n", config.control.force_limit.to_string()),
            ("torque_limit_nm", config.control.torque_limit.to_string()),
        ];
        // A recording of simulated time begins at 0, so that it is the same in each run.
        let start = match scenario.pace {
            Pace::Virtual => 0,
            Pace::RealTime => now.as_nanos() as u64,
        };
        Self {
            cell: config.cell.clone(),
            scenario: scenario.text.clone(),
            objects: loose.map(|(i, keys)| (i, keys.link())).collect(),
            options: overrides
                .iter()
                .map(|o| (o.option.clone(), o.key.clone(), o.value.clone()))
                .collect(),
            facts: facts
                .map(|(name, value)| (name.to_owned(), value))
                .into_iter()
                .collect::<BTreeMap<_, _>>(),
            start,
            length,
        }
    }

    /// Returns the description with the checksum of the running program, by which a verification of
    /// the recording finds that another build made it.
    #[must_use]
    pub fn with_build(mut self) -> Self {
        self.facts.insert("build".to_owned(), build());
        self
    }
}
