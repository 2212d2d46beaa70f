//! Levenberg and Marquardt's iteration (Madsen, Nielsen and Tingleff 2004, sections 3.2 and 3.5), with slopes that serve as long as they can.

use super::free::{Free, Point};
use super::layout::{Layout, State};
use super::normal::Normal;
use super::slopes::Slopes;
use super::system::System;

/// A round that gains less of the objective has arrived, where residuals are of the size of their errors; where they are larger, in
/// proportion to their mean square.
const ARRIVED: f64 = 1e-3;
/// The same, in proportion to the mean square, of models beyond this one that are only compared with others (named choices).
const ARRIVED_FAR: f64 = 0.03;
/// A mean square of the residuals beyond which a model is far off.
pub(super) const FAR_SQUARE: f64 = 4.0;
/// A step that gains less than this share of what it promised was promised too much.
const HOLDS: f64 = 0.8;
/// Slopes are taken again after more than so many such steps, one after the other.
const MENDED: usize = 2;
/// Slopes serve in so many rounds at most, on average.
const SERVED: usize = 3;
/// A step turns back where it takes this share of the last one's length back at least, within this cosine of its direction (a named choice: of
/// the four fits of the EMVA 1288 group's camera that went to and fro without end three end).
const BACK: f64 = 0.5;
/// Values that are a scatter have settled once a round changes them by less than this share.
const SETTLED: f64 = 1e-3;

/// How far an iteration goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effort {
    /// A look at what a start is worth: of what is known elsewhere slopes are not taken again.
    Look,
    /// Few rounds: enough to tell how far off a model is.
    Short,
    /// To the end; a model that is far off, as exactly as it is to be compared with others.
    Rival,
    /// To the end.
    Full,
}

impl Effort {
    /// Slopes are taken so often at most.
    fn rounds(self) -> usize {
        match self {
            Self::Look | Self::Short => 5,
            Self::Rival => 14,
            Self::Full => 40,
        }
    }

    /// What a round gains less than has arrived, at a mean square of the residuals.
    fn arrived(self, mean_square: f64) -> f64 {
        if matches!(self, Self::Look | Self::Rival) && mean_square > FAR_SQUARE {
            return ARRIVED_FAR * mean_square;
        }
        ARRIVED * mean_square.max(1.0)
    }
}

/// Where an iteration stands.
pub(super) struct Iteration<'a> {
    layout: &'a Layout<'a>,
    free: &'a Free,
    pub point: Point,
    pub now: State,
    pub slopes: Slopes,
    pub system: System<'a>,
    damping: f64,
    /// Whether the slopes were taken at this place.
    fresh: bool,
    /// Steps that gained less than they promised, since one did not.
    missed: usize,
    /// The last step.
    last: Option<Point>,
}

/// What a step did.
#[derive(Default)]
struct Step {
    gained: f64,
    /// Whether that is what the slopes promised.
    holds: bool,
}

impl<'a> Iteration<'a> {
    /// At a start; `known`: slopes of another fit near it.
    pub fn new(layout: &'a Layout<'a>, free: &'a Free, mut point: Point, known: Option<&Slopes>) -> Self {
        free.clamp(&mut point);
        let now = layout.at(free, &point);
        let slopes = Slopes::beside(known, layout, free, &point, &now);
        let system = System::new(layout, free, &point, &now, &slopes);
        let fresh = known.is_none();
        Self { layout, free, point, now, slopes, system, damping: 1e-3, fresh, missed: 0, last: None }
    }

    /// Goes down until nothing is gained.
    pub fn run(&mut self, effort: Effort, known: Option<&Slopes>) {
        let (mut taken, rows) = (0, self.layout.rows.len() as f64);
        for _ in 0..SERVED * effort.rounds() {
            let before = self.system.objective(&self.now, &self.now, &self.point.lights);
            let step = self.step(before);
            let settled = self.settle();
            let arrived = settled && step.gained < effort.arrived(before / rows);
            // Slopes of another fit that hold to the last are as good as those of this place.
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

    /// One step down, damped as much as it takes.
    fn step(&mut self, before: f64) -> Step {
        let mut normal = self.system.normal();
        // What lies at an end of its range and would leave it stays there: else a step that is cut off there
        // gains nothing for the others.
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
                // Of the smallest steps what they missed is rounding.
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

    /// Brings values that are a scatter to what the residuals show; whether they were there.
    fn settle(&mut self) -> bool {
        let factors = self.system.scatter_factors();
        if factors.iter().all(|(_, f)| (f - 1.0).abs() < SETTLED) {
            return true;
        }
        let from = self.point.clone();
        factors.iter().for_each(|(i, f)| self.point.x[*i] *= f);
        self.free.clamp(&mut self.point);
        // At an end of its range a scatter stays where it is.
        let moves =
            |(i, _): &(usize, f64)| (self.point.x[*i] - from.x[*i]).abs() >= SETTLED * from.x[*i].abs();
        if !factors.iter().any(moves) {
            self.point = from;
            return true;
        }
        self.now = self.layout.at_from(self.free, &self.point, &self.now, &from, None);
        // The slope of a variance grows with the scatter: without it the errors of the scatter would be
        // those of the start.
        for (i, _) in &factors {
            self.slopes.take_again(*i, self.layout, self.free, &self.point, &self.now);
        }
        false
    }

    /// Takes slopes at this place; those of `kept` stay.
    fn take_slopes(&mut self, kept: Option<&Slopes>) {
        self.slopes = Slopes::beside(kept, self.layout, self.free, &self.point, &self.now);
        (self.fresh, self.missed) = (true, 0);
        self.renew();
    }

    fn renew(&mut self) {
        self.system = System::new(self.layout, self.free, &self.point, &self.now, &self.slopes);
    }
}

/// Whether a step takes most of the last one back, in units of what the campaign tells of each value: errors follow what is fitted, and two
/// places may send a fit to and fro for ever.
fn turns_back(normal: &Normal, step: &[f64], last: &[f64]) -> bool {
    let product = |a: &[f64], b: &[f64]| -> f64 {
        a.iter().zip(b).enumerate().map(|(i, (a, b))| normal.matrix[i * normal.n + i] * a * b).sum()
    };
    let (along, square, was) = (product(step, last), product(step, step), product(last, last));
    along < -BACK * (square * was).sqrt() && square > BACK * BACK * was
}
