//! The search for inputs that make a reader panic or hang, shared by the tests of hostile input.
//!
//! - in: a strategy that makes inputs, and the number of cases (`HOSTILE_CASES` overrides it); with
//!   `HOSTILE_SECONDS=N` further seeds are tried until N seconds are over
//! - out: a found input is printed and written to `tests/corpus/KIND/found-...`, where each later
//!   run tries it
#![allow(unreachable_pub, reason = "a module of test programs")]

use crate::memory;
use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngSeed, TestError, TestRunner};
use std::cell::Cell;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Number of cases between two readings of the clock.
const AT_ONCE: u32 = 64;

/// Returns the number in the environment variable `name`, if there is one.
fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok().and_then(|text| text.parse().ok())
}

/// Writes an input into the corpus of its kind, for later runs, and returns its path.
pub fn keep(kind: &str, input: &[u8]) -> PathBuf {
    let sum = crc32fast::hash(input);
    let folder: PathBuf = [env!("CARGO_MANIFEST_DIR"), "tests/corpus", kind].iter().collect();
    let path = folder.join(format!("found-{sum:08x}"));
    if let Err(why) = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&path, input)) {
        eprintln!("{}: {why}", path.display());
    }
    path
}

/// Time at which the present input must be done, since the first one (ms); 0 if there is none.
static DUE: AtomicU64 = AtomicU64::new(0);
/// Present input, or the last one.
static NOW: Mutex<Option<Input>> = Mutex::new(None);

/// Closure that makes the bytes of an input again.
type Written = Box<dyn Fn() -> Vec<u8> + Send>;

/// An input: its name, and the corpus and the bytes with which it is kept if it hangs.
pub struct Input {
    name: String,
    kept: Option<(&'static str, Written)>,
}

impl Input {
    /// Makes an input that comes from a file and is not written to the corpus if a reader hangs.
    pub fn by_name(name: &str) -> Self {
        Self { name: name.to_owned(), kept: None }
    }

    /// Makes a generated input. If a reader hangs with it, the bytes that `written` returns are
    /// kept in the corpus `kind`.
    pub fn generated(kind: &'static str, written: impl Fn() -> Vec<u8> + Send + 'static) -> Self {
        Self { name: kind.to_owned(), kept: Some((kind, Box::new(written))) }
    }
}

/// Starts the watchdog at the first call and returns the time of that call. The watchdog prints the
/// name of an input that hangs and aborts the process, because a test's thread cannot be ended.
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

/// Runs a reader of `input` while no other reader runs, and aborts the process if it takes longer
/// than `limit`. Returns the most bytes that the reader held at a time, and its time.
pub fn watched(input: Input, limit: Duration, read: impl FnOnce()) -> (usize, Duration) {
    /// Guard that disarms the watchdog, also if the reader panics.
    struct Done;
    impl Drop for Done {
        fn drop(&mut self) {
            DUE.store(0, Ordering::SeqCst);
        }
    }
    let _alone = memory::lock_process();
    let begun = watch();
    *NOW.lock().unwrap_or_else(PoisonError::into_inner) = Some(input);
    let _done = Done;
    DUE.store((begun.elapsed() + limit).as_millis() as u64, Ordering::SeqCst);
    let begun = Instant::now();
    (memory::most_held(read), begun.elapsed())
}

/// Calls the reader `read` with generated inputs until it panics, or `cases` inputs or the time of
/// `HOSTILE_SECONDS` are used up. An input with which it panics is shrunk and kept, as the bytes
/// that `written` returns, in the corpus `kind`.
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
