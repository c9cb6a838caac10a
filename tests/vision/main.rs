//! Tests of vision with pictures of the plant's renderer, of a second renderer, and without a cube.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod colours;
mod cube_photo;
mod kinds;
mod rendered;
mod scenes;
