//! Test of the servo's thread in real time: no allocation, no wait for a lock, and no system call
//! except the sleep and the wake-up of the bridge.
//!
//! The servo's thread has the sinks of a run: the ring to the writer of records, and that to the
//! recorder. A third sink runs on it in each period and reads two counters. The allocator counts
//! the calls of marked threads. A seccomp filter turns each system call that is not on its list
//! into a signal. A positive control for each check runs the same thread with a sink that breaks
//! the rule.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test")]
#![allow(unsafe_code, reason = "an allocator, a signal handler and a system call filter")]

use nalgebra::Point3;
use rubik_robot::emergency_stop::EmergencyStop;
use rubik_robot::hw::driver::{
    Core, RecordSink, ServoLink, ServoRecord, Switches, WallOptions, link, spawn_wall,
};
use rubik_robot::motion::{
    Depth, Direction, Frame, JawCommand, JointPositions, Motion, MotorPositions, MoveCommand,
};
use rubik_robot::record::recorder::{Both, Patience, Recorder};
use rubik_robot::record::sheet::RunInfo;
use rubik_robot::servo::period::Length;
use rubik_robot::servo::{ForceSettings, ServoCommand};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

mod servo_rig;
use servo_rig::{Motors, START, config};

thread_local! {
    /// Whether the calls of the allocator by this thread are counted.
    static MARKED: Cell<bool> = const { Cell::new(false) };
}
/// Number of calls of the allocator by marked threads.
static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);
/// Number of system calls that the filter has stopped.
static CALLS: AtomicU64 = AtomicU64::new(0);
/// Lock that another thread holds half of the time.
static LOCK: Mutex<()> = Mutex::new(());

/// The system's allocator with a count of the calls of marked threads.
struct Counting;

/// Counts a call of the allocator if the calling thread is marked.
fn count() {
    if MARKED.try_with(Cell::get).unwrap_or(false) {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: each call goes to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        count();
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as promised by the caller.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Forbidden action of the sink on the servo's thread, as a positive control.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Violation {
    None,
    Allocates,
    AsksTheSystem,
    WaitsForALock,
}

/// Sink that marks its thread in the first period, and in each period publishes the counts since
/// then.
struct Watch {
    violation: Violation,
    /// Allocations, system calls, records.
    seen: Arc<[AtomicU64; 3]>,
    armed: bool,
}

impl RecordSink for Watch {
    fn record(&mut self, record: &ServoRecord) {
        if !self.armed {
            self.armed = true;
            MARKED.set(true);
            filter_system_calls();
        }
        if record.period.is_multiple_of(10) {
            match self.violation {
                Violation::None => {}
                Violation::Allocates => drop(std::hint::black_box(Box::new(record.period))),
                // SAFETY: the call has no arguments and changes nothing.
                Violation::AsksTheSystem => drop(unsafe { libc::getppid() }),
                Violation::WaitsForALock => drop(LOCK.lock()),
            }
        }
        self.seen[0].store(ALLOCATIONS.load(Ordering::Relaxed), Ordering::Relaxed);
        self.seen[1].store(CALLS.load(Ordering::Relaxed), Ordering::Relaxed);
        self.seen[2].fetch_add(1, Ordering::Relaxed);
    }
}

/// Counts a system call that the filter has stopped: the handler of SIGSYS.
extern "C" fn forbidden(_: libc::c_int) {
    CALLS.fetch_add(1, Ordering::Relaxed);
}

/// Installs a filter on the calling thread: each system call that a period does not need raises
/// SIGSYS. The calls that end a thread stay allowed, because a filter cannot be removed.
fn filter_system_calls() {
    let allowed = [
        libc::SYS_clock_nanosleep,
        libc::SYS_clock_gettime,
        libc::SYS_rt_sigreturn,
        libc::SYS_exit,
        libc::SYS_exit_group,
        libc::SYS_munmap,
        libc::SYS_madvise,
        libc::SYS_sigaltstack,
        libc::SYS_close,
        libc::SYS_rt_sigprocmask,
        libc::SYS_set_robust_list,
        libc::SYS_rseq,
    ];
    let statement =
        |code: u32, jt: u8, jf: u8, k: u32| libc::sock_filter { code: code as u16, jt, jf, k };
    // A futex may wake another thread but never wait for one, as a contended lock does.
    let load = libc::BPF_LD | libc::BPF_W | libc::BPF_ABS;
    let equal = libc::BPF_JMP | libc::BPF_JEQ | libc::BPF_K;
    let end = libc::BPF_RET | libc::BPF_K;
    let mut program = vec![
        statement(load, 0, 0, 0 /* the call's number */),
        statement(equal, 0, 5, libc::SYS_futex as u32),
        statement(load, 0, 0, 24 /* its second argument */),
        statement(libc::BPF_ALU | libc::BPF_AND | libc::BPF_K, 0, 0, 0x7f),
        statement(equal, 0, 1, libc::FUTEX_WAKE as u32),
        statement(end, 0, 0, libc::SECCOMP_RET_ALLOW),
        statement(end, 0, 0, libc::SECCOMP_RET_TRAP),
    ];
    for (i, call) in allowed.iter().enumerate() {
        let to_allow = (allowed.len() - i) as u8;
        program.push(statement(equal, to_allow, 0, *call as u32));
    }
    program.push(statement(end, 0, 0, libc::SECCOMP_RET_TRAP));
    program.push(statement(end, 0, 0, libc::SECCOMP_RET_ALLOW));
    let program =
        libc::sock_fprog { len: program.len() as u16, filter: program.leak().as_mut_ptr() };
    // SAFETY: the program outlives the calls; the handler only increments an atomic counter.
    unsafe {
        let handler = forbidden as extern "C" fn(libc::c_int);
        libc::signal(libc::SIGSYS, handler as libc::sighandler_t);
        assert_eq!(libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), 0);
        let set = libc::prctl(
            libc::PR_SET_SECCOMP,
            libc::SECCOMP_MODE_FILTER,
            std::ptr::from_ref(&program),
        );
        assert_eq!(set, 0, "{}", std::io::Error::last_os_error());
    }
    ALLOCATIONS.store(0, Ordering::Relaxed);
    CALLS.store(0, Ordering::Relaxed);
}

/// Number of the command before which the emergency stop is pressed.
const STOPPED: usize = 11;

/// Returns commands of all kinds that an EDP sends: motions, jaws, a refused motion, settings, and
/// a reset after the stop.
fn commands() -> Vec<ServoCommand> {
    let go = |motion| ServoCommand::Move {
        command: MoveCommand { motion, periods: 35, jaw: None },
        start: 0,
    };
    let mut directions = [Direction::HOLD; 6];
    directions[2] = Direction::Guarded { velocity: 0.005, admittance: 1e-3, inertia: 20.0 };
    let guarded = go(Motion::Task { frame: Frame::Tool, directions });
    let (mut near, mut by) = (START, MotorPositions::default());
    near.0[1] += 0.01;
    by.0[2] = 0.5;
    let at = config().model.base_from_flange(&START) * config().flange_from_tool;
    let jaw = JawCommand { opening: 0.06, force_limit: 20.0, stops: Depth::Two };
    let closing = MoveCommand { motion: Motion::Hold, periods: 35, jaw: Some(jaw) };
    vec![
        guarded,
        guarded,
        go(Motion::Joints(near)),
        go(Motion::Pose(at)),
        go(Motion::MotorsBy(by)),
        ServoCommand::SetTool(config().flange_from_tool),
        ServoCommand::ForceSettings(ForceSettings::default()),
        ServoCommand::Move { command: closing, start: 0 },
        ServoCommand::Bias,
        go(Motion::Joints(JointPositions([f64::NAN; 7]))),
        guarded,
        guarded,
        ServoCommand::Reset,
        ServoCommand::Payload { weight: 5.0, centre: Point3::origin() },
        ServoCommand::Synchronise,
        guarded,
    ]
}

/// Describes the recorded run: the built-in cell, without options.
fn about() -> RunInfo {
    let scenario =
        rubik_robot::tasks::read(Path::new("realtime.toml"), "task = \"idle\"\n", &[]).unwrap();
    RunInfo {
        cell: scenario.controller.cell,
        scenario: String::new(),
        options: Vec::new(),
        facts: BTreeMap::new(),
        objects: Vec::new(),
        start: 0,
        length: Length::default(),
    }
}

/// Runs the servo's real-time thread with all commands, while its last sink commits `violation`.
/// Returns the numbers of allocations, forbidden system calls and records.
fn run(violation: Violation) -> [u64; 3] {
    let seen: Arc<[AtomicU64; 3]> = Arc::default();
    let watch = Watch { violation, seen: Arc::clone(&seen), armed: false };
    let stop = EmergencyStop::default();
    let (button, switches) = (stop.button(), Arc::new(Switches::new(stop.signal())));
    let (mut links, ends): (Vec<ServoLink>, Vec<_>) = (0..2).map(|_| link()).unzip();
    let (ring, _records) = rtrb::RingBuffer::new(512 * links.len());
    let recorder = Recorder::begin(Cursor::new(Vec::new()), about(), Patience::Never).unwrap();
    let ticks = recorder.ticks().unwrap();
    let mut port = Motors::new(2);
    let core = Core::new(
        vec![config(), config()],
        ends,
        Arc::clone(&switches),
        Box::new(Both(Box::new(Both(Box::new(ring), Box::new(ticks))), Box::new(watch))),
        &mut port,
    )
    .unwrap();
    let options = WallOptions { missed_limit: u64::MAX, ..WallOptions::default() };
    let wall = spawn_wall(core, port, |_, _| {}, options).unwrap();

    let holds = Arc::new(AtomicBool::new(violation == Violation::WaitsForALock));
    let on = Arc::clone(&holds);
    let holder = std::thread::spawn(move || {
        while on.load(Ordering::Acquire) {
            let held = LOCK.lock();
            std::thread::sleep(Duration::from_millis(5));
            drop(held);
            std::thread::sleep(Duration::from_millis(5));
        }
    });
    for (step, command) in commands().into_iter().enumerate() {
        // The stop interrupts a motion; later commands reset both arms and move them again.
        if step == STOPPED {
            button.press();
        } else {
            stop.release();
        }
        for link in &mut links {
            link.send(command).unwrap();
        }
        switches.beats.fetch_add(1, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(80));
    }
    holds.store(false, Ordering::Release);
    holder.join().unwrap();
    let state = *links[1].state();
    assert!(state.fault.is_none(), "{:?}", state.fault);
    assert_ne!(state.desired_joints, START, "the arm has moved");
    let _ = wall.stop();
    seen.each_ref().map(|n| n.load(Ordering::Relaxed))
}

/// This file has a single test because its counters belong to the process.
#[test]
fn servo_period_needs_no_allocation_lock_or_syscall() {
    let [allocations, calls, records] = run(Violation::None);
    // All commands take 1.4 s, which are 680 records of each arm on an idle machine.
    assert!(records > 300, "{records} records");
    assert_eq!(allocations, 0);
    assert_eq!(calls, 0);

    // The violations happen in every tenth period. A busy machine misses many of them.
    let [allocations, calls, _] = run(Violation::Allocates);
    assert!(allocations >= 4, "the allocator counts: {allocations}");
    assert_eq!(calls, 0);

    let [allocations, calls, _] = run(Violation::AsksTheSystem);
    assert_eq!(allocations, 0);
    assert!(calls >= 20, "the filter counts: {calls}");

    let [allocations, calls, _] = run(Violation::WaitsForALock);
    assert_eq!(allocations, 0);
    assert!(calls >= 2, "a wait for a lock counts: {calls}");
}
