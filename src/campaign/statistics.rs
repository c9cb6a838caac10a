//! Statistics of many runs: the confidence interval of a share, and the distribution of a quantity.
//!
//! - in: counts and values
//! - out: the interval in which a share lies, [`Spread`]s
//! - source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
//!   J. Am. Stat. Assoc. 22 (1927). Its interval is valid for few runs and for shares near 1, where
//!   the usual interval (share +- z sigma) has no width

use serde::Serialize;

/// Quantile of the normal distribution for an interval of 95 %.
const Z95: f64 = 1.959_963_984_540_054;

/// Returns Wilson's interval of 95 % for the share of successes; 0 to 1 without runs.
#[must_use]
pub(crate) fn wilson(successes: u64, runs: u64) -> [f64; 2] {
    if runs == 0 {
        return [0.0, 1.0];
    }
    let n = runs as f64;
    let share = successes.min(runs) as f64 / n;
    let z2 = Z95 * Z95;
    // (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)
    let centre = (share + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z95 / (1.0 + z2 / n) * (share * (1.0 - share) / n + z2 / (4.0 * n * n)).sqrt();
    // With no success or no failure both terms cancel, so only rounding keeps the end from being
    // exactly 0 or 1.
    let low = if successes == 0 { 0.0 } else { (centre - half).max(0.0) };
    let high = if successes >= runs { 1.0 } else { (centre + half).min(1.0) };
    [low, high]
}

/// Distribution of a quantity over runs. Without values each figure is NaN, which JSON writes as
/// `null`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Smallest value.
    pub min: f64,
    /// Median; the mean of the two middle values if their number is even.
    pub median: f64,
    /// Smallest value that 95 % of the values do not exceed.
    pub p95: f64,
    /// Smallest value that 99 % of the values do not exceed.
    pub p99: f64,
    /// Largest value.
    pub max: f64,
}

impl From<[f64; 5]> for Spread {
    fn from([min, median, p95, p99, max]: [f64; 5]) -> Self {
        Self { min, median, p95, p99, max }
    }
}

impl Spread {
    /// Headings of the columns in a table.
    pub const COLUMNS: [&str; 5] = ["min", "median", "95 %", "99 %", "max"];

    /// Returns minimum, median, 95 % quantile, 99 % quantile and maximum, as [`Self::COLUMNS`]
    /// names them.
    #[must_use]
    pub fn values(&self) -> [f64; 5] {
        [self.min, self.median, self.p95, self.p99, self.max]
    }

    /// Computes the distribution of values in any order.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let [Some(&min), Some(&max)] = [sorted.first(), sorted.last()] else {
            return [f64::NAN; 5].into();
        };
        let n = sorted.len();
        let median = f64::midpoint(sorted[(n - 1) / 2], sorted[n / 2]);
        // The rank is computed in whole numbers, because 0.95 * 20 in floating point exceeds 19 and
        // would round up to the wrong value.
        let share = |percent: usize| sorted[(percent * n).div_ceil(100) - 1];
        [min, median, share(95), share(99), max].into()
    }

    /// Returns whether the distribution has no values.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.min.is_nan()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Checks that an interval has these bounds, to the four digits of published tables.
    fn near(interval: [f64; 2], low: f64, high: f64) {
        assert!((interval[0] - low).abs() < 5e-5, "{interval:?} is not {low}..{high}");
        assert!((interval[1] - high).abs() < 5e-5, "{interval:?} is not {low}..{high}");
    }

    #[test]
    fn wilson_interval_matches_published_values() {
        // R. G. Newcombe, Statistics in Medicine 17 (1998), table I, method 3: 81/263, 15/148,
        // 0/20, 1/29.
        near(wilson(81, 263), 0.2553, 0.3662);
        near(wilson(15, 148), 0.0624, 0.1605);
        near(wilson(0, 20), 0.0, 0.1611);
        near(wilson(1, 29), 0.0061, 0.1718);
    }

    #[test]
    fn interval_of_only_successes_matches_closed_form() {
        // n / (n + z^2)
        near(wilson(1000, 1000), 1000.0 / 1003.841459, 1.0);
        assert_eq!(wilson(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn spread_has_quantiles_of_its_values() {
        let s = Spread::of((1..=20).rev().map(f64::from));
        assert_eq!(s.values(), [1.0, 10.5, 19.0, 20.0, 20.0]);
        assert_eq!(Spread::of((1..=300).map(f64::from)).p99, 297.0);
        assert_eq!(Spread::of([7.0]).values(), [7.0; 5]);
    }

    #[test]
    fn empty_spread_is_null_in_json() {
        let none = Spread::of([]);
        assert!(none.is_empty());
        assert_eq!(
            serde_json::to_string(&none).unwrap(),
            r#"{"min":null,"median":null,"p95":null,"p99":null,"max":null}"#
        );
    }

    proptest! {
        #[test]
        fn interval_contains_observed_share(runs in 1u64..5000, part in 0.0..=1.0f64) {
            let successes = (runs as f64 * part) as u64;
            let [low, high] = wilson(successes, runs);
            let share = successes as f64 / runs as f64;

            prop_assert!(0.0 <= low && low <= share && share <= high && high <= 1.0);
        }

        #[test]
        fn spread_quantiles_are_sorted(values in proptest::collection::vec(-1e6..1e6f64, 1..60)) {
            let s = Spread::of(values.iter().copied());

            prop_assert!(s.values().is_sorted());
            let below = values.iter().filter(|v| **v <= s.p95).count();
            prop_assert!(below * 100 >= 95 * values.len());
        }
    }
}
