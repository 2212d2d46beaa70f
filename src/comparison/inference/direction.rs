//! Score test: gain of a move of the expectations, before anything is fitted.

use super::layout::State;
use super::normal::{Normal, Solver};
use super::system::System;
use crate::fit::cholesky::Factor;
use crate::observables::Expected;

/// Drop in minus twice the log likelihood.
#[derive(Debug, Clone, Copy)]
pub struct Gain {
    /// Drop for the whole of a move.
    pub whole: f64,
    /// Best multiple of the move, if it is in proportion.
    pub multiple: f64,
    /// Drop at the best multiple.
    pub best: f64,
}

/// Score test of a move of the expectations, with everything else fitted (Rao 1973, section 6e).
pub struct Direction<'s, 'a> {
    system: &'s System<'a>,
    normal: Normal,
    solver: Solver,
}

impl<'s, 'a> Direction<'s, 'a> {
    /// Prepares the test at a fit; `None` if the fitted values cannot be told apart.
    pub fn new(system: &'s System<'a>) -> Option<Self> {
        let normal = system.normal();
        Some(Self { solver: normal.solver(1e-9)?, normal, system })
    }

    /// Returns the further gain because the scatter of settings follows. For m settings whose sum of squares
    /// falls from S to T, the likelihood gains m ln(S / T), and not S - T.
    fn narrower(&self, settings: &[(f64, f64)]) -> f64 {
        let m: f64 = self.system.blocks.iter().map(|b| b.told).sum();
        let (before, after) = settings.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x * x, b + y * y));
        if m < 4.0 || after >= before {
            return 0.0;
        }
        // The scatter cannot fall below that of the frames.
        let floor: f64 = self.system.blocks.iter().map(|b| 1.0 / b.weight / b.variance).sum();
        (m * (before / after.max(floor)).ln() - (before - after)).max(0.0)
    }

    /// Computes the rest of a move from `now` to `there`, once the fitted values have absorbed what they can;
    /// `None` if it is not finite.
    pub fn left_of(&self, now: &State, there: &State) -> Option<Vec<f64>> {
        let mut moves = self.moves(now, there);
        self.take_over(&mut moves);
        moves.iter().all(|m| m.is_finite()).then_some(moves)
    }

    /// Computes the moves of the rows, in standard errors.
    fn moves(&self, now: &State, there: &State) -> Vec<f64> {
        let of = |(a, b): (&Expected, &Expected)| (b.normal.1 - a.normal.1) / a.normal.2;
        let mut moves: Vec<f64> = now.expected.iter().zip(&there.expected).map(of).collect();
        self.system.white.apply(&mut moves, 1);
        for block in &self.system.blocks {
            let common = block.take_common(&mut moves);
            moves.push(common / block.variance.sqrt());
        }
        moves
    }

    /// Subtracts the part of the moves that the fitted values can follow.
    fn take_over(&self, moves: &mut [f64]) {
        let (s, n) = (self.system, self.system.n);
        let mut gradient = vec![0.0; n];
        let mut lights = vec![0.0; self.normal.lights.len()];
        for (r, m) in moves.iter().enumerate().filter(|(_, m)| **m != 0.0) {
            let row = &s.slopes[r * n..][..n];
            gradient.iter_mut().zip(row).for_each(|(g, s)| *g += s * m);
            if let Some(light) = s.light[r] {
                lights[light] += s.by_light[r] * m;
            }
        }
        let (taken, lights) = self.solver.solve(&self.normal, gradient, &lights);
        for (r, m) in moves.iter_mut().enumerate() {
            let row = &s.slopes[r * n..][..n];
            *m -= row.iter().zip(&taken).map(|(s, t)| s * t).sum::<f64>();
            if let Some(light) = s.light[r] {
                *m -= s.by_light[r] * lights[light];
            }
        }
    }

    /// Computes the gain of a move with this rest; `None` if there is no rest.
    pub fn gain(&self, left: &[f64]) -> Option<Gain> {
        let s = self.system;
        let (mut with, mut square) = (0.0, 0.0);
        for (left, z) in left.iter().zip(&s.z) {
            with += left * z;
            square += left * left;
        }
        if square <= 1e-12 || !square.is_finite() {
            return None;
        }
        let first = left.len() - s.blocks.len();
        let left_over: Vec<(f64, f64)> =
            left[first..].iter().zip(&s.z[first..]).map(|(left, z)| (*z, z - left)).collect();
        let whole = 2.0 * with - square + self.narrower(&left_over);
        Some(Gain { whole, multiple: with / square, best: with * with / square })
    }

    /// Computes the multiples of further moves that together gain most, after a move with the rest `from`.
    pub fn together(&self, from: &[f64], moves: &[Vec<f64>]) -> Option<Vec<f64>> {
        let k = moves.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let rest: Vec<f64> = self.system.z.iter().zip(from).map(|(z, m)| z - m).collect();
        let mut a: Vec<f64> = (0..k * k).map(|i| dot(&moves[i / k], &moves[i % k])).collect();
        let mut b: Vec<f64> = moves.iter().map(|m| dot(m, &rest)).collect();
        for i in 0..k {
            a[i * k + i] = a[i * k + i] * (1.0 + 1e-9) + 1e-12;
        }
        Factor::of(&a, k)?.solve(&mut b);
        Some(b)
    }
}
