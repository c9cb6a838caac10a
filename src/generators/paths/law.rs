//! The time law of a path: its parameter over time, with bounded speed, acceleration and jerk.
//!
//! - in: the cells of a curve; at each macrostep whether a pause slows the motion down
//! - out: the parameter at the end of the macrostep
//!
//! 1. Each cell has a largest speed V and acceleration A of the parameter. With the bounds k of the
//!    curve's derivatives and the window T they satisfy, for each thing that moves,
//!    `k1 V <= speed`, `k2 V^2 + k1 A <= acceleration`, `k3 V^3 + 3 k2 V A + 2 k1 A / T <= jerk`.
//! 2. A pass forwards and one backwards give the fastest speed over the parameter that keeps V and
//!    A from rest to rest. This raw motion may change its acceleration at once. In a pause it
//!    brakes with A, and after a resume it accelerates with A until it has its planned speed again.
//! 3. The mean of the raw motion over the last T is the motion. Its acceleration is a mean of raw
//!    accelerations, and its jerk their difference over T, at most `2 A / T`.
//!
//! The mean lags behind the raw motion, so the speeds that it averages belong to other places.
//! Before 2 each cell therefore gets the least V and A of all cells that the raw motion can pass in
//! the same window. The chain rule then gives the bounds for the tool or the joints at every
//! moment, also in a pause. They are exact for the continuous motion, so by the mean value theorem
//! they hold for the differences of its samples.
//!
//! - source: a mean over time as a filter that limits jerk: Biagiotti and Melchiorri (2012), "FIR
//!   filters for online trajectory planning with time- and frequency-domain specifications"

use super::curve::{Cell, Demand};
use std::collections::VecDeque;

/// Part of the parameter, with the planned motion on it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Planned {
    length: f64,
    /// Largest speed and acceleration of the parameter.
    speed: f64,
    acceleration: f64,
    /// Squares of the planned speeds at both ends.
    squares: (f64, f64),
}

/// A time law with its memory.
#[derive(Debug, Clone)]
pub struct Law {
    cells: Vec<Planned>,
    /// Sum of all lengths.
    length: f64,
    /// Length of a macrostep (s) in the time of the motion: a fraction of the full speed takes
    /// shorter steps.
    step: f64,
    /// Present cell of the raw motion, the distance from its beginning, and the one from the
    /// beginning of the path.
    cell: usize,
    within: f64,
    at: f64,
    speed: f64,
    /// Integral of the raw parameter over time, at the ends of the last macrosteps.
    integrals: VecDeque<f64>,
    /// Number of macrosteps in a row in which the raw motion was at rest.
    still: usize,
}

impl Law {
    /// Plans the motion over these cells from rest to rest. `step` is the length of a macrostep
    /// (s) in the time of the motion.
    #[must_use]
    pub fn plan(cells: &[Cell], step: f64) -> Self {
        let all = || cells.iter().flat_map(|cell| &cell.demands);
        let rise = all().map(|d| 2.0 * d.limit.acceleration / d.limit.jerk).fold(0.0, f64::max);
        let window = ((rise / step).ceil() as usize).max(1);
        let seconds = window as f64 * step;
        let mut planned: Vec<Planned> = cells.iter().map(|cell| bounded(cell, seconds)).collect();
        lower_to_neighbours(&mut planned, seconds);
        pass(&mut planned);
        let length = planned.iter().map(|cell| cell.length).sum();
        // A path without a length is over before it begins.
        let still = if planned.is_empty() { window } else { 0 };
        Self {
            cells: planned,
            length,
            step,
            cell: 0,
            within: 0.0,
            at: 0.0,
            speed: 0.0,
            integrals: VecDeque::from(vec![0.0; window + 1]),
            still,
        }
    }

    /// Returns the length of the path in its parameter.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Returns the length of a macrostep (s) in the time of the motion.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Returns whether the motion has reached its end.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.cell >= self.cells.len() && self.rests()
    }

    /// Returns whether the motion is at rest.
    #[must_use]
    pub fn rests(&self) -> bool {
        // The mean covers one macrostep less than it has entries.
        self.still + 1 >= self.integrals.len()
    }

    /// Advances by a macrostep and returns the parameter at its end. `pauses` brakes the motion to
    /// rest and keeps it there.
    pub fn advance(&mut self, pauses: bool) -> f64 {
        let integral = self.integrals.back().copied().unwrap_or_default();
        let from = self.at;
        let integral = integral + self.integrate(pauses);
        self.still = if self.at == from && self.speed == 0.0 { self.still + 1 } else { 0 };
        self.integrals.push_back(integral);
        self.integrals.pop_front();
        if self.is_over() {
            return self.length;
        }
        let oldest = self.integrals.front().copied().unwrap_or_default();
        let seconds = (self.integrals.len() - 1) as f64 * self.step;
        ((integral - oldest) / seconds).clamp(0.0, self.length)
    }

    /// Moves the raw motion on by a macrostep and returns the integral of its parameter over it.
    fn integrate(&mut self, pauses: bool) -> f64 {
        let (mut left, mut integral) = (self.step, 0.0);
        // Each round ends the macrostep, a cell or a phase of acceleration.
        for _ in 0..2 * self.cells.len() + 8 {
            let resting = pauses && self.speed == 0.0;
            let Some(cell) = self.cells.get(self.cell).filter(|_| !resting) else { break };
            let rest = (cell.length - self.within).max(0.0);
            let (v, acceleration, until) = cell.phase(self.within, self.speed, pauses);
            // A remainder of rounding has no planned speed.
            let short = rest <= 1e-12 * cell.length;
            let lasts = if short { 0.0 } else { time(rest, v, acceleration) };
            let spent = left.min(until).min(lasts);
            integral += spent * (self.at + spent * (0.5 * v + spent * acceleration / 6.0));
            let way = (spent * (v + 0.5 * acceleration * spent)).clamp(0.0, rest);
            (self.at, self.within) = (self.at + way, self.within + way);
            self.speed = (v + acceleration * spent).max(0.0);
            // Exactly at rest, not at a rounded speed.
            if pauses && spent == until {
                self.speed = 0.0;
            }
            if spent == lasts || rest - way <= 0.0 {
                (self.cell, self.within) = (self.cell + 1, 0.0);
                if self.cell == self.cells.len() {
                    (self.at, self.speed) = (self.length, 0.0);
                }
            }
            left -= spent;
            if left <= 0.0 {
                return integral;
            }
        }
        integral + left * self.at
    }
}

impl Planned {
    /// Returns the raw speed and acceleration at the distance `within` from the beginning of the
    /// cell, and the time after which the acceleration changes if the cell does not end before (s).
    /// `speed` is the raw speed so far, which differs from the planned one by rounding or a pause.
    fn phase(&self, within: f64, speed: f64, pauses: bool) -> (f64, f64, f64) {
        let most = self.acceleration;
        if pauses {
            return (speed, -most, speed / most);
        }
        let (begin, end) = self.squares;
        let slope = (end - begin) / (2.0 * self.length);
        let square = (begin + 2.0 * slope * within).max(0.0);
        // As planned, except after a pause: until the planned speed is reached.
        let missing = square - speed * speed;
        if missing <= 1e-12 * self.speed * self.speed {
            return (square.sqrt(), slope, f64::INFINITY);
        }
        if most - slope <= 1e-12 * most {
            return (speed, most, f64::INFINITY);
        }
        (speed, most, time(missing / (2.0 * (most - slope)), speed, most))
    }
}

/// Returns the time in which a motion of this speed and acceleration covers a way; infinite if it
/// comes to rest before.
fn time(way: f64, speed: f64, acceleration: f64) -> f64 {
    let square = speed * speed + 2.0 * acceleration * way;
    // Rounding may leave a little less than zero where a motion ends at rest.
    if square < -1e-9 * speed * speed {
        return f64::INFINITY;
    }
    let sum = speed + square.max(0.0).sqrt();
    if sum > 0.0 { 2.0 * way / sum } else { f64::INFINITY }
}

/// Returns the largest speed and acceleration of the parameter within a cell, for the window T of
/// `seconds`. Half of the acceleration and of the jerk at most is left to the curvature.
fn bounded(cell: &Cell, seconds: f64) -> Planned {
    let over = |limit: f64, by: f64| if by > 0.0 { limit / by } else { f64::INFINITY };
    let speed_of = |Demand { derivatives: [first, second, third], limit }: &Demand| {
        over(limit.speed, *first)
            .min(over(0.5 * limit.acceleration, *second).sqrt())
            .min(over(0.5 * limit.jerk, *third).cbrt())
    };
    // A cell in which nothing moves takes no time, but a finite speed.
    let speed = cell.demands.iter().map(speed_of).fold(cell.length / seconds * 1e6, f64::min);
    let acceleration_of = |Demand { derivatives: [first, second, third], limit }: &Demand| {
        let by_curve = limit.acceleration - second * speed * speed;
        let by_jerk = limit.jerk - third * speed.powi(3);
        over(by_curve, *first).min(over(by_jerk, 3.0 * second * speed + 2.0 * first / seconds))
    };
    let acceleration = cell.demands.iter().map(acceleration_of).fold(f64::INFINITY, f64::min);
    Planned { length: cell.length, speed, acceleration, squares: (0.0, 0.0) }
}

/// Lowers the speed and the acceleration of each cell to the least ones of the cells that the
/// motion can pass within `seconds` of it.
fn lower_to_neighbours(cells: &mut [Planned], seconds: f64) {
    let free: Vec<Planned> = cells.to_vec();
    for (i, cell) in cells.iter_mut().enumerate() {
        let mut lower = |others: &mut dyn Iterator<Item = &Planned>| {
            let (mut between, mut fastest) = (0.0, free[i].speed);
            for other in others {
                fastest = fastest.max(other.speed);
                // Even the fastest motion takes longer than the window from one to the other.
                if between > seconds * fastest {
                    break;
                }
                cell.speed = cell.speed.min(other.speed);
                cell.acceleration = cell.acceleration.min(other.acceleration);
                between += other.length;
            }
        };
        lower(&mut free[i + 1..].iter());
        lower(&mut free[..i].iter().rev());
    }
}

/// Plans the speeds at the ends of the cells, from rest to rest.
fn pass(cells: &mut [Planned]) {
    let mut square = 0.0_f64;
    for i in 0..cells.len() {
        let next = cells.get(i + 1).map_or(0.0, |next| next.speed);
        let cell = &mut cells[i];
        let most = cell.speed.min(next);
        let reached = (square + 2.0 * cell.acceleration * cell.length).min(most * most);
        cell.squares = (square, reached);
        square = reached;
    }
    square = 0.0;
    for cell in cells.iter_mut().rev() {
        let (begin, _) = cell.squares;
        cell.squares = (begin.min(square + 2.0 * cell.acceleration * cell.length), square);
        square = cell.squares.0;
    }
}
