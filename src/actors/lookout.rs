//! The lookout: stops all arms when one comes too near an obstacle, or too fast near the operator's
//! hand. It also covers motions whose path is not known beforehand, such as those of the visual
//! servo.
//!
//! - in: the states that the EDPs publish; from MP, whether the hands are to keep apart
//! - out: an emergency stop, with its reason on every UI and as the error that ends the run
//! - thresholds: those of [`crate::reach::guard`], for places and speeds of the believed cell

use super::notice::Notice;
use super::services::Services;
use crate::cell::MOST_ARMS;
use crate::emergency_stop::StopButton;
use crate::error::{Error, Fatal};
use crate::motion::{ArmState, PERIOD, Synchronisation};
use crate::reach::guard::Guard;
use crate::reach::pairs::Pairs;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;
use tokio::sync::watch;

/// Time between two checks of the arms.
const INTERVAL: Duration = Duration::from_millis(20);

/// Word of MP for the lookout: the pairs of arms whose hands the commanded motions let meet.
/// Fingers and cubes of the others count as obstacles. In the beginning all may meet.
#[derive(Debug, Clone)]
pub struct MayMeet(Arc<AtomicU8>);

impl Default for MayMeet {
    fn default() -> Self {
        Self(Arc::new(AtomicU8::new(Pairs::ALL.bits())))
    }
}

impl MayMeet {
    /// Sets the pairs whose hands may meet.
    pub fn set(&self, pairs: Pairs) {
        self.0.store(pairs.bits(), Ordering::Release);
    }

    /// Returns the pairs whose hands may meet.
    #[must_use]
    pub fn pairs(&self) -> Pairs {
        Pairs::of_bits(self.0.load(Ordering::Acquire))
    }
}

/// Returns whether the state that an EDP publishes gives the place of its arm. Without
/// synchronisation the counters say nothing about it. An EDP whose servo has not begun publishes
/// the default state, of period 0.
pub(super) fn is_known(arm: &ArmState) -> bool {
    arm.synchronisation == Synchronisation::Yes && arm.period > 0
}

/// Number of states of each arm that are kept, for a comparison with a late one: those of 2.5 s.
const KEPT: usize = 128;

/// State of an arm that the lookout watches.
#[derive(Debug)]
pub(crate) struct Watched {
    /// Latest state that the arm's EDP has published.
    pub(crate) state: watch::Receiver<ArmState>,
    /// Greatest age (periods) of the state of an arm that moves, if the state comes over a link;
    /// `None` for an EDP on the node of the lookout.
    pub(crate) late: Option<u64>,
}

/// Latest states of an arm, the newest last.
#[derive(Debug, Default)]
struct Past(VecDeque<ArmState>);

impl Past {
    /// Keeps a state, if it is a new one.
    fn take(&mut self, state: ArmState) {
        if self.0.back().is_none_or(|last| last.period < state.period) {
            self.0.push_back(state);
        }
        if self.0.len() > KEPT {
            self.0.pop_front();
        }
    }

    /// Returns the newest state that is not later than `period`, or else the oldest one.
    fn at(&self, period: u64) -> Option<&ArmState> {
        self.0.iter().rev().find(|state| state.period <= period).or(self.0.front())
    }
}

/// Replaces the latest states of the `arms` by those of one time, if the state of one that moves is
/// late: the period of this late state. `late` is [`Watched::late`] of each arm, `now` the present
/// period. Arms that move together are near each other only as each is at the same time.
fn together(arms: &mut [ArmState], past: &mut [Past], late: &[Option<u64>], now: u64) {
    for (arm, past) in arms.iter().zip(&mut *past) {
        past.take(*arm);
    }
    // An arm whose state is older than a link makes it is at rest: its EDP was not asked.
    let moves = |(arm, late): &(&ArmState, &Option<u64>)| {
        is_known(arm) && late.is_some_and(|late| now.saturating_sub(arm.period) <= late)
    };
    let oldest = arms.iter().zip(late).filter(moves).map(|(arm, _)| arm.period).min();
    let Some(oldest) = oldest else { return };
    for (arm, past) in arms.iter_mut().zip(past) {
        *arm = past.at(oldest).copied().unwrap_or(*arm);
    }
}

/// Stops all arms when one comes too near an obstacle or too fast near the operator's hand,
/// whichever command moves it there.
pub(crate) async fn run_lookout(
    mut guard: Guard,
    watched: Vec<Watched>,
    stop: StopButton,
    may_meet: MayMeet,
    services: Services,
) {
    let late: Vec<_> = watched.iter().map(|arm| arm.late).collect();
    let present = || watched.iter().map(|arm| *arm.state.borrow()).collect::<Vec<ArmState>>();
    let known = |arms: &[ArmState], i: usize| arms.get(i).is_some_and(is_known);
    let distances = |guard: &Guard, arms: &[ArmState]| {
        let joints = |i: usize| known(arms, i).then(|| &arms[i].desired_joints);
        guard.distances::<MOST_ARMS>(std::array::from_fn(joints))
    };
    let mut past: Vec<Past> = watched.iter().map(|_| Past::default()).collect();
    let mut last = present();
    let mut least = distances(&guard, &last);
    loop {
        let mut arms = present();
        together(&mut arms, &mut past, &late, services.clock.period());
        // Time does not go back when the arm of a late state begins to move.
        for (arm, last) in arms.iter_mut().zip(&last) {
            if arm.period < last.period {
                *arm = *last;
            }
        }
        // The speed comes from the set values and the servo's own periods: this task may be late.
        let slow = |i: usize| {
            let (from, to) = (&last[i], &arms[i]);
            let seconds = to.period.saturating_sub(from.period) as f64 * PERIOD;
            guard.check_speed(i, &from.desired_joints, &to.desired_joints, seconds)
        };
        // An arm that has just become known has not moved from where it was believed before.
        let mut both = (0..arms.len()).filter(|&i| known(&last, i) && known(&arms, i));
        let slow = both.try_for_each(slow);
        // A hand counts with a cube if its jaws are as wide as one.
        let opening = |i: usize| known(&arms, i).then(|| arms[i].jaw_opening);
        guard.holding::<MOST_ARMS>(std::array::from_fn(opening));
        let mut now = distances(&guard, &arms);
        // The distance of hands that are to meet does not count. The distance to keep later begins
        // with the one at which they part.
        let joined = may_meet.pairs();
        (now, least) = (now.meeting(joined), least.meeting(joined));
        if let Err(near) = guard.check_motion(&least, &now).and(slow) {
            let now = services.clock.period() as f64 * PERIOD;
            services.trace.tell(Notice::Warning(now, format!("{near}: all arms are stopped")));
            stop.press();
            // Raised here, before the EDPs report an emergency stop without its reason.
            let cause = Fatal::TooNear(near.to_string());
            services.supervision.watchdog.raise(Error::Fatal {
                actor: "guard".into(),
                place: "watch".into(),
                cause,
                last: None,
            });
            return;
        }
        // An arm that begins too near may leave; each distance that it has gained is kept.
        (last, least) = (arms, now.or_more(&least));
        tokio::time::sleep(INTERVAL).await;
    }
}

#[cfg(test)]
mod tests {
    use super::super::clock::Clock;
    use super::super::control::Control;
    use super::super::trace::Trace;
    use super::*;
    use crate::emergency_stop::EmergencyStop;
    use crate::hw::driver::Switches;
    use crate::motion::JointPositions;
    use crate::reach::{MeetingTable, ReachSettings, example_cell};
    use crate::record::run_hash::RunHash;

    /// Moves both arms from the joint positions `from` to `to` in 0.1 s, while the hands may meet.
    /// Returns the warning of the lookout if it stops the arms.
    async fn stopped(from: [JointPositions; 2], to: [JointPositions; 2]) -> Option<String> {
        stopped_when(false, from, to).await
    }

    /// Moves both arms as [`stopped`] does. `keeps_apart` says whether the lookout must keep the
    /// hands apart.
    async fn stopped_when(
        keeps_apart: bool,
        from: [JointPositions; 2],
        to: [JointPositions; 2],
    ) -> Option<String> {
        let states = [from.map(|at| standing(at, 100)), to.map(|at| standing(at, 150))];
        let (number, near, warning) = watched(keeps_apart, &states).await?;
        assert_eq!(number, 1, "too early: {warning}");
        assert!(near.contains("arm"), "{near}");
        Some(warning)
    }

    /// Passes `states` of both arms to the lookout one after the other. Returns the index of the
    /// first at which it stops the arms.
    async fn stopped_at(keeps_apart: bool, states: &[[ArmState; 2]]) -> Option<usize> {
        watched(keeps_apart, states).await.map(|(number, ..)| number)
    }

    /// Returns the state of a synchronised arm that stands at these joint positions.
    fn standing(joints: JointPositions, period: u64) -> ArmState {
        let synchronisation = Synchronisation::Yes;
        ArmState { desired_joints: joints, synchronisation, period, ..ArmState::default() }
    }

    /// Passes `states` of both arms to the lookout one after the other. Returns the index of the
    /// first at which it stops the arms, the cause of the stop and the warning to the operator.
    async fn watched(
        keeps_apart: bool,
        states: &[[ArmState; 2]],
    ) -> Option<(usize, String, String)> {
        // The limit of the speed near the operator is 0.25 m/s.
        let guard = Guard::of(&example_cell(), 0.25);
        let channels = states[0].map(watch::channel);
        let listening = channels
            .iter()
            .map(|(_, states)| Watched { state: states.clone(), late: None })
            .collect();
        let stop = EmergencyStop::default();
        let switches = Arc::new(Switches::new(stop.signal()));
        let (trace, mut notices) = Trace::bare(RunHash::default());
        let clock = Clock::new(tokio::time::Instant::now(), switches);
        let services = Services::bare(clock, watch::channel(Control::Running).1, trace);
        let may_meet = MayMeet::default();
        may_meet.set(if keeps_apart { Pairs::NONE } else { Pairs::ALL });
        let listens = services.supervision.watchdog.listen();
        let watching =
            tokio::spawn(run_lookout(guard, listening, stop.button(), may_meet, services));
        let mut stopped = None;
        for (number, arms) in states.iter().enumerate() {
            for ((sender, _), state) in channels.iter().zip(arms) {
                sender.send_replace(*state);
            }
            tokio::time::sleep(3 * INTERVAL).await;
            if stop.signal().is_pressed() {
                stopped = Some(number);
                break;
            }
        }
        watching.abort();
        let warning = notices.try_recv().ok().map(|notice| format!("{notice:?}"));
        let ends = listens.borrow().as_ref().map(ToString::to_string);
        assert_eq!((warning.is_some(), ends.is_some()), (stopped.is_some(), stopped.is_some()));
        let (number, warning, ends) = (stopped?, warning?, ends?);
        // The error of the run is the cause of the stop, not the stop itself.
        let near = ends.strip_suffix(" (fatal, guard, watch)").unwrap();
        assert!(warning.contains(near), "{ends} {warning}");
        Some((number, near.to_owned(), warning))
    }

    /// A late state of a moving arm is compared with that of the other arm in the same period. An
    /// arm at rest publishes no states, over a link or not, and is no reason to look back.
    #[test]
    fn states_are_compared_as_of_one_time() {
        let state = |period: u64| standing(JointPositions([period as f64; 7]), period);
        let seen = |periods: [u64; 2], late: Option<u64>| {
            let mut past = [Past::default(), Past::default()];
            for period in (100..=200).step_by(8) {
                past[0].take(state(period));
            }
            let mut arms = periods.map(state);
            together(&mut arms, &mut past, &[None, late], 200);
            arms.map(|arm| arm.period)
        };

        assert_eq!(seen([196, 160], Some(60)), [156, 160], "the second one moves and is late");
        assert_eq!(seen([196, 100], Some(60)), [196, 100], "the second one rests");
        assert_eq!(seen([196, 100], None), [196, 100], "the second one rests on this node");
        assert_eq!(seen([100, 160], Some(60))[1], 160, "the first one rests");
    }

    /// An arm that begins too near an obstacle may leave, and must not return.
    #[tokio::test(start_paused = true)]
    async fn arm_may_leave_an_obstacle_but_not_return() {
        let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        // Joint 2 is turned so far that the arm is too near an obstacle.
        let mut low = meeting.postument;
        low.0[2] += 0.9;
        let arms = |postument, period| [meeting.track, postument].map(|at| standing(at, period));

        let out = [arms(low, 100), arms(meeting.postument, 150)];
        assert_eq!(stopped_at(false, &out).await, None);
        let back = [out[0], out[1], arms(low, 200)];
        assert_eq!(stopped_at(false, &back).await, Some(2));
    }

    /// The lookout computes no speed from the first known position of an arm, because the position
    /// before it is unknown.
    #[tokio::test(start_paused = true)]
    async fn first_known_arm_position_implies_no_speed() {
        let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
        let postument = table.grasps.iter().flatten().next().unwrap().postument;
        // Past the operator's hand, where 0.2 m in a fifth of a second are too fast.
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let there = |period| [standing(past(0.4), period), standing(postument, period)];
        let before = [standing(past(0.2), 1), standing(postument, 1)];
        assert_eq!(stopped_at(false, &[before, there(101)]).await, Some(1));

        // The state before the servo's first period, and that of an arm without synchronisation.
        let unheard = before.map(|arm| ArmState { period: 0, ..arm });
        let lost = before.map(|arm| ArmState { synchronisation: Synchronisation::No, ..arm });
        for unknown in [unheard, lost] {
            assert_eq!(stopped_at(false, &[unknown, there(101)]).await, None);
        }
    }

    /// Hands that are to keep apart keep more distance if their jaws hold cubes.
    #[tokio::test(start_paused = true)]
    async fn hands_with_cubes_keep_more_distance() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let edge = cell.cube.edge;
        let mut tried = 0;
        for meeting in table.grasps.iter().flatten() {
            let along = |by: f64| {
                let mut track = meeting.track;
                track.0[0] += by;
                track
            };
            let far = along(-0.4);
            let fits = |opening: f64, track: &JointPositions| {
                let mut guard = Guard::of(&cell, 0.25);
                guard.holding([Some(opening); 2]);
                let distances = |track| guard.distances([Some(track), Some(&meeting.postument)]);
                guard.check_motion(&distances(&far), &distances(track)).is_ok()
            };
            let beside = (1..200).map(|i| along(-0.4 + 0.002 * f64::from(i)));
            let Some(beside) = beside.into_iter().find(|at| fits(0.0, at) && !fits(edge, at))
            else {
                continue;
            };
            if !fits(edge, &far) {
                continue;
            }
            tried += 1;
            let arms = |track, period, jaw_opening| {
                [track, meeting.postument]
                    .map(|at| ArmState { jaw_opening, ..standing(at, period) })
            };
            // Slow enough for the limit near the operator's hand.
            let come = |opening| [arms(far, 100, opening), arms(beside, 10_000, opening)];
            assert_eq!(stopped_at(true, &come(0.0)).await, None);
            assert_eq!(stopped_at(true, &come(edge)).await, Some(1));
            assert_eq!(stopped_at(false, &come(edge)).await, None, "the hands must meet");
        }
        assert!(tried >= 2, "{tried}");
    }

    #[tokio::test(start_paused = true)]
    async fn nearby_obstacle_or_excess_speed_stops_both_arms() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let (track, postument) = (meeting.track, meeting.postument);

        assert_eq!(stopped([track, postument], [meeting.track_back, postument]).await, None);
        // Joint 2 is turned so far that the arm is too near an obstacle.
        let mut low = postument;
        low.0[2] += 0.9;
        let warning = stopped([track, postument], [track, low]).await.unwrap();
        // An arm that begins there may leave, but not come nearer.
        assert_eq!(stopped([track, low], [track, low]).await, None);
        assert_eq!(stopped([track, low], [track, postument]).await, None);
        let mut lower = low;
        lower.0[2] += 0.02;
        assert!(stopped([track, low], [track, lower]).await.is_some());
        assert!(warning.contains("of the postument arm comes within"), "{warning}");
        assert!(warning.contains("all arms are stopped"), "{warning}");

        // 0.2 m of track in 0.1 s, past the operator's hand.
        let before = JointPositions([0.0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let past = |d0: f64| {
            JointPositions(std::array::from_fn(|i| if i == 0 { d0 } else { before.0[i] }))
        };
        let warning = stopped([past(0.2), postument], [past(0.4), postument]).await.unwrap();
        assert!(warning.contains("track arm moves at 2000 mm/s"), "{warning}");
    }
}
