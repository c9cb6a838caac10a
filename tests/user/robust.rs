//! The program under signals, at limits of the system, and beside a second one.

use crate::folder::Folder;
use crate::program::program;
use rustix::process::{Pid, Signal, kill_process};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Arguments of an idle run at the pace of the wall clock; the value of its time must follow.
const LONG: &[&str] =
    &["run", "scenarios/idle.toml", "--ui", "none", "--json", "--speed", "1", "--set"];
/// Value for [`LONG`]: the run lasts a minute unless it is ended.
const MINUTE: &str = "idle.time_s=60";

/// Longest time in which a process starts or ends on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// Waits until `happened` returns `true`. `what` names the event in the failure.
fn until(what: &str, mut happened: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !happened() {
        assert!(begun.elapsed() < PATIENCE, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Returns whether a process ignores a signal.
fn ignores(process: &Child, signal: Signal) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id()));
    let mask = status
        .unwrap_or_default()
        .lines()
        .find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    mask.unwrap_or(0) >> (signal.as_raw() - 1) & 1 == 1
}

/// Each of these would end or stop a process that decides nothing.
#[test]
fn run_survives_signals_without_meaning() {
    let mut run = program();
    let mut run = run.args(LONG).arg(MINUTE).stdout(Stdio::piped()).spawn().unwrap();
    let process = Pid::from_child(&run);
    until("the start of the run", || ignores(&run, Signal::USR1));
    let signals = [
        Signal::TTIN,
        Signal::TTOU,
        Signal::XFSZ,
        Signal::USR1,
        Signal::USR2,
        Signal::IO,
        Signal::VTALARM,
        Signal::PROF,
    ];

    for signal in signals {
        assert!(ignores(&run, signal), "{signal:?}");
        kill_process(process, signal).unwrap();
    }
    std::thread::sleep(Duration::from_millis(300));
    assert!(run.try_wait().unwrap().is_none(), "it goes on");
    kill_process(process, Signal::TERM).unwrap();
    assert!(run.wait_with_output().unwrap().status.code().is_some());
}

/// `timeout --signal=ALRM` means the end; the limit of processor time comes again and again.
#[test]
fn signals_of_limits_end_the_run() {
    for signals in [&[Signal::XCPU, Signal::XCPU][..], &[Signal::ALARM]] {
        let mut run = program();
        // It would last longer than the patience.
        let mut run = run.args(LONG).arg("idle.time_s=600").stdout(Stdio::null()).spawn().unwrap();
        until("the start of the run", || ignores(&run, Signal::USR1));
        for signal in signals {
            kill_process(Pid::from_child(&run), *signal).unwrap();
        }
        until("the end of the run", || run.try_wait().unwrap().is_some());

        let status = run.wait().unwrap();
        assert!(status.code().is_some(), "{signals:?}: {status:?}");
    }
}

/// The size of a stack larger than the address space makes each thread impossible.
#[test]
fn impossible_thread_is_a_system_error() {
    let (folder, all) = (Folder::new("robust-thread"), ["--set", "idle.time_s=1"]);
    let record = folder.0.join("r.mcap");
    let pages: &[&[&str]] = &[
        &["run", "scenarios/idle.toml", "--ui", "none"],
        &["run", "scenarios/idle.toml", "--ui", "none", "--pace", "real-time"],
        &["run", "scenarios/idle.toml", "--ui", "none", "--record", record.to_str().unwrap()],
    ];
    for args in pages {
        let mut run = program();
        let out = run.args(*args).args(all).env("RUST_MIN_STACK", (1_u64 << 50).to_string());
        let out = out.output().unwrap();
        let told = String::from_utf8_lossy(&out.stderr);

        assert_eq!(out.status.code(), Some(4), "{args:?}: {told}");
        assert!(told.contains("temporarily unavailable"), "{args:?}: {told}");
        assert!(!told.contains("panicked"), "{args:?}: {told}");
    }
}

/// Two recordings to one file would damage each other.
#[test]
fn second_recording_to_one_file_is_refused() {
    let folder = Folder::new("robust-record");
    let path = folder.0.join("r.mcap");
    let record = |run: &mut std::process::Command, path: &Path| {
        run.args(LONG).arg(MINUTE).arg("--record").arg(path);
    };
    let mut first = program();
    record(&mut first, &path);
    let first = first.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    until("the first period", || path.exists());

    let mut second = program();
    record(&mut second, &path);
    let second = second.output().unwrap();
    kill_process(Pid::from_child(&first), Signal::TERM).unwrap();
    let first = first.wait_with_output().unwrap();

    let told = String::from_utf8_lossy(&second.stderr);
    assert_eq!(second.status.code(), Some(2), "{told}");
    assert!(told.contains("another run is writing it"), "{told}");
    let told = String::from_utf8_lossy(&first.stderr);
    assert!(told.contains("nothing lost"), "{told}");
    let whole = program().arg("recover").arg(&path).arg("-o").arg(folder.0.join("w")).output();
    let told = String::from_utf8_lossy(&whole.unwrap().stderr).into_owned();
    assert!(told.contains("the recording was complete"), "{told}");
}
