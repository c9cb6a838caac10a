//! The two schemes of coordination (Zieliński et al. 2007, p. 374): sporadic, in which the ECPs run
//! the generators, and continuous, in which MP runs them.
//!
//! - in: a behaviour for each effector or none, and which of them decides the end
//! - out: the outcome of each behaviour, or an error

use super::{Mp, system};
use crate::actors::ecp::EcpHandle;
use crate::actors::fault::ActorFault;
use crate::actors::move_instruction::{Ending, MoveInstruction};
use crate::actors::vsp::VspHandle;
use crate::actors::watchdog::Heartbeat;
use crate::error::Error;
use crate::generators::{Behaviour, Outcome};
use crate::motion::MoveCommand;
use crate::tasks::Until;
use std::sync::Arc;
use std::time::Duration;

/// The motions of both effectors under continuous coordination, and their outcomes.
struct Running {
    /// Motions under way.
    motions: [Option<MoveInstruction>; 2],
    outcomes: [Option<Outcome>; 2],
}

impl Running {
    /// Returns whether a pause has brought every motion under way to rest.
    fn rests(&self) -> bool {
        self.motions.iter().flatten().all(MoveInstruction::rests)
    }

    /// Returns whether both motions must end now: one has ended with an alarm, the effector that
    /// `until` names has ended its motion, or no motion is left.
    fn is_over(&self, until: Until) -> bool {
        let led = matches!(until, Until::Effector(e) if self.outcomes[e].is_some());
        self.alarms() || led || self.motions.iter().all(Option::is_none)
    }

    /// Returns whether one of the motions has ended with an alarm.
    fn alarms(&self) -> bool {
        self.outcomes.iter().any(|o| o.as_ref().is_some_and(Outcome::alarms))
    }

    /// Ends the motions that are under way. Returns `true` once all are at rest.
    fn end(&mut self) -> bool {
        let ending = if self.alarms() { Ending::AtOnce } else { Ending::Slowing };
        // A fast motion that slows down stays in the list and gets further macrosteps.
        for (motion, outcome) in self.motions.iter_mut().zip(&mut self.outcomes) {
            if motion.as_mut().is_some_and(|motion| motion.end(ending)) {
                (*motion, *outcome) = (None, Some(Outcome::Ended));
            }
        }
        self.motions.iter().all(Option::is_none)
    }

    /// Returns the outcome of each motion; `None` for an effector without one. A motion that is
    /// still under way counts as ended by the operator's terminate.
    fn ended(mut self) -> [Option<Outcome>; 2] {
        for (effector, motion) in self.motions.iter().enumerate() {
            if motion.is_some() {
                self.outcomes[effector] = Some(Outcome::Ended);
            }
        }
        self.outcomes
    }
}

impl Mp {
    /// Carries out the ordered behaviours under sporadic coordination, in which the ECPs run the
    /// generators. Returns the outcome of each.
    pub(super) async fn invoke(
        &mut self,
        orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<[Option<Outcome>; 2], Error> {
        let (heartbeat, fault) = (self.heartbeat.clone(), Arc::clone(&self.fault));
        wait_with_heartbeats(&heartbeat, &fault, self.invoke_ecps(orders, until)).await
    }

    /// Sends the behaviours to the ECPs, waits until they have ended, and returns their outcomes;
    /// `None` for an effector without an order. `until` says which effector's end ends both.
    async fn invoke_ecps(
        &mut self,
        orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<[Option<Outcome>; 2], Error> {
        let mut outcomes = [None, None];
        let [first, second] = orders;
        match (first, second) {
            // Both at once: an effector that leads or fails ends the behaviour of the other one.
            (Some(first), Some(second)) => {
                let (a, b) = (self.ecp(0)?.clone(), self.ecp(1)?.clone());
                let leads = |effector| until == Until::Effector(effector);
                let (x, y) = tokio::join!(
                    behave_beside(a.clone(), b.clone(), first, leads(0)),
                    behave_beside(b, a, second, leads(1))
                );
                let (x, y) = both(x, y)?;
                outcomes = [Some(x), Some(y)];
            }
            (Some(order), None) => outcomes[0] = Some(self.ecp(0)?.behave(order).await?.0),
            (None, Some(order)) => outcomes[1] = Some(self.ecp(1)?.behave(order).await?.0),
            (None, None) => {}
        }
        self.refresh().await?;
        Ok(outcomes)
    }

    /// Carries out the ordered behaviours under continuous coordination, in which MP itself runs
    /// the generators of all effectors, a macrostep at a time. Returns the outcome of each.
    pub(super) async fn move_all(
        &mut self,
        orders: [Option<Behaviour>; 2],
        until: Until,
    ) -> Result<[Option<Outcome>; 2], Error> {
        self.refresh().await?;
        let mut running = self.begin(&orders)?;
        loop {
            // A pause is no hang of MP.
            self.heartbeat.waits();
            if running.rests() && self.permitted().await?.is_err() {
                break;
            }
            self.heartbeat.works();
            self.fault.occur().await;
            let commands = self.step(&mut running);
            // The commands of this step are dropped: every motion is over.
            if running.is_over(until) && running.end() {
                break;
            }
            self.transmit(commands, &running).await?;
        }
        self.refresh().await?;
        Ok(running.ended())
    }

    /// Begins the motions of the ordered behaviours.
    fn begin(&self, orders: &[Option<Behaviour>; 2]) -> Result<Running, Error> {
        let mut motions = [None, None];
        for (effector, order) in orders.iter().enumerate() {
            if let Some(order) = order {
                let manner = self.parts.manners.get(effector);
                let manner = manner.ok_or_else(|| system("move", "an effector"))?;
                motions[effector] = Some(MoveInstruction::begin(order, manner));
            }
        }
        Ok(Running { motions, outcomes: [None, None] })
    }

    /// Steps the generators and returns the commands of the next macrostep. Stores the outcome of a
    /// motion that has ended, which gets no further command.
    fn step(&self, running: &mut Running) -> [Option<MoveCommand>; 2] {
        // One reading of control and target for both: they slow down and follow in step.
        let control = *self.parts.services.control.borrow();
        running.motions.iter_mut().flatten().for_each(|motion| motion.set_pace(control));
        let tracker = self.parts.tracker.as_ref();
        let target = tracker.and_then(VspHandle::target);
        let mut commands = [None, None];
        for (effector, sent) in commands.iter_mut().enumerate() {
            let Some(motion) = &mut running.motions[effector] else { continue };
            match motion.step(&self.arms[effector], target.as_ref()) {
                Ok((command, sensing)) => {
                    if let (Some(sensing), Some(tracker)) = (sensing, tracker) {
                        tracker.configure(sensing);
                    }
                    *sent = Some(command);
                }
                Err(outcome) => {
                    running.outcomes[effector] = Some(outcome);
                    running.motions[effector] = None;
                }
            }
        }
        commands
    }

    /// Sends the commands to both effectors at once, and stores the states with which they answer.
    async fn transmit(
        &mut self,
        commands: [Option<MoveCommand>; 2],
        running: &Running,
    ) -> Result<(), Error> {
        let send = |effector: usize| {
            let command = commands[effector];
            let ecp = self.parts.ecps.get(effector).cloned();
            let motion = running.motions[effector].as_ref();
            async move {
                let (Some(ecp), Some(command)) = (ecp, command) else { return Ok(None) };
                match ecp.transmit(command).await {
                    // The generator reads this refusal in the state and continues.
                    Err(error) if motion.is_some_and(|motion| motion.tolerates(&error)) => {
                        ecp.state().await.map(Some)
                    }
                    sent => sent.map(Some),
                }
            }
        };
        // Sent one after the other, the second command would wait for the answer to the first.
        let sent = async { tokio::join!(send(0), send(1)) };
        let (a, b) = self.heartbeat.away(sent).await;
        let (a, b) = both(a, b)?;
        for (effector, state) in [a, b].into_iter().enumerate() {
            if let Some(state) = state {
                self.arms[effector] = state;
            }
        }
        Ok(())
    }
}

/// Has the ECP `own` carry out a behaviour and returns the outcome. Afterwards ends the behaviour
/// of the ECP `partner` if the own one `leads`, has failed or has ended with an alarm.
async fn behave_beside(
    own: EcpHandle,
    partner: EcpHandle,
    order: Behaviour,
    leads: bool,
) -> Result<Outcome, Error> {
    let result = own.behave(order).await;
    let failed = !matches!(&result, Ok((outcome, _)) if !outcome.alarms());
    if leads || failed {
        let ending = if failed { Ending::AtOnce } else { Ending::Slowing };
        // A partner that is gone reports that in its own answer.
        let _ = partner.end(ending).await;
    }
    result.map(|(outcome, _)| outcome)
}

/// Waits for `others`, the work of other actors, and does a short work item of MP every 10 ms
/// meanwhile. An MP that hangs does not finish the item, so the watchdog detects the hang before
/// another actor needs an answer of MP.
async fn wait_with_heartbeats<T>(
    heartbeat: &Heartbeat,
    fault: &ActorFault,
    others: impl Future<Output = T>,
) -> T {
    /// Time between two work items: together with the watchdog's limit of 80 ms less than 0.1 s.
    const INTERVAL: Duration = Duration::from_millis(10);
    let mut others = std::pin::pin!(others);
    loop {
        if let Ok(answer) = tokio::time::timeout(INTERVAL, &mut others).await {
            return answer;
        }
        heartbeat.works();
        fault.occur().await;
        heartbeat.waits();
    }
}

/// Returns both answers, or the more severe of two errors; the first one if both are equally
/// severe.
fn both<T>(a: Result<T, Error>, b: Result<T, Error>) -> Result<(T, T), Error> {
    match (a, b) {
        (Ok(a), Ok(b)) => Ok((a, b)),
        (Err(a), Err(b)) => Err(if b.gravity() > a.gravity() { b } else { a }),
        (Err(error), Ok(_)) | (Ok(_), Err(error)) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::move_instruction::example_manner;
    use super::*;
    use crate::motion::{AXES, JointPositions};

    /// Returns the motions of two arms through free space: that of the arm `first` has ended with
    /// `outcome`, that of the other one is under way.
    fn after(first: usize, outcome: Outcome) -> Running {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 1.0 };
        let mut running = Running { motions: [None, None], outcomes: [None, None] };
        running.motions[1 - first] = Some(MoveInstruction::begin(&joints, &example_manner()));
        running.outcomes[first] = Some(outcome);
        running
    }

    #[test]
    fn alarm_of_one_arm_stops_both_at_once() {
        for first in [0, 1] {
            let alarm = Outcome::OverForce(0, 30.0);
            let mut alarmed = after(first, alarm);
            assert!(alarmed.is_over(Until::All) && alarmed.is_over(Until::Effector(1 - first)));
            assert!(alarmed.end(), "no further macrostep");
            let mut wanted = [Some(Outcome::Ended); 2];
            wanted[first] = Some(alarm);
            assert_eq!(alarmed.ended(), wanted);

            let mut reached = after(first, Outcome::Reached);
            assert!(!reached.is_over(Until::All) && !reached.is_over(Until::Effector(1 - first)));
            assert!(reached.is_over(Until::Effector(first)));
            assert!(!reached.end(), "the other arm slows down first");
        }
    }
}
