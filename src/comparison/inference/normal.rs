//! Normal equations: an arrowhead matrix, since light factors touch their own sets only.

use crate::fit::cholesky::Factor;

/// Terms of a light factor in the normal equations.
#[derive(Debug, Clone)]
pub(super) struct LightTerm {
    pub(super) square: f64,
    pub(super) gradient: f64,
    pub(super) with: Vec<f64>,
}

/// Normal equations.
#[derive(Debug, Clone)]
pub struct Normal {
    pub(super) n: usize,
    pub(super) matrix: Vec<f64>,
    pub(super) gradient: Vec<f64>,
    /// Values held in every step: a scatter that moves no expectation ([`System::scatter_factors`]), and
    /// values that would leave their range.
    pub(super) held: Vec<bool>,
    pub(super) lights: Vec<LightTerm>,
}

/// Normal equations with the lights eliminated, factored.
pub struct Solver {
    factor: Factor,
    squares: Vec<f64>,
}

impl Solver {
    /// Solves for a gradient: returns the step of the common values and of the lights.
    pub fn solve(&self, normal: &Normal, gradient: Vec<f64>, lights: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut b = gradient;
        for ((l, square), gradient) in normal.lights.iter().zip(&self.squares).zip(lights) {
            b.iter_mut().zip(&l.with).for_each(|(b, w)| *b -= w * gradient / square);
        }
        b.iter_mut().zip(&normal.held).filter(|(_, s)| **s).for_each(|(b, _)| *b = 0.0);
        self.factor.solve(&mut b);
        let back = |((l, square), gradient): ((&LightTerm, &f64), &f64)| {
            (gradient - l.with.iter().zip(&b).map(|(w, x)| w * x).sum::<f64>()) / square
        };
        let lights = normal.lights.iter().zip(&self.squares).zip(lights).map(back).collect();
        (b, lights)
    }
}

impl Normal {
    /// Adds prior knowledge of a common value: its weight, 1 over its variance.
    pub fn add_weight(&mut self, i: usize, weight: f64) {
        self.matrix[i * self.n + i] += weight;
    }

    /// Constrains a linear combination of successive common values to 0, far more tightly than the campaign
    /// does.
    pub fn constrain_to_zero(&mut self, first: usize, factors: &[f64]) {
        let n = self.n;
        let most = (0..n).map(|i| self.matrix[i * n + i]).fold(1.0, f64::max);
        let weight = most / factors.iter().map(|f| f * f).sum::<f64>();
        for (i, a) in factors.iter().enumerate() {
            for (j, b) in factors.iter().enumerate() {
                self.matrix[(first + i) * n + first + j] += weight * a * b;
            }
        }
    }

    /// Factors the damped equations; `None` if there is no solution.
    pub fn solver(&self, damping: f64) -> Option<Solver> {
        let n = self.n;
        let mut a = self.matrix.clone();
        for i in 0..n {
            a[i * n + i] += damping * self.matrix[i * n + i] + 1e-12;
        }
        let squares: Vec<f64> = self.lights.iter().map(|l| l.square * (1.0 + damping) + 1e-12).collect();
        for (l, square) in self.lights.iter().zip(&squares) {
            for i in (0..n).filter(|i| l.with[*i] != 0.0) {
                for j in 0..n {
                    a[i * n + j] -= l.with[i] * l.with[j] / square;
                }
            }
        }
        for i in (0..n).filter(|i| self.held[*i]) {
            for j in 0..n {
                (a[i * n + j], a[j * n + i]) = (0.0, 0.0);
            }
            a[i * n + i] = 1.0;
        }
        Some(Solver { factor: Factor::of(&a, n)?, squares })
    }

    /// Returns the damped step; `None` if there is none.
    pub fn step(&self, damping: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let lights: Vec<f64> = self.lights.iter().map(|l| l.gradient).collect();
        Some(self.solver(damping)?.solve(self, self.gradient.clone(), &lights))
    }

    /// Computes the covariance of the common values with the lights eliminated, row by row. Undetermined
    /// values keep a large error.
    pub fn covariance(&self) -> Covariance {
        let n = self.n;
        let mut a = self.matrix.clone();
        let lights: Vec<(f64, Vec<f64>)> = self
            .lights
            .iter()
            .map(|l| {
                let square = l.square + 1e-12;
                (1.0 / square, l.with.iter().map(|w| w / square).collect())
            })
            .collect();
        for (l, (inverse, _)) in self.lights.iter().zip(&lights) {
            for i in 0..n {
                for j in 0..n {
                    a[i * n + j] -= l.with[i] * l.with[j] * inverse;
                }
            }
        }
        for k in 0..n {
            a[k * n + k] += 1e-12 + 1e-10 * self.matrix[k * n + k];
        }
        let common = Factor::of(&a, n).map_or_else(|| vec![f64::NAN; n * n], |f| f.inverse());
        Covariance { n, common, lights }
    }
}

/// Covariance of the fitted values.
#[derive(Debug, Clone)]
pub struct Covariance {
    n: usize,
    /// Covariance of the common values, row by row.
    pub common: Vec<f64>,
    /// Variance of every light factor for given common values, and its slopes with them.
    lights: Vec<(f64, Vec<f64>)>,
}

impl Covariance {
    /// Computes the variance of a quantity from its slopes with the common values, and from its slope with a
    /// light factor.
    pub fn of(&self, slopes: &[f64], light: Option<(usize, f64)>) -> f64 {
        let n = self.n;
        let mut slopes = slopes.to_vec();
        let mut own = 0.0;
        if let Some((k, a)) = light {
            let (variance, follow) = &self.lights[k];
            slopes.iter_mut().zip(follow).for_each(|(s, f)| *s -= a * f);
            own = a * a * variance;
        }
        let row = |i: usize| (0..n).map(|j| self.common[i * n + j] * slopes[j]).sum::<f64>();
        own + (0..n).filter(|i| slopes[*i] != 0.0).map(|i| slopes[i] * row(i)).sum::<f64>()
    }
}
