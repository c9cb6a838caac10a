//! What a pruning table is, apart from where its bytes lie: its name, its size, how it is made and checked.
//!
//! - in: [`Workers`] that run its making side by side, a listener for its progress
//! - out: bytes; whoever keeps them (memory, a mapped file) hands them back to the search as a slice

/// Runs tasks side by side. The shells have one with threads; here nobody starts a thread.
pub trait Workers: Sync {
    /// How many tasks run at once.
    fn count(&self) -> usize;
    /// Runs `task(0)`, ..., `task(tasks - 1)`, in any order, and returns when all are done.
    fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync));
}

/// One after the other, on the thread that asks.
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

/// Share of the work that is done, 0..=1.
pub type Progress<'a> = &'a (dyn Fn(f64) + Sync);

/// Counts the entries at each distance; what is wrong otherwise.
pub type Verify = fn(&[u8], &dyn Workers) -> Result<Vec<u64>, String>;

/// A table that can be made, kept and checked.
#[derive(Debug, Clone, Copy)]
pub struct TableSpec {
    /// Name on the command line and of its file, lower case with hyphens.
    pub name: &'static str,
    /// Counts up whenever the same name stands for other bytes.
    pub version: u32,
    /// Size of the table.
    pub bytes: usize,
    /// What it is for, a line for people.
    pub purpose: &'static str,
    /// Makes all of its bytes, in native byte order.
    pub build: fn(&dyn Workers, Progress<'_>) -> Vec<u8>,
    /// Counts the entries at each distance and compares them with the known counts.
    pub verify: Verify,
}

/// Asks for a place of a table that will soon be read.
#[inline]
pub(super) fn prefetch<T>(table: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: the instruction reads nothing that a program could see, wherever it points.
        #[allow(unsafe_code, reason = "there is no safe form")]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(table.as_ptr().wrapping_add(at).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (table, at);
}
