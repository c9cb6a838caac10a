//! The commands `solve`, `scramble` and `tables`.

use crate::program::program;
use rubik_robot::cube::{Cube, Facelets, after_moves, format_turns, parse_moves, parse_turns};
use rubik_robot::solver::table::InTurn;
use rubik_robot::solver::{Budget, Tables, Watch, solve_watched};
use rubik_robot::tables::Threads;
use serde_json::Value;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::atomic::AtomicBool;

/// Returns the folder of the solver's tables, which these tests share and keep between test runs.
fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("tables")
}

/// Returns the command of the program with these arguments, the shared tables and piped streams.
fn command(args: &[&str]) -> Command {
    let mut command = program();
    command.args(args).env("RUBIK_ROBOT_TABLES", folder());
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs the program with `input` on its stdin, and returns its exit code and output.
fn robot(args: &[&str], input: &str) -> Output {
    let mut child = command(args).spawn().unwrap();
    // A program that does not read its input may have closed it.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap()
}

/// Returns what a stream has printed.
fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// Returns the JSON values on stdout, one from each line.
fn lines(out: &Output) -> Vec<Value> {
    text(&out.stdout).lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

/// Returns the facelet letters of the cube that is scrambled with this seed.
fn facelets(seed: u64) -> String {
    Facelets::from(&Cube::scrambled(seed)).to_string()
}

/// Returns the facelet letters of a solved cube with some letters replaced, each given by its index
/// and its new letter. Index 8 is U9, 9 is R1, 20 is F3: the corner URF. The edge UF has 7 (U8) and
/// 19 (F2), the edge UR has 5 (U6) and 10 (R2).
fn with(stickers: &[(usize, char)]) -> String {
    let mut letters: Vec<char> = Facelets::solved().to_string().chars().collect();
    for &(at, letter) in stickers {
        letters[at] = letter;
    }
    letters.into_iter().collect()
}

/// Applies the solution in a JSON answer of `solve` to the cube in it, and returns the result.
fn solved(line: &Value) -> Cube {
    let cube = Cube::try_from(line["cube"].as_str().unwrap().parse::<Facelets>().unwrap()).unwrap();
    let turns = parse_turns(line["solution"].as_str().unwrap()).unwrap();
    assert_eq!(line["length"], turns.len());
    cube.apply_all(&turns)
}

/// Solutions and refusals are printed in the order of the cubes, with one thread and with three.
#[test]
fn solve_answers_streamed_cubes_and_refusals_in_order() {
    let twisted = with(&[(8, 'R'), (9, 'F'), (20, 'U')]);
    let input = format!("{}\n{twisted}\n\nUUU\n{}\n", facelets(1), facelets(2));
    for threads in ["1", "3"] {
        let out = robot(&["solve", "--mode", "first", "--json", "--threads", threads, "-"], &input);

        assert_eq!(out.status.code(), Some(2), "{}", text(&out.stderr));
        let lines = lines(&out);
        assert_eq!(lines.len(), 4);
        assert_eq!(
            [lines[0]["cube"].as_str(), lines[3]["cube"].as_str()],
            [Some(&*facelets(1)), Some(&*facelets(2))]
        );
        assert!(solved(&lines[0]).is_solved() && solved(&lines[3]).is_solved());
        for field in ["optimal", "nodes", "time_s"] {
            assert!(!lines[0][field].is_null(), "{field}");
        }
        assert_eq!(lines[1]["error"]["kind"], "corner-twisted");
        assert_eq!(lines[2]["error"]["kind"], "length");
        assert_eq!(lines[2]["cube"], "UUU");
    }
}

#[test]
fn impossible_cube_is_refused_with_kind_and_place() {
    for (cube, kind, place) in [
        (with(&[(7, 'F'), (19, 'U')]), "edge-flipped", "UF"),
        (with(&[(8, 'R'), (9, 'F'), (20, 'U')]), "corner-twisted", "URF"),
        (with(&[(10, 'F'), (19, 'R')]), "swapped", "UR"),
        (with(&[(0, 'R')]), "colour-count", "U"),
        (with(&[(4, 'R'), (9, 'U')]), "centre-twice", "U5"),
        (with(&[(8, 'F'), (20, 'U')]), "no-such-piece", "URF"),
        (with(&[(19, 'R'), (12, 'F')]), "piece-twice", "UF"),
        (with(&[(3, 'x')]), "letter", "U4"),
    ] {
        let out = robot(&["solve", "--json", &cube], "");

        assert_eq!(out.status.code(), Some(2), "{cube}");
        let line = &lines(&out)[0];
        assert_eq!(line["error"]["kind"], kind, "{line}");
        assert!(line["error"]["where"].to_string().contains(place), "{line}");
        assert!(line["error"]["message"].is_string());

        let out = robot(&["solve", &cube], "");
        assert_eq!((out.status.code(), text(&out.stdout)), (Some(2), ""));
        assert!(!out.stderr.is_empty());
    }
}

/// The turns of the solution name the faces of the cube as the scramble leaves it, rotations
/// included.
#[test]
fn solution_undoes_slice_moves_and_rotations() {
    let scramble = "R U2 M' y Fw E2 x' d";
    let out = robot(&["solve", "--json", "--scramble", scramble], "");

    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let line = &lines(&out)[0];
    let moves = format!("{scramble} {}", line["solution"].as_str().unwrap());
    assert!(after_moves(&Facelets::solved(), &parse_moves(&moves).unwrap()).is_solved());
    // The scramble is short, so the search ends by itself and proves the solution optimal.
    assert_eq!(line["optimal"], true);

    let out = robot(&["solve", "--scramble", "R U Q2"], "");
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("`Q2` at position 5"), "{}", text(&out.stderr));
}

#[test]
fn solve_leaves_solved_cube_and_reaches_other_goals() {
    let out = robot(&["solve", "--json", &Facelets::solved().to_string()], "");
    let line = &lines(&out)[0];
    assert_eq!((&line["solution"], &line["length"]), (&Value::from(""), &Value::from(0)));
    assert_eq!(line["optimal"], true);

    let goal = Cube::SOLVED.apply_all(&parse_turns("U2 D2 F2 B2 L2 R2").unwrap());
    let to = Facelets::from(&goal).to_string();
    let out = robot(&["solve", "--json", "--mode", "first", "--to", &to, &facelets(3)], "");
    assert_eq!(solved(&lines(&out)[0]), goal);
}

/// The search is limited by its number of nodes, not by time.
#[test]
fn answers_do_not_depend_on_thread_count() {
    let input: String = (0..6).map(|seed| facelets(seed) + "\n").collect();
    let answer = |threads| {
        let args = ["solve", "--json", "--budget-nodes", "5000", "--threads", threads, "-"];
        let out = robot(&args, &input);
        lines(&out).iter().map(|l| (l["solution"].clone(), l["nodes"].clone())).collect::<Vec<_>>()
    };

    let one = answer("1");
    assert!(one.len() == 6 && one.iter().all(|(solution, _)| solution.is_string()), "{one:?}");
    assert_eq!(one, answer("4"));
}

#[test]
fn solution_respects_the_maximum_length() {
    let out = robot(&["solve", "--json", "--max-length", "20", &facelets(4)], "");
    assert!(lines(&out)[0]["length"].as_u64().unwrap() <= 20);

    let out =
        robot(&["solve", "--mode", "first", "--json", "--max-length", "20", &facelets(5)], "");
    assert!(lines(&out)[0]["length"].as_u64().unwrap() <= 20);

    let out = robot(&["solve", "--max-length", "3", "--scramble", "R U F D"], "");
    assert_eq!(out.status.code(), Some(1), "the cube is sound");
    assert!(text(&out.stderr).contains("no solution of 3 turns"), "{}", text(&out.stderr));

    let out = robot(&["solve", "--mode", "robot", "--max-length", "20", &facelets(4)], "");
    assert_eq!(out.status.code(), Some(2));
    assert!(text(&out.stderr).contains("--max-length"), "{}", text(&out.stderr));
}

/// A line that is not UTF-8 and a cube in another orientation are refused; the other cubes are
/// solved.
#[test]
fn solve_continues_after_refused_input_lines() {
    let turned = "UUUUUUUUUBBBBBBBBBRRRRRRRRRDDDDDDDDDFFFFFFFFFLLLLLLLLL";
    let mut input = format!("{}\n", facelets(1)).into_bytes();
    input.extend_from_slice(b"\xff\xfe\n");
    input.extend_from_slice(format!("{turned}\n{}\n", facelets(2)).as_bytes());
    let mut child = command(&["solve", "--mode", "first", "--json", "-"]).spawn().unwrap();
    child.stdin.take().unwrap().write_all(&input).unwrap();

    let out = child.wait_with_output().unwrap();

    let answers = lines(&out);
    assert_eq!(out.status.code(), Some(2));
    let kinds: Vec<_> = answers.iter().map(|a| a["error"]["kind"].as_str()).collect();
    assert_eq!(kinds, [None, Some("letter"), Some("centre-elsewhere"), None]);
    let message = answers[2]["error"]["message"].as_str().unwrap();
    assert!(message.contains(&Facelets::solved().to_string()), "{message}");
}

/// Returns a cube in the layouts that people have, each as the bytes of a file.
fn layouts(cube: &str) -> Vec<Vec<u8>> {
    let side = |face: usize| &cube[9 * face..][..9];
    let row = |face: usize, row: usize| &side(face)[3 * row..][..3];
    let sides: Vec<&str> = (0..6).map(side).collect();
    let colours = cube.chars().map(|c| "wrgyob".as_bytes()["URFDLB".find(c).unwrap()] as char);
    let colours: String = colours.collect();
    let mut net: Vec<String> = (0..3).map(|r| format!("    {}", row(0, r))).collect();
    net.extend((0..3).map(|r| [4, 2, 1, 5].map(|face| row(face, r)).join(" ")));
    net.extend((0..3).map(|r| format!("    {}", row(3, r))));
    let wide: Vec<u8> =
        format!("\u{feff}{cube}\r\n").encode_utf16().flat_map(u16::to_le_bytes).collect();
    let texts = [
        format!("\u{feff}{cube}\n"),
        sides.join(" "),
        sides.join("\n"),
        net.join("\n"),
        [0, 4, 2, 1, 5, 3].map(|face| &colours[9 * face..][..9]).concat(),
        colours,
    ];
    texts.into_iter().map(String::into_bytes).chain([wide]).collect()
}

#[test]
fn solve_reads_cubes_as_people_write_them() {
    let cube = facelets(7);
    for file in layouts(&cube) {
        let mut child = command(&["solve", "--mode", "first", "--json", "-"]).spawn().unwrap();
        child.stdin.take().unwrap().write_all(&file).unwrap();

        let out = child.wait_with_output().unwrap();

        let shown = String::from_utf8_lossy(&file);
        assert_eq!(out.status.code(), Some(0), "{shown}: {}", text(&out.stdout));
        let answers = lines(&out);
        assert_eq!(answers.len(), 1, "{shown}");
        assert_eq!(answers[0]["cube"], Value::from(cube.clone()), "{shown}");
    }
}

#[test]
fn closed_stdout_causes_no_panic() {
    let mut child = command(&["solve", "--mode", "first", "-"]).spawn().unwrap();
    drop(child.stdout.take());
    // The input stays open, so the program ends because its output is closed, not because it has
    // read everything.
    let mut input = child.stdin.take().unwrap();
    for seed in 0..50 {
        let _ = writeln!(input, "{}", facelets(seed));
    }

    let out = child.wait_with_output().unwrap();
    drop(input);

    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    assert!(!text(&out.stderr).contains("panick"), "{}", text(&out.stderr));
}

#[test]
fn printed_scramble_makes_the_printed_cube() {
    let out = robot(&["scramble", "--seed", "11", "--count", "2", "--json"], "");

    assert_eq!(lines(&out).len(), 2);
    for line in lines(&out) {
        let moves = parse_moves(line["scramble"].as_str().unwrap()).unwrap();
        let made = after_moves(&Facelets::solved(), &moves);
        assert_eq!(made.to_string(), line["cube"].as_str().unwrap());
    }
    assert_eq!(lines(&out)[0]["cube"], Value::from(facelets(11)));
}

#[test]
fn solver_tables_are_built_listed_repaired_and_removed() {
    let folder = std::env::temp_dir().join(format!("rubik-robot-{}-tables", std::process::id()));
    let place = folder.to_str().unwrap();
    let tables = |action: &str| robot(&["tables", action, "phase2", "--tables", place], "");

    assert!(text(&tables("list").stdout).contains("not built"));
    let file = folder.join("phase2.table");
    assert!(!file.exists());
    let built = tables("build");
    assert_eq!(built.status.code(), Some(0), "{}", text(&built.stderr));
    assert!(file.exists() && !text(&tables("list").stdout).contains("not built"));
    assert!(text(&tables("verify").stdout).contains("sound"));
    // Flip a bit in the middle of the file.
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[5_000_000] ^= 4;
    std::fs::write(&file, bytes).unwrap();
    let broken = tables("verify");
    assert_eq!(broken.status.code(), Some(1));
    assert!(text(&broken.stdout).contains("checksum"), "{}", text(&broken.stdout));
    let again = tables("build");
    assert!(text(&again.stderr).contains("building it"), "{}", text(&again.stderr));
    assert!(text(&tables("verify").stdout).contains("sound"));
    assert!(text(&tables("remove").stdout).contains("removed") && !file.exists());
    assert_eq!(robot(&["tables", "list", "nosuch"], "").status.code(), Some(2));

    std::fs::remove_dir_all(&folder).unwrap();
    // With a file in the place of the folder the tables are built and used, but not kept.
    std::fs::write(&folder, "").unwrap();
    let out = robot(&["solve", "--mode", "first", "--tables", place, &facelets(1)], "");
    assert_eq!(out.status.code(), Some(0));
    assert!(text(&out.stderr).contains("cannot be kept"), "{}", text(&out.stderr));
    assert_eq!(tables("build").status.code(), Some(1));
    std::fs::remove_file(&folder).unwrap();
}

#[test]
fn one_and_three_threads_solve_in_20_turns() {
    let tables = Tables::build_with(&Threads::new(2));
    for seed in 0..10 {
        let cube = Cube::scrambled(seed);
        let stop = AtomicBool::new(false);
        let budget = Budget { nodes: u64::MAX, max_length: 20 };
        let one = Watch {
            workers: &InTurn,
            stop: &stop,
            improved: &|_| (),
            excluded: &|_| (),
            longest: Some(20),
        };
        let three = Watch { workers: &Threads::new(3), ..one };

        for watch in [one, three] {
            let solution = solve_watched(&cube, &tables, &budget, &watch);

            assert!(solution.turns.len() <= 20);
            assert!(
                cube.apply_all(&solution.turns).is_solved(),
                "{}",
                format_turns(&solution.turns)
            );
        }
    }
}

#[test]
fn damaged_solver_table_is_reported_and_not_used() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("damaged-tables");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("phase1-large.table"), "no table at all").unwrap();
    let mut command = command(&["solve", "--mode", "first", "--json", &facelets(3)]);

    let out = command.env("RUBIK_ROBOT_TABLES", &folder).output().unwrap();

    let stderr = text(&out.stderr);
    assert!(stderr.contains("phase1-large") && stderr.contains("15 bytes instead of"), "{stderr}");
    assert_eq!(out.status.code(), Some(0));
    assert!(solved(&lines(&out)[0]).is_solved());
}
