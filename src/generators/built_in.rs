//! The library of the generators of this crate that tasks order by name.
//!
//! - in: nothing
//! - out: the [`Library`] to which a program adds its own generators

use super::own::Library;

/// Returns the library with the generators of this crate.
#[must_use]
pub fn library() -> Library {
    Library::default()
}
