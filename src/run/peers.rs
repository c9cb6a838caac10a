//! Other nodes of a run on the wall clock, which have joined it.
//!
//! - in: the nodes of the scenario with their endpoints
//! - out: the end of the link to each of them, and the state of their arms

use super::failure::not_created;
use crate::actors::remote::{Home, Introduction, Joined, Receiver, Sender, Stopped, ToHome};
use crate::error::Error;
use crate::net::{self, End, Session};
use crate::record::build;
use crate::scenario::Scenario;
use crate::scenario::node_keys::NodeConfig;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Longest time in which a node joins. It opens its devices meanwhile.
const JOINS: Duration = Duration::from_secs(30);
/// Time in which a last message leaves before the session ends.
const SENT: Duration = Duration::from_millis(100);
/// Number of losses of one message for which limits of time leave room.
const LOSSES: u32 = 3;

/// Nodes that have joined a run, or are about to.
#[derive(Default)]
pub(super) struct Peers {
    /// The nodes.
    pub(super) all: Vec<Peer>,
    /// Longest time of a value on its way.
    pub(super) way: Duration,
    /// Facts by which MP's node has introduced itself; `None` without other nodes.
    pub(super) introduction: Option<Introduction>,
    /// Nodes with a stopped arm.
    pub(super) stopped: Stopped,
    /// Session that carries the links; `None` without other nodes.
    session: Option<Session>,
}

/// Node that has joined a run.
pub(super) struct Peer {
    /// Actors of the node.
    pub(super) node: NodeConfig,
    /// End of the link to it.
    pub(super) home: Home,
    /// Effectors of the node, each with whether its arm is synchronised.
    pub(super) arms: Joined,
    /// Time at which the node was first asked to join.
    pub(super) asked: Instant,
    /// Messages that come by the link; `None` until the node has joined, and once the exchange has
    /// begun.
    pub(super) receiver: Option<Receiver<ToHome>>,
}

impl Drop for Peers {
    /// Ends the parts of the nodes in a run that could not begin or was broken off.
    fn drop(&mut self) {
        if self.dismiss() > 0 {
            std::thread::sleep(SENT);
        }
    }
}

impl Peers {
    /// Ends the parts of all nodes in the run. Returns the number of those whose part had not been
    /// ended before.
    pub(super) fn dismiss(&self) -> usize {
        self.all.iter().filter(|peer| peer.home.dismiss()).count()
    }

    /// Adds a node that has not joined yet, and returns it.
    fn add(&mut self, node: &NodeConfig, home: Home) -> &mut Peer {
        let (node, asked, last) = (node.clone(), Instant::now(), self.all.len());
        self.all.push(Peer { node, home, arms: Vec::new(), asked, receiver: None });
        &mut self.all[last]
    }

    /// Asks all other nodes of a scenario to take part in the run. On the virtual clock there are
    /// none.
    ///
    /// # Errors
    /// The first node that does not take part, with the reason.
    pub(super) async fn join(scenario: &Scenario) -> Result<Self, Error> {
        let network = &scenario.controller.network;
        if !network.is_real {
            return Ok(Self::default());
        }
        let endpoints: Vec<_> = network.nodes.iter().map(|node| node.endpoint.as_str()).collect();
        let failed = |why: String| not_created("network", &why);
        let session = net::open(&[], &endpoints, network.settings.as_deref()).map_err(failed)?;
        let introduction = introduction(scenario);
        let way = Duration::from_secs_f64(network.link.longest(1));
        let trip = Duration::from_secs_f64(2.0 * network.link.longest(LOSSES));
        let mut peers = Self::default();
        peers.way = way;
        for node in &network.nodes {
            let who = format!("node {}", node.name);
            let failed = |why: String| not_created(&who, &why);
            let (link, parcels) = session.link(&node.name, End::Home).map_err(failed)?;
            let home = Home::new(&node.name, Sender::new(link, introduction.run), trip, way);
            let mut receiver = Receiver::new(parcels).of_run(introduction.run);
            // A node that joins too late is told that the run is over.
            let peer = peers.add(node, home);
            tracing::info!("waiting for node {} at {}", node.name, node.endpoint);
            let joined = peer.home.join(&mut receiver, &introduction, JOINS).await;
            peer.arms = joined.map_err(|why| {
                failed(format!(
                    "{why}; it is to run at {} by `rubik-robot node {} --scenario {}`",
                    node.endpoint,
                    node.name,
                    scenario.path.display()
                ))
            })?;
            // While the others join, the arms of this one stand by.
            peer.home.keep_alive();
            peer.receiver = Some(receiver);
        }
        (peers.session, peers.introduction) = (Some(session), Some(introduction));
        Ok(peers)
    }
}

/// Returns the facts by which MP's node introduces itself: another build or another scenario is
/// refused.
fn introduction(scenario: &Scenario) -> Introduction {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let (program, scenario) = identity(scenario);
    Introduction { run: now.as_nanos() as u64, program, scenario }
}

/// Returns the program with its build, and the checksum of the scenario, as both nodes must have
/// them.
pub(super) fn identity(scenario: &Scenario) -> (String, u64) {
    let c = &scenario.controller;
    // Both may reach each other by different endpoints, such as those of a tunnel.
    let actors = |node: &NodeConfig| (node.edps.clone(), node.ecps.clone(), node.vsps.clone());
    let nodes: Vec<_> = c.network.nodes.iter().map(|node| (&node.name, actors(node))).collect();
    let facts = (&c.cell, &c.effectors, c.coordination, &c.vsps, nodes);
    let facts = (facts, c.network.link, &c.control, &c.visual_servo, &c.vision, c.task.word());
    let text = format!("{facts:?}");
    let program = format!("{} build {}", scenario.task.program(), build());
    (program, u64::from(crc32fast::hash(text.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tasks::read;
    use std::path::Path;

    #[test]
    fn identity_changes_with_what_nodes_share() {
        let identity = |text: &str| identity(&read(Path::new("t.toml"), text, &[]).unwrap());
        let plain = identity("");

        assert_eq!(plain, identity("seed = 9\n"), "the plant's seed is no matter of the nodes");
        assert_ne!(plain, identity("[control]\nforce_limit_n = 30\n"));
        assert_ne!(plain, identity("[cube]\nedge_mm = 56\n"));
        assert_ne!(plain, identity("[[node]]\nname = \"b\"\nactors = [\"vsp mpc\"]\n"));
    }
}
