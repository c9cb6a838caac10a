//! Bookkeeping of the plant: peaks of the contact forces after each substep; the other peaks,
//! slips, drops, pops, stuck layers and collisions at the end of a period.
//!
//! - in: the plant's state
//! - out: its [`Verdict`](super::Verdict), and the cube as the operator sees it
//!
//! | event | threshold | reason |
//! |---|---|---|
//! | slip | 1 mm or 3 deg since closing, unless the jaws open | opening jaws let go |
//! | crush | 150 N at a pad or the palm | assumption |
//! | pop | 3 Nm of tilt or 50 N of pull between two layers | assumption |
//! | stuck | 3 s without 1 deg, 3 deg off a quarter, under load | a layer at rest is not stuck |

use super::collision::{Bodies, HeldCube};
use super::frame::rotation_vector;
use super::grasp::{FRONT_STIFFNESS, Grasp, Hold, only};
use super::hand::Sight;
use super::undoing::Undoing;
use super::verdict::MOST_EVENTS;
use super::{Event, Exertion, GRAVITY, Incident, Part, Plant, State, StillWatch, lowest_face};
use crate::cell::MOST_ARMS;
use crate::cube::{Axis, Keeper};
use crate::spatial::Twist;
use nalgebra::{Point3, Vector3};

impl Plant {
    /// Raises the peaks of the contact forces to those of a substep.
    pub(super) fn record_peaks(&mut self) {
        // The chain is closed as soon as a second hand touches the cube that one holds.
        let both = self.balance.touches.iter().filter(|touch| touch.any()).count() >= 2
            && self.grasps.iter().any(Grasp::holds);
        let v = &mut self.verdict;
        for (i, touch) in self.balance.touches.iter().enumerate().take(self.arms.len()) {
            let (force, torque) = (touch.force.norm(), touch.torque.norm());
            let (pull, twist) = self.objects.contact(i);
            v.arm_peak_force[i] = v.arm_peak_force[i].max(force).max(pull);
            v.arm_peak_torque[i] = v.arm_peak_torque[i].max(torque).max(twist);
            if both {
                v.peak_force = v.peak_force.max(force);
                v.peak_torque = v.peak_torque.max(torque);
            }
        }
    }

    /// Updates the verdict at the end of a period (peaks of motors and speed, slips, crushes,
    /// drops, pops, stuck layers), and lets the operator's hand react.
    pub(super) fn record_period(&mut self) {
        let core = self.balance.core(&self.puzzle);
        // The cube has no inertia in the model, so its velocity is the mean over the period.
        let moved = (core.p - self.core.p) / self.config.period.seconds();
        let turned =
            rotation_vector(&(core.r * self.core.r.transpose())) / self.config.period.seconds();
        self.velocity = Twist { linear: moved, angular: turned };
        self.core = core;
        for i in 0..self.arms.len() {
            let touch = &self.balance.touches[i];
            let squeeze = touch.pads[0].max(touch.pads[1]).max(touch.palm);
            let grasp = &self.grasps[i];
            let (distance, angle) = grasp.slip;
            // The cube does not slip between opening jaws: they let it go.
            let held = grasp.hold == Hold::Closed && !self.jaws[i].opens();
            if held && !grasp.reported && grasp.slipped() {
                self.grasps[i].reported = true;
                self.verdict.counts.slips += 1;
                self.record(Incident::Slip { arm: i, distance, angle });
            }
            if squeeze > 150.0 && !self.crushed[i] {
                self.crushed[i] = true;
                self.verdict.counts.crushed += 1;
                self.record(Incident::Crush { arm: i, squeeze });
            }
        }
        self.measure_exertion();
        // The drop comes before the hand's decision: the operator sees a cube that has fallen.
        self.look_for_drop();
        self.look_for_pop_and_stuck();
        let sight = Sight {
            cube: self.core,
            speed: self.velocity.linear.norm(),
            grippers: self.grasps.iter().filter(|g| g.holds()).count(),
            load: self.balance.touches.iter().map(|t| t.force.norm()).fold(0.0, f64::max),
            solved: self.looks_solved(),
            fallen: matches!(self.state, State::Tray { .. }),
        };
        let t = self.time();
        let carried = self.hand.carries();
        self.hand.decide(t, &sight);
        if self.hand.carries() && !carried {
            // The hand gives up its pull, so its aim jumps back to the cube by 12 mm. Taken for a
            // motion of the hand, the jump made 240 N for a substep.
            self.balance.hand_comes(&self.core);
        }
        let has = self.hand.hold(t).is_some() || self.hand.has_it_back();
        if has != self.operator_has {
            self.operator_has = has;
            if has {
                // The hand may have picked the cube up from the tray.
                self.state = State::Held;
                self.balance.hand_comes(&self.core);
            }
            self.record(Incident::Operator { has_cube: has });
        }
    }

    /// Raises the run's greatest motor current, winding heat, motor speed and arm speed near the
    /// person to those of this period.
    fn measure_exertion(&mut self) {
        let zone = &self.config.cell.hand;
        let zone_from_world = zone.world_from_cube.inverse();
        let is_near = |point: &Vector3<f64>| {
            zone.distance(&(zone_from_world * Point3::from(*point))) < Exertion::NEAR
        };
        let most = &mut self.verdict.exertion;
        for (arm, of) in self.arms.iter().zip(&self.config.cell.arms) {
            arm.exert(most);
            // A cell without a person has no place near one.
            if self.config.cell.keeper == Keeper::Person {
                let fingers = of.gripper.finger_tip;
                most.near_person = most.near_person.max(arm.fastest(fingers, is_near));
            }
        }
    }

    /// Decides which faults act in the next period, and applies them to grasps, layers and the
    /// operator's hand.
    pub(super) fn apply_faults(&mut self) {
        // Without a split no layer turns between two hands.
        let turned = if self.balance.split.is_some() { self.verdict.turned } else { 0.0 };
        let time = self.time();
        self.faults.decide(time, turned);
        let acting = self.faults.acting;
        for (grasp, lost) in self.grasps.iter_mut().zip(acting.lost) {
            // A fault of an open hand has no cube to lose.
            grasp.lost |= lost && grasp.attached();
        }
        self.puzzle.jam = acting.torque;
        if acting.withdraw {
            self.hand.draw_back(time);
        }
        // A cube without a holder falls at once. A balance of forces on it, pinched at another
        // hand's palm, threw it away at 4 m/s with 130 N.
        if acting.lost.contains(&true) {
            self.look_for_drop();
        }
        let closed = |hand: &usize| self.grasps[*hand].hold == Hold::Closed;
        let turns = self.balance.split.filter(|split| split.hands.iter().all(closed));
        self.undoing = self.undoing.after(acting.undo.is_some(), turns, turned);
        if let (Some(takes), Undoing::Turn(_)) = (acting.undo, self.undoing) {
            // The fault undoes a quarter turn in the time that it `takes`.
            self.undo_turn(
                std::f64::consts::FRAC_PI_2 * self.config.period.seconds() / takes.max(1e-3),
            );
        }
    }

    /// Records the collisions that are new in this period, computes the forces of all collisions,
    /// and updates the least distance between the arms.
    pub(super) fn look_for_collisions(&mut self) {
        // The entries of arms that do not exist repeat the last arm's and are not used.
        let last = self.arms.len() - 1;
        let openings = std::array::from_fn(|i| self.jaws[i.min(last)].opening());
        let holds = self.grasps.each_ref().map(Grasp::holds);
        let cube = HeldCube {
            frame: self.balance.nodes[0],
            edge: self.config.cell.cube.edge,
            // A cube in two hands is no obstacle, and an obstacle's load goes to its only holder.
            holder: only(holds),
        };
        let arms = &self.config.cell.arms;
        let grippers = std::array::from_fn(|i| &arms[i.min(last)].gripper);
        let (events, counts) = (&mut self.verdict.events, &mut self.verdict.counts);
        let period = self.period;
        let mut found = |what: Incident| {
            counts.collisions += 1;
            if events.len() < MOST_EVENTS {
                events.push(Event { period, what });
            }
        };
        // The grasp computes the contact of finger ends with the cube; here it is only reported,
        // once.
        for (i, was) in self.fronts.iter_mut().enumerate() {
            let touch = &self.balance.touches[i];
            let is = touch.front > 0.0;
            if is && !*was {
                let (what, with) = (Part::Finger(i), Part::Cube);
                found(Incident::Collision { what, with, depth: touch.front / FRONT_STIFFNESS });
            }
            *was = is;
        }
        let table = self.config.cell.table_height;
        let bodies = Bodies { arms: &self.arms, openings, grippers, cube, table };
        self.collisions.look(&bodies, found);
        self.verdict.exertion.arms_apart = self.collisions.arms_apart;
    }

    /// Checks whether the cube looks solved to a person: each face has one colour, and each layer
    /// is within 0.1 rad of a quarter turn.
    fn looks_solved(&self) -> bool {
        let stickers = self.puzzle.stickers();
        (0..54).all(|i| stickers[i] == stickers[i / 9 * 9 + 4])
            && (0..3).all(|a| self.puzzle.misalignment(a) < 0.1)
    }

    /// Detects that neither a gripper nor the operator holds the cube any more. Records whether it
    /// falls, or an arm has laid it down on the table.
    pub(super) fn look_for_drop(&mut self) {
        if self.state != State::Held || self.hand.has_it_back() {
            return;
        }
        let carried = (0..self.arms.len()).any(|i| self.carries(i));
        if carried || self.hand.hold(self.time()).is_some() {
            return;
        }
        for i in 0..self.arms.len() {
            if self.grasps[i].lost {
                self.record(Incident::GraspLost { arm: i });
            }
        }
        // A grip that is lost has slipped; any other one ends by its opening jaws.
        let let_fall = self.last_holder.is_some() && !self.grasps.iter().any(|g| g.lost);
        // A cube in the air is one body without a grasp.
        self.grasps = [Grasp::OPEN; MOST_ARMS];
        self.regroup();
        // A cube that lies flat on the table when it is let go has been laid down.
        if let Some(arm) = self.last_holder.filter(|_| self.lies()) {
            let down = lowest_face(&self.balance.nodes[0]);
            self.state = State::Tray { down, fell: false };
            self.record(Incident::LaidDown { arm, down });
            return;
        }
        self.state = State::Falling { velocity: self.velocity.linear };
        self.verdict.counts.drops += 1;
        self.verdict.counts.violations.let_fall += u32::from(let_fall);
        self.record(Incident::Drop { arm: self.last_holder });
    }

    /// Checks whether arm `i` carries the cube: its grasp holds, and if its jaws open high above
    /// the table, the friction of their pads still bears the cube's weight. Below it no balance
    /// exists: the search for one pressed a cube that the other hand had just lost against its palm
    /// with 205 N. Near the table the cube slides down onto it.
    fn carries(&self, i: usize) -> bool {
        let (cube, jaws, jaw) = (&self.config.cell.cube, &self.config.jaws, &self.jaws[i]);
        let width = cube.edge.max(self.balance.touches[i].width);
        // Each pad has half of the stiffness over half of the overlap, and both pads rub.
        let grip = 0.25 * jaws.stiffness[1] * (width - jaw.opening());
        let bears = 2.0 * jaws.friction * grip > GRAVITY * cube.mass;
        let high = self.balance.nodes[0].p.z - self.config.cell.table_height > cube.edge;
        self.grasps[i].holds() && (bears || !jaw.opens() || !high)
    }

    /// Checks whether the table carries the cube flat on a face.
    fn lies(&self) -> bool {
        let cube = &self.balance.nodes[0];
        let flat = (cube.r * lowest_face(cube).normal()).z < -0.99;
        flat && self.balance.table_load() > 0.0
    }

    /// Detects a layer that pops off, and a loaded layer that has not moved for 3 s.
    fn look_for_pop_and_stuck(&mut self) {
        let Some(split) = self.balance.split else { return };
        let interface = self.balance.interface;
        self.verdict.turned = self.relative_angle() - self.angle_at_split;
        if !self.popped && (interface.tilt > 3.0 || interface.axial.abs() > 50.0) {
            self.popped = true;
            self.verdict.counts.pops += 1;
            self.record(Incident::Pop { tilt: interface.tilt, pull: interface.axial });
        }
        let angle = self.relative_angle();
        let off = self.puzzle.misalignment(split.axis);
        let loaded = interface.torque.abs() > 0.5 * interface.limit;
        // A motion of 1 deg restarts the watch. An unloaded layer, or one at a quarter, restarts
        // its time alone.
        if (angle - self.watch.angle).abs() > 1_f64.to_radians() {
            self.watch = StillWatch { angle, since: self.period, reported: false };
        } else if !loaded || off < 3_f64.to_radians() {
            self.watch.since = self.period;
        } else if !self.watch.reported
            && (self.period - self.watch.since) as f64 * self.config.period.seconds() > 3.0
        {
            self.watch.reported = true;
            self.verdict.counts.stuck += 1;
            self.record(Incident::Stuck {
                axis: Axis::ALL[split.axis],
                angle: off,
                torque: interface.torque,
            });
        }
    }

    /// Adds an event to the verdict, and passes it to the faults that wait for such an event.
    pub(super) fn record(&mut self, what: Incident) {
        let time = self.time();
        self.faults.pass_event(&what, time);
        // The list has its room from the start: a period must not allocate.
        if self.verdict.events.len() < MOST_EVENTS {
            self.verdict.events.push(Event { period: self.period, what });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{EDGE, TestServo, cell, held, quiet};
    use super::super::verdict::Violations;
    use super::super::{Counts, CubeMechanics, Jaws, Start, Verdict, Whereabouts};
    use super::*;
    use crate::cube::Face;
    use crate::motion::PERIOD;
    use crate::spatial::Pose;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    /// Returns the verdict after a gripper that points down has let go of a cube that touches the
    /// table. The cube is tilted by `tilt` (rad) about the line along which the jaws close.
    fn let_go_on_the_table(tilt: f64) -> Verdict {
        let mut cell = cell();
        cell.arms.truncate(1);
        let down = [0.0, -80.0, 5.0, -15.0, 270.0, 0.0].map(f64::to_radians);
        cell.arms[0].start.0[1..].copy_from_slice(&down);
        let mut config = quiet(cell);
        // The hand is not deep enough for the palm to meet an edge.
        let tool_from_cube = Pose::from_parts(
            Translation3::new(0.0, 0.0, EDGE / 3.0),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt),
        );
        config.start = Start::Held { arm: 0, tool_from_cube };
        let cube = Plant::new(config.clone(), 1).unwrap().balance.nodes[0];
        let lowest: f64 = (0..3).map(|i| cube.r[(2, i)].abs() * 0.5 * EDGE).sum();
        config.cell.table_height = cube.p.z - lowest + 1e-4;
        let mut servo = TestServo::new(Plant::new(config, 1).unwrap());
        servo.run(0.5);
        assert!(servo.plant.balance.table_load() > 0.0, "the cube rests on the table");
        assert_eq!(servo.plant.verdict().cube, Whereabouts::Arms([true, false, false, false]));

        servo.jaws[0] = (0.085, 30.0);
        servo.run(2.0);
        servo.plant.verdict()
    }

    /// A cube released flat on the table counts as laid down, a cube released on one edge as
    /// dropped.
    #[test]
    fn cube_released_tilted_on_table_counts_as_dropped() {
        let count =
            |v: &Verdict, what: Incident| v.events.iter().filter(|e| e.what == what).count();
        let (laid_down, drop) =
            (Incident::LaidDown { arm: 0, down: Face::U }, Incident::Drop { arm: Some(0) });

        let flat = let_go_on_the_table(0.0);
        let tilted = let_go_on_the_table(0.5);

        assert_eq!(flat.cube, Whereabouts::Tray { down: Face::U, fell: false });
        assert_eq!(flat.counts, Counts::default(), "{:?}", flat.events);
        assert_eq!((count(&flat, laid_down), count(&flat, drop)), (1, 0), "{:?}", flat.events);
        assert_eq!(tilted.cube, Whereabouts::Tray { down: Face::U, fell: true });
        // The jaws opened, so the fall breaks a rule of conduct.
        let violations = Violations { let_fall: 1, ..Violations::default() };
        let fell = Counts { drops: 1, violations, ..Counts::default() };
        assert_eq!(tilted.counts, fell, "{:?}", tilted.events);
        assert_eq!(
            (count(&tilted, laid_down), count(&tilted, drop)),
            (0, 1),
            "{:?}",
            tilted.events
        );
    }

    /// One hand has lost its grip, and the jaws of the other one open on the cube. Just before they
    /// let go, the friction of their pads no longer bears the cube: a balance of forces would press
    /// it against a palm.
    #[test]
    fn cube_between_opening_jaws_falls_without_blow() {
        let mut servo =
            TestServo::new(Plant::new(held(Jaws::rubber(), CubeMechanics::of_2007()), 1).unwrap());
        servo.jaws[1] = (0.055, 30.0);
        servo.run(1.5);
        assert!(servo.plant.grasps[..2].iter().all(Grasp::holds), "both hands hold the cube");
        servo.plant.verdict.arm_peak_force = [0.0; MOST_ARMS];
        servo.plant.grasps[0].lost = true;

        servo.jaws[1] = (0.085, 30.0);
        servo.run(1.0);

        let verdict = servo.plant.verdict();
        assert_eq!(verdict.counts.drops, 1, "{:?}", verdict.events);
        assert!(verdict.arm_peak_force.iter().all(|f| *f < 40.0), "{:?}", verdict.arm_peak_force);
    }

    /// A blow of the jaws may be over when the period ends.
    #[test]
    fn contact_force_peak_covers_every_substep() {
        let mut servo =
            TestServo::new(Plant::new(held(Jaws::rubber(), CubeMechanics::of_2007()), 1).unwrap());
        servo.jaws[1] = (0.055, 30.0);
        let mut at_ends: f64 = 0.0;
        for _ in 0..1000 {
            servo.run(PERIOD);
            at_ends = at_ends.max(servo.plant.balance.touches[1].force.norm());
        }

        let peak = servo.plant.verdict().arm_peak_force[1];

        assert!(at_ends > 1.0, "the jaws have met the cube: {at_ends:?}");
        assert!(peak > at_ends + 1e-3, "{peak} {at_ends}");
    }
}
