//! Lateness: how the servo continues when a reading of an axis is late or missing.
//!
//! The regulator of an axis works on steps, which are the differences of two counts. A count that
//! does not change for one period looks like an axis that was stopped dead. A count that changes by
//! two periods' steps at once looks like an axis that runs away. At speed the regulator's answer to
//! either trips a power stage. Both happen without a fault of the axis: a line answers late, the
//! bridge's exchange takes longer than a period, or the operating system keeps this machine from
//! running. The model has four parts, and every reading passes them in this order:
//!
//! 1. [`Extrapolator`]: a reading that is missing is replaced. The counters continue by their mean
//!    step for at most ten periods. The reading is marked as `extrapolated` if the counter was not
//!    read, and as `no_answer` if no new reading came at all. Serial lines and ISA cards mark
//!    single axes in the same way by themselves.
//! 2. [`Interval`]: the time between two readings of a counter is not known after a gap, because
//!    the first reading may be as old as the gap is long. The interval bounds the step that two
//!    readings can show without an encoder fault.
//! 3. [`StepFilter`]: the regulator gets a step that a motor can have made. The rest is the
//!    backlog, which drains into the following steps, so that nothing is lost.
//! 4. [`Allowance`]: the watchdog of the following error allows for the distance that a motor can
//!    have moved in a gap, until the backlog has drained.
//!
//! | word | meaning |
//! |---|---|
//! | missed periods | grid points that passed without a period of the servo; they have no numbers |
//! | gap | the time without a reading of a counter beyond the one period that is usual |
//! | late reading | a reading of an earlier period than the last one |
//! | `no_answer` | nothing new came of this axis; its power stage keeps the last pulse width |
//! | `extrapolated` | the count is an estimate of this period; watchdogs do not judge it |
//! | backlog | distance by which the motor is ahead of the steps that its regulator was given |
//! | drain | to add a part of the backlog to a step, at most a tenth of one that trips a stage |
//! | clear | to drop the backlog, when set values restart from the measured ones |
//!
//! - in: readings with their periods; periods that pass, including missed ones
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
