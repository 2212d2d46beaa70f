//! Excess kurtosis of the noisiest pixels in short darks, each about its own variance: whether they are noisy as
//! others are, or jump between levels.

use crate::statistics::steady::LEAST_DN2;

use super::{Expected, HalfView, Observable, Put, Statistic, View, in_quadrature};

/// The excess: of pixels that stand out, then of the noisiest hundredth and twentieth.
#[derive(Debug)]
pub struct NoisyLevels;

/// Relative error of the expected excess (a named choice): the selection of jumping pixels is predicted
/// roughly.
const ROUGHLY: f64 = 0.4;
/// Rounding to whole codes changes the kurtosis of noise of a code by no more (-1/120 over the square of 1/12 and
/// the noise's variance).
const ROUNDING: f64 = 0.02;
/// Standard deviation of the excess of one pixel of normal noise, of some ten frames (moments of chi-square).
const OF_ONE: f64 = 0.8;
/// Share of an excess above 0 that is not known to be none.
const ABOVE: f64 = 0.7;
/// Excess of two levels alone, the least there is.
const TWO_LEVELS: f64 = -2.0;
/// Pixels whose jumps are this part of their variance and more are all among the noisiest (a named choice).
const CHOSEN: f64 = 1.3;
/// Noise of less than a step makes two codes of a level, which look like two levels.
const TWO_CODES: f64 = 1.5;
/// Noisy pixels have so many times the noise of others (sCMOS data sheets: up to some times the median).
const NOISY: f64 = 3.0;
/// Excess of noise of which a part is cut off, at most some tenths (a named choice).
const CUT_OFF: f64 = 0.5;

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
        format!("kurtosis of {which}")
    }

    fn meaning(&self, _: usize) -> &'static str {
        "below 0: noisy pixels jump between two levels"
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
        // Pixels that jump are among the noisiest as far as their jumps stand out of the noise.
        let among = (jump.share * (rows * columns) as f64 / o.pixels).min(1.0);
        let part = jump.variance / (rest + jump.variance);
        // Weak jumps leave some of them among the others.
        let chosen = (CHOSEN * part).min(1.0);
        let excess: f64 = -2.0 * among * chosen * part * part;
        let step = view.prediction.code_step_dn;
        // Selected pixels cover more than two codes, but with coarse steps they may cover two steps only.
        let own = (noise.max(LEAST_DN2) / (step * step) - 1.0 / 12.0).max(0.0);
        let rounding = TWO_CODES * (-std::f64::consts::PI.powi(2) * own).exp()
            + (ROUNDING * step * step / noise.max(1e-6)).min(1.0);
        // Pixels that reach code 0 are left out; those that reach another floor are not.
        let cut_off = if view.prediction.floor_dn > -4.0 * NOISY * noise.sqrt() { CUT_OFF } else { 0.0 };
        // The measured excess is scaled up to that of long runs, and its errors with it.
        let scaled = (o.measured.std_err * o.pixels.sqrt() / OF_ONE).max(1.0);
        let unsure = ROUGHLY * excess.abs() + scaled * (rounding + cut_off);
        // Above 0 lies what grows from set to set, as the shot noise of dark charge does: only what lies below
        // tells of levels.
        let above = ABOVE * o.measured.value.max(0.0);
        // Excess below that of two levels alone was scaled up too much.
        let below = (TWO_LEVELS - o.measured.value).max(0.0);
        Expected::plain(o, excess, in_quadrature(&[o.measured.std_err, unsure, above, below]))
    }
}
