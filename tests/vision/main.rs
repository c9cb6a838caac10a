//! What the vision sees in pictures of its own renderer, of another one, and in none of a cube.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop loudly")]

mod colours;
mod cube_photo;
mod kinds;
mod rendered;
mod scenes;
