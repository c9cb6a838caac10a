//! What the tests of hostile input share: the search for an input that a reader does not bear, and the watch over each.
//!
//! - so many cases, or with `HOSTILE_SECONDS=N` fresh ones of other seeds until N seconds are over
//! - what is found is printed, and written to `tests/corpus/KIND/found-...`: there it is looked at in each later run
#![allow(unreachable_pub, reason = "a module of test programs")]

use crate::memory;
use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngSeed, TestError, TestRunner};
use std::cell::Cell;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
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

/// When the present input must be done, in milliseconds since the first; 0 while there is none.
static DUE: AtomicU64 = AtomicU64::new(0);
static NOW: Mutex<Option<Input>> = Mutex::new(None);

/// Makes an input once more.
type Written = Box<dyn Fn() -> Vec<u8> + Send>;

/// An input by its name; and by the corpus that it comes to where it hangs, and its bytes there.
pub struct Input {
    name: String,
    kept: Option<(&'static str, Written)>,
}

impl Input {
    /// One that can be had again by its name.
    pub fn named(name: &str) -> Self {
        Self { name: name.to_owned(), kept: None }
    }

    /// One that was found.
    pub fn found(kind: &'static str, written: impl Fn() -> Vec<u8> + Send + 'static) -> Self {
        Self { name: kind.to_owned(), kept: Some((kind, Box::new(written))) }
    }
}

/// Ends the process with the input's name when it hangs: a test cannot be ended otherwise.
fn watch() -> Instant {
    static BEGUN: OnceLock<Instant> = OnceLock::new();
    *BEGUN.get_or_init(|| {
        std::thread::spawn(|| {
            loop {
                std::thread::sleep(Duration::from_millis(200));
                let (due, now) = (DUE.load(Ordering::SeqCst), watch().elapsed().as_millis() as u64);
                if due > 0 && now > due {
                    let input = NOW.lock().unwrap_or_else(PoisonError::into_inner);
                    if let Some(Input { name, kept }) = input.as_ref() {
                        eprintln!("HANGS: {name}");
                        if let Some((kind, written)) = kept {
                            let bytes = written();
                            eprintln!("{}", String::from_utf8_lossy(&bytes));
                            eprintln!("{}", keep(kind, &bytes).display());
                        }
                    }
                    std::process::abort();
                }
            }
        });
        Instant::now()
    })
}

/// Runs a reader alone in the process, and ends that where it takes longer than `limit`. The most bytes that it held, and
/// the time that it took.
pub fn watched(input: Input, limit: Duration, read: impl FnOnce()) -> (usize, Duration) {
    /// No input is due any more, also where the reader has panicked.
    struct Done;
    impl Drop for Done {
        fn drop(&mut self) {
            DUE.store(0, Ordering::SeqCst);
        }
    }
    let _alone = memory::alone();
    let begun = watch();
    *NOW.lock().unwrap_or_else(PoisonError::into_inner) = Some(input);
    let _done = Done;
    DUE.store((begun.elapsed() + limit).as_millis() as u64, Ordering::SeqCst);
    let begun = Instant::now();
    (memory::most_held(read), begun.elapsed())
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
