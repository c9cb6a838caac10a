//! Messages of one type over a link: written as bytes and numbered.
//!
//! - in: messages; bytes from a link
//! - out: bytes to a link; messages, or the fault of one
//!
//! A network may drop a message without a word, so each has a number, and a gap is a fault. Values
//! and pictures have no number: newer ones follow. A picture that cannot be read is refused without
//! a fault. Messages of another run, whose processes may still be there, are dropped.

use crate::net::{Lane, Link, Parcels, Traffic};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};

/// Most bytes of a message. A picture has at most a quarter of them.
const LONGEST: usize = 1 << 20;

/// Message that a link carries.
pub(crate) trait Carried: Serialize + DeserializeOwned {
    /// Returns the lane of the message.
    fn lane(&self) -> Lane;

    /// Returns whether the message is about joining, and so may be one of any run.
    fn joins(&self) -> bool;
}

/// Sending end for messages of one type. All clones number the same messages.
#[derive(Debug)]
pub(crate) struct Sender<T> {
    link: Arc<dyn Link>,
    /// Number of the run.
    run: u64,
    /// Number of the next message.
    next: Arc<Mutex<u64>>,
    messages: PhantomData<fn(T)>,
}

impl<T> Clone for Sender<T> {
    fn clone(&self) -> Self {
        let (link, next) = (Arc::clone(&self.link), Arc::clone(&self.next));
        Self { link, run: self.run, next, messages: PhantomData }
    }
}

impl<T: Carried> Sender<T> {
    /// Makes the sending end over a link for the run with this number.
    pub(crate) fn new(link: Arc<dyn Link>, run: u64) -> Self {
        Self { link, run, next: Arc::default(), messages: PhantomData }
    }

    /// Returns the sending end over the same link for another run.
    pub(crate) fn of_run(&self, run: u64) -> Self {
        Self::new(Arc::clone(&self.link), run)
    }

    /// Returns the traffic of this end of the link.
    pub(crate) fn traffic(&self) -> Traffic {
        self.link.traffic()
    }

    /// Sends a message. It does not wait for the other node.
    pub(crate) fn send(&self, message: &T) {
        let lane = message.lane();
        // Locked until the link has the message: numbers leave in their order.
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        let number = if lane == Lane::Messages { *next } else { 0 };
        match rmp_serde::to_vec_named(&(self.run, number, message)) {
            Ok(parcel) => {
                *next += u64::from(lane == Lane::Messages);
                self.link.send(lane, parcel);
            }
            Err(why) => tracing::error!("a message to another node has no form as bytes: {why}"),
        }
    }
}

/// Receiving end for messages of one type.
#[derive(Debug)]
pub(crate) struct Receiver<T> {
    parcels: Parcels,
    /// Number of the run; `None` until the node has joined one.
    run: Option<u64>,
    /// Number of the next message.
    next: u64,
    /// Whether a picture has been refused.
    has_refused: bool,
    messages: PhantomData<fn() -> T>,
}

impl<T: Carried> Receiver<T> {
    /// Makes the receiving end over a link.
    pub(crate) fn new(parcels: Parcels) -> Self {
        Self { parcels, run: None, next: 0, has_refused: false, messages: PhantomData }
    }

    /// Returns this end for the messages of one run.
    pub(crate) fn of_run(self, run: u64) -> Self {
        Self { run: Some(run), next: 0, ..self }
    }

    /// Waits for the next message; `None` if the link has ended.
    ///
    /// # Errors
    /// The reason why a message cannot be read, or the number of messages that are missing.
    pub(crate) async fn recv(&mut self) -> Option<Result<T, String>> {
        loop {
            let (lane, parcel) = self.parcels.recv().await?;
            match self.read(lane, &parcel).transpose() {
                // Pictures are for people: a wrong one must not end a run.
                Some(Err(why)) if lane == Lane::Pictures => self.refuse(&why),
                Some(read) => return Some(read),
                None => {}
            }
        }
    }

    /// Reports the first picture that cannot be read.
    fn refuse(&mut self, why: &str) {
        if !std::mem::replace(&mut self.has_refused, true) {
            tracing::warn!("a picture of another node was refused: {why}");
        }
    }

    /// Reads a message, and checks that its number is the next one; `None` for one of another run.
    fn read(&mut self, lane: Lane, parcel: &[u8]) -> Result<Option<T>, String> {
        if parcel.len() > LONGEST {
            return Err(format!("a message of {} bytes is too long", parcel.len()));
        }
        let (run, number, message): (u64, u64, T) = rmp_serde::from_slice(parcel)
            .map_err(|why| format!("a message cannot be read: {why}"))?;
        if message.lane() != lane {
            return Err("a message came on the wrong lane".to_owned());
        }
        if self.run != Some(run) && !message.joins() {
            return Ok(None);
        }
        if lane == Lane::Messages {
            if number != self.next {
                return Err(format!("message {number} came in the place of {}", self.next));
            }
            self.next += 1;
        }
        Ok(Some(message))
    }
}

#[cfg(test)]
mod tests {
    use super::super::message::{Tell, ToNode};
    use super::*;
    use crate::actors::control::Control;
    use crate::net::pair;

    fn control() -> ToNode {
        ToNode::Tell(Tell::Control(Control::Paused))
    }

    #[tokio::test]
    async fn missing_message_is_a_fault() {
        let [(there, mut kept), (back, parcels)] = pair();
        let other = Sender::new(Arc::clone(&back), 6);
        let sender = Sender::new(back, 5);
        let mut receiver = Receiver::<ToNode>::new(parcels).of_run(5);
        other.send(&control());
        for _ in 0..3 {
            sender.send(&control());
        }
        let mut sent = Vec::new();
        while let Ok(parcel) = kept.try_recv() {
            sent.push(parcel);
        }

        // Number 0 is of another run.
        for i in [0, 1, 3] {
            there.send(sent[i].0, sent[i].1.clone());
        }

        assert_eq!(receiver.recv().await, Some(Ok(control())));
        assert_eq!(receiver.recv().await, Some(Err("message 2 came in the place of 1".into())));
    }

    /// A picture that cannot be read, and a message on its lane, end no run.
    #[tokio::test]
    async fn wrong_pictures_are_left_out() {
        let [(there, mut kept), (back, parcels)] = pair();
        let sender = Sender::new(back, 5);
        let mut receiver = Receiver::<ToNode>::new(parcels).of_run(5);
        sender.send(&control());
        let (_, parcel) = kept.try_recv().unwrap();

        there.send(Lane::Pictures, vec![0xc1; 3]);
        there.send(Lane::Pictures, parcel.clone());
        there.send(Lane::Messages, parcel);

        assert_eq!(receiver.recv().await, Some(Ok(control())));
    }

    #[tokio::test]
    async fn messages_beyond_the_limit_are_refused() {
        let [(there, _kept), (_, parcels)] = pair();
        let mut receiver = Receiver::<ToNode>::new(parcels).of_run(5);

        there.send(Lane::Values, vec![0; LONGEST + 1]);

        let why = receiver.recv().await.unwrap().unwrap_err();
        assert_eq!(why, "a message of 1048577 bytes is too long");
    }

    #[tokio::test]
    async fn foreign_bytes_are_refused() {
        let [(there, _kept), (_, parcels)] = pair();
        let mut receiver = Receiver::<ToNode>::new(parcels).of_run(5);

        for bytes in [vec![], vec![0xc1; 3], vec![0x93; 100_000], b"{\"Leave\":1}".to_vec()] {
            there.send(Lane::Messages, bytes);
            let read = receiver.recv().await.unwrap().unwrap_err();
            assert!(read.contains("cannot be read"), "{read}");
        }
    }
}
