//! The wait-free way between an EDP and the servo of its arm.
//!
//! Commands go by a ring (`rtrb`), the latest state comes back by a triple buffer; neither end ever waits.

use crate::motion::ArmState;
use crate::servo::ServoCommand;
use crate::servo::period::Length;

/// Commands that can lie in the ring: the servo takes one a period.
const DEPTH: usize = 16;

/// A state and how many commands had been taken when it was written.
#[derive(Debug, Clone, Copy, Default)]
struct Published {
    /// Numbered in periods of 2 ms.
    state: ArmState,
    /// Servo periods that the command has left.
    left: u64,
    taken: u64,
    /// Messages that had come before and were dropped.
    doubles: u64,
}

/// The EDP's end.
#[derive(Debug)]
pub struct ServoLink {
    /// Each with its ticket: one that comes twice is known by it.
    commands: rtrb::Producer<(u64, ServoCommand)>,
    states: triple_buffer::Output<Published>,
    sent: u64,
    doubled: bool,
    length: Length,
}

/// The servo's end.
#[derive(Debug)]
pub struct ServoEnd {
    commands: rtrb::Consumer<(u64, ServoCommand)>,
    states: triple_buffer::Input<Published>,
    taken: u64,
    doubles: u64,
    length: Length,
}

/// The servo has not taken a command for so long that the ring is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the servo takes no commands: {DEPTH} are waiting")]
pub struct Unsent;

/// Both ends of a way to one arm's servo, whose periods last 2 ms.
#[must_use]
pub fn link() -> (ServoLink, ServoEnd) {
    link_at(Length::default())
}

/// Both ends of a way to one arm's servo. On the EDP's side time counts in periods of 2 ms, on the servo's in its own.
#[must_use]
pub fn link_at(length: Length) -> (ServoLink, ServoEnd) {
    let (producer, consumer) = rtrb::RingBuffer::new(DEPTH);
    let (input, output) = triple_buffer::triple_buffer(&Published::default());
    (
        ServoLink { commands: producer, states: output, sent: 0, doubled: false, length },
        ServoEnd { commands: consumer, states: input, taken: 0, doubles: 0, length },
    )
}

impl ServoLink {
    /// Sends a command; the servo takes one in each period, in order. Returns its ticket.
    ///
    /// # Errors
    /// [`Unsent`] when the ring is full.
    pub fn send(&mut self, mut command: ServoCommand) -> Result<u64, Unsent> {
        if let ServoCommand::Move { command, start } = &mut command {
            // None lasts none: that stays the servo's to judge.
            if command.periods > 0 && command.periods < u32::MAX {
                command.periods = self.length.count(command.periods);
            }
            *start = self.length.first_after(*start);
        }
        self.commands.push((self.sent + 1, command)).map_err(|_| Unsent)?;
        self.sent += 1;
        if std::mem::take(&mut self.doubled) {
            // A full ring has no room for what should not be there.
            let _ = self.commands.push((self.sent, command));
        }
        Ok(self.sent)
    }

    /// Makes the next command come twice, as a disturbed line may.
    pub fn double(&mut self) {
        self.doubled = true;
    }

    /// How many commands came twice so far; each was obeyed once.
    pub fn doubles(&mut self) -> u64 {
        self.states.read().doubles
    }

    /// The latest state.
    pub fn state(&mut self) -> &ArmState {
        &self.states.read().state
    }

    /// Whether the command of this ticket was taken and has at most `early` periods left. With `early` =
    /// [`ArmServo::EARLY`](crate::servo::ArmServo::EARLY) the next one, sent now, follows without a gap. A
    /// command that was refused or broken off is done too: see the state.
    pub fn is_done(&mut self, ticket: u64, early: u64) -> bool {
        let Published { left, taken, .. } = self.states.read();
        let early =
            if early == 0 { 0 } else { self.length.early().max(self.length.first_after(early)) };
        *taken >= ticket && *left <= early
    }

    /// How many periods of 2 ms before its end a macrostep must be answered.
    #[must_use]
    pub fn early(&self) -> u64 {
        self.length.early_ticks()
    }

    /// Whether the servo is gone.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.commands.is_abandoned()
    }
}

impl ServoEnd {
    /// The next command, if there is one.
    pub(super) fn take(&mut self) -> Option<ServoCommand> {
        while let Ok((ticket, command)) = self.commands.pop() {
            if ticket > self.taken {
                self.taken = ticket;
                return Some(command);
            }
            self.doubles += 1;
        }
        None
    }

    pub(crate) fn publish(&mut self, state: &ArmState) {
        let left = state.command_end.saturating_sub(state.period);
        let state = ArmState {
            period: self.length.tick(state.period),
            command_end: self.length.tick_after(state.command_end),
            ..*state
        };
        let (taken, doubles) = (self.taken, self.doubles);
        self.states.write(Published { state, left, taken, doubles });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_done_when_it_was_taken_and_its_end_is_near() {
        let (mut edp, mut servo) = link();
        let ticket = edp.send(ServoCommand::Bias).unwrap();

        servo.publish(&ArmState { period: 7, ..ArmState::default() });
        assert!(!edp.is_done(ticket, 2), "not taken yet");

        assert_eq!(servo.take(), Some(ServoCommand::Bias));
        servo.publish(&ArmState { period: 8, command_end: 11, ..ArmState::default() });
        assert!(!edp.is_done(ticket, 2));
        servo.publish(&ArmState { period: 9, command_end: 11, ..ArmState::default() });
        assert!(edp.is_done(ticket, 2));
        assert!(!edp.is_done(ticket, 0));
    }

    #[test]
    fn a_command_that_comes_twice_is_obeyed_once() {
        let (mut edp, mut servo) = link();
        edp.double();
        edp.send(ServoCommand::Bias).unwrap();
        let ticket = edp.send(ServoCommand::Reset).unwrap();

        assert_eq!(servo.take(), Some(ServoCommand::Bias));
        assert_eq!(servo.take(), Some(ServoCommand::Reset));
        assert_eq!(servo.take(), None);
        servo.publish(&ArmState::default());
        assert!(edp.is_done(ticket, 0));
        assert_eq!(edp.doubles(), 1);
    }

    #[test]
    fn a_full_ring_is_reported_and_a_dropped_servo_is_noticed() {
        let (mut edp, servo) = link();

        for _ in 0..DEPTH {
            edp.send(ServoCommand::Reset).unwrap();
        }
        assert_eq!(edp.send(ServoCommand::Reset), Err(Unsent));

        assert!(!edp.is_closed());
        drop(servo);
        assert!(edp.is_closed());
    }
}
