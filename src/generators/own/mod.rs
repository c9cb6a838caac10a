//! The door for motion generators of any crate: a trait, and the library in which they are found
//! by name.
//!
//! - in: types that implement [`MotionGenerator`], registered with [`crate::App::generator`]
//! - out: a [`Library`], which makes the generator of a `Behaviour::Own`
//!
//! The order of such a generator is plain data, so runs record and replay it like any other. The
//! generator runs where the others run: in an ECP under sporadic coordination and in a programme,
//! in MP under continuous coordination. The generators in `paths` and `contact` use the same door.
//!
//! ```
//! use rubik_robot::generators::own::{Clock, Forecast, MotionGenerator, Pacing, Site, Touch};
//! use rubik_robot::generators::{Inputs, Next, Outcome};
//! use rubik_robot::motion::{JointPositions, Motion};
//! use serde::{Deserialize, Serialize};
//!
//! /// Order to nod with the wrist.
//! #[derive(Serialize, Deserialize)]
//! struct Nods {
//!     /// Angle (rad).
//!     angle: f64,
//!     /// Time of all nods (s).
//!     seconds: f64,
//! }
//!
//! struct Nod(Nods, JointPositions, Clock);
//!
//! impl MotionGenerator for Nod {
//!     type Order = Nods;
//!
//!     fn begin(order: Nods, site: &Site<'_>) -> Result<Self, String> {
//!         if order.seconds < 2.0 {
//!             return Err(format!("{} s are too short to nod", order.seconds));
//!         }
//!         Ok(Self(order, site.arm.desired_joints, Clock::new(site)))
//!     }
//!
//!     fn next(&mut self, inputs: &Inputs<'_>) -> Next {
//!         let Self(order, start, clock) = self;
//!         if clock.time() >= order.seconds {
//!             return Next::Done(Outcome::Reached);
//!         }
//!         let part = (clock.advance(inputs) / order.seconds).min(1.0);
//!         let mut at = *start;
//!         at.0[5] += order.angle * (1.0 - (2.0 * std::f64::consts::PI * part).cos());
//!         Next::go(Motion::Joints(at))
//!     }
//!
//!     fn pacing(&self) -> Pacing {
//!         Pacing::Clock
//!     }
//! }
//!
//! let order = Nod::behaviour("nod", &Nods { angle: 0.1, seconds: 4.0 });
//! assert!(order.is_ok());
//! // In `main`: rubik_robot::App::new().generator::<Nod>("nod").main()
//! # let _ = (Touch::Free, None::<Forecast>);
//! ```

mod clock;
mod forecast;
mod library;
mod order;
mod running;
mod traits;

pub use clock::Clock;
pub use forecast::{Forecast, Place, Places};
pub use library::Library;
pub use order::OwnOrder;
pub use running::Running;
pub use traits::{MotionGenerator, Pacing, Site, Touch};
