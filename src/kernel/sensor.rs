//! Readings of a user's own sensors, as kernels and VSPs know them.
//!
//! - in: a VSP's kernel, which measures with its device ([`SensorKernel`])
//! - out: the latest [`SensorReading`] of each VSP, for the kernels of its owner

use crate::motion::{ArmState, PERIOD};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeMap;

/// Kernel of a VSP together with its device, of any type.
pub trait SensorKernel: Send {
    /// Measures once. `period` is the present one of 2 ms, `arms` are the latest states of the
    /// effectors in the scenario's order.
    ///
    /// # Errors
    /// The reason why there is no reading now.
    fn measure(&mut self, period: u64, arms: &[ArmState]) -> Result<Value, String>;
}

/// One reading of a sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorReading {
    /// Period of 2 ms of the measurement.
    pub period: u64,
    /// Number of periods after which the reading no longer describes the present.
    pub valid: u64,
    /// The reading, or the reason why there is none.
    pub value: Result<Value, String>,
}

/// Latest readings of the sensors that one actor owns, by the names of their VSPs. A sensor that
/// has not measured yet has none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SensorReadings(pub BTreeMap<String, Option<SensorReading>>);

impl SensorReadings {
    /// Returns the reading of a sensor as it is in period `now` of 2 ms.
    ///
    /// # Errors
    /// In words: the actor does not own the sensor; there is no reading, or only an old one; the
    /// device has none; or it is of another type.
    pub fn get<R: DeserializeOwned>(&self, name: &str, now: u64) -> Result<R, String> {
        let reading = self.0.get(name).ok_or_else(|| {
            let known: Vec<&str> = self.0.keys().map(String::as_str).collect();
            let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
            format!("there is no sensor `{name}` here; known: {known}")
        })?;
        let Some(reading) = reading else {
            return Err(format!("the sensor `{name}` has not measured yet"));
        };
        let age = now.saturating_sub(reading.period);
        if age > reading.valid {
            let seconds = age as f64 * PERIOD;
            return Err(format!("the last reading of `{name}` is {seconds:.2} s old"));
        }
        let value = reading.value.as_ref().map_err(|why| format!("sensor `{name}`: {why}"))?;
        R::deserialize(value).map_err(|why| format!("reading of the sensor `{name}`: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_present_readings_of_known_sensors_are_returned() {
        let reading = |period, value| Some(SensorReading { period, valid: 10, value });
        let readings = SensorReadings(BTreeMap::from([
            ("new".to_owned(), None),
            ("good".to_owned(), reading(100, Ok(Value::from(0.5)))),
            ("dark".to_owned(), reading(100, Err("no light".to_owned()))),
        ]));
        let why = |name: &str, now: u64| readings.get::<f64>(name, now).unwrap_err();

        assert_eq!(readings.get::<f64>("good", 110), Ok(0.5));
        assert_eq!(why("good", 111), "the last reading of `good` is 0.02 s old");
        assert_eq!(why("new", 0), "the sensor `new` has not measured yet");
        assert_eq!(why("dark", 100), "sensor `dark`: no light");
        assert_eq!(why("old", 0), "there is no sensor `old` here; known: dark, good, new");
        let wrong = readings.get::<bool>("good", 100).unwrap_err();
        assert!(wrong.starts_with("reading of the sensor `good`: "), "{wrong}");
    }
}
