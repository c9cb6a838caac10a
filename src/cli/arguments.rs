//! Arguments that several commands take.

use super::catalogue;
use super::output::refuse;
use super::scenarios;
use crate::hw::devices::{self, NAME_DEVICES};
use crate::hw::text;
use crate::scenario::{Override, Scenario};
use crate::vision::Lens;
use clap::Args;
use std::path::PathBuf;

/// A scenario and the overrides of its keys.
#[allow(clippy::doc_markdown, reason = "these comments are the help text")]
#[derive(Debug, Clone, Args)]
pub(super) struct ScenarioArgs {
    /// Scenario: a file (TOML), or a name, as in solve; shipped:solve and
    /// shipped:table are built into the program
    #[arg(value_parser = scenarios::parser(), verbatim_doc_comment)]
    pub(super) scenario: PathBuf,
    /// Override of a key, as in control.grip_n=30; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
}

impl ScenarioArgs {
    /// Returns the overrides of `--set`, without those that cannot be parsed: [`Self::load`]
    /// refuses these.
    pub(super) fn overrides(&self) -> Vec<Override> {
        self.set.iter().filter_map(|text| Override::parse(text).ok()).collect()
    }

    /// Loads the scenario with the overrides of `--set` and, after them, those in `more`.
    ///
    /// # Errors
    /// All errors of the file and of the overrides, one a line.
    pub(super) fn load(&self, more: &[Override]) -> Result<Scenario, String> {
        let mut overrides = Vec::new();
        let mut wrong = Vec::new();
        for text in &self.set {
            match Override::parse(text) {
                Ok(over) => overrides.push(over),
                Err(reason) => wrong.push(format!("--set: {reason}")),
            }
        }
        overrides.extend_from_slice(more);
        // The file is read even if an override is wrong, so that all errors are listed at once.
        let loaded = catalogue::load(&self.scenario, &overrides).map_err(|f| f.to_string());
        match (loaded, wrong.is_empty()) {
            (Ok(scenario), true) => Ok(scenario),
            (Ok(_), false) => Err(wrong.join("\n")),
            (Err(faults), _) => {
                Err(wrong.into_iter().chain([faults]).collect::<Vec<_>>().join("\n"))
            }
        }
    }
}

/// Parses the value of an option that must be a finite number of 0 or more.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        Ok(_) => Err("must be a number of 0 or more".to_owned()),
        Err(why) => Err(why.to_string()),
    }
}

/// Checks that the principal point of a lens is inside a picture of this size (px). A point outside
/// was calibrated for another resolution: poses would be wrong although their residuals are small.
///
/// # Errors
/// A text with the point, the size of the picture, and the size for which the lens may have been
/// calibrated.
pub(super) fn check_centre(lens: &Lens, width: u32, height: u32) -> Result<(), String> {
    let (x, y) = lens.centre;
    // The centre of the first pixel has coordinate 0, so the picture begins at -0.5.
    let inside = |at: f64, size: u32| (-0.5..=f64::from(size) - 0.5).contains(&at);
    if inside(x, width) && inside(y, height) {
        return Ok(());
    }
    // A principal point is near the middle of the picture for which it was calibrated.
    let size = |at: f64| (2.0 * at + 1.0).round();
    let of = if x > 0.0 && y > 0.0 {
        format!(" (about {} x {} px)", size(x), size(y))
    } else {
        String::new()
    };
    Err(format!(
        "the principal point ({x}, {y}) is outside of the picture of {width} x {height} px: the \
         optics seem to be those of another resolution{of}: scale fx, fy, cx and cy to this one"
    ))
}

/// Checks that the file of devices of a scenario on hardware can be read. Other scenarios have no
/// such file.
///
/// # Errors
/// The reason why the file cannot be read, with what to do.
pub(super) fn check_devices(scenario: &Scenario) -> anyhow::Result<()> {
    if !scenario.bridge.kind.is_hardware() {
        return Ok(());
    }
    let path = scenario.bridge.devices_at(&scenario.path);
    devices::read(&path).map(|_| ()).map_err(|why| {
        refuse(format!("bridge.devices: {}; {NAME_DEVICES}", text::Unread::new(&path, why)))
    })
}

/// Parses the value of an option that must be a finite number of any sign.
pub(super) fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err("must be a finite number".to_owned()),
    }
}

/// Parses the value of an option that must be a finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("must be a number above 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn principal_point_outside_picture_is_refused() {
        let at =
            |centre| Lens { focal: (600.0, 600.0), centre, radial: [0.0; 3], tangential: [0.0; 2] };

        for centre in [(159.5, 119.5), (-0.5, 0.0), (319.5, 239.5)] {
            assert_eq!(check_centre(&at(centre), 320, 240), Ok(()));
        }
        for centre in [(639.5, 119.5), (159.5, -1.0), (159.5, 240.0), (f64::NAN, 119.5)] {
            assert!(check_centre(&at(centre), 320, 240).is_err(), "{centre:?}");
        }
        let why = check_centre(&at((639.5, 479.5)), 320, 240).unwrap_err();
        assert!(why.contains("320 x 240 px") && why.contains("(about 1280 x 960 px)"), "{why}");
    }
}
