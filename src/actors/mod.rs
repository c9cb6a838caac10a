//! The shells: UI, MP, an ECP and an EDP per effector, VSPs. `run` creates them.
//!
//! Actors are tokio tasks with bounded mailboxes. Requests go down a tree (MP, ECP, EDP), answers come back by
//! `oneshot`, states go up by `watch`; so there is no cycle of waiting.

pub(crate) mod alarm;
pub mod board;
pub mod clock;
pub mod control;
pub mod ecp;
pub mod edp;
pub(crate) mod fault;
pub(crate) mod homing;
pub mod lookout;
pub mod move_instruction;
pub mod mp;
pub mod notice;
pub(crate) mod present;
pub mod ui;
pub mod vsp;
pub mod work;
