//! Lateness: how the servo goes on when news of an axis comes late, or not at all.
//!
//! The regulator of an axis works on steps: how far the counter went in one period. It takes a
//! counter that shows nothing for one period for an axis that was stopped dead, and a counter that
//! shows two periods' steps at once for an axis that runs away. At speed its answer to either trips
//! a power stage. Both happen without any fault of the axis: a line answers late, the bridge's
//! exchange takes longer than a period, or the operating system keeps this machine from running.
//! The model has four parts, and every reading passes them in this order:
//!
//! 1. [`Extrapolator`]: a reading that is missing is replaced. The counters go on by their mean
//!    step for at most ten periods, and the reading is marked: `extrapolated` (the counter was not
//!    read) and `no_answer` (nothing new came at all). Serial lines and ISA cards mark single axes
//!    in the same way by themselves.
//! 2. [`Interval`]: the time between two readings of a counter is not known after a gap, because
//!    the first reading may be as old as the gap is long. It bounds the step that two readings can
//!    show without an encoder fault.
//! 3. [`StepFilter`]: the regulator gets a step that a motor can have made. The rest is the
//!    backlog, which drains into the following steps, so that nothing is lost.
//! 4. [`Allowance`]: the watchdog of the following error allows for the way that a motor can have
//!    gone in a gap, until the backlog has drained.
//!
//! | word | meaning |
//! |---|---|
//! | missed periods | points of the servo's grid that passed without a period; they have no numbers |
//! | gap | the time without a reading of a counter beyond the one period that is usual |
//! | late reading | a reading of an earlier period than the last one |
//! | `no_answer` | nothing new came of this axis; its power stage keeps the last pulse width |
//! | `extrapolated` | the counter was not read in this period but carried on; watchdogs do not judge it |
//! | backlog | how far the motor is ahead of the steps that its regulator was given |
//! | drain | to add a part of the backlog to a step; at most a tenth of what trips a power stage |
//! | clear | to drop the backlog, when set values begin anew from what is measured |
//!
//! - in: readings with their periods, periods that pass, missed ones too
//! - out: a reading for each period, steps for regulators, bounds and allowances for watchdogs
//! - users: the bridge's servo side (1), serial lines (2), watchdogs of axes and jaw (2, 4), the
//!   arm's servo (3)

mod allowance;
mod extrapolator;
mod interval;
mod step_filter;
#[cfg(test)]
mod tests;

pub use allowance::Allowance;
pub use extrapolator::{Extrapolator, MOST_ARMS, Readings};
pub use interval::Interval;
pub use step_filter::StepFilter;
