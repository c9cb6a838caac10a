//! The desk between whoever runs and whoever shows: two ends of the same channels.
//!
//! - a face (page, terminal, keys) has a [`Desk`]: the latest snapshot and pictures, and a way for commands
//! - who runs (the UI actor, a replay) has the [`Behind`]: what it publishes replaces what was there, so it never waits
//!   for a slow face

use crate::operator::{Command, Snapshot, Stage};
use image::RgbImage;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::{mpsc, watch};

/// Commands that may wait: a person gives one at a time.
const COMMANDS: usize = 32;

/// Pixels of a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// [`CameraView::frame`](crate::operator::CameraView::frame).
    pub frame: u64,
    /// The pixels.
    pub pixels: Pixels,
}

/// Raw, or as a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Pixels {
    /// 8 bits a channel.
    Raw(RgbImage),
    /// A JPEG or PNG file.
    File(Vec<u8>),
}

/// The latest picture of each camera, in the scenario's order.
pub type Pictures = Vec<Option<Arc<Picture>>>;

/// A face's end. Clones are further faces.
#[derive(Debug, Clone)]
pub struct Desk {
    /// What does not change; the default before a run has begun.
    pub stage: watch::Receiver<Arc<Stage>>,
    /// The latest snapshot.
    pub snapshots: watch::Receiver<Arc<Snapshot>>,
    /// The latest pictures.
    pub pictures: watch::Receiver<Pictures>,
    commands: mpsc::Sender<Command>,
    emergency: Arc<AtomicBool>,
}

impl Desk {
    /// Gives a command; `false` when nobody takes it now.
    #[must_use]
    pub fn command(&self, command: Command) -> bool {
        if command == Command::EmergencyStop {
            // Past all queues: the servo reads the flag in its next period.
            self.emergency.store(true, Ordering::Release);
        }
        self.commands.try_send(command).is_ok()
    }
}

/// The end of whoever runs.
#[derive(Debug, Clone)]
pub struct Behind {
    /// What does not change.
    pub stage: Arc<watch::Sender<Arc<Stage>>>,
    /// Snapshots.
    pub snapshots: Arc<watch::Sender<Arc<Snapshot>>>,
    /// Pictures; published before the snapshot that names them.
    pub pictures: Arc<watch::Sender<Pictures>>,
    /// The emergency stop: set by a face, read by the servo.
    pub emergency: Arc<AtomicBool>,
    commands: Arc<Mutex<Option<mpsc::Receiver<Command>>>>,
    heard_by: mpsc::Sender<Command>,
}

impl Behind {
    /// One more face.
    #[must_use]
    pub fn desk(&self) -> Desk {
        Desk {
            stage: self.stage.subscribe(),
            snapshots: self.snapshots.subscribe(),
            pictures: self.pictures.subscribe(),
            commands: self.heard_by.clone(),
            emergency: Arc::clone(&self.emergency),
        }
    }

    /// The commands' end; `None` while somebody else has it.
    #[must_use]
    pub fn take_commands(&self) -> Option<mpsc::Receiver<Command>> {
        self.commands.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Gives it back for whoever comes next.
    pub fn return_commands(&self, commands: mpsc::Receiver<Command>) {
        *self.commands.lock().unwrap_or_else(PoisonError::into_inner) = Some(commands);
    }
}

/// Both ends.
#[must_use]
pub fn desk() -> (Desk, Behind) {
    let (heard_by, commands) = mpsc::channel(COMMANDS);
    let behind = Behind {
        stage: Arc::new(watch::channel(Arc::default()).0),
        snapshots: Arc::new(watch::channel(Arc::default()).0),
        pictures: Arc::new(watch::channel(Vec::new()).0),
        emergency: Arc::new(AtomicBool::new(false)),
        commands: Arc::new(Mutex::new(Some(commands))),
        heard_by,
    };
    (behind.desk(), behind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_emergency_stop_goes_past_a_full_queue() {
        let (desk, behind) = desk();
        while desk.command(Command::Pause) {}

        assert!(!desk.command(Command::EmergencyStop), "nobody takes commands");

        assert!(behind.emergency.load(Ordering::Acquire));
    }

    #[test]
    fn a_face_sees_the_latest_and_nobody_waits_for_it() {
        let (desk, behind) = desk();
        for number in 1..=1000 {
            behind.snapshots.send_replace(Arc::new(Snapshot { number, ..Snapshot::default() }));
        }

        assert_eq!(desk.snapshots.borrow().number, 1000);
    }
}
