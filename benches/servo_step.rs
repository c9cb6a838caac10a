//! Time and allocations of a servo period of both arms, with warm and with swept caches, and the
//! times of its parts beside the inverse kinematics of a public library.
//!
//! A period is [`Core::compute`], the function that both drivers call. It reads flags and commands,
//! controls both arms in position and force, and writes states to triple buffers and records to a
//! ring.

use criterion::{BatchSize, Criterion};
use nalgebra::{Translation3, UnitQuaternion};
use rs_opw_kinematics::kinematic_traits::Kinematics;
use rs_opw_kinematics::kinematics_impl::OPWKinematics;
use rs_opw_kinematics::parameters::opw_kinematics::Parameters;
use rubik_robot::hw::driver::{Core, ServoLink, ServoRecord, Switches, link};
use rubik_robot::hw::port::Port;
use rubik_robot::motion::{Frame, JointPositions};
use rubik_robot::servo::regulator::Regulator;
use rubik_robot::servo::tff::{ForceLaw, TaskMotion};
use rubik_robot::spatial::{Pose, Wrench};
use std::alloc::{GlobalAlloc, Layout, System};
use std::hint::black_box;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

mod rig;
use rig::{COMPLIANT, START, Still};

/// Number of allocations of this program so far.
static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

/// The system's allocator with a counter of allocations.
struct Counting;

#[allow(unsafe_code, reason = "an allocator")]
// SAFETY: all calls are passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps the contract, which is the same.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract, which is the same.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Measures and prints times and allocations of a servo period, and the times of its parts.
fn main() {
    if !["servo_step", "servo_period", "servo_parts"].iter().any(|name| rig::is_selected(name)) {
        return;
    }
    let warm = Measured::measure(50_000, || {});
    // In a run other programs use the caches between two periods: the sweep imitates them.
    let mut sweep = vec![0u8; 16 << 20];
    let cold = Measured::measure(500, || {
        for line in sweep.iter_mut().step_by(64) {
            *line = line.wrapping_add(1);
        }
        black_box(&sweep);
    });
    if rig::json() {
        let fields = [
            ("warm_p50_us", Some(rig::us(&warm.times, 0.5))),
            ("warm_p999_us", Some(rig::us(&warm.times, 0.999))),
            ("cold_p50_us", Some(rig::us(&cold.times, 0.5))),
            ("cold_p99_us", Some(rig::us(&cold.times, 0.99))),
            ("allocations", Some((warm.allocations + cold.allocations) as f64)),
        ];
        println!("{}", rig::object(&fields));
        return;
    }
    println!("servo_step: a period of both arms in position-force control, us");
    for (name, measured) in [("warm", &warm), ("caches swept (16 MB)", &cold)] {
        println!(
            "  {name:22} p50 {:6.2}  p99 {:6.2}  p99.9 {:6.2}  {} allocations in {} periods",
            rig::us(&measured.times, 0.5),
            rig::us(&measured.times, 0.99),
            rig::us(&measured.times, 0.999),
            measured.allocations,
            measured.times.len(),
        );
    }
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(800))
        .configure_from_args();
    parts(&mut criterion);
    criterion.final_summary();
}

/// Times of single periods (ns), and the number of allocations in all of them.
struct Measured {
    times: hdrhistogram::Histogram<u64>,
    allocations: u64,
}

impl Measured {
    /// Measures the time and the allocations of `periods` servo periods, after 200 unmeasured ones.
    /// Calls `between` before each period; its time does not count.
    fn measure(periods: u64, mut between: impl FnMut()) -> Self {
        let mut pair = Pair::new();
        let mut times = rig::histogram();
        let mut allocations = 0;
        for _ in 0..200 {
            pair.step();
        }
        for _ in 0..periods {
            between();
            let before = ALLOCATIONS.load(Ordering::Relaxed);
            times.saturating_record(pair.step());
            allocations += ALLOCATIONS.load(Ordering::Relaxed) - before;
        }
        Self { times, allocations }
    }
}

/// Both arms in position-force control without an end, on motors that do not move.
struct Pair {
    core: Core,
    links: Vec<ServoLink>,
    records: rtrb::Consumer<ServoRecord>,
    port: Still,
    period: u64,
}

impl Pair {
    /// Makes both servos and sends each its position-force command.
    fn new() -> Self {
        let (mut links, ends): (Vec<_>, Vec<_>) = (0..2).map(|_| link()).unzip();
        let (sink, records) = rtrb::RingBuffer::<ServoRecord>::new(64);
        let mut port = Still::new();
        let switches = Arc::new(Switches::default());
        let core = Core::new(rig::configs(), ends, switches, Box::new(sink), &mut port)
            .unwrap_or_else(|e| unreachable!("this port never fails: {e}"));
        for link in &mut links {
            let _ = link.send(rig::yielding());
        }
        Self { core, links, records, port, period: 0 }
    }

    /// Runs one servo period of both arms and returns the time that the servo computed (ns).
    fn step(&mut self) -> u64 {
        self.period += 1;
        let begun = Instant::now();
        let drives = black_box(self.core.compute(self.period));
        let took = begun.elapsed().as_nanos() as u64;
        let drives = [drives[0], drives[1]];
        let _ = self.port.exchange(self.period, &drives, self.core.readings_mut());
        while self.records.pop().is_ok() {}
        for link in &mut self.links {
            let state = link.state();
            let stopped = state.refused.is_some() || state.fault.is_some();
            assert!(!stopped, "the measured arm stopped: {:?} {:?}", state.refused, state.fault);
        }
        took
    }
}

/// Measures the computations of a servo period one by one: kinematics, force law, regulators.
fn parts(c: &mut Criterion) {
    let model = rig::model("irp6_track");
    let mut group = c.benchmark_group("servo_parts");
    let flange = model.base_from_flange(&START);
    let mut near = START;
    near.0[1] += 0.001;
    group.bench_function("forward", |b| b.iter(|| model.base_from_flange(black_box(&START))));
    group.bench_function("jacobian", |b| {
        b.iter(|| model.jacobian(black_box(&START), &Pose::identity()));
    });
    group.bench_function("inverse", |b| {
        b.iter(|| model.inverse(black_box(&flange), black_box(&near)));
    });
    // Parameters of a robot with a spherical wrist and the size of an IRp-6, for comparison.
    let robot = OPWKinematics::new(Parameters {
        a1: 0.0,
        a2: 0.0,
        b: 0.0,
        c1: 0.95,
        c2: 0.455,
        c3: 0.67,
        c4: 0.19,
        ..Parameters::default()
    });
    let joints = [0.1, 0.3, 0.2, 0.4, 0.9, -0.4];
    let pose = robot.forward(&joints);
    group.bench_function("inverse of rs-opw-kinematics, nearest first", |b| {
        b.iter(|| robot.inverse_continuing(black_box(&pose), black_box(&joints)));
    });
    let wrench = Wrench::from_directions([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]);
    let pose = Pose::from_parts(
        Translation3::new(0.6, 0.1, 1.2),
        UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
    );
    let task = TaskMotion { frame: Frame::Tool, directions: [COMPLIANT; 6] };
    group.bench_function("tff", |b| {
        b.iter_batched_ref(
            ForceLaw::default,
            |law| law.step(1, black_box(&task), &wrench, &pose),
            BatchSize::SmallInput,
        );
    });
    let gains = &rig::configs()[0].gains;
    let mut regulators = gains.axes.map(|axis| Regulator::new(axis, gains.pwm_limit));
    group.bench_function("seven regulators", |b| {
        b.iter(|| {
            regulators.each_mut().map(|regulator| {
                regulator.step(black_box(0.2), black_box(0.1), black_box(Some(0.5)))
            })
        });
    });
    let motors = model.motors(&START);
    group.bench_function("joints of motors", |b| {
        b.iter(|| -> JointPositions { model.joints_unchecked(black_box(&motors)) });
    });
    group.finish();
}
