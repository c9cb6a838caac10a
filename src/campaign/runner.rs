//! The runner of a campaign: it performs each run in a process of its own, several at a time.
//!
//! - in: the program, and for each run its seed and options
//! - out: a [`RunResult`] for each run, in the order in which they end
//!
//! The process isolates the run: a panic, an abort, a leak or a hang ends with it. The runner kills
//! a process that exceeds its time. When the campaign is stopped, the runner kills all processes,
//! which leave no result.

use super::result::{Ended, RunResult, Verdict};
use rustix::process::{Pid, Signal, kill_process_group};
use std::ffi::OsString;
use std::io::{Read, Result};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

/// Time between two polls of a process.
const POLL: Duration = Duration::from_millis(10);
/// Signal that ends a process without a clean-up.
const KILLED: i32 = 9;
/// Exit code of a run that a signal interrupted.
const INTERRUPTED: i32 = 130;
/// Longest time between the first and the last process of a task that gets a scheduler's signal. A
/// run that a signal ends takes that much longer.
const GRACE: Duration = Duration::from_millis(200);
/// Number of bytes that are kept from the end of stdout and of stderr.
const KEPT_BYTES: usize = 1 << 20;

/// Run to be performed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Job {
    /// Seed of the run.
    pub seed: u64,
    /// Drawn values, in the form `KEY=VALUE` of `--set`.
    pub set: Vec<String>,
    /// Files with which the run is resumed after a simulated power cut; `None` if a power cut ends
    /// the run.
    pub kept: Option<Kept>,
}

/// Files that outlive a simulated power cut, and the values of the run that resumes after it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Kept {
    /// State of the simulated plant. The journal is beside it.
    pub world: PathBuf,
    /// Recording of the run before the power cut.
    pub recording: PathBuf,
    /// Drawn values of the resumed run, in the form `KEY=VALUE` of `--set`.
    pub set: Vec<String>,
}

impl Kept {
    /// Removes the files, as far as they exist.
    fn remove(&self) {
        let beside = |end: &str| PathBuf::from(format!("{}.{end}", self.world.display()));
        for file in [&self.world, &self.recording, &beside("journal"), &beside("lock")] {
            // A file that stays costs room, but no result.
            let _ = std::fs::remove_file(file);
        }
    }
}

/// Program, scenario and limits of the runs.
#[derive(Debug, Clone)]
pub(crate) struct Runner {
    /// Path of this program.
    pub program: PathBuf,
    /// Path of the scenario.
    pub scenario: PathBuf,
    /// Overrides of all runs, in the form `KEY=VALUE` of `--set`.
    pub set: Vec<String>,
    /// Largest number of processes at a time.
    pub jobs: usize,
    /// Time that a run may take by the wall clock.
    pub limit: Duration,
}

impl Runner {
    /// Performs the runs of all jobs and passes each result to `keep` on the calling thread.
    /// Setting `stop`, or an error of `keep`, kills the processes of the current runs and starts no
    /// more. `unchanged` checks before and after each run that the scenario has not changed; its
    /// error stops the runs as well, and a run during which the scenario changed leaves no result.
    ///
    /// # Errors
    /// An error of `keep` or `unchanged`, or of the operating system when it starts or waits for a
    /// process.
    pub(crate) fn perform(
        &self,
        jobs: &[Job],
        stop: &AtomicBool,
        unchanged: &(dyn Fn() -> Result<()> + Sync),
        mut keep: impl FnMut(RunResult) -> Result<()>,
    ) -> Result<()> {
        let (results, ended) = mpsc::channel();
        let next = AtomicUsize::new(0);
        let failed = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for _ in 0..self.jobs.clamp(1, jobs.len().max(1)) {
                let (results, next, failed) = (results.clone(), &next, &failed);
                scope.spawn(move || {
                    let stopped = || stop.load(Ordering::SeqCst) || failed.load(Ordering::SeqCst);
                    // Each thread takes the next job, so a slow run does not hold up the others.
                    while let Some(job) = jobs.get(next.fetch_add(1, Ordering::SeqCst)) {
                        if stopped() {
                            return;
                        }
                        let one = unchanged().and_then(|()| self.perform_one(job, &stopped));
                        match one.and_then(|one| unchanged().map(|()| one)) {
                            Ok(None) => return,
                            Ok(Some(result)) => {
                                if results.send(Ok(result)).is_err() {
                                    return;
                                }
                            }
                            Err(error) => {
                                // Sending fails only if the receiving thread has panicked.
                                let _ = results.send(Err(error));
                                return;
                            }
                        }
                    }
                });
            }
            drop(results);
            // After an error the loop still receives until all threads have ended, but keeps
            // nothing: the first error is the one that the campaign reports.
            let mut outcome = Ok(());
            for result in ended {
                if outcome.is_ok() {
                    outcome = result.and_then(&mut keep);
                    failed.store(outcome.is_err(), Ordering::SeqCst);
                }
            }
            outcome
        })
    }

    /// Returns the command of a run, or of the run that resumes it after a power cut.
    fn command(&self, job: &Job, resumes: bool) -> Command {
        let mut command = Command::new(&self.program);
        // The path of the running program may be a link in /proc, which would be the name in a list
        // of processes.
        command.arg0("rubik-robot").arg("run").arg(&self.scenario);
        command
            .args(["--json", "--ui", "none", "--seed"])
            .arg(job.seed.to_string())
            // The run ends with the campaign, even if the campaign is killed.
            .arg("--with-parent");
        let kept_set = job.kept.as_ref().filter(|_| resumes).map(|kept| &kept.set);
        for option in self.set.iter().chain(kept_set.unwrap_or(&job.set)) {
            command.args([OsString::from("--set"), option.into()]);
        }
        if let Some(kept) = &job.kept {
            command.arg("--world").arg(&kept.world);
            command.arg(if resumes { "--resume" } else { "--record" });
            command.args((!resumes).then_some(&kept.recording));
        }
        command
            // The last lines of the output become the reason of a failure; neither a log nor a
            // backtrace belongs among them.
            .env_remove("RUST_LOG")
            .env("RUST_BACKTRACE", "0")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // A terminal sends Ctrl-C to its whole group; the campaign ends its runs itself.
            .process_group(0);
        command
    }

    /// Performs one run, and resumes it after a power cut if its files are kept. Returns `None` if
    /// it was stopped.
    fn perform_one(&self, job: &Job, stopped: &dyn Fn() -> bool) -> Result<Option<RunResult>> {
        let first = self.perform_process(self.command(job, false), stopped)?;
        let Some(kept) = &job.kept else {
            let own = first.filter(|end| !(end.is_by_signal() && stops_soon(stopped)));
            return Ok(own.map(|end| end.result(job)));
        };
        // A simulated power cut kills the process of the run after it saved the state of the plant.
        let cut = first.as_ref().is_some_and(|end| end.ended == Ended::Signal(KILLED));
        let result = if !cut {
            Ok(first.map(|end| end.result(job)))
        } else if kept.world.exists() {
            let last = self.perform_process(self.command(job, true), stopped);
            last.map(|end| end.map(|end| end.result(job)))
        } else {
            // A run that can no longer save its world removes the file: no run can resume it.
            Ok(first.map(|end| end.aborted(job)))
        };
        kept.remove();
        result
    }

    /// Performs the process of one run. Returns `None` if it was stopped.
    fn perform_process(
        &self,
        mut command: Command,
        stopped: &dyn Fn() -> bool,
    ) -> Result<Option<ProcessEnd>> {
        let begun = Instant::now();
        let mut child = command.spawn()?;
        // Both streams are read all the time, since a full pipe would block the process.
        let streams = (child.stdout.take().map(read_tail), child.stderr.take().map(read_tail));
        let ended = self.wait(&mut child, begun, stopped);
        let text = |stream: Option<JoinHandle<Vec<u8>>>| {
            let bytes = stream.and_then(|s| s.join().ok()).unwrap_or_default();
            String::from_utf8_lossy(&bytes).into_owned()
        };
        let (stdout, stderr) = (text(streams.0), text(streams.1));
        let wall_time_s = begun.elapsed().as_secs_f64();
        Ok(ended?.map(|ended| ProcessEnd { stdout, stderr, ended, wall_time_s }))
    }

    /// Waits for the end of a run's process, and kills it at the time limit, counted from `begun`.
    /// Returns `None` if `stopped` became true earlier, which kills the process as well.
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
                // The cause of the stop may have ended this run as well, so its end is no result.
                return Ok((!stopped()).then_some(ended));
            }
            let late = begun.elapsed() > self.limit;
            if late || stopped() {
                // An error means that the process has just ended by itself. Its whole group is
                // killed, because a child of the run would keep the streams open.
                let _ = kill_process_group(Pid::from_child(child), Signal::KILL);
                child.wait()?;
                return Ok(late.then_some(Ended::TimedOut(self.limit.as_secs_f64())));
            }
            std::thread::sleep(POLL);
        }
    }
}

/// Waits for at most [`GRACE`] and returns whether the campaign is stopped meanwhile. A scheduler
/// that ends a task sends the signal to one process after the other, so a run may end before the
/// campaign is stopped. Its end would count as a failure of the run. If the signal kills the
/// campaign as well, it comes during this wait, and no result is kept either.
fn stops_soon(stopped: &dyn Fn() -> bool) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < GRACE {
        if stopped() {
            return true;
        }
        std::thread::sleep(POLL);
    }
    stopped()
}

/// End of the process of a run.
struct ProcessEnd {
    stdout: String,
    stderr: String,
    ended: Ended,
    wall_time_s: f64,
}

impl ProcessEnd {
    /// Returns the result of the run.
    fn result(&self, job: &Job) -> RunResult {
        let streams = (self.stdout.as_str(), self.stderr.as_str());
        let result =
            RunResult::of_process(job.seed, &job.set, streams, self.ended, self.wall_time_s);
        // A clock before 1970 is wrong, and gives no pace.
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok();
        RunResult { ended_unix_s: now.map(|now| now.as_secs_f64()), ..result }
    }

    /// Returns whether a signal from outside ended the run.
    fn is_by_signal(&self) -> bool {
        matches!(self.ended, Ended::Signal(_) | Ended::Code(INTERRUPTED))
    }

    /// Returns the result of a run that a power cut ended, and that no run can resume because the
    /// file of its simulated world was lost before.
    fn aborted(&self, job: &Job) -> RunResult {
        let reason = "the power was cut after the file of the simulated world was lost";
        RunResult { verdict: Verdict::Aborted, reason: reason.into(), ..self.result(job) }
    }
}

/// Reads a stream to its end in a thread, which returns the last [`KEPT_BYTES`] of it, or all if
/// they are fewer.
fn read_tail(mut stream: impl Read + Send + 'static) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let (mut kept, mut bytes) = (Vec::new(), vec![0; 1 << 16]);
        // A read error ends the stream as its end does.
        while let Ok(read) = stream.read(&mut bytes) {
            if read == 0 {
                break;
            }
            kept.extend_from_slice(&bytes[..read]);
            // Cut at twice the length, so that each byte is moved once at most.
            if kept.len() > 2 * KEPT_BYTES {
                kept.drain(..kept.len() - KEPT_BYTES);
            }
        }
        kept.drain(..kept.len().saturating_sub(KEPT_BYTES));
        kept
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    /// Returns a runner that starts this shell script for each run instead of the program.
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

    /// Returns a job for each seed.
    fn jobs(seeds: std::ops::Range<u64>) -> Vec<Job> {
        seeds.map(|seed| Job { seed, set: vec![], kept: None }).collect()
    }

    /// Performs the jobs and returns their results in the order of the seeds.
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
    fn hanging_crashing_or_flooding_run_spares_other_runs() {
        // $7 is the seed.
        let script = "case $7 in\n0) sleep 60;;\n1) kill -9 $$;;\n2) yes | head -c 9000000;;\n\
                      *) echo \"thread 'main' panicked at a.rs:1:1:\" >&2; echo why >&2; \
                      exit 101;;\nesac";
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
    fn stream_tail_has_at_most_kept_bytes() {
        let tail = |bytes: Vec<u8>| read_tail(std::io::Cursor::new(bytes)).join().unwrap();
        // Longer than the tail, but not yet twice as long.
        let long = [vec![b'a'; KEPT_BYTES / 2], vec![b'b'; KEPT_BYTES]].concat();

        assert!(tail(long) == vec![b'b'; KEPT_BYTES], "the last bytes");
        assert_eq!(tail(b"short".to_vec()), b"short");
    }

    #[test]
    fn stopped_runs_leave_no_result() {
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

    /// A scheduler ends the run a moment before the campaign: the run is not a failure. Without a
    /// stop its end by a signal is one.
    #[test]
    fn signal_to_run_and_campaign_leaves_no_result() {
        for (name, end) in [("killed", "kill -9 $$"), ("interrupted", "exit 130")] {
            let runner = runner(name, &format!(": > \"${{0%/*}}/begun\"; {end}"));
            let begun = runner.program.with_file_name("begun");
            let stop = AtomicBool::new(false);

            std::thread::scope(|scope| {
                scope.spawn(|| {
                    while !begun.exists() {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    std::thread::sleep(Duration::from_millis(50));
                    stop.store(true, Ordering::SeqCst);
                });
                assert!(all(&runner, &jobs(0..1), &stop).is_empty(), "{name}");
            });
            let alone = all(&runner, &jobs(0..1), &AtomicBool::new(false));
            assert_eq!(alone[0].verdict, Verdict::Died, "{name}");
        }
    }

    #[test]
    fn full_disk_ends_the_campaign_with_its_error() {
        let runner = runner("full", "echo x >> \"${0%/*}/begun\"; exit 1");

        let outcome = runner.perform(&jobs(0..50), &AtomicBool::new(false), &|| Ok(()), |_| {
            Err(std::io::ErrorKind::StorageFull.into())
        });

        assert_eq!(outcome.unwrap_err().kind(), std::io::ErrorKind::StorageFull);
        let begun = std::fs::read_to_string(runner.program.with_file_name("begun")).unwrap();
        assert!(begun.lines().count() < 25, "it starts no more of the 50 runs: {begun}");
    }

    #[test]
    fn changed_scenario_ends_the_campaign() {
        let runner = Runner { jobs: 1, ..runner("changes", "exit 1") };
        let looks = AtomicUsize::new(0);
        // The scenario is unchanged before and after each of two runs and before the third, but not
        // after it.
        let unchanged = || match looks.fetch_add(1, Ordering::SeqCst) {
            0..5 => Ok(()),
            _ => Err(std::io::Error::other("it has changed")),
        };
        let mut seeds = Vec::new();

        let outcome = runner.perform(&jobs(0..50), &AtomicBool::new(false), &unchanged, |result| {
            seeds.push(result.seed);
            Ok(())
        });

        assert_eq!(outcome.unwrap_err().to_string(), "it has changed");
        assert_eq!(seeds, [0, 1]);
    }

    #[test]
    fn run_is_resumed_after_power_cut() {
        // The stand-in saves its state and is killed, and names its options when it is resumed.
        let script = "case \"$*\" in\n*--resume*) echo \"$*\" >&2; exit 7;;\n\
                      *\"$SAVES\"*) : > \"${0%/*}/world\"; kill -9 $$;;\n*) kill -9 $$;;\nesac";
        let script = script.replace("$SAVES", "a=1");
        let runner = runner("resumes", &script);
        let world = runner.program.with_file_name("world");
        let run = |set: &str| {
            let kept = Kept {
                world: world.clone(),
                recording: world.with_extension("mcap"),
                set: vec!["a=2".into()],
            };
            let job = Job { seed: 1, set: vec![set.into()], kept: Some(kept) };
            all(&runner, &[job], &AtomicBool::new(false)).remove(0)
        };

        let cut = run("a=1");
        let lost = run("a=0");

        assert!(cut.reason.contains("exit code 7"), "{cut:?}");
        assert!(cut.reason.contains("--set a=2") && !cut.reason.contains("a=1"), "{cut:?}");
        assert!(!world.exists(), "its files are removed");
        // Without the world nothing can be resumed, which is no death of the program.
        assert_eq!(lost.verdict, Verdict::Aborted, "{lost:?}");
        assert!(lost.reason.contains("simulated world was lost"), "{lost:?}");
    }
}
