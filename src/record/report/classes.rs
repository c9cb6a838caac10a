//! Histogram of times as a recording holds it: classes, each a time (ns) and a count.

/// Parses a histogram of times: words `nanoseconds:count`, in rising order of the times. Returns
/// time (ns) and count of each class; words of another form are left out.
pub(super) fn classes(text: &str) -> Vec<(u64, u64)> {
    let pair = |word: &str| {
        let (nanos, count) = word.split_once(':')?;
        Some((nanos.parse().ok()?, count.parse().ok()?))
    };
    text.split_whitespace().filter_map(pair).collect()
}

/// Returns the sum of the counts of all classes of a histogram.
pub(super) fn count(classes: &[(u64, u64)]) -> u64 {
    // A file may hold any numbers, so the sum saturates.
    classes.iter().fold(0, |sum, (_, count)| sum.saturating_add(*count))
}

/// Returns a quantile of a histogram: the least time (ns) that `share` (0 to 1) of all counted
/// times do not exceed; 0 for an empty histogram.
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
