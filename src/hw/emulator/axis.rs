//! An emulated serial axis controller, which takes the bytes of orders and answers each order with
//! the state of its axis.
//!
//! | case | threshold | reaction |
//! |---|---|---|
//! | no order, if it has a watchdog | `SILENCE` | power off, brake on, error mode |
//! | current above its limit | `TRIPS` | over-current |
//!
//! - in: bytes of orders; at the end of each period of the plant, the state of the axis
//! - out: answers; the mode, pulse width and outputs from which the plant's drives are made
//! - The power stage follows pulse widths in [`Mode::Pwm`] only.
//! - An answer has the state at the end of the plant's last period. Only the counter is
//!   interpolated within the present period.

use crate::hw::serial::frame::{Mode, ORDER, Order, Parameter, Status};

/// Plant periods without an order after which a controller with a watchdog brakes: 50 ms.
const SILENCE: u32 = 25;

/// Plant periods above the current limit that are still allowed: 0.1 s.
const TRIPS: u32 = 50;

/// An axis controller.
#[derive(Debug, Clone)]
pub struct AxisController {
    mode: Mode,
    width: i16,
    outputs: u8,
    max_current: u16,
    /// Number of plant periods in a row in which the current was above `max_current`.
    above: u32,
    synchronise: bool,
    /// Whether the controller brakes when no order comes.
    watchdog: bool,
    /// Plant periods since the last order.
    silent: u32,
    /// Bytes of the order that is being received, and their number.
    pending: [u8; ORDER],
    length: usize,
    /// State of the axis at the end of the period that the plant computed last. The counter is the
    /// plant's.
    status: Status,
    /// Counter at the beginning of that period; `None` before the first one.
    before: Option<i32>,
    /// Counter at the last reset; `None` while the plant's own zero applies.
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
    /// Makes a controller that follows its last order for ever.
    #[must_use]
    pub fn without_watchdog() -> Self {
        Self { watchdog: false, ..Self::default() }
    }

    /// Receives a byte of an order when `share` (0..=1) of the plant's period has passed. Returns
    /// the answer if the byte completes an order.
    pub fn receive(&mut self, byte: u8, share: f64) -> Option<Status> {
        self.pending[self.length] = byte;
        self.length += 1;
        // Noise or a cut order may precede an order: bytes are dropped from the front until the
        // rest can begin one.
        while self.length > 0 && !self.may_begin_an_order() {
            self.pending.copy_within(1.., 0);
            self.length -= 1;
        }
        if self.length < ORDER {
            return None;
        }
        // An order with an unknown command gets no answer, like one that was lost on the line.
        let order = Order::decode(&self.pending);
        self.length = 0;
        self.obey(order?);
        Some(self.answer(share))
    }

    /// Returns whether the bytes received so far are the beginning of an order: four zeros, `#`.
    fn may_begin_an_order(&self) -> bool {
        let wanted = [0, 0, 0, 0, b'#'];
        self.pending[..self.length].iter().zip(wanted).all(|(byte, wanted)| *byte == wanted)
    }

    /// Carries out an order.
    fn obey(&mut self, order: Order) {
        // Each order proves that the bridge is alive, even one that is ignored.
        self.silent = 0;
        match order {
            Order::Pwm { width, outputs, synchronise } => {
                (self.width, self.outputs, self.synchronise) = (width, outputs, synchronise);
            }
            Order::Set(Parameter::Mode(mode)) => {
                self.mode = mode;
                // An old width must not move the axis when the power stage comes on again.
                if mode != Mode::Pwm {
                    self.width = 0;
                }
            }
            Order::Set(Parameter::MaxCurrent(limit)) => self.max_current = limit,
            // The bridge drives by pulse width; the controllers' own regulators are not emulated.
            Order::Set(_) | Order::Current(_) | Order::Position(_) => {}
        }
    }

    /// Returns the answer to an order that is complete when `share` (0..=1) of the plant's period
    /// has passed: its counter is interpolated to that time.
    #[must_use]
    pub fn answer(&self, share: f64) -> Status {
        let mut status = self.status;
        let before = self.before.unwrap_or(status.count);
        // The plant computes a period at its beginning, so the latched counter is ahead by the rest
        // of the period.
        let way = f64::from(status.count.wrapping_sub(before));
        status.count = status.count.wrapping_sub(((1.0 - share) * way).round() as i32);
        // The plant knows neither the mode nor the zero that a reset gave the counter.
        status.error = self.mode == Mode::Error;
        if let Some(zero) = self.reset_at {
            status.count = status.count.wrapping_sub(zero);
            status.synchronised = false;
        }
        status
    }

    /// Stores the state of the axis at the end of a period of the plant.
    pub fn latch(&mut self, status: Status) {
        // At the first encoder zero behind the switch the plant's counter jumps.
        let jumps = self.synchronise && status.sync_zero && !status.sync_switch;
        // A new synchronisation makes up for a reset.
        if jumps {
            self.reset_at = None;
        }
        // A jump is no motion, so the counter is not interpolated over it, nor before the first
        // period.
        let last = self.before.map(|_| self.status.count).filter(|_| !jumps);
        self.before = Some(last.unwrap_or(status.count));
        // A short peak of the current is allowed; a longer one trips until the current falls.
        let is_above = status.current.unsigned_abs() > self.max_current;
        self.above = if is_above { self.above.saturating_add(1) } else { 0 };
        let over_current = status.over_current || self.above > TRIPS;
        self.status = Status { over_current, ..status };
        self.silent = self.silent.saturating_add(1);
        // Only a stage that drives needs the watchdog. The error mode lasts until the bridge orders
        // another mode.
        if self.watchdog && self.silent > SILENCE && self.mode == Mode::Pwm {
            self.mode = Mode::Error;
            self.width = 0;
        }
    }

    /// Resets the controller during a run: it forgets all orders, its power goes off and its
    /// counter starts at zero.
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

    /// Returns whether the power stage follows pulse widths.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.mode == Mode::Pwm
    }

    /// Returns the pulse width, -255..=255.
    #[must_use]
    pub fn width(&self) -> i16 {
        self.width
    }

    /// Returns the digital outputs.
    #[must_use]
    pub fn outputs(&self) -> u8 {
        self.outputs
    }

    /// Returns whether the counter becomes zero at the next zero of the encoder behind the
    /// synchronisation switch.
    #[must_use]
    pub fn synchronises(&self) -> bool {
        self.synchronise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sends bytes at the end of a period; returns the last answer.
    fn send(controller: &mut AxisController, bytes: &[u8]) -> Option<Status> {
        bytes.iter().filter_map(|b| controller.receive(*b, 1.0)).last()
    }

    const PWM: Order = Order::Pwm { width: 77, outputs: 1, synchronise: false };

    /// Without an earlier count there is no speed, so the counter is not interpolated.
    #[test]
    fn counter_is_constant_in_the_first_period() {
        let mut controller = AxisController::default();

        controller.latch(Status { count: 500_000, ..Status::default() });
        assert_eq!(controller.answer(0.3).count, 500_000);

        controller.latch(Status { count: 500_100, ..Status::default() });
        assert_eq!(controller.answer(0.3).count, 500_030);
    }

    /// The controller follows pulse widths only in the mode for them, and brakes after 50 ms
    /// without an order.
    #[test]
    fn controller_follows_orders_and_brakes_after_silence() {
        let mut controller = AxisController::default();
        send(&mut controller, &PWM.encode());
        assert!(!controller.is_on(), "another mode");
        assert!(send(&mut controller, &Order::Set(Parameter::Mode(Mode::Pwm)).encode()).is_some());
        controller.latch(Status { count: 5, synchronised: true, ..Status::default() });

        let answer = send(&mut controller, &PWM.encode()).unwrap();

        assert_eq!((answer.count, answer.error), (5, false));
        assert!(controller.is_on() && controller.width() == 77 && controller.outputs() == 1);
        // 50 ms are 25 periods.
        for _ in 0..25 {
            controller.latch(Status::default());
        }
        assert!(controller.is_on() && controller.width() == 77);
        controller.latch(Status::default());
        assert!(!controller.is_on() && controller.width() == 0 && controller.answer(1.0).error);
    }

    /// A controller that was started without a watchdog has none after a reset either.
    #[test]
    fn controller_without_watchdog_keeps_its_last_order() {
        let mut controller = AxisController::without_watchdog();

        for _ in 0..2 {
            controller.reset();
            send(&mut controller, &Order::Set(Parameter::Mode(Mode::Pwm)).encode());
            send(&mut controller, &PWM.encode());
            for _ in 0..2500 {
                controller.latch(Status::default());
            }

            assert!(controller.is_on() && controller.width() == 77);
            assert!(!controller.answer(1.0).error);
        }
    }

    /// The counter is interpolated, but not over the jump to zero at the synchronisation.
    #[test]
    fn counter_is_interpolated_except_at_synchronisation() {
        let mut controller = AxisController::default();
        controller.latch(Status { count: 100, ..Status::default() });
        controller.latch(Status { count: 200, ..Status::default() });
        assert_eq!([0.0, 0.25, 1.0].map(|share| controller.answer(share).count), [100, 125, 200]);

        let synchronise = Order::Pwm { width: 0, outputs: 0, synchronise: true };
        send(&mut controller, &synchronise.encode());
        controller.latch(Status { count: 3, sync_zero: true, ..Status::default() });

        assert_eq!(controller.answer(0.25).count, 3);
    }

    #[test]
    fn reset_loses_counter_and_synchronisation() {
        let mut controller = AxisController::default();
        controller.latch(Status { count: 1234, synchronised: true, ..Status::default() });

        controller.reset();
        controller.latch(Status { count: 1240, synchronised: true, ..Status::default() });

        let answer = controller.answer(1.0);
        assert_eq!((answer.count, answer.synchronised), (6, false));
    }

    proptest! {
        #[test]
        fn order_is_understood_after_any_noise(noise in prop::collection::vec(any::<u8>(), 0..40)) {
            let mut controller = AxisController::default();
            send(&mut controller, &noise);
            // The noise may have begun an order that swallows the first order.
            send(&mut controller, &PWM.encode());

            send(&mut controller, &PWM.encode());

            prop_assert_eq!(controller.width(), 77);
        }
    }
}
