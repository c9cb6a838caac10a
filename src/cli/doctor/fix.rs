//! Commands that `rubik-robot doctor` prints to mend what it found.

/// Highest real-time priority (`SCHED_FIFO`) that the files in `packaging/` grant.
pub(super) const GRANTED: i32 = 85;

/// Command that adds this user to the group `rubik-robot`, to which the files in `packaging/` grant
/// all rights.
pub(super) const MEMBER: &str =
    "sudo groupadd -f rubik-robot && sudo usermod -aG rubik-robot $USER   (then log in again)";
/// Command that lets this group open the devices.
pub(super) const RULES: &str = "sudo cp packaging/udev/60-rubik-robot.rules /etc/udev/rules.d/ \
                                && sudo udevadm control --reload";

/// Returns the command that lets the group `rubik-robot` open the devices, also those that are
/// already connected, and adds this user to the group.
pub(super) fn trigger() -> String {
    format!("{RULES} && sudo udevadm trigger && {MEMBER}")
}

/// Returns the command that lets this program access the I/O ports of ISA cards: a build with the
/// feature `isa`, or the capability if it has that feature.
pub(super) fn raw_io() -> String {
    if !cfg!(feature = "isa") {
        return "cargo build --release --features isa   (for bridge.kind = \"isa\")".to_owned();
    }
    let program = std::env::current_exe().unwrap_or_default();
    format!("sudo setcap cap_sys_rawio+ep {}   (for bridge.kind = \"isa\")", program.display())
}
