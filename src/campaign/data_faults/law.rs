//! Smooth law for all sets except a few, with the deviation of those few.
//!
//! Least squares with a normal prior on every coefficient (ridge regression: Hoerl and Kennard 1970):
//! the priors state the usual bend of cameras, so that few sets suffice and the ends of the range are
//! not extrapolated freely. The point whose deletion lowers the sum of squares most, e^2 / (1 - h), is
//! removed repeatedly; then points that do not stand out are taken back, the least deviating first. Thus
//! a single stray point is found whatever its influence on the fit (Cook and Weisberg 1982, section
//! 2.2.2). The remaining points give the scatter; a point is judged by Student's t of a held-out
//! prediction.

use crate::fit::cholesky::Factor;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Point of the fit: factors of the coefficients, value, usual standard deviation.
#[derive(Debug, Clone)]
pub struct Point {
    /// Factor of each coefficient.
    pub factors: Vec<f64>,
    /// Measured value.
    pub value: f64,
    /// Nominal standard deviation.
    pub std: f64,
}

/// Fit without the points that were removed.
#[derive(Debug, Clone)]
pub struct Law {
    coefficients: Vec<f64>,
    inverse: Vec<f64>,
    /// Scatter relative to the nominal one.
    scale: f64,
    /// Scatter relative to the nominal one from the points alone; infinite for few points.
    own_scale: f64,
    dof: f64,
    /// Points that were removed.
    pub out: Vec<usize>,
}

/// Weight of the prior that the scatter is the usual one, in points (a named choice).
const PRIOR_DOF: f64 = 3.0;
/// Minimum degrees of freedom at which the points alone determine their scatter (a named choice).
const MIN_OWN_DOF: f64 = 3.0;
/// Maximum number of points for a search over all pairs: 2000 fits.
const MAX_POINTS_FOR_PAIRS: usize = 64;
/// Probability of a false stray in a campaign.
const FALSE_STRAY_PROBABILITY: f64 = 1e-4;

impl Law {
    /// Fits the law; `priors`: standard deviations of the coefficients; `most`: maximum number of
    /// removed points. `None` with too few points.
    pub fn fit(points: &[Point], priors: &[f64], most: usize) -> Option<Self> {
        let most = most.min(points.len().saturating_sub(2));
        let one_by_one = Self::one_by_one(points, priors, most)?;
        // Several strays on one side attract the fit: those furthest from a least-absolute-deviations
        // fit are removed at once.
        let at_once = Self::furthest(points, priors, most).and_then(|out| Self::back_in(points, priors, out));
        Some(match at_once {
            Some(other) if other.scale < one_by_one.scale => other,
            _ => one_by_one,
        })
    }

    /// Removes the point whose deletion lowers the squares most, repeatedly.
    fn one_by_one(points: &[Point], priors: &[f64], most: usize) -> Option<Self> {
        let mut out: Vec<usize> = Vec::new();
        let mut law = Self::without(points, priors, &out)?;
        while out.len() < most {
            let drop = |i: &usize| {
                let (off, leverage) = law.residual(&points[*i]);
                off * off / (1.0 - leverage).max(1e-9)
            };
            let left = (0..points.len()).filter(|i| !out.contains(i));
            let Some(worst) = left.max_by(|a, b| drop(a).total_cmp(&drop(b))) else { break };
            out.push(worst);
            law = Self::without(points, priors, &out)?;
            // Two strays mask each other: with exchanged labels the first to be removed may be a wrong
            // one.
            if out.len() == 2 && points.len() <= MAX_POINTS_FOR_PAIRS {
                for i in 0..points.len() {
                    for j in 0..i {
                        let pair = vec![i, j];
                        let other = Self::without(points, priors, &pair)?;
                        if other.scale < law.scale {
                            (law, out) = (other, pair);
                        }
                    }
                }
            }
        }
        Self::back_in(points, priors, out)
    }

    /// Takes back points that do not stand out, the least deviating first.
    fn back_in(points: &[Point], priors: &[f64], mut out: Vec<usize>) -> Option<Self> {
        let mut law = Self::without(points, priors, &out)?;
        while let Some(least) =
            out.iter().copied().min_by(|a, b| law.t(&points[*a]).total_cmp(&law.t(&points[*b])))
        {
            if law.is_stray(&points[least], points.len()) {
                break;
            }
            out.retain(|i| *i != least);
            law = Self::without(points, priors, &out)?;
        }
        out.sort_unstable();
        Some(Self { out, ..law })
    }

    /// Returns the points furthest from a least-absolute-deviations fit, by iterative reweighting
    /// (Schlossmacher 1973).
    fn furthest(points: &[Point], priors: &[f64], most: usize) -> Option<Vec<usize>> {
        let mut weighed = points.to_vec();
        let mut law = Self::without(&weighed, priors, &[])?;
        let off = |law: &Self, p: &Point| ((p.value - law.at(&p.factors)) / p.std).abs();
        for _ in 0..20 {
            for (w, p) in weighed.iter_mut().zip(points) {
                w.std = p.std * off(&law, p).max(0.3).sqrt();
            }
            law = Self::without(&weighed, priors, &[])?;
        }
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|a, b| off(&law, &points[*b]).total_cmp(&off(&law, &points[*a])));
        order.truncate(most);
        Some(order)
    }

    fn without(points: &[Point], priors: &[f64], out: &[usize]) -> Option<Self> {
        let n = priors.len();
        let mut matrix = vec![0.0; n * n];
        let mut right = vec![0.0; n];
        let used = || points.iter().enumerate().filter(|(i, _)| !out.contains(i)).map(|(_, p)| p);
        for p in used() {
            let weight = p.std.powi(-2);
            for i in 0..n {
                right[i] += weight * p.factors[i] * p.value;
                (0..n).for_each(|j| matrix[i * n + j] += weight * p.factors[i] * p.factors[j]);
            }
        }
        (0..n).for_each(|i| matrix[i * n + i] += priors[i].powi(-2));
        let factor = Factor::of(&matrix, n)?;
        let mut coefficients = right;
        factor.solve(&mut coefficients);
        let inverse = factor.inverse();
        let spent = n as f64 - (0..n).map(|i| inverse[i * n + i] / priors[i].powi(2)).sum::<f64>();
        let mut law =
            Self { coefficients, inverse, scale: 1.0, own_scale: f64::INFINITY, dof: 1.0, out: Vec::new() };
        let squares: f64 = used().map(|p| ((p.value - law.at(&p.factors)) / p.std).powi(2)).sum();
        let own_dof = (used().count() as f64 - spent).max(0.0);
        if own_dof >= MIN_OWN_DOF {
            law.own_scale = (squares / own_dof).sqrt();
        }
        law.dof = own_dof + PRIOR_DOF;
        law.scale = ((squares + PRIOR_DOF) / law.dof).sqrt();
        Some(law)
    }

    /// Returns the law with these points stated as removed.
    pub fn with_out(self, out: Vec<usize>) -> Self {
        Self { out, ..self }
    }

    /// Returns the scatter of the points about the law, relative to the stated one.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Returns the value at given factors.
    pub fn at(&self, factors: &[f64]) -> f64 {
        self.coefficients.iter().zip(factors).map(|(c, f)| c * f).sum()
    }

    /// Returns the variance of that value due to the points, divided by the squared scale.
    fn variance(&self, factors: &[f64]) -> f64 {
        let n = factors.len();
        (0..n).map(|i| (0..n).map(|j| factors[i] * self.inverse[i * n + j] * factors[j]).sum::<f64>()).sum()
    }

    /// Returns the normalised residual and the leverage of a point of the fit.
    fn residual(&self, p: &Point) -> (f64, f64) {
        ((p.value - self.at(&p.factors)) / p.std, self.variance(&p.factors) / p.std.powi(2))
    }

    /// Returns the standard deviation of a point about its held-out prediction.
    pub fn std(&self, p: &Point) -> f64 {
        self.scale * (p.std.powi(2) + self.variance(&p.factors)).sqrt()
    }

    /// Returns that standard deviation from the scatter of the points alone; infinite for few points.
    pub fn own_std(&self, p: &Point) -> f64 {
        self.own_scale / self.scale * self.std(p)
    }

    /// Returns the absolute deviation in these standard deviations.
    pub fn t(&self, p: &Point) -> f64 {
        ((p.value - self.at(&p.factors)) / self.std(p)).abs()
    }

    /// Returns the difference of two held-out points minus the law's, and its standard deviation: that of
    /// both points and of the prediction (Bishop 2006, eq. 3.59, at the difference of the factors).
    pub fn difference_of(&self, a: &Point, b: &Point) -> (f64, f64) {
        let factors: Vec<f64> = a.factors.iter().zip(&b.factors).map(|(a, b)| a - b).collect();
        let off = a.value - b.value - self.at(&factors);
        let variance = a.std.powi(2) + b.std.powi(2) + self.variance(&factors);
        (off, self.scale * variance.sqrt())
    }

    /// Returns true if the deviation is beyond chance among this number of points.
    pub fn is_stray(&self, p: &Point, points: usize) -> bool {
        let (Ok(student), t) = (StudentsT::new(0.0, 1.0, self.dof), self.t(p)) else { return false };
        // statrs panics at the tail of NaN.
        !t.is_nan() && 2.0 * student.sf(t) * (points.max(1) as f64) < FALSE_STRAY_PROBABILITY
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    fn points(seed: u32, n: usize) -> Vec<Point> {
        let at = |i: usize| {
            let x = i as f64 / (n - 1) as f64;
            let z = PixelRng::new(7, Stream::Frame, i as u64, seed, 0).normal();
            Point { factors: vec![1.0, x, x * x], value: 2.0 + x + 0.05 * x * x + 0.004 * z, std: 0.002 }
        };
        (0..n).map(at).collect()
    }

    const PRIORS: [f64; 3] = [1e3, 10.0, 0.1];

    /// No stray in 2000 campaigns: the stated probability is 1e-4 each.
    #[test]
    fn chance_makes_no_stray() {
        let false_ones = (0..2000).filter(|s| {
            let points = points(*s, 6 + *s as usize % 20);
            !Law::fit(&points, &PRIORS, 3).unwrap().out.is_empty()
        });
        assert!(false_ones.count() <= 3);
    }

    /// RMS of the difference of two held-out points, in its standard deviations, over 4000 campaigns of 16
    /// points at their nominal scatter: 1.05, for Student's t with 13 degrees of freedom and a scale known
    /// like 3 more. The tolerance is four standard errors.
    #[test]
    fn a_difference_of_held_out_points_has_its_error() {
        for (a, b) in [(0.3, 0.3), (0.2, 0.9)] {
            let at = |x: f64, seed: u64, i: u64| {
                let z = PixelRng::new(seed, Stream::Frame, i, 5, 0).normal();
                Point { factors: vec![1.0, x, x * x], value: 2.0 + x + 0.05 * x * x + 0.002 * z, std: 0.002 }
            };
            let square = |seed: u64| {
                let fitted: Vec<Point> = (0..16).map(|i| at(i as f64 / 15.0, seed, i)).collect();
                let law = Law::fit(&fitted, &PRIORS, 0).unwrap();
                let (off, std) = law.difference_of(&at(a, seed, 16), &at(b, seed, 17));
                (off / std).powi(2)
            };
            let rms = ((0..4000).map(square).sum::<f64>() / 4000.0).sqrt();
            assert!((rms - 1.05).abs() < 0.05, "{a} {b}: {rms}");
        }
    }

    /// NaN and infinite values are not strays and cause no panic.
    #[test]
    fn nan_is_no_stray() {
        for value in [f64::NAN, f64::NEG_INFINITY] {
            let mut points = points(1, 8);
            points[3].value = value;
            assert!(Law::fit(&points, &PRIORS, 3).is_none_or(|law| law.out.is_empty()));
        }
    }

    /// One or two points off by 5 %, anywhere: twenty times their scatter of 0.4 % with the error of the
    /// prediction at the ends.
    #[test]
    fn strays_are_found_wherever_they_are() {
        for seed in 0..40 {
            let n = 12;
            let mut one = points(seed, n);
            let at = seed as usize % n;
            one[at].value += 0.1;
            assert_eq!(Law::fit(&one, &PRIORS, 3).unwrap().out, [at], "seed {seed}");
            let other = (at + 5) % n;
            one[other].value -= 0.15;
            let mut both = vec![at, other];
            both.sort_unstable();
            assert_eq!(Law::fit(&one, &PRIORS, 3).unwrap().out, both, "seed {seed}");
        }
    }
}
