//! One axis behind its serial line: what goes out in a period, and what of an answer can be believed.
//!
//! - in: what the servo wants of the axis; the bytes that came, or none
//! - out: one [`Order`] a period; the axis's reading; an [`AxisFault`] when the line must be given up
//! - a parameter takes the place of a pulse width for one period and counts as taken when it is answered; three tries
//! - while answers are missed, the counter is taken to go on as before: an axis that seems to stand still for a period
//!   and then to go twice as far makes its regulator brake fully in between, which trips a power stage at speed
//!   (measured: one answer in a thousand missed ended every mission)
//! - source: the original's rules: three answers missed in a row, or a counter that jumps by more than 1000, are a
//!   fault; a switch is believed when two answers in a row show it; four answers settle a start.
//!   Different from the original: a frame has no check sum, so one impossible answer is taken for a spoilt one, like
//!   a missed one, and only the third in a row for the truth; and limit switches, over-current and loss of
//!   synchronisation must show twice as well.

use super::frame::{Mode, Order, Parameter, STATUS, Status};
use crate::servo::lateness::Interval;

/// What the servo wants of an axis in a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AxisDrive {
    /// Power stage on.
    pub enabled: bool,
    /// Pulse width, -255..=255.
    pub width: i16,
    /// Digital outputs.
    pub outputs: u8,
    /// Limit of the motor current (mA), where the servo sets one.
    pub max_current: Option<u16>,
    /// The counter becomes zero at the next zero of the encoder.
    pub synchronise: bool,
}

/// Rules of an axis's line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rules {
    /// Answers that are missed or impossible in a row, after which the line is given up.
    pub misses: u32,
    /// No counter goes further in a period.
    pub jump: i32,
    /// Tries of a parameter.
    pub tries: u32,
}

impl Default for Rules {
    fn default() -> Self {
        Self { misses: 3, jump: 1000, tries: 3 }
    }
}

/// What became of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// It was taken.
    Taken,
    /// Nothing came, so many times in a row.
    Missed(u32),
    /// What came cannot be true, so many times in a row.
    Impossible(u32),
    /// What came was owed to an earlier order.
    Late,
}

/// Why a line is given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum AxisFault {
    /// Nothing comes any more.
    #[error("no answer for {0} periods")]
    Silent(u32),
    /// What comes cannot be true.
    #[error(
        "{times} impossible answers in a row, the last with the counter at {count} after {before}"
    )]
    Impossible {
        /// In a row.
        times: u32,
        /// Counter told last.
        count: i32,
        /// Counter believed last.
        before: i32,
    },
    /// The controller has switched itself off.
    #[error("the axis controller is in its error mode")]
    Error,
    /// It has forgotten where it is: it was reset.
    #[error("the axis controller has lost its synchronisation: it was reset")]
    Reset,
    /// A parameter was never answered.
    #[error("the axis controller does not take {0:?}")]
    Untaken(Parameter),
}

/// A flag that is believed when it shows twice.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Twice {
    last: bool,
    is: bool,
}

impl Twice {
    fn see(&mut self, now: bool) -> bool {
        if now == self.last {
            self.is = now;
        }
        self.last = now;
        self.is
    }
}

/// An axis and its line's history.
#[derive(Debug, Clone)]
pub struct Axis {
    rules: Rules,
    /// Latest believed answer.
    status: Status,
    /// Counter of that answer, carried on since, and how far it goes in a period.
    count: i32,
    step: f64,
    /// Periods by the clock since that answer, and those of them since the order before the last.
    interval: Interval,
    passed: f64,
    /// How far it went in a period before the last gap.
    fast: f64,
    /// Counter of the answer from which the step is reckoned, and periods since: the last one, but while that may be
    /// older than it seems the one before the gap.
    from: i32,
    age: f64,
    /// Answers taken, as far as they settle the start.
    settled: u32,
    /// First byte of its answers, once one has come.
    begins: Option<u8>,
    misses: u32,
    /// Answers in a row that were taken for an earlier order's.
    late: u32,
    impossible: u32,
    /// Counter of the last answer, when it was off by more than a motor could be: another one may confirm it.
    doubted: Option<i32>,
    upper: Twice,
    lower: Twice,
    over_current: Twice,
    sync_switch: Twice,
    stage_fault: Twice,
    error: Twice,
    synchronised: Twice,
    was_synchronised: bool,
    /// The controller was asked to synchronise: its counter may jump, and it forgets that it was synchronised.
    synchronising: bool,
    /// What the controller is known to have taken.
    mode: Option<Mode>,
    max_current: Option<u16>,
    sent: Option<Parameter>,
    tries: u32,
}

/// Steps of a counter up to this say nothing of the time (increments).
const NOISE: f64 = 8.0;
/// Periods for which a counter goes on as before.
const GOES_ON: f64 = 10.0;
/// How far a counter may be off where it was expected a period later, for all that a motor can gain
/// in it (increments).
const LEAP: f64 = 64.0;
/// Answers nearer together than this say nothing of the speed (periods).
const APART: f64 = 0.5;
/// So many times nearer to where the axis was expected a period before is what counts as late. One that brakes is somewhat
/// nearer, too; what is passed over then makes it seem to have run on, and its regulator brakes even harder.
const CLEARLY: f64 = 3.0;
/// Answers in a row that may be an earlier order's. An axis that brakes looks late, too, and what is owed may be lost.
const LATE: u32 = 2;
/// Answers that settle a start, when they agree.
const SETTLING: u32 = 4;

impl Axis {
    /// Before the first exchange.
    #[must_use]
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            status: Status::default(),
            count: 0,
            step: 0.0,
            interval: Interval::default(),
            passed: 0.0,
            fast: 0.0,
            from: 0,
            age: 0.0,
            settled: 0,
            begins: None,
            misses: 0,
            late: 0,
            impossible: 0,
            doubted: None,
            upper: Twice::default(),
            lower: Twice::default(),
            over_current: Twice::default(),
            sync_switch: Twice::default(),
            stage_fault: Twice::default(),
            error: Twice::default(),
            synchronised: Twice::default(),
            was_synchronised: false,
            synchronising: false,
            mode: None,
            max_current: None,
            sent: None,
            tries: 0,
        }
    }

    /// What goes out in this period.
    pub fn order(&mut self, drive: &AxisDrive) -> Order {
        self.synchronising = drive.synchronise;
        if drive.synchronise {
            self.was_synchronised = false;
        }
        let mode = if drive.enabled { Mode::Pwm } else { Mode::Manual };
        let wanted = drive
            .max_current
            .filter(|limit| self.max_current != Some(*limit))
            .map(Parameter::MaxCurrent)
            .or((self.mode != Some(mode)).then_some(Parameter::Mode(mode)));
        if self.sent != wanted {
            self.tries = 0;
        }
        self.sent = wanted;
        match wanted {
            Some(parameter) => Order::Set(parameter),
            None => Order::Pwm {
                width: if drive.enabled { drive.width } else { 0 },
                outputs: drive.outputs,
                synchronise: drive.synchronise,
            },
        }
    }

    /// So many periods have passed by the clock since the order before: the counter goes on as before, for a while. A
    /// machine that was kept from running has not stopped the motors.
    pub fn pass(&mut self, periods: f64) {
        self.passed = periods;
        self.age += periods;
        self.interval.pass(periods);
        self.count = self.expected(self.interval.since());
    }

    fn expected(&self, since: f64) -> i32 {
        self.status.count.wrapping_add((self.step * since.clamp(0.0, GOES_ON)).round() as i32)
    }

    /// Whether what came while an answer was owed is that one rather than the last order's: the axis seems to stand
    /// clearly where it was expected then.
    #[must_use]
    pub fn is_late(&self, answer: &[u8; STATUS]) -> bool {
        if self.begins != Some(answer[0]) || self.late >= LATE {
            return false;
        }
        let told = Status::decode(answer);
        let off = |count: i32| f64::from(told.count.wrapping_sub(count)).abs();
        let since = self.interval.since();
        self.step.abs() > NOISE
            && off(self.expected(since - self.passed)) * CLEARLY < off(self.expected(since))
    }

    /// What came was an earlier order's ([`Self::is_late`]): nothing is known of this period, but the line speaks.
    pub fn overlook(&mut self) -> Answer {
        self.late += 1;
        self.misses = 0;
        Answer::Late
    }

    /// Judges what came in answer to the last order.
    ///
    /// # Errors
    /// The line must be given up.
    pub fn take(&mut self, answer: Option<&[u8; STATUS]>) -> Result<Answer, AxisFault> {
        let Some(bytes) = answer else {
            self.misses += 1;
            if self.misses >= self.rules.misses {
                return Err(AxisFault::Silent(self.misses));
            }
            self.count_try()?;
            return Ok(Answer::Missed(self.misses));
        };
        (self.misses, self.late) = (0, 0);
        // What answers a parameter need not be a reading.
        if self.sent.is_some() && self.begins.is_none_or(|first| first == bytes[0]) {
            self.confirm();
            return Ok(Answer::Taken);
        }
        let settled = self.has_settled();
        // The controllers' first byte is whatever they all begin with.
        if !settled && self.begins != Some(bytes[0]) {
            (self.begins, self.settled) = (Some(bytes[0]), 0);
        }
        let told = (self.begins == Some(bytes[0])).then(|| Status::decode(bytes));
        match told.filter(|now| self.is_possible(now, settled)) {
            Some(now) => self.believe(now, settled),
            None => self.doubt(told),
        }
    }

    /// How far no counter goes until a reading of now.
    fn most(&self) -> f64 {
        f64::from(self.rules.jump) * self.interval.longest()
    }

    /// Returns whether a reading can be true; notes one that a motor cannot show, as another one
    /// may confirm it.
    ///
    /// Answers have no checksum: one wrong bit would throw an axis about. A motor that was really
    /// carried off shows so again, somewhere near.
    fn is_possible(&mut self, now: &Status, settled: bool) -> bool {
        let plain = self.step.abs() + LEAP * self.interval.since().max(1.0).powi(2);
        let jump = f64::from(self.rules.jump);
        let hidden = (self.fast + 2.0 * LEAP).min(jump) * self.interval.older();
        let off = |count: i32| f64::from(now.count.wrapping_sub(count)).abs();
        let most = self.most();
        let confirmed = self.doubted.is_some_and(|at| off(at) <= 0.5 * most);
        let odd = off(self.count) > plain + hidden && !confirmed;
        self.doubted = odd.then_some(now.count);
        !settled || self.finds_zero(now) || (!odd && off(self.count) <= most)
    }

    /// Passes over an answer that cannot be true, until too many of them have come in a row.
    fn doubt(&mut self, told: Option<Status>) -> Result<Answer, AxisFault> {
        if told.is_none() {
            self.doubted = None;
        }
        self.impossible += 1;
        self.count_try()?;
        // A controller that was reset counts from zero and says that it is not synchronised.
        let reset = told.is_some_and(|now| !now.synchronised) && self.was_synchronised;
        if self.impossible < self.rules.misses {
            Ok(Answer::Impossible(self.impossible))
        } else if reset {
            Err(AxisFault::Reset)
        } else {
            let count = told.map_or(0, |now| now.count);
            let before = self.status.count;
            Err(AxisFault::Impossible { times: self.impossible, count, before })
        }
    }

    /// Takes a reading for true: the counter, the speed from it, the flags.
    fn believe(&mut self, now: Status, settled: bool) -> Result<Answer, AxisFault> {
        self.impossible = 0;
        let near = f64::from(now.count.wrapping_sub(self.status.count)).abs() <= self.most();
        if !settled && !near {
            // One of the two is spoilt: neither says where the axis stands until others agree with it.
            self.settled = 0;
        }
        self.settled = self.settled.saturating_add(1);
        if !settled || self.finds_zero(&now) {
            self.step = 0.0;
            self.interval = Interval::default();
        } else {
            self.learn_speed(&now);
        }
        if self.interval.older() == 0.0 {
            (self.from, self.age) = (now.count, 0.0);
        }
        (self.status, self.count) = (now, now.count);
        self.confirm();
        self.see_flags(&now)
    }

    /// Takes the step in a period from a reading, and whether the reading shows what a gap hid.
    fn learn_speed(&mut self, now: &Status) {
        let gone = f64::from(now.count.wrapping_sub(self.status.count)).abs();
        let since = self.interval.since();
        if self.interval.older() == 0.0 {
            self.fast = self.step.abs();
        }
        if self.age > APART {
            self.step = f64::from(now.count.wrapping_sub(self.from)) / self.age;
        }
        // One that shows half of what a gap hid, or what the time since the last one does not
        // explain, is of now. Periods by the clock are never quite one.
        let gap = since > 1.0 + APART;
        let explained = (self.fast + 2.0 * LEAP) * since.max(1.0);
        self.interval.read(gap && gone > 0.5 * self.fast * since || gone > explained);
    }

    /// The counter jumps in the very answer that says so.
    fn finds_zero(&self, now: &Status) -> bool {
        self.synchronising && now.synchronised && !self.synchronised.is
    }

    fn confirm(&mut self) {
        match self.sent.take() {
            Some(Parameter::Mode(mode)) => self.mode = Some(mode),
            Some(Parameter::MaxCurrent(limit)) => self.max_current = Some(limit),
            _ => {}
        }
        self.tries = 0;
    }

    fn count_try(&mut self) -> Result<(), AxisFault> {
        let Some(parameter) = self.sent else { return Ok(()) };
        self.tries += 1;
        if self.tries >= self.rules.tries {
            return Err(AxisFault::Untaken(parameter));
        }
        Ok(())
    }

    fn see_flags(&mut self, now: &Status) -> Result<Answer, AxisFault> {
        self.upper.see(now.upper);
        self.lower.see(now.lower);
        self.over_current.see(now.over_current);
        self.sync_switch.see(now.sync_switch);
        self.stage_fault.see(now.stage_fault);
        // Until it has taken its first mode, a controller may still be in the error mode of the last run.
        if self.error.see(now.error) && self.mode.is_some() && self.settled >= SETTLING {
            return Err(AxisFault::Error);
        }
        if self.synchronising {
            // The counter jumps in the very answer that says so.
            self.synchronised = Twice { last: now.synchronised, is: now.synchronised };
            return Ok(Answer::Taken);
        }
        self.synchronised.see(now.synchronised);
        if self.was_synchronised && !self.synchronised.is {
            return Err(AxisFault::Reset);
        }
        self.was_synchronised = self.synchronised.is;
        Ok(Answer::Taken)
    }

    /// Encoder counter, carried on while answers are missed.
    #[must_use]
    pub fn count(&self) -> i64 {
        i64::from(self.count)
    }

    /// Whether the counter is carried on: the last order was not answered.
    #[must_use]
    pub fn is_extrapolated(&self) -> bool {
        self.interval.since() > 0.0
    }

    /// Motor current (A).
    #[must_use]
    pub fn current(&self) -> f64 {
        f64::from(self.status.current) * 1e-3
    }

    /// Whether the upper and the lower limit switch are hit.
    #[must_use]
    pub fn at_limits(&self) -> (bool, bool) {
        (self.upper.is, self.lower.is)
    }

    /// Whether the power stage reports over-current.
    #[must_use]
    pub fn over_current(&self) -> bool {
        self.over_current.is
    }

    /// Whether the power stage reports a fault of its own.
    #[must_use]
    pub fn stage_fault(&self) -> bool {
        self.stage_fault.is
    }

    /// Whether the synchronisation switch is closed.
    #[must_use]
    pub fn sync_switch(&self) -> bool {
        self.sync_switch.is
    }

    /// Whether the encoder's zero has passed in the last answer.
    #[must_use]
    pub fn sync_zero(&self) -> bool {
        self.status.sync_zero
    }

    /// Whether the counter counts from the synchronisation switch.
    #[must_use]
    pub fn synchronised(&self) -> bool {
        self.synchronised.is
    }

    /// Whether enough answers have come to believe the counter.
    #[must_use]
    pub fn has_settled(&self) -> bool {
        self.settled >= SETTLING
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ON: AxisDrive =
        AxisDrive { enabled: true, width: 100, outputs: 0, max_current: None, synchronise: false };

    fn at(count: i32) -> Status {
        Status { count, synchronised: true, ..Status::default() }
    }

    fn after_a_period(axis: &mut Axis, answer: Option<&[u8; STATUS]>) -> Result<Answer, AxisFault> {
        axis.pass(1.0);
        axis.take(answer)
    }

    /// An axis that runs and stands at 5000.
    fn running() -> Axis {
        let mut axis = Axis::new(Rules::default());
        for _ in 0..6 {
            axis.order(&ON);
            assert_eq!(after_a_period(&mut axis, Some(&at(5000).encode())), Ok(Answer::Taken));
        }
        axis
    }

    #[test]
    fn the_mode_goes_first_then_pulse_widths() {
        let mut axis = Axis::new(Rules::default());

        assert_eq!(axis.order(&ON), Order::Set(Parameter::Mode(Mode::Pwm)));
        assert_eq!(after_a_period(&mut axis, None), Ok(Answer::Missed(1)));
        assert_eq!(axis.order(&ON), Order::Set(Parameter::Mode(Mode::Pwm)), "it was not answered");
        after_a_period(&mut axis, Some(&at(7).encode())).unwrap();
        assert_eq!(axis.order(&ON), Order::Pwm { width: 100, outputs: 0, synchronise: false });
        let off = AxisDrive { enabled: false, ..ON };
        assert_eq!(axis.order(&off), Order::Set(Parameter::Mode(Mode::Manual)));
    }

    #[test]
    fn a_new_current_limit_takes_the_place_of_one_pulse_width() {
        let mut axis = running();
        let limited = AxisDrive { max_current: Some(54), ..ON };

        assert_eq!(axis.order(&limited), Order::Set(Parameter::MaxCurrent(54)));
        after_a_period(&mut axis, Some(&at(5000).encode())).unwrap();
        assert!(matches!(axis.order(&limited), Order::Pwm { .. }));
    }

    #[test]
    fn a_spoilt_answer_settles_no_start() {
        let (good, spoilt) = (at(5000).encode(), at(5000 + (1 << 30)).encode());
        for spoilt_one in 0..SETTLING {
            let mut axis = Axis::new(Rules::default());
            for k in 0..=SETTLING + spoilt_one {
                assert!(!axis.has_settled() || axis.count() == 5000, "after {k}");
                let answer = if k == spoilt_one { &spoilt } else { &good };
                assert_eq!(after_a_period(&mut axis, Some(answer)), Ok(Answer::Taken));
            }
            assert!(axis.has_settled() && axis.count() == 5000, "{spoilt_one}");
        }
    }

    #[test]
    fn three_missed_answers_in_a_row_are_a_fault_and_two_are_not() {
        let mut axis = running();
        let miss = |axis: &mut Axis| {
            axis.order(&ON);
            after_a_period(axis, None)
        };

        assert_eq!(miss(&mut axis), Ok(Answer::Missed(1)));
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(2)));
        axis.order(&ON);
        after_a_period(&mut axis, Some(&at(5001).encode())).unwrap();
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(1)));
        assert_eq!(miss(&mut axis), Ok(Answer::Missed(2)));
        assert_eq!(miss(&mut axis), Err(AxisFault::Silent(3)));
    }

    #[test]
    fn an_answer_of_the_period_before_is_told_by_its_counter() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }
        after_a_period(&mut axis, None).unwrap();
        axis.pass(1.0);

        assert!(axis.is_late(&at(300 * 20 + 5)));
        assert!(!axis.is_late(&at(300 * 21 - 5)));
    }

    /// What becomes of the answers to an axis that went 20 increments a period, after one was lost.
    fn after_a_lost_answer(counts: [i32; 3]) -> [Answer; 3] {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(20 * k))).unwrap();
        }
        after_a_period(&mut axis, None).unwrap();

        counts.map(|count| {
            axis.pass(1.0);
            let late = axis.is_late(&at(count));
            if late { axis.overlook() } else { axis.take(Some(&at(count))).unwrap() }
        })
    }

    #[test]
    fn what_seems_late_is_no_silence_and_is_believed_soon() {
        use Answer::{Late, Taken};

        // It stands where it was expected a period before: nothing tells that from an answer that is late.
        assert_eq!(after_a_lost_answer([400, 400, 400]), [Late, Taken, Taken]);
        // Always a period behind: what is owed is not to come.
        assert_eq!(after_a_lost_answer([400, 420, 440]), [Late, Late, Taken]);
        assert_eq!(after_a_lost_answer([420, 440, 460]), [Taken; 3]);
    }

    #[test]
    fn an_axis_that_brakes_hard_is_read_at_once_after_a_lost_answer() {
        // At the end of it, below 80 increments a period, it is anybody's guess, and little depends on it.
        for lost in 1..9 {
            let mut axis = Axis::new(Rules::default());
            let at = |count| Status { count, ..Status::default() }.encode();
            let mut count = 0;
            for _ in 0..20 {
                count += 190;
                after_a_period(&mut axis, Some(&at(count))).unwrap();
            }
            for k in 1..12 {
                // A track that brakes as fast as it may, in 20 ms.
                count += 190 - 16 * k;
                axis.pass(1.0);
                if k == lost {
                    axis.take(None).unwrap();
                    continue;
                }
                assert!(k != lost + 1 || !axis.is_late(&at(count)), "{lost}");
                axis.take(Some(&at(count))).unwrap();
            }
        }
    }

    #[test]
    fn a_motor_goes_on_while_this_machine_is_kept_from_running() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(8.0);
        assert_eq!(axis.count(), 300 * 27);
        assert_eq!(axis.take(Some(&at(300 * 23))), Ok(Answer::Taken), "it was braked meanwhile");
        axis.pass(1.0);
        assert_eq!(axis.count(), 300 * 23 + 150, "4 steps in 8 periods");
        assert!(matches!(axis.take(Some(&at(300 * 60))), Ok(Answer::Impossible(1))));
    }

    #[test]
    fn what_a_standstill_of_the_machine_hid_may_show_an_answer_later() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(12.0);
        let old = at(300 * 20);
        assert_eq!(axis.take(Some(&old)), Ok(Answer::Taken), "from when the standstill began");
        for k in 32..40 {
            let taken = after_a_period(&mut axis, Some(&at(300 * k)));
            assert_eq!(taken, Ok(Answer::Taken), "now is told of now");
            // The extrapolation after it is right at once.
            let mut guess = axis.clone();
            after_a_period(&mut guess, None).unwrap();
            assert!((guess.count() - i64::from(300 * (k + 1))).abs() <= 2, "{}", guess.count());
        }
        let far = at(300 * 39 + 1400);
        assert_eq!(after_a_period(&mut axis, Some(&far)), Ok(Answer::Impossible(1)), "no more");
    }

    #[test]
    fn a_line_that_catches_up_may_show_a_little_first() {
        let mut axis = Axis::new(Rules::default());
        let at = |count| Status { count, ..Status::default() }.encode();
        for k in 0..20 {
            after_a_period(&mut axis, Some(&at(300 * k))).unwrap();
        }

        axis.pass(12.0);
        axis.take(Some(&at(300 * 20))).unwrap();
        for count in [300 * 21, 300 * 33] {
            axis.pass(1.003);
            assert_eq!(axis.take(Some(&at(count))), Ok(Answer::Taken), "{count}");
        }
    }

    #[test]
    fn a_counter_goes_on_while_answers_are_missed() {
        let mut axis = running();
        after_a_period(&mut axis, Some(&at(5100).encode())).unwrap();
        after_a_period(&mut axis, Some(&at(5200).encode())).unwrap();

        after_a_period(&mut axis, None).unwrap();
        assert_eq!(axis.count(), 5300);
        after_a_period(&mut axis, Some(b"$1234567")).unwrap();
        assert_eq!(axis.count(), 5400);
        after_a_period(&mut axis, Some(&at(5503).encode())).unwrap();
        assert_eq!(axis.count(), 5503);
        after_a_period(&mut axis, None).unwrap();
        assert_eq!(axis.count(), 5604, "101 a period");
    }

    #[test]
    fn one_spoilt_answer_is_passed_over_and_a_lasting_jump_is_a_fault() {
        let mut axis = running();
        let jumped = at(5000 + 1001).encode();

        assert_eq!(after_a_period(&mut axis, Some(&jumped)), Ok(Answer::Impossible(1)));
        assert_eq!(axis.count(), 5000);
        assert_eq!(after_a_period(&mut axis, Some(&at(5100).encode())), Ok(Answer::Taken));
        assert_eq!(after_a_period(&mut axis, Some(b"$1234567")), Ok(Answer::Impossible(1)));
        for told in [Ok(Answer::Impossible(2)), Ok(Answer::Taken)] {
            assert_eq!(after_a_period(&mut axis, Some(&at(5800).encode())), told, "said twice");
        }
        for _ in 0..2 {
            assert!(matches!(
                after_a_period(&mut axis, Some(&at(0).encode())),
                Ok(Answer::Impossible(_))
            ));
        }
        assert!(matches!(
            after_a_period(&mut axis, Some(&at(0).encode())),
            Err(AxisFault::Impossible { times: 3, count: 0, before: 5800 })
        ));
    }

    #[test]
    fn a_flag_counts_when_it_shows_twice() {
        let mut axis = running();
        let hit = Status { upper: true, over_current: true, ..at(5000) };

        after_a_period(&mut axis, Some(&hit.encode())).unwrap();
        assert!(axis.at_limits() == (false, false) && !axis.over_current());
        after_a_period(&mut axis, Some(&at(5000).encode())).unwrap();
        after_a_period(&mut axis, Some(&hit.encode())).unwrap();
        after_a_period(&mut axis, Some(&hit.encode())).unwrap();
        assert!(axis.at_limits() == (true, false) && axis.over_current());
    }

    #[test]
    fn a_controller_that_was_reset_is_found_out() {
        let mut axis = running();
        let near = Status { synchronised: false, ..at(4950) };
        assert_eq!(after_a_period(&mut axis, Some(&near.encode())), Ok(Answer::Taken));
        assert_eq!(after_a_period(&mut axis, Some(&near.encode())), Err(AxisFault::Reset));

        let mut axis = running();
        let far = Status { synchronised: false, ..at(0) }.encode();
        after_a_period(&mut axis, Some(&far)).unwrap();
        after_a_period(&mut axis, Some(&far)).unwrap();
        assert_eq!(after_a_period(&mut axis, Some(&far)), Err(AxisFault::Reset));
    }

    #[test]
    fn a_parameter_that_is_never_answered_is_a_fault() {
        let mut axis = running();
        let off = AxisDrive { enabled: false, ..ON };
        for answer in [None, Some(b"$1234567")] {
            axis.order(&off);
            after_a_period(&mut axis, answer).unwrap();
        }
        axis.order(&off);
        assert_eq!(
            after_a_period(&mut axis, None),
            Err(AxisFault::Untaken(Parameter::Mode(Mode::Manual)))
        );
    }

    #[test]
    fn an_axis_that_synchronises_may_jump_and_forget() {
        let mut axis = running();
        let homing = AxisDrive { synchronise: true, ..ON };
        let lost = Status { synchronised: false, ..at(5010) };

        assert_eq!(axis.order(&homing), Order::Pwm { width: 100, outputs: 0, synchronise: true });
        assert_eq!(after_a_period(&mut axis, Some(&lost.encode())), Ok(Answer::Taken));
        assert!(!axis.synchronised());
        axis.order(&homing);
        assert_eq!(after_a_period(&mut axis, Some(&at(3).encode())), Ok(Answer::Taken));
        assert!(axis.synchronised());
        assert_eq!(axis.count(), 3);
        axis.order(&ON);
        assert_eq!(after_a_period(&mut axis, Some(&at(4).encode())), Ok(Answer::Taken));
    }

    #[test]
    fn answers_begin_with_whatever_they_began_with() {
        let begun_with = |first: u8, bytes: [u8; STATUS]| [&[first], &bytes[1..]].concat();
        let mut axis = Axis::new(Rules::default());
        for _ in 0..6 {
            axis.order(&ON);
            let answer: [u8; STATUS] = begun_with(0x55, at(5000).encode()).try_into().unwrap();
            assert_eq!(after_a_period(&mut axis, Some(&answer)), Ok(Answer::Taken));
        }
        assert!(axis.has_settled());
        axis.order(&ON);
        let other = at(5000).encode();
        assert_eq!(after_a_period(&mut axis, Some(&other)), Ok(Answer::Impossible(1)));
    }
}
