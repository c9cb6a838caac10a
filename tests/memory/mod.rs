//! The system's allocator with a count of bytes, with which the tests of hostile input limit a
//! reader's memory.
#![allow(unreachable_pub, reason = "a module of test programs")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The system's allocator, which counts for each thread the bytes that it holds and their maximum.
struct Counting;

// The counts are per thread, because other tests and the harness allocate and free at any moment.
// They are signed, because a thread may free the memory of another.
thread_local! {
    /// Bytes that the thread has allocated and not freed.
    static HELD: Cell<isize> = const { Cell::new(0) };
    /// Maximum of [`HELD`] since [`most_held`] began.
    static MOST: Cell<isize> = const { Cell::new(0) };
}

/// Adds bytes that the thread has allocated.
fn count_allocated(bytes: usize) {
    HELD.set(HELD.get() + bytes.cast_signed());
    MOST.set(MOST.get().max(HELD.get()));
}

/// Subtracts bytes that the thread has freed.
fn count_freed(bytes: usize) {
    HELD.set(HELD.get() - bytes.cast_signed());
}

#[allow(unsafe_code, reason = "an allocator needs unsafe code; this one forwards each call")]
// SAFETY: every call is passed to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count_allocated(layout.size());
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count_allocated(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        count_freed(layout.size());
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count_allocated(size);
        count_freed(layout.size());
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// Lock of the thread that tests an input.
static ALONE: Mutex<()> = Mutex::new(());

/// Waits until no other thread tests an input, and keeps others waiting until the guard is dropped.
/// One input at a time has exact times, and the one that hangs is known.
pub fn lock_process() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls `read` and returns the most bytes that it has held allocated at a time, beyond those that
/// its thread held before. Allocations of threads that `read` starts are not counted.
pub fn most_held(read: impl FnOnce()) -> usize {
    let before = HELD.get();
    MOST.set(before);
    read();
    (MOST.get() - before).cast_unsigned()
}

#[test]
fn most_held_returns_peak_of_allocated_bytes() {
    let bytes = 1 << 20;
    let one = || drop(std::hint::black_box(vec![1_u8; bytes]));
    assert_eq!(most_held(one), bytes);
    let one_after_the_other = || {
        one();
        one();
    };
    assert_eq!(most_held(one_after_the_other), bytes, "freed memory is not counted");
    assert_eq!(most_held(|| ()), 0);
    // Zeroed memory counts as well. Memory that grows may need its old and its new place at a time.
    let zeroed = || drop(std::hint::black_box(vec![0_u8; bytes]));
    assert_eq!(most_held(zeroed), bytes);
    let grown = || {
        let mut grown = vec![1_u8; bytes];
        std::hint::black_box(&mut grown).reserve_exact(bytes);
        drop(grown);
        one();
    };
    assert_eq!(most_held(grown), 3 * bytes);
    assert_eq!(most_held(one), bytes, "all memory was freed");
}
