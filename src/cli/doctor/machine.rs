//! Checks of the rights and properties of this machine on which a real-time servo depends.

use super::finding::{Finding, Weight};
use super::fix::{GRANTED, MEMBER, RULES};
use crate::hw::driver::{Clock, RealTime, missing_core, own_cores};
use std::fs;

/// Returns the findings about the rights of a servo thread with this real-time `priority`
/// (`SCHED_FIFO`). Requests each right, to see whether it is granted.
pub(super) fn rights(priority: i32) -> Vec<Finding> {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = |name: &str| -> String {
        // The first number after the name is the soft limit.
        let line = limits.lines().find(|line| line.starts_with(name)).unwrap_or_default();
        line[name.len().min(line.len())..].split_whitespace().next().unwrap_or("?").to_owned()
    };
    // The priority belongs to a thread. This one ends at once, so the program does not keep it.
    let denied = std::thread::spawn(move || RealTime::acquire(priority, None).warnings)
        .join()
        .unwrap_or_default();
    let refusal = |what: &str| denied.iter().find(|warning| warning.contains(what)).cloned();
    let limits_file =
        format!("sudo cp packaging/limits.d/rubik-robot.conf /etc/security/limits.d/ && {MEMBER}");
    // A priority above the limit of packaging/ cannot be granted by its files.
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

/// Returns the findings about the kernel and the processor.
pub(super) fn kernel() -> Vec<Finding> {
    let cores = own_cores();
    vec![preemption(), budget(), timer(), governor(&cores), isolation(&cores), hypervisor()]
}

/// Returns the text of a kernel file (in `/proc` or `/sys`) without blanks around it; an empty text
/// if the file cannot be read, for example because this kernel has none.
fn read(path: &str) -> String {
    fs::read_to_string(path).unwrap_or_default().trim().to_owned()
}

/// Makes a finding: one without fault if `good`, otherwise a note with `fix`, the command or
/// setting that mends it.
fn note(name: &'static str, good: bool, fact: String, fix: Option<&str>) -> Finding {
    Finding {
        name,
        weight: if good { Weight::Good } else { Weight::Note },
        fact,
        fix: fix.filter(|_| !good).map(str::to_owned),
    }
}

/// Checks that the kernel was built for real time (`PREEMPT_RT`).
fn preemption() -> Finding {
    let release = read("/proc/sys/kernel/osrelease");
    // Some real-time kernels lack the file, but name PREEMPT_RT in their version.
    let preempts =
        read("/sys/kernel/realtime") == "1" || read("/proc/version").contains("PREEMPT_RT");
    note(
        "PREEMPT_RT",
        preempts,
        format!("kernel {release}, {}", if preempts { "PREEMPT_RT" } else { "not PREEMPT_RT" }),
        Some("sudo apt-get install linux-image-rt-amd64   (Debian; then boot it)"),
    )
}

/// Checks how much of each second the kernel lets real-time threads use.
fn budget() -> Finding {
    // The kernel throttles real-time threads by default to 0.95 s of each second.
    let budget = read("/proc/sys/kernel/sched_rt_runtime_us");
    note(
        "real-time budget",
        budget == "-1" || budget == "950000",
        match budget.as_str() {
            "-1" => "real-time threads are never throttled".to_owned(),
            "" => "the kernel does not tell how much time real-time threads have".to_owned(),
            budget => {
                format!("real-time threads have {budget} us of each second; the servo needs 4 %")
            }
        },
        Some("sudo sysctl kernel.sched_rt_runtime_us=950000"),
    )
}

/// Checks the resolution of the clock.
fn timer() -> Finding {
    // Without high-resolution timers a sleep ends only at a tick of the kernel, which come every
    // few milliseconds.
    let resolution = Clock.resolution();
    note(
        "timer",
        resolution <= 1000,
        format!("the monotonic clock has a resolution of {resolution} ns"),
        Some("boot with highres=on"),
    )
}

/// Checks that the governor of each core of this process keeps the frequency at its maximum.
fn governor(cores: &[usize]) -> Finding {
    let governors: Vec<String> = cores
        .iter()
        .map(|cpu| read(&format!("/sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor")))
        .filter(|governor| !governor.is_empty())
        .collect();
    // Any other governor lowers the frequency of an idle core, so that a period takes longer.
    let performs = governors.iter().all(|governor| governor == "performance");
    note(
        "governor",
        performs,
        match governors.first() {
            None => "no frequency scaling found".to_owned(),
            Some(first) if performs => format!("{first} on all cores"),
            Some(_) => format!("{} on {} cores", governors.join(", "), cores.len()),
        },
        Some("sudo cpupower frequency-set -g performance"),
    )
}

/// Checks that the kernel reserves a core, which the servo can use. `cores` are those on which this
/// process may run.
fn isolation(cores: &[usize]) -> Finding {
    // Only threads that are pinned to an isolated core run on it.
    let isolated = read("/sys/devices/system/cpu/isolated");
    isolation_of(&isolated, cores)
}

/// Returns the finding about reserved cores: `isolated` is the kernel's list of them, and `cores`
/// are those on which this process may run.
fn isolation_of(isolated: &str, cores: &[usize]) -> Finding {
    let count = cores.len();
    let fact = match (isolated, count) {
        ("", 0 | 1) => "none: the only core of this process cannot be reserved".to_owned(),
        ("", _) => format!("none of {count}"),
        (isolated, _) => format!("{isolated}: set real_time.core to one of them"),
    };
    // The last core is proposed: the first one serves the interrupts of the machine. One core must
    // be left for all other threads.
    let fix = cores.last().filter(|_| count > 1).map(|core| {
        format!(
            "boot with isolcpus={core} nohz_full={core} rcu_nocbs={core}, \
             then --set real_time.core={core}"
        )
    });
    note("isolated cores", !isolated.is_empty(), fact, fix.as_deref())
}

/// Returns the finding about `core`, the value of the scenario's key `real_time.core`: the core on
/// which the servo thread is to run. Returns `None` if the key is not set.
pub(super) fn core(core: Option<u32>) -> Option<Finding> {
    let core = core?;
    let missing = missing_core(core as usize);
    let weight = if missing.is_some() { Weight::Refused } else { Weight::Good };
    let fix =
        missing.is_some().then(|| "set real_time.core to one of these, or leave it out".to_owned());
    let fact = missing.unwrap_or_else(|| format!("the servo's thread can be kept on core {core}"));
    Some(Finding { name: "real_time.core", weight, fact, fix })
}

/// Checks that the machine is not virtual.
fn hypervisor() -> Finding {
    // The processor reports a hypervisor to its guest.
    let is_virtual = read("/proc/cpuinfo").contains(" hypervisor");
    let fact = if is_virtual {
        "a virtual machine: its host may suspend it for milliseconds"
    } else {
        "none found"
    };
    note("hypervisor", !is_virtual, fact.to_owned(), None)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the finding with this name.
    fn of<'f>(findings: &'f [Finding], name: &str) -> &'f Finding {
        findings.iter().find(|f| f.name == name).unwrap()
    }

    #[test]
    fn scheduling_report_matches_priority_granted_to_thread() {
        const PRIORITY: i32 = 42;

        let found = rights(PRIORITY);
        let stat = std::thread::spawn(|| {
            let _rights = RealTime::acquire(PRIORITY, None);
            fs::read_to_string("/proc/thread-self/stat").unwrap()
        })
        .join()
        .unwrap();

        // Fields 40 and 41 of the line are priority and policy; policy 1 is first in, first out.
        // Field 3 is the first one after the name in brackets.
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let is_granted = fields[37] == PRIORITY.to_string() && fields[38] == "1";
        let scheduling = of(&found, "scheduling");
        assert_eq!(scheduling.weight == Weight::Good, is_granted, "{}: {stat}", scheduling.fact);
        assert!(scheduling.fact.contains("42"), "{}", scheduling.fact);
    }

    #[test]
    fn isolation_advice_names_a_core_of_this_process() {
        let fix = |isolated, cores: &[usize]| isolation_of(isolated, cores).fix;

        assert_eq!(fix("", &[0]), None);
        assert_eq!(fix("1", &[0, 2]), None);
        let advice = fix("", &[0, 2, 6]).unwrap();
        assert!(advice.contains("isolcpus=6 ") && advice.ends_with("core=6"), "{advice}");
    }

    #[test]
    fn core_that_is_not_there_is_refused() {
        let of = |wanted| core(wanted).map(|finding| finding.weight);

        assert_eq!(of(None), None);
        assert_eq!(of(Some(own_cores()[0] as u32)), Some(Weight::Good));
        assert_eq!(of(Some(1023)), Some(Weight::Refused));
        assert!(core(Some(1023)).unwrap().fact.starts_with("core 1023 is not there"));
    }

    #[test]
    fn memory_lock_finding_agrees_with_process_limits() {
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
    fn kernel_findings_agree_with_uname() {
        let found = kernel();
        let uname = |argument| {
            let out = std::process::Command::new("uname").arg(argument).output().unwrap();
            String::from_utf8(out.stdout).unwrap().trim().to_owned()
        };

        let flag = fs::read_to_string("/sys/kernel/realtime").is_ok_and(|t| t.trim() == "1");
        let is_real_time = flag || uname("-v").contains("PREEMPT_RT");
        let preempts = of(&found, "PREEMPT_RT");
        assert_eq!(preempts.weight == Weight::Good, is_real_time, "{}", preempts.fact);
        assert!(preempts.fact.contains(&uname("-r")), "{}", preempts.fact);
    }
}
