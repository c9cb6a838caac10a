//! Stands in the place of the network in a build without the feature `net`.

use super::link::{End, Link, Parcels};
use std::convert::Infallible;
use std::path::Path;
use std::sync::Arc;

/// Session of a node with its peers, which this build cannot open.
#[derive(Debug)]
pub struct Session(Infallible);

/// Returns the error of a build without the network.
///
/// # Errors
/// Always.
pub fn open(_: &[&str], _: &[&str], _: Option<&Path>) -> Result<Session, String> {
    Err("this build has no network: build it with `--features net`".to_owned())
}

impl Session {
    /// Opens an end of a link.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn link(&self, _: &str, _: End) -> Result<(Arc<dyn Link>, Parcels), String> {
        match self.0 {}
    }
}
