//! [`Workers`] that are threads.

use crate::solver::table::Workers;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Workers that start this number of threads for each call.
#[derive(Debug, Clone, Copy)]
pub struct Threads(usize);

impl Threads {
    /// Makes workers of `count` threads, at least one.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self(count.max(1))
    }

    /// Makes workers of as many threads as the machine runs at once.
    #[must_use]
    pub fn all() -> Self {
        Self::new(std::thread::available_parallelism().map_or(1, usize::from))
    }
}

impl Workers for Threads {
    fn count(&self) -> usize {
        self.0
    }

    fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        // Each thread takes the next task when it is free: tasks differ in length.
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
                // At the limit of threads the others do the work.
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
