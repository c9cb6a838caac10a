//! Report of a run: one self-contained HTML page, made from a recording.
//!
//! - in: a recording, whole or cut off
//! - out: HTML that contains its pictures and curves, for light and dark screens and for paper,
//!   without scripts

mod classes;
mod figures;
mod html;
mod page;
mod story;
mod svg;

pub(crate) use html::{HEAD, STYLE, escaped};
pub use story::{Story, gather};
pub(crate) use svg::{number, step};

/// Returns the report of a run as an HTML page.
#[must_use]
pub fn page(story: &Story) -> String {
    page::page(story)
}
