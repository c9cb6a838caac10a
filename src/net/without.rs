//! Stands in the place of the network in a build without the feature `net`.

use super::link::{End, Link, Message, Parcels};
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

/// Opens a client's session.
///
/// # Errors
/// Always.
pub fn open_client(_: &str) -> Result<Session, String> {
    open(&[], &[], None)
}

/// Sign of life of something that others look for, which this build cannot give.
#[derive(Debug)]
pub struct Token(Infallible);

/// Publisher of a topic, which this build cannot open.
#[derive(Debug)]
pub struct Topic(Infallible);

impl Topic {
    /// Publishes data with an attachment.
    ///
    /// # Errors
    /// None: there is no publisher.
    pub fn put(&self, _: &[u8], _: &[u8]) -> Result<(), String> {
        match self.0 {}
    }
}

/// Subscription of keys, which this build cannot open.
#[derive(Debug)]
pub struct Subscription(Infallible);

impl Session {
    /// Returns the identity of the session.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn identity(&self) -> Result<String, String> {
        match self.0 {}
    }

    /// Declares a token.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn token(&self, _: String) -> Result<Token, String> {
        match self.0 {}
    }

    /// Declares the publisher of a topic.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn topic(&self, _: String) -> Result<Topic, String> {
        match self.0 {}
    }

    /// Subscribes to keys.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn subscribe(
        &self,
        _: String,
        _: usize,
        _: impl Fn(Message) + Send + Sync + 'static,
    ) -> Result<Subscription, String> {
        match self.0 {}
    }

    /// Opens an end of a link.
    ///
    /// # Errors
    /// None: there is no session.
    pub fn link(&self, _: &str, _: End) -> Result<(Arc<dyn Link>, Parcels), String> {
        match self.0 {}
    }
}
