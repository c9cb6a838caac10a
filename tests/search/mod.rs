//! What the tests of hostile input share: the search for an input that a reader does not bear.
//!
//! - so many cases, or with `HOSTILE_SECONDS=N` fresh ones of other seeds until N seconds are over
//! - what is found is printed, and written to `tests/corpus/KIND/found-...`: there it is looked at in each later run
#![allow(unreachable_pub, reason = "a module of test programs")]

use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngSeed, TestError, TestRunner};
use std::cell::Cell;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Cases between two looks at the clock.
const AT_ONCE: u32 = 64;

fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

/// Writes an input into its kind's corpus, for later runs; its name.
pub fn keep(kind: &str, input: &[u8]) -> PathBuf {
    let sum = crc32fast::hash(input);
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "tests/corpus", kind].iter().collect();
    let path = folder.join(format!("found-{sum:08x}"));
    if let Err(why) = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&path, input)) {
        eprintln!("{}: {why}", path.display());
    }
    path
}

/// Gives inputs to a reader until one makes it panic, or the cases, or the seconds, are over.
pub fn search<S: Strategy>(
    kind: &str,
    cases: u32,
    inputs: &S,
    written: impl Fn(&S::Value) -> Vec<u8>,
    read: impl Fn(S::Value),
) {
    let (begun, done) = (Instant::now(), Cell::new(0_u64));
    let time = number("HOSTILE_SECONDS").map(Duration::from_secs);
    let cases = number("HOSTILE_CASES").map_or(cases, |n| n as u32);
    let first = number("PROPTEST_RNG_SEED").unwrap_or(1);
    for round in 0.. {
        let mut runner = TestRunner::new(Config {
            cases: if time.is_some() { AT_ONCE } else { cases },
            failure_persistence: None,
            max_shrink_iters: 2000,
            rng_seed: RngSeed::Fixed(first.wrapping_add(round)),
            ..Config::default()
        });
        let found = runner.run(inputs, |input| {
            if time.is_none_or(|time| begun.elapsed() < time) {
                done.set(done.get() + 1);
                read(input);
            }
            Ok(())
        });
        match found {
            Ok(()) => {}
            Err(TestError::Fail(why, input)) => {
                let bytes = written(&input);
                let place = keep(kind, &bytes);
                let shown = String::from_utf8_lossy(&bytes);
                panic!("{kind}, {}: {why}\n{shown}\n{:?}", place.display(), bytes.as_slice());
            }
            Err(why) => panic!("{kind}: {why}"),
        }
        if time.is_none_or(|time| begun.elapsed() >= time) {
            break;
        }
    }
    if time.is_some() {
        println!("{kind}: {} cases in {:.0} s", done.get(), begun.elapsed().as_secs_f64());
    }
}
