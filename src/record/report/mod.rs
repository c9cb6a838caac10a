//! The report of a run: one page that needs nothing else, made of a recording.
//!
//! - in: a recording, whole or cut off
//! - out: HTML with pictures and curves in it, for a screen in light or dark and for paper; no
//!   scripts

mod classes;
mod figures;
mod html;
mod page;
mod story;
mod svg;

pub(crate) use html::{HEAD, STYLE, escaped};
pub use story::{Story, gather};
pub(crate) use svg::{number, step};

/// The page.
#[must_use]
pub fn page(story: &Story) -> String {
    page::page(story)
}
