//! Campaigns whose shards are tasks of a scheduler: the shard from the environment, the files in a
//! folder, the progress, a task that is started again.

use crate::folder::Folder;
use crate::program::program;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

/// Arguments of a campaign whose runs idle for a second.
const IDLE: [&str; 5] = ["campaign", "scenarios/idle.toml", "--set", "idle.time_s=1", "--json"];
/// Variables of schedulers, which the machine of the test may set.
const VARIABLES: [&str; 8] = [
    "SLURM_ARRAY_TASK_ID",
    "SLURM_ARRAY_TASK_MIN",
    "SLURM_ARRAY_TASK_MAX",
    "SLURM_ARRAY_TASK_COUNT",
    "SLURM_ARRAY_TASK_STEP",
    "JOB_COMPLETION_INDEX",
    "JOB_COMPLETIONS",
    "PARALLEL_SEQ",
];

/// Removes the variables of schedulers from a command and sets those of `environment`, pairs
/// `NAME=VALUE`.
fn within(mut command: Command, environment: &str) -> Command {
    for name in VARIABLES {
        command.env_remove(name);
    }
    command.envs(environment.split_whitespace().filter_map(|pair| pair.split_once('=')));
    command
}

/// Runs the program with these arguments, in this environment, to its end.
fn robot(environment: &str, args: &[&str]) -> Output {
    within(program(), environment).args(args).output().unwrap()
}

/// Returns the environment of a task of a job array with the indices 0 to `count` - 1.
fn task(id: u64, count: u64) -> String {
    format!(
        "SLURM_ARRAY_TASK_ID={id} SLURM_ARRAY_TASK_MIN=0 SLURM_ARRAY_TASK_MAX={} \
         SLURM_ARRAY_TASK_COUNT={count} SLURM_ARRAY_TASK_STEP=1",
        count - 1
    )
}

/// Returns the environment of a pod of an indexed job with `count` pods.
fn pod(id: u64, count: u64) -> String {
    format!("JOB_COMPLETION_INDEX={id} JOB_COMPLETIONS={count}")
}

/// Returns stdout and stderr of a program.
fn all_of(out: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr))
}

/// Checks the exit code and returns the JSON object in the last line of stdout.
fn object(out: &Output, code: i32) -> Value {
    assert_eq!(out.status.code(), Some(code), "{}", all_of(out));
    let stdout = String::from_utf8_lossy(&out.stdout);
    serde_json::from_str(stdout.lines().last().unwrap()).unwrap()
}

/// Each task finds its shard in its environment and its file in the folder. The merged folder gives
/// the object of the whole campaign, and a task that is started again has nothing left.
#[test]
fn tasks_of_schedulers_share_a_campaign() {
    let whole = object(&robot("", &[&IDLE[..], &["--runs", "5"]].concat()), 0);
    let schedulers = [("slurm", task as fn(u64, u64) -> String), ("pods", pod)];
    for (name, of_task) in schedulers {
        let folder = Folder::new(&format!("cluster-{name}"));
        let args = ["--runs", "5", "--shard", "auto", "--state", folder.path()];
        let run = |id| robot(&of_task(id, 2), &[&IDLE[..], &args].concat());
        let first = object(&run(0), 0);
        object(&run(1), 0);

        assert_eq!(first["runs"], 3, "{name}");
        let merged = robot("", &["campaign", "merge", folder.path(), "--json"]);
        assert_eq!(object(&merged, 0).to_string(), whole.to_string(), "{name}");
        for file in ["shard-1-of-2.jsonl", "shard-2-of-2.jsonl"] {
            assert!(Path::new(&folder.file(file)).is_file(), "{name}: {file}");
        }
        let again = run(0);
        assert_eq!(object(&again, 0), first, "{name}");
        assert!(all_of(&again).contains("has 3 of 3 runs"), "{name}: {}", all_of(&again));
        let status = object(&robot("", &["campaign", "status", folder.path(), "--json"]), 0);
        assert_eq!((&status["runs"], &status["left_s"]), (&5.into(), &0.0.into()), "{status}");
    }
}

/// A second process with the shard of a live one is refused. After a kill of the first one, which
/// leaves the file locked by a dead process, the next one continues the file.
#[test]
fn requeued_task_continues_its_own_file() {
    let folder = Folder::new("cluster-requeue");
    let file = folder.file("shard-1-of-2.jsonl");
    // Runs in real time, so that the process is killed between two of its three runs.
    let slowly = ["--set", "pace=real-time", "--runs", "6", "--jobs", "1", "--shard", "auto"];
    let args = [&IDLE[..], &slowly, &["--state", folder.path()]].concat();
    let mut first = within(program(), &task(0, 2))
        .args(&args)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let lines = || std::fs::read_to_string(&file).map_or(0, |text| text.lines().count());
    while lines() < 2 {
        assert!(first.try_wait().unwrap().is_none(), "it ended before it was killed");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }

    let second = robot(&task(0, 2), &args);
    first.kill().unwrap();
    first.wait().unwrap();
    let kept = lines() - 1;
    let third = robot(&task(0, 2), &args);

    assert_eq!(second.status.code(), Some(2), "{}", all_of(&second));
    assert!(all_of(&second).contains("another campaign is writing it"), "{}", all_of(&second));
    let done = object(&third, 0);
    assert_eq!((&done["runs"], &done["solved"]), (&3.into(), &3.into()), "{done}");
    let words = format!("has {kept} of 3 runs, the campaign continues");
    assert!(kept < 3 && all_of(&third).contains(&words), "{words}: {}", all_of(&third));
}

#[test]
fn status_reports_progress_and_missing_shards() {
    let folder = Folder::new("cluster-status");
    let shard = ["--runs", "5", "--shard", "1/3", "--state", folder.path()];
    object(&robot("", &[&IDLE[..], &shard].concat()), 0);
    // A task that was killed at its start, and a file that is none of the campaign.
    std::fs::write(folder.file("shard-2-of-3.jsonl"), "").unwrap();
    std::fs::write(folder.file("notes.txt"), "my notes\n").unwrap();

    let status = ["campaign", "status", folder.path(), "--plan", "10000", "--cores", "500"];
    let table = robot("", &status);
    let values = object(&robot("", &[&status[..], &["--json"]].concat()), 1);
    let merged = robot("", &["campaign", "merge", folder.path()]);

    assert_eq!(table.status.code(), Some(1));
    for words in [
        "runs             2 of 5",
        "solved, failed   2, 0",
        "shards           3: 1 complete, 0 incomplete, 2 missing",
        "missing shards   2/3, 3/3",
        "10000 runs need",
        "shard-2-of-3.jsonl: is empty",
    ] {
        assert!(all_of(&table).contains(words), "{words}: {}", all_of(&table));
    }
    assert_eq!(values["missing"], serde_json::json!(["2/3", "3/3"]));
    let core_hours = values["core_hours"].as_f64().unwrap();
    let planned = values["plan"]["core_hours"].as_f64().unwrap();
    assert!(core_hours > 0.0 && (planned / core_hours - 5000.0).abs() < 1e-6, "{values}");
    assert!(values["left_s"].as_f64().unwrap() > 0.0 && values["changed_unix_s"].is_number());
    assert_eq!(merged.status.code(), Some(0));
    assert!(all_of(&merged).contains("without the shards 2/3, 3/3"), "{}", all_of(&merged));
}

/// A line that two writers have damaged costs its run alone: `merge` leaves it out, and the next
/// task repeats the run.
#[test]
fn damaged_line_costs_only_its_run() {
    let folder = Folder::new("cluster-damaged");
    let args = [&IDLE[..], &["--runs", "3", "--state", folder.path()]].concat();
    let whole = object(&robot("", &args), 0);
    let file = folder.file("shard-1-of-1.jsonl");
    let text = std::fs::read_to_string(&file).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let cut = format!("{}\n{}\n{}\n{}\n", lines[0], lines[1], &lines[2][90..], lines[3]);
    std::fs::write(&file, cut).unwrap();

    let merged = robot("", &["campaign", "merge", folder.path(), "--json"]);
    let again = robot("", &args);

    assert_eq!(object(&merged, 0)["runs"], 2);
    assert!(all_of(&merged).contains("1 damaged lines are left out"), "{}", all_of(&merged));
    assert_eq!(object(&again, 0), whole);
    let words = "has 2 of 3 runs, the campaign continues; 1 damaged lines are left out";
    assert!(all_of(&again).contains(words), "{}", all_of(&again));
}

#[test]
fn unclear_shards_and_folders_are_refused() {
    let folder = Folder::new("cluster-refused");
    let path = folder.path();
    let auto = [&IDLE[..], &["--runs", "5", "--shard", "auto"]].concat();
    let both = format!("{} JOB_COMPLETION_INDEX=0 JOB_COMPLETIONS=2", task(0, 2));
    let gaps = task(0, 2).replace("MAX=1", "MAX=7");
    let nowhere = [&IDLE[..], &["--runs", "5", "--state", "no/such/"]].concat();
    let odd = [&IDLE[..], &["--runs", "5", "--shard", "auto/2"]].concat();
    for (environment, args, reason) in [
        ("", &auto[..], "JOB_COMPLETION_INDEX (an indexed job of Kubernetes)"),
        ("PARALLEL_SEQ=3", &auto, "--shard {#}/{##}"),
        ("JOB_COMPLETION_INDEX=3", &auto, "JOB_COMPLETIONS"),
        (both.as_str(), &auto, "are all set"),
        (gaps.as_str(), &auto, "has gaps"),
        ("", &odd, "or auto"),
        ("", &nowhere, "there is no folder no/such/"),
        ("", &["campaign", "status", path], "it is a folder without a file shard-K-of-N.jsonl"),
        ("", &["campaign", "merge", path], "it is a folder without a file shard-K-of-N.jsonl"),
        ("", &["campaign", "status", "no/such"], "cannot read no/such"),
        ("", &["campaign", "status", path, "--cores", "5"], "--plan"),
    ] {
        let out = robot(environment, args);
        assert_eq!(out.status.code(), Some(2), "{environment} {args:?}: {}", all_of(&out));
        assert!(all_of(&out).contains(reason), "{environment} {args:?}: {}", all_of(&out));
    }
}

/// The script for Slurm performs the shard of its task as `sbatch` starts it, and makes the folder.
#[test]
fn sbatch_script_performs_shard_of_its_task() {
    let folder = Folder::new("cluster-sbatch");
    let shards = folder.file("shards");
    let sbatch = |args: &[&str]| {
        let mut script = Command::new("bash");
        script.arg("packaging/slurm/campaign.sbatch").args(args).stdin(Stdio::null());
        script.current_dir(env!("CARGO_MANIFEST_DIR"));
        let environment = format!("RUBIK_ROBOT={}", env!("CARGO_BIN_EXE_rubik-robot"));
        within(script, &format!("{} {environment}", task(1, 2))).output().unwrap()
    };

    let done = sbatch(&[&[shards.as_str()], &IDLE[1..], &["--runs", "3"]].concat());

    assert_eq!(object(&done, 0)["runs"], 1);
    assert!(Path::new(&shards).join("shard-2-of-2.jsonl").is_file());
    assert_eq!(sbatch(&[shards.as_str()]).status.code(), Some(2));
}

/// The file for Kubernetes gives the number of pods to the campaign, and its arguments are valid:
/// only the volume is missing here.
#[test]
fn kubernetes_job_is_consistent() {
    let job = include_str!("../../packaging/kubernetes/job.yaml");
    let after = |key: &str| {
        let value = job.split_once(key).unwrap().1.lines().next().unwrap();
        value.trim().trim_matches('"').to_owned()
    };
    let pods = after("\n  completions:");
    let variable = job.split_once("- name: JOB_COMPLETIONS").unwrap().1;
    let count = variable.split_once("value:").unwrap().1.lines().next().unwrap();
    let args = job.split_once("args: [").unwrap().1.split_once(']').unwrap().0;
    let args: Vec<&str> = args.split(',').map(|word| word.trim().trim_matches('"')).collect();

    let out = robot(&format!("JOB_COMPLETION_INDEX=7 JOB_COMPLETIONS={pods}"), &args);

    assert_eq!(count.trim().trim_matches('"'), pods);
    assert_eq!(out.status.code(), Some(2), "{}", all_of(&out));
    assert!(all_of(&out).contains("there is no folder /campaign/"), "{}", all_of(&out));
}
