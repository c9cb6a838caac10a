//! Messages of one type over a link: written as bytes and numbered.
//!
//! - in: messages; bytes from a link
//! - out: bytes to a link; messages, or the fault of one
//!
//! A network may drop a message without a word, so each has a number, and a gap is a fault. Values
//! have no number: newer ones follow.

use crate::net::{Lane, Link, Parcels};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::marker::PhantomData;
use std::sync::{Arc, Mutex, PoisonError};

/// Message that a link carries.
pub(crate) trait Carried: Serialize + DeserializeOwned {
    /// Returns the lane of the message.
    fn lane(&self) -> Lane;
}

/// Sending end for messages of one type. All clones number the same messages.
#[derive(Debug)]
pub(crate) struct Sender<T> {
    link: Arc<dyn Link>,
    /// Number of the next message.
    next: Arc<Mutex<u64>>,
    messages: PhantomData<fn(T)>,
}

impl<T> Clone for Sender<T> {
    fn clone(&self) -> Self {
        Self { link: Arc::clone(&self.link), next: Arc::clone(&self.next), messages: PhantomData }
    }
}

impl<T: Carried> Sender<T> {
    /// Makes the sending end over a link.
    pub(crate) fn new(link: Arc<dyn Link>) -> Self {
        Self { link, next: Arc::default(), messages: PhantomData }
    }

    /// Sends a message. It does not wait for the other node.
    pub(crate) fn send(&self, message: &T) {
        let lane = message.lane();
        // Locked until the link has the message: numbers leave in their order.
        let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
        let number = if lane == Lane::Messages { *next } else { 0 };
        match rmp_serde::to_vec_named(&(number, message)) {
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
    /// Number of the next message.
    next: u64,
    messages: PhantomData<fn() -> T>,
}

impl<T: Carried> Receiver<T> {
    /// Makes the receiving end over a link.
    pub(crate) fn new(parcels: Parcels) -> Self {
        Self { parcels, next: 0, messages: PhantomData }
    }

    /// Waits for the next message; `None` if the link has ended.
    ///
    /// # Errors
    /// The reason why a message cannot be read, or the number of messages that are missing.
    pub(crate) async fn recv(&mut self) -> Option<Result<T, String>> {
        let (lane, parcel) = self.parcels.recv().await?;
        Some(self.read(lane, &parcel))
    }

    /// Reads a message, and checks that its number is the next one.
    fn read(&mut self, lane: Lane, parcel: &[u8]) -> Result<T, String> {
        let (number, message): (u64, T) = rmp_serde::from_slice(parcel)
            .map_err(|why| format!("a message cannot be read: {why}"))?;
        if message.lane() != lane {
            return Err("a message came on the wrong lane".to_owned());
        }
        if lane == Lane::Messages {
            if number != self.next {
                return Err(format!("message {number} came in the place of {}", self.next));
            }
            self.next += 1;
        }
        Ok(message)
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
        let (sender, mut receiver) = (Sender::new(back), Receiver::<ToNode>::new(parcels));
        for _ in 0..3 {
            sender.send(&control());
        }
        let mut sent = Vec::new();
        while let Ok(parcel) = kept.try_recv() {
            sent.push(parcel);
        }

        for i in [0, 2] {
            there.send(sent[i].0, sent[i].1.clone());
        }

        assert_eq!(receiver.recv().await, Some(Ok(control())));
        assert_eq!(receiver.recv().await, Some(Err("message 2 came in the place of 1".into())));
    }

    #[tokio::test]
    async fn foreign_bytes_are_refused() {
        let [(there, _kept), (_, parcels)] = pair();
        let mut receiver = Receiver::<ToNode>::new(parcels);

        for bytes in [vec![], vec![0xc1; 3], vec![0x93; 100_000], b"{\"Leave\":1}".to_vec()] {
            there.send(Lane::Messages, bytes);
            let read = receiver.recv().await.unwrap().unwrap_err();
            assert!(read.contains("cannot be read"), "{read}");
        }
    }
}
