//! The activity of each actor, as a state and in words, for the UIs.

use super::moment::Moment;
use crate::actors::latest::ArmLatest;
use crate::cell::Cell;
use crate::motion::{ArmState, Synchronisation};
use crate::operator::{ActorView, CameraView, ControlView, State};

/// The facts about all actors at one moment.
pub(super) struct Actors<'a> {
    /// State of the run.
    pub(super) control: ControlView,
    /// Whether a fatal error has stopped MP.
    pub(super) fatal: bool,
    /// Whether an arm has published a state; before that the VSPs count as absent.
    pub(super) begun: bool,
    /// Believed cell.
    pub(super) cell: &'a Cell,
    /// Latest values.
    pub(super) moment: &'a Moment,
    /// Name and camera of each VSP.
    pub(super) vsps: &'a [(String, Option<usize>)],
    /// Views of all cameras.
    pub(super) cameras: &'a [CameraView],
}

impl Actors<'_> {
    /// Returns the name, state and activity of each actor, as the user interfaces show them: UI and
    /// MP first, then ECPs, EDPs and VSPs.
    pub(super) fn views(&self) -> Vec<ActorView> {
        let mut views = vec![view("ui".into(), State::Running, "shows the run"), self.mp()];
        let arms = self.cell.arms.iter().enumerate();
        views.extend(arms.clone().map(|(i, arm)| self.ecp(i, &arm.name)));
        views.extend(arms.map(|(i, arm)| self.edp(i, &arm.name)));
        views.extend(self.vsps.iter().map(|(name, camera)| self.vsp(name, *camera)));
        views
    }

    /// Returns whether the run has ended.
    fn is_over(&self) -> bool {
        self.control == ControlView::Ended
    }

    /// Returns the state to show for an actor: `state` while the run proceeds, otherwise that of a
    /// run that waits for its start, is paused or has ended.
    fn alive(&self, state: State) -> State {
        match self.control {
            ControlView::Ended => State::Absent,
            ControlView::Waiting => State::Idle,
            ControlView::Paused => State::Held,
            ControlView::Running | ControlView::Terminated => state,
        }
    }

    /// Returns the state and activity of MP for the user interfaces.
    fn mp(&self) -> ActorView {
        let (state, words) = match self.control {
            // The fault stays visible after the run has ended.
            _ if self.fatal => (State::Fault, "stopped by an error"),
            ControlView::Waiting => (State::Idle, "waits for the start"),
            ControlView::Paused => (State::Held, "paused"),
            ControlView::Ended => (State::Absent, "has ended"),
            // With manual orders MP waits for the operator most of the time.
            ControlView::Running | ControlView::Terminated => {
                (if self.moment.manual { State::Idle } else { State::Running }, self.moment.mp)
            }
        };
        view("mp".into(), state, words)
    }

    /// Returns the state and activity of an arm's ECP for the user interfaces. `index` is that of
    /// the arm, `arm` its name.
    fn ecp(&self, index: usize, arm: &str) -> ActorView {
        let (state, words) = match (&self.moment.orders, self.moment.arms.get(index)) {
            // A recording holds no orders: the motion of the arm shows that there was one.
            (None, Some(latest)) => (self.edp_state(latest).0, "not recorded"),
            (None, None) => (State::Absent, "not recorded"),
            (Some(orders), _) => match orders.get(index).copied().flatten() {
                Some(order) => (State::Running, order),
                None => (State::Idle, "waits for an order"),
            },
        };
        let words = if self.is_over() { "" } else { words };
        view(format!("ecp {arm}"), self.alive(state), words)
    }

    /// Returns the state and activity of an arm's EDP for the user interfaces. `index` is that of
    /// the arm, `arm` its name.
    fn edp(&self, index: usize, arm: &str) -> ActorView {
        let latest = self.moment.arms.get(index);
        // Not through `alive`: an arm holds, or has a fault, whatever the run does.
        let absent = (State::Absent, String::new());
        let (state, words) = latest.map_or(absent, |latest| self.edp_state(latest));
        view(format!("edp {arm}"), state, &words)
    }

    /// Returns the state of an EDP and its activity in words, concluded from the state of its arm.
    fn edp_state(&self, latest: &ArmLatest) -> (State, String) {
        let state: &ArmState = &latest.state;
        // A fault comes first: an arm with a fault may have lost its synchronisation as well.
        if let Some(fault) = state.fault {
            return (State::Fault, fault.to_string());
        }
        match state.synchronisation {
            Synchronisation::No => (State::NotSynchronised, "not synchronised".to_owned()),
            Synchronisation::Under { axis } => {
                (State::NotSynchronised, format!("synchronises axis {axis}"))
            }
            Synchronisation::Yes if self.is_over() => (State::Held, "holds".to_owned()),
            // The last command has periods left.
            Synchronisation::Yes if state.command_end > state.period => {
                (State::Running, "synchronised, moves".to_owned())
            }
            Synchronisation::Yes => (State::Held, "synchronised, holds".to_owned()),
        }
    }

    /// Returns the state and activity of a VSP for the user interfaces. `camera` is the index of
    /// its camera; `None` for the VSP that aggregates the forces of the wrists.
    fn vsp(&self, name: &str, camera: Option<usize>) -> ActorView {
        let seen = camera.and_then(|camera| self.cameras.get(camera));
        let words = match (seen, camera) {
            (Some(seen), _) if seen.frame > 0 => seen.words.as_str(),
            (_, Some(_)) => "has not looked yet",
            (_, None) => "gathers the wrists' forces",
        };
        let state = if self.begun { State::Running } else { State::Absent };
        view(format!("vsp {name}"), self.alive(state), words)
    }
}

/// Makes the entry of an actor in a snapshot; `words` describe its activity.
fn view(name: String, state: State, words: &str) -> ActorView {
    ActorView { name, state, words: words.to_owned() }
}
