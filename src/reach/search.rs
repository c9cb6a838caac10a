//! The search for meetings: seeded samples, then improvement of the best ones.
//!
//! A candidate is a cube in space, the grasp of the first hand, the travel of the track and, for a
//! view, the roll of the camera. The joint positions of both arms follow in closed form. The cost
//! of a candidate is a time (s): that of the motion to it from joint positions that are the
//! reference of all meetings, so that motions between meetings are short. Narrow margins add
//! penalties.
//!
//! | sample | share | reason |
//! |---|---|---|
//! | near the best one so far, in wide and in narrow steps by turns | 1/2 | improvement |
//! | another grasp of the cube where another meeting has it | 3/8 | short paths between meetings |
//! | anywhere in `BOX` | 1/8 | escape from a local minimum |

use super::bodies::{Bodies, apart, at_the_cube, hands_fit};
use super::meeting::{Meeting, MeetingTable};
use super::settings::ReachSettings;
use super::stance::{Demand, Roll, Stance, stances};
use super::ways::way_clearance;
use crate::cell::{Arm, Cell, Mount};
use crate::cube::rotations;
use crate::motion::JointPositions;
use crate::spatial::{Pose, pose_from_axes};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use std::f64::consts::PI;

/// Space in which cubes are tried (m): x, y, z of the world, between the arms.
const BOX: [(f64, f64); 3] = [(-0.3, 0.9), (0.8, 1.7), (1.0, 1.8)];
/// Room that the track keeps beyond the separation, and twice that at its far end (m).
const TRACK_ROOM: f64 = 0.02;
/// Clearance below which a candidate is penalised (m).
const GOOD_CLEARANCE: f64 = 0.06;

/// Kind of meeting that is searched for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wanted {
    /// Both hands hold the cube; this is the rotation of the postument's tool in the track's tool
    /// frame.
    Grasp(UnitQuaternion<f64>),
    /// The arm `holder` (0 track, 1 postument) has the cube, and the other hand's camera looks at
    /// the face with this outward `normal` in the holder's tool frame.
    View { holder: usize, normal: Vector3<f64> },
}

/// A sample of the search, from which both arms' joints follow.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    /// Pose of the holder's tool, or of the track's tool when both hold.
    world_from_tool: Pose,
    /// Travel of the track, d0 (m).
    track: f64,
    /// Roll of the camera about its optical axis, for a view (rad).
    roll: f64,
}

/// A candidate that is allowed, with its meeting.
#[derive(Debug, Clone, Copy)]
struct Found {
    candidate: Candidate,
    meeting: Meeting,
    /// Cost (s).
    cost: f64,
}

impl MeetingTable {
    /// Searches the meetings of the track arm (`cell.arms[0]`) and the postument arm
    /// (`cell.arms[1]`), in about a second. The table is empty if the cell has fewer than two arms,
    /// or if the first arm has no track on which it could retract.
    #[must_use]
    pub fn compute(cell: &Cell, settings: &ReachSettings) -> Self {
        table(cell, settings)
    }
}

/// Searches all meetings, as [`MeetingTable::compute`] describes.
fn table(cell: &Cell, settings: &ReachSettings) -> MeetingTable {
    let mut table = MeetingTable {
        grasps: [None; 24],
        views: [[None; 3]; 2],
        separation: settings.separation,
        ways: Vec::new(),
    };
    if cell.arms.len() < 2 || !cell.arms[0].model.has_track {
        return table;
    }
    let mut search = Search::new(cell, settings);
    let wanted = wanted(cell);
    let mut found: Vec<Option<Found>> = vec![None; wanted.len()];
    for _ in 0..ROUNDS {
        for (i, wanted) in wanted.iter().enumerate() {
            found[i] = search.improve(wanted, found[i].as_ref());
            // The searches for other meetings also try the cube at the place of this one.
            search.known.extend(found[i].map(|f| f.candidate.world_from_tool));
        }
        search.settle(&found);
        // The reference has changed, and the costs with it.
        for (wanted, slot) in wanted.iter().zip(&mut found) {
            *slot = slot.and_then(|f| search.evaluate(wanted, &f.candidate, f64::INFINITY));
        }
    }
    clear_ways(&mut search, &wanted, &mut found);
    // `wanted` lists the grasps that the fingers allow, then the views, in the table's order.
    let mut found = found.into_iter();
    for (slot, rotation) in table.grasps.iter_mut().zip(rotations()) {
        if hands_fit(cell, &rotation) {
            *slot = found.next().flatten().map(|f| f.meeting);
        }
    }
    for slot in table.views.iter_mut().flatten() {
        *slot = found.next().flatten().map(|f| f.meeting);
    }
    table
}

/// Searches again for the meetings from which paths to other meetings are blocked, beginning with
/// the most blocked one. It accepts only places from which all these paths are free. A meeting for
/// which there is no such place stays where it is.
fn clear_ways(search: &mut Search, wanted: &[Wanted], found: &mut [Option<Found>]) {
    let mut tried = vec![false; found.len()];
    for _ in 0..found.len() {
        // Counted again in each round: a meeting that moves may block or free others.
        let blocked = |i: usize| {
            let Some(one) = found[i] else { return 0 };
            let others = found.iter().flatten();
            others.filter(|other| search.way_is_blocked(&one.meeting, &other.meeting)).count()
        };
        let worst = (0..found.len())
            .filter(|&i| !tried[i])
            .map(|i| (blocked(i), i))
            // Among equally blocked meetings the first one, so that the table is repeatable.
            .max_by_key(|&(count, i)| (count, std::cmp::Reverse(i)));
        let Some((1.., worst)) = worst else { return };
        tried[worst] = true;
        let others = found.iter().enumerate().filter(|(i, _)| *i != worst);
        search.peers = others.filter_map(|(_, f)| f.map(|f| f.meeting)).collect();
        found[worst] = search.improve(&wanted[worst], None).or(found[worst]);
        search.peers.clear();
    }
}

/// Rounds of sampling over the whole table; each ends with a new reference.
const ROUNDS: u32 = 3;

/// Returns the demands on all meetings of the table: the grasps that the fingers allow, then the
/// views.
fn wanted(cell: &Cell) -> Vec<Wanted> {
    let grasps = rotations().into_iter().filter(|r| hands_fit(cell, r)).map(Wanted::Grasp);
    let views = [0, 1].into_iter().flat_map(|holder| {
        [Vector3::z(), Vector3::x(), -Vector3::x()].map(|normal| Wanted::View { holder, normal })
    });
    grasps.chain(views).collect()
}

/// State of the search.
struct Search<'a> {
    cell: &'a Cell,
    settings: &'a ReachSettings,
    random: Pcg64,
    /// Joint positions of both arms from which the motion to each candidate is timed.
    reference: [JointPositions; 2],
    /// The `world_from_tool` of each meeting found so far: good places for other meetings too.
    known: Vec<Pose>,
    /// Travel of the track in the reference, d0 (m).
    track: f64,
    /// Meetings to which the usual path from a new meeting must be free.
    peers: Vec<Meeting>,
    /// The [`rotations`] of a cube.
    rotations: [UnitQuaternion<f64>; 24],
}

impl<'a> Search<'a> {
    /// Makes a search that has found no meeting yet.
    fn new(cell: &'a Cell, settings: &'a ReachSettings) -> Self {
        // The first reference: both arms bent, each facing its partner.
        let facing = |sign: f64, track: f64, roll: f64| {
            JointPositions([track, sign * 1.4, -1.57, 0.0, 0.0, roll, 0.0])
        };
        let track = settings.separation + 0.2;
        Self {
            cell,
            settings,
            random: Pcg64::seed_from_u64(settings.seed),
            reference: [facing(1.0, track, 3.0), facing(-1.0, 0.0, 3.0)],
            known: Vec::new(),
            track,
            peers: Vec::new(),
            rotations: rotations(),
        }
    }

    /// Draws new samples and returns the cheapest meeting that fulfils `wanted`, which may be the
    /// one `known` before; `None` if there is none at all.
    fn improve(&mut self, wanted: &Wanted, known: Option<&Found>) -> Option<Found> {
        let mut best = known.copied();
        for i in 0..self.settings.samples {
            let candidate = match &best {
                // Near the best one: wide steps leave a local minimum, narrow ones refine.
                Some(found) if i % 2 == 0 => {
                    let size = if i % 4 == 0 { 0.3 } else { 0.08 };
                    self.next_to(&found.candidate, size)
                }
                // The cube where another meeting has it, so that the path between them is short.
                _ if !self.known.is_empty() && i % 8 != 1 => self.like_another(),
                _ => self.anywhere(),
            };
            let limit = best.map_or(f64::INFINITY, |f| f.cost);
            if let Some(found) = self.evaluate(wanted, &candidate, limit) {
                best = Some(found);
            }
        }
        best
    }

    /// Sets the reference joint positions to the medians over all `found` meetings, joint by joint.
    fn settle(&mut self, found: &[Option<Found>]) {
        let middle = |of: &dyn Fn(&Meeting) -> JointPositions| {
            JointPositions(std::array::from_fn(|axis| {
                let mut values: Vec<f64> =
                    found.iter().flatten().map(|f| of(&f.meeting).0[axis]).collect();
                values.sort_by(f64::total_cmp);
                values.get(values.len() / 2).copied().unwrap_or_default()
            }))
        };
        if found.iter().any(Option::is_some) {
            self.reference = [middle(&|m| m.track), middle(&|m| m.postument)];
            self.track = self.reference[0].0[0];
        }
    }

    /// Returns a candidate drawn from the whole space of the search.
    fn anywhere(&mut self) -> Candidate {
        let [x, y, z] = BOX.map(|(low, high)| self.random.random_range(low..high));
        // A normalised vector of four normal numbers is a uniformly distributed rotation.
        let [a, b, c, d] = [(); 4].map(|()| self.normal());
        let rotation = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(a, b, c, d));
        let (low, high) = self.track_range();
        Candidate {
            world_from_tool: Pose::from_parts(Translation3::new(x, y, z), rotation),
            track: self.random.random_range(low..high),
            roll: self.random.random_range(-PI..PI),
        }
    }

    /// Returns a candidate with the cube near its place in a known meeting, but held in a random
    /// one of the 24 rotations.
    fn like_another(&mut self) -> Candidate {
        let known = self.known[self.random.random_range(0..self.known.len())];
        let other = self.rotations[self.random.random_range(0..24)];
        // The cube's centre is a third of an edge beyond the tool point, since the fingers hold one
        // layer.
        let into = Translation3::new(0.0, 0.0, self.cell.cube.edge / 3.0);
        let candidate = Candidate {
            world_from_tool: known * into * other * into.inverse(),
            track: self.track,
            roll: self.random.random_range(-PI..PI),
        };
        self.next_to(&candidate, 0.2)
    }

    /// Returns a random candidate near `candidate`. `size` scales the standard deviations: with 1
    /// they are 0.3 m, 0.8 rad, 0.2 m of the track, and 1 rad of the camera's roll.
    fn next_to(&mut self, candidate: &Candidate, size: f64) -> Candidate {
        let mut step = |scale: f64| scale * size * self.normal();
        let shift = Vector3::new(step(0.3), step(0.3), step(0.3));
        let turn = Vector3::new(step(0.8), step(0.8), step(0.8));
        let (track, roll) = (candidate.track + step(0.2), candidate.roll + step(1.0));
        let (low, high) = self.track_range();
        let pose = &candidate.world_from_tool;
        Candidate {
            world_from_tool: Pose::from_parts(
                Translation3::from(pose.translation.vector + shift),
                UnitQuaternion::from_scaled_axis(turn) * pose.rotation,
            ),
            track: track.clamp(low, high),
            roll,
        }
    }

    /// Returns a random number of the standard normal distribution.
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    /// Returns the range of track positions d0 from which the track can retract by the separation
    /// (m).
    fn track_range(&self) -> (f64, f64) {
        let (low, high) = self.cell.arms[0].model.joint_limits[0];
        let low = low.max(0.0) + self.settings.separation + TRACK_ROOM;
        (low, (high - 2.0 * TRACK_ROOM).max(low + 1e-6))
    }

    /// Returns the meeting of a candidate, or `None` if it is not allowed or costs `limit` (s) or
    /// more.
    fn evaluate(&self, wanted: &Wanted, candidate: &Candidate, limit: f64) -> Option<Found> {
        let (tools, need) = self.tools(wanted, candidate)?;
        let stances_of = |arm: usize, limit: f64| {
            let demand = Demand {
                arm: &self.cell.arms[arm],
                track: if arm == 0 { candidate.track } else { 0.0 },
                roll: need,
                reference: &self.reference[arm],
                limit,
                settings: self.settings,
            };
            stances(&demand, &tools[arm])
        };
        let track = stances_of(0, limit);
        // The track's cheapest stance uses up part of the limit.
        let postument = stances_of(1, limit - track.0[0]?.cost);
        let mut best: Option<Found> = None;
        for a in track.iter() {
            for b in postument.iter() {
                // A penalty only adds to this cost. A pair that costs too much already is skipped
                // before its distances are computed, which takes long.
                let cost = a.cost + b.cost;
                let below = best.map_or(limit, |f| f.cost);
                if cost >= below {
                    continue;
                }
                let Some(clearance) = self.clearance(wanted, &a, &b) else { continue };
                let cost = cost + 40.0 * (GOOD_CLEARANCE - clearance).max(0.0);
                if cost < below {
                    let meeting = Meeting {
                        track_from_postument: tools[0].inverse() * tools[1],
                        track: a.joints,
                        postument: b.joints,
                        track_back: a.back,
                        postument_back: b.back,
                        track_roll: a.roll,
                        postument_roll: b.roll,
                        clearance,
                    };
                    if !self.peers.iter().any(|peer| self.way_is_blocked(peer, &meeting)) {
                        best = Some(Found { candidate: *candidate, meeting, cost });
                    }
                }
            }
        }
        best
    }

    /// Returns whether the arms come nearer than the clearance on the usual path between two
    /// meetings.
    fn way_is_blocked(&self, a: &Meeting, b: &Meeting) -> bool {
        way_clearance(self.cell, self.settings.separation, a, b) < self.settings.clearance
    }

    /// Returns the poses of both tools in the world, and whether the wrists must be able to roll
    /// there; `None` for a view if no camera is on the other hand.
    fn tools(&self, wanted: &Wanted, candidate: &Candidate) -> Option<([Pose; 2], Roll)> {
        let into = Translation3::new(0.0, 0.0, self.cell.cube.edge / 3.0);
        match wanted {
            // Both hands are one layer deep, so their tool points are equally far from the centre.
            Wanted::Grasp(rotation) => {
                let postument = candidate.world_from_tool * into * *rotation * into.inverse();
                Some(([candidate.world_from_tool, postument], Roll::Needed))
            }
            Wanted::View { holder, normal } => {
                let viewer = 1 - holder;
                let face = Point3::from(into.vector + 0.5 * self.cell.cube.edge * normal);
                // The camera's z is against the face's normal, and its roll is free.
                let side = if normal.z.abs() > 0.5 { Vector3::x() } else { Vector3::z() };
                let (s, c) = libm::sincos(candidate.roll);
                let x = c * side + s * normal.cross(&side);
                let z = -normal;
                let holder_from_camera =
                    pose_from_axes(x, z.cross(&x), z, face + self.settings.view_distance * normal);
                let camera_from_tool = self.camera_from_tool(viewer)?;
                let other = candidate.world_from_tool * holder_from_camera * camera_from_tool;
                let tools = if *holder == 0 {
                    [candidate.world_from_tool, other]
                } else {
                    [other, candidate.world_from_tool]
                };
                Some((tools, Roll::Free))
            }
        }
    }

    /// Returns the pose of the viewer's tool in the frame of the camera on its flange; `None` if
    /// there is no such camera.
    fn camera_from_tool(&self, viewer: usize) -> Option<Pose> {
        self.cell.cameras.iter().find_map(|camera| match camera.mount {
            Mount::Flange { arm, flange_from_camera } if arm == viewer => {
                Some(flange_from_camera.inverse() * self.cell.arms[viewer].flange_from_tool)
            }
            _ => None,
        })
    }

    /// Returns the least distance between the arms at the meeting, while a hand retracts, and while
    /// the track separates (m). Returns `None` if a distance is below the wanted clearance, or if
    /// an arm is too low over the table.
    fn clearance(&self, wanted: &Wanted, a: &Stance, b: &Stance) -> Option<f64> {
        let arms: [&Arm; 2] = [&self.cell.arms[0], &self.cell.arms[1]];
        let floor = self.cell.table_height + self.settings.above_table;
        let enough = |distance: f64| (distance >= self.settings.clearance).then_some(distance);
        let at = [a, b].map(|s| s.joints);
        let back = [a, b].map(|s| s.back);
        let place = |i: usize, joints: &JointPositions| Bodies::of(self.cell, arms[i], joints);
        let here = [place(0, &at[0]), place(1, &at[1])];
        let half_gone = [place(0, &a.half_back), place(1, &b.half_back)];
        let gone = [place(0, &back[0]), place(1, &back[1])];
        if here.iter().chain(&gone).any(|body| body.lowest_axis() < floor) {
            return None;
        }
        let mut least = match wanted {
            Wanted::Grasp(_) => enough(at_the_cube(&here[0], &here[1]))?,
            Wanted::View { holder, .. } => enough(apart(&here[*holder], &here[1 - holder]))?,
        };
        for body in here.iter().chain(&gone) {
            enough(body.own())?;
        }
        // Either hand of a grasp may be the newcomer; at a view it is the one that looks.
        let newcomers: &[usize] = match wanted {
            Wanted::Grasp(_) => &[0, 1],
            Wanted::View { holder, .. } => &[1 - *holder],
        };
        for &newcomer in newcomers {
            let (holder, other) = (here[1 - newcomer], gone[newcomer]);
            // The fingers of a newcomer that is half retracted are still beside the cube, so they
            // are left out.
            least = least.min(enough(at_the_cube(&holder, &half_gone[newcomer]))?);
            least = least.min(enough(self.separating(newcomer, &holder, &other))?);
        }
        Some(least)
    }

    /// Returns the least distance between the arms while the track retracts by the separation (m).
    /// `holder` is the arm that has the cube. `other` is the arm `newcomer` (0 track, 1 postument),
    /// which is retracted along its tool already.
    fn separating(&self, newcomer: usize, holder: &Bodies, other: &Bodies) -> f64 {
        const STEPS: u32 = 5;
        let away = self.cell.arms[0].world_from_base.rotation * -Vector3::y();
        let mut least = f64::INFINITY;
        for i in 0..=STEPS {
            let by = away * (self.settings.separation * f64::from(i) / f64::from(STEPS));
            least = least.min(if newcomer == 0 {
                apart(holder, &other.moved(by))
            } else {
                apart(&holder.moved(by), other)
            });
        }
        least
    }
}
