//! Checks of the devices that a bridge may need. The simulated plant needs none.

use super::finding::{Finding, Weight};
use super::fix::{raw_io, trigger};
use crate::hw::devices::ask_ports;
use rustix::fs::{Access, access};
use rustix::io::Errno;
use std::fs;
use std::path::Path;

/// Returns the findings about serial lines, the I/O ports of ISA cards and serial adapters.
pub(super) fn devices() -> Vec<Finding> {
    let names = serial_lines(Path::new("/dev"), Path::new("/sys/class/tty"));
    let mut findings = vec![lines(Path::new("/dev"), &names), ports()];
    findings.extend(slow_adapters(&names));
    findings
}

/// Returns the sorted names of the serial lines in `devices`, usually `/dev`. `classes` is the
/// kernel's folder `/sys/class/tty`, which has a subfolder for each line with its type.
fn serial_lines(devices: &Path, classes: &Path) -> Vec<String> {
    // The kernel lists more ports ttyS* than the PC has. The type of a port that is missing is 0.
    let is_there = |name: &String| {
        let kind = fs::read_to_string(classes.join(name).join("type")).unwrap_or_default();
        !name.starts_with("ttyS") || kind.trim() != "0"
    };
    let mut names: Vec<String> = fs::read_dir(devices)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| ["ttyUSB", "ttyACM", "ttyM", "ttyS"].iter().any(|p| name.starts_with(p)))
        .filter(is_there)
        .collect();
    names.sort();
    names
}

/// Checks whether this user may read and write a device; otherwise returns the reason. The device
/// stays closed: opening a serial line raises its DTR signal, which resets some controllers.
pub(super) fn may_open(device: &Path) -> Result<(), Errno> {
    access(device, Access::READ_OK | Access::WRITE_OK)
}

/// Checks whether this user may open the serial lines with these names in the folder `devices`.
fn lines(devices: &Path, names: &[String]) -> Finding {
    let name = "serial lines";
    let denied: Vec<Errno> =
        names.iter().filter_map(|name| may_open(&devices.join(name)).err()).collect();
    // Only a serial bridge needs the lines, so a missing line or right is a note and no fault.
    match (names.len(), denied.len()) {
        (0, _) => Finding {
            name,
            weight: Weight::Note,
            fact: "none; bridge.kind = \"serial\" needs one for each axis".to_owned(),
            fix: None,
        },
        (all, 0) => Finding {
            name,
            weight: Weight::Good,
            fact: format!("{all} can be opened: {}", names.join(" ")),
            fix: None,
        },
        (all, count) => Finding {
            name,
            weight: Weight::Note,
            fact: format!("{count} of {all} cannot be opened by this user"),
            fix: denied.contains(&Errno::ACCESS).then(trigger),
        },
    }
}

/// Checks whether the kernel grants this program the I/O ports of an ISA card at the addresses that
/// the original robot of 2007 used.
pub(super) fn ports() -> Finding {
    let name = "ISA ports";
    // Port instructions are a feature that is chosen when the program is built.
    if !cfg!(feature = "isa") {
        return Finding {
            name,
            weight: Weight::Note,
            fact: "this program was built without port instructions".to_owned(),
            fix: Some(raw_io()),
        };
    }
    match asked(ask_ports, 0) {
        Ok(()) => Finding {
            name,
            weight: Weight::Good,
            fact: "port instructions are granted".to_owned(),
            fix: None,
        },
        Err(fact) => Finding { name, weight: Weight::Note, fact, fix: Some(raw_io()) },
    }
}

/// Requests access to I/O ports by `ask(ports)`, in a thread that ends at once. The kernel grants
/// the access to that thread alone, so the program does not keep it. `ports` is the argument of
/// [`ask_ports`] or [`ask_parallel`](crate::hw::devices::ask_parallel).
pub(super) fn asked(ask: fn(u16) -> Result<(), String>, ports: u16) -> Result<(), String> {
    std::thread::spawn(move || ask(ports))
        .join()
        .unwrap_or_else(|_| Err("the thread that asked for ports panicked".to_owned()))
}

/// Returns a note if FTDI serial adapters collect answers for more than 1 ms before they pass them
/// on, otherwise `None`. The default of their driver is 16 ms, eight servo periods.
fn slow_adapters(serial: &[String]) -> Option<Finding> {
    // Only the driver of FTDI adapters offers this file.
    let timer = |name: &&String| {
        let path = format!("/sys/class/tty/{name}/device/latency_timer");
        let text = fs::read_to_string(path).ok()?;
        text.trim().parse::<u32>().ok().filter(|&milliseconds| milliseconds > 1)
    };
    let slow: Vec<&String> = serial.iter().filter(|name| timer(name).is_some()).collect();
    let names: Vec<&str> = slow.iter().map(|name| name.as_str()).collect();
    let first = slow.first()?;
    Some(Finding {
        name: "serial adapters",
        weight: Weight::Note,
        fact: format!("answers are delayed by more than 1 ms: {}", names.join(", ")),
        fix: Some(format!(
            "echo 1 | sudo tee /sys/class/tty/{first}/device/latency_timer   (for each adapter; or \
             install packaging/udev)"
        )),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::testing::Folder;

    #[test]
    fn serial_lines_omit_ports_that_the_pc_lacks() {
        let folder = Folder::new("doctor-lines");
        for (name, kind) in
            [("ttyS0", "4\n"), ("ttyS1", "0\n"), ("ttyUSB0", "0\n"), ("tty3", "4\n")]
        {
            folder.write(&format!("dev/{name}"), "");
            folder.write(&format!("class/{name}/type"), kind);
        }
        let devices = folder.0.join("dev");

        let names = serial_lines(&devices, &folder.0.join("class"));

        assert_eq!(names, ["ttyS0", "ttyUSB0"]);
        assert_eq!(lines(&devices, &names).fact, "2 can be opened: ttyS0 ttyUSB0");
        fs::remove_file(devices.join("ttyS0")).unwrap();
        assert_eq!(lines(&devices, &names).fact, "1 of 2 cannot be opened by this user");
    }
}
