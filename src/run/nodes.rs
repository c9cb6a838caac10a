//! Nodes of a run on the virtual clock: the ways to them, and the watch over their beats.
//!
//! On the wall clock the nodes are processes, and [`Peers`] has the links to them.
//!
//! - in: the nodes of the scenario, the model of the link, the flags of dead nodes; nodes that have
//!   joined the run
//! - out: the way to each remote actor; a system error once a node is silent
//!
//! A node sends a beat every [`BEAT`]. Both arms hold by the error of MP's node.

use super::disturbance::InjectedFaults;
use super::peers::Peers;
use super::servos::Servos;
use crate::actors::edp::EdpHandle;
use crate::actors::lookout::Watched;
use crate::actors::remote::{Home, Watch};
use crate::actors::services::Services;
use crate::actors::watchdog::{silent_node, within};
use crate::actors::way::{BEAT, Carries, Toward, Way};
use crate::error::Error;
use crate::motion::{ArmState, PERIOD};
use crate::net::Traffic;
use crate::record::summary::LinkUse;
use crate::scenario::ControllerConfig;
use crate::scenario::node_keys::NodeConfig;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;

/// Least time without a beat, beyond the longest way of one, after which a node counts as dead. It
/// is longer on a link that may lose all beats of this time.
const SILENCE: Duration = Duration::from_millis(120);

/// Longest time in which nodes on the wall clock switch their drives off.
const LEAVES: Duration = Duration::from_secs(3);
/// Longest time between two states that the EDP of a moving arm publishes, with one of them lost.
const PUBLISHED: Duration = Duration::from_millis(100);

/// Nodes beside that of MP.
pub(super) struct Nodes {
    /// Nodes on the virtual clock, each with the way to it.
    modelled: Vec<(NodeConfig, Way)>,
    /// Nodes on the wall clock.
    peers: Peers,
}

impl Nodes {
    /// Makes the ways to the nodes of a scenario on the virtual clock, and begins to watch them.
    /// `peers` are those on the wall clock.
    pub(super) fn start(
        config: &ControllerConfig,
        seed: u64,
        faults: &InjectedFaults,
        services: &Services,
        peers: Peers,
    ) -> Self {
        let nodes = config.network.nodes.iter().filter(|_| !config.network.is_real);
        let nodes = nodes.zip(&faults.nodes).enumerate();
        let nodes = nodes.map(|(i, (node, dead))| {
            let way = Way::new(config.network.link, seed, i, Arc::clone(dead));
            watch_beats(&node.name, &way, services);
            (node.clone(), way)
        });
        Self { modelled: nodes.collect(), peers }
    }

    /// Begins the exchange with the nodes on the wall clock. `edps` are the EDPs as MP's node sees
    /// them.
    ///
    /// # Errors
    /// If the beats of a node do not come back.
    pub(super) async fn begin(
        &mut self,
        config: &ControllerConfig,
        edps: &[EdpHandle],
        servos: &Servos,
        services: &Services,
    ) -> Result<(), Error> {
        for peer in &mut self.peers.all {
            let Some(receiver) = peer.receiver.take() else { continue };
            let others = edps.iter().enumerate().filter(|(i, _)| !peer.node.edps.contains(i));
            let watch = Watch {
                services: services.clone(),
                switches: Arc::clone(&servos.switches),
                stop_button: servos.stop_button.clone(),
                states: others.map(|(i, edp)| (i, edp.watch())).collect(),
                stopped: Arc::clone(&self.peers.stopped),
                cameras: cameras(config, &peer.node),
            };
            peer.home.start(receiver, watch).await?;
        }
        Ok(())
    }

    /// Ends the parts of the nodes on the wall clock in the run.
    pub(super) async fn leave(&self) {
        self.peers.dismiss();
        let limit = Instant::now() + LEAVES;
        for peer in &self.peers.all {
            peer.home.gone(limit).await;
        }
    }

    /// Returns the use of the links to the nodes on the wall clock.
    pub(super) fn links(&self) -> Vec<LinkUse> {
        let used = self.peers.all.iter().map(|peer| {
            let Traffic { sent, received } = peer.home.traffic();
            LinkUse {
                node: peer.node.name.clone(),
                time_s: peer.asked.elapsed().as_secs_f64(),
                sent_bytes: sent,
                received_bytes: received,
            }
        });
        used.collect()
    }

    /// Returns the link to the node on the wall clock that has the ECP and the EDP of an effector;
    /// `None` on MP's node.
    pub(super) fn home_of(&self, effector: usize) -> Option<&Home> {
        self.link_to(|node| node.edps.contains(&effector))
    }

    /// Returns the link to the node on the wall clock that has the VSP with this index; `None` on
    /// MP's node.
    pub(super) fn home_of_vsp(&self, vsp: usize) -> Option<&Home> {
        self.link_to(|node| node.vsps.contains(&vsp))
    }

    /// Returns whether the arm of an effector was synchronised when its node joined; `None` for one
    /// on MP's node.
    pub(super) fn is_synchronised(&self, effector: usize) -> Option<bool> {
        let mut arms = self.peers.all.iter().flat_map(|peer| &peer.arms);
        arms.find(|(arm, _)| *arm == effector).map(|(_, is)| *is)
    }

    /// Returns the link to the node on the wall clock that has an actor.
    fn link_to(&self, has: impl Fn(&NodeConfig) -> bool) -> Option<&Home> {
        self.peers.all.iter().find(|peer| has(&peer.node)).map(|peer| &peer.home)
    }

    /// Returns the way to the EDP of the effector with this index; `None` on MP's node.
    pub(super) fn of_edp(&self, effector: usize) -> Option<&Way> {
        self.way_to(|node| node.edps.contains(&effector))
    }

    /// Returns the EDP of the effector with this index as the node of MP sees it.
    pub(super) fn home(&self, effector: usize, edp: &EdpHandle) -> EdpHandle {
        self.of_edp(effector).map_or_else(|| edp.clone(), |way| edp.clone().across(way))
    }

    /// Returns the states of the arms of these EDPs for the lookout on the node of MP.
    pub(super) fn watched(&self, edps: &[EdpHandle]) -> Vec<Watched> {
        let watched = edps.iter().enumerate().map(|(i, edp)| {
            let real = self.home_of(i).map(|_| self.peers.way);
            let way = self.of_edp(i).map(Way::longest_value).or(real);
            let late = way.map(|way| (way + PUBLISHED).as_secs_f64() / PERIOD);
            Watched { state: edp.watch(), late: late.map(|periods| periods as u64) }
        });
        watched.collect()
    }

    /// Returns the states of all arms as the ECP of the effector with this index sees them. `edps`
    /// are the EDPs as the node of MP sees them, `beside` as actors of their own nodes do.
    pub(super) fn states_seen_by(
        &self,
        effector: usize,
        edps: &[EdpHandle],
        beside: &[EdpHandle],
    ) -> Vec<watch::Receiver<ArmState>> {
        let Some(way) = self.of_ecp(effector) else {
            return edps.iter().map(EdpHandle::watch).collect();
        };
        let node = self.modelled.iter().find(|(node, _)| node.ecps.contains(&effector));
        let is_here = |i: &usize| node.is_some_and(|(node, _)| node.edps.contains(i));
        let states = edps.iter().zip(beside).enumerate().map(|(i, (far, near))| {
            if is_here(&i) {
                near.watch()
            } else {
                way.watch(Toward::Node, Carries::Newest, far.watch())
            }
        });
        states.collect()
    }

    /// Returns the way to the ECP of the effector with this index; `None` on MP's node.
    pub(super) fn of_ecp(&self, effector: usize) -> Option<&Way> {
        self.way_to(|node| node.ecps.contains(&effector))
    }

    /// Returns the way to the VSP with this index; `None` on MP's node.
    pub(super) fn of_vsp(&self, vsp: usize) -> Option<&Way> {
        self.way_to(|node| node.vsps.contains(&vsp))
    }

    /// Returns the way to the node that has an actor; `None` for an actor on MP's node.
    fn way_to(&self, has: impl Fn(&NodeConfig) -> bool) -> Option<&Way> {
        self.modelled.iter().find(|(node, _)| has(node)).map(|(_, way)| way)
    }
}

/// Returns the cameras of a node: index, and size of the pictures (px).
fn cameras(config: &ControllerConfig, node: &NodeConfig) -> BTreeMap<usize, (u32, u32)> {
    let cameras = node.vsps.iter().filter_map(|&vsp| config.vsps[vsp].camera);
    let size = |camera: usize| {
        let optics = &config.cell.cameras[camera].intrinsics;
        (camera, (optics.width, optics.height))
    };
    cameras.map(size).collect()
}

/// Lets a node send beats, and raises an error once they do not arrive.
fn watch_beats(node: &str, way: &Way, services: &Services) {
    let (beat, beats) = watch::channel(0_u64);
    tokio::spawn(async move {
        while !beat.is_closed() {
            beat.send_modify(|count| *count += 1);
            tokio::time::sleep(BEAT).await;
        }
    });
    let mut arrive = way.watch(Toward::Home, Carries::Newest, beats);
    let limit = way.longest_value() + SILENCE.max(BEAT * (way.values_for_one() + 1));
    let (watchdog, node) = (services.supervision.watchdog.clone(), format!("node {node}"));
    tokio::spawn(async move {
        // A jump of the clock ends a part of the wait at once, and the beat after it needs its way.
        while let Some(Ok(())) = within(limit, limit / 2, arrive.changed()).await {
            arrive.borrow_and_update();
        }
        watchdog.raise(silent_node(node, limit));
    });
}
