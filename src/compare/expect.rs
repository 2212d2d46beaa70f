//! What a prediction says of an observable, in the space in which its noise is normal.

use super::global::occupancy_of;
use super::observe::{Observable, Observations, Statistic};
use crate::dataset::Kind;
use radcam_sim::predict::{Prediction, SetPrediction, Spectrum};

/// An expectation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Predicted value in the observable's own unit.
    pub value: f64,
    /// Standard error in the observable's own unit.
    pub std_err: f64,
    /// Measured, predicted and deviation in the space in which the noise is normal.
    pub normal: (f64, f64, f64),
}

impl Expected {
    /// Standardised residual.
    pub fn z(&self) -> f64 {
        (self.normal.0 - self.normal.1) / self.normal.2
    }
}

/// What taking off the mean over `n` frames leaves of the variance of noise that remembers.
fn left(memory: &[f64], n: f64) -> f64 {
    let lost: f64 = memory.iter().enumerate().map(|(k, r)| (n - (k + 1) as f64).max(0.0) * r).sum();
    1.0 - 2.0 * lost / (n * (n - 1.0))
}

/// Mean product of successive residuals over the variance, for noise with these correlations.
fn product(memory: &[f64], n: usize) -> f64 {
    let rho = |k: usize| if k == 0 { 1.0 } else { memory.get(k - 1).copied().unwrap_or(0.0) };
    let all = |f: usize| (0..n).map(|g| rho(f.abs_diff(g))).sum::<f64>() / n as f64;
    let whole = (0..n).map(all).sum::<f64>() / n as f64;
    let each: f64 = (0..n - 1).map(|f| rho(1) - all(f) - all(f + 1) + whole).sum();
    each / (n - 1) as f64
}

/// The part of the noise of single pixels that a frame's mean takes with it.
fn of_frame(s: &SetPrediction, o: &Observable, shape: (usize, usize)) -> f64 {
    (s.shot.of_mean() + s.read.of_mean()) / o.pixels + s.row / shape.0 as f64 + s.column / shape.1 as f64
}

/// Noise power without horizontal (axis 1) or vertical (axis 0) variation: what a line's mean over `n` pixels has.
fn along(p: &Spectrum, axis: usize) -> f64 {
    let grid = radcam_sim::predict::GRID;
    (0..grid).map(|i| p.0[if axis == 1 { i * grid } else { i }]).sum::<f64>() / grid as f64
}

/// Share of a line's variance that is left in means over n pixels with a phase step.
fn line_mean(phase: f64, n: f64) -> f64 {
    let half = (0.5 * phase).sin();
    if half.abs() < 1e-9 { 1.0 } else { ((0.5 * phase * n).sin() / (n * half)).powi(2) }
}

/// What quantisation in steps of q may do to mean and variance beyond what is predicted for pixels of normal levels, where the noise
/// and these levels together are narrower than about half a step, DN and DN^2: a quarter of the first terms of the characteristic
/// function (Widrow and Kollar 2008, ch. 4 and app. B).
fn quantised(variance: f64, spread: f64, q: f64) -> (f64, f64) {
    let noise = (variance - q * q / 12.0).max(1e-3 * q * q);
    let ripple = 0.25 * (-2.0 * std::f64::consts::PI.powi(2) * (noise + spread * spread) / (q * q)).exp();
    (q / std::f64::consts::PI * ripple, (q * q / std::f64::consts::PI.powi(2) + 4.0 * noise) * ripple)
}

/// Spatial variance of the dark charge of a dark set, DN^2: what it has beyond the shortest darks'.
fn dark_spread(o: &Observable, all: &Observations) -> f64 {
    let darks = || all.campaign.sets.iter().zip(&all.kinds).filter(|(_, kind)| **kind == Kind::Dark);
    let Some(here) = o.set.filter(|s| all.kinds.get(*s) == Some(&Kind::Dark)) else { return 0.0 };
    let shortest = darks().min_by(|a, b| a.0.exposure_s.total_cmp(&b.0.exposure_s));
    let offset = shortest.map_or(0.0, |(s, _)| s.spread_dn);
    (all.campaign.sets[here].spread_dn.powi(2) - offset * offset).max(0.0)
}

/// What the prediction expects of an observable.
pub fn expect(o: &Observable, p: &Prediction, all: &Observations) -> Expected {
    let shape = all.campaign.shape;
    let plain = |value: f64, std_err: f64| Expected {
        value,
        std_err,
        normal: (o.measured.value, value, std_err.max(1e-12)),
    };
    // A variance from few samples: its cube root is normal (Wilson and Hilferty 1931).
    let few = |value: f64, dof: f64| {
        let value = value.max(1e-12);
        let c = 2.0 / (9.0 * dof);
        let root = value.cbrt();
        Expected {
            value,
            std_err: value * (2.0 / dof).sqrt(),
            normal: (o.measured.value.max(0.0).cbrt(), (1.0 - c) * root, c.sqrt() * root),
        }
    };
    // Where the noise covers few codes their widths are in it: not an equation but a bound on what is not predicted, gone where the
    // noise covers many.
    let widths = 0.5 * p.bit_errors_dn.iter().map(|e| e * e).sum::<f64>();
    let rough = |s: &SetPrediction| {
        let spread = o.set.and_then(|i| all.campaign.sets.get(i)).map_or(0.0, |s| s.spread_dn);
        let noise = s.covariance(0, 0);
        let (mean, variance) = quantised(noise, spread, p.code_step_dn);
        (mean, if widths > 0.0 { variance.hypot(widths * (-0.02 * noise).exp()) } else { variance })
    };
    let Some(s) = o.set.and_then(|i| p.sets.get(i)) else {
        let (step, half) = (p.code_step_dn, usize::from(o.half.min(1)));
        let width = |c: u32| {
            if step > 1.0 {
                let step = step.round().max(1.0) as u32;
                return if c.is_multiple_of(step) { f64::from(step) } else { 0.0 };
            }
            let volt = |c: u32| {
                let errors = p.bit_errors_dn.iter().enumerate();
                f64::from(c) + errors.map(|(b, e)| if c >> b & 1 == 1 { *e } else { 0.0 }).sum::<f64>()
            };
            (volt(c + 1) - volt(c)).max(0.0)
        };
        return match o.kind {
            Statistic::Tap(parts, k) => {
                let tap = p.taps.get(parts).copied().unwrap_or_default();
                plain(if k == 0 { tap.0 } else { tap.1 }, o.measured.std_err)
            }
            // Codes of equal widths.
            Statistic::Occupancy(_) if widths == 0.0 && step <= 1.0 => plain(0.0, o.measured.std_err),
            Statistic::Occupancy(b) => plain(occupancy_of(&width, &all.codes[half], b), o.measured.std_err),
            Statistic::CodesUsed => plain(if step > 1.0 { 1.0 / step } else { 1.0 }, o.measured.std_err),
            Statistic::Line => {
                let line: f64 = p.sets.first().map_or(0.0, |s| s.lines.iter().map(|l| l.0).sum());
                plain(line, o.measured.std_err)
            }
            Statistic::Leak(way) => {
                let leak = all.scenes[half].as_ref().map_or(0.0, |s| s.expected(way, p));
                // A patch with shading spills here more and there less than its mean does.
                plain(leak, o.measured.std_err.hypot(0.01 * leak))
            }
            Statistic::Light(level) => {
                let per = |l: usize| {
                    let flux = p.base.flux_e_per_s.get(l).copied().unwrap_or(1.0);
                    let light =
                        all.campaign.sets.iter().find(|s| s.light == Some(l)).map_or(1.0, |s| s.illumination);
                    (flux / light).max(1e-300)
                };
                plain((per(level) / per(reference_level(all))).ln(), o.measured.std_err)
            }
            _ => plain(0.0, o.measured.std_err.max(1.0)),
        };
    };
    let (first, end) = o.frames;
    let frames = p.frame_signal.get(first..end).unwrap_or(&[]);
    let n = frames.len().max(1) as f64;
    let mean = frames.iter().sum::<f64>() / n;
    let of_mean = of_frame(s, o, shape);
    let frame_mean_var = of_mean + s.common;
    let (shot_left, read_left) =
        if n > 1.5 { (left(&s.shot_memory, n), left(&s.read_memory, n)) } else { (1.0, 1.0) };
    let lag = |dy: i32, dx: i32| {
        let lost =
            |power: &Spectrum, left: f64| if left == 1.0 { 0.0 } else { (1.0 - left) * power.lag(dy, dx) };
        s.covariance(dy, dx) - lost(&s.shot, shot_left) - lost(&s.read, read_left) - of_mean
    };
    // While the level moves within a chunk, shading and fixed pattern move with it, pixel by pixel: how much of that neighbours share
    // is not known, and is in the error.
    let spread = all.campaign.sets.iter().map(|s| s.spread).fold(0.0, f64::max);
    let dof = (n - 1.0).max(1.0);
    let moved = frames.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / dof;
    let moving = spread * spread * moved;
    // Noise of whole rows and columns: there are few of them, and a mean product of n normal pairs has the error s^2 / root n (twice
    // that square for a product with itself).
    let shared = |dy: i32, dx: i32| {
        let of = |own: f64, count: usize, same: bool| {
            own * ((1.0 + f64::from(u8::from(same))) / count as f64 / dof).sqrt()
        };
        of(s.row, shape.0, dy == 0).hypot(of(s.column, shape.1, dx == 0))
    };
    // A line has one phase a frame: what few frames show of it scatters (random walk of n phases).
    let walk = 1.0 / (n * (n - 1.0)).max(1.0).sqrt();
    let lines = |dy: i32, dx: i32| -> f64 {
        let of = |&(v, px, py): &(f64, f64, f64)| v * (px * f64::from(dx) + py * f64::from(dy)).cos();
        walk * s.lines.iter().map(of).sum::<f64>().abs()
    };
    match o.kind {
        Statistic::Mean if all.means_given => plain(mean, (s.covariance(0, 0) / o.pixels).sqrt()),
        Statistic::Mean => {
            // Noise that remembers averages out less.
            let memory = s.shot_memory.first().copied().unwrap_or(0.0).max(0.0);
            plain(
                mean,
                (frame_mean_var * (1.0 + 2.0 * memory) / n)
                    .sqrt()
                    .hypot(0.002)
                    .hypot(rough(s).0)
                    .hypot(s.unsure_mean),
            )
        }
        // The frames of both run from the first of the set.
        Statistic::Settling(k) => {
            let rest = frames.get(k + 1..).unwrap_or(&[]);
            let m = rest.len().max(1) as f64;
            let expected = frames.get(k).copied().unwrap_or(0.0) - rest.iter().sum::<f64>() / m;
            plain(expected, (frame_mean_var * (1.0 + 1.0 / m)).sqrt().hypot(0.002))
        }
        Statistic::FrameMeanVariance => few(frame_mean_var + moved + 1e-7, dof),
        Statistic::Variance => plain(
            lag(0, 0) + moving,
            o.measured
                .std_err
                .hypot(rough(s).1)
                .hypot(s.unsure_var)
                .hypot(lines(0, 0))
                .hypot(moving)
                .hypot(shared(0, 0)),
        ),
        Statistic::Covariance(dy, dx) => plain(
            lag(dy, dx),
            o.measured.std_err.hypot(s.unsure_var).hypot(lines(dy, dx)).hypot(moving).hypot(shared(dy, dx)),
        ),
        Statistic::RowVariance | Statistic::ColumnVariance => {
            let rows = o.kind == Statistic::RowVariance;
            let (axis, width, count, own) =
                if rows { (1, shape.1, shape.0, s.row) } else { (0, shape.0, shape.1, s.column) };
            let of_lines =
                s.lines.iter().map(|&(v, px, py)| v * line_mean(if rows { px } else { py }, width as f64));
            let of_lines: f64 = of_lines.sum();
            let pixels = (along(&s.shot, axis) * shot_left + along(&s.read, axis) * read_left) / width as f64;
            // Of noise across the lines each holds the mean, which the frame's mean takes with it.
            let across = if rows { s.column / shape.1 as f64 } else { s.row / shape.0 as f64 };
            let value = pixels + own + across + of_lines - of_mean;
            let dof = dof * (count as f64 - 1.0);
            let rest = (walk * of_lines).hypot(moving).hypot(rough(s).1.hypot(s.unsure_var) / width as f64);
            plain(value, (value.abs().max(1e-9) * (2.0 / dof).sqrt()).hypot(rest))
        }
        Statistic::Successive => {
            let f = frames.len().max(2);
            // Of the mean product, and of the variance that is left over the frames: nothing where frames are independent.
            let carried = |power: &Spectrum, memory: &[f64], left: f64| {
                power.lag(0, 0) * (product(memory, f) + left / f as f64)
            };
            let value =
                carried(&s.shot, &s.shot_memory, shot_left) + carried(&s.read, &s.read_memory, read_left);
            plain(
                value,
                o.measured
                    .std_err
                    .hypot(0.5 * rough(s).1)
                    .hypot(lines(0, 0))
                    .hypot(moving)
                    .hypot(shared(1, 1)),
            )
        }
        Statistic::Unequal => {
            // The variance of a sample variance has the fourth cumulant over the frames in it (Cramer 1946, 27.4).
            let allowed = 1.0 + 2.0 / dof;
            let variance = s.covariance(0, 0).max(1e-9);
            let rest = rough(s).1.hypot(moving) / variance;
            let square = variance * variance;
            // Shot noise of unequal dark charge: only pixels that stand out are known to have more of it.
            let charge = dark_spread(o, all) * p.base.gain_dn_per_e.powi(2);
            plain(
                (s.unequal + s.fourth / (n * allowed)) / square,
                o.measured.std_err.hypot((s.unsure + charge) / square).hypot(0.002).hypot(rest),
            )
        }
        Statistic::Parity(k) => {
            let parity = if k == 0 { s.parity.0 } else { s.parity.1 };
            plain(parity, o.measured.std_err.hypot(moving).hypot(2.0 * shared(1, 1)))
        }
        Statistic::Growth(k) => {
            let growth = if k == 0 { s.growth.0 } else { s.growth.1 };
            plain(0.5 * growth * s.shot.lag(0, 0), o.measured.std_err.hypot(moving).hypot(2.0 * shared(1, 1)))
        }
        _ => plain(0.0, o.measured.std_err.max(1.0)),
    }
}

/// The light level that the others are counted from.
pub fn reference_level(all: &Observations) -> usize {
    let sets = all.campaign.sets.iter().zip(&all.kinds).filter(|(_, kind)| **kind == Kind::Flat);
    let near =
        sets.min_by(|(a, _), (b, _)| (a.illumination - 1.0).abs().total_cmp(&(b.illumination - 1.0).abs()));
    near.and_then(|(s, _)| s.light).unwrap_or(0)
}
