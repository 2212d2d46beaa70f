//! Kurtosis of the noisiest pixels above Pearson's bound in short darks: it tells pixels that jump between
//! two levels from noisy ones.

use crate::statistics::steady::{LEAST_DN2, REACH};

use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// Kurtosis above the bound: pixels that stand out, then the noisiest hundredth and twentieth.
#[derive(Debug)]
pub struct NoisyLevels;

/// Relative error of the expected value (a named choice): the share of jumping pixels among the noisiest is
/// predicted roughly.
const MODEL_ERROR_REL: f64 = 0.4;
/// Maximum change by rounding to whole codes: half of that of the kurtosis of noise of a code (-1/120 over
/// the square of 1/12 and the noise's variance).
const ROUNDING: f64 = 0.01;
/// Error assigned to a value above 0, as a share of it.
const ABOVE: f64 = 0.7;
/// Value of two levels alone, the lowest possible one.
const TWO_LEVELS: f64 = -1.0;
/// Change due to a code that is wider by a standard deviation of the noise (normal noise with a gap of 0.7
/// deviations in its middle: 0.42), for pixels within two deviations of it.
const SPLIT: f64 = 0.6;
/// Pixels whose jumps make up at least 1 / `CHOSEN` of their variance are all among the noisiest (a named
/// choice).
const CHOSEN: f64 = 1.3;
/// Change due to noise of less than a step: two codes of a level look like two levels.
const TWO_CODES: f64 = 1.0;
/// Variance of a level between two codes whose noise is far less than a code, in codes squared; a larger
/// variance is noise.
const BETWEEN_CODES: f64 = 0.25;
/// Ratio of the noise of noisy pixels to that of others (sCMOS data sheets: up to some times the median).
const NOISY: f64 = 3.0;
/// Change due to noise of which a part is cut off, at most some tenths (a named choice).
const CUT_OFF: f64 = 0.25;

/// Returns the squared share of jumps of one variance in the variance of the noisiest pixels. `jumping`:
/// jumping pixels per noisiest pixel.
fn squared_share(jumping: f64, variance: f64, rest: f64) -> f64 {
    // Jumping pixels are among the noisiest as far as their jumps exceed the noise.
    let part = variance / (rest + variance);
    // Some pixels with weak jumps remain among the others.
    jumping_share(jumping) * (CHOSEN * part).min(1.0) * part * part
}

/// Returns the share of jumping pixels among the noisiest: min(jumping, 1) without its kink, at which fits
/// would end.
fn jumping_share(jumping: f64) -> f64 {
    (1.0 + jumping.max(1e-9).powi(-4)).powf(-0.25)
}

/// Returns [`squared_share`] for exponentially distributed amplitudes of mean A and mean variance A^2 / 2:
/// the noisiest pixels have the largest amplitudes.
fn squared_share_exponential(jumping: f64, variance: f64, rest: f64) -> f64 {
    /// Number of quantiles of the exponential distribution in the mean.
    const VALUES: usize = 32;
    let beyond = jumping.max(1.0).ln();
    let of = |k: usize| {
        let a = beyond - ((k as f64 + 0.5) / VALUES as f64).ln();
        // Variance a^2 / 4 in units of its mean, A^2 / 2.
        squared_share(f64::INFINITY, 0.5 * a * a * variance, rest)
    };
    jumping_share(jumping) * (0..VALUES).map(of).sum::<f64>() / VALUES as f64
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
        format!("kurtosis above its bound (skewness^2 + 1), {which}")
    }

    fn meaning(&self, _: usize) -> &'static str {
        "below 0: noisy pixels jump between two levels; -1: without other noise"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for (index, levels) in half.noisy_levels.iter().enumerate() {
            let Some(levels) = levels else { continue };
            put.put_of(index, levels.pixels, levels.excess.value, levels.excess.std_err);
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
        let of = if jump.differ { squared_share_exponential } else { squared_share };
        let off = TWO_LEVELS * of(jumping / o.pixels, jump.variance, rest);
        let step = view.prediction.code_step_dn.max(s.step_dn);
        // Selected pixels cover more than two codes, but with coarse steps they may cover two steps only.
        let own = (noise.max(LEAST_DN2) / (step * step) - BETWEEN_CODES).max(0.0);
        let rounding = TWO_CODES * (-std::f64::consts::PI.powi(2) * own).exp()
            + (ROUNDING * step * step / noise.max(1e-6)).min(1.0);
        // Wide codes split the noise of the pixels around them.
        let sd = noise.sqrt();
        let split = |width_dn: f64, apart_dn: f64| SPLIT * width_dn / sd * (4.0 * sd / apart_dn).min(1.0);
        let bits = view.prediction.bit_errors_dn.iter().enumerate();
        let bits = bits.map(|(k, e)| split(e.abs(), f64::from(1u32 << k)).powi(2)).sum::<f64>().sqrt();
        // Steps of a table and of multiplied codes differ by one code.
        let multiplied = view.prediction.code_step_dn.fract() != 0.0;
        let table = if s.codes_used < 0.999 || multiplied { split(0.5, 1.0) } else { 0.0 };
        let unequal_codes = (bits + table).min(1.0);
        // Pixels that reach code 0 are left out; those that reach another floor are not.
        let cut_off = if view.prediction.floor_dn > -4.0 * NOISY * noise.sqrt() { CUT_OFF } else { 0.0 };
        // The measurement leaves out pixels whose jumps reach code 0.
        let level_dn = view.prediction.base.offset_dn + s.signal;
        let left_out = jump.share > 0.0 && REACH * REACH * (rest + jump.variance) > level_dn * level_dn;
        let unsure = MODEL_ERROR_REL * off.abs()
            + rounding
            + unequal_codes
            + cut_off
            + if left_out { 1.0 } else { 0.0 };
        // Values above 0 are due to noise that grows from set to set, such as the shot noise of dark charge;
        // only values below 0 indicate levels.
        let above = ABOVE * o.measured.value.max(0.0);
        Expected::plain(o, off, in_quadrature(&[o.measured.std_err, unsure, above]))
            .with_common(MODEL_ERROR_REL * off.abs())
    }
}
