//! The description of a pruning table: its name and size, and the functions that build and check
//! it.
//!
//! The place of the bytes is not part of it: a caller keeps them in memory or in a mapped file and
//! passes them to the search as a slice.
//!
//! - in: [`Workers`] that build the parts of a table in parallel, a listener for the progress
//! - out: bytes

/// A runner of parallel tasks. This crate starts no threads; its users implement this trait.
///
/// ```
/// use rubik_robot_solver::Tables;
/// use rubik_robot_solver::table::Workers;
/// use std::sync::atomic::{AtomicUsize, Ordering};
///
/// /// Two threads that take the tasks in turn.
/// struct TwoThreads;
///
/// impl Workers for TwoThreads {
///     fn count(&self) -> usize {
///         2
///     }
///
///     fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync)) {
///         let next = AtomicUsize::new(0);
///         let work = || loop {
///             let number = next.fetch_add(1, Ordering::Relaxed);
///             if number >= tasks {
///                 break;
///             }
///             task(number);
///         };
///         std::thread::scope(|scope| {
///             scope.spawn(work);
///             work();
///         });
///     }
/// }
///
/// // Phase 1 and phase 2 together take less than 64 MiB.
/// assert!(Tables::build_with(&TwoThreads).size() < 64 << 20);
/// ```
pub trait Workers: Sync {
    /// Returns the number of tasks that run at once.
    fn count(&self) -> usize;
    /// Runs `task(0)`, ..., `task(tasks - 1)`, in any order, and returns when all are done.
    fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync));
}

/// Workers that run all tasks one after the other, on the thread of the caller.
#[derive(Debug, Clone, Copy, Default)]
pub struct InTurn;

impl Workers for InTurn {
    fn count(&self) -> usize {
        1
    }

    fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync)) {
        (0..tasks).for_each(task);
    }
}

/// Listener that gets the share of the work that is done, 0..=1.
pub type Progress<'a> = &'a (dyn Fn(f64) + Sync);

/// Check of a table: returns the number of entries at each distance, or a message that says which
/// numbers are wrong.
pub type Verify = fn(&[u8], &dyn Workers) -> Result<Vec<u64>, String>;

/// Description of a table.
#[derive(Debug, Clone, Copy)]
pub struct TableSpec {
    /// Name on the command line and of its file, lower case with hyphens.
    pub name: &'static str,
    /// Version of the bytes; it rises with each change of the contents under the same name.
    pub version: u32,
    /// Size of the table (bytes).
    pub bytes: usize,
    /// Purpose, one line for the user.
    pub purpose: &'static str,
    /// Function that builds the whole table, in native byte order.
    pub build: fn(&dyn Workers, Progress<'_>) -> Vec<u8>,
    /// Function that counts the entries at each distance and compares them with the known counts.
    pub verify: Verify,
}

/// Prefetches the cache line of `table[at]`, which the search reads soon.
#[inline]
pub(super) fn prefetch<T>(table: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch has no effect that a program could see, wherever the address points.
        #[allow(unsafe_code, reason = "the prefetch instruction is unsafe to call")]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(table.as_ptr().wrapping_add(at).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (table, at);
}
