//! The shells: UI, MP, an ECP and an EDP per effector, VSPs. `run` creates them.
//!
//! Actors are tokio tasks with bounded mailboxes. Requests go down a tree (MP, ECP, EDP), answers come back by
//! `oneshot`, states go up by `watch`; so there is no cycle of waiting.

pub mod clock;
pub mod control;
pub mod ecp;
pub mod edp;
pub(crate) mod fault;
pub(crate) mod homing;
pub mod latest;
pub mod lookout;
pub mod move_instruction;
pub mod mp;
pub mod notice;
pub(crate) mod present;
pub mod services;
pub mod trace;
pub mod ui;
pub mod vsp;
pub(crate) mod watchdog;
pub mod work;
