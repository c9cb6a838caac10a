//! Commands that `rubik-robot doctor` prints as help.

/// Highest priority that `packaging/` grants.
pub(super) const GRANTED: i32 = 85;

/// Command that adds this user to the group to which `packaging/` grants all rights.
pub(super) const MEMBER: &str =
    "sudo groupadd -f rubik-robot && sudo usermod -aG rubik-robot $USER   (then log in again)";
/// Command that lets the group open the devices.
pub(super) const RULES: &str = "sudo cp packaging/udev/60-rubik-robot.rules /etc/udev/rules.d/ \
                                && sudo udevadm control --reload";

/// Returns the command that lets the group `rubik-robot` open the devices, also those that are
/// already connected, and adds this user to the group.
pub(super) fn trigger() -> String {
    format!("{RULES} && sudo udevadm trigger && {MEMBER}")
}

/// Returns the command that lets this program use port instructions.
pub(super) fn raw_io() -> String {
    if !cfg!(feature = "isa") {
        return "cargo build --release --features isa   (for bridge.kind = \"isa\")".to_owned();
    }
    let program = std::env::current_exe().unwrap_or_default();
    format!("sudo setcap cap_sys_rawio+ep {}   (for bridge.kind = \"isa\")", program.display())
}
