//! The two schemes of coordination (Zieliński et al. 2007, p. 374): sporadic, in which the ECPs run
//! the generators, and continuous, in which MP runs them.
//!
//! - in: a behaviour for each effector or none, and which of them decides the end
//! - out: the outcome of each behaviour, or an error

use super::{Mp, refused, system};
use crate::actors::ecp::EcpHandle;
use crate::actors::fault::ActorFault;
use crate::actors::move_instruction::{Ending, MoveInstruction};
use crate::actors::vsp::VspHandle;
use crate::actors::watchdog::Heartbeat;
use crate::error::Error;
use crate::generators::{Behaviour, Outcome};
use crate::kernel::Until;
use crate::motion::MoveCommand;
use futures_util::future::join_all;
use std::sync::Arc;
use std::time::Duration;

/// The motions of the effectors under continuous coordination, and their outcomes: one entry an
/// order each.
struct Running {
    /// Motions under way.
    motions: Vec<Option<MoveInstruction>>,
    outcomes: Vec<Option<Outcome>>,
}

impl Running {
    /// Returns whether a pause has brought every motion under way to rest.
    fn rests(&self) -> bool {
        self.motions.iter().flatten().all(MoveInstruction::rests)
    }

    /// Returns whether all motions must end now: one has ended with an alarm, the effector that
    /// `until` names has ended its motion, or no motion is left.
    fn is_over(&self, until: Until) -> bool {
        let has_ended = |e: usize| self.outcomes.get(e).is_some_and(Option::is_some);
        let led = matches!(until, Until::Effector(e) if has_ended(e));
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
    fn ended(mut self) -> Vec<Option<Outcome>> {
        for (motion, outcome) in self.motions.iter().zip(&mut self.outcomes) {
            if motion.is_some() {
                *outcome = Some(Outcome::Ended);
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
        orders: &[Option<Behaviour>],
        until: Until,
    ) -> Result<Vec<Option<Outcome>>, Error> {
        let (heartbeat, fault) = (self.heartbeat.clone(), Arc::clone(&self.fault));
        wait_with_heartbeats(&heartbeat, &fault, self.invoke_ecps(orders, until)).await
    }

    /// Sends the behaviours to the ECPs, waits until they have ended, and returns their outcomes;
    /// `None` for an effector without an order. `until` says which effector's end ends the others.
    async fn invoke_ecps(
        &mut self,
        orders: &[Option<Behaviour>],
        until: Until,
    ) -> Result<Vec<Option<Outcome>>, Error> {
        let mut ordered = Vec::with_capacity(orders.len());
        for (effector, order) in orders.iter().enumerate() {
            if let Some(order) = order {
                ordered.push((effector, self.ecp(effector)?.clone(), order.clone()));
            }
        }
        let behaviours = ordered.iter().map(|(effector, own, order)| {
            let others = ordered.iter().filter(|(other, ..)| other != effector);
            let partners = others.map(|(_, partner, _)| partner.clone()).collect();
            behave_beside(own.clone(), partners, order.clone(), until == Until::Effector(*effector))
        });
        // All at once: an effector that leads or fails ends the behaviours of the others.
        let ended = all(join_all(behaviours).await)?;
        let mut outcomes = vec![None; orders.len()];
        for ((effector, ..), outcome) in ordered.into_iter().zip(ended) {
            outcomes[effector] = Some(outcome);
        }
        self.refresh().await?;
        Ok(outcomes)
    }

    /// Carries out the ordered behaviours under continuous coordination, in which MP itself runs
    /// the generators of all effectors, a macrostep at a time. Returns the outcome of each.
    pub(super) async fn move_all(
        &mut self,
        orders: &[Option<Behaviour>],
        until: Until,
    ) -> Result<Vec<Option<Outcome>>, Error> {
        self.refresh().await?;
        let mut running = self.begin(orders)?;
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
    fn begin(&self, orders: &[Option<Behaviour>]) -> Result<Running, Error> {
        let begin = |(effector, order): (usize, &Option<Behaviour>)| {
            let Some(order) = order else { return Ok(None) };
            let manner = self.parts.manners.get(effector);
            let manner = manner.ok_or_else(|| system("move", "an effector"))?;
            let arm = self.arms.get(effector).ok_or_else(|| system("move", "an effector"))?;
            MoveInstruction::begin(order, manner, arm).map(Some).map_err(refused)
        };
        let motions = orders.iter().enumerate().map(begin).collect::<Result<_, Error>>()?;
        Ok(Running { motions, outcomes: vec![None; orders.len()] })
    }

    /// Steps the generators and returns the commands of the next macrostep. Stores the outcome of a
    /// motion that has ended, which gets no further command.
    fn step(&mut self, running: &mut Running) -> Vec<Option<MoveCommand>> {
        // One reading of control and target for all: they slow down and follow in step.
        let control = *self.parts.services.control.borrow();
        running.motions.iter_mut().flatten().for_each(|motion| motion.set_pace(control));
        let tracker = self.parts.tracker.as_ref();
        let target = tracker.and_then(VspHandle::target);
        let mut commands = vec![None; running.motions.len()];
        for (effector, sent) in commands.iter_mut().enumerate() {
            let Some(motion) = &mut running.motions[effector] else { continue };
            let (arm, tuning) = (&self.arms[effector], &mut self.tunings[effector]);
            match motion.step_under(tuning, arm, target.as_ref()) {
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

    /// Sends the commands to all effectors at once, and stores the states with which they answer.
    async fn transmit(
        &mut self,
        commands: Vec<Option<MoveCommand>>,
        running: &Running,
    ) -> Result<(), Error> {
        let ecps = &self.parts.ecps;
        let sent =
            ecps.iter().zip(commands).zip(&running.motions).map(|((ecp, command), motion)| {
                async move {
                    let Some(command) = command else { return Ok(None) };
                    match ecp.transmit(command).await {
                        // The generator reads this refusal in the state and continues.
                        Err(error) if motion.as_ref().is_some_and(|m| m.tolerates(&error)) => {
                            ecp.state().await.map(Some)
                        }
                        sent => sent.map(Some),
                    }
                }
            });
        // Sent one after the other, the second command would wait for the answer to the first.
        let answers = self.heartbeat.away(join_all(sent)).await;
        for (arm, state) in self.arms.iter_mut().zip(all(answers)?) {
            if let Some(state) = state {
                *arm = state;
            }
        }
        Ok(())
    }
}

/// Has the ECP `own` carry out a behaviour and returns the outcome. Afterwards ends the behaviours
/// of the ECPs `partners` if the own one `leads`, has failed or has ended with an alarm.
async fn behave_beside(
    own: EcpHandle,
    partners: Vec<EcpHandle>,
    order: Behaviour,
    leads: bool,
) -> Result<Outcome, Error> {
    let result = own.behave(order).await;
    let failed = !matches!(&result, Ok((outcome, _)) if !outcome.alarms());
    if leads || failed {
        let ending = if failed { Ending::AtOnce } else { Ending::Slowing };
        for partner in partners {
            // A partner that is gone reports that in its own answer.
            let _ = partner.end(ending).await;
        }
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

/// Returns all answers, or the most severe of the errors; the first one of equally severe errors.
fn all<T>(answers: Vec<Result<T, Error>>) -> Result<Vec<T>, Error> {
    let (mut fine, mut worst) = (Vec::with_capacity(answers.len()), None::<Error>);
    for answer in answers {
        match answer {
            Ok(answer) => fine.push(answer),
            Err(error) if worst.as_ref().is_none_or(|w| error.gravity() > w.gravity()) => {
                worst = Some(error);
            }
            Err(_) => {}
        }
    }
    worst.map_or(Ok(fine), Err)
}

#[cfg(test)]
mod tests {
    use super::super::super::move_instruction::example_manner;
    use super::*;
    use crate::motion::{AXES, ArmState, JointPositions};

    /// Returns the motions of two arms through free space: that of the arm `first` has ended with
    /// `outcome`, that of the other one is under way.
    fn after(first: usize, outcome: Outcome) -> Running {
        let target = JointPositions([0.5; AXES]);
        let joints = Behaviour::Joints { target, speed: 1.0, seconds: 1.0 };
        let mut running = Running { motions: vec![None, None], outcomes: vec![None, None] };
        running.motions[1 - first] =
            Some(MoveInstruction::begin(&joints, &example_manner(), &ArmState::default()).unwrap());
        running.outcomes[first] = Some(outcome);
        running
    }

    #[test]
    fn alarm_of_one_arm_stops_both_at_once() {
        for first in [0, 1] {
            let alarm = Outcome::OverForce(0, 30.0);
            let mut alarmed = after(first, alarm.clone());
            assert!(alarmed.is_over(Until::All) && alarmed.is_over(Until::Effector(1 - first)));
            assert!(alarmed.end(), "no further macrostep");
            let mut wanted = [(); 2].map(|()| Some(Outcome::Ended));
            wanted[first] = Some(alarm);
            assert_eq!(alarmed.ended(), wanted);

            let mut reached = after(first, Outcome::Reached);
            assert!(!reached.is_over(Until::All) && !reached.is_over(Until::Effector(1 - first)));
            assert!(reached.is_over(Until::Effector(first)));
            assert!(!reached.end(), "the other arm slows down first");
        }
    }
}
