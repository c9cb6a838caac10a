//! The programmes of ECPs that MP has started: their starts, their signals and their ends.
//!
//! - in: the kernel's requests to start a programme, to send a signal, to wait for a message
//! - out: messages of the ECPs as events for the kernel; the tool frame that a programme has left
//!
//! An effector with a programme is not MP's to order. Its faults end its programme and not the run.
//! Under continuous coordination as well: the ECPs of the other effectors transmit meanwhile.

use super::{Mp, Stop};
use crate::actors::ecp::{Outbox, Report};
use crate::error::{Error, NonFatal};
use crate::kernel::{Event, Message, Programme, Signal};
use std::time::Duration;

/// Time between two looks at the control of the run, while MP waits for a message.
const LOOK: Duration = Duration::from_millis(10);

impl Mp {
    /// Has the ECP of an effector begin a programme.
    pub(super) async fn start(
        &mut self,
        effector: usize,
        programme: Programme,
    ) -> Result<(), Error> {
        let ecp = self.ecp(effector)?.clone();
        if self.programmes.busy([effector].into_iter()).is_some() {
            return Err(refused(format!("effector {effector} carries out a programme already")));
        }
        let outbox = Outbox { effector, mailbox: self.programmes.to_mp.clone() };
        self.heartbeat.away(ecp.start(programme, outbox)).await?;
        // No order of MP joins this hand with another, so it must stay apart.
        self.parts.may_meet.set(self.parts.may_meet.pairs().without(effector));
        self.programmes.running.push(effector);
        self.programmes.own.push(effector);
        Ok(())
    }

    /// Sends a signal to the programme of an effector.
    pub(super) async fn signal(&mut self, effector: usize, signal: Signal) -> Result<(), Error> {
        let ecp = self.ecp(effector)?.clone();
        if self.programmes.busy([effector].into_iter()).is_none() {
            return Err(refused(format!("effector {effector} carries out no programme")));
        }
        self.parts.services.trace.message("mp", &format!("ecp {effector}"), &signal);
        self.heartbeat.away(ecp.signal(signal)).await
    }

    /// Waits for the next message of a programme, at most for `seconds` (s) of the run's time.
    pub(super) async fn receive<C>(&mut self, seconds: f64) -> Result<Event<C>, Stop> {
        let until = self.now() + seconds;
        loop {
            // A pause is no hang of MP.
            self.heartbeat.waits();
            self.permitted().await??;
            let next = tokio::time::timeout(LOOK, self.programmes.messages.recv()).await;
            self.heartbeat.works();
            self.fault.occur().await;
            if let Ok(Some(Report { message, tool })) = next {
                let (Message::Signal { effector, .. } | Message::Ended { effector, .. }) = &message;
                // MP checks the paths of its own orders for the tool that the programme has left.
                if let Some(last) = self.tools.get_mut(*effector) {
                    *last = tool;
                }
                if matches!(message, Message::Ended { .. }) {
                    self.programmes.running.retain(|running| running != effector);
                }
                self.refresh().await?;
                return Ok(Event::Received(Some(message)));
            }
            if self.now() >= until {
                self.refresh().await?;
                return Ok(Event::Received(None));
            }
        }
    }
}

/// Returns the error for a request about programmes that MP cannot carry out.
fn refused(why: String) -> Error {
    Error::NonFatal {
        actor: "mp".into(),
        place: "programme".into(),
        cause: NonFatal::Arguments(why),
    }
}
