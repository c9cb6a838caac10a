//! Korf's solver, which the robot of 2007 used: IDA* with three pattern databases.
//!
//! - in: a [`Cube`], the databases of [`TABLES`], [`Limits`], [`Workers`], a flag that stops the
//!   search
//! - out: an [`Answer`]
//! - source: R. Korf, "Finding optimal solutions to Rubik's cube using pattern databases", AAAI
//!   1997; Zieliński et al. (2007), p. 376, where it solves cubes that need up to about 16 turns
//!
//! One database has the distance of each state of the eight corners, the other two those of six
//! edges each. The greatest of the three distances is a lower bound for the cube. Depth-first
//! searches, each to one turn more than the search before, go on until one finds a solution.
//!
//! The solver is a baseline and deliberately has no improvements of later years; [`super::optimal`]
//! is much faster.
//!
//! `pattern` numbers the states of the pieces, `fill` builds the databases.

mod fill;
mod pattern;

use super::coordinates::{PERMUTATIONS, TWISTS, corner_moves, rank, twist, twist_moves};
use super::optimal::{Answer, Limits};
use super::search::Watch;
use super::table::{TableSpec, Workers};
use crate::cube::{Cube, Turn};
use fill::{count, distance, fill};
use pattern::{Corners, EdgeMoves, Edges, edge_moves, edge_states, edges_number};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Number of states of the corners at each distance, as in the table of Korf's paper.
const CORNERS: [u64; 12] =
    [1, 18, 243, 2874, 28000, 205416, 1168516, 5402628, 20776176, 45391616, 15139616, 64736];
/// Number of states of the edges UR, UF, UL, UB, DR, DF at each distance.
const FIRST_EDGES: [u64; 11] =
    [1, 18, 230, 2747, 30847, 308783, 2508618, 13189082, 23497569, 3039786, 239];
/// Number of states of the edges DL, DB, FR, FL, BL, BR at each distance.
const LAST_EDGES: [u64; 11] =
    [1, 15, 190, 2360, 27139, 281416, 2380459, 13065209, 23961831, 2859244, 56];

/// Pattern databases; the solver needs all three.
pub const TABLES: [TableSpec; 3] = [
    TableSpec {
        name: "korf-corners",
        version: 1,
        bytes: Corners::STATES / 2,
        purpose: "Korf's solver: all corners",
        build: |workers, progress| fill(&Corners::new(), u8::MAX, workers, progress),
        verify: |table, workers| verify(table, Corners::STATES, &CORNERS, workers),
    },
    TableSpec {
        name: "korf-edges-first",
        version: 1,
        bytes: Edges::<6>::STATES / 2,
        purpose: "Korf's solver: six edges",
        build: |workers, progress| fill(&Edges::<6>::new(0), u8::MAX, workers, progress),
        verify: |table, workers| verify(table, Edges::<6>::STATES, &FIRST_EDGES, workers),
    },
    TableSpec {
        name: "korf-edges-last",
        version: 1,
        bytes: Edges::<6>::STATES / 2,
        purpose: "Korf's solver: the other six edges",
        build: |workers, progress| fill(&Edges::<6>::new(6), u8::MAX, workers, progress),
        verify: |table, workers| verify(table, Edges::<6>::STATES, &LAST_EDGES, workers),
    },
];

/// Checks a pattern database of `states` states: counts the states at each distance and compares
/// the counts with `known`. Returns the counts.
///
/// # Errors
/// A message with the found and the known counts, or with the found and the right size.
fn verify(
    table: &[u8],
    states: usize,
    known: &[u64],
    workers: &dyn Workers,
) -> Result<Vec<u64>, String> {
    if table.len() != states / 2 {
        return Err(format!("{} bytes instead of {}", table.len(), states / 2));
    }
    let counts = count(table, workers);
    let deepest = counts.iter().rposition(|&n| n > 0).unwrap_or(0);
    if counts[..=deepest] == *known {
        Ok(known.to_vec())
    } else {
        Err(format!("{:?} states at each distance instead of {known:?}", &counts[..=deepest]))
    }
}

/// Error: a database has the wrong size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the pattern database {name} has {bytes} bytes instead of {expected}")]
pub struct WrongSize {
    /// Name of the database.
    pub name: &'static str,
    /// Size of the database (bytes).
    pub bytes: usize,
    /// Size that it should have (bytes).
    pub expected: usize,
}

/// Korf's solver.
///
/// ```
/// use rubik_robot_solver::korf::{Korf, TABLES};
///
/// // The databases of Korf's paper: 88 million states of the corners, 43 million of six edges,
/// // half a byte each.
/// assert_eq!(TABLES.map(|spec| spec.bytes), [44_089_920, 21_288_960, 21_288_960]);
/// let wrong = Korf::new([&[], &[], &[]]).unwrap_err();
/// let words = "the pattern database korf-corners has 0 bytes instead of 44089920";
/// assert_eq!(wrong.to_string(), words);
/// ```
#[derive(Debug)]
pub struct Korf<'a> {
    corners: &'a [u8],
    edges: [&'a [u8]; 2],
    /// Order of the corners after a turn: `[order * 18 + turn]`.
    orders: Vec<u16>,
    /// Twists after a turn: `[twist * 18 + turn]`.
    twists: Vec<u16>,
    edge_moves: EdgeMoves,
}

/// A cube in the coordinates of the databases.
#[derive(Debug, Clone, Copy)]
struct State {
    /// Index of the order of the corners.
    order: u16,
    /// Index of the twists of the corners.
    twist: u16,
    /// For each edge 2 * its place + its flip.
    edges: [u8; 12],
}

/// Part of a search: the state after some turns, and these turns.
#[derive(Debug, Clone)]
struct Task {
    state: State,
    made: Vec<u8>,
}

/// Number of states that a worker visits between two checks of the limits.
const PATIENCE: u64 = 1 << 14;
/// Number of turns after which the search is divided into tasks.
const TASK_DEPTH: u8 = 2;

impl<'a> Korf<'a> {
    /// Makes a solver from the three pattern databases, in the order of [`TABLES`].
    ///
    /// # Errors
    /// [`WrongSize`] for the first database whose size is wrong.
    pub fn new(tables: [&'a [u8]; 3]) -> Result<Self, WrongSize> {
        for (table, spec) in tables.iter().zip(&TABLES) {
            if table.len() != spec.bytes {
                let (name, bytes, expected) = (spec.name, table.len(), spec.bytes);
                return Err(WrongSize { name, bytes, expected });
            }
        }
        let by_state = |moves: &[u16], states: usize| {
            (0..states * 18).map(|i| moves[i % 18 * states + i / 18]).collect()
        };
        Ok(Self {
            corners: tables[0],
            edges: [tables[1], tables[2]],
            orders: by_state(&corner_moves(), PERMUTATIONS),
            twists: by_state(&twist_moves(), TWISTS),
            edge_moves: edge_moves(),
        })
    }

    /// Finds a shortest solution, unless `limits` or `stop` end the search before. The length of
    /// the solution does not depend on the number of workers; its turns are reproducible with one
    /// worker only.
    #[must_use]
    pub fn solve(
        &self,
        cube: &Cube,
        limits: Limits,
        workers: &dyn Workers,
        stop: &AtomicBool,
    ) -> Answer {
        let watch = Watch { workers, stop, improved: &|_| (), excluded: &|_| (), longest: None };
        self.solve_watched(cube, limits, &watch)
    }

    /// Finds a shortest solution as [`Korf::solve`] does; `watch` gets each length that a round has
    /// excluded.
    #[must_use]
    pub fn solve_watched(&self, cube: &Cube, limits: Limits, watch: &Watch<'_>) -> Answer {
        let Watch { workers, stop, .. } = *watch;
        let root = State {
            order: rank(cube.corners()) as u16,
            twist: twist(cube) as u16,
            edges: edge_states(cube),
        };
        let least = self.bound(&root);
        let mut answer = Answer { turns: None, at_least: least, nodes: 0 };
        // Iterative deepening: a round without a solution proves that the next length is a bound.
        for length in least..=limits.max_length {
            let round = Round {
                tasks: self.tasks(root, TASK_DEPTH.min(length)),
                left: length - TASK_DEPTH.min(length),
                taken: AtomicUsize::new(0),
                nodes: AtomicU64::new(answer.nodes),
                max_nodes: limits.max_nodes,
                stop,
                ended: AtomicBool::new(false),
                found: Mutex::new(None),
            };
            workers.run(workers.count().max(1), &|_| self.work(&round));
            answer.nodes = round.nodes.into_inner();
            answer.turns = round.found.into_inner().unwrap_or_else(PoisonError::into_inner);
            if round.ended.into_inner() {
                return answer;
            }
            answer.at_least = length + 1;
            (watch.excluded)(length);
        }
        answer
    }

    /// Returns a lower bound on the turns that solve a state: the greatest of its three distances
    /// in the databases.
    fn bound(&self, state: &State) -> u8 {
        self.corner_distance(state)
            .max(self.edge_distance(state, 0))
            .max(self.edge_distance(state, 1))
    }

    /// Returns the number of turns that the corners of a state need at least.
    #[inline]
    fn corner_distance(&self, state: &State) -> u8 {
        distance(self.corners, usize::from(state.order) * TWISTS + usize::from(state.twist))
    }

    /// Returns the number of turns that six edges of a state need at least: the first six (`half`
    /// is 0) or the last six (1).
    #[inline]
    fn edge_distance(&self, state: &State, half: usize) -> u8 {
        let edges: &[u8; 6] = if half == 0 { &state.edges[..6] } else { &state.edges[6..] }
            .try_into()
            .unwrap_or(&[0; 6]);
        distance(self.edges[half], edges_number(edges))
    }

    /// Returns the state after the turn with this index.
    #[inline]
    fn turned(&self, state: &State, turn: usize) -> State {
        State {
            order: self.orders[usize::from(state.order) * 18 + turn],
            twist: self.twists[usize::from(state.twist) * 18 + turn],
            edges: state.edges.map(|e| self.edge_moves[turn][usize::from(e)]),
        }
    }

    /// Divides the search from `root` into tasks: one for each sequence of `depth` turns that the
    /// search may make first, with the state after it.
    fn tasks(&self, root: State, depth: u8) -> Vec<Task> {
        let mut tasks = vec![Task { state: root, made: Vec::new() }];
        for _ in 0..depth {
            tasks = tasks
                .iter()
                .flat_map(|task| {
                    let last = task.made.last().map(|turn| turn / 3);
                    (0..18).filter(move |turn| follows(last, turn / 3)).map(|turn| {
                        let made = [task.made.as_slice(), &[turn]].concat();
                        Task { state: self.turned(&task.state, usize::from(turn)), made }
                    })
                })
                .collect();
        }
        tasks
    }

    /// Searches the tasks of a round, as one of several workers, until none is left or the round
    /// has ended.
    fn work(&self, round: &Round<'_>) {
        let mut walk = Walk { korf: self, round, made: Vec::new(), nodes: 0 };
        while let Some(task) = round.tasks.get(round.taken.fetch_add(1, Ordering::Relaxed)) {
            walk.made.clone_from(&task.made);
            let last = task.made.last().map(|turn| turn / 3);
            let solved =
                self.bound(&task.state) <= round.left && walk.search(&task.state, round.left, last);
            if solved {
                let turns = walk.made.iter().map(|&t| Turn::from_index(usize::from(t))).collect();
                *round.found.lock().unwrap_or_else(PoisonError::into_inner) = Some(turns);
                round.ended.store(true, Ordering::Relaxed);
            }
            if round.ended.load(Ordering::Relaxed) {
                break;
            }
        }
        round.nodes.fetch_add(walk.nodes, Ordering::Relaxed);
    }
}

/// One search to a given number of turns, by all workers.
struct Round<'a> {
    tasks: Vec<Task>,
    /// Number of turns that are left at the start of each task.
    left: u8,
    /// Number of tasks that workers have taken.
    taken: AtomicUsize,
    nodes: AtomicU64,
    max_nodes: u64,
    stop: &'a AtomicBool,
    /// Whether the round is over: solved, stopped, or out of nodes.
    ended: AtomicBool,
    found: Mutex<Option<Vec<Turn>>>,
}

/// Depth-first walk of one worker.
struct Walk<'a> {
    korf: &'a Korf<'a>,
    round: &'a Round<'a>,
    made: Vec<u8>,
    nodes: u64,
}

impl Walk<'_> {
    /// Searches for exactly `left` turns that solve the state; `last` is the face of the turn
    /// before. Returns whether there are such turns. If so, they are at the end of `made`.
    fn search(&mut self, state: &State, left: u8, last: Option<u8>) -> bool {
        if left == 0 {
            // The caller has checked that all three distances are 0, so each piece is in its place.
            return true;
        }
        for turn in 0..18 {
            if !follows(last, turn / 3) {
                continue;
            }
            let next = self.korf.turned(state, usize::from(turn));
            self.nodes += 1;
            if self.nodes == PATIENCE {
                self.report();
            }
            // After this turn `left - 1` turns remain, so a distance of `left` is too far. The
            // corners come first: their distances are the greatest on average and reject the most
            // states.
            if self.korf.corner_distance(&next) >= left
                || self.korf.edge_distance(&next, 0) >= left
                || self.korf.edge_distance(&next, 1) >= left
            {
                continue;
            }
            self.made.push(turn);
            if self.search(&next, left - 1, Some(turn / 3)) {
                return true;
            }
            self.made.pop();
            if self.round.ended.load(Ordering::Relaxed) {
                return false;
            }
        }
        false
    }

    /// Adds the number of states that this worker has visited to the total of the round. Ends the
    /// round if the total has reached its limit or the caller wants to stop.
    fn report(&mut self) {
        let nodes = self.round.nodes.fetch_add(self.nodes, Ordering::Relaxed) + self.nodes;
        self.nodes = 0;
        if nodes >= self.round.max_nodes || self.round.stop.load(Ordering::Relaxed) {
            self.round.ended.store(true, Ordering::Relaxed);
        }
    }
}

/// Returns whether the search turns `face` right after the face `last`. It never turns one face
/// twice in a row, and turns opposite faces, whose turns commute, only in the order U D, R L, F B.
fn follows(last: Option<u8>, face: u8) -> bool {
    last.is_none_or(|last| face != last && face + 3 != last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::parse_turns;
    use crate::table::InTurn;
    use std::collections::HashMap;
    use std::sync::LazyLock;

    /// Databases up to distance 4, with 5 for all further states: quick to build and admissible.
    static NEAR: LazyLock<[Vec<u8>; 3]> = LazyLock::new(|| {
        [
            fill(&Corners::new(), 4, &InTurn, &|_| ()),
            fill(&Edges::<6>::new(0), 4, &InTurn, &|_| ()),
            fill(&Edges::<6>::new(6), 4, &InTurn, &|_| ()),
        ]
    });

    /// Returns the search with the databases [`NEAR`].
    fn near() -> Korf<'static> {
        Korf::new([&NEAR[0], &NEAR[1], &NEAR[2]]).unwrap()
    }

    /// Solves a cube by one thread, without a stop.
    fn solve(korf: &Korf<'_>, cube: &Cube, limits: Limits) -> Answer {
        korf.solve(cube, limits, &InTurn, &AtomicBool::new(false))
    }

    /// Returns all cubes at most three turns away from `cube`, each with its distance from it.
    fn within_three(cube: Cube) -> HashMap<Cube, u8> {
        let mut distances = HashMap::from([(cube, 0)]);
        let mut last = vec![cube];
        for distance in 1..=3 {
            let next = last.iter().flat_map(|c| Turn::all().map(|t| c.apply(t)));
            last = next
                .filter(|c| !distances.contains_key(c))
                .collect::<std::collections::HashSet<_>>()
                .into_iter()
                .collect();
            distances.extend(last.iter().map(|c| (*c, distance)));
        }
        distances
    }

    #[test]
    fn databases_have_known_state_counts_to_distance_four() {
        for (table, known) in NEAR.iter().zip([&CORNERS[..], &FIRST_EDGES, &LAST_EDGES]) {
            let counts = count(table, &InTurn);

            assert_eq!(counts[..5], known[..5]);
            assert_eq!(counts[5], known[5..].iter().sum::<u64>());
        }
    }

    /// The expected length comes from a bidirectional search without databases, three turns from
    /// each end.
    #[test]
    fn solutions_are_as_long_as_bidirectional_search_finds() {
        let (korf, from_solved) = (near(), within_three(Cube::SOLVED));
        for text in
            ["", "R", "U2 D", "F R U' L2", "R U2 F' D L", "B2 U L' D F2 R'", "R2 U2 R2 U2 R2 U2"]
        {
            let cube = Cube::SOLVED.apply_all(&parse_turns(text).unwrap());
            let from_cube = within_three(cube);
            let meetings = from_cube.iter().filter_map(|(c, d)| Some(d + from_solved.get(c)?));
            let length = meetings.min().unwrap();

            let answer = solve(&korf, &cube, Limits::NONE);

            let turns = answer.turns.unwrap();
            assert_eq!((turns.len(), answer.at_least), (usize::from(length), length), "{text}");
            assert!(cube.apply_all(&turns).is_solved());
        }
    }

    #[test]
    fn search_obeys_length_limit_node_limit_and_stop() {
        let cube = Cube::SOLVED.apply_all(&parse_turns("R U2 F' D L B").unwrap());

        let short = solve(&near(), &cube, Limits { max_length: 5, ..Limits::NONE });
        assert_eq!((short.turns, short.at_least), (None, 6));

        let far = Cube::scrambled(1);
        let few = solve(&near(), &far, Limits { max_nodes: 100_000, ..Limits::NONE });
        assert_eq!(few.turns, None);
        assert!((100_000..120_000).contains(&few.nodes), "{} nodes", few.nodes);

        let stopped = near().solve(&far, Limits::NONE, &InTurn, &AtomicBool::new(true));
        assert_eq!(stopped.turns, None);
    }

    #[test]
    fn korf_rejects_databases_of_wrong_size() {
        let names = ["korf-corners", "korf-edges-first", "korf-edges-last"];
        for (place, name) in names.into_iter().enumerate() {
            let mut databases = [&NEAR[0][..], &NEAR[1], &NEAR[2]];
            databases[place] = &databases[place][1..];

            assert_eq!(Korf::new(databases).unwrap_err().name, name);
        }
    }

    /// Takes about 10 s: `cargo test --release --lib korf -- --ignored`.
    #[test]
    #[ignore = "makes all three databases and solves a cube of thirteen turns"]
    fn full_databases_have_known_state_counts_and_solve() {
        let tables = TABLES.map(|spec| {
            let table = (spec.build)(&InTurn, &|_| ());
            (spec.verify)(&table, &InTurn).unwrap();
            table
        });
        let korf = Korf::new([&tables[0], &tables[1], &tables[2]]).unwrap();
        let text = "L D' B2 R F U2 L' B R D2 F L' U";
        let cube = Cube::SOLVED.apply_all(&parse_turns(text).unwrap());

        let answer = solve(&korf, &cube, Limits::NONE);

        assert_eq!(answer.turns.map(|turns| turns.len()), Some(13));
    }
}
