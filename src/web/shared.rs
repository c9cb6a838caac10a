//! The state of a server that each request sees.

use super::guard::Guard;
use super::seats::Seats;
use crate::desk::UiEnd;
use std::sync::Arc;

/// The desk, the rules and the seats of a server.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) desk: UiEnd,
    pub(super) guard: Arc<Guard>,
    pub(super) seats: Arc<Seats>,
}
