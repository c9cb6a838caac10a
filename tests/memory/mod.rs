//! What the tests of hostile input share: the system's allocator with a count, so that a reader's memory is known.
#![allow(unreachable_pub, reason = "a module of test programs")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The system's allocator with a count, for each thread, of what it holds and of the most that it held.
struct Counting;

// By thread, because other tests and their harness take and give back at any moment. Signed, because a thread may give
// back what another took.
thread_local! {
    static HELD: Cell<isize> = const { Cell::new(0) };
    static MOST: Cell<isize> = const { Cell::new(0) };
}

fn took(bytes: usize) {
    HELD.set(HELD.get() + bytes.cast_signed());
    MOST.set(MOST.get().max(HELD.get()));
}

fn gave(bytes: usize) {
    HELD.set(HELD.get() - bytes.cast_signed());
}

#[allow(unsafe_code, reason = "an allocator cannot be written without; it hands everything on")]
// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        took(layout.size());
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        took(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        gave(layout.size());
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        took(size);
        gave(layout.size());
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

static ALONE: Mutex<()> = Mutex::new(());

/// One input at a time in the process: its time is its own, and what hangs can be named.
pub fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The most bytes that a reader held beside what its thread held before; a reader with threads of its own would have to
/// add up theirs.
pub fn most_held(read: impl FnOnce()) -> usize {
    let before = HELD.get();
    MOST.set(before);
    read();
    (MOST.get() - before).cast_unsigned()
}

#[test]
fn memory_that_is_held_and_given_back_is_counted() {
    let bytes = 1 << 20;
    let one = || drop(std::hint::black_box(vec![1_u8; bytes]));
    assert_eq!(most_held(one), bytes);
    let one_after_the_other = || {
        one();
        one();
    };
    assert_eq!(most_held(one_after_the_other), bytes, "what is given back is not held");
    assert_eq!(most_held(|| ()), 0);
}
