//! Messages of a node's actors to the operator at MP's node.
//!
//! - in: notices of the node's actors
//! - out: messages over the link, and lines of the node's log; at MP's node a notice with the
//!   node's name

use super::line::Sender;
use super::message::ToHome;
use crate::actors::notice::{Notice, message};
use crate::operator::Class;
use crate::record::merge::name_of;
use tokio::sync::mpsc;

/// Most bytes of a text, and of a name.
const LONGEST: usize = 4096;

/// Sends the notices of a node's actors, until their trace is gone.
pub(crate) fn send_notices(mut notices: mpsc::Receiver<Notice>, sender: Sender<ToHome>) {
    tokio::spawn(async move {
        while let Some(notice) = notices.recv().await {
            let Some((class, who, text)) = message(&notice) else { continue };
            tracing::warn!("{who}: {text}");
            let (who, text) = (short(who), short(text));
            sender.send(&ToHome::Notice { class, who, text });
        }
    });
}

/// Returns the notice at MP's node at `time` (s) of what the actor `who` of a node has told.
pub(super) fn of_node(
    node: &str,
    time: f64,
    (class, who, text): (Class, String, String),
) -> Notice {
    Notice::Elsewhere(time, class, name_of(node, &short(who)), short(text))
}

/// Returns the beginning of a text that is too long.
fn short(mut text: String) -> String {
    let end = (0..=LONGEST.min(text.len())).rev().find(|&at| text.is_char_boundary(at));
    text.truncate(end.unwrap_or(0));
    text
}

#[cfg(test)]
mod tests {
    use super::super::Receiver;
    use super::*;
    use crate::error::{Error, NonFatal};
    use crate::net::pair;

    #[tokio::test]
    async fn notices_cross_with_name_of_node() {
        let [(near, _), (_, parcels)] = pair();
        let (told, notices) = mpsc::channel(8);
        let mut receiver = Receiver::<ToHome>::new(parcels).of_run(5);
        send_notices(notices, Sender::new(near, 5));
        let cause = NonFatal::NoReading("dark".into());
        let error = Error::NonFatal { actor: "vsp gs1".into(), place: "look".into(), cause };
        let text = error.to_string();
        told.send(Notice::Error(1.0, error)).await.unwrap();
        told.send(Notice::Warning(2.0, "\u{20ac}".repeat(2000))).await.unwrap();

        let mut arrived = Vec::new();
        for _ in 0..2 {
            let message = receiver.recv().await.unwrap().unwrap();
            let ToHome::Notice { class, who, text } = message else { panic!("{message:?}") };
            arrived.push(of_node("b", 7.0, (class, who, text)));
        }

        let on_b = "vsp gs1 on node b".to_owned();
        assert_eq!(arrived[0], Notice::Elsewhere(7.0, Class::NonFatal, on_b, text));
        let cut = "\u{20ac}".repeat(LONGEST / 3);
        let expected = Notice::Elsewhere(7.0, Class::Warning, "on node b".into(), cut);
        assert_eq!(arrived[1], expected);
    }
}
