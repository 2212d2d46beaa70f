//! How far the noisiest pixels are off two levels in short darks, each about its own mean: whether they are noisy
//! as others are, or jump.

use crate::statistics::steady::{LEAST_DN2, REACH};

use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// How far: of pixels that stand out, then of the noisiest hundredth and twentieth.
#[derive(Debug)]
pub struct NoisyLevels;

/// Relative error of what is expected (a named choice): the selection of jumping pixels is predicted roughly.
const ROUGHLY: f64 = 0.4;
/// Rounding to whole codes changes the kurtosis of noise of a code by no more (-1/120 over the square of 1/12 and
/// the noise's variance), of which it is the half.
const ROUNDING: f64 = 0.01;
/// Share of a value above 0 that is not known to be none.
const ABOVE: f64 = 0.7;
/// Value of two levels alone, the least there is.
const TWO_LEVELS: f64 = -1.0;
/// Pixels whose jumps are this part of their variance and more are all among the noisiest (a named choice).
const CHOSEN: f64 = 1.3;
/// Noise of less than a step makes two codes of a level, which look like two levels.
const TWO_CODES: f64 = 0.75;
/// Noisy pixels have so many times the noise of others (sCMOS data sheets: up to some times the median).
const NOISY: f64 = 3.0;
/// Value of noise of which a part is cut off, at most some tenths (a named choice).
const CUT_OFF: f64 = 0.25;

/// Square of the part that jumps of one variance are of that of the noisiest pixels; `jumping`: pixels that
/// jump for each of these.
fn of_one(jumping: f64, variance: f64, rest: f64) -> f64 {
    // Pixels that jump are among the noisiest as far as their jumps stand out of the noise.
    let part = variance / (rest + variance);
    // Weak jumps leave some of them among the others.
    among(jumping) * (CHOSEN * part).min(1.0) * part * part
}

/// Share of the noisiest pixels that jump, where so many jump for each of these: all of them where there are more,
/// without a kink, at which a fit would end.
fn among(jumping: f64) -> f64 {
    (1.0 + jumping.max(1e-9).powi(-4)).powf(-0.25)
}

/// The same of amplitudes a with an exponential distribution of mean A, whose mean variance is A^2 / 2: the
/// noisiest are those beyond the amplitude that so many exceed.
fn of_noisiest(jumping: f64, variance: f64, rest: f64) -> f64 {
    /// Values of the exponential distribution that stand for it.
    const VALUES: usize = 32;
    let beyond = jumping.max(1.0).ln();
    let of = |k: usize| {
        let a = beyond - ((k as f64 + 0.5) / VALUES as f64).ln();
        // A quarter of a^2 in units of A, of which the mean is a half.
        of_one(f64::INFINITY, 0.5 * a * a * variance, rest)
    };
    among(jumping) * (0..VALUES).map(of).sum::<f64>() / VALUES as f64
}

impl Statistic for NoisyLevels {
    fn id(&self) -> &'static str {
        "levels of noisy pixels"
    }

    fn name(&self, index: usize) -> String {
        let which = [
            "pixels that stand out",
            "the noisiest hundredth of the pixels",
            "the noisiest twentieth of the pixels",
        ];
        let which = which[index.min(2)];
        format!("two levels of {which}")
    }

    fn meaning(&self, _: usize) -> &'static str {
        "below 0: noisy pixels jump between two levels; -1: without other noise"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for (index, levels) in half.noisy_levels.iter().enumerate() {
            let Some(levels) = levels else { continue };
            put.put_of(index, levels.pixels, levels.off.value, levels.off.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (rows, columns) = view.all.campaign.shape;
        let darks =
            view.prediction.sets.iter().zip(&view.all.campaign.sets).filter(|(_, s)| s.light.is_none());
        let shortest = darks.min_by(|a, b| a.1.exposure_s.total_cmp(&b.1.exposure_s));
        let Some((s, _)) = shortest else { return Expected::plain(o, 0.0, 1.0) };
        let jump = s.two_levels;
        let noise = s.covariance(0, 0).max(1e-12);
        let rest = (noise - jump.share * jump.variance).max(1e-12);
        let jumping = jump.share * (rows * columns) as f64;
        let of = if jump.differ { of_noisiest } else { of_one };
        let off = TWO_LEVELS * of(jumping / o.pixels, jump.variance, rest);
        let step = view.prediction.code_step_dn.max(s.step_dn);
        // Selected pixels cover more than two codes, but with coarse steps they may cover two steps only.
        let own = (noise.max(LEAST_DN2) / (step * step) - 1.0 / 12.0).max(0.0);
        let rounding = TWO_CODES * (-std::f64::consts::PI.powi(2) * own).exp()
            + (ROUNDING * step * step / noise.max(1e-6)).min(1.0);
        // Pixels that reach code 0 are left out; those that reach another floor are not.
        let cut_off = if view.prediction.floor_dn > -4.0 * NOISY * noise.sqrt() { CUT_OFF } else { 0.0 };
        // Jumps that reach code 0 are left out, and say nothing.
        let level_dn = view.prediction.base.offset_dn + s.signal;
        let left_out = jump.share > 0.0 && REACH * REACH * (rest + jump.variance) > level_dn * level_dn;
        let unsure = ROUGHLY * off.abs() + rounding + cut_off + if left_out { 1.0 } else { 0.0 };
        // Above 0 lies what grows from set to set, as the shot noise of dark charge does: only what lies below
        // tells of levels.
        let above = ABOVE * o.measured.value.max(0.0);
        Expected::plain(o, off, in_quadrature(&[o.measured.std_err, unsure, above]))
            .with_common(ROUGHLY * off.abs())
    }
}
