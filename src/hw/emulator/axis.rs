//! A serial axis controller, emulated: it takes orders byte by byte and answers each with what its axis shows.
//!
//! - its power stage follows pulse widths in [`Mode::Pwm`] only; when no order has come for 50 ms it brakes, unless it
//!   has no watchdog
//! - a current that is above its limit for 0.1 s is an over-current
//! - what it answers with was latched at the plant's last period, but for the counter, which goes on through the period

use crate::hw::serial::frame::{Mode, ORDER, Order, Parameter, Status};

/// Plant periods without an order after which a controller brakes by itself.
const SILENCE: u32 = 25;

/// Plant periods after which a current above its limit is one too many.
const TRIPS: u32 = 50;

/// An axis controller.
#[derive(Debug, Clone)]
pub struct AxisController {
    mode: Mode,
    width: i16,
    outputs: u8,
    max_current: u16,
    /// Plant periods in a row in which the current was above that.
    above: u32,
    synchronise: bool,
    /// Brakes when no order comes.
    watchdog: bool,
    silent: u32,
    /// Bytes of the order that is under way.
    pending: [u8; ORDER],
    length: usize,
    /// Latched: what the axis shows at the period's end, its counter from where the plant counts.
    status: Status,
    /// Counter at the period's beginning; `None` before the first one.
    before: Option<i32>,
    /// Counter at the last reset; `None` while the plant's own zero holds.
    reset_at: Option<i32>,
}

impl Default for AxisController {
    fn default() -> Self {
        Self {
            mode: Mode::Manual,
            width: 0,
            outputs: 0,
            max_current: u16::MAX,
            above: 0,
            synchronise: false,
            watchdog: true,
            silent: 0,
            pending: [0; ORDER],
            length: 0,
            status: Status::default(),
            before: None,
            reset_at: None,
        }
    }
}

impl AxisController {
    /// One that follows its last order for ever.
    #[must_use]
    pub fn without_watchdog() -> Self {
        Self { watchdog: false, ..Self::default() }
    }

    /// Takes a byte when `share` of the plant's period has passed; the answer when it completes an order.
    pub fn hear(&mut self, byte: u8, share: f64) -> Option<Status> {
        self.pending[self.length] = byte;
        self.length += 1;
        while self.length > 0 && !self.may_begin_an_order() {
            self.pending.copy_within(1.., 0);
            self.length -= 1;
        }
        if self.length < ORDER {
            return None;
        }
        let order = Order::decode(&self.pending);
        self.length = 0;
        self.obey(order?);
        Some(self.answer(share))
    }

    fn may_begin_an_order(&self) -> bool {
        let wanted = [0, 0, 0, 0, b'#'];
        self.pending[..self.length].iter().zip(wanted).all(|(byte, wanted)| *byte == wanted)
    }

    fn obey(&mut self, order: Order) {
        self.silent = 0;
        match order {
            Order::Pwm { width, outputs, synchronise } => {
                (self.width, self.outputs, self.synchronise) = (width, outputs, synchronise);
            }
            Order::Set(Parameter::Mode(mode)) => {
                self.mode = mode;
                if mode != Mode::Pwm {
                    self.width = 0;
                }
            }
            Order::Set(Parameter::MaxCurrent(limit)) => self.max_current = limit,
            // The bridge drives by pulse width; the controllers' own regulators are not emulated.
            Order::Set(_) | Order::Current(_) | Order::Position(_) => {}
        }
    }

    /// What it answers when `share` of the plant's period has passed.
    #[must_use]
    pub fn answer(&self, share: f64) -> Status {
        let mut status = self.status;
        let before = self.before.unwrap_or(status.count);
        let way = f64::from(status.count.wrapping_sub(before));
        status.count = status.count.wrapping_sub(((1.0 - share) * way).round() as i32);
        status.error = self.mode == Mode::Error;
        if let Some(zero) = self.reset_at {
            status.count = status.count.wrapping_sub(zero);
            status.synchronised = false;
        }
        status
    }

    /// The end of a plant's period: what the axis shows now.
    pub fn latch(&mut self, status: Status) {
        // At the first zero behind the switch the plant's counter jumps.
        let jumps = self.synchronise && status.sync_zero && !status.sync_switch;
        // A new synchronisation makes up for a reset.
        if jumps {
            self.reset_at = None;
        }
        let last = self.before.map(|_| self.status.count).filter(|_| !jumps);
        self.before = Some(last.unwrap_or(status.count));
        let is_above = status.current.unsigned_abs() > self.max_current;
        self.above = if is_above { self.above.saturating_add(1) } else { 0 };
        let over_current = status.over_current || self.above > TRIPS;
        self.status = Status { over_current, ..status };
        self.silent = self.silent.saturating_add(1);
        if self.watchdog && self.silent > SILENCE && self.mode == Mode::Pwm {
            self.mode = Mode::Error;
            self.width = 0;
        }
    }

    /// A reset in mid-run: counter at zero, power off, nothing remembered.
    pub fn reset(&mut self) {
        let status = self.status;
        *self = Self {
            status,
            before: Some(status.count),
            reset_at: Some(status.count),
            watchdog: self.watchdog,
            ..Self::default()
        };
    }

    /// Whether its power stage follows.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.mode == Mode::Pwm
    }

    /// Pulse width.
    #[must_use]
    pub fn width(&self) -> i16 {
        self.width
    }

    /// Digital outputs.
    #[must_use]
    pub fn outputs(&self) -> u8 {
        self.outputs
    }

    /// Whether it is to take the next zero of the encoder for its own.
    #[must_use]
    pub fn synchronises(&self) -> bool {
        self.synchronise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tell(controller: &mut AxisController, bytes: &[u8]) -> Option<Status> {
        bytes.iter().filter_map(|b| controller.hear(*b, 1.0)).last()
    }

    const PWM: Order = Order::Pwm { width: 77, outputs: 1, synchronise: false };

    #[test]
    fn before_the_first_period_ends_a_counter_stands_where_it_is() {
        let mut controller = AxisController::default();

        controller.latch(Status { count: 500_000, ..Status::default() });
        assert_eq!(controller.answer(0.3).count, 500_000);

        controller.latch(Status { count: 500_100, ..Status::default() });
        assert_eq!(controller.answer(0.3).count, 500_030);
    }

    #[test]
    fn it_follows_orders_in_its_mode_and_brakes_by_itself() {
        let mut controller = AxisController::default();
        assert!(tell(&mut controller, &Order::Set(Parameter::Mode(Mode::Pwm)).encode()).is_some());
        controller.latch(Status { count: 5, synchronised: true, ..Status::default() });

        let answer = tell(&mut controller, &PWM.encode()).unwrap();

        assert_eq!((answer.count, answer.error), (5, false));
        assert!(controller.is_on() && controller.width() == 77 && controller.outputs() == 1);
        for _ in 0..SILENCE + 2 {
            controller.latch(Status::default());
        }
        assert!(!controller.is_on() && controller.answer(1.0).error);
    }

    #[test]
    fn without_a_watchdog_it_follows_its_last_order_for_ever_even_after_a_reset() {
        let mut controller = AxisController::without_watchdog();

        for _ in 0..2 {
            controller.reset();
            tell(&mut controller, &Order::Set(Parameter::Mode(Mode::Pwm)).encode());
            tell(&mut controller, &PWM.encode());
            for _ in 0..100 * SILENCE {
                controller.latch(Status::default());
            }

            assert!(controller.is_on() && controller.width() == 77);
            assert!(!controller.answer(1.0).error);
        }
    }

    #[test]
    fn a_counter_goes_on_through_the_period_and_jumps_at_its_zero_only() {
        let mut controller = AxisController::default();
        controller.latch(Status { count: 100, ..Status::default() });
        controller.latch(Status { count: 200, ..Status::default() });
        assert_eq!([0.0, 0.25, 1.0].map(|share| controller.answer(share).count), [100, 125, 200]);

        let synchronise = Order::Pwm { width: 0, outputs: 0, synchronise: true };
        tell(&mut controller, &synchronise.encode());
        controller.latch(Status { count: 3, sync_zero: true, ..Status::default() });

        assert_eq!(controller.answer(0.25).count, 3);
    }

    #[test]
    fn a_reset_loses_the_counter_and_the_synchronisation() {
        let mut controller = AxisController::default();
        controller.latch(Status { count: 1234, synchronised: true, ..Status::default() });

        controller.reset();
        controller.latch(Status { count: 1240, synchronised: true, ..Status::default() });

        let answer = controller.answer(1.0);
        assert_eq!((answer.count, answer.synchronised), (6, false));
    }

    proptest! {
        #[test]
        fn an_order_is_understood_after_any_noise(noise in prop::collection::vec(any::<u8>(), 0..40)) {
            let mut controller = AxisController::default();
            tell(&mut controller, &noise);
            // At worst the noise has begun an order that swallows the first one.
            tell(&mut controller, &PWM.encode());

            tell(&mut controller, &PWM.encode());

            prop_assert_eq!(controller.width(), 77);
        }
    }
}
