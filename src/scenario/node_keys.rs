//! The keys of the list `[[node]]` and of the section `link`, and the node that is built of them.

use super::section::section;
use crate::motion::PERIOD;
use crate::net::LinkModel;
use std::path::PathBuf;

section! {
    /// Other node than that of MP, with the actors that run there.
    pub NodeKeys {
        /// Name of the node.
        name: String = String::new();
        /// Actors of the node: "edp ARM", "ecp ARM", or "vsp NAME" of a camera; all others are on
        /// MP's node.
        actors: Vec<String> = Vec::new();
        /// Endpoint at which the node listens for MP's node on the wall clock: a protocol, `tcp` or
        /// `tls`, a host and a port, such as "tcp/127.0.0.1:7447".
        endpoint: String = String::new();
    }
}

section! {
    /// Link between MP's node and each other one: its model on the virtual clock. On the wall clock
    /// these times are bounds that the controller relies on.
    pub LinkKeys {
        /// Shortest time of a message on its way.
        delay [ms]: f64 = 0.2, 0.0..=1000.0;
        /// Greatest addition to that time, drawn for each message.
        jitter [ms]: f64 = 0.1, 0.0..=1000.0;
        /// Share of the messages that are lost on their way.
        loss: f64 = 0.0, 0.0..=0.2;
        /// Time after which a lost message is sent again.
        resend [ms]: f64 = 20.0, 1.0..=10000.0;
        /// File of zenoh's own settings for the wall clock, such as certificates and access rules,
        /// relative to the scenario's folder.
        settings: Option<String> = None;
        /// Whether links without encryption (`tcp`) may lead to other hosts.
        plain: bool = false;
    }
}

/// Node with its actors.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeConfig {
    /// Name of the node.
    pub name: String,
    /// Endpoint at which the node listens on the wall clock; empty on the virtual clock.
    pub endpoint: String,
    /// Indices of the effectors whose EDPs run there.
    pub edps: Vec<usize>,
    /// Indices of the effectors whose ECPs run there, beside their EDPs.
    pub ecps: Vec<usize>,
    /// Indices of the VSPs that run there.
    pub vsps: Vec<usize>,
}

impl LinkKeys {
    /// Returns the model of the link.
    #[must_use]
    pub fn model(&self) -> LinkModel {
        let Self { delay, jitter, loss, resend, .. } = *self;
        LinkModel { delay, jitter, loss, resend }
    }
}

/// Nodes beside that of MP, and the link to each of them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Network {
    /// Nodes beside that of MP.
    pub nodes: Vec<NodeConfig>,
    /// Model of the link.
    pub link: LinkModel,
    /// File of zenoh's own settings.
    pub settings: Option<PathBuf>,
    /// Whether the nodes are processes on the wall clock. On the virtual clock the link is a model,
    /// and all actors are in one process.
    pub is_real: bool,
}

/// Difference between the macrostep of an EDP that is not beside its ECP and the time of a request
/// with its answer (periods): two periods at its end, and one in which the command begins.
const MARGIN: u32 = 3;
/// Periods in which an ECP asks the EDP beside it for the state of the arm, before it sends the
/// first command of a motion.
const BEGINS: u64 = 4;

impl Network {
    /// Returns the indices of those of `effectors` effectors whose servos run in a process: that of
    /// the node `node`, or of MP's node if it is `None`.
    #[must_use]
    pub fn servos_of(&self, node: Option<&str>, effectors: usize) -> Vec<usize> {
        let here = |effector: &usize| {
            let of = self.nodes.iter().find(|node| node.edps.contains(effector));
            of.filter(|_| self.is_real).map(|node| node.name.as_str()) == node
        };
        (0..effectors).filter(here).collect()
    }

    /// Returns whether the VSP with this index runs in the process of the node `node`, or of MP's
    /// node if it is `None`.
    #[must_use]
    pub fn has_vsp(&self, node: Option<&str>, vsp: usize) -> bool {
        let of = self.nodes.iter().find(|node| node.vsps.contains(&vsp));
        of.filter(|_| self.is_real).map(|node| node.name.as_str()) == node
    }

    /// Returns the number of servo periods by which the EDP of an effector answers earlier: the
    /// time of a request of its ECP and of the answer, each of which may be lost once. It is 0 for
    /// an ECP on the node of its EDP.
    #[must_use]
    pub fn lead(&self, effector: usize) -> u32 {
        let far =
            |node: &NodeConfig| node.edps.contains(&effector) && !node.ecps.contains(&effector);
        if self.nodes.iter().any(far) { 2 * self.way() } else { 0 }
    }

    /// Returns the least length of a macrostep of an effector (periods): if its EDP is not beside
    /// its ECP, the next command of a shorter one would come too late.
    #[must_use]
    pub fn least_macrostep(&self, effector: usize) -> u32 {
        match self.lead(effector) {
            0 => 0,
            lead => lead + MARGIN,
        }
    }

    /// Returns the time between the order of a motion and its beginning (periods): all arms begin
    /// once the first command has reached the EDPs on other nodes. It is 0 if there is none.
    #[must_use]
    pub fn lag(&self) -> u64 {
        let edps = self.nodes.iter().flat_map(|node| &node.edps);
        // The order crosses once to an ECP. To an EDP alone, the request for the state of the arm,
        // its answer and the command cross.
        let crossings = edps.map(|effector| if self.lead(*effector) == 0 { 1 } else { 3 });
        crossings.max().map_or(0, |times| times * u64::from(self.way()) + BEGINS)
    }

    /// Returns the time of a message on its way that is lost once (periods).
    fn way(&self) -> u32 {
        (self.link.longest(1) / PERIOD).ceil() as u32
    }
}
