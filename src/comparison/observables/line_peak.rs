//! Strongest peak of the spectrum of line means, over all frames of a campaign. A ripple down the rows or a
//! stripe pattern of the columns, far weaker than the noise of one frame, stands out of the sum over
//! hundreds. Away from the peak a spectrum is smooth, whatever filters and crosstalk there are, so the power
//! beside the peak is subtracted.

use super::campaign::is_quiet;
use super::read::Chunk;
use super::row_spectrum::{PADDED, refined};
use super::{Expected, Half, Observable, Put, View};
use crate::dataset::{FrameRow, Kind};
use crate::statistics::median::median;
use radcam_sim::predict::{Ripple, SHAPES, SetPrediction, cosine_power};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Bins beside a peak, on either side, that give the spectrum without it: 1.5 to 5 cycles over all lines
/// away.
const BESIDE: std::ops::RangeInclusive<usize> = 6..=20;
/// Lowest of these bins: two cycles over all lines.
const LOWEST: usize = 2 * PADDED;
/// Slowest ripple searched, in cycles over all lines: fields that tilt and breathe lie below it (a named
/// choice).
const SLOWEST: usize = 3;
/// Maximum chance that noise has such a peak anywhere in a spectrum (a named choice: four sums of spectra a
/// campaign give one false peak in twenty-five thousand campaigns).
const CHANCE: f64 = 1e-5;

/// Axis of the lines whose means are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Means of rows.
    Rows,
    /// Means of columns.
    Columns,
}

/// Frames that a value is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    /// Darks.
    Darks,
    /// Flats of the shortest third of the exposures.
    Short,
    /// Flats of the middle third.
    Middle,
    /// Flats of the longest third.
    Long,
}

impl Group {
    const ALL: [Self; 4] = [Self::Darks, Self::Short, Self::Middle, Self::Long];

    fn of(index: usize) -> Self {
        Self::ALL[index.min(3)]
    }

    fn words(self) -> &'static str {
        match self {
            Self::Darks => "darks",
            Self::Short => "flats of short exposures",
            Self::Middle => "flats of middle exposures",
            Self::Long => "flats of long exposures",
        }
    }
}

/// Returns the name of the value of a group. `line`: "row" or "column".
pub(super) fn name(line: &str, index: usize) -> String {
    format!("strongest peak in the spectrum of {line} means, {}", Group::of(index).words())
}

/// Some frames of a set.
#[derive(Debug, Clone, Copy)]
struct Part {
    set: usize,
    half: Half,
    group: Group,
    /// Weight of the power in the sums of the group.
    weight: f64,
    /// Power at the peak in excess of that beside it, DN^2.
    beyond_dn2: f64,
    /// Variance of a line's mean, DN^2: power of white noise.
    noise_dn2: f64,
    frames: f64,
}

impl Part {
    fn dof(&self) -> f64 {
        (self.frames - 1.0).max(1.0)
    }
}

/// Peak that noise does not make.
#[derive(Debug, Clone)]
pub struct Peak {
    axis: Axis,
    origin: Origin,
    /// Bin of the peak; each bin is a quarter of a cycle over all lines.
    bin: usize,
    /// Number of bins.
    bins: usize,
    /// Number of lines.
    lines: usize,
    /// Frequency of the peak between bins, cycles per line.
    pub cycles: f64,
    parts: Vec<Part>,
}

/// Spectrum of some frames of a set.
struct Spectrum<'a> {
    set: usize,
    half: Half,
    frames: f64,
    /// Power of each bin over the number of lines: the variance of a line's mean if noise is white, DN^2.
    power: &'a [f64],
    is_dark: bool,
    exposure_s: f64,
    signal_dn: f64,
    noise_dn2: f64,
}

/// Dependence of the amplitude of a ripple, DN, on the settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Origin {
    /// One size in all frames.
    Additive,
    /// In proportion to the signal.
    Light,
    /// In proportion to the light, whatever the exposure: whole periods of a lamp's ripple cancel, so that
    /// what is left under exposures of many periods is that of a part of one.
    Lamp,
}

impl Origin {
    const ALL: [Self; 3] = [Self::Additive, Self::Light, Self::Lamp];

    /// Returns the weight of a spectrum's power in the sum of all.
    fn weight(self, s: &Spectrum<'_>) -> f64 {
        match self {
            Self::Additive => s.noise_dn2.powi(-2),
            _ if s.is_dark => 0.0,
            Self::Light => (s.signal_dn / s.noise_dn2).powi(2),
            Self::Lamp => (s.signal_dn / s.exposure_s.max(f64::MIN_POSITIVE) / s.noise_dn2).powi(2),
        }
    }
}

/// Finds the strongest peak of all frames; `None` if noise alone may have made it. `place`: index of the
/// power of the bins among a chunk's sums.
pub(super) fn find(
    chunks: &[Chunk],
    settings: &[FrameRow],
    zero_dn: f64,
    axis: Axis,
    place: usize,
) -> Option<Peak> {
    let lines_of = |c: &Chunk| match axis {
        Axis::Rows => c.summary.rows_dn.len(),
        Axis::Columns => c.summary.columns_dn.len(),
    };
    let lines = chunks.first().map(lines_of)?;
    let of = chunks.iter().filter_map(|chunk| {
        let (power, frames) = (chunk.summary.extra.get(place)?, chunk.summary.frames as f64);
        let noise_dn2 = noise_of(power, lines, frames);
        let spectrum = Spectrum {
            set: chunk.set,
            half: chunk.half,
            frames,
            power,
            is_dark: settings[chunk.set].kind == Kind::Dark,
            exposure_s: settings[chunk.set].exposure_s,
            signal_dn: (chunk.summary.frame_means.mean_dn() - zero_dn).max(0.0),
            noise_dn2,
        };
        let told = matches!(settings[chunk.set].kind, Kind::Dark | Kind::Flat) && !is_quiet(&chunk.summary);
        (told && noise_dn2 > 0.0 && chunk.summary.frames > 1).then_some(spectrum)
    });
    let all: Vec<Spectrum<'_>> = of.collect();
    let first = PADDED * SLOWEST;
    let bins = all.iter().map(|s| s.power.len()).min()?;
    // Half a cycle per line belongs to odd and even lines.
    let looked_at = first..bins.saturating_sub(PADDED / 2);
    if bins < first + BESIDE.end() {
        return None;
    }
    let sources = if axis == Axis::Rows { Origin::ALL.as_slice() } else { &[Origin::Additive] };
    let of_source = |source: &Origin| {
        let found = strongest(&all, lines, bins, looked_at.clone(), |s| source.weight(s))?;
        Some((*source, found))
    };
    let found = sources.iter().filter_map(of_source).min_by(|a, b| a.1.0.total_cmp(&b.1.0));
    let (origin, (chance, bin, cycles)) = found?;
    tracing::debug!("spectrum of {axis:?}: peak at {cycles:.5} cycles a line, chance {chance:e}, {origin:?}");
    if chance > CHANCE {
        return None;
    }
    let mut exposures: Vec<f64> = all.iter().filter(|s| !s.is_dark).map(|s| s.exposure_s).collect();
    exposures.sort_by(f64::total_cmp);
    let group = |s: &Spectrum<'_>| {
        let shorter = exposures.iter().filter(|t| **t < s.exposure_s).count();
        match 3 * shorter / exposures.len().max(1) {
            _ if s.is_dark => Group::Darks,
            0 => Group::Short,
            1 => Group::Middle,
            _ => Group::Long,
        }
    };
    // A ripple of one size in all frames has the same value in all flats, whatever their weights.
    let of_flats = if axis == Axis::Rows && origin == Origin::Additive { Origin::Light } else { origin };
    let part = |s: &Spectrum<'_>| Part {
        set: s.set,
        half: s.half,
        group: group(s),
        weight: (s.frames - 1.0) * if s.is_dark { Origin::Additive.weight(s) } else { of_flats.weight(s) },
        beyond_dn2: (s.power[bin] - mean_beside(bin, bins, |k| s.power[k])) / lines as f64,
        noise_dn2: s.noise_dn2,
        frames: s.frames,
    };
    Some(Peak { axis, origin, bin, bins, lines, cycles, parts: all.iter().map(part).collect() })
}

/// Returns the variance of a line's mean without peaks, DN^2, from the median of the bins. With a peak in it,
/// frames with similar phases would have the largest weight, and they show least of the peak.
fn noise_of(power: &[f64], lines: usize, frames: f64) -> f64 {
    // The power of noise over n frames follows chi^2 with 2 (n - 1) degrees of freedom; its median is by
    // Wilson and Hilferty 1931.
    let of_median = (1.0 - 1.0 / (9.0 * (frames - 1.0).max(1.0))).powi(3);
    median(power.iter().skip(LOWEST).copied()) / (lines as f64 * of_median)
}

/// Returns the bins beside one, for this number of bins.
fn beside(bin: usize, bins: usize) -> impl Iterator<Item = usize> {
    let below = BESIDE.rev().filter_map(move |d| bin.checked_sub(d)).filter(|k| *k >= LOWEST);
    below.chain(BESIDE.map(move |d| bin + d).filter(move |k| *k < bins))
}

/// Returns the number of independent values among the bins beside one: one per cycle over all lines.
fn independent(bin: usize, bins: usize) -> f64 {
    beside(bin, bins).count() as f64 / PADDED as f64
}

/// Returns the mean of the values beside a bin.
fn mean_beside(bin: usize, bins: usize, of: impl Fn(usize) -> f64) -> f64 {
    beside(bin, bins).map(of).sum::<f64>() / beside(bin, bins).count().max(1) as f64
}

/// Finds the bin that stands out most of the weighted sum of all spectra. Returns the chance that noise has
/// such a peak anywhere in it, the bin, and its frequency between bins in cycles per line.
fn strongest(
    all: &[Spectrum<'_>],
    lines: usize,
    bins: usize,
    looked_at: std::ops::Range<usize>,
    weight: impl Fn(&Spectrum<'_>) -> f64,
) -> Option<(f64, usize, f64)> {
    let mut power = vec![0.0; bins];
    // Sum of the weighted noise, and of its squares over the degrees of freedom.
    let (mut sum, mut square) = (0.0, 0.0);
    for s in all {
        let dof = s.frames - 1.0;
        let w = dof * weight(s);
        power.iter_mut().zip(s.power).for_each(|(p, v)| *p += w * v);
        sum += w * s.noise_dn2;
        square += (w * s.noise_dn2).powi(2) / dof;
    }
    let frames = sum * sum / square;
    let ratio = |k: usize| power[k] / mean_beside(k, bins, |k| power[k]);
    let bin = looked_at.clone().max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))?;
    // Power of normal noise is exponential. Sums of it follow chi^2 with two degrees of freedom per frame,
    // and their ratio follows F.
    let law = FisherSnedecor::new(2.0 * frames, 2.0 * independent(bin, bins) * frames).ok()?;
    let tries = looked_at.len() as f64 / 2.0;
    Some((tries * law.sf(ratio(bin)), bin, refined(&power, bin) / (PADDED * lines) as f64))
}

/// Variance of row means by a ripple, in some frames of a set.
pub(super) struct OfRipple {
    pub set: usize,
    pub frames: f64,
    /// Variance and its error by the noise, DN^2.
    pub var_dn2: (f64, f64),
}

impl Peak {
    /// Returns the variance of row means by a ripple of the light, set by set: the power at its frequency
    /// tells it far better than the variance of all rows. `None` for a ripple that does not follow the light.
    pub(super) fn of_ripple(&self) -> Option<Vec<OfRipple>> {
        // At its own frequency a sine of variance 1 has half the power of white noise times the lines.
        let per_power = 2.0 / self.lines as f64;
        let of = |p: &Part| OfRipple {
            set: p.set,
            frames: p.frames,
            var_dn2: (
                per_power * p.beyond_dn2,
                per_power * p.noise_dn2 * ((1.0 + 1.0 / independent(self.bin, self.bins)) / p.dof()).sqrt(),
            ),
        };
        let is_of_light = self.axis == Axis::Rows && self.origin != Origin::Additive;
        is_of_light.then(|| self.parts.iter().map(of).collect())
    }

    /// Puts the values of one half: for each group, the mean power in excess of that beside the peak.
    pub(super) fn put(&self, half: Half, put: &mut Put<'_>) {
        for (index, group) in Group::ALL.into_iter().enumerate() {
            let parts = || self.parts.iter().filter(|p| p.half == half && p.group == group);
            let sum: f64 = parts().map(|p| p.weight).sum();
            if sum > 0.0 {
                let value = parts().map(|p| p.weight * p.beyond_dn2).sum::<f64>() / sum;
                let noise = parts().map(|p| (p.weight * p.noise_dn2).powi(2) / p.dof()).sum::<f64>();
                put.put(index, value, (noise * (1.0 + 1.0 / independent(self.bin, self.bins))).sqrt() / sum);
            }
        }
    }

    /// Returns the predicted power at the peak.
    pub(super) fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let parts = || self.parts.iter().filter(|p| p.half == o.half && p.group == Group::of(o.index));
        let (mut sum, mut value, mut var) = (0.0, 0.0, 0.0);
        let mut known = Vec::new();
        let of_shapes: [f64; SHAPES] = std::array::from_fn(|shape| {
            // A cosine of the whole frame: its mean product with a sine of this turn, times the lines.
            let (halves, lines) = (shape as u32 + 1, self.lines as f64);
            let turn = |bin: usize| std::f64::consts::TAU * bin as f64 / (PADDED as f64 * lines);
            let of = |bin: usize| lines * cosine_power(halves, lines, turn(bin));
            of(self.bin) - mean_beside(self.bin, self.bins, of)
        });
        for p in parts() {
            let Some(s) = view.prediction.sets.get(p.set) else { continue };
            let power = self.beyond_dn2(s, view.all.campaign.shape, &mut known);
            let field = self.field_dn2(s, &of_shapes);
            // The square of one number per frame scatters, and so do its products with the noise.
            let of_field = 2.0 * field * field / p.dof() + (FIELD_SHAPE_ERROR_REL * field).powi(2);
            let with_noise = 4.0 * field.abs() * p.noise_dn2 / p.dof();
            sum += p.weight;
            value += p.weight * (power + field);
            let own = self.beyond_line_variance(p, power.max(0.0));
            var += p.weight * p.weight * (own + of_field + with_noise);
        }
        let sum = f64::max(sum, f64::MIN_POSITIVE);
        Expected::plain(o, value / sum, var.sqrt() / sum)
    }

    /// Returns the variance of a part's value, DN^4, reduced to the information that the variance of line
    /// means of the same frames does not have. Both see one sine with the phases that it had (random walk)
    /// and its products with the noise of its own frequency, so their errors are alike if the sine is strong.
    /// With c the shared variance and a and b those of each alone, the second of two measurements adds to the
    /// first the information 1/V = 1/(c + ab/(a + b)) - 1/(c + a) (Bevington and Robinson 2003, section 4.1).
    fn beyond_line_variance(&self, p: &Part, power: f64) -> f64 {
        let noise = p.noise_dn2;
        let shared = power * power / (p.frames * p.dof()) + 2.0 * power * noise / p.dof();
        let line = noise * noise * self.lines as f64 / (2.0 * p.dof());
        let own = noise * noise * (1.0 + 1.0 / independent(self.bin, self.bins)) / p.dof();
        let both = line * own / (line + own);
        (shared + both) * (shared + line) * (line + own) / (line * line)
    }

    /// Returns the power at the peak in excess of that beside it, DN^2, of the ripples and lines of a set.
    /// `known` holds the power of ripples of variance 1, which most sets share.
    fn beyond_dn2(
        &self,
        s: &SetPrediction,
        (rows, columns): (usize, usize),
        known: &mut Vec<(Ripple, f64)>,
    ) -> f64 {
        let mut of_one = |ripple: Ripple| {
            if let Some((_, power)) = known.iter().find(|(k, _)| *k == ripple) {
                return *power;
            }
            let lines = self.lines as f64;
            let of = |bin: usize| power_of(ripple, bin as f64 / (PADDED as f64 * lines), lines);
            let power = of(self.bin) - mean_beside(self.bin, self.bins, of);
            known.push((ripple, power));
            power
        };
        let turns = |phase: f64| phase / std::f64::consts::TAU;
        let of_lines = s.lines.iter().map(|&(v, across, down)| {
            let (along, own, pixels) = match self.axis {
                Axis::Rows => (turns(across), turns(down), columns),
                Axis::Columns => (turns(down), turns(across), rows),
            };
            (v * through(pixels as f64, along), Ripple::Sine(own))
        });
        let of_rows = s.ripples.iter().filter(|_| self.axis == Axis::Rows).copied();
        of_lines.chain(of_rows).map(|(variance, ripple)| variance * of_one(ripple)).sum()
    }

    /// Returns the power of the field's shapes at the peak, DN^2, from the power of each at variance 1.
    fn field_dn2(&self, s: &SetPrediction, of_shapes: &[f64; SHAPES]) -> f64 {
        let shapes = if self.axis == Axis::Rows { s.fields.down } else { s.fields.across };
        shapes.iter().zip(of_shapes).map(|(variance, power)| variance * power).sum()
    }
}

/// Relative error of the power of a field due to its shape, which is no cosine (a named choice).
const FIELD_SHAPE_ERROR_REL: f64 = 0.3;

/// Returns the power of a ripple of variance 1 at a frequency, in the spectrum of this number of lines.
fn power_of(ripple: Ripple, cycles: f64, lines: f64) -> f64 {
    match ripple {
        Ripple::Sine(own) => 0.5 * lines * (through(lines, cycles - own) + through(lines, cycles + own)),
        // Spectrum of an autoregression of the first order (Box and Jenkins 1976, 3.2.3).
        Ripple::Wander(next) => {
            let cosine = (std::f64::consts::TAU * cycles).cos();
            (1.0 - next * next) / (1.0 + next * next - 2.0 * next * cosine)
        }
    }
}

/// Returns the share of a sine's power that a sum over this number of lines passes, at a distance in cycles
/// per line (Dirichlet kernel; Oppenheim and Schafer, Discrete-Time Signal Processing, section 2.6).
fn through(lines: f64, cycles: f64) -> f64 {
    let half = std::f64::consts::PI * (cycles - cycles.round());
    if half.abs() < 1e-9 { 1.0 } else { ((lines * half).sin() / (lines * half.sin())).powi(2) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observables::row_spectrum::{add_power, count};
    use radcam_sim::rng::{PixelRng, Stream};

    const LINES: usize = 96;
    const SETS: usize = 12;
    const FRAMES: usize = 4;

    /// Draws some sets of line means with a sine of this amplitude. Returns the power of their deviations
    /// over the degrees of freedom.
    fn drawn(run: u64, amplitude: f64, cycles: f64) -> Vec<Vec<f64>> {
        let mut random = PixelRng::new(31, Stream::Effect, run, 0, 0);
        let set = |_| {
            let mut frame = |_| -> Vec<f64> {
                let phase = std::f64::consts::TAU * random.uniform();
                let sine = |k: usize| amplitude * (std::f64::consts::TAU * cycles * k as f64 + phase).sin();
                (0..LINES).map(|k| sine(k) + random.normal()).collect()
            };
            let frames: Vec<Vec<f64>> = (0..FRAMES).map(&mut frame).collect();
            let mut sums = vec![0.0; count(LINES)];
            let mut plan = None;
            for own in &frames {
                let mean = |k: usize| frames.iter().map(|f| f[k]).sum::<f64>() / FRAMES as f64;
                add_power(&mut plan, LINES, (0..LINES).map(|k| (own[k] - mean(k)) as f32), &mut sums);
            }
            sums.iter().map(|s| s / (FRAMES as f64 - 1.0)).collect()
        };
        (0..SETS).map(set).collect()
    }

    fn spectra(powers: &[Vec<f64>]) -> Vec<Spectrum<'_>> {
        let of = |(set, power)| Spectrum {
            set,
            half: Half::First,
            frames: FRAMES as f64,
            power,
            is_dark: true,
            exposure_s: 0.01,
            signal_dn: 0.0,
            noise_dn2: 1.0,
        };
        powers.iter().map(Vec::as_slice).enumerate().map(of).collect()
    }

    fn found(powers: &[Vec<f64>]) -> (f64, usize, f64) {
        let bins = count(LINES);
        strongest(&spectra(powers), LINES, bins, PADDED * SLOWEST..bins - PADDED / 2, |_| 1.0).unwrap()
    }

    /// The stated chance of a peak holds for noise: the number of 400 spectra below 0.05 is as stated, within
    /// four standard errors, and none lies below the limit. A sine of a third of a line's noise, which shows
    /// in no frame, is found in 40 of 40 campaigns, at its frequency and with its power.
    #[test]
    fn chances_hold_and_weak_sines_are_found() {
        let chances: Vec<f64> = (0..400).map(|run| found(&drawn(run, 0.0, 0.1)).0).collect();
        let few = chances.iter().filter(|c| **c < 0.05).count();
        assert!(few <= 20 + 18 && chances.iter().all(|c| *c > CHANCE), "{few} of 400");
        let mut z = Vec::new();
        for run in 0..40 {
            let cycles = 0.05 + 0.01 * run as f64;
            let powers = drawn(1000 + run, 0.33, cycles);
            let (chance, bin, place) = found(&powers);
            assert!(
                chance < CHANCE && (place - cycles).abs() * (LINES as f64) < 0.3,
                "{cycles}: {chance:e} at {place}"
            );
            // At the bin the sine has the power that the kernel passes, minus that beside it.
            let sine = |k: usize| {
                let away = k as f64 / (PADDED * LINES) as f64 - cycles;
                0.25 * 0.33 * 0.33 * LINES as f64 * through(LINES as f64, away)
            };
            let bins = powers[0].len();
            let expected = sine(bin) - mean_beside(bin, bins, sine);
            let own = |p: &Vec<f64>| (p[bin] - mean_beside(bin, bins, |k| p[k])) / LINES as f64;
            let mean = powers.iter().map(own).sum::<f64>() / SETS as f64;
            let dof = (SETS * (FRAMES - 1)) as f64;
            let error = ((1.0 + 2.0 * expected) * (1.0 + 1.0 / independent(bin, bins)) / dof
                + expected * expected / (SETS * FRAMES * (FRAMES - 1)) as f64)
                .sqrt();
            z.push((mean - expected) / error);
        }
        let square = z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64;
        // The bin is the highest of some: on average half an error too high, which gives a square of 1.25.
        // The mean of forty squares scatters by 0.3.
        assert!(square < 2.3, "{square} {z:?}");
    }

    /// Bands of a fast lamp, of one amplitude in DN at all exposures, under flats of 1 to 45 times the
    /// shortest exposure and beside quiet darks: the sum for a lamp shows them in 40 of 40 campaigns, and
    /// those for ripples in all frames and in proportion to the signal in at most two.
    #[test]
    fn bands_of_a_fast_lamp_are_found() {
        let exposures: Vec<f64> = (0..SETS).map(|k| 2f64.powf(0.5 * k as f64)).collect();
        let found = |run: u64| -> Vec<Origin> {
            // Noise of 1 and sines of amplitude 1 / sqrt(t), scaled to noise of sqrt(t).
            let flats = exposures.iter().zip(0..).map(|(t, k)| {
                let own = drawn(3000 + 100 * run + k, 0.7 / t.sqrt(), 0.2).swap_remove(0);
                own.iter().map(|v| v * t).collect::<Vec<f64>>()
            });
            let darks = drawn(9000 + run, 0.0, 0.2).into_iter();
            let darks = darks.map(|own| own.iter().map(|v| 0.01 * v).collect::<Vec<f64>>());
            let powers: Vec<Vec<f64>> = flats.chain(darks).collect();
            let mut all = spectra(&powers);
            for (k, s) in all.iter_mut().enumerate() {
                s.is_dark = k >= SETS;
                s.noise_dn2 = exposures.get(k).copied().unwrap_or(0.01);
                (s.exposure_s, s.signal_dn) = exposures.get(k).map_or((1.0, 0.0), |t| (*t, *t));
            }
            let bins = count(LINES);
            let shown = |o: &Origin| {
                let range = PADDED * SLOWEST..bins - PADDED / 2;
                strongest(&all, LINES, bins, range, |s| o.weight(s)).is_some_and(|found| found.0 < CHANCE)
            };
            Origin::ALL.into_iter().filter(shown).collect()
        };
        let all: Vec<Origin> = (0..40).flat_map(found).collect();
        let times = |o: Origin| all.iter().filter(|f| **f == o).count();
        let [additive, light, lamp] = Origin::ALL.map(times);
        assert!(lamp == 40 && additive <= 2 && light <= 2, "{additive} {light} {lamp}");
    }

    /// A strong sine has the same weight in sets of few frames with similar and with different phases: its
    /// weighted power is that drawn, within four standard errors over 60 campaigns. If the weights came from
    /// the variance of the lines, with the sine in it, the power would be a fifth too low.
    #[test]
    fn phases_that_lie_together_weigh_no_more() {
        let cycles = 20.0 / LINES as f64;
        let bin = 20 * PADDED;
        let power = |run: u64| {
            let sets = drawn(2000 + run, 2.0, cycles);
            let weights: Vec<f64> = sets.iter().map(|p| noise_of(p, LINES, FRAMES as f64).powi(-2)).collect();
            let of = |p: &Vec<f64>| (p[bin] - mean_beside(bin, p.len(), |k| p[k])) / LINES as f64;
            let sum: f64 = sets.iter().zip(&weights).map(|(p, w)| w * of(p)).sum();
            sum / weights.iter().sum::<f64>()
        };
        let runs: Vec<f64> = (0..60).map(power).collect();
        let mean = runs.iter().sum::<f64>() / runs.len() as f64;
        let var = runs.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (runs.len() - 1) as f64;
        let sine = |k: usize| {
            LINES as f64 * through(LINES as f64, (k as f64 - bin as f64) / (PADDED * LINES) as f64)
        };
        let expected = sine(bin) - mean_beside(bin, PADDED * LINES / 2 + 1, sine);
        let z = (mean - expected) / (var / runs.len() as f64).sqrt();
        assert!(z.abs() < 4.0, "{mean} for {expected}: {z}");
    }
}
