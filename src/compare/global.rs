//! Observables of a whole campaign: code occupancy, spectrum, the step between taps, scenes.

use super::observe::Statistic;
use crate::dataset::{FrameRow, Kind};
use crate::statistics::residual::{Residual, Value};
use ndarray::Array2;
use radcam_sim::predict::BITS;

/// Mean of some frames, DN.
pub fn mean_image(images: &[Array2<u16>]) -> Array2<f32> {
    let mut mean = Array2::<f32>::zeros(images.first().map_or((0, 0), |f| f.dim()));
    images.iter().for_each(|f| mean.zip_mut_with(f, |m, &d| *m += f32::from(d)));
    mean / images.len().max(1) as f32
}

/// Mean of the pixels that count, DN.
pub fn mean_used(frame: &Array2<u16>, used: &Array2<bool>) -> f64 {
    mean_of(&frame.mapv(f32::from), used)
}

/// Mean of the pixels that count, DN.
pub fn mean_of(image: &Array2<f32>, used: &Array2<bool>) -> f64 {
    let marked = image.iter().zip(used).filter(|(_, u)| **u);
    let (sum, n) = marked.fold((0.0, 0.0), |(s, n), (v, _)| (s + f64::from(*v), n + 1.0));
    sum / f64::max(n, 1.0)
}

/// Growth of variance with the mean between the dimmest and the brightest set, DN: enough to weigh pixels.
pub fn rough_gain(read: &[Vec<Array2<u16>>], used: &Array2<bool>) -> f64 {
    let mut ends: Option<((f64, f64), (f64, f64))> = None;
    for pair in read.iter().filter(|r| r.len() >= 2) {
        let (mut n, mut sum, mut diff, mut square) = (0.0, 0.0, 0.0, 0.0);
        for ((&a, &b), _) in pair[0].iter().zip(&pair[1]).zip(used).filter(|(_, u)| **u) {
            let (a, b) = (f64::from(a), f64::from(b));
            (n, sum, diff, square) = (n + 1.0, sum + a + b, diff + a - b, square + (a - b) * (a - b));
        }
        let point = (0.5 * sum / n, 0.5 * (square / n - (diff / n) * (diff / n)));
        let (low, high) = ends.unwrap_or((point, point));
        ends = Some((if point.0 < low.0 { point } else { low }, if point.1 > high.1 { point } else { high }));
    }
    match ends {
        Some((low, high)) if high.0 > low.0 + 1.0 => ((high.1 - low.1) / (high.0 - low.0)).max(0.0),
        _ => 0.0,
    }
}

/// Spatial deviation over the mean above zero.
pub fn spread(mean_dn: &Array2<f32>, used: &Array2<bool>, zero: f64) -> f64 {
    let values = || mean_dn.iter().zip(used).filter(|(_, u)| **u).map(|(m, _)| f64::from(*m) - zero);
    let n = values().count() as f64;
    let mean = values().sum::<f64>() / n;
    let var = values().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    if mean > 5.0 { (var.sqrt() / mean).min(0.3) } else { 0.0 }
}

/// The step between the middle columns over all chunks: slope with the mean, and at zero; errors from what all other columns
/// show.
pub fn middle_step(means: &[&Array2<f32>], used: &Array2<bool>, zero: f64) -> Option<[Value; 2]> {
    let columns = used.ncols();
    if columns < 64 || means.is_empty() {
        return None;
    }
    let reach = 4;
    // Column means of each chunk, and its level.
    let profiles: Vec<(f64, Vec<f64>)> = means
        .iter()
        .map(|m| {
            let column = |x: usize| {
                let values = m.column(x);
                let marked = values.iter().zip(used.column(x)).filter(|(_, u)| **u);
                let (s, n) = marked.fold((0.0, 0.0), |(s, n), (v, _)| (s + f64::from(*v), n + 1.0));
                s / f64::max(n, 1.0)
            };
            let profile: Vec<f64> = (0..columns).map(column).collect();
            (profile.iter().sum::<f64>() / columns as f64 - zero, profile)
        })
        .collect();
    let step = |profile: &[f64], x: usize| {
        let part = |from: usize| profile[from..from + reach].iter().sum::<f64>() / reach as f64;
        let (l2, l1, r1, r2) = (part(x - 2 * reach), part(x - reach), part(x), part(x + reach));
        (r1 - l1) - 0.5 * ((r2 - r1) + (l1 - l2))
    };
    let line = |x: usize| {
        let n = profiles.len() as f64;
        let points = || profiles.iter().map(|(m, p)| (*m, step(p, x)));
        let (sx, sy) = points().fold((0.0, 0.0), |(a, b), (m, s)| (a + m, b + s));
        let (mx, my) = (sx / n, sy / n);
        let (xx, xy) =
            points().fold((0.0, 0.0), |(a, b), (m, s)| (a + (m - mx).powi(2), b + (m - mx) * (s - my)));
        let slope = if xx > 0.0 { xy / xx } else { 0.0 };
        (slope, my - slope * mx)
    };
    let middle = columns / 2;
    let others: Vec<(f64, f64)> =
        (2 * reach..=columns - 2 * reach).filter(|x| x.abs_diff(middle) > 2 * reach).map(line).collect();
    let here = line(middle);
    let rms = |of: &dyn Fn(&(f64, f64)) -> f64| {
        (others.iter().map(|o| of(o).powi(2)).sum::<f64>() / others.len() as f64).sqrt().max(1e-9)
    };
    Some([Value { value: here.0, std_err: rms(&|o| o.0) }, Value { value: here.1, std_err: rms(&|o| o.1) }])
}

/// Counts of every code, and what each level alone says of the bits.
pub struct Histogram {
    counts: Vec<u64>,
    /// For each level and bit: mean excess of the one kind of codes over the other, and its variance.
    levels: Vec<[(f64, f64); BITS]>,
}

/// Deviation of the noise from which a level's histogram is smooth over a few codes, DN^2.
const WIDE_DN2: f64 = 36.0;

/// Occupancy of bit `b` expected of a converter with these widths, as [`Histogram::finish`] measures it.
pub fn occupancy_of(widths: &dyn Fn(u32) -> f64, codes: &std::ops::Range<u32>, b: usize) -> f64 {
    let (first, second) = ((1u32 << b) - 1, (1u32 << (b + 1)) - 1);
    let bend = |c: u32| widths(c) - 0.5 * (widths(c - 1) + widths(c + 1));
    let mean = |residue: u32| {
        let all: Vec<f64> =
            codes.clone().filter(|c| *c > 0 && c & second == residue).take(256).map(bend).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    };
    mean(first) - mean(second)
}

impl Histogram {
    /// For codes up to a full scale.
    pub fn new(full: u16) -> Self {
        Self { counts: vec![0; usize::from(full) + 1], levels: Vec::new() }
    }

    /// Adds the frames of one level with noise of this variance. Narrow levels say nothing: their histogram is all slope.
    pub fn add(&mut self, frames: &[Array2<u16>], var_dn2: f64) {
        if var_dn2 < WIDE_DN2 {
            return;
        }
        let mut n = vec![0u64; self.counts.len()];
        let last = n.len() - 1;
        frames.iter().flat_map(|f| f.iter()).for_each(|&d| n[usize::from(d).min(last)] += 1);
        self.counts.iter_mut().zip(&n).for_each(|(a, b)| *a += b);
        let mut bits = [(0.0, f64::INFINITY); BITS];
        for (b, out) in bits.iter_mut().enumerate() {
            let (first, second) = ((1usize << b) - 1, (1usize << (b + 1)) - 1);
            let (mut value, mut var) = (0.0, 0.0);
            for (residue, sign) in [(first, 1.0), (second, -1.0)] {
                let (mut bend, mut all, mut squares) = (0.0, 0.0, 0.0);
                for c in (1..last).filter(|c| c & second == residue) {
                    let level = (n[c - 1] + 2 * n[c] + n[c + 1]) as f64 / 4.0;
                    if level < 20.0 {
                        continue;
                    }
                    bend += n[c] as f64 - 0.5 * (n[c - 1] + n[c + 1]) as f64;
                    squares += n[c] as f64 + 0.25 * (n[c - 1] + n[c + 1]) as f64;
                    all += level;
                }
                value += sign * bend / all.max(1.0);
                var += if all > 0.0 { squares / (all * all) } else { f64::INFINITY };
            }
            *out = (value, var);
        }
        self.levels.push(bits);
    }

    /// The range of filled codes, and what they say.
    pub fn finish(self) -> (std::ops::Range<u32>, Vec<(Statistic, Value)>) {
        let n = &self.counts;
        let mut out = Vec::new();
        let wide = |c: usize| n[c.saturating_sub(8)..(c + 9).min(n.len())].iter().sum::<u64>();
        let filled: Vec<usize> = (1..n.len().saturating_sub(1)).filter(|c| wide(*c) > 1700).collect();
        if filled.len() < 32 {
            return (0..0, out);
        }
        let used = filled.iter().filter(|c| n[**c] > 0).count() as f64;
        out.push((Statistic::CodesUsed, Value { value: used / filled.len() as f64, std_err: 0.02 }));
        for b in 0..BITS {
            let sound: Vec<(f64, f64)> =
                self.levels.iter().map(|l| l[b]).filter(|(_, var)| var.is_finite() && *var > 0.0).collect();
            let weight: f64 = sound.iter().map(|(_, var)| 1.0 / var).sum();
            if sound.len() < 4 {
                continue;
            }
            let value = sound.iter().map(|(v, var)| v / var).sum::<f64>() / weight;
            // Pixels stay where they are from frame to frame: levels scatter more than their counts.
            let chi2 = sound.iter().map(|(v, var)| (v - value).powi(2) / var).sum::<f64>()
                / (sound.len() - 1) as f64;
            out.push((
                Statistic::Occupancy(b),
                Value { value, std_err: (chi2.max(1.0) / weight).sqrt().hypot(2e-4) },
            ));
        }
        (filled[0] as u32..filled[filled.len() - 1] as u32, out)
    }
}

/// The power spectrum of the noise in read-out order, summed over chunks.
pub struct LineSearch {
    length: usize,
    power: Vec<f64>,
    weight: f64,
    var_dn2: f64,
    samples: f64,
}

impl LineSearch {
    /// For frames of this shape.
    pub fn new(shape: (usize, usize)) -> Self {
        let length = (shape.0 * shape.1).min(1 << 16);
        Self { length, power: vec![0.0; length / 2 + 1], weight: 0.0, var_dn2: 0.0, samples: 0.0 }
    }

    /// Adds the frames of a chunk; their rows' means are taken off, so that row noise is no line.
    pub fn add(&mut self, frames: &[Array2<u16>], r: &Residual) {
        if self.length < 1024 || r.var.value <= 0.0 {
            return;
        }
        let mut planner = rustfft::FftPlanner::<f32>::new();
        let fft = planner.plan_fft_forward(self.length);
        for frame in frames {
            let reach = 6.0 * r.var.value.sqrt() as f32;
            let mut off = ndarray::Zip::from(frame)
                .and(&r.mean_dn)
                .map_collect(|&d, &m| (f32::from(d) - m).clamp(-reach, reach));
            // What whole rows and columns share is no line.
            for axis in [1, 0] {
                if let Some(mean) = off.mean_axis(ndarray::Axis(axis)) {
                    off -= &mean.insert_axis(ndarray::Axis(axis));
                }
            }
            let mut line: Vec<_> =
                off.iter().take(self.length).map(|v| rustfft::num_complex::Complex::new(*v, 0.0)).collect();
            line.resize(self.length, rustfft::num_complex::Complex::new(0.0, 0.0));
            // Hann's window keeps a line within a few bins; its mean square is 3/8.
            let turn = std::f32::consts::TAU / self.length as f32;
            line.iter_mut().enumerate().for_each(|(n, v)| *v *= 0.5 - 0.5 * (turn * n as f32).cos());
            fft.process(&mut line);
            // Weighted by the noise: quiet sets see a line best.
            let w = 1.0 / r.var.value;
            // The mean over the frames took its share of the power with it.
            let up = r.frames as f64 / (r.frames as f64 - 1.0);
            for (p, v) in self.power.iter_mut().zip(&line) {
                *p += up * w * f64::from(v.norm_sqr()) / (0.375 * self.length as f64);
            }
            self.weight += w;
            self.var_dn2 += 1.0;
            self.samples += 1.0;
        }
    }

    /// Frequency (cycles per pixel) and variance of the strongest line, where it is no accident.
    pub fn strongest(&self) -> Option<(f64, Value)> {
        if self.samples < 2.0 {
            return None;
        }
        let n = self.power.len();
        let local = |i: usize| {
            let around: Vec<f64> = (i.saturating_sub(60)..(i + 61).min(n))
                .filter(|j| j.abs_diff(i) > 4)
                .map(|j| self.power[j])
                .collect();
            median(&around)
        };
        let from = 64.min(n / 8);
        let top = (from..n - 2).max_by(|&a, &b| self.power[a].total_cmp(&self.power[b]))?;
        let floor = local(top);
        // A sum of exponentials: relative deviation 1 / root of the frames. Ten deviations and a third more are no accident
        // among 10^5 frequencies.
        let ratio = self.power[top] / floor;
        let deviation = 1.0 / self.samples.sqrt();
        if ratio - 1.0 < (10.0 * deviation).max(0.3) {
            return None;
        }
        // Between two bins the line's power is shared: a parabola through the logarithms finds its place.
        let log = |i: usize| self.power[i].max(f64::MIN_POSITIVE).ln();
        let (a, b, c) = (log(top - 1), log(top), log(top + 1));
        let shift = (0.5 * (a - c) / (a - 2.0 * b + c)).clamp(-0.5, 0.5);
        let frequency = (top as f64 + if shift.is_finite() { shift } else { 0.0 }) / self.length as f64;
        let excess: f64 = (top - 3..=top + 3).map(|i| (self.power[i.min(n - 1)] - floor).max(0.0)).sum();
        // Power at one frequency of a sine of variance v is v N / 2 (the other half lies at minus it).
        let variance = excess / self.weight * 2.0 / self.length as f64;
        let error = floor * 7f64.sqrt() * deviation / self.weight * 2.0 / self.length as f64;
        Some((frequency, Value { value: variance, std_err: error.hypot(0.1 * variance) }))
    }
}

fn median(values: &[f64]) -> f64 {
    crate::calibrate::pattern::median(values, &mut Vec::new())
}

/// A still scene at two exposures.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePair {
    /// Columns through the patch against the rest of the background: the short exposure scaled up less the long one, DN.
    pub columns: Value,
    /// The same combination of the light of the columns (mean of each column), DN per second at the long exposure.
    pub column_light_dn_per_s: f64,
    /// Long over short exposure.
    pub ratio: f64,
}

impl ScenePair {
    /// From the mean images of scenes, the longest and the shortest of equal light.
    pub fn of(
        means: &[(usize, Array2<f32>)],
        settings: &[FrameRow],
        zero: f64,
        used: &Array2<bool>,
    ) -> Option<Self> {
        let scenes: Vec<_> = means.iter().filter(|(i, _)| settings[*i].kind == Kind::Scene).collect();
        let by = |(i, _): &&&(usize, Array2<f32>)| settings[*i].exposure_s;
        let long = scenes.iter().max_by(|a, b| by(a).total_cmp(&by(b)))?;
        let same = |s: &&&(usize, Array2<f32>)| settings[s.0].illumination == settings[long.0].illumination;
        let short = scenes.iter().filter(same).min_by(|a, b| by(a).total_cmp(&by(b)))?;
        let (t_long, t_short) = (settings[long.0].exposure_s, settings[short.0].exposure_s);
        let ratio = t_long / t_short;
        if ratio < 1.5 {
            return None;
        }
        let image = long.1.mapv(|v| f64::from(v) - zero);
        let top = image.iter().copied().fold(f64::MIN, f64::max);
        let bright = image.mapv(|v| v > 0.5 * top);
        let (rows, columns) = image.dim();
        let through: Vec<bool> = (0..columns).map(|x| bright.column(x).iter().any(|b| *b)).collect();
        let level: Vec<bool> = (0..rows).map(|y| bright.row(y).iter().any(|b| *b)).collect();
        let scaled = short.1.mapv(|v| f64::from(v) - zero) * ratio - &image;
        // Rows clear of the patch.
        let part = |wanted: bool| {
            let values: Vec<f64> = scaled
                .indexed_iter()
                .filter(|((y, x), _)| !level[*y] && through[*x] == wanted && used[(*y, *x)])
                .map(|(_, v)| *v)
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
            (n >= 50.0).then_some((mean, var / n))
        };
        let (a, b) = (part(true)?, part(false)?);
        let light = |wanted: bool| {
            let all: Vec<f64> = (0..columns)
                .filter(|x| through[*x] == wanted)
                .map(|x| image.column(x).sum() / rows as f64)
                .collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        Some(Self {
            columns: Value { value: a.0 - b.0, std_err: (a.1 + b.1).sqrt() },
            column_light_dn_per_s: (light(true) - light(false)) / t_long,
            ratio,
        })
    }
}
