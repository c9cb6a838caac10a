//! Histogram of times: classes with their counts, as a recording holds them.

/// Parses classes from `nanoseconds:count` pairs in rising order. Other words are left out.
pub(super) fn classes(text: &str) -> Vec<(u64, u64)> {
    let pair = |word: &str| {
        let (nanos, count) = word.split_once(':')?;
        Some((nanos.parse().ok()?, count.parse().ok()?))
    };
    text.split_whitespace().filter_map(pair).collect()
}

/// Returns the number of times in all classes.
pub(super) fn count(classes: &[(u64, u64)]) -> u64 {
    // A file may hold any numbers, so the sum saturates.
    classes.iter().fold(0, |sum, (_, count)| sum.saturating_add(*count))
}

/// Returns the time that a share of all counts does not exceed (ns); 0 without classes.
pub(super) fn quantile(classes: &[(u64, u64)], share: f64) -> u64 {
    let total = count(classes);
    let mut seen: u64 = 0;
    for (nanos, count) in classes {
        seen = seen.saturating_add(*count);
        if seen as f64 >= share * total as f64 {
            return *nanos;
        }
    }
    0
}
