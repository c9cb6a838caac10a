//! Runner of a check over many seeds, and the limits of the controller in it.

/// Seed of everything that a run draws.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seed(pub(crate) u64);

/// Runs a check for each seed in the environment variable `FAULT_SEEDS`, and panics with all seeds
/// at which it fails. `100` means the seeds 1 to 100, `57-60` a range; without the variable only
/// seed 1 runs.
pub(crate) fn each_seed(check: impl Fn(Seed) + std::panic::RefUnwindSafe) {
    let seeds = std::env::var("FAULT_SEEDS").unwrap_or_else(|_| "1".to_owned());
    let (first, last) = seeds.split_once('-').unwrap_or(("1", &seeds));
    let (first, last): (u64, u64) = (first.parse().unwrap(), last.parse().unwrap());
    assert!(first <= last, "FAULT_SEEDS={seeds}: no seed");
    let fails = |seed: &u64| std::panic::catch_unwind(|| check(Seed(*seed))).is_err();
    let failed: Vec<u64> = (first..=last).filter(fails).collect();
    assert!(failed.is_empty(), "of seeds {first} to {last} {} fail: {failed:?}", failed.len());
}

/// Returns the override of a scenario's key that selects the controller's profile named in the
/// environment variable `FAULT_PROFILE`, for instance `workshop`. Returns `None` without the
/// variable: then each scenario keeps its own profile.
pub(crate) fn profile() -> Option<String> {
    let name = std::env::var("FAULT_PROFILE").ok()?;
    Some(format!("control.profile={name:?}"))
}
