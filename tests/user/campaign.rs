//! Campaigns on the command line: many runs in processes of their own, interrupted, resumed,
//! divided into shards and merged.

use crate::program::program;
use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Runs the program with these arguments to its end.
fn robot(args: &[&str]) -> Output {
    program().args(args).output().unwrap()
}

/// Returns an output as text.
fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// Returns the text that the program has written to stderr.
fn stderr_of(out: &Output) -> &str {
    text(&out.stderr)
}

/// Checks the exit code and returns the JSON object in the last line of stdout.
fn object(out: &Output, code: i32) -> Value {
    assert_eq!(out.status.code(), Some(code), "{}\n{}", text(&out.stderr), text(&out.stdout));
    serde_json::from_str(text(&out.stdout).lines().last().unwrap()).unwrap()
}

/// Temporary file, which is removed when the test ends.
struct Place(PathBuf);

impl Place {
    /// Returns the path of a file that does not exist yet, whose name ends with `name`.
    fn new(name: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("rubik-campaign-{}-{name}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        Self(path)
    }

    /// Writes a file with this text, whose name ends with `name`.
    fn with(name: &str, text: &str) -> Self {
        let place = Self::new(name);
        std::fs::write(&place.0, text).unwrap();
        place
    }

    /// Returns the path of the file.
    fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Arguments of a campaign whose runs idle for a second.
const IDLE: [&str; 5] = ["campaign", "scenarios/idle.toml", "--set", "idle.time_s=1", "--json"];

/// Runs a campaign of the idle task with further arguments.
fn idle(more: &[&str]) -> Output {
    robot(&[&IDLE[..], more].concat())
}

#[test]
fn campaign_of_three_runs_prints_one_json_object() {
    // `--at-least 1` demands that every run is solved.
    let done = object(&idle(&["--runs", "3", "--seed", "40", "--at-least", "1"]), 0);

    assert_eq!((&done["runs"], &done["solved"]), (&3.into(), &3.into()));
    assert_eq!(done["failures"], Value::Array(vec![]));
    // Lower bound of the Wilson interval of n out of n: n / (n + z^2).
    assert!((done["interval"][0].as_f64().unwrap() - 0.438_503).abs() < 1e-6);
    // Idle arms touch nothing: no contact exceeds the limit of the scenario, and no cube falls.
    assert_eq!(done["peak_contact_n"]["max"], 0.0);
    assert_eq!(done["force_limit_n"]["min"], 20.0);
    for name in [
        "runs_above_force_limit",
        "drops",
        "runs_with_unnoticed_drops",
        "contact_unknown",
        "without_verdict",
    ] {
        assert_eq!(done[name], 0, "{name}");
    }
    for name in ["peak_force_n", "grasps", "turns", "sim_time_s"] {
        for part in ["min", "median", "p95", "max"] {
            assert!(done[name][part].is_number(), "{name}.{part}");
        }
    }
    assert!((done["sim_time_s"]["median"].as_f64().unwrap() - 1.0).abs() < 0.05);
}

/// Numbers of the task and of its judge are in `--json`, in the table and in the report, and the
/// loads of the bar count as contacts.
#[test]
fn campaign_reports_figures_of_task() {
    let report = std::env::temp_dir().join(format!("figures-{}.html", std::process::id()));
    let scenario = ["campaign", "scenarios/three_arms.toml", "--runs", "2", "--seed", "3"];
    let done = object(&robot(&[&scenario[..], &["--json"]].concat()), 0);
    let table = robot(&[&scenario[..], &["-o", report.to_str().unwrap()]].concat());

    let figure = |name: &str, part: &str| done["figures"][name][part].as_f64().unwrap();
    assert!((figure("carried_s", "min") - 18.0).abs() < 1.0, "{done}");
    assert_eq!((figure("rounds[0]", "min"), figure("rounds[0]", "max")), (4.0, 4.0));
    assert!(figure("internal_p99_n", "max") < 15.0, "{done}");
    let contact = done["peak_contact_n"]["max"].as_f64().unwrap();
    assert!(contact > figure("internal_p99_n", "max"), "{contact} N: each hand bears half the bar");
    let html = std::fs::read_to_string(&report).unwrap();
    std::fs::remove_file(&report).unwrap();
    for text in [String::from_utf8_lossy(&table.stdout), html.into()] {
        assert!(text.to_lowercase().contains("carried [s]"), "{text}");
    }
}

/// The report lists a command for each failed run. The command repeats only this run, which fails
/// for the same reason. The HTML report contains the command too.
#[test]
fn report_lists_seed_phase_and_command_of_failure() {
    let page = Place::new("report.html");
    let run =
        ["campaign", "scenarios/face_turn.toml", "--runs", "1", "--seed", "5", "--json", "-o"];
    let run = [&run[..], &[page.path(), "--set", "control.compliance=none"]].concat();

    let done = object(&robot(&run), 0);
    // A campaign of failed runs exits with 0: only `--at-least` judges the results.
    let short = robot(&[&run[..], &["--at-least", "0.5"]].concat());
    assert_eq!(object(&short, 1), done);

    let failure = &done["failures"][0];
    assert_eq!((&failure["seed"], &done["solved"]), (&5.into(), &0.into()));
    assert!(!failure["phase"].as_str().unwrap().is_empty());
    let command = failure["command"].as_str().unwrap().strip_prefix("rubik-robot ").unwrap();
    let words: Vec<&str> = command.split(' ').chain(["--json"]).collect();
    let again = robot(&words);
    assert_ne!(again.status.code(), Some(0));
    let again: Value = serde_json::from_str(text(&again.stdout).lines().last().unwrap()).unwrap();
    assert_eq!(again["reason"], failure["reason"]);
    assert!(std::fs::read_to_string(page.path()).unwrap().contains(command));
}

/// A state file that ends amid its third result: the campaign repeats only the runs without a
/// complete result, and the object equals that of an uninterrupted campaign.
#[test]
fn campaign_resumes_from_a_truncated_state_file() {
    let (state, other) = (Place::new("cut.jsonl"), Place::new("other.jsonl"));
    let run = ["--runs", "4", "--state", state.path()];
    let whole = object(&idle(&run), 0);
    let state_text = std::fs::read_to_string(state.path()).unwrap();
    assert_eq!(state_text.lines().count(), 5);

    // Cut the file in the middle of the third result.
    let third = state_text.match_indices('\n').nth(2).unwrap().0;
    std::fs::write(state.path(), &state_text[..third + 40]).unwrap();
    let out = idle(&run);

    assert_eq!(object(&out, 0), whole);
    let stderr = text(&out.stderr);
    assert!(
        stderr.contains("has 2 of 4 runs, the campaign continues; its last line was cut"),
        "{stderr}"
    );
    assert!(stderr.contains("campaign: 2 runs"), "{stderr}");
    assert_eq!(std::fs::read_to_string(state.path()).unwrap().lines().count(), 5);
    // A complete campaign runs nothing more. `--resume` is an alias of `--state`.
    assert_eq!(object(&idle(&["--runs", "4", "--resume", state.path()]), 0), whole);

    // A campaign with other seeds is refused, and a file that is no state file stays unchanged.
    let wrong = idle(&["--runs", "4", "--seed", "2", "--state", state.path()]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(text(&wrong.stderr).contains("differ in first seeds"), "{}", text(&wrong.stderr));
    std::fs::write(other.path(), "my notes\n").unwrap();
    assert_eq!(idle(&["--runs", "4", "--state", other.path()]).status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(other.path()).unwrap(), "my notes\n");
}

#[test]
fn resumed_campaign_accepts_more_but_not_fewer_runs() {
    let state = Place::new("longer.jsonl");
    let run = |runs| idle(&["--state", state.path(), "--seed", "7", "--runs", runs]);
    assert_eq!(object(&run("2"), 0)["runs"], 2);
    let whole = object(&idle(&["--seed", "7", "--runs", "4"]), 0);

    let longer = run("4");
    assert!(text(&longer.stderr).contains("campaign: 2 runs"), "{}", text(&longer.stderr));
    assert_eq!(object(&longer, 0), whole);
    assert_eq!(object(&run("4"), 0), whole);
    assert_eq!(object(&robot(&["campaign", "merge", state.path(), "--json"]), 0), whole);
    let fewer = run("2");
    assert_eq!(fewer.status.code(), Some(2));
    assert!(text(&fewer.stderr).contains("--runs 4 or more"), "{}", text(&fewer.stderr));
}

/// State files of another shard, of another build, and of a campaign that is still writing: each is
/// refused with its reason and stays unchanged.
#[test]
fn campaign_refuses_mismatched_or_locked_state_file() {
    let state = Place::new("theirs.jsonl");
    let run = ["--runs", "2", "--state", state.path(), "--shard"];
    assert_eq!(idle(&[&run[..], &["1/2"]].concat()).status.code(), Some(0));
    let kept = std::fs::read_to_string(state.path()).unwrap();
    let refused = |shard: &str, reason: &str| {
        let before = std::fs::read_to_string(state.path()).unwrap();
        let out = idle(&[&run[..], &[shard]].concat());
        let stderr = text(&out.stderr);
        assert!(out.status.code() == Some(2) && stderr.contains(reason), "{reason}: {stderr}");
        assert_eq!(std::fs::read_to_string(state.path()).unwrap(), before, "{reason}");
    };

    refused("2/2", "of shard 1/2, not 2/2");
    let header: Value = serde_json::from_str(kept.lines().next().unwrap()).unwrap();
    let build = header["campaign"]["build"].as_str().unwrap();
    std::fs::write(state.path(), kept.replacen(build, "another", 1)).unwrap();
    refused("1/2", "of another build of this program");
    std::fs::write(state.path(), &kept).unwrap();
    let file = std::fs::File::options().append(true).open(state.path()).unwrap();
    file.lock().unwrap();
    refused("1/2", "another campaign is writing it");
}

/// Starts a campaign of the idle task and interrupts it at the first line of stderr that `begun`
/// accepts. Returns the exit code and the JSON object in the last line of stdout.
fn interrupted(args: &[&str], mut begun: impl FnMut(&str) -> bool) -> (Option<i32>, Value) {
    use std::io::{BufRead as _, BufReader};
    let mut campaign = program()
        .args([&IDLE[..], args].concat())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(campaign.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.any(|line| begun(&line)), "it was over before it was interrupted");
    let process = rustix::process::Pid::from_child(&campaign);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    std::thread::spawn(move || lines.for_each(drop));
    let out = campaign.wait_with_output().unwrap();
    let done = serde_json::from_str(text(&out.stdout).lines().last().unwrap()).unwrap();
    (out.status.code(), done)
}

/// SIGINT ends a soak and a campaign with exit code 130. The results until then are printed and
/// kept in the state file.
#[test]
fn interrupt_ends_a_campaign_with_partial_results() {
    let soak = ["--soak", "1000", "--set", "idle.time_s=30"];
    let (code, done) = interrupted(&soak, |line| line.contains("times real time"));
    assert_eq!((code, &done["steady"]), (Some(130), &false.into()), "{done}");

    let state = Place::new("interrupted.jsonl");
    // A failed run is reported at once, so its line shows that the campaign is under way.
    let drawn = Place::with(
        "now.toml",
        "fault = { one_of = [[{ kind = \"emergency_stop\", at_s = 0.5 }]] }\n",
    );
    let runs = ["--runs", "1000", "--state", state.path(), "--vary", drawn.path()];
    let (code, done) = interrupted(&runs, |line| line.contains("seed 1 aborted"));
    assert_eq!(code, Some(130));
    let runs = done["runs"].as_u64().unwrap();
    assert!((1..1000).contains(&runs), "{runs}");
    let kept = std::fs::read_to_string(state.path()).unwrap();
    assert_eq!(kept.lines().count() as u64, runs + 1, "a header and the reported runs");
}

#[test]
fn merged_shards_equal_the_whole_campaign() {
    let vary = Place::with(
        "vary.toml",
        "idle.time_s = { uniform = [0.5, 1.5] }\n\
         plant.cube_kind = { one_of = [\"2007\", \"dry\"] }\n",
    );
    let run = ["campaign", "scenarios/idle.toml", "--json", "--runs", "5", "--vary", vary.path()];
    let whole = object(&robot(&run), 0);
    let parts = ["1/2", "2/2"].map(|shard| {
        let place = Place::new(&format!("shard{}.jsonl", &shard[..1]));
        let part = [&run[..], &["--shard", shard, "--state", place.path()]].concat();
        assert_eq!(robot(&part).status.code(), Some(0));
        place
    });

    let merged = robot(&["campaign", "merge", parts[1].path(), parts[0].path(), "--json"]);

    assert_eq!(object(&merged, 0), whole);
    let times = &whole["sim_time_s"];
    assert!(times["min"].as_f64().unwrap() < times["max"].as_f64().unwrap(), "nothing was drawn");
    // A merge of one shard names the missing shard and fails `--at-least`.
    let merge = ["campaign", "merge", parts[0].path()];
    let half = robot(&merge);
    assert_eq!(half.status.code(), Some(0));
    assert!(text(&half.stdout).contains("3 of 5"), "{}", text(&half.stdout));
    assert!(text(&half.stderr).contains("shards 2/2\n"), "{}", text(&half.stderr));
    let short = robot(&[&merge[..], &["--at-least", "0.9"]].concat());
    assert_eq!(short.status.code(), Some(1));
    assert!(text(&short.stderr).contains("is not reached: 3 of 5 runs"), "{}", text(&short.stderr));
}

#[test]
fn run_beyond_its_time_limit_counts_as_failure() {
    let endless = ["campaign", "scenarios/idle.toml", "--set", "pace=real-time"];
    let limits = ["--set", "idle.time_s=3600", "--runs", "2", "--limit-s", "2", "--json"];
    let out = robot(&[&endless[..], &limits].concat());

    let done = object(&out, 0);
    assert_eq!((&done["runs"], &done["solved"]), (&2.into(), &0.into()));
    assert_eq!(done["failures"][0]["reason"], "no end within 2 s");
    assert_eq!(done["failures"][1]["phase"], "idle");
    assert_eq!(done["sim_time_s"]["max"], Value::Null);
}

#[test]
fn campaign_rejects_bad_arguments_before_the_first_run() {
    let vary = Place::with("wrong.toml", "control.gripp_n = { uniform = [20, 30] }\n");
    let range = Place::with("range.toml", "idle.time_s = { uniform = [-5, -1] }\n");
    for (args, reason) in [
        (&["campaign", "scenarios/idle.toml"][..], "--runs"),
        (&["campaign", "--runs", "3"], "SCENARIO"),
        (&["campaign", "scenarios/nosuch.toml", "--runs", "3"], "no such file"),
        (&["campaign", "scenarios/idle.toml", "--runs", "0"], "0"),
        (
            &["campaign", "scenarios/idle.toml", "--runs", "3", "--shard", "4/3"],
            "4/3 is not a shard",
        ),
        (&["campaign", "scenarios/idle.toml", "--runs", "3", "--at-least", "99"], "99 is no share"),
        (&["campaign", "scenarios/idle.toml", "--runs", "3", "--vary", vary.path()], "grip_n"),
        (
            &["campaign", "scenarios/idle.toml", "--runs", "3", "--vary", range.path()],
            "seed 1 draws",
        ),
        (&["campaign", "scenarios/hardware.toml", "--runs", "3"], "simulated plant"),
        (&["campaign", "merge"], "FILES"),
        (&["campaign", "merge", "scenarios/idle.toml"], "not the state file of a campaign"),
        (&["campaign", "scenarios/idle.toml", "--soak=-1"], "hours"),
        (&["campaign", "scenarios/idle.toml", "--runs", "3", "-o", "."], ". is a folder"),
        (
            &["campaign", "scenarios/idle.toml", "--runs", "3", "-o", "/proc/r.html"],
            "/proc/r.html:",
        ),
        (&["campaign", "scenarios/idle.toml", "--runs", "3", "-o", "no/r.html"], "no folder no"),
        (&["campaign", "scenarios/idle.toml", "--runs", "3", "--set", "seed=4"], "seed of its own"),
        (&["campaign", "scenarios/idle.toml", "--soak=1", "--set", "seed = 4"], "seed of its own"),
        (&["benchmark", "--tier", "1-1", "-o", "src"], "src is a folder"),
        (&["benchmark", "--tier", "1-1", "--set", "seed=4"], "seed of its own"),
        (&["campaign", "scenarios/idle.toml", "--soak=1", "--at-least", "99"], "99 is no share"),
        (&["benchmark"], "--mission"),
        (&["benchmark", "--tier", "5"], "is not a tier"),
        (&["benchmark", "--tier", "1-1", "--scenario", "scenarios/face_turn.toml"], "\"solve\""),
        (&["benchmark", "--tier", "1-1", "--clearance-mm", "9000"], "less than 9000 mm"),
    ] {
        let out = robot(args);
        let stderr = text(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains(reason), "{args:?}: no `{reason}` in\n{stderr}");
        assert_eq!(text(&out.stdout), "", "{args:?}");
    }
}

#[test]
fn shipped_variation_files_give_valid_scenarios() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios/vary");
    let files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path()).collect();
    assert!(files.len() >= 2, "{files:?}");
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let vary = rubik_robot::campaign::vary::Variations::read(&path, &text).unwrap();
        let scenario = include_str!("../../scenarios/solve.toml");
        for seed in 0..50 {
            let overrides: Vec<_> = vary
                .draw(seed)
                .iter()
                .map(|d| rubik_robot::scenario::Override::parse(&d.option()).unwrap())
                .collect();
            let read = rubik_robot::tasks::read("solve.toml".as_ref(), scenario, &overrides);
            assert!(read.is_ok(), "{}", read.unwrap_err());
        }
    }
}

/// Faults are drawn for each run, so some runs fail and some do not. The report's command for a
/// failed run has its faults. A drawn fault with an unknown kind is refused with its place in the
/// file.
#[test]
fn random_faults_of_run_appear_in_repeat_command() {
    // The value spans lines and has a comment; the command must hold it in one line.
    let stop = "fault = { one_of = [[], [ # now and then\n  \
        { kind = \"emergency_stop\", at_s = 0.5 },\n]] }\n";
    let vary = Place::with("faults.toml", stop);
    let done = object(&idle(&["--runs", "6", "--vary", vary.path()]), 0);

    let failures = done["failures"].as_array().unwrap();
    assert!(!failures.is_empty() && done["solved"].as_u64().unwrap() > 0, "{done}");
    let command = failures[0]["command"].as_str().unwrap();
    assert!(command.contains("--set 'fault=[{") && !command.contains('\n'), "{command}");
    let program = env!("CARGO_BIN_EXE_rubik-robot");
    let again = Command::new("sh")
        .args(["-c", &format!("{} --json", command.replacen("rubik-robot", program, 1))])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert_eq!(object(&again, 3)["reason"], failures[0]["reason"]);

    let wrong = Place::with("slipp.toml", "fault = { one_of = [[{ kind = \"slipp\" }]] }\n");
    let out = idle(&["--runs", "2", "--vary", wrong.path()]);
    let stderr = text(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("slipp.toml:1:21: `fault.0.kind`") && stderr.contains("\"slip\"?"),
        "{stderr}"
    );
}

/// A push of 45 N counts as a contact above the limit of 20 N. A dropped cube counts as noticed if
/// the mission continues after it and solves the cube.
#[test]
fn campaign_counts_dropped_cubes_and_excessive_contact_forces() {
    let fault = "fault=[{kind=\"drop\",arm=\"track\",at_s=30},\
                 {kind=\"push\",arm=\"track\",event=\"turned\",turned_deg=30,\
                 duration_s=0.5,magnitude=45}]";
    let run = ["campaign", "scenarios/solve.toml", "--runs", "1", "--json", "--set", fault];
    let done = object(&robot(&run), 0);

    assert!(done["peak_contact_n"]["max"].as_f64().unwrap() > 20.0, "{done}");
    assert_eq!((&done["runs_above_force_limit"], &done["drops"]), (&1.into(), &1.into()));
    assert_eq!((&done["runs_with_unnoticed_drops"], &done["solved"]), (&0.into(), &1.into()));
}

/// `ulimit -f 1` simulates a full disk. The older report stays unchanged and no partial file
/// remains.
#[test]
fn failed_report_write_keeps_the_older_report() {
    let page = Place::with("room.html", "an older report\n");
    // With SIGXFSZ ignored, a write beyond the limit fails with EFBIG instead of ending the
    // process.
    let limited = "trap '' XFSZ; ulimit -f 1; exec \"$0\" \"$@\"";
    let out = Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_rubik-robot")])
        .args([&IDLE[..], &["--runs", "1", "-o", page.path()]].concat())
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .output()
        .unwrap();

    let stderr = text(&out.stderr);
    assert!(stderr.contains(page.path()) && stderr.contains("File too large"), "{stderr}");
    assert_ne!(out.status.code(), Some(0));
    // The results are printed nevertheless.
    let done: Value = serde_json::from_str(text(&out.stdout).lines().last().unwrap()).unwrap();
    assert_eq!(done["solved"], 1);
    assert_eq!(std::fs::read_to_string(page.path()).unwrap(), "an older report\n");
    assert!(!std::path::Path::new(&format!("{}.part", page.path())).exists());
}

#[test]
fn soak_reports_drift_and_memory_of_ten_intervals() {
    let out = idle(&["--soak", "0.01"]);

    let done = object(&out, 0);
    assert_eq!(done["tenths"].as_array().unwrap().len(), 10);
    assert_eq!((&done["steady"], &done["drift_s"]), (&true.into(), &0.0.into()));
    // 0.01 h are 36 missions of a second; the first four have seeds of their own.
    assert_eq!((&done["runs"], &done["repeated"]), (&36.into(), &32.into()));
    assert!(done["tenths"][9]["resident_mib"].as_f64().unwrap() > 1.0);
}

/// A soak fails if its missions are not solved, unless `--at-least 0` permits it, and if no mission
/// was repeated, because then there is nothing to compare.
#[test]
fn soak_fails_if_missions_are_unsolved_or_unrepeated() {
    let scenario =
        ["campaign", "scenarios/face_turn.toml", "--set", "control.compliance=none", "--seed", "5"];
    let gently = ["--set", "control.profile=workshop"];
    // A mission takes 4 s, so it runs twice in 0.002 h and once in 0.001 h.
    let soak = |hours, more: &[&str]| {
        let soak = [&["--soak", hours, "--soak-seeds", "1"], more].concat();
        let out = robot(&[&scenario[..], &gently, &soak].concat());
        (out.status.code(), stderr_of(&out).to_owned())
    };

    let (code, stderr) = soak("0.002", &[]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("2 of 2 missions were not solved; --at-least 1"), "{stderr}");
    let (code, stderr) = soak("0.002", &["--at-least", "0"]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(!stderr.contains("were not solved"), "{stderr}");
    let (code, stderr) = soak("0.001", &["--at-least", "0"]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("not steady: no mission was repeated"), "{stderr}");
}

/// A tier of the benchmark runs from any working directory. Its figures equal those of one run of
/// the same scenario, seed and cube, and appear in the protocol.
#[test]
fn benchmark_tier_reports_same_figures_as_single_run() {
    use rubik_robot::campaign::benchmark::{scramble, scrambled};
    let protocol = Place::new("protocol.md");
    let elsewhere =
        |args: &[&str]| program().args(args).current_dir(std::env::temp_dir()).output().unwrap();
    let out = elsewhere(&["benchmark", "--tier", "1-2", "--json", "-o", protocol.path()]);
    let done = object(&out, 0);
    let cube = format!("cube.state=\"{}\"", scrambled(&scramble(2, 1)));
    let alone = elsewhere(&[
        "run",
        "shipped:table",
        "--json",
        "--ui",
        "none",
        "--seed",
        "1",
        "--set",
        &cube,
    ]);
    let plant = object(&alone, 0);

    let (score, campaign) = (&done["score"], &done["campaign"]);
    assert_eq!(
        (&done["benchmark"], &done["start"]),
        (&"Rubiks-1-2".into(), &"on the table".into())
    );
    assert_eq!((&score["trials_passed"], &score["passed"]), (&1.into(), &true.into()));
    assert_eq!(campaign["scenario"], "shipped:table");
    for name in ["peak_force_n", "sim_time_s"] {
        assert_eq!(campaign[name]["max"], plant[name], "{name}");
    }
    for name in ["turns", "grasps"] {
        assert_eq!(campaign[name]["max"].as_f64(), plant[name].as_f64(), "{name}");
    }
    let contacts =
        plant["sensors"].as_array().unwrap().iter().map(|s| s["force_n"].as_f64().unwrap());
    let contact = contacts.fold(0.0, f64::max);
    assert_eq!(campaign["peak_contact_n"]["max"], contact);
    assert_eq!(score["trial_s"]["median"], plant["sim_time_s"]);
    let clearance = plant["clearance_mm"].as_f64().unwrap();
    assert_eq!(done["clearances"], serde_json::json!([{ "seed": 1, "clearance_mm": clearance }]));
    // The threshold applies to the believed cell; the plant differs from it by a few millimetres.
    assert!(clearance > 1e3 * done["clearance_m"].as_f64().unwrap() - 10.0, "{clearance}");

    let protocol_text = std::fs::read_to_string(protocol.path()).unwrap();
    let number = |name: &str| plant[name].as_f64().unwrap();
    let row = format!(
        "| solved | {} | {} | {:.1} | {:.1} | {contact:.1} | {clearance:.1} |",
        plant["turns"],
        plant["grasps"],
        number("sim_time_s"),
        number("peak_force_n")
    );
    for part in [
        "# Protocol: Rubiks-1-2, passed\n",
        "| Scenario | `shipped:table` (built into the program), sum ",
        "--tier 1-2 --scenario shipped:table --seed 1",
        &format!("to the cube's centre: {clearance:.0} to {clearance:.0} mm."),
        "Accuracy: **1 of 1** trials passed",
        &row,
    ] {
        assert!(protocol_text.contains(part), "no `{part}` in\n{protocol_text}");
    }
}

/// Starts a campaign of four short runs, one at a time, and waits for the first result in its state
/// file. Returns the process of the campaign.
fn under_way(mut program: Command, scenario: &str, state: &Place) -> std::process::Child {
    let mut campaign = program
        .args(["campaign", scenario, "--runs", "4", "--jobs", "1", "--state", state.path()])
        .args(["--set", "pace=real-time", "--set", "idle.time_s=0.5", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while results(state) == 0 {
        assert_eq!(campaign.try_wait().unwrap(), None, "it ended by itself");
        std::thread::sleep(Duration::from_millis(20));
    }
    campaign
}

/// Counts the results in a state file.
fn results(state: &Place) -> usize {
    let kept = std::fs::read_to_string(state.path()).unwrap_or_default();
    kept.lines().count().saturating_sub(1)
}

/// The file of the program is replaced while the campaign runs. The later runs still use the old
/// program.
#[test]
fn running_campaign_ignores_replacement_of_its_executable() {
    let (own, other) = (Place::new("own-program"), Place::with("other", "#!/bin/sh\nexit 9\n"));
    std::fs::copy(env!("CARGO_BIN_EXE_rubik-robot"), own.path()).unwrap();
    let executable = std::fs::metadata(own.path()).unwrap().permissions();
    std::fs::set_permissions(other.path(), executable).unwrap();
    let state = Place::new("rebuilt.jsonl");
    let mut program = Command::new(own.path());
    program.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(Stdio::null());

    let campaign = under_way(program, "scenarios/idle.toml", &state);
    std::fs::rename(other.path(), own.path()).unwrap();

    let done = object(&campaign.wait_with_output().unwrap(), 0);
    assert_eq!((&done["runs"], &done["solved"]), (&4.into(), &4.into()), "{done}");
}

/// The file of the servo profile that the scenario names changes during the campaign.
#[test]
fn changed_servo_profile_of_scenario_ends_the_campaign() {
    let profile = include_str!("../../scenarios/arms/irp6_servo.toml");
    let gains = Place::with("gains.toml", profile);
    let name = gains.0.file_name().unwrap().to_str().unwrap();
    let text = include_str!("../../scenarios/idle.toml").to_owned();
    let scenario = Place::with("given.toml", &format!("{text}servo_profile = \"{name}\"\n"));
    let state = Place::new("changed.jsonl");

    let campaign = under_way(program(), scenario.path(), &state);
    let changed = profile.replacen("pwm_limit = 190.0", "pwm_limit = 189.0", 1);
    assert_ne!(changed, profile);
    std::fs::write(gains.path(), changed).unwrap();

    let out = campaign.wait_with_output().unwrap();
    let stderr = stderr_of(&out);
    assert_eq!(out.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("given.toml, or a file that it names, has changed since"), "{stderr}");
    assert!((1..4).contains(&results(&state)), "{stderr}");
    // A second start with the same state file is refused as well.
    let run = ["campaign", scenario.path(), "--runs", "4", "--jobs", "1", "--state", state.path()];
    let later =
        robot(&[&run[..], &["--set", "pace=real-time", "--set", "idle.time_s=0.5"]].concat());
    assert_eq!(later.status.code(), Some(2));
    assert!(stderr_of(&later).contains("whose contents differ"), "{}", stderr_of(&later));
}

/// Shards of two builds can be merged, but they are no measurement of one program.
#[test]
fn success_threshold_rejects_shards_of_different_builds() {
    let parts = ["1/2", "2/2"].map(|shard| {
        let place = Place::new(&format!("build{}.jsonl", &shard[..1]));
        let part = ["--runs", "2", "--shard", shard, "--state", place.path()];
        assert_eq!(idle(&part).status.code(), Some(0));
        place
    });
    let merge = ["campaign", "merge", parts[0].path(), parts[1].path(), "--json"];
    let judged = [&merge[..], &["--at-least", "1"]].concat();
    let one = object(&robot(&judged), 0);
    let build = one["build"].as_str().unwrap();
    let kept = std::fs::read_to_string(parts[1].path()).unwrap();
    std::fs::write(parts[1].path(), kept.replacen(build, "another", 1)).unwrap();

    assert_eq!(object(&robot(&merge), 0)["build"], "several");
    let several = robot(&judged);
    assert_eq!(object(&several, 1)["solved"], 2);
    let stderr = stderr_of(&several);
    assert!(stderr.contains("is not reached: the runs of different builds are no"), "{stderr}");
}

/// Returns the ids of the child processes of the process with the id `of`.
fn children(of: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{of}/task")).unwrap();
    let lists =
        threads.filter_map(|t| std::fs::read_to_string(t.unwrap().path().join("children")).ok());
    lists
        .flat_map(|l| l.split_whitespace().map(|p| p.parse().unwrap()).collect::<Vec<_>>())
        .collect()
}

/// Returns whether the process with this id exists and is not a zombie.
fn lives(process: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    stat.rsplit(')').next().is_some_and(|rest| !rest.is_empty() && !rest.starts_with(" Z"))
}

#[test]
fn killed_campaign_leaves_no_run_processes_alive() {
    let mut campaign = program()
        .args(["campaign", "scenarios/idle.toml", "--runs", "2", "--jobs", "2"])
        .args(["--set", "pace=real-time", "--set", "idle.time_s=60"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut runs = Vec::new();
    while runs.len() < 2 {
        assert_eq!(campaign.try_wait().unwrap(), None, "it ended by itself");
        std::thread::sleep(Duration::from_millis(20));
        runs = children(campaign.id());
    }
    std::thread::sleep(Duration::from_millis(500));
    assert!(runs.iter().all(|run| lives(*run)));

    campaign.kill().unwrap();
    campaign.wait().unwrap();

    let begun = Instant::now();
    while runs.iter().any(|run| lives(*run)) {
        assert!(begun.elapsed() < Duration::from_secs(20), "{runs:?} go on alone");
        std::thread::sleep(Duration::from_millis(20));
    }
}
