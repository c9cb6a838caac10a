//! The shard of a process that a scheduler has started as one of many: a job array of Slurm, or an
//! indexed job of Kubernetes.
//!
//! - in: the value of `--shard`, and the environment of the process
//! - out: the [`Shard`], or the reason why the environment names none
//!
//! | scheduler | shard K | number of shards N |
//! |---|---|---|
//! | Slurm | `SLURM_ARRAY_TASK_ID`, from `_MIN` in steps of `_STEP` | `SLURM_ARRAY_TASK_COUNT` |
//! | Kubernetes | `JOB_COMPLETION_INDEX` + 1 | `JOB_COMPLETIONS`, which the job's file must set |
//! | GNU parallel | `PARALLEL_SEQ` | not in the environment: `--shard {#}/{##}` with `--plus` |
//!
//! - source: the man page sbatch(1) of Slurm 22.05, "output environment variables"; the page
//!   "Indexed Job" of Kubernetes; parallel(1) of 2022, `--plus`

use super::state::Shard;
use std::str::FromStr;

/// Index of a task in a job array of Slurm.
const SLURM: &str = "SLURM_ARRAY_TASK_ID";
/// Index of a pod in an indexed job of Kubernetes, from 0.
const KUBERNETES: &str = "JOB_COMPLETION_INDEX";
/// Number of a job of GNU parallel, from 1.
const PARALLEL: &str = "PARALLEL_SEQ";

/// Environment of a process: returns the value of a variable, `None` if it is not set.
pub(crate) type Environment<'a> = &'a dyn Fn(&str) -> Option<String>;

/// Value of `--shard`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Choice {
    /// The shard that the user names.
    Named(Shard),
    /// The shard that the environment names.
    Auto,
}

impl FromStr for Choice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let named = text.parse().map(Self::Named);
        named.map_err(|why| format!("{why}, or auto in a task of Slurm or Kubernetes"))
    }
}

impl Choice {
    /// Returns the shard.
    ///
    /// # Errors
    /// The reason why `environment` names no shard, or more than one.
    pub(crate) fn shard(self, environment: Environment<'_>) -> Result<Shard, String> {
        match self {
            Self::Named(shard) => Ok(shard),
            Self::Auto => of_environment(environment).map_err(|why| format!("--shard auto: {why}")),
        }
    }
}

/// Returns the shard that the variables of a scheduler give.
fn of_environment(environment: Environment<'_>) -> Result<Shard, String> {
    let set: Vec<&str> = [SLURM, KUBERNETES, PARALLEL]
        .into_iter()
        .filter(|name| environment(name).is_some())
        .collect();
    match set[..] {
        [SLURM] => slurm(environment),
        [KUBERNETES] => kubernetes(environment),
        [PARALLEL] => Err(format!(
            "{PARALLEL} has no number of shards beside it: write --shard {{#}}/{{##}} and give GNU \
             parallel the option --plus"
        )),
        [] => Err(format!(
            "this is no task of a scheduler: neither {SLURM} (a job array of Slurm) nor \
             {KUBERNETES} (an indexed job of Kubernetes) nor {PARALLEL} (GNU parallel) is set: \
             write --shard K/N"
        )),
        // One of them may be the environment of a task in which the other scheduler was started.
        _ => Err(format!("{} are all set: write --shard K/N", set.join(" and "))),
    }
}

/// Returns the shard of a task of a job array. The indices of an array may have a first one and a
/// step, as in 10-16:2, but no gaps, because a gap would be a shard that no task performs.
fn slurm(environment: Environment<'_>) -> Result<Shard, String> {
    let id = number(environment, SLURM)?;
    let min = number(environment, "SLURM_ARRAY_TASK_MIN")?;
    let count = number(environment, "SLURM_ARRAY_TASK_COUNT")?;
    let or = |name: &str, value: Option<u64>| match environment(name) {
        Some(_) => number(environment, name).map(Some),
        None => Ok(value),
    };
    let step = or("SLURM_ARRAY_TASK_STEP", Some(1))?.unwrap_or(1).max(1);
    let last = count.checked_sub(1).and_then(|n| min.checked_add(n.checked_mul(step)?));
    let max = or("SLURM_ARRAY_TASK_MAX", last)?;
    let from_first = id.checked_sub(min).filter(|i| i % step == 0).map(|i| i / step);
    match (from_first, last) {
        (Some(k), Some(_)) if k < count && max == last => Shard::try_from((k + 1, count)),
        _ => Err(format!(
            "the job array has gaps: {count} tasks from {min} in steps of {step} do not end at \
             {}, or have no index {id}: give sbatch an array such as --array=1-{count}",
            max.map_or_else(|| "2^64".to_owned(), |max| max.to_string()),
        )),
    }
}

/// Returns the shard of a pod of an indexed job.
fn kubernetes(environment: Environment<'_>) -> Result<Shard, String> {
    // Kubernetes sets the index alone.
    if environment("JOB_COMPLETIONS").is_none() {
        return Err(format!(
            "{KUBERNETES} is set, but not the number of pods: set the variable JOB_COMPLETIONS in \
             the job's file to the number in its key completions"
        ));
    }
    let (index, count) =
        (number(environment, KUBERNETES)?, number(environment, "JOB_COMPLETIONS")?);
    if index >= count {
        return Err(format!(
            "{KUBERNETES} is {index}, but counts from 0 to JOB_COMPLETIONS - 1, with {count} pods: \
             is JOB_COMPLETIONS the number in the key completions?"
        ));
    }
    Shard::try_from((index + 1, count))
}

/// Returns the whole number in a variable.
fn number(environment: Environment<'_>, name: &str) -> Result<u64, String> {
    let text = environment(name).ok_or_else(|| format!("{name} is not set: write --shard K/N"))?;
    text.trim().parse().map_err(|_| format!("{name} is `{text}`, which is no whole number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the shard of `--shard auto` in an environment of pairs `NAME=VALUE`, or the reason.
    fn auto(environment: &str) -> Result<String, String> {
        let value = |name: &str| {
            let mut pairs = environment.split(' ').filter_map(|pair| pair.split_once('='));
            pairs.find(|(key, _)| *key == name).map(|(_, value)| value.to_owned())
        };
        Choice::Auto.shard(&value).map(|shard| shard.to_string())
    }

    /// Returns the environment of a task: index, first index, last index, number of tasks, step.
    fn task([id, min, max, count, step]: [u64; 5]) -> String {
        format!(
            "SLURM_ARRAY_TASK_ID={id} SLURM_ARRAY_TASK_MIN={min} SLURM_ARRAY_TASK_MAX={max} \
             SLURM_ARRAY_TASK_COUNT={count} SLURM_ARRAY_TASK_STEP={step}"
        )
    }

    #[test]
    fn named_shard_ignores_the_environment() {
        let named: Choice = "2/4".parse().unwrap();
        assert_eq!(named.shard(&|_| Some("9".into())).unwrap().to_string(), "2/4");
        assert_eq!("auto".parse(), Ok(Choice::Auto));
        for wrong in ["automatic", "3", "0/2", ""] {
            assert!(wrong.parse::<Choice>().unwrap_err().contains("or auto"), "{wrong}");
        }
    }

    #[test]
    fn slurm_array_gives_consecutive_shards() {
        for (first, step) in [(0, 1), (1, 1), (10, 1), (1, 2), (0, 3)] {
            let max = first + 7 * step;
            let shards = (0..8).map(|k| auto(&task([first + k * step, first, max, 8, step])));
            let wanted: Vec<_> = (1..=8).map(|k| Ok(format!("{k}/8"))).collect();
            assert_eq!(shards.collect::<Vec<_>>(), wanted, "from {first} in steps of {step}");
        }
        // An older Slurm sets neither the last index nor the step.
        let old = "SLURM_ARRAY_TASK_ID=3 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_COUNT=4";
        assert_eq!(auto(old).unwrap(), "3/4");
    }

    #[test]
    fn slurm_array_with_gaps_is_refused() {
        // The arrays 1,2,5 and 1-4,9 and 2-8:2,3; an index outside; no tasks at all.
        for numbers in [
            [1, 1, 5, 3, 1],
            [5, 1, 5, 3, 1],
            [2, 1, 9, 5, 1],
            [3, 2, 8, 5, 2],
            [0, 1, 4, 4, 1],
            [7, 1, 4, 4, 1],
            [1, 1, 1, 0, 1],
            [u64::MAX, u64::MAX, 4, 4, u64::MAX],
        ] {
            let why = auto(&task(numbers)).unwrap_err();
            assert!(why.contains("has gaps"), "{numbers:?}: {why}");
        }
        let half = "SLURM_ARRAY_TASK_ID=3 SLURM_ARRAY_TASK_MIN=1";
        assert!(auto(half).unwrap_err().contains("SLURM_ARRAY_TASK_COUNT is not set"));
        let word = "SLURM_ARRAY_TASK_ID=x SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_COUNT=4";
        assert!(auto(word).unwrap_err().contains("`x`, which is no whole number"));
    }

    #[test]
    fn kubernetes_index_counts_from_zero() {
        assert_eq!(auto("JOB_COMPLETION_INDEX=0 JOB_COMPLETIONS=8").unwrap(), "1/8");
        assert_eq!(auto("JOB_COMPLETION_INDEX=7 JOB_COMPLETIONS=8").unwrap(), "8/8");
        let beyond = auto("JOB_COMPLETION_INDEX=8 JOB_COMPLETIONS=8").unwrap_err();
        assert!(beyond.contains("counts from 0"), "{beyond}");
        let alone = auto("JOB_COMPLETION_INDEX=0").unwrap_err();
        assert!(alone.contains("set the variable JOB_COMPLETIONS"), "{alone}");
    }

    #[test]
    fn unclear_environment_is_refused_with_its_variables() {
        let none = auto("HOME=/root").unwrap_err();
        for name in [SLURM, KUBERNETES, PARALLEL, "--shard auto: ", "--shard K/N"] {
            assert!(none.contains(name), "{name} in {none}");
        }
        assert!(auto("PARALLEL_SEQ=2").unwrap_err().contains("--shard {#}/{##}"));
        let array = task([1, 1, 4, 4, 1]);
        for other in ["JOB_COMPLETION_INDEX=0 JOB_COMPLETIONS=8", "PARALLEL_SEQ=2"] {
            let why = auto(&format!("{array} {other}")).unwrap_err();
            assert!(why.contains("are all set") && why.contains(SLURM), "{why}");
        }
    }
}
