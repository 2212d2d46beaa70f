//! Levenberg-Marquardt iteration (Madsen, Nielsen and Tingleff 2004, sections 3.2 and 3.5) that reuses its
//! Jacobian as long as it serves.

use super::free::{Free, Point};
use super::layout::{Layout, State};
use super::normal::Normal;
use super::slopes::Slopes;
use super::system::System;

/// Convergence threshold: minimum gain of the objective per round, per mean squared residual (1 at least).
const ARRIVED: f64 = 1e-3;
/// Convergence threshold, per mean squared residual beyond `FAR_SQUARE`, of models that are only compared
/// with others (named choices).
const ARRIVED_FAR: f64 = 0.03;
/// Mean squared residual beyond which a model is far off.
pub(super) const FAR_SQUARE: f64 = 4.0;
/// Minimum ratio of actual to predicted gain of a step; below it the slopes do not hold.
const HOLDS: f64 = 0.8;
/// Maximum number of successive steps below that ratio before the slopes are computed again.
const MENDED: usize = 2;
/// Maximum rounds per computation of the slopes, on average.
const SERVED: usize = 3;
/// A step turns back if it is at least this share of the last step's length, and opposite to it within this
/// cosine (a named choice: it ends three of the four fits of the EMVA 1288 group's camera that oscillated
/// without end).
const BACK: f64 = 0.5;
/// Maximum relative change per round of a fitted scatter that has settled.
const SETTLED: f64 = 1e-3;

/// Iteration budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effort {
    /// Brief fit to rank a start: slopes known from another fit are not computed again.
    Look,
    /// Few rounds: enough to tell how far off a model is.
    Short,
    /// To convergence; a model that is far off, only as exactly as a comparison with others needs.
    Rival,
    /// To convergence.
    Full,
}

impl Effort {
    /// Returns the maximum number of computations of the slopes.
    fn rounds(self) -> usize {
        match self {
            Self::Look | Self::Short => 5,
            Self::Rival => 14,
            Self::Full => 40,
        }
    }

    /// Returns the convergence threshold at a mean squared residual.
    fn arrived(self, mean_square: f64) -> f64 {
        if matches!(self, Self::Look | Self::Rival) && mean_square > FAR_SQUARE {
            return ARRIVED_FAR * mean_square;
        }
        ARRIVED * mean_square.max(1.0)
    }
}

/// State of an iteration.
pub(super) struct Iteration<'a> {
    layout: &'a Layout<'a>,
    free: &'a Free,
    pub point: Point,
    pub now: State,
    pub slopes: Slopes,
    pub system: System<'a>,
    damping: f64,
    /// True if the slopes were computed at this point.
    fresh: bool,
    /// Number of successive steps that gained less than predicted.
    missed: usize,
    /// The last step.
    last: Option<Point>,
}

/// Outcome of a step.
#[derive(Default)]
struct Step {
    gained: f64,
    /// True if the gain is as large as the slopes predicted.
    holds: bool,
}

impl<'a> Iteration<'a> {
    /// Starts at a point; `known`: slopes of another fit near it.
    pub fn new(layout: &'a Layout<'a>, free: &'a Free, mut point: Point, known: Option<&Slopes>) -> Self {
        free.clamp(&mut point);
        let now = layout.at(free, &point);
        let slopes = Slopes::beside(known, layout, free, &point, &now);
        let system = System::new(layout, free, &point, &now, &slopes);
        let fresh = known.is_none();
        Self { layout, free, point, now, slopes, system, damping: 1e-3, fresh, missed: 0, last: None }
    }

    /// Iterates until nothing is gained, within the budget.
    pub fn run(&mut self, effort: Effort, known: Option<&Slopes>) {
        let (mut taken, rows) = (0, self.layout.rows.len() as f64);
        for _ in 0..SERVED * effort.rounds() {
            let before = self.system.objective(&self.now, &self.now, &self.point.lights);
            let step = self.step(before);
            let settled = self.settle();
            let arrived = settled && step.gained < effort.arrived(before / rows);
            // Slopes of another fit that predict the last step are as good as those of this point.
            let sure = self.fresh || known.is_some() && step.holds && step.gained < ARRIVED;
            if arrived && sure {
                break;
            }
            self.fresh = false;
            if arrived || self.missed > MENDED {
                taken += 1;
                if taken == effort.rounds() {
                    break;
                }
                self.take_slopes(known.filter(|_| effort == Effort::Look));
            } else if !settled {
                self.renew();
            }
        }
        if !self.fresh && known.is_none() && effort == Effort::Full {
            self.take_slopes(None);
        }
    }

    /// Takes one step down, with as much damping as it needs.
    fn step(&mut self, before: f64) -> Step {
        let mut normal = self.system.normal();
        // A value at an end of its range that would leave it is held: a step that is cut off there gains
        // nothing for the others.
        for (i, (x, (min, max))) in self.point.x.iter().zip(&self.free.bounds).enumerate() {
            let gradient = normal.gradient[i];
            normal.held[i] |= x <= min && gradient < 0.0 || x >= max && gradient > 0.0;
        }
        for _ in 0..if self.fresh { 10 } else { 2 } {
            let Some((mut step, mut lights)) = normal.step(self.damping) else {
                self.damping *= 10.0;
                continue;
            };
            if self.last.as_ref().is_some_and(|last| turns_back(&normal, &step, &last.x)) {
                step.iter_mut().chain(&mut lights).for_each(|s| *s *= 0.5);
            }
            let mut trial = self.point.clone();
            trial.x.iter_mut().zip(&step).for_each(|(x, s)| *x += s);
            trial.lights.iter_mut().zip(&lights).for_each(|(x, s)| *x += s);
            self.free.clamp(&mut trial);
            let there = self.layout.at(self.free, &trial);
            let gained = before - self.system.objective(&self.now, &there, &trial.lights);
            if gained > 0.0 {
                self.damping = (self.damping * 0.2).max(1e-7);
                let moved = trial.from(&self.point);
                let holds = gained >= HOLDS * self.system.promised(&moved.x, &lights);
                self.missed = if holds { 0 } else { self.missed + 1 };
                // The shortfall of the smallest steps is rounding.
                if !holds && gained > ARRIVED {
                    self.system.follow(&mut self.slopes, self.free, &moved, &self.now, &there, &normal);
                    self.fresh = false;
                }
                (self.point, self.now, self.last) = (trial, there, Some(moved));
                self.renew();
                return Step { gained, holds };
            }
            self.damping *= 6.0;
        }
        Step::default()
    }

    /// Scales fitted scatters to match the residuals. Returns true if they already did.
    fn settle(&mut self) -> bool {
        let factors = self.system.scatter_factors();
        if factors.iter().all(|(_, f)| (f - 1.0).abs() < SETTLED) {
            return true;
        }
        let from = self.point.clone();
        factors.iter().for_each(|(i, f)| self.point.x[*i] *= f);
        self.free.clamp(&mut self.point);
        // A scatter at an end of its range stays there.
        let moves =
            |(i, _): &(usize, f64)| (self.point.x[*i] - from.x[*i]).abs() >= SETTLED * from.x[*i].abs();
        if !factors.iter().any(moves) {
            self.point = from;
            return true;
        }
        self.now = self.layout.at_from(self.free, &self.point, &self.now, &from, None);
        // The slope of a variance grows with the scatter. Without new slopes the errors of the scatter would
        // be those at the start.
        for (i, _) in &factors {
            self.slopes.take_again(*i, self.layout, self.free, &self.point, &self.now);
        }
        false
    }

    /// Computes the slopes at this point; those of `kept` stay.
    fn take_slopes(&mut self, kept: Option<&Slopes>) {
        self.slopes = Slopes::beside(kept, self.layout, self.free, &self.point, &self.now);
        (self.fresh, self.missed) = (true, 0);
        self.renew();
    }

    fn renew(&mut self) {
        self.system = System::new(self.layout, self.free, &self.point, &self.now, &self.slopes);
    }
}

/// Returns true if a step takes back most of the last one, in the metric of the normal matrix's diagonal.
/// Errors follow the fitted values, so a fit may oscillate between two points forever.
fn turns_back(normal: &Normal, step: &[f64], last: &[f64]) -> bool {
    let product = |a: &[f64], b: &[f64]| -> f64 {
        a.iter().zip(b).enumerate().map(|(i, (a, b))| normal.matrix[i * normal.n + i] * a * b).sum()
    };
    let (along, square, was) = (product(step, last), product(step, step), product(last, last));
    along < -BACK * (square * was).sqrt() && square > BACK * BACK * was
}
