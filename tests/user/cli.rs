//! The command line: exit codes, stdout and stderr, closed pipes, refused arguments and files.

use crate::program::program;
use std::io::Write;
use std::process::{Output, Stdio};

/// Runs the program with these arguments and an empty stdin to its end.
fn robot(args: &[&str]) -> Output {
    with_input(args, "")
}

/// Runs the program with these arguments and with `input` on stdin to its end.
fn with_input(args: &[&str], input: &str) -> Output {
    let mut child = program()
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A program that does not read its input may have closed it.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap()
}

/// Returns an output as text.
fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// Scenario file, which is removed when the test ends.
struct Scenario(std::path::PathBuf);

impl Scenario {
    /// Writes a file with this text, whose name contains `name`.
    fn new(name: &str, text: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("rubik-robot-{}-{name}.toml", std::process::id()));
        std::fs::write(&path, text).unwrap();
        Self(path)
    }

    /// Returns the path of the file.
    fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }
}

impl Drop for Scenario {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Returns the paths of the scenarios that the project ships.
fn scenarios() -> Vec<std::path::PathBuf> {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut files: Vec<_> = files.filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
    files.sort();
    assert!(files.len() >= 5, "{files:?}");
    files
}

#[test]
fn shipped_scenarios_are_valid_with_three_leading_comments() {
    for path in scenarios() {
        let out = robot(&["check", path.to_str().unwrap()]);
        assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));

        let scenario = std::fs::read_to_string(&path).unwrap();
        let opening = scenario.lines().take_while(|l| l.starts_with("# ")).count();
        assert_eq!(opening, 3, "{}", path.display());
    }
}

/// Unknown keys and wrong values are reported together, with their places and a suggestion.
#[test]
fn broken_scenario_lists_every_error_and_exits_2() {
    let broken = Scenario::new("broken", "taks = \"solve\"\n[cube]\nedge_mm = \"big\"\n");

    for command in ["check", "run"] {
        let out = robot(&[command, broken.path(), "--set", "control.gripp_n=3"]);

        assert_eq!(out.status.code(), Some(2));
        assert_eq!(text(&out.stdout), "");
        let stderr = text(&out.stderr);
        for wanted in [
            format!("{}:1:1: unknown key `taks`", broken.path()),
            format!("{}:3:11: `cube.edge_mm`: expected a number", broken.path()),
            "--set control.gripp_n: unknown key `gripp_n`".to_owned(),
            "did you mean `grip_n`?".to_owned(),
        ] {
            assert!(stderr.contains(&wanted), "no `{wanted}` in:\n{stderr}");
        }
    }
}

#[test]
fn invalid_arguments_exit_with_2_and_a_reason() {
    // The edge UF is flipped.
    let flipped = "UUUUUUUFURRRRRRRRRFUFFFFFFFDDDDDDDDDLLLLLLLLLBBBBBBBBB";
    for (args, reason) in [
        (&["run", "scenarios/nosuch.toml"][..], "there is no such file"),
        (&["run", "scenarios/solve.toml", "--cube", "UUU"], "3 letters"),
        (&["run", "scenarios/solve.toml", "--cube", flipped], "edge UF is flipped"),
        (&["run", "scenarios/solve.toml", "--seed", "many"], "--seed"),
        (&["run", "scenarios/solve.toml", "--set", "seed"], "has no `=`"),
        (&["run", "scenarios/solve.toml", "--set", "bridge.kind=isa"], "real time only"),
        (&["run"], "Usage"),
        (&["rnu"], "unrecognized subcommand"),
        (&["keys", "nosuch"], "no key"),
        (&["kinematics", "fk", "--arm", "left"], "track and postument"),
        (&["doctor", "--seconds", "nan"], "above 0"),
        (&["vision", "render", "x.toml", "--poses", "1", "-o", "x", "--noise", "nan"], "0 or more"),
        (&["vision", "locate", "p.png", "--cx", "inf"], "finite"),
    ] {
        let out = robot(args);
        assert_eq!(out.status.code(), Some(2), "{args:?}: {}", text(&out.stderr));
        assert!(text(&out.stderr).contains(reason), "{args:?}: {}", text(&out.stderr));
        assert_eq!(text(&out.stdout), "", "{args:?}");
    }
}

#[test]
fn invalid_speeds_and_addresses_exit_with_2() {
    for (more, word) in [
        (["--speed", "1e-300"], "--speed"),
        (["--speed", "0.001"], "--speed"),
        (["--listen", "everywhere"], "--listen everywhere"),
        (["--ui=none", "--listen=everywhere"], "--listen: --ui none has no page"),
        (["--ui=none", "--host=robot.example"], "--host: --ui none has no page"),
        // An address that is reserved for documentation, so no machine has it.
        (["--listen", "192.0.2.1:80"], "192.0.2.1"),
    ] {
        let output = robot(&[&["run", "scenarios/idle.toml", "--json"], &more[..]].concat());
        assert_eq!(output.status.code(), Some(2), "{more:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(word), "{more:?}: {}", text(&output.stderr));
    }
}

#[test]
fn help_shows_three_examples() {
    for args in
        [&["--help"][..], &["run", "--help"], &["check", "--help"], &["kinematics", "--help"]]
    {
        let out = robot(args);
        assert_eq!(out.status.code(), Some(0));
        // The line `Usage:` is no example.
        let is_example = |l: &&str| l.starts_with("  ") && l.contains("rubik-robot ");
        assert!(text(&out.stdout).lines().filter(is_example).count() >= 3, "{args:?}");
    }
}

/// Without a terminal the headings have no colours.
#[test]
fn help_lists_commands_in_groups() {
    let out = robot(&["--help"]);

    let lines: Vec<&str> = text(&out.stdout).lines().collect();
    for wanted in
        ["Run:", "  run          Run a scenario and print its summary", "Files:", "Options:"]
    {
        assert!(lines.contains(&wanted), "no `{wanted}` in:\n{}", text(&out.stdout));
    }
}

/// Texts of 100 columns are broken again, also in the columns of options. A command stays whole.
#[test]
fn helps_fit_into_eighty_columns() {
    let names = text(&robot(&["completions", "bash"]).stdout).to_owned();
    for command in [
        "run",
        "campaign",
        "benchmark",
        "emulate",
        "node",
        "weigh",
        "check",
        "keys",
        "parameters",
        "kinematics",
        "solve",
        "plan",
        "scramble",
        "tables",
        "vision",
        "doctor",
        "calibrate",
        "replay",
        "report",
        "export",
        "film",
        "recover",
        "merge",
        "urdf",
        "schema",
        "completions",
        "man",
        "picture",
    ] {
        assert!(names.contains(command), "{command}");
        let out = robot(&[command, "--help"]);
        for line in text(&out.stdout).lines() {
            let is_command = line.starts_with("  ") && line.contains("rubik-robot ");
            assert!(line.chars().count() <= 80 || is_command, "{command}: {line}");
        }
    }
}

#[test]
fn call_without_scenario_lists_the_scenarios() {
    let out = robot(&["run"]);

    let stderr = text(&out.stderr);
    assert_eq!(out.status.code(), Some(2), "{stderr}");
    for wanted in ["shipped:table ", "  face_turn ", "`rubik-robot run solve`"] {
        assert!(stderr.contains(wanted), "no `{wanted}` in:\n{stderr}");
    }
    let head = "  solve           The whole mission: the operator's hand brings a scrambled cube";
    assert!(stderr.lines().any(|line| line.starts_with(&head[..70])), "{stderr}");
    assert!(stderr.lines().all(|line| line.chars().count() <= 80), "{stderr}");
}

/// The name is that of a file in `scenarios`, otherwise that of a built-in scenario.
#[test]
fn scenario_name_stands_for_its_file() {
    let here = robot(&["check", "idle"]);
    let folder = std::env::temp_dir();
    let elsewhere = program().args(["check", "solve"]).current_dir(folder).output().unwrap();
    let wrong = robot(&["check", "ilde"]);
    let path = robot(&["check", "scenarios/solv.toml"]);

    for (out, wanted) in
        [(here, "scenario idle: scenarios/idle.toml"), (elsewhere, "scenario solve: shipped:solve")]
    {
        assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
        assert_eq!(text(&out.stderr).trim_end(), wanted);
    }
    for (out, wanted) in [(wrong, "did you mean `idle`?"), (path, "did you mean `solve`?")] {
        assert_eq!(out.status.code(), Some(2));
        assert!(text(&out.stderr).contains(wanted), "{}", text(&out.stderr));
    }
}

#[test]
fn moves_given_as_cube_name_the_scramble_option() {
    for args in [&["solve", "R U R'"][..], &["solve", "R", "U", "R'"], &["plan", "R U R'"]] {
        let out = robot(args);
        let stderr = text(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains("solve --scramble \"R U R'\""), "{args:?}: {stderr}");
        assert_eq!(text(&out.stdout), "", "{args:?}");
    }
    let out = robot(&["solve", "RUX"]);
    assert!(!text(&out.stderr).contains("--scramble"), "{}", text(&out.stderr));
}

/// Other text in place of a scenario or of cubes gives a few errors and the number of the others.
#[test]
fn file_of_other_text_gives_few_errors() {
    let other = std::fs::read_to_string("docs/operating.md").unwrap();

    let scenario = robot(&["check", "docs/operating.md"]);
    let cubes = with_input(&["solve", "-"], &other);

    let stderr = text(&scenario.stderr);
    assert!(stderr.lines().count() <= 40 && stderr.contains(" more: is this a"), "{stderr}");
    let stderr = text(&cubes.stderr);
    assert_eq!(cubes.status.code(), Some(2), "{stderr}");
    assert!(stderr.lines().count() <= 12 && stderr.contains(" more cubes without"), "{stderr}");
    // Each of the cubes still has its line.
    let lines = other.lines().filter(|line| !line.trim().is_empty()).count();
    assert_eq!(text(&cubes.stdout).lines().count(), lines);
}

#[test]
fn colours_appear_only_when_forced_without_terminal() {
    let call = |variables: &[(&str, &str)]| {
        let mut call = program();
        call.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE");
        let out = call.envs(variables.iter().copied()).args(["check", "nosuch"]).output().unwrap();
        text(&out.stderr).to_owned()
    };

    let plain = call(&[]);
    assert!(plain.starts_with("cannot read nosuch"), "{plain}");
    assert!(!plain.contains('\u{1b}'), "{plain}");
    let forced = call(&[("CLICOLOR_FORCE", "1")]);
    assert!(forced.starts_with("\u{1b}[31mcannot read nosuch"), "{forced}");
}

/// Without `RUST_LOG` a warning is a sentence without level, module and time of day.
#[test]
fn warnings_are_notices_unless_log_is_wanted() {
    let idle = std::fs::read_to_string("scenarios/idle.toml").unwrap();
    let fault = "[[fault]]\nkind = \"limit_switch\"\narm = \"postument\"\naxis = 1\nat_s = 0.2\n";
    let scenario = Scenario::new("limit", &format!("{idle}{fault}"));
    let call = |log: Option<&str>| {
        let mut call = program();
        call.env_remove("RUST_LOG").envs(log.map(|level| ("RUST_LOG", level)));
        // The last second of the stopped run goes to a folder that is a file.
        call.env("XDG_STATE_HOME", "/dev/null");
        let out = call.args(["run", scenario.path(), "--ui", "none"]).output().unwrap();
        text(&out.stderr).to_owned()
    };

    let usual = call(None);
    assert!(usual.contains("note: the last second"), "{usual}");
    assert!(!usual.contains("WARN") && !usual.contains("rubik_robot::"), "{usual}");
    let logged = call(Some("warn"));
    assert!(logged.contains(" WARN rubik_robot::run"), "{logged}");
}

#[test]
fn keys_command_lists_scenario_keys_once_with_meaning() {
    let out = robot(&["keys"]);
    let lines: Vec<&str> = text(&out.stdout).lines().collect();

    let keys: Vec<&str> = lines
        .iter()
        .filter(|l| !l.starts_with(' '))
        .map(|l| l.split(" = ").next().unwrap())
        .collect();
    let mut unique = keys.clone();
    unique.sort_unstable();
    unique.dedup();
    assert_eq!(unique.len(), keys.len());
    assert_eq!(lines.len(), 2 * keys.len());
    for wanted in [
        "task",
        "coordination",
        "bridge.kind",
        "cube.edge_mm",
        "control.compliant_arm",
        "control.compliance",
        "control.force_sign",
        "control.force_delay_periods",
        "control.grip_n",
        "face_turn.angle_deg",
        "follow_joints.speed",
        "joint_commands.stale_ms",
        "ros.router",
        "plant.grasp_error_mm",
        "plant.grasp_error_deg",
        "plant.jaws",
        "plant.cube_kind",
        "plant.lens_cap",
        "plant.errors.base_mm",
        "plant.errors.base_deg",
        "plant.errors.focal_percent",
        "effector.track.gripper.palm_clearance",
        "vsp.mpf.owner",
    ] {
        assert!(keys.contains(&wanted), "no {wanted}");
    }
}

#[test]
fn defaults_listed_for_scenario_keys_are_valid() {
    let out = robot(&["keys"]);
    for line in text(&out.stdout).lines().filter(|l| !l.starts_with(' ')) {
        let (key, default) = line.split_once(" = ").unwrap();
        // The keys of a fault, an object, a node or an order apply only in a scenario that has one.
        let listed = ["fault.", "object.", "probe.", "lead.", "node.", "order."];
        if default == "(not given)" || listed.iter().any(|list| key.starts_with(list)) {
            continue;
        }
        let over = rubik_robot::scenario::Override::parse(&format!("{key}={default}")).unwrap();
        let read = rubik_robot::tasks::read(std::path::Path::new("t.toml"), "", &[over]);
        assert!(read.is_ok(), "{key} = {default}: {}", read.unwrap_err());
    }
}

#[test]
fn closed_stdout_causes_no_panic() {
    for args in [&["keys"][..], &["--help"], &["check", "scenarios/solve.toml"]] {
        // The pipe is closed before the program begins to write.
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);

        let out = program().args(args).stdout(writer).output().unwrap();

        assert_eq!(out.status.code(), Some(0), "{args:?}: {}", text(&out.stderr));
        assert_eq!(text(&out.stderr), "", "{args:?}");
    }
}

/// A wrong row of the input is answered by an error; an empty row gets no answer.
#[test]
fn kinematics_answers_input_rows_in_order_despite_errors() {
    let rows =
        "0,-1.5707963267948966,0,0,1.5707963267948966,0\nnonsense\n\n0,-1.57,0,1.56,1.57,-1.57\n";

    let out = with_input(&["kinematics", "fk", "--arm", "postument", "--json"], rows);

    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let answers: Vec<serde_json::Value> =
        text(&out.stdout).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(answers.len(), 3);
    // Lower arm upright, upper arm level, wrist up: the flange is 0.67 + 0.19 m away from the
    // column and 0.95 + 0.455 m high.
    let pose = &answers[0]["base_from_flange"];
    assert!((pose[0][3].as_f64().unwrap() - 0.86).abs() < 1e-12);
    assert!((pose[2][3].as_f64().unwrap() - 1.405).abs() < 1e-12);
    assert!(answers[1]["error"].is_string());
    assert!((answers[2]["base_from_flange"][0][3].as_f64().unwrap() - 0.672262).abs() < 1e-6);
}

/// The plan solves the cube and gives a reason for each step. An impossible cube is refused.
#[test]
fn plan_needs_under_half_the_baseline_planners_grasps() {
    let cube = "RRBDUUULDBLULRUBDFLDLUFFRURDFDRDFUDLFRBLLBLFFRBURBBDBF";
    let out = robot(&["plan", cube, "--budget-ms", "300", "--json"]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let plan: serde_json::Value = serde_json::from_str(text(&out.stdout).trim()).unwrap();

    let turns = rubik_robot::cube::parse_turns(plan["solution"].as_str().unwrap()).unwrap();
    let start: rubik_robot::cube::Facelets = cube.parse().unwrap();
    let end = turns.iter().fold(start, |cube, turn| cube.turned(*turn));
    assert_eq!(end, rubik_robot::cube::Facelets::solved());
    let (grasps, original) = (&plan["grasps"], &plan["baseline"]["grasps"]);
    assert!(grasps.as_f64().unwrap() < 0.45 * original.as_f64().unwrap(), "{grasps} {original}");
    let steps = plan["steps"].as_array().unwrap();
    let seconds: f64 = steps.iter().map(|s| s["seconds"].as_f64().unwrap()).sum();
    assert!((seconds - plan["robot_time_s"].as_f64().unwrap()).abs() < 1e-6);
    assert!(steps.iter().all(|s| !s["why"].as_str().unwrap().is_empty()));

    // One sticker gets another colour.
    let twisted = cube.replacen("RR", "UR", 1);
    let out = robot(&["plan", &twisted, "--json"]);
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stdout).contains("\"kind\""), "{}", text(&out.stdout));
}

#[test]
fn doctor_reports_scenario_with_missing_devices_file() {
    let scenario = Scenario::new(
        "nodevices",
        "task = \"idle\"\npace = \"real-time\"\n\
         [bridge]\nkind = \"serial\"\ndevices = \"nosuch/devices.toml\"\n",
    );

    let out = robot(&["doctor", scenario.path(), "--seconds", "0.1", "--json"]);

    assert_eq!(out.status.code(), Some(1), "{}", text(&out.stderr));
    let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["refused"], true, "{report}");
    let findings = report["findings"].as_array().unwrap();
    let devices = findings.iter().find(|finding| finding["name"] == "bridge.devices").unwrap();
    assert_eq!(devices["state"], "REFUSED");
    assert!(devices["fix"].as_str().unwrap().contains("rubik-robot emulate"), "{devices}");
}

/// A servo on a core that is not there is refused by `run`, and reported by `doctor`.
#[test]
fn core_that_is_not_there_is_refused() {
    let scenario = Scenario::new(
        "nocore",
        "task = \"idle\"\npace = \"real-time\"\n[idle]\ntime_s = 1\n[real_time]\ncore = 1000\n",
    );

    let run = robot(&["run", scenario.path(), "--ui", "none"]);
    let doctor = robot(&["doctor", scenario.path(), "--seconds", "0.1"]);
    let slower = robot(&["run", scenario.path(), "--ui", "none", "--pace", "virtual"]);

    let words = "core 1000 is not there: this process may use core";
    assert_eq!(run.status.code(), Some(2), "{}", text(&run.stderr));
    assert!(text(&run.stderr).contains(words), "{}", text(&run.stderr));
    assert_eq!(doctor.status.code(), Some(1));
    let report = text(&doctor.stdout);
    assert!(report.contains(words) && report.contains("REFUSED  real_time.core"), "{report}");
    // The virtual clock has no servo thread.
    assert_eq!(slower.status.code(), Some(0), "{}", text(&slower.stderr));
}

/// Two outputs at one path are refused as well. The file at the path stays unchanged.
#[test]
fn commands_refuse_same_path_for_input_and_output() {
    let own = Scenario::new("own", "task = \"idle\"\n");
    let scenario = own.path();
    let other = std::env::temp_dir().join(format!("rubik-robot-{}-other", std::process::id()));
    let other = other.to_str().unwrap();
    let folder = std::path::Path::new(scenario).parent().unwrap();
    // Another path of the same file.
    let again = format!("{}/./{}", folder.display(), own.0.file_name().unwrap().to_str().unwrap());

    for args in [
        &["run", scenario, "--record", &again][..],
        &["run", scenario, "--world", scenario],
        &["run", scenario, "--journal", scenario],
        &["run", scenario, "--journal", other, "--record", other],
        &["run", scenario, "--world", other, "--record", other],
        &["run", scenario, "--world", other, "--journal", &format!("{other}.lock")],
        &["campaign", scenario, "--runs", "1", "-o", scenario],
        &["campaign", scenario, "--runs", "1", "--state", scenario],
        &["campaign", scenario, "--runs", "1", "--state", other, "-o", other],
        &["campaign", "merge", scenario, "-o", &again],
        &["benchmark", "--mission", "1", "--scenario", scenario, "-o", scenario],
        &["calibrate", scenario, "-o", scenario],
        &["report", scenario, "-o", &again],
        &["recover", scenario, "-o", scenario],
        &["merge", scenario, other, "-o", &again],
    ] {
        let before = std::fs::read(scenario).unwrap();

        let done = robot(args);

        let stderr = text(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{args:?}: {stderr}");
        assert!(
            stderr.contains("overwritten") || stderr.contains("of its own"),
            "{args:?}: {stderr}"
        );
        assert_eq!(std::fs::read(scenario).unwrap(), before, "{args:?}");
        assert!(!std::path::Path::new(other).exists(), "{args:?}");
    }
    let done = robot(&["picture", scenario, "--out", scenario]);
    assert_eq!(done.status.code(), Some(2), "{}", text(&done.stderr));
    assert!(text(&done.stderr).contains("ends in .png or .jpg"), "{}", text(&done.stderr));
}

#[test]
fn failed_calibration_keeps_the_existing_file() {
    let kept = Scenario::new("kept", "kept\n");

    // Behind a lens cap no camera sees a board.
    let path = "scenarios/solve.toml";
    let done = robot(&[
        "calibrate",
        path,
        "--set",
        "plant.lens_cap=true",
        "--camera",
        "standalone",
        "--views",
        "8",
        "-o",
        kept.path(),
    ]);

    assert_eq!(done.status.code(), Some(1), "{}", text(&done.stderr));
    let stderr = text(&done.stderr);
    let wanted = format!("no camera was calibrated: the file {} is not written", kept.path());
    assert!(stderr.contains(&wanted) && text(&done.stdout).contains("not calibrated"), "{stderr}");
    assert_eq!(std::fs::read_to_string(kept.path()).unwrap(), "kept\n", "{}", text(&done.stderr));
}

/// Every command says it in the same words, names the file once and exits with 2.
#[test]
fn file_that_cannot_be_read_exits_2() {
    let new = std::env::temp_dir().join(format!("rubik-robot-{}-unread", std::process::id()));
    let new = new.to_str().unwrap();
    let film = format!("{new}.gif");
    let commands: &[&[&str]] = &[
        &["check", "FILE"],
        &["run", "FILE"],
        &["campaign", "FILE", "--runs", "1"],
        &["campaign", "scenarios/idle.toml", "--runs", "1", "--vary", "FILE"],
        &["campaign", "merge", "FILE"],
        &["campaign", "status", "FILE"],
        &["run", "scenarios/hardware.toml", "--set", "bridge.devices=FILE"],
        &["weigh", "scenarios/hardware.toml", "--arm", "track", "--set", "bridge.devices=FILE"],
        &["replay", "FILE"],
        &["replay", "FILE", "--verify"],
        &["report", "FILE", "-o", new],
        &["film", "FILE", "-o", &film],
        &["recover", "FILE", "-o", new],
        &["merge", "FILE", "scenarios/idle.toml", "-o", new],
        &["vision", "face", "FILE"],
        &["vision", "locate", "FILE", "--fx", "600"],
        &["vision", "stages", "FILE"],
        &["vision", "colours", "FILE"],
        &["vision", "eval", "FILE"],
        &["vision", "rig", "FILE", "--boxes", "FILE"],
        &["vision", "learn", "FILE", "--boxes", "FILE"],
    ];
    for (file, why) in
        [("/nowhere/file", "there is no such file"), ("/proc/self", "it is a folder")]
    {
        for command in commands {
            let args: Vec<String> = command.iter().map(|word| word.replace("FILE", file)).collect();
            let done = robot(&args.iter().map(String::as_str).collect::<Vec<_>>());

            let told = format!("{}{}", text(&done.stdout), text(&done.stderr));
            assert_eq!(done.status.code(), Some(2), "{args:?}: {told}");
            assert!(told.contains(&format!("cannot read {file}: {why}")), "{args:?}: {told}");
            assert_eq!(told.matches(file).count(), 1, "{args:?}: {told}");
            assert!(!std::path::Path::new(new).exists(), "{args:?}");
        }
    }
}

#[test]
fn help_gives_sizes_and_required_options() {
    let help =
        |args: &[&str]| text(&robot(args).stdout).split_whitespace().collect::<Vec<_>>().join(" ");

    // The large tables alone take more than a gigabyte.
    let build = help(&["tables", "build", "--help"]);
    let size = build.split("all tables: ").nth(1).unwrap().split(' ').next().unwrap();
    assert!((1.0..100.0).contains(&size.parse::<f64>().unwrap()), "{build}");
    let campaign = help(&["campaign", "--help"]);
    assert!(campaign.contains("required without --soak"), "{campaign}");
    assert!(!help(&["campaign", "merge", "--help"]).contains("soak"));
    assert!(!help(&["film", "--help"]).contains("minute"));
}

#[test]
fn endless_and_oversized_files_are_refused_with_reason() {
    let large = Scenario::new("large", &"#".repeat((1 << 20) + 1));
    let endless = std::env::temp_dir().join(format!("rubik-robot-{}.toml", std::process::id()));
    std::os::unix::fs::symlink("/dev/zero", &endless).unwrap();
    let profile = Scenario::new(
        "profile",
        &format!("task = \"idle\"\n[[effector]]\nname = \"track\"\nservo_profile = {endless:?}\n"),
    );
    let large = large.path();
    for args in [
        &["check", large][..],
        &["check", "/dev/zero"],
        &["campaign", "scenarios/idle.toml", "--runs", "1", "--vary", "/dev/zero"],
        &["vision", "colours", "/dev/zero"],
        &["vision", "colours", large],
        &["vision", "eval", "/dev/zero"],
        &["vision", "rig", "tests/corpus/image/nine-tiles.png", "--boxes", "/dev/zero"],
        &["check", profile.path()],
    ] {
        let done = robot(args);

        let output = format!("{}{}", text(&done.stdout), text(&done.stderr));
        assert!(!matches!(done.status.code(), Some(0) | None), "{args:?}: {output}");
        let why = ["larger than 1 MiB", "larger than 64 MiB"];
        assert!(why.iter().any(|why| output.contains(why)), "{args:?}: {output}");
    }
    std::fs::remove_file(endless).unwrap();
    let empty = Scenario::new("empty", "\n");
    let done = robot(&["vision", "eval", empty.path()]);
    assert_ne!(done.status.code(), Some(0));
    assert!(text(&done.stderr).contains("names no picture"), "{}", text(&done.stderr));
}

#[test]
fn overlong_kinematics_row_is_refused_and_next_answered() {
    let long = "1,".repeat(200_000);
    let rows = format!("{long}\n0,-1.57,0,1.56,1.57,-1.57\n");
    let done = with_input(&["kinematics", "fk", "--arm", "postument"], &rows);
    let answers: Vec<&str> = text(&done.stdout).lines().collect();
    assert_eq!(answers.len(), 2, "{answers:?}");
    assert!(answers[0].contains("a row of more than 65536 bytes"), "{}", answers[0]);
    assert!(answers[1].contains("base_from_tool"), "{}", answers[1]);
}
