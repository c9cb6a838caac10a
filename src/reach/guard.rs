//! A guard over all arms. It checks where they may be, which paths they may take, and how fast
//! they may be near the operator's hand.
//!
//! - in: the believed cell, the joint positions of all arms, the paths that are asked for
//! - out: the first pair of bodies that would come too near; the factor by which a path exceeds the
//!   speed limit near the operator's hand, or that of the motors
//! - the bodies are the capsules of `bodies`, as in the search for meetings
//!
//! | case | threshold | reason |
//! |---|---|---|
//! | arm to arm, hand to its own arm | `MIN_DISTANCE` | meetings keep 20 mm |
//! | arm, hand and cube to the table | `MIN_HEIGHT` | the arms' places are believed, not known |
//! | arm to the operator's zone | `MIN_ZONE_DISTANCE` | only the hand that takes the cube enters |
//! | arm to arm, on a path | 1 mm more (`MARGIN_ON_PATH`) | a path that is allowed is not stopped |
//! | arm to arm and hand to hand, moving | 1 mm less (`LATITUDE`) | the two states differ in age |
//! | bodies too near already, on a path | `DIP_ON_PATH` | for rounding: no path leads nearer |
//! | places between the checked ones | `FINE` | bodies pass each other between two places |
//! | bodies too near already, moving | `DIP_WATCHED` | a hand that turns out of a corner may dip |
//! | jaws that may hold a cube | `WIDTH_TOLERANCE` | tilted grasps, calibration of the jaws |
//! | slow hand near the operator's | `SLOW_DISTANCE` | speeds are judged within 0.175 m of it |
//!
//! Where both hands are at one cube, their fingers and the cube meet by design. These are left out
//! on a path that begins or ends there, and checked on every other path. Without faults the guard
//! refuses few paths. It does if the arms are a little beside the beginning of a path in the table
//! and the hands therefore come nearer than the table says. The mission then takes a longer path.

use super::bodies::{Bodies, at_the_cube, hands};
use super::motors::{MOMENTS, MOTORS, farthest_turn};
use super::pairs::{PAIR, PAIRS, Pairs};
use crate::cell::{Cell, MOST_ARMS, PerArm};
use crate::cube::Keeper;
use crate::generators::legs::Legs;
use crate::generators::own::{Forecast, Place as Forecasted, Places};
use crate::motion::{JointPositions, MoveRefused};
use crate::spatial::Pose;
use nalgebra::Point3;
use std::sync::Arc;

/// Least distance between the arms, and of a hand from its own arm (m).
const MIN_DISTANCE: f64 = 0.005;
/// Least height of upper arm, wrist, hand and cube above the table (m).
const MIN_HEIGHT: f64 = 0.005;
/// Least distance from the operator's zone, for all parts that may not enter it (m).
const MIN_ZONE_DISTANCE: f64 = 0.005;
/// The arm that takes the cube out of the operator's hand, and gives it back: its hand may enter.
const TAKER: usize = 0;
/// Tolerance of the width of jaws that hold a cube (m): for a tilted grasp, and for an error of the
/// jaws' calibration.
const WIDTH_TOLERANCE: f64 = 0.006;
/// Number of equal parts of a path; it is checked at the end of each. A part in which bodies may
/// come too near is halved again and again.
const STEPS: u32 = 24;
/// Motion between two places (m) up to which no place in between is checked. Two bodies that are 5
/// mm apart at both places and pass each other come nearer by a tenth of it at most.
const FINE: f64 = 0.004;
/// Share of a path that is not halved any more. Where the inverse kinematics changes its branch,
/// the joints jump even in the shortest part of a line, so halving would never end.
const LEAST_SHARE: f64 = 1e-4;
/// Distance that the arms keep on a path beyond [`MIN_DISTANCE`] (m).
const MARGIN_ON_PATH: f64 = 0.001;
/// Distance by which arms that are watched while they move may come nearer than [`MIN_DISTANCE`]
/// (m). The latest states of the two arms may be a period or two apart in time, which is 2 to 4 mm
/// for arms that pass each other at 1 m/s.
const LATITUDE: f64 = 0.001;
/// Distance from the operator's zone within which a hand is slow (m).
const SLOW_DISTANCE: f64 = 0.18;
/// Distance by which two bodies that are too near at the beginning of a path may come still nearer
/// on it (m): for rounding.
const DIP_ON_PATH: f64 = 1e-4;
/// Distance by which two bodies that are too near may come still nearer while the arms are watched
/// in motion (m): a hand that is turned out of a corner may dip first.
const DIP_WATCHED: f64 = 2e-3;

/// The guard, with the cell as the controller believes it.
///
/// ```
/// use rubik_robot::reach::guard::{Guard, Near, PlannedMotion};
/// use rubik_robot::tasks;
/// use std::path::Path;
///
/// let cell = tasks::read(Path::new("cell"), "task = \"idle\"\n", &[])?.controller.cell;
/// let guard = Guard::of(&cell, 0.25);
/// let from = [Some(&cell.arms[0].start), Some(&cell.arms[1].start)];
/// let stays = PlannedMotion::Stays;
/// assert_eq!(guard.check_paths(from, [&stays, &stays]), Ok(()));
///
/// // The lower arm of the track tilts forwards until the hand is in the table.
/// let mut low = cell.arms[0].start;
/// low.0[2] += 1.2;
/// let refused = guard.check_paths(from, [&PlannedMotion::Joints(low), &stays]);
/// assert!(matches!(refused, Err(Near::Table { arm, .. }) if arm == "track"));
/// # Ok::<(), rubik_robot::scenario::fault::Faults>(())
/// ```
#[derive(Debug, Clone)]
pub struct Guard {
    /// Shared between copies: each order has a copy of its own.
    cell: Arc<Cell>,
    /// Largest speed near the operator's hand (m/s); `None` if the cube is taken from a table,
    /// since no person's hand is near then.
    hand_speed: Option<f64>,
    /// Whether the hands are never to meet at a cube: see [`Guard::by_hand`].
    never_meet: bool,
    /// Whether each hand may hold a cube: see [`Guard::holding`].
    hold: PerArm<bool>,
}

/// Number of distances that belong to one arm each, for all arms: table, own links, zone.
const OF_ARMS: usize = 3 * MOST_ARMS;
/// Number of all distances: those of one arm each, between the arms, and between the hands.
const DISTANCES: usize = OF_ARMS + 2 * PAIRS;

/// Distance between two arms (m), each with its index.
type Measure<'a> = dyn Fn((usize, &Bodies), (usize, &Bodies)) -> f64 + 'a;

/// Returns the values of the first `N` arms, and `rest` for all others.
fn per_arm<T: Copy, const N: usize>(first: [T; N], rest: T) -> PerArm<T> {
    std::array::from_fn(|i| first.get(i).copied().unwrap_or(rest))
}

/// Distances of all guarded bodies from the obstacles that they must not touch (m); `None` for an
/// arm that does not exist or whose joint positions are unknown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distances {
    /// Height of each arm above the table.
    table: PerArm<Option<f64>>,
    /// Distance of each hand from its own arm's links.
    own: PerArm<Option<f64>>,
    /// Distance of each arm from the operator's zone; `None` without a person.
    zone: PerArm<Option<f64>>,
    /// Distance between the arms of each pair, without the parts that meet at one cube.
    arms: [Option<f64>; PAIRS],
    /// Distance between the parts of each pair that meet at one cube: fingers and cube with the
    /// other hand.
    hands: [Option<f64>; PAIRS],
}

impl Distances {
    /// Returns all distances (m): of each arm from the table, of each hand from its own links, of
    /// each arm from the operator's zone, between the arms of each pair, and between its hands.
    fn all(&self) -> [Option<f64>; DISTANCES] {
        let Self { table, own, zone, arms, hands } = self;
        let of_arms = [table, own, zone];
        std::array::from_fn(|which| match which.checked_sub(OF_ARMS) {
            None => of_arms[which / MOST_ARMS][which % MOST_ARMS],
            Some(pair) if pair < PAIRS => arms[pair],
            Some(pair) => hands[pair - PAIRS],
        })
    }

    /// Returns these distances without those between the hands of these pairs, which are to meet at
    /// one cube.
    #[must_use]
    pub fn meeting(mut self, pairs: Pairs) -> Self {
        for pair in (0..PAIRS).filter(|&pair| pairs.has(pair)) {
            self.hands[pair] = None;
        }
        self
    }

    /// Returns whether the hands of a pair are known to be at least [`MIN_DISTANCE`] apart, less
    /// [`LATITUDE`].
    fn apart(&self, pair: usize) -> bool {
        self.hands[pair].is_some_and(|hands| hands >= MIN_DISTANCE - LATITUDE)
    }

    /// Returns for each distance the larger one of `self`, the present value, and `before`. A body
    /// that was too near and has moved away may not come back, so this is the distance from which
    /// it must not come nearer.
    #[must_use]
    pub fn or_more(&self, before: &Self) -> Self {
        let more = |now: Option<f64>, before: Option<f64>| {
            // An arm that is unknown now keeps no distance; one that is known for the first time
            // keeps the present one.
            now.map(|now| before.map_or(now, |before| before.max(now)))
        };
        let each = |now: PerArm<Option<f64>>, before: PerArm<Option<f64>>| {
            std::array::from_fn(|i| more(now[i], before[i]))
        };
        Self {
            table: each(self.table, before.table),
            own: each(self.own, before.own),
            zone: each(self.zone, before.zone),
            arms: std::array::from_fn(|i| more(self.arms[i], before.arms[i])),
            hands: std::array::from_fn(|i| more(self.hands[i], before.hands[i])),
        }
    }
}

/// Pair of bodies that comes too near, or hand that is too fast.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Near {
    /// Two arms.
    #[error("the arms{arms} come within {:.0} mm of each other", .distance * 1e3)]
    Arms {
        /// Names of the arms, as " A and B"; empty in a cell of two.
        arms: String,
        /// Distance (m).
        distance: f64,
    },
    /// The fingers or the cube of one hand and another hand, though the hands are not to meet now.
    #[error("the hands{arms} come within {:.0} mm of each other", .distance * 1e3)]
    Hands {
        /// Names of the arms, as " of A and B"; empty in a cell of two.
        arms: String,
        /// Distance (m).
        distance: f64,
    },
    /// An arm and the operator's zone. The hand of the arm that takes the cube may enter the zone.
    #[error("the {arm} arm comes within {:.0} mm of the operator's zone", .distance * 1e3)]
    Zone {
        /// Name of the arm.
        arm: String,
        /// Distance (m).
        distance: f64,
    },
    /// A hand and its own arm.
    #[error("the hand of the {arm} arm comes within {:.0} mm of its own links", .distance * 1e3)]
    Own {
        /// Name of the arm.
        arm: String,
        /// Distance (m).
        distance: f64,
    },
    /// An arm, its hand or its cube, and the table.
    #[error("the hand of the {arm} arm comes within {:.0} mm of the table", .height * 1e3)]
    Table {
        /// Name of the arm.
        arm: String,
        /// Height above the table (m).
        height: f64,
    },
    /// A hand or forearm that is too fast near the operator's hand.
    #[error(
        "the hand of the {arm} arm moves at {:.0} mm/s where the operator's hand may be",
        .speed * 1e3
    )]
    TooFast {
        /// Name of the arm.
        arm: String,
        /// Speed (m/s).
        speed: f64,
    },
}

/// Motion that is planned for an arm.
#[derive(Debug, Clone, PartialEq)]
pub enum PlannedMotion {
    /// The arm stays, or moves by less than the distances that the guard keeps.
    Stays,
    /// All joints move to these positions in the same time.
    Joints(JointPositions),
    /// The joints move in legs, which may overlap in time.
    Legs(Legs),
    /// The tool moves straight to this `base_from_tool`; the track (d0) stays.
    Line(Pose),
    /// The arm takes the course that its generator has declared.
    Forecast(Arc<Forecast>),
}

/// Place of all arms on their paths.
struct Place {
    /// Share of the paths that is covered there, 0..=1.
    part: f64,
    joints: PerArm<Option<JointPositions>>,
    bodies: PerArm<Option<Bodies>>,
    distances: Distances,
}

impl Place {
    /// Returns the longest distance by which two bodies may have approached each other since
    /// `before` (m): twice the longest motion of any body, since both may have moved by it.
    fn moved_since(&self, before: &Self) -> f64 {
        let pairs = self.bodies.iter().zip(&before.bodies);
        let moves = pairs.filter_map(|(now, then)| Some(now.as_ref()?.moved_since(then.as_ref()?)));
        2.0 * moves.fold(0.0, f64::max)
    }
}

/// Tolerance of a check of distances.
struct Tolerance {
    /// Distance by which bodies that are too near already may come still nearer (m).
    dip: f64,
    /// Distance that the arms keep from each other beyond [`MIN_DISTANCE`] (m).
    margin: f64,
}

impl Tolerance {
    /// Tolerance for a path that is asked for.
    const ON_PATH: Self = Self { dip: DIP_ON_PATH, margin: MARGIN_ON_PATH };

    /// Returns the least distances (m) that a check allows, in the order of [`Distances::all`].
    fn least(&self) -> [f64; DISTANCES] {
        std::array::from_fn(|which| match which / MOST_ARMS {
            0 => MIN_HEIGHT,
            1 => MIN_DISTANCE,
            2 => MIN_ZONE_DISTANCE,
            _ => MIN_DISTANCE + self.margin,
        })
    }
}

impl Guard {
    /// Makes a guard for a cell. `hand_speed` is the largest speed near the operator's hand (m/s).
    #[must_use]
    pub fn of(cell: &Cell, hand_speed: f64) -> Self {
        let hand_speed = (cell.keeper == Keeper::Person).then_some(hand_speed);
        Self {
            cell: Arc::new(cell.clone()),
            hand_speed,
            never_meet: false,
            hold: [true; MOST_ARMS],
        }
    }

    /// Returns the tool frame of an arm in the believed cell (`flange_from_tool`); `None` if there
    /// is no such arm.
    #[must_use]
    pub fn flange_from_tool(&self, arm: usize) -> Option<Pose> {
        self.cell.arms.get(arm).map(|arm| arm.flange_from_tool)
    }

    /// Returns this guard for an operator who moves the arms: the hands must not meet, since no
    /// plan says that they are to.
    #[must_use]
    pub fn by_hand(self) -> Self {
        Self { never_meet: true, ..self }
    }

    /// Checks that an arm keeps the limits of its joints and motors at all places of a course in
    /// joints. An arm that the cell does not have keeps them.
    ///
    /// # Errors
    /// The first limit that is exceeded.
    pub fn check_limits(&self, arm: usize, course: &Forecast) -> Result<(), MoveRefused> {
        let (Some(arm), Places::Joints(places)) = (self.cell.arms.get(arm), &course.places) else {
            return Ok(());
        };
        places.iter().try_for_each(|joints| arm.model.check(joints))
    }

    /// Sets the openings of the hands' jaws (m); `None` if unknown. From now on a hand counts as
    /// holding a cube if its jaws are about as far open as a cube's edge, or if their opening is
    /// unknown.
    pub fn holding<const N: usize>(&mut self, openings: [Option<f64>; N]) {
        let is_wide = |opening: f64| (opening - self.cell.cube.edge).abs() < WIDTH_TOLERANCE;
        self.hold = per_arm(openings, None).map(|opening| opening.is_none_or(is_wide));
    }

    /// Returns the name of an arm; `None` if the cell has no such arm.
    #[must_use]
    pub fn name(&self, arm: usize) -> Option<&str> {
        self.cell.arms.get(arm).map(|arm| arm.name.as_str())
    }

    /// Returns the name of an arm of the cell, for an error.
    fn owned_name(&self, arm: usize) -> String {
        self.name(arm).unwrap_or_default().to_owned()
    }

    /// Returns the bodies of an arm at these joint positions, in the world.
    fn bodies(&self, arm: usize, joints: &JointPositions) -> Bodies {
        Bodies::of(&self.cell, &self.cell.arms[arm], joints)
    }

    /// Returns all guarded distances of arms at these joint positions; `None` for an arm whose
    /// joints are unknown.
    #[must_use]
    pub fn distances<const N: usize>(&self, joints: [Option<&JointPositions>; N]) -> Distances {
        self.distances_of(&self.bodies_of_all(per_arm(joints, None)))
    }

    /// Returns in words which arms are in each other at these joint positions; `None` if none are.
    #[must_use]
    pub fn overlap(&self, joints: PerArm<Option<&JointPositions>>) -> Option<String> {
        let arms = self.distances(joints).arms;
        let within = |pair: usize| arms[pair].filter(|distance| *distance < 0.0);
        let (pair, distance) = (0..PAIRS).find_map(|pair| Some((pair, within(pair)?)))?;
        let (arms, depth) = (self.names("", pair), -1e3 * distance);
        Some(format!("the arms{arms} are {depth:.0} mm deep in each other"))
    }

    /// Returns the bodies of the arms whose joints are known.
    fn bodies_of_all(&self, joints: PerArm<Option<&JointPositions>>) -> PerArm<Option<Bodies>> {
        let known = |i: usize| joints[i].filter(|_| i < self.cell.arms.len());
        std::array::from_fn(|i| known(i).map(|joints| self.bodies(i, joints)))
    }

    /// Returns all guarded distances of these bodies.
    fn distances_of(&self, bodies: &PerArm<Option<Bodies>>) -> Distances {
        let of =
            |measure: &dyn Fn(&Bodies) -> f64| bodies.each_ref().map(|b| b.as_ref().map(measure));
        let pairs = |measure: &Measure<'_>| {
            PAIR.map(|(i, j)| Some(measure((i, bodies[i].as_ref()?), (j, bodies[j].as_ref()?))))
        };
        let off = |i: usize| {
            // Without a person the arms need not keep off the zone.
            let body = bodies[i].as_ref().filter(|_| self.hand_speed.is_some());
            body.map(|body| body.distance_to_zone(&self.cell.hand, i != TAKER))
        };
        Distances {
            table: of(&|body| body.lowest() - self.cell.table_height),
            own: of(&Bodies::own),
            zone: std::array::from_fn(off),
            arms: pairs(&|(_, a), (_, b)| at_the_cube(a, b)),
            hands: pairs(&|(i, a), (j, b)| hands(a, b, [self.hold[i], self.hold[j]])),
        }
    }

    /// Checks the distances of moving arms, which were `before` and are `now`. Bodies that were too
    /// near before may move apart.
    ///
    /// # Errors
    /// The first pair that is too near and was not before, or that has come still nearer by more
    /// than 2 mm.
    pub fn check_motion(&self, before: &Distances, now: &Distances) -> Result<(), Near> {
        self.within(before, now, &Tolerance { dip: DIP_WATCHED, margin: -LATITUDE })
    }

    /// Checks that no distance of `now` is too small. A distance that was too small `before` may
    /// have become smaller by the dip of `tolerance` at most.
    ///
    /// # Errors
    /// The first pair of bodies that is too near.
    fn within(
        &self,
        before: &Distances,
        now: &Distances,
        tolerance: &Tolerance,
    ) -> Result<(), Near> {
        let pairs = before.all().into_iter().zip(now.all()).zip(tolerance.least());
        let too_near = pairs.enumerate().find_map(|(which, ((before, now), least))| {
            let (before, now) = (before?, now?);
            // Below the least distance only pairs that were as near before are allowed, unless they
            // come nearer by more than the dip.
            (now < least.min(before - tolerance.dip)).then_some((which, now))
        });
        // The numbers are those of `Distances::all`.
        let Some((which, distance)) = too_near else { return Ok(()) };
        let arm = || self.owned_name(which % MOST_ARMS);
        Err(match (which / MOST_ARMS, which.checked_sub(OF_ARMS)) {
            (0, _) => Near::Table { arm: arm(), height: distance },
            (1, _) => Near::Own { arm: arm(), distance },
            (2, _) => Near::Zone { arm: arm(), distance },
            (_, Some(pair)) if pair >= PAIRS => {
                Near::Hands { arms: self.names(" of", pair - PAIRS), distance }
            }
            (_, pair) => Near::Arms { arms: self.names("", pair.unwrap_or_default()), distance },
        })
    }

    /// Returns the names of a pair of arms after a word; empty in a cell of two.
    fn names(&self, word: &str, pair: usize) -> String {
        let (first, second) = PAIR[pair];
        if self.cell.arms.len() < 3 {
            return String::new();
        }
        format!("{word} {} and {}", self.owned_name(first), self.owned_name(second))
    }

    /// Checks whether the arms may take the paths `ways` from the joint positions `from`. All arms
    /// begin and end together, and at each moment all have covered the same share of their paths.
    /// Bodies that are too near at the beginning may move apart, so that an operator can move an
    /// arm out of a corner.
    ///
    /// # Errors
    /// The first pair of bodies that comes too near on the paths.
    pub fn check_paths<const N: usize>(
        &self,
        from: [Option<&JointPositions>; N],
        ways: [&PlannedMotion; N],
    ) -> Result<(), Near> {
        let mut courses = self.courses(from, ways);
        let places = self.places(&mut courses);
        let joined = self.joined(&places);
        // Fingers and cube of hands that are to meet may touch on the whole path.
        let as_meant = |distances: Distances| distances.meeting(joined);
        let before = as_meant(places[0].distances);
        let check =
            |distances: Distances| self.within(&before, &as_meant(distances), &Tolerance::ON_PATH);
        let mut pairs = places.iter().zip(&places[1..]);
        pairs.try_for_each(|(last, next)| self.check_between(&mut courses, last, next, &check))
    }

    /// Applies `check` to the distances at the place `to`. If bodies may have come too near between
    /// `from` and `to`, applies it to places in between as well: it halves the interval again and
    /// again.
    ///
    /// # Errors
    /// The first pair of bodies that comes too near.
    fn check_between(
        &self,
        courses: &mut PerArm<Option<Course<'_>>>,
        from: &Place,
        to: &Place,
        check: &impl Fn(Distances) -> Result<(), Near>,
    ) -> Result<(), Near> {
        let moved = to.moved_since(from);
        // Two bodies at distance a here and b there, which approach or part by m in all, are never
        // nearer than (a + b - m) / 2.
        let pairs = from
            .distances
            .all()
            .into_iter()
            .zip(to.distances.all())
            .zip(Tolerance::ON_PATH.least());
        let may_dip = |((a, b), least): ((Option<f64>, Option<f64>), f64)| {
            a.zip(b).is_some_and(|(a, b)| a + b - moved < 2.0 * least)
        };
        let divisible = to.part - from.part > LEAST_SHARE;
        if divisible && moved > FINE && pairs.into_iter().any(may_dip) {
            // The inverse kinematics of a line continues from the place before, as the servo does.
            for (course, joints) in courses.iter_mut().zip(from.joints) {
                if let (Some(course), Some(joints)) = (course, joints) {
                    course.last = joints;
                }
            }
            let middle = self.place(courses, f64::midpoint(from.part, to.part));
            self.check_between(courses, from, &middle, check)?;
            return self.check_between(courses, &middle, to, check);
        }
        check(to.distances)
    }

    /// Returns the pairs whose hands may meet on the paths `ways` of all arms. The others are apart
    /// at the beginning and at the end, or the guard is made by [`Guard::by_hand`], which allows no
    /// meeting. A hand meets one other at most.
    #[must_use]
    pub fn may_meet<const N: usize>(
        &self,
        from: [Option<&JointPositions>; N],
        ways: [&PlannedMotion; N],
    ) -> Pairs {
        self.joined(&self.places(&mut self.courses(from, ways)))
    }

    /// Returns the pairs whose hands may meet, as [`Guard::may_meet`], for paths given by the
    /// places on them.
    fn joined(&self, places: &[Place]) -> Pairs {
        let (begin, end) = (&places[0].distances, &places[places.len() - 1].distances);
        let free = |pair: &usize| !self.never_meet || begin.hands[*pair].is_none();
        let near = (0..PAIRS).filter(free).filter(|pair| !begin.apart(*pair));
        let near = near.fold(Pairs::NONE, Pairs::with);
        // The pairs of an arm whose place is unknown have no distance that could count.
        let known = (0..PAIRS).filter(|pair| begin.hands[*pair].is_some());
        let together = known.filter(|pair| near.has(*pair)).fold(Pairs::NONE, Pairs::with);
        let meet = |(joined, taken): (Pairs, Pairs), pair: usize| {
            let (one, other) = PAIR[pair];
            if taken.names(one) || taken.names(other) {
                (joined, taken)
            } else {
                (joined.with(pair), taken.with(pair))
            }
        };
        let coming = (0..PAIRS).filter(free).filter(|&p| begin.apart(p) && !end.apart(p));
        coming.fold((near, together), meet).0
    }

    /// Returns the beginning and the ends of the [`STEPS`] equal parts of the paths, at which every
    /// path is checked. A line is followed place by place, so that the inverse kinematics stays on
    /// its branch.
    fn places(&self, courses: &mut PerArm<Option<Course<'_>>>) -> Vec<Place> {
        (0..=STEPS).map(|step| self.place(courses, f64::from(step) / f64::from(STEPS))).collect()
    }

    /// Returns the [`Course`] of each arm on its path in `ways`; `None` for an arm whose joint
    /// positions are unknown.
    fn courses<const N: usize>(
        &self,
        from: [Option<&JointPositions>; N],
        ways: [&PlannedMotion; N],
    ) -> PerArm<Option<Course<'_>>> {
        let from = per_arm(from, None);
        let known = |i: usize| from[i].filter(|_| i < self.cell.arms.len());
        std::array::from_fn(|i| known(i).map(|from| self.course(i, from, ways[i])))
    }

    /// Returns the place of all arms after the share `part` (0..=1) of their paths.
    fn place(&self, courses: &mut PerArm<Option<Course<'_>>>, part: f64) -> Place {
        let joints = courses.each_mut().map(|course| course.as_mut().map(|course| course.at(part)));
        let bodies = self.bodies_of_all(joints.each_ref().map(Option::as_ref));
        Place { part, joints, bodies, distances: self.distances_of(&bodies) }
    }

    /// Returns the course of an arm on the path `way`, which begins at the joint positions `from`.
    ///
    /// # Panics
    /// If the cell has no such arm.
    #[must_use]
    pub fn course(&self, arm: usize, from: &JointPositions, way: &PlannedMotion) -> Course<'_> {
        let of = &self.cell.arms[arm];
        let tool = of.model.base_from_flange(from) * of.flange_from_tool;
        Course { guard: self, arm, from: *from, way: way.clone(), last: *from, tool }
    }

    /// Checks the speed of an arm that has moved from one set of joint positions to another in
    /// `seconds` (s), if its hand or forearm is near the operator's zone.
    ///
    /// # Errors
    /// [`Near::TooFast`], if the speed is more than a fifth above its limit.
    pub fn check_speed(
        &self,
        arm: usize,
        from: &JointPositions,
        to: &JointPositions,
        seconds: f64,
    ) -> Result<(), Near> {
        let Some(allowed) = self.hand_speed.filter(|_| seconds > 0.0) else { return Ok(()) };
        match self.near_hand(&self.bodies(arm, from), &self.bodies(arm, to)) {
            Some(way) if way > 1.2 * allowed * seconds => {
                Err(Near::TooFast { arm: self.owned_name(arm), speed: way / seconds })
            }
            _ => Ok(()),
        }
    }

    /// Returns the longest distance that a part of the arm near the operator's zone has moved (m),
    /// or `None` if no part of the arm is near. If any part of the hand is near, the motions of all
    /// its parts count, since the hand may turn; a point of the forearm counts if it is near
    /// itself.
    fn near_hand(&self, from: &Bodies, to: &Bodies) -> Option<f64> {
        let zone = &self.cell.hand;
        let zone_from_world = zone.world_from_cube.inverse();
        let off = |at: &Point3<f64>| zone.distance(&(zone_from_world * at));
        // The surface of a part counts, so its radius is added to the threshold.
        let is_near = |(a, radius): (Point3<f64>, f64), b: Point3<f64>| {
            off(&a).min(off(&b)) < radius + SLOW_DISTANCE
        };
        let mut most: Option<f64> = None;
        let mut count = |moved: f64| most = Some(most.map_or(moved, |most| most.max(moved)));
        let hand = || from.hand().into_iter().zip(to.hand());
        if hand().any(|(a, (b, _))| is_near(a, b)) {
            hand().for_each(|((a, _), (b, _))| count((b - a).norm()));
        }
        for (a, (b, _)) in from.forearm().into_iter().zip(to.forearm()) {
            if is_near(a, b) {
                count((b - a.0).norm());
            }
        }
        most
    }
}

/// Course of an arm: its joint positions along a path. Each is computed from the one before, so
/// that the inverse kinematics stays on its branch.
#[derive(Debug)]
pub struct Course<'a> {
    guard: &'a Guard,
    arm: usize,
    from: JointPositions,
    way: PlannedMotion,
    /// Joint positions that were computed last.
    last: JointPositions,
    /// `base_from_tool` at the beginning.
    tool: Pose,
}

impl Course<'_> {
    /// Returns the largest speed of the hand or forearm near the operator's zone, divided by the
    /// limit there; 1 or less means slow enough, and 0 that no part comes near. The path takes
    /// `seconds` (s), and `share` maps a share of this time to the share of the path that is
    /// covered by then.
    #[must_use]
    pub fn hand_speed_factor(mut self, seconds: f64, share: impl Fn(f64) -> f64) -> f64 {
        let (guard, arm) = (self.guard, self.arm);
        // Where the cube is taken from a table, no person's hand could be hurt.
        let Some(allowed) = guard.hand_speed else { return 0.0 };
        let step = seconds / f64::from(MOMENTS);
        let mut last = guard.bodies(arm, &self.from);
        (1..=MOMENTS)
            .map(|moment| {
                let here =
                    guard.bodies(arm, &self.at(share(f64::from(moment) / f64::from(MOMENTS))));
                let speed = guard.near_hand(&last, &here).map_or(0.0, |way| way / step);
                last = here;
                speed / allowed
            })
            .fold(0.0, f64::max)
    }

    /// Returns the largest speed of a motor of the arm, divided by 0.95 of the motors' limit; 1 or
    /// less means that all are slow enough. The arguments are those of
    /// [`Course::hand_speed_factor`].
    #[must_use]
    pub fn motor_speed_factor(mut self, seconds: f64, share: impl Fn(f64) -> f64) -> f64 {
        let (model, from) = (&self.guard.cell.arms[self.arm].model, self.from);
        let allowed = MOTORS * model.motor_speed_limit * seconds / f64::from(MOMENTS);
        farthest_turn(model, &from, |part| self.at(share(part))) / allowed
    }

    /// Returns the share of the path until which the hand or forearm is near the operator's zone at
    /// the beginning, and the share from which on it is near until the end: (0, 1) if it is near at
    /// neither end.
    #[must_use]
    pub fn near_ends(mut self) -> (f64, f64) {
        let (guard, arm) = (self.guard, self.arm);
        let share = |moment: u32| f64::from(moment) / f64::from(MOMENTS);
        let near: Vec<bool> = (0..=MOMENTS)
            .map(|moment| {
                let here = guard.bodies(arm, &self.at(share(moment)));
                guard.near_hand(&here, &here).is_some()
            })
            .collect();
        let begin = near.iter().take_while(|near| **near).count() as u32;
        let end = near.iter().rev().take_while(|near| **near).count() as u32;
        // Up to the first moment that is not near, since the places before it were not checked.
        let until = if begin == 0 { 0.0 } else { share(begin.min(MOMENTS)) };
        (until, if end == 0 { 1.0 } else { 1.0 - share(end.min(MOMENTS)) })
    }

    /// Returns the joint positions after the share `part` (0..=1) of the path. Where a line leaves
    /// the arm's reach, the arm stays at the last place within reach, since the servo refuses to
    /// follow it farther.
    fn at(&mut self, part: f64) -> JointPositions {
        self.last = match &self.way {
            PlannedMotion::Stays => self.from,
            PlannedMotion::Joints(to) => self.from.towards(to, part),
            PlannedMotion::Legs(legs) => legs.at(&self.from, part),
            PlannedMotion::Line(to) => self.joints_of(&self.on_line(to, part)),
            PlannedMotion::Forecast(course) => match course.at(part) {
                Some(Forecasted::Joints(joints)) => joints,
                Some(Forecasted::Pose(tool)) => self.joints_of(&tool),
                None => self.from,
            },
        };
        self.last
    }

    /// Returns the joint positions for a `base_from_tool`; out of reach, the last ones.
    fn joints_of(&self, tool: &Pose) -> JointPositions {
        self.inverse(tool).unwrap_or(self.last)
    }

    /// Returns the joint positions for a `base_from_tool`. The solution nearest to the last place
    /// stays on its branch, as the servo does.
    fn inverse(&self, tool: &Pose) -> Result<JointPositions, MoveRefused> {
        let arm = &self.guard.cell.arms[self.arm];
        arm.model.inverse(&(tool * arm.flange_from_tool.inverse()), &self.last)
    }

    /// Returns the share of the path that the arm can follow, 0..1, and the limit that ends it;
    /// `None` if it can follow all of it, or if the path goes straight to joint positions.
    #[must_use]
    pub fn beyond_reach(mut self) -> Option<(f64, MoveRefused)> {
        /// Most places of a declared course that are looked at.
        const MOST_PLACES: u32 = 20_000;
        let moments = match &self.way {
            PlannedMotion::Forecast(course) => (course.len() as u32).clamp(MOMENTS, MOST_PLACES),
            _ => MOMENTS,
        };
        let share = |moment: u32| f64::from(moment) / f64::from(moments);
        let model = &self.guard.cell.arms[self.arm].model;
        (1..=moments).find_map(|moment| {
            let joints = match self.place_at(share(moment))? {
                Forecasted::Joints(joints) => Ok(joints),
                Forecasted::Pose(tool) => self.inverse(&tool),
            };
            match joints.and_then(|joints| model.check(&joints).map(|()| joints)) {
                Ok(joints) => {
                    self.last = joints;
                    None
                }
                Err(why) => Some((share(moment - 1), why)),
            }
        })
    }

    /// Returns the place after the share `part` of a line or of a declared course; `None` for
    /// another path.
    fn place_at(&self, part: f64) -> Option<Forecasted> {
        match &self.way {
            PlannedMotion::Line(to) => Some(Forecasted::Pose(self.on_line(to, part))),
            PlannedMotion::Forecast(course) => course.at(part),
            PlannedMotion::Stays | PlannedMotion::Joints(_) | PlannedMotion::Legs(_) => None,
        }
    }

    /// Returns the `base_from_tool` after the share `part` of the line to `to`.
    fn on_line(&self, to: &Pose, part: f64) -> Pose {
        Pose::from_parts(
            self.tool.translation.vector.lerp(&to.translation.vector, part).into(),
            self.tool.rotation.slerp(&to.rotation, part),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MeetingTable, ReachSettings, example_cell};
    use super::*;
    use nalgebra::Vector3;
    use rand::{Rng as _, SeedableRng as _};
    use rand_pcg::Pcg64;

    /// Limit of the speed near the operator (m/s).
    const LIMIT: f64 = 0.25;

    /// The guard allows every meeting. It refuses an arm that enters the other arm or the table,
    /// both on a planned path and while the motion is watched. It allows a path out of a collision.
    #[test]
    fn guard_allows_arm_meetings_and_refuses_collisions() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meetings = table.grasps.iter().flatten().chain(table.views.iter().flatten().flatten());
        let (mut refused, mut into, mut on_and_on) = (0, 0, 0);
        for meeting in meetings {
            // The hands are at one cube, so they are to meet.
            let distances =
                |stand: [Option<&JointPositions>; 2]| guard.distances(stand).meeting(Pairs::ALL);
            let free = distances([Some(&meeting.track), Some(&meeting.postument)]);
            assert_eq!(guard.check_motion(&free, &free), Ok(()));
            // Joint 2 is turned so far that the postument's hand is in the table.
            let mut low = meeting.postument;
            low.0[2] += 0.9;
            let watched = |track: &JointPositions, postument: &JointPositions| {
                guard.check_motion(&free, &distances([Some(track), Some(postument)]))
            };
            let lowered = watched(&meeting.track, &low);
            assert!(
                matches!(&lowered, Err(Near::Table { arm, .. }) if arm == "postument"),
                "{lowered:?}"
            );
            // Moves the track arm on along its track, in steps of 50 mm.
            let nearer = |by: u32| {
                let mut near = meeting.track;
                near.0[0] += 0.05 * f64::from(by);
                near
            };
            let meets = |track: &JointPositions| {
                matches!(watched(track, &meeting.postument), Err(Near::Arms { .. }))
            };
            let Some(near) = (1..=20).map(nearer).find(meets) else { continue };
            refused += 1;

            // The path to the place that is too near is refused, the path back from it is not.
            let ends = [&meeting.track, &near].map(|track| [Some(track), Some(&meeting.postument)]);
            let to = |ends: [Option<&JointPositions>; 2]| {
                ends.map(|to| PlannedMotion::Joints(*to.unwrap()))
            };
            let into_arm = guard.check_paths(ends[0], to(ends[1]).each_ref());
            assert!(
                matches!(into_arm, Err(Near::Arms { .. } | Near::Hands { .. })),
                "{into_arm:?}"
            );
            // Fingers and cubes that are apart at both ends may be too near on the path.
            let out = guard.check_paths(ends[1], to(ends[0]).each_ref());
            assert!(matches!(out, Ok(()) | Err(Near::Hands { .. })), "{out:?}");

            // If bodies are too near already, the arm still may not go on in the same direction,
            // and the other hand may not enter the table.
            let mut on = near;
            on.0[0] += 0.02;
            let on = [Some(&on), Some(&meeting.postument)];
            let nears = distances(on).arms < distances(ends[1]).arms;
            let further = guard.check_paths(ends[1], to(on).each_ref());
            assert!(further.is_err() == nears || matches!(further, Err(Near::Hands { .. })));
            // A motion that is watched may go on for a while, since its limits are less strict.
            let watched = guard.check_motion(&distances(ends[1]), &distances(on));
            assert!(nears || watched.is_ok());
            on_and_on += usize::from(watched.is_err());
            assert!(
                guard
                    .check_paths(ends[1], [&PlannedMotion::Stays, &PlannedMotion::Joints(low)])
                    .is_err()
            );
            // One arm alone is checked against the table and its own links.
            assert!(
                guard
                    .check_paths(
                        [None, ends[0][1]],
                        [&PlannedMotion::Stays, &PlannedMotion::Joints(low)]
                    )
                    .is_err()
            );
            assert_eq!(
                guard.check_paths(
                    [None, ends[0][1]],
                    [&PlannedMotion::Stays, &PlannedMotion::Stays]
                ),
                Ok(())
            );

            // A line is checked at the places on it, as joint paths are.
            let track = &cell.arms[0];
            let tool = |joints| track.model.base_from_flange(joints) * track.flange_from_tool;
            let there =
                PlannedMotion::Line(tool(&meeting.track) * Pose::translation(0.0, 0.0, 0.1));
            let back =
                PlannedMotion::Line(tool(&meeting.track) * Pose::translation(0.0, 0.0, -0.05));
            into +=
                usize::from(guard.check_paths(ends[0], [&there, &PlannedMotion::Stays]).is_err());
            let out = guard.check_paths(ends[0], [&back, &PlannedMotion::Stays]);
            assert!(matches!(out, Ok(()) | Err(Near::Hands { .. })), "{out:?}");
        }
        // The hands of a view may pass each other, so not all meetings are refused farther on.
        assert!(refused >= 16, "{refused}");
        assert!(into >= refused / 2, "{into} of {refused}");
        assert!(on_and_on >= refused / 2, "{on_and_on} of {refused}");
    }

    /// Checks a path of the track arm past the postument, drawn at random, on which the arms are
    /// too near only between two of the places at which every path is checked.
    #[test]
    fn path_check_finds_collisions_between_coarse_steps() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let postument = &meeting.postument;
        let mut random = Pcg64::seed_from_u64(1);
        let mut drawn = || {
            let mut track = meeting.track;
            // Behind the meeting and turned away from it, the arms are mostly apart.
            track.0[0] -= random.random_range(0.0..0.6);
            track.0[1..5].iter_mut().for_each(|joint| *joint += random.random_range(-1.2..1.2));
            track
        };
        // The least distance between the arms on a path, measured in this number of steps.
        let least = |from: &JointPositions, to: &JointPositions, steps: u32| {
            let nearest = |step: u32| {
                let track = from.towards(to, f64::from(step) / f64::from(steps));
                let distances = guard.distances([Some(&track), Some(postument)]);
                distances.arms[0].unwrap().min(distances.hands[0].unwrap())
            };
            (0..=steps).map(nearest).fold(f64::INFINITY, f64::min)
        };

        let paths = std::iter::repeat_with(|| (drawn(), drawn())).take(20_000);
        let mut overlooked = paths.filter(|(from, to)| {
            (MIN_DISTANCE..0.05).contains(&least(from, to, STEPS))
                && least(from, to, 20 * STEPS) < 0.8 * MIN_DISTANCE
        });
        let (from, to) = overlooked.next().unwrap();
        let refused = guard.check_paths(
            [Some(&from), Some(postument)],
            [&PlannedMotion::Joints(to), &PlannedMotion::Stays],
        );

        assert!(matches!(refused, Err(Near::Arms { .. } | Near::Hands { .. })), "{refused:?}");
    }

    /// Checks random straight paths of the tool. On some of them the inverse kinematics jumps to
    /// another branch. There, halving the interval until the motion is small would never end.
    #[test]
    fn path_check_terminates_at_jumps_of_inverse_kinematics() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let track = &cell.arms[0];
        let mut random = Pcg64::seed_from_u64(2);
        let mut refused = 0;
        for _ in 0..2000 {
            let mut from = track.start;
            for (joint, (low, high)) in from.0.iter_mut().zip(&track.model.joint_limits) {
                *joint = random.random_range(*low..*high);
            }
            let mut drawn = |most: f64| Vector3::from_fn(|_, _| random.random_range(-most..most));
            let tool = track.model.base_from_flange(&from) * track.flange_from_tool;
            let to = PlannedMotion::Line(tool * Pose::new(drawn(0.2), drawn(0.6)));
            let checked = guard.check_paths([Some(&from), None], [&to, &PlannedMotion::Stays]);
            refused += u32::from(checked.is_err());
        }
        assert!((1..2000).contains(&refused), "{refused} of 2000 are refused");
    }

    /// Hands that begin and end apart may not meet in between. Hands that end at one cube may.
    #[test]
    fn hands_may_come_near_only_at_shared_cube() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let (mut met, mut passed) = (0, 0);
        for meeting in table.grasps.iter().flatten() {
            let along = |by: f64| {
                let mut track = meeting.track;
                track.0[0] += by;
                track
            };
            let stands = |track| [Some(track), Some(&meeting.postument)];
            let (before, behind) = (along(-0.3), along(0.3));
            let (back, to) = (&meeting.track_back, PlannedMotion::Joints(meeting.track));
            assert!(guard.may_meet(stands(back), [&to, &PlannedMotion::Stays]).join(0, 1));
            assert_eq!(
                guard.check_paths(stands(back), [&to, &PlannedMotion::Stays]),
                Ok(()),
                "the hands must meet"
            );
            met += 1;

            // Arms that an operator moves must not meet.
            if guard.distances(stands(back)).apart(0) {
                let by_hand =
                    guard.clone().by_hand().check_paths(stands(back), [&to, &PlannedMotion::Stays]);
                assert!(matches!(by_hand, Err(Near::Hands { .. })), "{by_hand:?}");
            }

            let past = PlannedMotion::Joints(behind);
            if guard.may_meet(stands(&before), [&past, &PlannedMotion::Stays]).join(0, 1) {
                continue;
            }
            let way = guard.check_paths(stands(&before), [&past, &PlannedMotion::Stays]);
            assert!(way.is_err(), "a path through the other hand is refused");
            passed += usize::from(matches!(way, Err(Near::Hands { .. })));
            // While they are watched, the hands may be at one cube only if they are to meet.
            let (far, near) =
                (guard.distances(stands(&before)), guard.distances(stands(&meeting.track)));
            assert!(matches!(guard.check_motion(&far, &near), Err(Near::Hands { .. })));
            assert_eq!(
                guard.check_motion(&far.meeting(Pairs::ALL), &near.meeting(Pairs::ALL)),
                Ok(())
            );
        }
        assert!(met >= 12 && passed >= 4, "{met} {passed}");
    }

    /// A third arm where the second one is keeps the same distances. It may not come to two hands
    /// that meet at a cube, nor to the hand that goes to meet another one; a pair that is too near
    /// frees no other one.
    #[test]
    fn guard_watches_each_pair_of_three_arms() {
        let mut cell = example_cell();
        let pair = Guard::of(&cell, LIMIT);
        let third = crate::cell::Arm { name: "third".to_owned(), ..cell.arms[1].clone() };
        cell.arms.push(third);
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let (mut met, mut refused) = (0, 0);
        for meeting in table.grasps.iter().flatten() {
            let (track, there) = (Some(&meeting.track), Some(&meeting.postument));
            let of_pair = pair.distances([track, there]);
            let of_third = guard.distances([track, None, there]);
            // The pairs are (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3).
            assert_eq!((of_third.arms[1], of_third.hands[1]), (of_pair.arms[0], of_pair.hands[0]));
            assert_eq!((of_third.own[2], of_third.hands[0]), (of_pair.own[1], None));

            // Two hands meet, and the third one comes from aside.
            let mut aside = meeting.postument;
            aside.0[1] += 1.2;
            let from = [track, there, Some(&aside)];
            let to = PlannedMotion::Joints(meeting.postument);
            let ways = [&PlannedMotion::Stays, &PlannedMotion::Stays, &to];
            let joined = guard.may_meet(from, ways);
            assert!(joined.join(0, 1) && !joined.join(0, 2) && !joined.join(1, 2));
            let (far, near) = (guard.distances(from), guard.distances([track, there, there]));
            let (far, near) = (far.meeting(joined), near.meeting(joined));
            assert_eq!(guard.check_motion(&far, &far), Ok(()));
            assert!(guard.check_motion(&far, &near).is_err());
            met += 1;
            let why = guard.check_paths(from, ways);
            refused += usize::from(why.is_err_and(|why| why.to_string().contains(" third ")));

            // The second and the third arm are in each other; the first may not come to them.
            let mut before = meeting.track;
            before.0[0] -= 0.6;
            let from = [Some(&before), there, there];
            let past = PlannedMotion::Joints(meeting.track);
            let ways = [&past, &PlannedMotion::Stays, &PlannedMotion::Stays];
            let both = guard.may_meet(from, ways);
            assert!(!(both.join(0, 1) && both.join(0, 2)), "a hand meets one other");
            assert!(guard.check_paths(from, ways).is_err());
        }
        assert!(met >= 12 && refused == met, "{refused} of {met}");
    }

    /// Jaws that are about as far open as the cube's edge count as holding it. So do jaws whose
    /// opening is unknown.
    #[test]
    fn jaws_as_wide_as_cube_count_as_holding() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let edge = cell.cube.edge;
        let mut told_apart = 0;
        for meeting in table.grasps.iter().flatten() {
            let apart = |openings: [Option<f64>; 2]| {
                let mut guard = Guard::of(&cell, LIMIT);
                guard.holding(openings);
                guard.distances([Some(&meeting.track_back), Some(&meeting.postument)]).hands[0]
                    .unwrap()
            };
            let (held, empty) = (apart([Some(edge); 2]), apart([Some(0.0); 2]));
            told_apart += usize::from(held < empty);
            // A calibration may have an error, and a grasp may be tilted.
            for wide in [None, Some(edge - 0.005), Some(edge + 0.005)] {
                assert_eq!(apart([wide; 2]), held, "{wide:?}");
            }
            for wide in [edge - 0.007, edge + 0.007, 0.09] {
                assert_eq!(apart([Some(wide); 2]), empty, "{wide}");
            }
            // Jaws whose opening has become unknown may have closed on a cube in the meantime.
            let mut guard = Guard::of(&cell, LIMIT);
            guard.holding([Some(0.0); 2]);
            guard.holding([None; 2]);
            let distances = guard.distances([Some(&meeting.track_back), Some(&meeting.postument)]);
            assert_eq!(distances.hands[0], Some(held));
        }
        assert!(told_apart >= 4, "{told_apart}");
    }

    /// A body that has left a collision may not return. A body that is still too near may come
    /// still nearer, but by 2 mm at most.
    #[test]
    fn watched_motion_near_table_may_dip_by_tolerance() {
        let guard = Guard::of(&example_cell(), LIMIT);
        let above = |height: f64| Distances {
            table: [Some(height), None, None, None],
            ..Distances::default()
        };

        assert_eq!(above(0.05).or_more(&above(0.01)), above(0.05));
        assert_eq!(above(0.01).or_more(&above(0.05)), above(0.05));
        // An arm that is unknown now has no distance to keep. An arm that is known for the first
        // time keeps its present one.
        assert_eq!(Distances::default().or_more(&above(0.05)), Distances::default());
        assert_eq!(above(0.01).or_more(&Distances::default()), above(0.01));

        assert!(guard.check_motion(&above(0.05), &above(0.004)).is_err());
        // A hand that is watched may dip when it is turned out of a corner.
        assert_eq!(guard.check_motion(&above(0.004), &above(0.0025)), Ok(()));
        assert!(guard.check_motion(&above(0.004), &above(0.0015)).is_err());

        // Arms that pass each other on a path that keeps 6 mm may deviate from it by 2 mm.
        let apart = |arms: f64| {
            let mut distances = Distances::default();
            distances.arms[0] = Some(arms);
            distances
        };
        assert_eq!(guard.check_motion(&apart(0.05), &apart(0.0041)), Ok(()));
        assert!(guard.check_motion(&apart(0.05), &apart(0.0039)).is_err());
    }

    /// A planned path from a place too near the table may not come nearer, even where a motion that
    /// is watched may by up to 2 mm.
    #[test]
    fn planned_path_towards_too_near_table_is_refused() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let mut low = table.grasps.iter().flatten().next().unwrap().postument;
        low.0[2] += 0.9;
        let height =
            |joints: &JointPositions| guard.distances([None, Some(joints)]).table[1].unwrap();
        assert!(height(&low) < MIN_HEIGHT);
        let lower = |by: u32| {
            let mut lower = low;
            lower.0[2] += 1e-4 * f64::from(by);
            lower
        };

        let by = (1..100).find(|by| height(&low) - height(&lower(*by)) > 1e-3).unwrap();
        let (from, to) = ([None, Some(&low)], lower(by));

        assert!(height(&low) - height(&to) < DIP_WATCHED);
        let asked = guard.check_paths(from, [&PlannedMotion::Stays, &PlannedMotion::Joints(to)]);
        assert!(matches!(asked, Err(Near::Table { .. })), "{asked:?}");
        assert_eq!(
            guard.check_motion(&guard.distances(from), &guard.distances([None, Some(&to)])),
            Ok(())
        );
        // A path whose end alone is too low is refused as well.
        let above = table.grasps.iter().flatten().next().unwrap().postument;
        let down = guard.check_paths(
            [None, Some(&above)],
            [&PlannedMotion::Stays, &PlannedMotion::Joints(low)],
        );
        assert!(matches!(down, Err(Near::Table { .. })), "{down:?}");
    }

    #[test]
    fn straight_path_ends_at_tools_target_orientation() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let arm = &cell.arms[0];
        let tool =
            |joints: &JointPositions| arm.model.base_from_flange(joints) * arm.flange_from_tool;
        let mut led = 0;
        for meeting in table.grasps.iter().flatten() {
            for by in [-0.3, 0.3] {
                let turn =
                    nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), by);
                let to = tool(&meeting.track) * turn;
                let flange = to * arm.flange_from_tool.inverse();
                if arm.model.inverse(&flange, &meeting.track).is_err() {
                    continue;
                }

                let end = guard.course(0, &meeting.track, &PlannedMotion::Line(to)).at(1.0);

                assert!(tool(&end).rotation.angle_to(&to.rotation) < 1e-6);
                led += 1;
            }
        }
        assert!(led >= 8, "{led}");
    }

    #[test]
    fn only_hand_taking_cube_may_enter_operator_zone() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let stands = [Some(&meeting.track), Some(&meeting.postument)];
        let mut turned = [meeting.track, meeting.postument];
        // Both arms are turned aside by the waist, and the checked path leads back.
        turned[0].0[1] += 0.6;
        turned[1].0[1] += 0.6;
        let went = |arm: usize, at: Point3<f64>, keeper: Keeper| {
            let mut cell = cell.clone();
            cell.hand.world_from_cube = Pose::translation(at.x, at.y, at.z);
            cell.hand.half_extent = nalgebra::Vector3::repeat(0.03);
            cell.keeper = keeper;
            let guard = Guard::of(&cell, LIMIT);
            let mut from = stands;
            from[arm] = Some(&turned[arm]);
            let back = PlannedMotion::Joints(*stands[arm].unwrap());
            let ways = if arm == 0 {
                [&back, &PlannedMotion::Stays]
            } else {
                [&PlannedMotion::Stays, &back]
            };
            let asked = guard.check_paths(from, ways);
            let watched = guard.check_motion(
                &guard.distances(from).meeting(Pairs::ALL),
                &guard.distances(stands).meeting(Pairs::ALL),
            );
            assert_eq!(asked.is_err(), watched.is_err(), "{asked:?} {watched:?}");
            asked
        };
        let points = |arm: usize| {
            let of = &cell.arms[arm];
            of.model.points(stands[arm].unwrap()).map(|p| of.world_from_base * p)
        };
        let refused =
            |way: Result<(), Near>| way.is_err_and(|near| near.to_string().contains("zone"));

        let forearm = |arm: usize| nalgebra::center(&points(arm)[2], &points(arm)[3]);
        // No part of the postument may enter the zone, and the forearm of the track may not either.
        assert!(refused(went(1, forearm(1), Keeper::Person)));
        assert!(refused(went(1, points(1)[4], Keeper::Person)));
        assert!(refused(went(0, forearm(0), Keeper::Person)));
        assert_eq!(went(0, points(0)[4], Keeper::Person), Ok(()), "its hand takes the cube");
        // Where the cube is taken from a table, there is no person to protect.
        assert_eq!(went(1, points(1)[4], Keeper::Table), Ok(()));
    }

    #[test]
    fn speed_is_limited_only_near_operator() {
        let cell = example_cell();
        let guard = Guard::of(&cell, LIMIT);
        let arm = &cell.arms[0];
        // The tool is on the -x side of the operator's zone and points along +x.
        let rotation =
            nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), 1.571);
        let standing = |x: f64| {
            let centre = cell.hand.world_from_cube.translation.vector;
            let tool = Pose::from_parts((centre - nalgebra::Vector3::x() * x).into(), rotation);
            let flange = arm.world_from_base.inverse() * tool * arm.flange_from_tool.inverse();
            let stance = JointPositions([0.4, 0.0, -1.6, 0.3, 1.3, 1.57, 0.0]);
            (arm.model.inverse(&flange, &stance).unwrap(), arm.world_from_base.inverse() * tool)
        };
        let ((far, _), (near, at)) = (standing(0.25), standing(0.05));
        let even = |u: f64| u;

        // The path of 0.2 m is slow enough in 1.2 s, but not in 0.6 s.
        for way in [PlannedMotion::Line(at), PlannedMotion::Joints(near)] {
            let slow = guard.course(0, &far, &way).hand_speed_factor(1.2, even);
            let fast = guard.course(0, &far, &way).hand_speed_factor(0.6, even);
            assert!(slow > 0.5 && slow <= 1.0, "{slow}");
            assert!((fast / slow - 2.0).abs() < 1e-9, "{fast} {slow}");
        }
        assert!(guard.check_speed(0, &far, &near, 1.2).is_ok());
        let told = guard.check_speed(0, &far, &near, 0.4).unwrap_err().to_string();
        // 0.2 m in 0.4 s are 0.5 m/s; other points of the hand may be a little faster.
        assert!(told.contains("track arm moves at 5") && told.contains("mm/s"), "{told}");
        // The surface of a part counts: its centre is beyond the threshold here.
        let (bodies, mut aside) = (guard.bodies(0, &near), cell.clone());
        let nearest = |cell: &Cell, counts: f64| {
            let zone_from_world = cell.hand.world_from_cube.inverse();
            let off = bodies
                .hand()
                .map(|(at, radius)| cell.hand.distance(&(zone_from_world * at)) - counts * radius);
            off.into_iter().fold(f64::INFINITY, f64::min)
        };
        while nearest(&aside, 0.0) < 1.1 * SLOW_DISTANCE {
            aside.hand.world_from_cube.translation.vector.z += 0.001;
        }
        assert!(nearest(&aside, 1.0) < 0.9 * SLOW_DISTANCE);
        let mut moved = near;
        moved.0[6] += 0.5;
        moved.0[5] += 0.1;
        assert!(Guard::of(&aside, LIMIT).check_speed(0, &near, &moved, 0.01).is_err());
        // Far from the operator's zone, or without a person, the hand may move as fast.
        let mut elsewhere = cell.clone();
        elsewhere.hand.world_from_cube.translation.vector.x += 1.0;
        for cell in [elsewhere, Cell { keeper: Keeper::Table, ..cell.clone() }] {
            let guard = Guard::of(&cell, LIMIT);
            let course = guard.course(0, &far, &PlannedMotion::Line(at));
            assert_eq!(course.hand_speed_factor(0.2, even), 0.0);
            assert!(guard.check_speed(0, &far, &near, 0.1).is_ok());
        }
    }

    /// The limit begins where the surface of the hand is 180 mm from the zone. A fifth more speed
    /// is tolerated.
    #[test]
    fn hand_speed_limit_begins_180_mm_from_zone() {
        let mut cell = example_cell();
        let from = JointPositions([0.4, 0.0, -1.6, 0.3, 1.3, 1.57, 0.0]);
        let mut to = from;
        to.0[1] += 1e-3;
        let bodies = Guard::of(&cell, LIMIT).bodies(0, &from);
        let nearest = |cell: &Cell| {
            let zone_from_world = cell.hand.world_from_cube.inverse();
            let off = bodies
                .hand()
                .map(|(at, radius)| cell.hand.distance(&(zone_from_world * at)) - radius);
            off.into_iter().fold(f64::INFINITY, f64::min)
        };
        // The zone moves away from the hand.
        cell.hand.world_from_cube.translation.vector = bodies.hand()[6].0.coords;
        for (distance, limited) in [(0.175, true), (0.185, false)] {
            while nearest(&cell) < distance {
                cell.hand.world_from_cube.translation.vector.x += 5e-4;
            }
            let guard = Guard::of(&cell, LIMIT);
            assert_eq!(guard.check_speed(0, &from, &to, 1e-3).is_err(), limited, "{distance}");
            let course = guard.course(0, &from, &PlannedMotion::Joints(to));
            assert_eq!(course.hand_speed_factor(1e-3, |u| u) > 0.0, limited, "{distance}");
            let Err(Near::TooFast { speed, .. }) = guard.check_speed(0, &from, &to, 1e-3) else {
                continue;
            };
            let way = speed * 1e-3;
            assert_eq!(guard.check_speed(0, &from, &to, way / (1.15 * LIMIT)), Ok(()));
            assert!(guard.check_speed(0, &from, &to, way / (1.25 * LIMIT)).is_err());
        }
    }

    /// Returns the joint positions of both arms if only those of this arm are known.
    fn alone(arm: usize, joints: &JointPositions) -> [Option<&JointPositions>; 2] {
        if arm == 0 { [Some(joints), None] } else { [None, Some(joints)] }
    }

    /// Random paths of one arm, on which the hand stays above the table and comes too near its own
    /// arm.
    #[test]
    fn hand_too_near_its_own_arm_is_refused() {
        let cell = Cell { keeper: Keeper::Table, table_height: 0.0, ..example_cell() };
        let guard = Guard::of(&cell, LIMIT);
        let mut random = Pcg64::seed_from_u64(3);
        for (i, arm) in cell.arms.iter().enumerate() {
            let distances = |joints: &JointPositions| guard.distances(alone(i, joints));
            let from = arm.start;
            let mut drawn = || {
                JointPositions(arm.model.joint_limits.map(|(low, high)| {
                    if low < high { random.random_range(low..high) } else { low }
                }))
            };
            let above = |to: &JointPositions| {
                let at = |part: u32| from.towards(to, f64::from(part) / 100.0);
                (0..=100).all(|part| distances(&at(part)).table[i].unwrap() > 0.03)
            };
            let near = |to: &JointPositions| distances(to).own[i].unwrap() < MIN_DISTANCE;
            let paths = std::iter::repeat_with(&mut drawn).take(100_000);
            let to = paths.into_iter().find(|to| near(to) && above(to)).unwrap();

            let way = PlannedMotion::Joints(to);
            let stays = PlannedMotion::Stays;
            let ways = if i == 0 { [&way, &stays] } else { [&stays, &way] };
            let asked = guard.check_paths(alone(i, &from), ways);
            let watched = guard.check_motion(&distances(&from), &distances(&to));
            for refused in [asked, watched] {
                let Err(Near::Own { arm: name, distance }) = refused else { panic!("{refused:?}") };
                assert!(name == arm.name && distance < MIN_DISTANCE, "{name}: {distance}");
            }
        }
    }

    #[test]
    fn forearm_speed_is_limited_near_operator() {
        let mut cell = example_cell();
        let from = JointPositions([0.4, 0.0, -1.6, 0.3, 1.3, 1.57, 0.0]);
        let mut to = from;
        to.0[1] += 0.05;
        let bodies = Guard::of(&cell, LIMIT).bodies(0, &from);
        // The elbow is at the operator's place, and the hand is an arm's length away.
        cell.hand.world_from_cube.translation.vector = bodies.forearm()[0].0.coords;
        let zone_from_world = cell.hand.world_from_cube.inverse();
        let off =
            |(at, radius): (Point3<f64>, f64)| cell.hand.distance(&(zone_from_world * at)) - radius;
        assert!(bodies.hand().map(off).into_iter().all(|off| off > 1.2 * SLOW_DISTANCE));

        let guard = Guard::of(&cell, LIMIT);
        assert!(guard.check_speed(0, &from, &to, 0.01).is_err());
        assert!(guard.check_speed(0, &from, &to, 1.0).is_ok());
    }
}
