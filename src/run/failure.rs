//! Error of a run whose parts could not be created.

use crate::error::{Error, System};

/// Returns the system error of a part `who` that could not be created.
pub(super) fn not_created(who: &str, why: &str) -> Error {
    let cause = System::NotCreated { who: who.into(), why: why.into() };
    Error::System { actor: "supervisor".into(), place: "create".into(), cause }
}
