//! Threads as the [`Workers`] that build and check tables.

use crate::solver::table::Workers;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Workers that run the tasks of each call on this number of threads, with the calling one.
#[derive(Debug, Clone, Copy)]
pub struct Threads(usize);

impl Threads {
    /// Makes workers of `count` threads, at least one.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self(count.max(1))
    }

    /// Makes workers with one thread for each core that this process may use.
    #[must_use]
    pub fn all() -> Self {
        Self::new(cores())
    }
}

/// Returns the number of cores that this process may use, at least one.
///
/// CPU affinity and the limits of a control group count. So does the share of a job under SLURM
/// (`SLURM_CPUS_PER_TASK`), which neither of them need enforce.
#[must_use]
pub fn cores() -> usize {
    let share = std::env::var("SLURM_CPUS_PER_TASK").ok();
    shared(std::thread::available_parallelism().map_or(1, usize::from), share.as_deref())
}

/// Returns the smaller one of the number of available cores and a job's share of them. A share that
/// is no integer above 0 is ignored.
fn shared(available: usize, share: Option<&str>) -> usize {
    let share = share.and_then(|text| text.trim().parse().ok()).filter(|&n: &usize| n > 0);
    share.map_or(available, |share| share.min(available))
}

impl Workers for Threads {
    fn count(&self) -> usize {
        self.0
    }

    fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        // Tasks differ in length, so each thread takes the next task when it is free.
        let work = || {
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= tasks {
                    return;
                }
                task(number);
            }
        };
        // The thread of the caller works as well.
        std::thread::scope(|scope| {
            for _ in 1..self.0.min(tasks) {
                // If no more threads can be started, those that run do the work.
                if std::thread::Builder::new().spawn_scoped(scope, work).is_err() {
                    break;
                }
            }
            work();
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[test]
    fn share_of_slurm_job_limits_cores() {
        for (share, wanted) in
            [(None, 8), (Some("3"), 3), (Some("16"), 8), (Some("0"), 8), (Some("a few"), 8)]
        {
            assert_eq!(shared(8, share), wanted, "{share:?}");
        }
    }

    #[test]
    fn threads_run_each_task_once() {
        for count in [1, 2, 7] {
            let done = Mutex::new(Vec::new());

            Threads::new(count).run(50, &|task| done.lock().unwrap().push(task));

            let mut done = done.into_inner().unwrap();
            done.sort_unstable();
            assert_eq!(done, (0..50).collect::<Vec<_>>());
        }
    }
}
