//! Search for shortest solutions with proof: IDA* with one large table and six look-ups per state.
//!
//! - in: a [`Cube`], the bytes of a table of [`TABLES`], [`Limits`], [`Workers`], a flag that stops
//!   the search
//! - out: an [`Answer`]: turns, or a length below which no solution exists
//! - source: R. Korf, "Finding optimal solutions to Rubik's cube using pattern databases" (1997);
//!   T. Rokicki, nxopt; S. Tronto, H48; A. Skalski, vcube. `coset` and `search` describe the
//!   differences.
//!
//! | module | purpose |
//! |---|---|
//! | `geometry` | the 48 symmetries of a cube |
//! | `coset` | numbers of the features of a cube that a table distinguishes |
//! | `flips` | sets of 2048 states as bits, moved as a whole |
//! | `build` | builder of a table |
//! | `lanes` | vector instructions |
//! | `probe` | the entry of a cube |
//! | `search` | depth-first search to a given number of turns |
//! | `rounds` | rounds of growing length, shared out among workers |

mod build;
mod coset;
mod flips;
mod geometry;
mod lanes;
mod probe;
mod rounds;
mod search;

use super::table::{Progress, TableSpec, Workers};
use crate::cube::{Cube, Turn};
use build::{count, fill, row_bytes};
use coset::{Cosets, Shape, Tetrads};
use lanes::Plain;
use probe::Prober;
use rounds::{Ends, Tasks};
use search::Searcher;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

/// Design of a table.
#[derive(Debug, Clone, Copy)]
struct Design {
    /// Features that the table distinguishes.
    shape: Shape,
    /// Distance up to which all cosets have one code (turns).
    base: u8,
    /// Number of cosets at each distance up to `base + 2`, as the first build counted them. The
    /// first five are tested against turns of whole cubes.
    distances: &'static [u64],
    /// Number of cosets with an entry of their own, in four groups by distance: at most `base`,
    /// `base + 1`, `base + 2`, and more.
    counts: [u64; 4],
}

/// Small table: named tetrads, flips of eight edges; 317 MB.
const SMALL: Design = Design {
    shape: Shape { tetrads: Tetrads::Named, full: false },
    base: 8,
    distances: &[
        1,
        6,
        71,
        816,
        9936,
        122_768,
        1_518_477,
        18_576_110,
        219_253_477,
        2_210_229_882,
        10_909_970_084,
    ],
    counts: [230_242_653, 2_167_386_670, 10_828_160_289, 6_022_216_088],
};
/// Standard table: unnamed tetrads, all flips; 1.21 GiB.
const STANDARD: Design = Design {
    shape: Shape { tetrads: Tetrads::Unnamed, full: true },
    base: 9,
    distances: &[
        1,
        5,
        60,
        702,
        8621,
        107_276,
        1_338_101,
        16_609_298,
        203_039_972,
        2_334_550_968,
        20_072_722_361,
        49_581_364_433,
    ],
    counts: [2_502_714_296, 19_862_003_756, 49_257_371_894, 5_369_932_854],
};
/// Tables to choose from, the smallest first. The solver needs one; the largest that fits into the
/// memory is the fastest.
pub static TABLES: [TableSpec; 2] = [
    TableSpec {
        name: "optimal-small",
        version: 1,
        bytes: SMALL.bytes(),
        purpose: "shortest solutions on small machines",
        build: |workers, progress| SMALL.build(workers, progress),
        verify: |table, workers| SMALL.verify(table, workers),
    },
    TableSpec {
        name: "optimal",
        version: 1,
        bytes: STANDARD.bytes(),
        purpose: "shortest solutions",
        build: |workers, progress| STANDARD.build(workers, progress),
        verify: |table, workers| STANDARD.verify(table, workers),
    },
];

impl Design {
    /// Returns the size of a table of this design (bytes).
    const fn bytes(self) -> usize {
        self.shape.rows() * row_bytes(self.shape)
    }

    /// Builds the table of this design.
    ///
    /// # Panics
    /// Panics if the number of cosets at a distance is not the known one.
    fn build(self, workers: &dyn Workers, progress: Progress<'_>) -> Vec<u8> {
        let filled = fill(&Cosets::new(self.shape), self.base, workers, progress);
        // An entry above the true distance would make a search prove a false bound.
        assert_eq!(filled.counts, self.distances, "wrong numbers of cosets at each distance");
        filled.table
    }

    /// Counts how many entries of a table have each of the four codes, and compares these counts
    /// with the known ones. Returns the counts, or a message if a count or the size is wrong.
    fn verify(self, table: &[u8], workers: &dyn Workers) -> Result<Vec<u64>, String> {
        if table.len() != self.bytes() {
            return Err(format!("{} bytes instead of {}", table.len(), self.bytes()));
        }
        let counts = count(&Cosets::new(self.shape), table, workers);
        if counts == self.counts {
            Ok(counts.to_vec())
        } else {
            Err(format!("{counts:?} entries at each distance instead of {:?}", self.counts))
        }
    }
}

/// Error: a table is none of [`TABLES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no table for shortest solutions has {bytes} bytes")]
pub struct NoSuchTable {
    /// Size of the table (bytes).
    pub bytes: usize,
}

/// Limits of a search.
///
/// ```
/// use rubik_robot_solver::optimal::{Limits, NoSuchTable, Optimal};
///
/// // Each of the 4.3e19 states can be solved in 20 turns.
/// assert_eq!(Limits::NONE.max_length, 20);
/// assert_eq!(Optimal::new(&[0; 3]).unwrap_err(), NoSuchTable { bytes: 3 });
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Length of the longest solution that the search looks for (turns).
    pub max_length: u8,
    /// Number of states after which the search ends, give or take a batch for each worker.
    pub max_nodes: u64,
}

impl Limits {
    /// No limits: no cube needs more than 20 turns.
    pub const NONE: Self = Self { max_length: 20, max_nodes: u64::MAX };
}

/// Result of a search.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Shortest solution; `None` if it is longer than the limit or the search was stopped.
    pub turns: Option<Vec<Turn>>,
    /// Proven lower bound on the length of all solutions (turns).
    pub at_least: u8,
    /// Number of states visited.
    pub nodes: u64,
}

/// Solver that finds shortest solutions with one table.
#[derive(Debug)]
pub struct Optimal<'a> {
    prober: Prober,
    table: &'a [u8],
    base: u8,
}

impl<'a> Optimal<'a> {
    /// Makes a solver from the bytes of one of [`TABLES`]; their number tells which table it is.
    ///
    /// # Errors
    /// [`NoSuchTable`] if none of [`TABLES`] has this size.
    pub fn new(table: &'a [u8]) -> Result<Self, NoSuchTable> {
        let design = [SMALL, STANDARD].into_iter().find(|d| d.bytes() == table.len());
        design.map(|d| Self::with(d, table)).ok_or(NoSuchTable { bytes: table.len() })
    }

    /// Makes a solver from a table that was built for `design`.
    fn with(design: Design, table: &'a [u8]) -> Self {
        Self { prober: Prober::new(&Cosets::new(design.shape)), table, base: design.base }
    }

    /// Makes a search with the table of this solver.
    fn searcher(&self) -> Searcher<'_> {
        Searcher { prober: &self.prober, table: self.table, base: self.base }
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
        let searcher = self.searcher();
        let root = searcher.root::<Plain>(cube);
        let least = root.bounds.iter().copied().max().unwrap_or(0);
        let mut answer = Answer { turns: None, at_least: least, nodes: 0 };
        let mut tasks = Tasks::new(&searcher, root);
        let ends = Ends { max_nodes: limits.max_nodes, stop };
        // Iterative deepening: a round without a solution proves that the next length is a bound.
        for length in least..=limits.max_length {
            let ended = tasks.search(length, workers, ends, &mut answer.nodes);
            if let ControlFlow::Break(turns) = ended {
                answer.turns = turns;
                return answer;
            }
            answer.at_least = length + 1;
        }
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::search::Watch;
    use super::*;
    use crate::cube::parse_turns;
    use crate::table::InTurn;
    use std::sync::LazyLock;

    /// Design without tetrads and with the flips of eight edges: 168 rows, which are quick to
    /// build.
    const FEW_FLIPS: Design = Design {
        shape: Shape { tetrads: Tetrads::Ignored, full: false },
        base: 6,
        distances: &[],
        counts: [0; 4],
    };
    /// Design without tetrads and with all flips: phase 1 of Kociemba's algorithm.
    const PHASE_1: Design =
        Design { shape: Shape { full: true, ..FEW_FLIPS.shape }, base: 8, ..FEW_FLIPS };

    /// The two designs with their tables.
    static TABLES_OF_TEST: LazyLock<[(Design, build::Filled); 2]> = LazyLock::new(|| {
        [FEW_FLIPS, PHASE_1]
            .map(|design| (design, fill(&Cosets::new(design.shape), design.base, &InTurn, &|_| ())))
    });

    /// Returns a search for each table of [`TABLES_OF_TEST`].
    fn solvers() -> [Optimal<'static>; 2] {
        TABLES_OF_TEST.each_ref().map(|(design, filled)| Optimal::with(*design, &filled.table))
    }

    /// Workers that are two threads.
    struct Two;

    impl Workers for Two {
        fn count(&self) -> usize {
            2
        }

        fn run(&self, tasks: usize, task: &(dyn Fn(usize) + Sync)) {
            std::thread::scope(|scope| {
                for first in 0..2 {
                    scope.spawn(move || (first..tasks).step_by(2).for_each(task));
                }
            });
        }
    }

    /// Returns the solved cube after these turns.
    fn after(text: &str) -> Cube {
        Cube::SOLVED.apply_all(&parse_turns(text).unwrap())
    }

    /// Stop that is never pressed.
    static RUN: AtomicBool = AtomicBool::new(false);

    /// Watch that never ends a search.
    struct Patient;

    impl Watch for Patient {
        fn add_shares(&mut self, _: &[(u16, u32)]) -> bool {
            true
        }
    }

    impl Optimal<'_> {
        /// Finds a solution of exactly `length` turns without vector instructions.
        fn plainly(&self, cube: &Cube, length: u8) -> Option<Vec<Turn>> {
            let mut root = self.searcher().root::<Plain>(cube);
            root.left = length;
            let mut stack =
                if root.bounds.iter().all(|&b| b <= length) { vec![root] } else { vec![] };
            self.searcher().search::<Plain>(&mut stack, &mut Patient)
        }
    }

    /// A table without tetrads distinguishes the states of phase 1 of the two-phase search. Its
    /// numbers of states by distance are known from the pages of H. Kociemba and J. Scherphuis.
    #[test]
    fn table_without_tetrads_has_known_state_counts() {
        let known =
            [1, 4, 50, 592, 7156, 87236, 1043817, 12070278, 124946368, 821605960, 1199128738];
        let (design, filled) = &TABLES_OF_TEST[1];

        assert_eq!(filled.counts, known);
        let counts = count(&Cosets::new(design.shape), &filled.table, &InTurn);
        let all = 495 * 2048 * 2187;
        // Two of the 256 entries of a line hold the least distance instead.
        let without_room = all / 128;
        assert_eq!(counts.iter().sum::<u64>(), all - without_room);
        assert!(counts[0].abs_diff(known[..9].iter().sum()) < without_room);
    }

    #[test]
    fn bounds_never_exceed_turns_from_solved_cube() {
        for solver in solvers() {
            let searcher = solver.searcher();
            for seed in 0..200 {
                // The pieces of a scrambled cube give eight turns at random.
                let random = Cube::scrambled(seed);
                let turns =
                    random.corners().iter().zip(random.edges()).map(|(c, e)| (c * 12 + e) % 18);
                let mut cube = Cube::SOLVED;
                for (done, turn) in turns.enumerate() {
                    cube = cube.apply(Turn::from_index(usize::from(turn)));
                    let bounds = searcher.root::<Plain>(&cube).bounds;
                    assert!(bounds.iter().all(|&b| usize::from(b) <= done + 1), "{bounds:?}");
                }
            }
        }
    }

    /// The expected lengths come from a bidirectional search without tables.
    #[test]
    fn vector_scalar_and_threaded_searches_find_shortest_solutions() {
        for (text, length) in [
            ("", 0),
            ("R", 1),
            ("U2 D", 2),
            ("R2 U2 R2 U2 R2 U2", 6),
            ("R' D R U R' D' R U'", 8),
            ("R U2 F' D L B2 U' F", 8),
            ("L D' B2 R F U2 L' B R D2", 10),
        ] {
            let cube = after(text);
            for solver in solvers() {
                for workers in [&InTurn as &dyn Workers, &Two] {
                    let answer = solver.solve(&cube, Limits::NONE, workers, &RUN);
                    let turns = answer.turns.unwrap();
                    assert_eq!((turns.len(), answer.at_least), (length, length as u8), "{text}");
                    assert!(cube.apply_all(&turns).is_solved());
                }
                let plain = solver.plainly(&cube, length as u8);
                assert!(cube.apply_all(&plain.unwrap()).is_solved());
                assert!(length == 0 || solver.plainly(&cube, length as u8 - 1).is_none());
            }
        }
    }

    #[test]
    fn two_threads_find_solution_of_same_length() {
        let cube = after("L D' B2 R F U2 L' B R D2 F L' U");
        let solver = &solvers()[1];

        let alone = solver.solve(&cube, Limits::NONE, &InTurn, &RUN);
        let again = solver.solve(&cube, Limits::NONE, &InTurn, &RUN);
        let both = solver.solve(&cube, Limits::NONE, &Two, &RUN);

        assert_eq!(alone, again);
        assert_eq!(alone.turns.as_ref().map(Vec::len), Some(13));
        assert_eq!(both.at_least, 13);
        let turns = both.turns.unwrap();
        assert!(turns.len() == 13 && cube.apply_all(&turns).is_solved(), "{turns:?}");
    }

    /// A rule such as "shortest up to n turns, otherwise another search" is exact with this search:
    /// the limit of the length alone decides.
    #[test]
    fn length_limit_decides_each_cube_exactly() {
        let solver = &solvers()[1];
        for text in ["R U2 F' D L B2 U' F", "L D' B2 R F U2 L' B R D2", "F U2 L' B R D2 F L' U R B"]
        {
            let cube = after(text);
            let length = parse_turns(text).unwrap().len() as u8;
            let limit = |max_length| Limits { max_length, ..Limits::NONE };

            let shorter = solver.solve(&cube, limit(length - 1), &InTurn, &RUN);
            let exact = solver.solve(&cube, limit(length), &InTurn, &RUN);

            assert_eq!((shorter.turns, shorter.at_least), (None, length), "{text}");
            assert_eq!(exact.turns.map(|turns| turns.len()), Some(usize::from(length)), "{text}");
        }
    }

    #[test]
    fn search_obeys_length_limit_node_limit_and_stop() {
        let solver = &solvers()[1];
        let cube = after("R' D R U R' D' R U'");

        let short = solver.solve(&cube, Limits { max_length: 7, ..Limits::NONE }, &InTurn, &RUN);
        assert_eq!((short.turns, short.at_least), (None, 8));

        let far = Cube::scrambled(1);
        let limits = Limits { max_nodes: 100_000, ..Limits::NONE };
        let few = solver.solve(&far, limits, &InTurn, &RUN);
        assert_eq!(few.turns, None);
        assert!((100_000..110_000).contains(&few.nodes), "{} nodes", few.nodes);

        let stopped = solver.solve(&far, Limits::NONE, &Two, &AtomicBool::new(true));
        assert_eq!(stopped.turns, None);
    }

    #[test]
    fn solver_rejects_table_of_unknown_size() {
        assert_eq!(Optimal::new(&[0; 64]).unwrap_err(), NoSuchTable { bytes: 64 });
        assert!(SMALL.verify(&[0; 64], &InTurn).is_err());
    }

    /// Takes a minute and 3 GB: `cargo test --release --lib optimal -- --ignored`.
    #[test]
    #[ignore = "makes both tables"]
    fn full_tables_have_known_state_counts_and_solve() {
        for spec in &TABLES {
            let table = (spec.build)(&InTurn, &|_| ());
            (spec.verify)(&table, &InTurn).unwrap();
            let solver = Optimal::new(&table).unwrap();
            for (text, length) in [
                ("U' D F2 U2 R F' R' U' D2 F' U B R D F R'", 16),
                ("B' D' R' D F' R' F2 R2 D2 B2 D' B L U R D' B2", 17),
            ] {
                let answer = solver.solve(&after(text), Limits::NONE, &InTurn, &RUN);
                assert_eq!(answer.turns.map(|turns| turns.len()), Some(length));
            }
        }
    }
}
