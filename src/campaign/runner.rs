//! Performs runs, each in a process of its own, several at a time.
//!
//! - in: the program, and for each run its seed and options
//! - out: a [`RunResult`] for each that came to an end, in the order of their ends
//!
//! A process is what isolates a run: its panic, its abort, its memory and its hang end with it. One
//! that takes longer than its time is killed; all are when the campaign is told to stop, and leave
//! no result.

use super::result::{Ended, RunResult};
use rustix::process::{Pid, Signal, kill_process_group};
use std::ffi::OsString;
use std::io::{Read, Result};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two looks at a process.
const LOOK: Duration = Duration::from_millis(10);
/// Length of the end of a process's output that is kept (bytes).
const KEPT: usize = 1 << 20;

/// A run to be performed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Job {
    /// Its seed.
    pub seed: u64,
    /// What was drawn for it, as behind `--set`.
    pub set: Vec<String>,
}

/// How runs are performed.
#[derive(Debug, Clone)]
pub(crate) struct Runner {
    /// This program.
    pub program: PathBuf,
    /// The scenario.
    pub scenario: PathBuf,
    /// What overrules it in all runs, as behind `--set`.
    pub set: Vec<String>,
    /// Processes at a time.
    pub jobs: usize,
    /// Time that a run may take by the wall clock.
    pub limit: Duration,
}

impl Runner {
    /// Performs all; each result goes to `done` on this thread, which may fail and thereby stop the
    /// rest. So may `still`, which says before and after each run whether what is run is what it
    /// was: a run in whose time it changed leaves no result.
    ///
    /// # Errors
    /// What `done` or `still` returns, or what the operating system says to a new process.
    pub(crate) fn perform(
        &self,
        jobs: &[Job],
        stop: &AtomicBool,
        still: &(dyn Fn() -> Result<()> + Sync),
        mut done: impl FnMut(RunResult) -> Result<()>,
    ) -> Result<()> {
        let (results, ended) = mpsc::channel();
        let next = AtomicUsize::new(0);
        let failed = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..self.jobs.clamp(1, jobs.len().max(1)) {
                let (results, next, failed) = (results.clone(), &next, &failed);
                scope.spawn(move || {
                    let stopped = || stop.load(Ordering::SeqCst) || failed.load(Ordering::SeqCst);
                    while let Some(job) = jobs.get(next.fetch_add(1, Ordering::SeqCst)) {
                        if stopped() {
                            return;
                        }
                        let one = still().and_then(|()| self.one(job, &stopped));
                        match one.and_then(|one| still().map(|()| one)) {
                            Ok(None) => return,
                            Ok(Some(result)) => {
                                if results.send(Ok(result)).is_err() {
                                    return;
                                }
                            }
                            Err(error) => {
                                // Whoever listens is told, if anybody is left.
                                let _ = results.send(Err(error));
                                return;
                            }
                        }
                    }
                });
            }
            drop(results);
            let mut outcome = Ok(());
            for result in ended {
                if outcome.is_ok() {
                    outcome = result.and_then(&mut done);
                    failed.store(outcome.is_err(), Ordering::SeqCst);
                }
            }
            outcome
        })
    }

    fn command(&self, job: &Job) -> Command {
        let mut command = Command::new(&self.program);
        // What a list of processes shows, whatever path leads to the program.
        command.arg0("rubik-robot").arg("run").arg(&self.scenario);
        command
            .args(["--json", "--ui", "none", "--seed"])
            .arg(job.seed.to_string())
            .arg("--with-parent");
        for option in self.set.iter().chain(&job.set) {
            command.args([OsString::from("--set"), option.into()]);
        }
        command
            .env_remove("RUST_LOG")
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C is for the campaign, which ends its runs itself.
            .process_group(0);
        command
    }

    /// `None` when it was stopped.
    fn one(&self, job: &Job, stopped: &dyn Fn() -> bool) -> Result<Option<RunResult>> {
        let begun = Instant::now();
        let mut child = self.command(job).spawn()?;
        let streams = (child.stdout.take().map(last_of), child.stderr.take().map(last_of));
        let ended = self.wait(&mut child, begun, stopped);
        let text = |stream: Option<JoinHandle<Vec<u8>>>| {
            let bytes = stream.and_then(|s| s.join().ok()).unwrap_or_default();
            String::from_utf8_lossy(&bytes).into_owned()
        };
        let (stdout, stderr) = (text(streams.0), text(streams.1));
        let wall = begun.elapsed().as_secs_f64();
        Ok(ended?.map(|ended| {
            RunResult::of_process(job.seed, &job.set, (&stdout, &stderr), ended, wall)
        }))
    }

    fn wait(
        &self,
        child: &mut Child,
        begun: Instant,
        stopped: &dyn Fn() -> bool,
    ) -> Result<Option<Ended>> {
        loop {
            if let Some(status) = child.try_wait()? {
                let ended = match (status.code(), status.signal()) {
                    (Some(code), _) => Ended::Code(code),
                    (None, signal) => Ended::Signal(signal.unwrap_or(0)),
                };
                return Ok((!stopped()).then_some(ended));
            }
            let late = begun.elapsed() > self.limit;
            if late || stopped() {
                // It may just have ended by itself. Whatever it started goes with it, and lets the
                // streams end.
                let _ = kill_process_group(Pid::from_child(child), Signal::KILL);
                child.wait()?;
                return Ok(late.then_some(Ended::TimedOut(self.limit.as_secs_f64())));
            }
            std::thread::sleep(LOOK);
        }
    }
}

/// Reads a stream to its end and keeps the last of it.
fn last_of(mut stream: impl Read + Send + 'static) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let (mut kept, mut bytes) = (Vec::new(), vec![0; 1 << 16]);
        // A stream that fails has no more to say.
        while let Ok(read) = stream.read(&mut bytes) {
            if read == 0 {
                break;
            }
            kept.extend_from_slice(&bytes[..read]);
            if kept.len() > 2 * KEPT {
                kept.drain(..kept.len() - KEPT);
            }
        }
        kept
    })
}

#[cfg(test)]
mod tests {
    use super::super::result::Verdict;
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    /// A stand-in for the program that does as its seed says.
    fn runner(name: &str, script: &str) -> Runner {
        let folder =
            std::env::temp_dir().join(format!("rubik-runner-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let program = folder.join("stand-in");
        std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        Runner {
            program,
            scenario: "s.toml".into(),
            set: vec![],
            jobs: 3,
            limit: Duration::from_millis(1500),
        }
    }

    fn jobs(seeds: std::ops::Range<u64>) -> Vec<Job> {
        seeds.map(|seed| Job { seed, set: vec![] }).collect()
    }

    fn all(runner: &Runner, jobs: &[Job], stop: &AtomicBool) -> Vec<RunResult> {
        let mut results = Vec::new();
        runner
            .perform(jobs, stop, &|| Ok(()), |result| {
                results.push(result);
                Ok(())
            })
            .unwrap();
        results.sort_by_key(|r| r.seed);
        results
    }

    #[test]
    fn neither_a_hang_nor_a_crash_nor_a_flood_ends_the_others() {
        // $7 is the seed.
        let script = "case $7 in\n0) sleep 60;;\n1) kill -9 $$;;\n2) yes | head -c 9000000;;\n\
                      *) echo \"thread 'main' panicked at a.rs:1:1:\" >&2; echo why >&2; exit 101;;\nesac";
        let runner = runner("isolates", script);
        let begun = Instant::now();

        let results = all(&runner, &jobs(0..6), &AtomicBool::new(false));

        assert!(begun.elapsed() < Duration::from_secs(20));
        let verdicts: Vec<_> = results.iter().map(|r| r.verdict).collect();
        assert_eq!(verdicts[0], Verdict::TimedOut);
        assert!(verdicts[1..].iter().all(|v| *v == Verdict::Died), "{results:?}");
        assert!(results[1].reason.contains("signal 9"), "{results:?}");
        assert!(results[5].reason.contains("panicked at a.rs:1:1: why"), "{results:?}");
    }

    #[test]
    fn a_stop_ends_the_runs_and_leaves_no_result_of_them() {
        let runner = Runner { limit: Duration::from_secs(60), ..runner("stops", "sleep 30") };
        let stop = AtomicBool::new(false);
        let begun = Instant::now();

        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(200));
                stop.store(true, Ordering::SeqCst);
            });
            assert!(all(&runner, &jobs(0..6), &stop).is_empty());
        });
        assert!(begun.elapsed() < Duration::from_secs(20));
    }

    #[test]
    fn a_full_disk_ends_the_campaign_and_is_told() {
        let runner = runner("full", "exit 1");

        let told = runner.perform(&jobs(0..50), &AtomicBool::new(false), &|| Ok(()), |_| {
            Err(std::io::ErrorKind::StorageFull.into())
        });

        assert_eq!(told.unwrap_err().kind(), std::io::ErrorKind::StorageFull);
    }

    #[test]
    fn what_changes_in_the_middle_ends_the_campaign_and_the_run_that_it_changed_in_leaves_no_result()
     {
        let runner = Runner { jobs: 1, ..runner("changes", "exit 1") };
        let looks = AtomicUsize::new(0);
        // Before and after each of two runs all is well, and before the third; no longer after it.
        let still = || match looks.fetch_add(1, Ordering::SeqCst) {
            0..5 => Ok(()),
            _ => Err(std::io::Error::other("it has changed")),
        };
        let mut seeds = Vec::new();

        let told = runner.perform(&jobs(0..50), &AtomicBool::new(false), &still, |result| {
            seeds.push(result.seed);
            Ok(())
        });

        assert_eq!(told.unwrap_err().to_string(), "it has changed");
        assert_eq!(seeds, [0, 1]);
    }
}
