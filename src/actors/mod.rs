//! The actors of a run: UI, MP (master process), an ECP (effector control process) and an EDP
//! (effector driver process) for each effector, and VSPs (virtual sensor processes). The module
//! `run` creates them.
//!
//! An actor is a tokio task with a bounded mailbox. Requests travel down a tree (MP, ECP, EDP),
//! answers return by `oneshot`, and states travel up by `watch`. So no actors can wait for each
//! other in a cycle.
//!
//! - actors: `ui`, `mp`, `ecp`, `edp`, `vsp`
//! - parts of actors: `move_instruction` runs a generator by its `manner`, `ways` checks the path
//!   of a motion before it begins, `homing` synchronises an arm, `present` makes the UI's snapshots
//! - services of all actors: `services` with `clock`, `control`, `tuning`, `work`, `trace`,
//!   `latest`, `notice`
//! - nodes: `way` is the model of a link on the virtual clock, `remote` a link on the wall clock
//! - supervision: `watchdog` detects actors that fail, `lookout` stops arms that come too near an
//!   obstacle, `fault` injects failures

pub mod clock;
pub mod control;
pub mod ecp;
pub mod edp;
pub(crate) mod fault;
pub(crate) mod homing;
pub mod latest;
pub mod lookout;
pub mod manner;
pub mod move_instruction;
pub mod mp;
pub mod notice;
pub(crate) mod present;
pub(crate) mod remote;
pub mod sensor;
pub mod services;
#[cfg(test)]
mod testing;
pub mod trace;
pub mod tuning;
pub mod ui;
pub mod vsp;
pub(crate) mod watchdog;
pub mod way;
pub(crate) mod ways;
pub mod work;
