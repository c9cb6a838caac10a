//! Answers of virtual sensors as messages of a recording. A replay needs them: besides the readings
//! of the port they are inputs of the controller.
//!
//! - in: a [`Sensed`]; or the bytes of a message
//! - out: the bytes; or a [`Sensed`] that equals the original to the bit

use super::cdr::{Malformed, Reader, Writer};
use crate::spatial::Pose;
use crate::vision::sensor::FaceReading;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

/// One answer of a virtual sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensed {
    /// Period of 2 ms in which the sensor was asked.
    pub period: u64,
    /// Name of the sensor.
    pub sensor: String,
    /// Text of the request to the sensor.
    pub asked: String,
    /// Result, or the reason why there is none.
    pub found: Result<Found, String>,
}

/// Result of a virtual sensor.
#[derive(Debug, Clone, PartialEq)]
pub enum Found {
    /// Cube in front of the stand-alone camera.
    Cube {
        /// Pose of the cube.
        world_from_cube: Pose,
        /// Speed of the cube's centre (m/s).
        speed: f64,
        /// Period of 2 ms in which the picture was exposed.
        exposed: u64,
    },
    /// Face of the cube in front of the camera of a hand.
    Face(FaceReading),
    /// Reading of a user's own sensor.
    Own(Value),
}

// Field `kind` of the message: which result its numbers are.
const CUBE: u8 = 0;
const FACE: u8 = 1;
const OWN: u8 = 2;

impl Sensed {
    /// Encodes this answer of a sensor as a message with the time stamp `stamp` (ns).
    pub fn write(&self, stamp: u64, to: &mut Writer) {
        to.time(stamp);
        to.u64(self.period);
        to.string(&self.sensor);
        to.string(&self.asked);
        to.string(self.found.as_ref().err().map_or("", String::as_str));
        // All numbers are written as `float64`, which holds the numbers of periods up to 2^53
        // exactly.
        let mut values = Vec::new();
        let kind = match &self.found {
            Ok(Found::Cube { world_from_cube, speed, exposed }) => {
                values.extend(pose_numbers(world_from_cube));
                values.extend([*speed, *exposed as f64]);
                CUBE
            }
            Ok(Found::Face(face)) => {
                values.extend(face.rgb.iter().flatten());
                values.extend(face.colours.iter().map(|c| f64::from(*c)));
                values.extend(face.confidences);
                values.extend(pose_numbers(&face.camera_from_face));
                values.extend([face.residual_px, face.confidence]);
                values.extend(face.occluded.iter().map(|o| f64::from(u8::from(*o))));
                FACE
            }
            Ok(Found::Own(_)) => OWN,
            // An answer with a reason instead of a result has no kind; readers ignore it.
            Err(_) => CUBE,
        };
        to.u8(kind);
        to.f64_sequence(&values);
        match &self.found {
            Ok(Found::Own(reading)) => to.string(&reading.to_string()),
            _ => to.string(""),
        }
    }

    /// Decodes the message of an answer of a sensor.
    ///
    /// # Errors
    /// [`Malformed`] if the bytes are no such message.
    pub fn read(bytes: &[u8]) -> Result<Self, Malformed> {
        let mut from = Reader::new(bytes)?;
        from.time()?;
        let period = from.u64()?;
        let sensor = from.string()?.to_owned();
        let asked = from.string()?.to_owned();
        let refusal = from.string()?.to_owned();
        let kind = from.u8()?;
        let values = from.f64_sequence()?;
        let mut values = Values(values.iter().copied());
        let found = if !refusal.is_empty() {
            Err(refusal)
        } else if kind == CUBE {
            let (world_from_cube, speed) = (values.pose()?, values.next()?);
            // Recordings of older versions lack the period of the exposure: the request's is used.
            let exposed = values.next().map_or(period, |exposed| exposed as u64);
            Ok(Found::Cube { world_from_cube, speed, exposed })
        } else if kind == OWN {
            Ok(Found::Own(serde_json::from_str(from.string()?).map_err(|_| Malformed)?))
        } else {
            // Recordings of older versions have no text after the numbers.
            Ok(Found::Face(values.face()?))
        };
        Ok(Self { period, sensor, asked, found })
    }
}

/// Returns a pose as seven numbers: x y z (m), then the quaternion qx qy qz qw.
#[must_use]
pub(crate) fn pose_numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// Reader of the numbers of a message, one after the other.
struct Values<I>(I);

impl<I: Iterator<Item = f64>> Values<I> {
    fn next(&mut self) -> Result<f64, Malformed> {
        self.0.next().ok_or(Malformed)
    }

    /// Reads the next `N` numbers.
    fn array<const N: usize>(&mut self) -> Result<[f64; N], Malformed> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.next()?;
        }
        Ok(values)
    }

    /// Reads a pose as [`pose_numbers`] writes it. The quaternion is not normalised, since that
    /// would change its bits.
    fn pose(&mut self) -> Result<Pose, Malformed> {
        let [x, y, z, qx, qy, qz, qw] = self.array()?;
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
        Ok(Pose::from_parts(Translation3::from(Vector3::new(x, y, z)), rotation))
    }

    /// Reads the numbers of a face that was read, in the order in which [`Sensed::write`] writes
    /// them.
    fn face(&mut self) -> Result<FaceReading, Malformed> {
        let mut rgb = [[0.0; 3]; 9];
        for tile in &mut rgb {
            *tile = self.array()?;
        }
        let colours = self.array::<9>()?.map(|c| c as u8);
        let confidences = self.array()?;
        let camera_from_face = self.pose()?;
        let [residual_px, confidence] = self.array()?;
        let occluded = self.array::<9>()?.map(|o| o != 0.0);
        Ok(FaceReading {
            rgb,
            colours,
            confidences,
            camera_from_face,
            residual_px,
            confidence,
            occluded,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Encodes an answer and decodes the message.
    fn back(sensed: &Sensed) -> Sensed {
        let mut writer = Writer::default();
        sensed.write(9, &mut writer);
        Sensed::read(&writer.bytes()).unwrap()
    }

    #[test]
    fn decoded_answer_equals_encoded_answer_exactly() {
        let pose = Pose::new(Vector3::new(0.1, 0.2, 1.0 / 3.0), Vector3::new(0.3, -0.7, 0.1));
        let face = FaceReading {
            rgb: std::array::from_fn(|i| [i as f64 / 7.0, 0.0, 255.0]),
            colours: [0, 1, 2, 3, 4, 5, 0, 1, 2],
            confidences: std::array::from_fn(|i| i as f64 / 9.0),
            camera_from_face: pose,
            residual_px: 0.1,
            confidence: 0.9,
            occluded: std::array::from_fn(|i| i == 4),
        };
        for found in [
            Ok(Found::Cube { world_from_cube: pose, speed: 0.01, exposed: 3 }),
            Ok(Found::Face(face)),
            Ok(Found::Own(serde_json::json!({"distance_m": 1.0 / 3.0}))),
            Err("glare".to_owned()),
        ] {
            let sensed = Sensed { period: 4, sensor: "vsp gs1".into(), asked: "x".into(), found };
            assert_eq!(back(&sensed), sensed);
        }
    }
}
