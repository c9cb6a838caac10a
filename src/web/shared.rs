//! State of a server that all requests share.

use super::guard::Guard;
use super::pictures::Files;
use super::seats::Seats;
use crate::desk::UiEnd;
use std::sync::Arc;

/// Desk, rules, seats and pictures of a server.
#[derive(Clone)]
pub(super) struct Shared {
    pub(super) desk: UiEnd,
    pub(super) guard: Arc<Guard>,
    pub(super) seats: Arc<Seats>,
    pub(super) pictures: Arc<Files>,
}
