//! Nodes of a scenario, from the list `[[node]]`.
//!
//! - in: names of nodes and actors, the parameters of the link
//! - out: the actors of each node by index; faults at the key that has to change

use super::catalogue::Declaration;
use super::config::{Owner, VspConfig};
use super::draft::Draft;
use super::injected::{FaultKeys, FaultKind};
use super::keys::{Coordination, Pace};
use super::lists::{Effector, VspKind};
use super::node_keys::{Network, NodeConfig, NodeKeys};
use super::section::Reader;
use crate::motion::PERIOD;
use std::net::IpAddr;
use std::path::Path;

/// Longest macrostep (periods).
const LONGEST: u32 = 100;

/// Builds the nodes of a draft, and checks them: each actor exists and is on one node, beside those
/// that it needs there, and no macrostep becomes too long.
pub(super) fn network(
    draft: &Draft,
    vsps: &[Option<VspConfig>],
    folder: &Path,
    reader: &mut Reader,
) -> Network {
    let mut nodes: Vec<NodeConfig> = Vec::new();
    for (path, keys) in &draft.nodes {
        let (name, endpoint) = (keys.name.clone(), keys.endpoint.clone());
        let mut node = NodeConfig { name, endpoint, edps: vec![], ecps: vec![], vsps: vec![] };
        if keys.actors.is_empty() {
            reader.fault(path, format!("`{path}.actors` is empty: name the actors of this node"));
        }
        for actor in &keys.actors {
            let placed = place(actor, &draft.effectors, vsps).and_then(|actor| {
                let others = nodes.iter().chain([&node]);
                match others.into_iter().find(|other| other.has(actor)) {
                    Some(other) => Err(format!("it is on the node \"{}\" already", other.name)),
                    None => Ok(actor),
                }
            });
            match placed {
                Ok(Placed::Edp(i)) => node.edps.push(i),
                Ok(Placed::Ecp(i)) => node.ecps.push(i),
                Ok(Placed::Vsp(i)) => node.vsps.push(i),
                Err(why) => {
                    let at = format!("{path}.actors");
                    reader.fault(&at, format!("`{at}`: \"{actor}\": {why}"));
                }
            }
        }
        nodes.push(node);
    }
    for ((path, _), node) in draft.nodes.iter().zip(&nodes) {
        if let Some(why) = apart(node, &draft.effectors, vsps) {
            let at = format!("{path}.actors");
            reader.fault(&at, format!("`{at}`: {why}"));
        }
    }
    limits(draft, &nodes, reader);
    let is_real = draft.root.pace == Pace::RealTime && !nodes.is_empty();
    if is_real {
        real(draft, &nodes, reader);
    }
    let link = &draft.root.link;
    let settings = link.settings.as_ref().map(|file| folder.join(file));
    let network = Network { nodes, link: link.model(), settings, is_real };
    let longest = (0..draft.effectors.len()).map(|i| network.least_macrostep(i)).max();
    if let Some(longest) = longest.filter(|longest| *longest > LONGEST) {
        let reason = format!(
            "`link`: an EDP without its ECP beside it would need macrosteps of {longest} periods, \
             at most {LONGEST} are possible: put the ECP on its node, or make the link faster"
        );
        reader.fault("link.delay_ms", reason);
    }
    network
}

/// Returns which actor is missing beside an ECP of a node: its EDP, or a VSP that belongs to it.
fn apart(node: &NodeConfig, effectors: &[Effector], vsps: &[Option<VspConfig>]) -> Option<String> {
    node.ecps.iter().find_map(|&i| {
        let arm = &effectors[i].name;
        if !node.edps.contains(&i) {
            return Some(format!("\"ecp {arm}\" needs \"edp {arm}\" on the same node"));
        }
        let own = |vsp: &VspConfig| vsp.owner == Owner::Ecp(i) && vsp.kind != VspKind::Force;
        let here = |index: &usize| node.vsps.contains(index);
        let away = (0..vsps.len())
            .filter(|index| !here(index))
            .find_map(|index| vsps[index].as_ref().filter(|vsp| own(vsp)));
        away.map(|vsp| match vsp.kind {
            VspKind::Own => format!("\"ecp {arm}\" has the sensor \"{}\" on MP's node", vsp.name),
            _ => format!("\"ecp {arm}\" needs its \"vsp {}\" on the same node", vsp.name),
        })
    })
}

/// Checks clock and coordination of a scenario with nodes.
fn limits(draft: &Draft, nodes: &[NodeConfig], reader: &mut Reader) {
    let root = &draft.root;
    let remote = nodes.iter().any(|node| !node.edps.is_empty());
    if !nodes.is_empty() && root.real_time.period != PERIOD {
        let reason = "`real_time.period_ms`: nodes need servo periods of 2 ms";
        reader.fault("real_time.period_ms", reason);
    }
    if remote && root.coordination == Coordination::Continuous {
        let reason = "`coordination`: an EDP on another node cannot keep step with the others, as \
                      \"continuous\" needs it";
        reader.fault("coordination", reason);
    }
}

/// Checks nodes on the wall clock: they are processes with hardware, each at an endpoint.
fn real(draft: &Draft, nodes: &[NodeConfig], reader: &mut Reader) {
    if !draft.root.bridge.kind.is_hardware() {
        let reason = "`bridge.kind`: nodes on the wall clock need \"serial\" or \"isa\", hardware \
                      which `rubik-robot emulate` stands in for; a simulated plant needs `pace` \
                      \"virtual\"";
        reader.fault("bridge.kind", reason);
    }
    for ((path, _), node) in draft.nodes.iter().zip(nodes) {
        if let Err(why) = endpoint(&node.endpoint, draft.root.link.plain) {
            let at = format!("{path}.endpoint");
            reader.fault(&at, format!("`{at}`: {why}"));
        }
        if let Some(&alone) = node.edps.iter().find(|edp| !node.ecps.contains(edp)) {
            let (at, arm) = (format!("{path}.actors"), &draft.effectors[alone].name);
            let reason = format!(
                "`{at}`: on the wall clock \"edp {arm}\" needs \"ecp {arm}\" on the same node: its \
                 macrosteps would cross the network"
            );
            reader.fault(&at, reason);
        }
    }
}

/// Checks the endpoint of a node. One without encryption may leave the host only if `plain` is set.
fn endpoint(endpoint: &str, plain: bool) -> Result<(), String> {
    let form = || "must be like \"tcp/127.0.0.1:7447\" or \"tls/HOST:PORT\"".to_owned();
    let (protocol, address) = endpoint.split_once('/').ok_or_else(form)?;
    let (host, port) = address.rsplit_once(':').ok_or_else(form)?;
    port.parse::<u16>().ok().filter(|port| *port > 0 && !host.is_empty()).ok_or_else(form)?;
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = bare.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    match protocol {
        "tls" => Ok(()),
        "tcp" if plain || is_loopback || host == "localhost" => Ok(()),
        "tcp" => Err("a link without encryption to another host lets anyone on the network move \
                      the arms: use \"tls/\" with certificates (`link.settings`), or allow it by \
                      `link.plain`"
            .to_owned()),
        _ => Err(form()),
    }
}

/// Checks that the operator moves no arm by hand over a link: MP then sends each macrostep.
pub(super) fn by_hand(task: &dyn Declaration, network: &Network, reader: &mut Reader) {
    let remote = network.nodes.iter().any(|node| !node.edps.is_empty());
    if remote && task.properties().by_hand {
        let reason = format!(
            "`task`: \"{}\" lets the operator move arms by hand, which needs their EDPs on the \
             node of MP",
            task.name()
        );
        reader.fault("task", reason);
    }
}

/// Checks the node of an injected fault, which `path` names.
pub(super) fn check_fault(
    fault: &FaultKeys,
    path: &str,
    nodes: &[(String, NodeKeys)],
    reader: &mut Reader,
) {
    let dies = fault.kind == Some(FaultKind::NodeDies);
    let why = match &fault.node {
        None if dies => "\"node_dies\" needs a node".to_owned(),
        Some(_) if !dies => "only \"node_dies\" takes a node".to_owned(),
        Some(name) if !nodes.iter().any(|(_, node)| node.name == *name) => {
            format!("there is no node \"{name}\"")
        }
        _ => return,
    };
    let at = format!("{path}.{}", if fault.node.is_none() { "kind" } else { "node" });
    reader.fault(&at, format!("`{at}`: {why}"));
}

/// Actor that a node can have.
#[derive(Debug, Clone, Copy)]
enum Placed {
    Edp(usize),
    Ecp(usize),
    Vsp(usize),
}

impl NodeConfig {
    /// Checks whether an actor runs on this node.
    fn has(&self, actor: Placed) -> bool {
        match actor {
            Placed::Edp(i) => self.edps.contains(&i),
            Placed::Ecp(i) => self.ecps.contains(&i),
            Placed::Vsp(i) => self.vsps.contains(&i),
        }
    }
}

/// Finds the actor that a node names.
fn place(
    actor: &str,
    effectors: &[Effector],
    vsps: &[Option<VspConfig>],
) -> Result<Placed, String> {
    let effector = |arm: &str| {
        let found = effectors.iter().position(|effector| effector.name == arm);
        found.ok_or_else(|| format!("there is no effector \"{arm}\""))
    };
    match actor.split_once(' ') {
        Some(("edp", arm)) => effector(arm).map(Placed::Edp),
        Some(("ecp", arm)) => effector(arm).map(Placed::Ecp),
        Some(("vsp", name)) => {
            let is_named = |v: &Option<VspConfig>| v.as_ref().is_some_and(|v| v.name == name);
            let found = vsps.iter().position(is_named);
            let index = found.ok_or_else(|| format!("there is no VSP \"{name}\""))?;
            let kind = vsps[index].as_ref().map(|vsp| vsp.kind);
            match kind {
                Some(VspKind::Cube | VspKind::Face) => Ok(Placed::Vsp(index)),
                _ => Err("only a VSP of a camera can be on another node".to_owned()),
            }
        }
        _ => {
            Err("it is no actor of a node: write \"edp ARM\", \"ecp ARM\" or \"vsp NAME\""
                .to_owned())
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::scenario::Scenario;
    use crate::tasks::read;
    use std::path::Path;

    fn faults(text: &str) -> String {
        match read(Path::new("t.toml"), text, &[]) {
            Ok(_) => String::new(),
            Err(faults) => faults.to_string(),
        }
    }

    const NODE: &str = "[[node]]\nname = \"b\"\n";

    #[test]
    fn node_finds_its_actors() {
        let text = format!("{NODE}actors = [\"edp postument\", \"vsp mpc\", \"vsp gs2\"]\n");
        let Scenario { controller, .. } = read(Path::new("t.toml"), &text, &[]).unwrap();

        let node = &controller.network.nodes[0];
        let vsps: Vec<_> = node.vsps.iter().map(|i| controller.vsps[*i].name.as_str()).collect();
        assert_eq!((node.edps.as_slice(), vsps), ([1].as_slice(), vec!["mpc", "gs2"]));
    }

    #[test]
    fn wrong_node_is_refused_at_its_key() {
        for (text, found) in [
            (format!("{NODE}actors = [\"edp left\"]\n"), "there is no effector \"left\""),
            (format!("{NODE}actors = [\"vsp x\"]\n"), "there is no VSP \"x\""),
            (format!("{NODE}actors = [\"vsp mpf\"]\n"), "only a VSP of a camera"),
            (format!("{NODE}actors = [\"mp\"]\n"), "is no actor of a node"),
            (format!("{NODE}actors = [\"ecp track\"]\n"), "needs \"edp track\" on the same node"),
            (
                format!("{NODE}actors = [\"ecp postument\", \"edp postument\"]\n"),
                "needs its \"vsp gs2\" on the same node",
            ),
            (NODE.to_owned(), "is empty"),
            (format!("{NODE}actors = [\"vsp mpc\", \"vsp mpc\"]\n"), "on the node \"b\" already"),
            (
                format!("{NODE}actors = [\"vsp mpc\"]\n[real_time]\nperiod_ms = 1\n"),
                "nodes need servo periods of 2 ms",
            ),
            (
                format!("task = \"idle\"\n{NODE}actors = [\"edp track\"]\n"),
                "lets the operator move arms by hand",
            ),
            (
                format!("coordination = \"continuous\"\n{NODE}actors = [\"edp track\"]\n"),
                "cannot keep step",
            ),
        ] {
            let message = faults(&text);
            assert!(message.contains(found), "{text}\n{message}");
        }
    }

    /// On the wall clock a node is a process with hardware, at an endpoint that only the own host
    /// reaches without encryption.
    #[test]
    fn node_on_wall_clock_needs_endpoint_and_hardware() {
        let serial = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";
        let read = |actors: &str, endpoint: &str, more: &str| {
            faults(&format!("{serial}{NODE}actors = [{actors}]\nendpoint = \"{endpoint}\"\n{more}"))
        };
        let vsp = "\"vsp mpc\"";
        for good in ["tcp/127.0.0.1:7447", "tcp/localhost:1", "tcp/[::1]:7447", "tls/robot-b:7447"]
        {
            assert_eq!(read(vsp, good, ""), "", "{good}");
        }
        for wrong in ["", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "tcp/:7447", "udp/[::1]:7"] {
            assert!(read(vsp, wrong, "").contains("must be like"), "{wrong}");
        }
        for away in ["tcp/192.0.2.7:7447", "tcp/0.0.0.0:7447", "tcp/robot-b:7447"] {
            assert!(read(vsp, away, "").contains("without encryption"), "{away}");
            assert_eq!(read(vsp, away, "[link]\nplain = true\n"), "", "{away}");
        }
        let edp = read("\"edp postument\"", "tcp/127.0.0.1:7447", "");
        assert!(edp.contains("needs \"ecp postument\" on the same node"), "{edp}");
        let simulated = faults(&format!("pace = \"real-time\"\n{NODE}actors = [{vsp}]\n"));
        assert!(simulated.contains("nodes on the wall clock"), "{simulated}");
    }

    #[test]
    fn servos_belong_to_processes_on_wall_clock_only() {
        let node = format!(
            "{NODE}actors = [\"edp postument\", \"ecp postument\", \"vsp gs2\"]\n\
             endpoint = \"tcp/[::1]:7447\"\n"
        );
        let network = |text: &str| read(Path::new("t.toml"), text, &[]).unwrap().controller.network;
        let virtual_clock = network(&node);
        let serial = "pace = \"real-time\"\n[bridge]\nkind = \"serial\"\n";
        let wall_clock = network(&format!("{serial}{node}"));

        assert_eq!(virtual_clock.servos_of(None, 2), [0, 1]);
        assert_eq!(wall_clock.servos_of(None, 2), [0]);
        assert_eq!(wall_clock.servos_of(Some("b"), 2), [1]);
        let gs2 = wall_clock.nodes[0].vsps[0];
        let here = [None, Some("b")].map(|node| wall_clock.has_vsp(node, gs2));
        assert_eq!((here, virtual_clock.has_vsp(None, gs2)), ([false, true], true));
    }

    #[test]
    fn link_that_needs_long_macrosteps_is_refused() {
        let alone = format!("{NODE}actors = [\"edp postument\"]\n[link]\ndelay_ms = 100\n");
        assert!(faults(&alone).contains("macrosteps of 105 periods"), "{}", faults(&alone));
        let beside = alone.replace("]\n[link]", ", \"ecp postument\", \"vsp gs2\"]\n[link]");
        assert_eq!(faults(&beside), "");
    }

    #[test]
    fn death_of_node_needs_its_name() {
        let node = format!("{NODE}actors = [\"vsp mpc\"]\n");
        for (fault, found) in [
            ("kind = \"node_dies\"", "needs a node"),
            ("kind = \"node_dies\"\nnode = \"c\"", "there is no node \"c\""),
            ("kind = \"withdraw\"\nnode = \"b\"", "only \"node_dies\" takes a node"),
            ("kind = \"node_dies\"\nnode = \"b\"", ""),
        ] {
            let message = faults(&format!("{node}[[fault]]\n{fault}\nat_s = 1\n"));
            assert!(message.contains(found) && message.is_empty() == found.is_empty(), "{message}");
        }
    }

    #[test]
    fn macrostep_of_remote_arm_covers_the_link() {
        let text = format!("{NODE}actors = [\"edp track\"]\n[link]\ndelay_ms = 50\n");
        let config = read(Path::new("t.toml"), &text, &[]).unwrap().controller;

        // A request takes 50.1 ms, 26 periods, and so does its answer.
        assert_eq!([0, 1].map(|effector| config.macrostep(effector)), [55, 8]);
        assert_eq!(config.network.lag(), 82);
    }

    #[test]
    fn ecp_beside_its_edp_needs_no_longer_macrostep() {
        let actors = "[\"edp postument\", \"ecp postument\", \"vsp gs2\"]";
        let text = format!("{NODE}actors = {actors}\n[link]\ndelay_ms = 50\n");
        let config = read(Path::new("t.toml"), &text, &[]).unwrap().controller;

        assert_eq!([0, 1].map(|effector| config.macrostep(effector)), [8, 8]);
        assert_eq!((config.network.lead(1), config.network.lag()), (0, 30));
    }
}
