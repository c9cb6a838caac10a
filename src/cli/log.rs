//! Log of the program, and the notices for people that take its place.
//!
//! - in: the value of `RUST_LOG`, the events of all crates
//! - out: with a readable value the log on stderr; without one each warning and each error as a
//!   notice, without time and module

use crate::hw::console::{self, Log, Tone};
use std::fmt::{self, Write as _};
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::Context;
use tracing_subscriber::prelude::*;

/// Starts the log. `wanted` is the value of `RUST_LOG`, see [`filter`].
pub(super) fn start(wanted: Option<&str>) {
    let registry = tracing_subscriber::registry();
    // stdout belongs to the results, which a program may read.
    match filter(wanted) {
        Some(filter) => {
            let log = tracing_subscriber::fmt::layer()
                .with_writer(|| Log)
                .with_ansi(console::has_colours());
            registry.with(log.with_filter(filter)).init();
        }
        None => registry.with(Notices.with_filter(LevelFilter::WARN)).init(),
    }
}

/// Returns the filter of `RUST_LOG`: levels, and levels of targets, as in
/// `warn,rubik_robot=debug`. Returns `None` without a readable value.
///
/// `Targets` is used instead of `EnvFilter`, which can also filter by spans and fields: that needs
/// an engine for regular expressions, a tenth of the cost of all packages in a fresh build.
fn filter(wanted: Option<&str>) -> Option<Targets> {
    let wanted = wanted.filter(|text| !text.trim().is_empty());
    wanted.and_then(|text| text.parse().ok())
}

/// Layer that prints events as notices for people.
struct Notices;

impl<S: Subscriber> tracing_subscriber::Layer<S> for Notices {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut sentence = Sentence::default();
        event.record(&mut sentence);
        let tone =
            if *event.metadata().level() == Level::ERROR { Tone::Error } else { Tone::Warning };
        console::timed(tone, &notice(event.metadata().target(), &sentence));
    }
}

/// Returns the notice of an event of the module `target`. Another crate is named.
fn notice(target: &str, sentence: &Sentence) -> String {
    let module = target.split("::").next().unwrap_or_default();
    let source = if module.starts_with("rubik_robot") { "" } else { module };
    let colon = if source.is_empty() { "" } else { ": " };
    let Sentence { message, fields } = sentence;
    let fields = if fields.is_empty() { String::new() } else { format!(" ({fields})") };
    format!("note: {source}{colon}{message}{fields}")
}

/// Message and fields of an event.
#[derive(Debug, Default)]
struct Sentence {
    message: String,
    /// Names and values of the fields, separated by commas.
    fields: String,
}

impl Visit for Sentence {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.record_debug(field, &format_args!("{value}"));
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        // Writing to a string cannot fail.
        let _ = if field.name() == "message" {
            write!(self.message, "{value:?}")
        } else {
            let comma = if self.fields.is_empty() { "" } else { ", " };
            write!(self.fields, "{comma}{} {value:?}", field.name())
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_filter_reads_levels_and_targets() {
        let lets_through =
            |wanted, target, level| filter(Some(wanted)).unwrap().would_enable(target, &level);
        let (warn, debug, trace) = (Level::WARN, Level::DEBUG, Level::TRACE);

        for none in [None, Some(""), Some("rubik_robot=loud")] {
            assert!(filter(none).is_none(), "{none:?}");
        }
        assert!(lets_through("debug", "tokio", debug));
        let two = "warn,rubik_robot::truth=trace";
        assert!(lets_through(two, "rubik_robot::truth", trace));
        assert!(lets_through(two, "rubik_robot::run", warn));
        assert!(!lets_through(two, "rubik_robot::run", debug));
    }

    #[test]
    fn notice_has_words_of_event_without_module() {
        let plain = Sentence { message: "the disk is slow".into(), fields: String::new() };
        let detailed = Sentence { message: "late".into(), fields: "period 7".into() };

        assert_eq!(notice("rubik_robot::run::world", &plain), "note: the disk is slow");
        assert_eq!(notice("zenoh::net", &plain), "note: zenoh: the disk is slow");
        assert_eq!(notice("rubik_robot", &detailed), "note: late (period 7)");
    }
}
