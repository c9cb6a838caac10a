//! The wait-free channels between an EDP, the actor that drives one arm, and the servo of the arm.
//!
//! A ring (`rtrb`) carries commands to the servo. A triple buffer carries the latest state back.
//! Neither end ever waits. The EDP counts time in periods of 2 ms, the servo in its own periods;
//! the conversion takes place here.

use crate::motion::ArmState;
use crate::servo::ServoCommand;
use crate::servo::period::Length;

/// Number of commands that fit into the ring. The servo takes one in each period.
const DEPTH: usize = 16;

/// A state of the arm, with the progress of the commands when the servo wrote it.
#[derive(Debug, Clone, Copy, Default)]
struct Published {
    /// State of the arm, its times in periods of 2 ms.
    state: ArmState,
    /// Servo periods until the end of the command that is being carried out.
    left: u64,
    /// Ticket of the last command that the servo has taken.
    taken: u64,
    /// Number of duplicate commands that the servo has dropped.
    doubles: u64,
}

/// The EDP's end of the link: it sends commands and reads states.
#[derive(Debug)]
pub struct ServoLink {
    /// Commands with their tickets, by which the servo recognises duplicates.
    commands: rtrb::Producer<(u64, ServoCommand)>,
    states: triple_buffer::Output<Published>,
    /// Ticket of the last command that was sent; tickets count from 1.
    sent: u64,
    /// Whether the next command is to arrive twice.
    doubled: bool,
    length: Length,
}

/// The servo's end of the link: it takes commands and publishes states.
#[derive(Debug)]
pub struct ServoEnd {
    commands: rtrb::Consumer<(u64, ServoCommand)>,
    states: triple_buffer::Input<Published>,
    /// Ticket of the last command that was taken.
    taken: u64,
    /// Number of duplicate commands that were dropped.
    doubles: u64,
    length: Length,
}

/// Refusal of a command because the ring is full: the servo takes none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the servo takes no commands: {DEPTH} are waiting")]
pub struct Unsent;

/// Makes the EDP's and the servo's end of a link to one arm, whose servo periods last 2 ms.
#[must_use]
pub fn link() -> (ServoLink, ServoEnd) {
    link_at(Length::default())
}

/// Makes the EDP's and the servo's end of a link to one arm, whose servo periods have this
/// `length`. The EDP counts time in periods of 2 ms.
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
            // 0 and `u32::MAX` periods pass unchanged. The conversion would make 1 of 0, but the
            // servo is to refuse a command without a duration. `u32::MAX` is a command without end.
            if command.periods > 0 && command.periods < u32::MAX {
                command.periods = self.length.count(command.periods);
            }
            *start = self.length.first_after(*start);
        }
        self.commands.push((self.sent + 1, command)).map_err(|_| Unsent)?;
        self.sent += 1;
        if std::mem::take(&mut self.doubled) {
            // A duplicate that finds the ring full is lost. That is no error, because it is an
            // injected fault itself.
            let _ = self.commands.push((self.sent, command));
        }
        Ok(self.sent)
    }

    /// Makes the next command arrive twice, as on a disturbed line.
    pub fn double(&mut self) {
        self.doubled = true;
    }

    /// Returns how many duplicate commands the servo has dropped.
    pub fn doubles(&mut self) -> u64 {
        self.states.read().doubles
    }

    /// Returns the latest state of the arm that the servo has published.
    pub fn state(&mut self) -> &ArmState {
        &self.states.read().state
    }

    /// Returns whether the servo has taken the command of this ticket and has at most `early`
    /// periods of 2 ms left to do it.
    ///
    /// With `early` = [`ArmServo::EARLY`](crate::servo::ArmServo::EARLY) a command that is sent now
    /// follows without a gap. A command that was refused or broken off counts as done: the state
    /// says which.
    pub fn is_done(&mut self, ticket: u64, early: u64) -> bool {
        let Published { left, taken, .. } = self.states.read();
        // 0 asks for the very end. Any other lead covers at least the servo's own two periods, or
        // a servo with long periods would get the next command too late.
        let early =
            if early == 0 { 0 } else { self.length.early().max(self.length.first_after(early)) };
        *taken >= ticket && *left <= early
    }

    /// Returns how long before its end a macrostep must be answered, so that the next one follows
    /// without a gap (periods of 2 ms).
    #[must_use]
    pub fn early(&self) -> u64 {
        self.length.early_ticks()
    }

    /// Returns whether the servo is gone.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.commands.is_abandoned()
    }
}

impl ServoEnd {
    /// Takes the next command, if there is one, and drops duplicates before it.
    pub(crate) fn take(&mut self) -> Option<ServoCommand> {
        while let Ok((ticket, command)) = self.commands.pop() {
            if ticket > self.taken {
                self.taken = ticket;
                return Some(command);
            }
            self.doubles += 1;
        }
        None
    }

    /// Publishes the state of the arm to the EDP, with its times converted to periods of 2 ms.
    pub(crate) fn publish(&mut self, state: &ArmState) {
        // The time left stays in servo periods, because two of them can round to the same period of
        // 2 ms.
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
    fn command_is_done_within_given_periods_of_end() {
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
    fn servo_takes_duplicate_command_once() {
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
    fn edp_detects_full_ring_and_dropped_servo() {
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
