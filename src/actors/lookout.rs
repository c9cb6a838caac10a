//! Looks after the arms while they move: that they come too near to nothing, nor too fast to the operator's hand.
//!
//! - in: the states that the EDPs publish; MP's word for whether the hands are not to meet now
//! - out: an emergency stop, with its reason on every UI and as the error that ends the run

use super::notice::Notice;
use super::services::Services;
use crate::emergency_stop::StopButton;
use crate::error::{Error, Fatal};
use crate::motion::{ArmState, PERIOD, Synchronisation};
use crate::reach::guard::Guard;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::watch;

/// The arms are looked at at this interval.
const INTERVAL: Duration = Duration::from_millis(20);

/// MP's word for it: what is commanded keeps the hands apart, so that fingers and cubes are not to meet.
#[derive(Debug, Clone, Default)]
pub struct Apart(Arc<AtomicBool>);

impl Apart {
    /// Tells.
    pub fn tell(&self, apart: bool) {
        self.0.store(apart, Ordering::Release);
    }
}

/// Stops all arms where one comes too near to something, or too fast to the operator's hand, whatever brings it there.
pub(crate) async fn watch_over(
    mut guard: Guard,
    states: Vec<watch::Receiver<ArmState>>,
    stop: StopButton,
    apart: Apart,
    services: Services,
) {
    let present = || states.iter().map(|state| *state.borrow()).collect::<Vec<ArmState>>();
    let known = |arms: &[ArmState], i: usize| {
        // An EDP that has heard nothing yet publishes a state of no period.
        let is_known =
            |arm: &ArmState| arm.synchronisation == Synchronisation::Yes && arm.period > 0;
        arms.get(i).is_some_and(is_known)
    };
    let room = |guard: &Guard, arms: &[ArmState]| {
        guard.room([0, 1].map(|i| known(arms, i).then(|| &arms[i].desired_joints)))
    };
    let mut last = present();
    let mut least = room(&guard, &last);
    loop {
        let arms = present();
        let slow = |i: usize| {
            let (from, to) = (&last[i], &arms[i]);
            let seconds = to.period.saturating_sub(from.period) as f64 * PERIOD;
            guard.pace(i, &from.desired_joints, &to.desired_joints, seconds)
        };
        let mut both = (0..arms.len()).filter(|&i| known(&last, i) && known(&arms, i));
        let slow = both.try_for_each(slow);
        let openings = [0, 1].map(|i| known(&arms, i).then(|| arms[i].jaw_opening));
        guard.holding(openings);
        let mut now = room(&guard, &arms);
        if !apart.0.load(Ordering::Acquire) {
            // What they keep from each other afterwards begins with how they part.
            (now, least) = (now.meeting(), least.meeting());
        }
        if let Err(near) = guard.may(&least, &now).and(slow) {
            let now = services.clock.period() as f64 * PERIOD;
            services.trace.tell(Notice::Warning(now, format!("{near}: all arms are stopped")));
            stop.press();
            // Else the arms would be the first to say that they were stopped, and not why.
            let cause = Fatal::TooNear(near.to_string());
            services.supervision.watchdog.raise(Error::Fatal {
                actor: "guard".into(),
                place: "watch",
                cause,
                last: None,
            });
            return;
        }
        // Who is put too near at the beginning may be led out of there, and stays out.
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

    /// Whether both arms are stopped, and what is told, when they go from one place to another in a tenth of a second.
    async fn stopped(from: [JointPositions; 2], to: [JointPositions; 2]) -> Option<String> {
        stopped_when(false, from, to).await
    }

    /// The same when the hands are not to meet.
    async fn stopped_when(
        keeps_apart: bool,
        from: [JointPositions; 2],
        to: [JointPositions; 2],
    ) -> Option<String> {
        let states = [from.map(|at| standing(at, 100)), to.map(|at| standing(at, 150))];
        let (number, near, told) = watched(keeps_apart, &states).await?;
        assert_eq!(number, 1, "nothing is wrong before: {told}");
        assert!(near.contains("arm"), "{near}");
        Some(told)
    }

    /// At which of these states both arms are stopped, when they are in one after the other.
    async fn stopped_at(keeps_apart: bool, states: &[[ArmState; 2]]) -> Option<usize> {
        watched(keeps_apart, states).await.map(|(number, ..)| number)
    }

    fn standing(joints: JointPositions, period: u64) -> ArmState {
        let synchronisation = Synchronisation::Yes;
        ArmState { desired_joints: joints, synchronisation, period, ..ArmState::default() }
    }

    /// The same with what came too near, and what is told.
    async fn watched(
        keeps_apart: bool,
        states: &[[ArmState; 2]],
    ) -> Option<(usize, String, String)> {
        let guard = Guard::of(&example_cell(), 0.25);
        let channels = states[0].map(watch::channel);
        let listening = channels.iter().map(|(_, states)| states.clone()).collect();
        let stop = EmergencyStop::default();
        let switches = Arc::new(Switches::new(stop.signal()));
        let (trace, mut notices) = Trace::bare(RunHash::default());
        let clock = Clock::new(tokio::time::Instant::now(), switches);
        let services = Services::bare(clock, watch::channel(Control::Running).1, trace);
        let apart = Apart::default();
        apart.tell(keeps_apart);
        let listens = services.supervision.watchdog.listen();
        let watching = tokio::spawn(watch_over(guard, listening, stop.button(), apart, services));
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
        let told = notices.try_recv().ok().map(|notice| format!("{notice:?}"));
        let ends = listens.borrow().as_ref().map(ToString::to_string);
        assert_eq!((told.is_some(), ends.is_some()), (stopped.is_some(), stopped.is_some()));
        let (number, told, ends) = (stopped?, told?, ends?);
        // The run ends with what came too near, not with the stop that followed.
        let near = ends.strip_prefix("fatal, guard, watch: ").unwrap();
        assert!(told.contains(near), "{ends} {told}");
        Some((number, near.to_owned(), told))
    }

    #[tokio::test(start_paused = true)]
    async fn an_arm_that_was_led_out_of_where_it_was_too_near_stays_out() {
        let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let mut low = meeting.postument;
        low.0[2] += 0.9;
        let arms = |postument, period| [meeting.track, postument].map(|at| standing(at, period));

        let out = [arms(low, 100), arms(meeting.postument, 150)];
        assert_eq!(stopped_at(false, &out).await, None);
        let back = [out[0], out[1], arms(low, 200)];
        assert_eq!(stopped_at(false, &back).await, Some(2));
    }

    #[tokio::test(start_paused = true)]
    async fn where_an_arm_is_known_for_the_first_time_it_has_not_come_from_anywhere() {
        let table = MeetingTable::compute(&example_cell(), &ReachSettings::default());
        let postument = table.grasps.iter().flatten().next().unwrap().postument;
        // Past the operator's hand, where 0.2 m in a fifth of a second are too fast.
        let past = |d0: f64| JointPositions([d0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let there = |period| [standing(past(0.4), period), standing(postument, period)];
        let before = [standing(past(0.2), 1), standing(postument, 1)];
        assert_eq!(stopped_at(false, &[before, there(101)]).await, Some(1));

        // What an EDP publishes before it has heard anything, and what an arm counts that does not know its place.
        let unheard = before.map(|arm| ArmState { period: 0, ..arm });
        let lost = before.map(|arm| ArmState { synchronisation: Synchronisation::No, ..arm });
        for unknown in [unheard, lost] {
            assert_eq!(stopped_at(false, &[unknown, there(101)]).await, None);
        }
    }

    #[tokio::test(start_paused = true)]
    async fn hands_that_are_not_to_meet_keep_their_cubes_apart_where_their_jaws_hold_some() {
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
                let room = |track| guard.room([Some(track), Some(&meeting.postument)]);
                guard.may(&room(&far), &room(track)).is_ok()
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
            // So slowly that nobody minds.
            let come = |opening| [arms(far, 100, opening), arms(beside, 10_000, opening)];
            assert_eq!(stopped_at(true, &come(0.0)).await, None);
            assert_eq!(stopped_at(true, &come(edge)).await, Some(1));
            assert_eq!(stopped_at(false, &come(edge)).await, None, "they are to meet");
        }
        assert!(tried >= 2, "{tried}");
    }

    #[tokio::test(start_paused = true)]
    async fn what_comes_too_near_or_too_fast_stops_both_arms_and_nothing_else_does() {
        let cell = example_cell();
        let table = MeetingTable::compute(&cell, &ReachSettings::default());
        let meeting = table.grasps.iter().flatten().next().unwrap();
        let (track, postument) = (meeting.track, meeting.postument);

        assert_eq!(stopped([track, postument], [meeting.track_back, postument]).await, None);
        let mut low = postument;
        low.0[2] += 0.9;
        let told = stopped([track, postument], [track, low]).await.unwrap();
        // Who is there from the beginning may be led out, and no farther in.
        assert_eq!(stopped([track, low], [track, low]).await, None);
        assert_eq!(stopped([track, low], [track, postument]).await, None);
        let mut lower = low;
        lower.0[2] += 0.02;
        assert!(stopped([track, low], [track, lower]).await.is_some());
        assert!(told.contains("of the postument arm comes within"), "{told}");
        assert!(told.contains("all arms are stopped"), "{told}");

        // Half a metre of track in a tenth of a second, past the operator's hand.
        let before = JointPositions([0.0, 0.0, -1.57, 0.0, 1.56, 1.57, -1.57]);
        let past = |d0: f64| {
            JointPositions(std::array::from_fn(|i| if i == 0 { d0 } else { before.0[i] }))
        };
        let told = stopped([past(0.2), postument], [past(0.4), postument]).await.unwrap();
        assert!(told.contains("track arm goes at 2000 mm/s"), "{told}");
    }
}
