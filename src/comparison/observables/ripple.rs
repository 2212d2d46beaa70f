//! Frequency of a lamp's ripple, from the fading with the exposure of rolling shutter bands or of the scatter
//! of whole frames ([`ripple_left`]). A search for light banding, or for flicker, starts from it.

use super::line_peak::{OfRipple, Peak};
use super::read::Chunk;
use crate::dataset::{FrameRow, Kind};
use crate::statistics::median::median;
use crate::statistics::pass::Summary;
use radcam_sim::effects::{FittingRipple, ripple_left};
use std::collections::BTreeMap;

/// Ripples of a lamp that fit the bands of a campaign, or the scatter of its frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ripples {
    /// Frequencies, Hz, the likeliest first; empty if the exposures do not determine any.
    pub likely_hz: Vec<f64>,
    /// Slowest and fastest ripple within three standard errors of the likeliest; `None` without flats.
    pub fitting: Option<[FittingRipple; 2]>,
}

/// Variance that a ripple leaves in flats under one exposure.
#[derive(Debug, Clone, Copy)]
struct Rippled {
    exposure_s: f64,
    /// Mean above the darks, DN.
    signal_dn: f64,
    /// Variance of row or frame means beyond that of pixels and darks, DN^2, and its error by their noise.
    var_dn2: (f64, f64),
    /// Variance due to the phases of the frames, over the square of the expected variance.
    by_phases: f64,
}

/// Steps of the search, coarse and fine, in turns within the longest exposure.
const STEPS: [f64; 2] = [0.04, 5e-4];
/// Slowest and fastest ripple of the search, in turns within the longest exposure: PWM lamps run at up to
/// some 10 kHz.
const TURNS: (f64, f64) = (0.1, 101.0);
/// Number of coarse minima that are refined in fine steps.
const FINE: usize = 8;
/// Largest number of frequencies returned.
const MOST: usize = 3;
/// Largest drop in twice the log likelihood, relative to the best frequency, of a returned one (a chance of
/// e^-10).
const FAR: f64 = 20.0;
/// Minimum gain in twice the log likelihood of a faster ripple over a slower one: less is not worth more than
/// a bare mention (Kass and Raftery 1995, section 3.2). Under exposures in equal steps a faster ripple with a
/// larger amplitude fades as a slower one does.
const BARELY: f64 = 2.0;
/// Drop in twice the log likelihood of a ripple three standard errors away.
const THREE_ERRORS: f64 = 9.0;
/// Iterations of the weights, which depend on the amplitude.
const ITERATIONS: usize = 6;
/// Minimum number of chunks, and maximum ratio of the shortest exposure to the longest, that determine a
/// frequency (named choices).
const FEWEST: (usize, f64) = (4, 0.67);

/// Returns the ripples that fit the bands in the flats of a campaign. `peak`: that of the spectrum of row
/// means.
pub(super) fn of_bands(
    chunks: &[Chunk],
    settings: &[FrameRow],
    zero_dn: f64,
    peak: Option<&Peak>,
) -> Ripples {
    if let Some(parts) = peak.and_then(Peak::of_ripple) {
        return ripples(&rippled_at_peak(&parts, chunks, settings, zero_dn));
    }
    // Variance of row means beyond the noise of pixels, and its error.
    let beyond = |s: &Summary| {
        let columns = s.columns_dn.len().max(1) as f64;
        let [rows_dn2, _] = s.line_var_dn2;
        let of_pixels = (s.var.value - rows_dn2).max(0.0) / columns;
        let dof = (s.frames as f64 - 1.0) * s.rows_dn.len() as f64;
        (rows_dn2 - of_pixels, of_pixels * (2.0 / dof.max(1.0)).sqrt())
    };
    ripples(&rippled(chunks, settings, zero_dn, beyond, by_phases))
}

/// Returns the ripples that fit the scatter of the frames in the flats of a campaign.
pub(super) fn of_frames(chunks: &[Chunk], settings: &[FrameRow], zero_dn: f64) -> Ripples {
    // Variance of frame means beyond the noise of pixels, and its error.
    let beyond = |s: &Summary| {
        let pixels = (s.rows_dn.len() * s.columns_dn.len()).max(1) as f64;
        let of_pixels = s.var.value / pixels;
        let var_dn2 = if s.frames > 1 { s.frame_means.variance_dn2() } else { 0.0 };
        (var_dn2 - of_pixels, of_pixels * (2.0 / (s.frames as f64 - 1.0).max(1.0)).sqrt())
    };
    // Variance of a sample variance (Kenney and Keeping 1951, part 2, p. 164) of a sine, whose fourth moment
    // is 1.5 times the square of its second.
    let by_phases = |n: f64| 1.5 / n - (n - 3.0) / (n * (n - 1.0)).max(1.0);
    ripples(&rippled(chunks, settings, zero_dn, beyond, by_phases))
}

/// Returns the flats with the variance that a ripple of the peak's frequency has in them.
fn rippled_at_peak(
    parts: &[OfRipple],
    chunks: &[Chunk],
    settings: &[FrameRow],
    zero_dn: f64,
) -> Vec<Rippled> {
    let mut levels: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for c in chunks {
        levels.entry(c.set).or_default().push(c.summary.frame_means.mean_dn() - zero_dn);
    }
    let signal_dn = |set: usize| median(levels.get(&set).into_iter().flatten().copied());
    let of_part = |p: &OfRipple| {
        let signal_dn = signal_dn(p.set);
        let is_lit = settings[p.set].kind == Kind::Flat && signal_dn > 0.0;
        is_lit.then(|| Rippled {
            exposure_s: settings[p.set].exposure_s,
            signal_dn,
            var_dn2: p.var_dn2,
            by_phases: by_phases(p.frames),
        })
    };
    parts.iter().filter_map(of_part).collect()
}

/// Returns the relative variance of the variance of row means by a ripple due to the phases of this number
/// of frames: the mean product of two different ones with independent phases scatters by 1 / n (n - 1).
fn by_phases(frames: f64) -> f64 {
    1.0 / (frames * (frames - 1.0)).max(1.0)
}

/// Returns the flats with their variance beyond that of darks. `beyond`: variance beyond the noise of pixels,
/// DN^2, and its error. `by_phases`: relative variance of it due to the phases of this number of frames.
fn rippled(
    chunks: &[Chunk],
    settings: &[FrameRow],
    zero_dn: f64,
    beyond: impl Fn(&Summary) -> (f64, f64),
    by_phases: impl Fn(f64) -> f64,
) -> Vec<Rippled> {
    let darks = chunks.iter().filter(|c| settings[c.set].kind == Kind::Dark);
    let of_dark = median(darks.map(|c| beyond(&c.summary).0));
    let of_dark = if of_dark.is_finite() { of_dark.max(0.0) } else { 0.0 };
    let of_chunk = |c: &Chunk| {
        let signal_dn = c.summary.frame_means.mean_dn() - zero_dn;
        let (value, error) = beyond(&c.summary);
        let is_lit = settings[c.set].kind == Kind::Flat && signal_dn > 0.0;
        (is_lit && error > 0.0 && c.summary.frames > 1).then(|| Rippled {
            exposure_s: settings[c.set].exposure_s,
            signal_dn,
            var_dn2: (value - of_dark, error.hypot(of_dark)),
            by_phases: by_phases(c.summary.frames as f64),
        })
    };
    chunks.iter().filter_map(of_chunk).collect()
}

/// Returns the ripples that fit, each with its best amplitude.
fn ripples(all: &[Rippled]) -> Ripples {
    let exposures = || all.iter().map(|b| b.exposure_s);
    let (shortest_s, longest_s) = exposures().fold((f64::INFINITY, 0.0f64), |(a, b), t| (a.min(t), b.max(t)));
    if all.is_empty() || longest_s <= 0.0 {
        return Ripples::default();
    }
    let at = |turns: f64| fitted(all, turns / longest_s);
    let count = ((TURNS.1 - TURNS.0) / STEPS[0]) as usize;
    let coarse: Vec<Fitted> = (0..count).map(|i| at(TURNS.0 + STEPS[0] * i as f64)).collect();
    let mut minima: Vec<usize> = (1..count - 1)
        .filter(|&i| coarse[i].score <= coarse[i - 1].score && coarse[i].score < coarse[i + 1].score)
        .collect();
    minima.sort_by(|&a, &b| coarse[a].score.total_cmp(&coarse[b].score));
    let per_step = (STEPS[0] / STEPS[1]) as i32;
    let finely = |&i: &usize| {
        let middle = TURNS.0 + STEPS[0] * i as f64;
        let near = (-per_step..=per_step).map(|k| at(middle + STEPS[1] * f64::from(k)));
        near.min_by(|a, b| a.score.total_cmp(&b.score))
    };
    let mut found: Vec<Fitted> = minima.iter().take(FINE).filter_map(finely).collect();
    let best = found.iter().chain(&coarse).map(|f| f.score).fold(f64::INFINITY, f64::min);
    let fitting = || found.iter().chain(&coarse).filter(|f| f.score < best + THREE_ERRORS).map(|f| f.ripple);
    let slowest = fitting().min_by(|a, b| a.hz.total_cmp(&b.hz));
    let fastest = fitting().max_by(|a, b| a.hz.total_cmp(&b.hz));
    // Ripples faster than those of the search also fit: their amplitudes grow with the frequency, up to 1.
    let beyond = |r: FittingRipple| match r.hz * longest_s > TURNS.1 - 1.0 && r.rel > 0.0 {
        true => FittingRipple { hz: r.hz / r.rel, rel: 1.0 },
        false => r,
    };
    let fitting = slowest.zip(fastest).map(|(slowest, fastest)| [slowest, beyond(fastest)]);
    if all.len() < FEWEST.0 || shortest_s > FEWEST.1 * longest_s {
        return Ripples { likely_hz: Vec::new(), fitting };
    }
    found.sort_by(|a, b| a.ripple.hz.total_cmp(&b.ripple.hz));
    let mut slower = f64::INFINITY;
    found.retain(|f| {
        let gains = f.score < slower - BARELY;
        slower = slower.min(f.score);
        gains
    });
    found.sort_by(|a, b| a.score.total_cmp(&b.score));
    let likely = found.into_iter().take(MOST).filter(|f| f.score < best + FAR);
    Ripples { likely_hz: likely.map(|f| f.ripple.hz).collect(), fitting }
}

/// A ripple with its best amplitude, and minus twice the logarithm of its likelihood.
#[derive(Clone, Copy)]
struct Fitted {
    score: f64,
    ripple: FittingRipple,
}

/// Fits the amplitude of a ripple of this frequency.
fn fitted(all: &[Rippled], hz: f64) -> Fitted {
    // Share of the signal's square that the ripple would have at amplitude 1.
    let shape = |b: &Rippled| 0.5 * (b.signal_dn * ripple_left(hz, b.exposure_s)).powi(2);
    let shapes: Vec<f64> = all.iter().map(shape).collect();
    let variance = |b: &Rippled, expected: f64| expected * expected * b.by_phases + b.var_dn2.1.powi(2);
    // Square of the amplitude.
    let mut square = 0.0;
    for iteration in 0..ITERATIONS {
        let (mut product, mut weight) = (0.0, 0.0);
        for (b, shape) in all.iter().zip(&shapes) {
            let expected = if iteration == 0 { b.var_dn2.0 } else { square * shape };
            let v = variance(b, expected);
            product += shape * b.var_dn2.0 / v;
            weight += shape * shape / v;
        }
        square = (product / weight.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    }
    let score = all.iter().zip(&shapes).fold(0.0, |sum, (b, shape)| {
        let v = variance(b, square * shape);
        sum + (b.var_dn2.0 - square * shape).powi(2) / v + v.ln()
    });
    Fitted { score, ripple: FittingRipple { hz, rel: square.sqrt() } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Draws three and four frames under each exposure, with phases and noise of their own.
    fn drawn(random: &mut PixelRng, exposures_s: &[f64], hz: f64, rel: f64) -> Vec<Rippled> {
        let sets = exposures_s.iter().flat_map(|t| [(*t, 3), (*t, 4)]);
        sets.map(|(exposure_s, frames)| {
            let signal_dn = 3500.0 * exposure_s / exposures_s.iter().fold(0.0, |a: f64, b| a.max(*b));
            let x = std::f64::consts::PI * hz * exposure_s;
            let phases: Vec<f64> = (0..frames).map(|_| std::f64::consts::TAU * random.uniform()).collect();
            let n = f64::from(frames);
            let of = |f: fn(f64) -> f64| phases.iter().map(|p| f(*p)).sum::<f64>() / n;
            let apart = 1.0 - of(f64::cos).powi(2) - of(f64::sin).powi(2);
            let ripple = 0.5 * (rel * signal_dn * x.sin() / x).powi(2) * apart * n / (n - 1.0);
            let error = 0.4 * signal_dn / 96.0 * 0.09;
            let var_dn2 = (ripple + error * random.normal(), error);
            Rippled { exposure_s, signal_dn, var_dn2, by_phases: 1.0 / (n * (n - 1.0)) }
        })
        .collect()
    }

    /// Lamps of 100 to 900 Hz under exposures of 0.4 to 20 ms: in 38 of 40 campaigns one of the frequencies
    /// is the lamp's within 3 % or 5 Hz.
    #[test]
    fn a_ripple_has_its_frequency() {
        let exposures_s = [0.0004, 0.001, 0.0028, 0.0075, 0.005, 0.0101, 0.0125, 0.015, 0.0176, 0.02];
        let found = |run: u64| {
            let mut random = PixelRng::new(12, Stream::Effect, run, 0, 0);
            let hz = 100.0 * 9f64.powf(random.uniform());
            let rel = 0.02 * 10f64.powf(random.uniform());
            let near = |f: &f64| (f - hz).abs() < (0.03 * hz).max(5.0);
            ripples(&drawn(&mut random, &exposures_s, hz, rel)).likely_hz.iter().any(near)
        };
        let found = (0..40).filter(|run| found(*run)).count();
        assert!(found >= 38, "{found} of 40");
    }

    /// Twelve exposures in steps of 0.418 ms: ripples of f, 2390 - f and 2390 + f Hz fade alike, and the
    /// slowest comes first, in 19 of 20 campaigns.
    #[test]
    fn of_ripples_that_fade_alike_the_slowest_comes_first() {
        let exposures_s: Vec<f64> = (1..=12).map(|k| 0.000_418_333 * f64::from(k)).collect();
        let slowest = |run: u64| {
            let mut random = PixelRng::new(13, Stream::Effect, run, 0, 0);
            let hz = 150.0 + 600.0 * random.uniform();
            let found = ripples(&drawn(&mut random, &exposures_s, hz, 0.05));
            let fastest = found.fitting.unwrap()[1];
            assert!(fastest.hz > 2300.0 && fastest.rel > 0.2, "{found:?}");
            found.likely_hz.first().is_some_and(|f| (f - hz).abs() < (0.03 * hz).max(0.1 / exposures_s[11]))
        };
        let right = (0..20).filter(|run| slowest(*run)).count();
        assert!(right >= 19, "{right} of 20");
    }

    #[test]
    fn one_exposure_tells_no_frequency() {
        let set =
            Rippled { exposure_s: 0.01, signal_dn: 1000.0, var_dn2: (100.0, 1.0), by_phases: 1.0 / 12.0 };
        let found = ripples(&[set; 8]);
        let [slowest, fastest] = found.fitting.unwrap();
        assert!(found.likely_hz.is_empty() && slowest.hz < 20.0 && fastest.hz > 2000.0, "{found:?}");
        assert!(slowest.rel < 0.02 && fastest.rel == 1.0, "{found:?}");
        assert_eq!(ripples(&[]), Ripples::default());
    }
}
