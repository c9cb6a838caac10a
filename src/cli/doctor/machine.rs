//! Rights and properties of this machine that decide how punctual a servo can be.

use super::finding::{Finding, Weight};
use super::fix::{GRANTED, MEMBER, RULES};
use crate::hw::driver::{Clock, RealTime};
use std::fs;

/// Returns which of the servo thread's rights are granted, by asking for them.
pub(super) fn rights(priority: i32) -> Vec<Finding> {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = |name: &str| -> String {
        let line = limits.lines().find(|line| line.starts_with(name)).unwrap_or_default();
        line[name.len().min(line.len())..].split_whitespace().next().unwrap_or("?").to_owned()
    };
    // Rights belong to a thread; this one ends at once.
    let denied = std::thread::spawn(move || RealTime::acquire(priority, None).warnings)
        .join()
        .unwrap_or_default();
    let refusal = |what: &str| denied.iter().find(|warning| warning.contains(what)).cloned();
    let limits_file =
        format!("sudo cp packaging/limits.d/rubik-robot.conf /etc/security/limits.d/ && {MEMBER}");
    let lower = if priority > GRANTED {
        format!("set real_time.priority to {GRANTED}, the most that packaging/ grants; then ")
    } else {
        String::new()
    };
    let one = |name, what: &str, good: String, fix: &str| match refusal(what) {
        None => Finding { name, weight: Weight::Good, fact: good, fix: None },
        Some(fact) => Finding { name, weight: Weight::Missing, fact, fix: Some(fix.to_owned()) },
    };
    vec![
        one(
            "scheduling",
            "SCHED_FIFO",
            format!(
                "SCHED_FIFO {priority} granted (RLIMIT_RTPRIO {})",
                limit("Max realtime priority")
            ),
            &format!("{lower}{limits_file}"),
        ),
        one(
            "memory lock",
            "mlockall",
            format!("mlockall granted (RLIMIT_MEMLOCK {})", limit("Max locked memory")),
            &limits_file,
        ),
        one(
            "wake-up latency",
            "cpu_dma_latency",
            "/dev/cpu_dma_latency can be held at 0".to_owned(),
            &format!("{RULES} && sudo udevadm trigger /dev/cpu_dma_latency && {MEMBER}"),
        ),
    ]
}

/// Returns what the kernel and the processor do for punctuality.
pub(super) fn kernel() -> Vec<Finding> {
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    vec![preemption(), budget(), timer(), governor(cores), isolation(cores), hypervisor()]
}

/// Returns the text of a file of the kernel, empty if it has none.
fn read(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_default().trim().to_owned()
}

/// Makes a finding that is at most a note; `fix` is kept if the fact is not `good`.
fn note(name: &'static str, good: bool, fact: String, fix: Option<&str>) -> Finding {
    Finding {
        name,
        weight: if good { Weight::Good } else { Weight::Note },
        fact,
        fix: fix.filter(|_| !good).map(str::to_owned),
    }
}

fn preemption() -> Finding {
    let release = read("/proc/sys/kernel/osrelease");
    let preempts =
        read("/sys/kernel/realtime") == "1" || read("/proc/version").contains("PREEMPT_RT");
    note(
        "PREEMPT_RT",
        preempts,
        format!("kernel {release}, {}", if preempts { "PREEMPT_RT" } else { "not PREEMPT_RT" }),
        Some("sudo apt-get install linux-image-rt-amd64   (Debian; then boot it)"),
    )
}

fn budget() -> Finding {
    let budget = read("/proc/sys/kernel/sched_rt_runtime_us");
    note(
        "real-time budget",
        budget == "-1" || budget == "950000",
        match budget.as_str() {
            "-1" => "real-time threads are never throttled".to_owned(),
            budget => {
                format!("real-time threads have {budget} us of each second; the servo needs 4 %")
            }
        },
        Some("sudo sysctl kernel.sched_rt_runtime_us=950000"),
    )
}

fn timer() -> Finding {
    let resolution = Clock.resolution();
    note(
        "timer",
        resolution <= 1000,
        format!("the monotonic clock resolves {resolution} ns"),
        Some("boot with highres=on"),
    )
}

fn governor(cores: usize) -> Finding {
    let governors: Vec<String> = (0..cores)
        .map(|cpu| read(&format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor")))
        .filter(|governor| !governor.is_empty())
        .collect();
    let performs = governors.iter().all(|governor| governor == "performance");
    note(
        "governor",
        performs,
        match governors.first() {
            None => "no frequency scaling to be seen".to_owned(),
            Some(first) if performs => format!("{first} on all cores"),
            Some(_) => format!("{} on {cores} cores", governors.join(", ")),
        },
        Some("sudo cpupower frequency-set -g performance"),
    )
}

fn isolation(cores: usize) -> Finding {
    let isolated = read("/sys/devices/system/cpu/isolated");
    note(
        "isolated cores",
        !isolated.is_empty(),
        match isolated.as_str() {
            "" => format!("none of {cores}"),
            isolated => format!("{isolated} of {cores}: set real_time.core to one of them"),
        },
        Some("boot with isolcpus=1 nohz_full=1 rcu_nocbs=1, then --set real_time.core=1"),
    )
}

fn hypervisor() -> Finding {
    let is_virtual = read("/proc/cpuinfo").contains(" hypervisor");
    let fact = if is_virtual {
        "a virtual machine: gaps of milliseconds come from below it"
    } else {
        "none to be seen"
    };
    note("hypervisor", !is_virtual, fact.to_owned(), None)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of<'f>(findings: &'f [Finding], name: &str) -> &'f Finding {
        findings.iter().find(|f| f.name == name).unwrap()
    }

    #[test]
    fn a_priority_is_granted_where_a_thread_really_has_it() {
        const PRIORITY: i32 = 42;

        let found = rights(PRIORITY);
        let stat = std::thread::spawn(|| {
            let _rights = RealTime::acquire(PRIORITY, None);
            fs::read_to_string("/proc/thread-self/stat").unwrap()
        })
        .join()
        .unwrap();

        // Fields 40 and 41 of the line: priority and policy, of which 1 is first in, first out. The
        // third one follows the name in its brackets.
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let is_granted = fields[37] == PRIORITY.to_string() && fields[38] == "1";
        let scheduling = of(&found, "scheduling");
        assert_eq!(scheduling.weight == Weight::Good, is_granted, "{}: {stat}", scheduling.fact);
        assert!(scheduling.fact.contains("42"), "{}", scheduling.fact);
    }

    #[test]
    fn memory_is_locked_only_where_nothing_limits_it() {
        let found = rights(42);
        let lock = of(&found, "memory lock");

        let most = rustix::process::getrlimit(rustix::process::Resource::Memlock).current;
        let status = fs::read_to_string("/proc/self/status").unwrap();
        let line = |name: &str| status.lines().find_map(|l| l.strip_prefix(name)).unwrap().trim();
        let may_lock = u64::from_str_radix(line("CapEff:"), 16).unwrap() >> 14 & 1 == 1;
        if lock.weight == Weight::Good {
            assert!(most.is_none() || may_lock, "{most:?}");
            assert_ne!(line("VmLck:"), "0 kB");
            let limit = most.map_or("unlimited".to_owned(), |bytes| bytes.to_string());
            assert!(lock.fact.contains(&limit), "{}, but {limit}", lock.fact);
        } else {
            assert!(lock.fact.contains("mlockall"), "{}", lock.fact);
        }
    }

    #[test]
    fn the_kernel_is_as_it_says_itself() {
        let found = kernel();
        let said = |argument| {
            let out = std::process::Command::new("uname").arg(argument).output().unwrap();
            String::from_utf8(out.stdout).unwrap().trim().to_owned()
        };

        let flag = fs::read_to_string("/sys/kernel/realtime").is_ok_and(|t| t.trim() == "1");
        let is_real_time = flag || said("-v").contains("PREEMPT_RT");
        let preempts = of(&found, "PREEMPT_RT");
        assert_eq!(preempts.weight == Weight::Good, is_real_time, "{}", preempts.fact);
        assert!(preempts.fact.contains(&said("-r")), "{}", preempts.fact);
    }
}
