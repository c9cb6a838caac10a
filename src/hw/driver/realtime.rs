//! What the operating system can do for a punctual thread. The only unsafe code of the project: plain calls
//! of libc that the standard library does not have.
#![allow(unsafe_code, reason = "scheduling and absolute sleep exist in libc only")]

use std::fs::File;
use std::io::Write;

/// Real-time rights of a thread; each is asked for and, if it is denied, said so.
#[derive(Debug)]
pub struct RealTime {
    /// What was denied, one fact each; empty when all was granted.
    pub warnings: Vec<String>,
    /// Open for as long as the processor shall not sleep deeply: worth a factor of five in wake-up latency.
    _awake: Option<File>,
}

impl RealTime {
    /// Asks for a FIFO priority of the calling thread, for memory that is not paged out, for a processor that
    /// wakes up fast, and to stay on one `core` if it is given. The wake-up lasts until this is dropped.
    #[must_use]
    pub fn acquire(priority: i32, core: Option<usize>) -> Self {
        let mut warnings = Vec::new();
        if let Some(core) = core {
            pin(core).unwrap_or_else(|error| warnings.push(format!("not on core {core}: {error}")));
        }
        let scheduling = libc::sched_param { sched_priority: priority };
        // SAFETY: thread 0 is the caller; the parameter outlives the call.
        if unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const scheduling) } != 0 {
            warnings.push(denied(&format!("no real-time priority {priority} (SCHED_FIFO)")));
            // Second best: an ordinary thread's timers may else fire 50 us late to save power.
            // SAFETY: no memory of ours is passed.
            unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, 1) };
        }
        // SAFETY: no memory of ours is passed.
        if unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) } != 0 {
            warnings.push(denied("memory can be paged out (mlockall)"));
        }
        let awake = File::options()
            .write(true)
            .open("/dev/cpu_dma_latency")
            .and_then(|mut file| file.write_all(&0i32.to_ne_bytes()).map(|()| file));
        if let Err(error) = &awake {
            warnings
                .push(format!("the processor may sleep deeply (/dev/cpu_dma_latency): {error}"));
        }
        Self { warnings, _awake: awake.ok() }
    }
}

/// The calling thread, and those that it starts, step back behind ordinary ones: bytes of serial lines pass through
/// ordinary threads of the kernel, which pictures and plans must not hold up.
pub fn step_back() {
    const NICE: i32 = 10;
    // SAFETY: no memory of ours is passed; process 0 is the calling thread. Failing is no worse than before.
    unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICE) };
}

/// Keeps the calling thread on one core.
fn pin(core: usize) -> std::io::Result<()> {
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

fn denied(what: &str) -> String {
    format!("{what}: {}", std::io::Error::last_os_error())
}

/// The monotonic clock, by its absolute nanoseconds.
#[derive(Debug, Clone, Copy, Default)]
pub struct Clock;

impl Clock {
    /// Now [ns].
    #[must_use]
    pub fn now(self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: the clock exists on every Linux and the time is ours.
        unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// What it resolves [ns].
    #[must_use]
    pub fn resolution(self) -> u64 {
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: as above.
        unsafe { libc::clock_getres(libc::CLOCK_MONOTONIC, &raw mut time) };
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Sleeps until `nanos` of this clock.
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
            if interrupted != libc::EINTR {
                return;
            }
        }
    }

    /// Sleeps until `spin` nanoseconds before `nanos` and spins the rest: the wake-up of the kernel is late
    /// by tens of microseconds, a spinning thread by less than one.
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
    fn waiting_ends_not_before_the_time() {
        let clock = Clock;
        let goal = clock.now() + 3_000_000;

        clock.wait_until(goal, 100_000);

        assert!(clock.now() >= goal);
        clock.sleep_until(goal - 1_000_000_000);
    }
}
