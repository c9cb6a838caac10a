//! The system calls of a punctual thread: its real-time rights, and a clock with absolute sleep.
//!
//! The unsafe code here is plain calls of libc that the standard library does not offer.
#![allow(unsafe_code, reason = "only libc offers real-time scheduling and absolute sleep")]

use rustix::process::{Resource, getrlimit};
use std::fs::File;
use std::io::Write;

/// Real-time rights of a thread, with a warning for each one that the system denied.
#[derive(Debug)]
pub struct RealTime {
    /// Rights that were denied, one message each; empty if all were granted.
    pub warnings: Vec<String>,
    /// `/dev/cpu_dma_latency`. While it is open the processor does not sleep deeply, which cuts the
    /// 99th percentile of the wake-up latency from 103-174 us to 26-51 us.
    _awake: Option<File>,
}

impl RealTime {
    /// Asks for a FIFO priority of the calling thread, for memory that is not paged out, for a
    /// processor that wakes up fast, and for one fixed `core` if it is given. The fast wake-up ends
    /// when the value is dropped; the other rights stay.
    #[must_use]
    pub fn acquire(priority: i32, core: Option<usize>) -> Self {
        let mut warnings = Vec::new();
        if let Some(core) = core {
            pin(core).unwrap_or_else(|error| {
                warnings.push(format!("the thread is not kept on core {core}: {error}"));
            });
        }
        let scheduling = libc::sched_param { sched_priority: priority };
        // SAFETY: thread 0 is the caller; the parameter outlives the call.
        if unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const scheduling) } != 0 {
            warnings.push(denied(&format!("no real-time priority {priority} (SCHED_FIFO)")));
            // Second best: by default Linux lets an ordinary thread's timer fire 50 us late, to
            // save power.
            // SAFETY: no memory of ours is passed.
            unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
        }
        warnings.extend(lock_memory(Lockable::now()));
        // 0 us is the latency that the processor's sleep states may add. The request lasts as long
        // as the file is open.
        let awake = File::options()
            .write(true)
            .open("/dev/cpu_dma_latency")
            .and_then(|mut file| file.write_all(&0i32.to_ne_bytes()).map(|()| file));
        if let Err(error) = &awake {
            warnings.push(format!(
                "the processor may enter deep sleep states (/dev/cpu_dma_latency): {error}"
            ));
        }
        Self { warnings, _awake: awake.ok() }
    }
}

/// Amount of memory that this process may lock, so that it is not paged out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Lockable {
    /// Any amount.
    All,
    /// At most this amount (bytes).
    Limited(u64),
}

impl Lockable {
    /// Returns how much memory the calling thread may lock now.
    fn now() -> Self {
        let status = std::fs::read_to_string("/proc/thread-self/status").unwrap_or_default();
        Self::of(getrlimit(Resource::Memlock).current, &status)
    }

    /// Returns how much memory the thread may lock, from the resource limit (bytes, `None`:
    /// unlimited) and from the thread's capabilities in `status`, the text of
    /// `/proc/thread-self/status`.
    fn of(limit: Option<u64>, status: &str) -> Self {
        /// Number of the capability that lifts the limit, see capabilities(7).
        const CAP_IPC_LOCK: u32 = 14;
        let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
        let capabilities = effective.and_then(|bits| u64::from_str_radix(bits.trim(), 16).ok());
        match limit {
            Some(bytes) if capabilities.unwrap_or(0) >> CAP_IPC_LOCK & 1 == 0 => {
                Self::Limited(bytes)
            }
            _ => Self::All,
        }
    }
}

/// Locks the memory of this process, so that it is not paged out; returns a warning if that is
/// denied or limited.
///
/// Under a limit only the present memory is locked. If later memory were locked as well, an
/// allocation beyond the limit would fail, which ends the program.
fn lock_memory(lockable: Lockable) -> Option<String> {
    let flags = match lockable {
        Lockable::All => libc::MCL_CURRENT | libc::MCL_FUTURE,
        Lockable::Limited(_) => libc::MCL_CURRENT,
    };
    // SAFETY: no memory of ours is passed.
    if unsafe { libc::mlockall(flags) } != 0 {
        return Some(denied("memory can be paged out (mlockall)"));
    }
    match lockable {
        Lockable::All => None,
        Lockable::Limited(bytes) => Some(format!(
            "memory allocated from now on can be paged out (mlockall: RLIMIT_MEMLOCK is {} KiB, \
             not unlimited)",
            bytes / 1024
        )),
    }
}

/// Lowers the priority of the calling thread, and of the threads that it starts later, below
/// ordinary ones. The bytes of serial lines pass through ordinary threads of the kernel, which
/// vision and planning must not delay.
pub fn step_back() {
    const NICE: i32 = 10;
    // SAFETY: no memory of ours is passed; process 0 is the calling thread. A failure leaves the
    // priority as it is.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) };
}

/// Keeps the calling thread on one core.
fn pin(core: usize) -> std::io::Result<()> {
    // `CPU_SET` indexes the set without a check of its own.
    if core >= libc::CPU_SETSIZE as usize {
        return Err(std::io::ErrorKind::InvalidInput.into());
    }
    // SAFETY: all zeros are an empty set, the core was checked, and the set outlives the call.
    let kept = unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::CPU_SET(core, &mut set);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set)
    };
    if kept == 0 { Ok(()) } else { Err(std::io::Error::last_os_error()) }
}

/// Returns the cores that a thread of this process can be kept on, in ascending order. Cores that
/// are switched off or belong to other control groups are not among them.
fn usable_cores() -> Vec<usize> {
    // Each try changes the affinity of the thread that makes it. A thread of its own makes the
    // tries, and ends at once.
    let tried = std::thread::Builder::new()
        .spawn(|| (0..libc::CPU_SETSIZE as usize).filter(|core| pin(*core).is_ok()).collect());
    tried.ok().and_then(|thread| thread.join().ok()).unwrap_or_default()
}

/// Returns the cores on which the calling thread may run now, in ascending order.
#[must_use]
pub fn own_cores() -> Vec<usize> {
    // SAFETY: all zeros are an empty set, which outlives the call; `CPU_ISSET` is asked for cores
    // within the set.
    unsafe {
        let mut set: libc::cpu_set_t = std::mem::zeroed();
        libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut set);
        (0..libc::CPU_SETSIZE as usize).filter(|core| libc::CPU_ISSET(*core, &set)).collect()
    }
}

/// Returns the reason why no thread can be kept on `core`, with the cores that can be used; `None`
/// if it can.
#[must_use]
pub fn missing_core(core: usize) -> Option<String> {
    let cores = usable_cores();
    (!cores.contains(&core))
        .then(|| format!("core {core} is not there: this process may use {}", in_words(&cores)))
}

/// Returns ascending numbers of cores in words: "core 0", "cores 0 to 3, 8".
fn in_words(cores: &[usize]) -> String {
    let runs: Vec<String> = cores
        .chunk_by(|a, b| a + 1 == *b)
        .map(|run| match run {
            [first, .., last] => format!("{first} to {last}"),
            [one] => one.to_string(),
            [] => String::new(),
        })
        .collect();
    let noun = if cores.len() == 1 { "core" } else { "cores" };
    format!("{noun} {}", runs.join(", "))
}

/// Returns a warning with the error of the last system call as its reason.
fn denied(what: &str) -> String {
    format!("{what}: {}", std::io::Error::last_os_error())
}

/// The monotonic clock, whose times are absolute nanoseconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Clock;

impl Clock {
    /// Returns the time (ns).
    #[must_use]
    pub fn now(self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: the clock exists on every Linux and the time is ours.
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Returns the time of the clock that also counts while the computer is suspended (ns).
    #[must_use]
    pub fn boot_time(self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: as above.
        unsafe { libc::clock_gettime(libc::CLOCK_BOOTTIME, &raw mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Returns the resolution of the clock (ns).
    #[must_use]
    pub fn resolution(self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: as above.
        unsafe { libc::clock_getres(libc::CLOCK_MONOTONIC, &raw mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Sleeps until the clock shows `nanos` (ns).
    pub fn sleep_until(self, nanos: u64) {
        let time = libc::timespec {
            tv_sec: (nanos / 1_000_000_000) as libc::time_t,
            tv_nsec: (nanos % 1_000_000_000) as libc::c_long,
        };
        loop {
            // SAFETY: the time outlives the call; no remainder is asked for.
            let interrupted = unsafe {
                libc::clock_nanosleep(
                    libc::CLOCK_MONOTONIC,
                    libc::TIMER_ABSTIME,
                    &raw const time,
                    std::ptr::null_mut(),
                )
            };
            // A signal ends the sleep early. The goal is absolute, so a second sleep adds no drift.
            if interrupted != libc::EINTR {
                return;
            }
        }
    }

    /// Sleeps until `spin` (ns) before the clock shows `nanos` (ns) and spins for the rest. The
    /// kernel wakes a thread tens of microseconds late; a spinning thread is less than one late.
    pub fn wait_until(self, nanos: u64, spin: u64) {
        self.sleep_until(nanos.saturating_sub(spin));
        while self.now() < nanos {
            std::hint::spin_loop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_lock_limit_applies_without_ipc_lock_capability() {
        const NONE: &str = "Name:\tx\nCapEff:\t0000000000000000\n";
        // CAP_IPC_LOCK is bit 14 of the effective capabilities.
        const IPC_LOCK: &str = "CapEff:\t0000000000004000\n";
        let limit = 8 << 20;

        assert_eq!(Lockable::of(Some(limit), NONE), Lockable::Limited(limit));
        assert_eq!(Lockable::of(Some(limit), ""), Lockable::Limited(limit));
        assert_eq!(Lockable::of(Some(limit), IPC_LOCK), Lockable::All);
        assert_eq!(Lockable::of(None, NONE), Lockable::All);
    }

    #[test]
    fn missing_core_message_lists_usable_cores() {
        let cores = usable_cores();

        assert!(own_cores().iter().all(|core| cores.contains(core)));
        assert!(cores.iter().all(|core| missing_core(*core).is_none()));
        let why = missing_core(1023).unwrap();
        assert!(why.starts_with("core 1023 is not there: this process may use core"), "{why}");
        assert_eq!(in_words(&[0]), "core 0");
        assert_eq!(in_words(&[0, 1, 2, 5, 8, 9]), "cores 0 to 2, 5, 8 to 9");
    }

    #[test]
    fn wait_ends_at_or_after_its_time() {
        let clock = Clock;
        let goal = clock.now() + 3_000_000;

        clock.wait_until(goal, 100_000);

        let late = clock.now().checked_sub(goal).unwrap();
        assert!(late < 1_000_000_000, "{late} ns late");
        clock.sleep_until(goal - 1_000_000_000);
    }
}
