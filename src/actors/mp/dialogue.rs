//! The dialogue of MP with the operator: questions, and orders by hand.
//!
//! - in: a question of the kernel, or its request for an order; the operator's inputs
//! - out: an answer or none, an order, or the end of an order that MP carries out itself

use super::jog::Jog;
use super::{Mp, Parts, Stop, system};
use crate::actors::control::{Attended, Control, LOOK};
use crate::actors::homing::{self, wait_for_homing};
use crate::actors::notice::Notice;
use crate::cell::MOST_ARMS;
use crate::error::{Error, NonFatal};
use crate::operator::{Answer, Input, Manual, Question};
use crate::reach::guard::PlannedMotion;

/// Length of a macrostep (periods) for an effector without an entry in [`Parts::manners`].
const MACROSTEP: u32 = 8;

impl Mp {
    /// Asks the operator and waits for the answer, at most for the time that the question allows.
    /// Returns `None` if no answer comes. The arms hold meanwhile.
    pub(super) async fn ask(&mut self, question: &Question) -> Result<Option<Answer>, Stop> {
        if self.parts.operator.is_none() {
            return Ok(None);
        }
        let until = self.now() + question.seconds;
        self.parts.services.trace.asks(Some(Question { until, ..question.clone() }));
        self.parts.services.tempo.attend(Attended::Asked);
        let mut answer = Ok(None);
        while self.now() < until {
            match self.input().await {
                // An answer to an earlier question, or of the wrong kind, is ignored.
                Ok(Some(Input::Answer { question: number, answer: given }))
                    if number == question.number && given.fits(&question.subject) =>
                {
                    answer = Ok(Some(given));
                    break;
                }
                Ok(_) => {}
                // Not with `?`: the question must be closed first.
                Err(stop) => {
                    answer = Err(stop);
                    break;
                }
            }
        }
        self.parts.services.tempo.attend(Attended::No);
        self.parts.services.trace.asks(None);
        answer
    }

    /// Waits for the operator's next order by hand. Returns the order and its effector's index.
    pub(super) async fn ordered(&mut self) -> Result<(usize, Manual), Stop> {
        self.parts.services.tempo.attend(Attended::ByHand);
        self.parts.services.trace.takes_orders();
        let order = loop {
            match self.input().await {
                Ok(Some(Input::Manual { effector, order })) => break Ok((effector, order)),
                Ok(_) => {}
                Err(stop) => break Err(stop),
            }
        };
        self.refresh().await?;
        order
    }

    /// Returns the operator's next input if one comes within [`LOOK`]. A terminate of the run, or a
    /// fault of an arm, is returned as an error instead. Waits as long as the run is paused.
    async fn input(&mut self) -> Result<Option<Input>, Stop> {
        self.permitted().await??;
        let input = match &mut self.parts.operator {
            Some(inputs) => tokio::time::timeout(LOOK, inputs.recv()).await.ok().flatten(),
            None => return Err(Stop::Error(system("listen", "the operator"))),
        };
        if input.is_none() {
            // A closed channel returns at once: without this sleep the callers would spin.
            tokio::time::sleep(LOOK).await;
        }
        // A fault of an arm ends the wait of the callers.
        self.refresh().await?;
        Ok(input)
    }

    /// Carries out an order by hand that is no behaviour: the homing of an arm, or the rotation of
    /// one motor.
    pub(super) async fn manual(&mut self, effector: usize, order: &Manual) -> Result<(), Stop> {
        match order {
            Manual::Synchronise => self.synchronise(effector).await?,
            Manual::Motor(step) => self.turn_motor(effector, step.axis, step.by).await?,
            other => {
                let why = format!("MP itself can only home an arm or turn a motor, not {other:?}");
                let cause = NonFatal::Arguments(why);
                let actor = "mp".into();
                return Err(Stop::Error(Error::NonFatal { actor, place: "manual".into(), cause }));
            }
        }
        self.refresh().await?;
        Ok(())
    }

    /// Homes the arm `effector` until it is synchronised. A pause stops the homing, and a resume
    /// continues it.
    async fn synchronise(&mut self, effector: usize) -> Result<(), Stop> {
        let ecp = self.ecp(effector)?.clone();
        loop {
            self.permitted().await??;
            let Parts { services, .. } = &mut self.parts;
            if wait_for_homing(ecp.synchronise(), &mut services.control, &services.clock).await? {
                return Ok(());
            }
            self.tell(Notice::Note(self.now(), homing::STOPPED_MESSAGE.to_owned()));
        }
    }

    /// Turns the motor of one axis by the angle `by` (rad), from rest to rest. A pause brings the
    /// motor to rest in between, and a resume continues the turn.
    pub(super) async fn turn_motor(
        &mut self,
        effector: usize,
        axis: usize,
        by: f64,
    ) -> Result<(), Stop> {
        let macrostep =
            self.parts.manners.get(effector).map_or(MACROSTEP, |m| m.compliance.macrostep);
        let ecp = self.ecp(effector)?.clone();
        // The path is not checked before, since the arm need not be synchronised. The lookout stops
        // an arm that comes too near an obstacle.
        if let Some(guard) = self.guard() {
            let from = self.known().map(|arm| arm.map(|arm| &arm.desired_joints));
            self.let_meet(guard.may_meet(from, [&PlannedMotion::Stays; MOST_ARMS]));
        }
        let mut jog = Jog::new(axis, by, macrostep);
        while !jog.is_over() {
            // Only at rest: a wait for the resume while the motor is fast would stop it at once.
            if jog.rests() {
                self.permitted().await??;
            }
            let runs = *self.parts.services.control.borrow() == Control::Running;
            ecp.transmit(jog.next(runs)).await?;
        }
        Ok(())
    }
}
