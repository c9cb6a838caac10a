//! Findings of `rubik-robot doctor`.

/// A fact about one property of the machine or of the robot, and how much it matters.
pub(super) struct Finding {
    pub(super) name: &'static str,
    pub(super) weight: Weight,
    pub(super) fact: String,
    /// Command or setting that mends it; `None` if there is none, or if it needs no mending.
    pub(super) fix: Option<String>,
}

/// Importance of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weight {
    /// No fault.
    Good,
    /// Missing right that `run --require-rt` needs.
    Missing,
    /// Reason why `run` refuses the scenario.
    Refused,
    /// Property that can make a servo late, or that only some scenarios need.
    Note,
}

impl Weight {
    /// Returns the word that marks a finding of this weight in the printed list.
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Good => "ok",
            Self::Missing => "MISSING",
            Self::Refused => "REFUSED",
            Self::Note => "note",
        }
    }
}

/// Returns whether any finding has this weight.
pub(super) fn any(findings: &[Finding], weight: Weight) -> bool {
    findings.iter().any(|finding| finding.weight == weight)
}

/// Returns the exit code of `doctor`: 1 when a right is missing or `run` would refuse the scenario.
pub(super) fn exit_code(findings: &[Finding]) -> u8 {
    u8::from(any(findings, Weight::Missing) || any(findings, Weight::Refused))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_code_is_1_when_run_would_refuse() {
        let found = |weight| Finding { name: "", weight, fact: String::new(), fix: None };
        let code = |weights: &[Weight]| {
            exit_code(&weights.iter().map(|weight| found(*weight)).collect::<Vec<_>>())
        };

        assert_eq!(code(&[Weight::Good, Weight::Note]), 0);
        assert_eq!(code(&[Weight::Missing, Weight::Good]), 1);
        assert_eq!(code(&[Weight::Good, Weight::Refused]), 1);
    }
}
