//! Random telegraph noise: a few pixels jump between two levels.

use crate::predict::TwoLevels;

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, Together, takes};

/// A share of the pixels is up or down by half the amplitude, at random in every frame.
pub struct RandomTelegraphNoise;

/// Minimum share of the spread of the pixels' variances that stays with the pixels (a named choice: for
/// pixels that jump at one frame in seven it is 0.4 to 0.6 in sets of eight frames, and 0 for deviations that
/// hit any pixel).
const STAYS: f64 = 0.3;

/// Maximum share of the spread of the pixels' variances that pixels two columns or two rows apart have in
/// common (a named choice: for pixels anywhere it is 0, for parts of the sensor most of it, for its edges
/// half).
const ALONE: f64 = 0.25;
/// Maximum share of the pixels that jump (a named choice: sensors have some per cent at most). Jumps of more
/// pixels are the sensor's own noise.
const FEW: f64 = 0.2;
/// Relative errors of fraction and amplitude by the unknown distribution of the amplitudes (half of the
/// difference between fits of both distributions to four cameras).
const DISTRIBUTION_ERROR_REL: [f64; 2] = [0.5, 0.33];
/// Standard errors beyond which a common share is significant.
const SURE: f64 = 3.0;

/// Returns mean, e^2, and mean square, e^4, of the variance of a jump over the pixels that jump.
///
/// A jump of +-a / 2 has the variance a^2 / 4. Exponentially distributed amplitudes of mean A have the
/// moments E a^2 = 2 A^2 and E a^4 = 24 A^4.
fn jump_moments(p: &[f64]) -> (f64, f64) {
    let square = p[1] * p[1];
    if amplitudes_differ(p) {
        (0.5 * square, 1.5 * square * square)
    } else {
        (0.25 * square, 0.0625 * square * square)
    }
}

/// Returns true if the amplitudes differ from pixel to pixel.
fn amplitudes_differ(p: &[f64]) -> bool {
    p[AMPLITUDES].round() as i32 == 1
}

/// Index of the parameter `amplitudes`.
const AMPLITUDES: usize = 3;

/// Returns the spread of the pixels' variances, e^4.
fn spread(p: &[f64]) -> f64 {
    let (mean, square) = jump_moments(p);
    p[0] * square - (p[0] * mean).powi(2)
}

impl Effect for RandomTelegraphNoise {
    fn id(&self) -> &'static str {
        "random-telegraph-noise"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["rtn", "rts", "telegraph noise", "blinking pixels", "popcorn noise"]
    }

    fn stage(&self) -> Stage {
        Stage::Read
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "fraction",
                meaning: "share of the pixels that have two levels",
                unit: "1",
                min: 1e-5,
                max: FEW,
                starts: &[0.01],
            },
            Parameter {
                name: "amplitude_e",
                meaning: "distance of the two levels, the mean over the pixels that have two",
                unit: "e",
                min: 0.0,
                max: 1e5,
                starts: &[20.0],
            },
            Parameter {
                name: "stays",
                meaning: "correlation of a pixel's level with that of the next frame",
                unit: "1",
                min: -0.95,
                max: 0.95,
                starts: &[0.0],
            },
            Parameter {
                name: "amplitudes",
                meaning: "0: all the same, 1: exponential distribution over the pixels",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
        ]
    }

    /// Default of models written before the parameter existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == AMPLITUDES).then_some(0.0)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(if amplitudes_differ(p) {
            "amplitudes with an exponential distribution"
        } else {
            "one amplitude"
        })
    }

    fn together(&self, p: &[f64]) -> Option<Together> {
        // The combination is the spread of the pixels' variances; their mean says nothing beside an unknown
        // read noise.
        let cube = p[1].powi(3);
        let (name, value) = ("fraction * amplitude_e^4", p[0] * p[1] * cube);
        let slopes = vec![p[1] * cube, 4.0 * p[0] * cube, 0.0, 0.0];
        Some(Together { name, unit: "e^4", value, slopes, unsure_per_e: 0.0 })
    }

    /// Returns starts with jumps of several times the dark noise.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let noise_e = (seen.dark_noise_dn * seen.peak_e / seen.peak_dn.max(1e-9)).max(1.0);
        let one =
            [(0.01, 3.0, 0.0), (0.01, 8.0, 0.0), (0.001, 20.0, 0.0), (0.01, 8.0, 0.3), (0.02, 6.0, -0.2)];
        let differ = [(0.01, 3.0, 0.0), (0.05, 5.0, 0.0), (0.05, 5.0, 0.3), (0.003, 12.0, 0.0)];
        let of = |list: &[(f64, f64, f64)], differ: f64| -> Vec<Vec<f64>> {
            list.iter().map(|(share, jump, stays)| vec![*share, jump * noise_e, *stays, differ]).collect()
        };
        [of(&one, 0.0), of(&differ, 1.0)].concat()
    }

    /// Few campaigns tell the distribution of the amplitudes: one amplitude fits an exponential distribution
    /// with half of the pixels and more than twice the mean amplitude.
    fn resolution(&self, parameter: usize, p: &[f64], _: &Seen) -> f64 {
        DISTRIBUTION_ERROR_REL.get(parameter).map_or(0.0, |part| part * p[parameter])
    }

    fn read_noise_absorbs_it(&self) -> bool {
        true
    }

    fn told_by(&self) -> &'static [&'static str] {
        &["levels of noisy pixels", "covariance of successive frames"]
    }

    /// Deviations that hit any pixel are not telegraph noise; noisy parts of the sensor are not either.
    fn contradicted(&self, p: &[f64], _: &[f64], seen: &Seen) -> Option<&'static str> {
        let gain = seen.peak_dn / seen.peak_e.max(1e-9);
        let stays = spread(p) * gain.powi(4);
        if let Some((found, std_err)) = seen.together_dn4
            && found > SURE * std_err
            && found > ALONE * stays
        {
            return Some(
                "noisier pixels lie side by side or in every second line: parts of the sensor are read with more noise than others",
            );
        }
        let (found, std_err) = seen.steady_dn4?;
        (found + 2.0 * std_err < STAYS * stays).then_some(
            "pixels that are noisier in one dark set are not so in others: large deviations hit any pixel",
        )
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.01, 7.0 * plain.noise_e, 0.0, 0.0])
    }

    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        // The number of pixels stays, the jumps change.
        vec![values[0], values[1] * by, values[2], values[3]]
    }

    fn page(&self) -> Page {
        Page {
            what: "A trap in the source follower of a pixel catches and frees one electron: the pixel has two levels.",
            equation: "v +- amplitude / 2 in a share f of the pixels; their variance + amplitude^2 / 4; where amplitudes differ, exponentially over the pixels, on average amplitude^2 / 2",
            signature: "the noisiest pixels of darks jump between two levels, and stay at each for a frame or for seconds; bright frames hardly move",
            look_alikes: "pixels with more read noise than others scatter normally, and are part of every CMOS sensor; hot pixels have more variance too, but for their dark charge: it grows with the exposure",
            remedy: "list the pixels and replace them; a median over frames",
            measure: "a long run of short darks: the distribution of the pixels' variances",
            sets: takes::DARKS,
            source: "Wang, Rao, Mierop and Theuwissen 2006, IEDM; Janesick 2007; exponential amplitudes: Fantini et al. 2007, IEEE EDL 28, 1114",
        }
    }

    /// The fourth cumulant of +-a / 2 is -a^4 / 8, minus twice the square of its variance: sample variances
    /// of two levels scatter less than those of normal noise.
    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let (variance, square) = jump_moments(p);
        // E a^8 / (E a^4)^2 of an exponential distribution is 8! / 4!^2.
        let few = if amplitudes_differ(p) { 70.0 } else { 3.0 };
        for s in &mut out.sets {
            let spread = spread(p);
            s.unequal += spread;
            s.fourth -= 2.0 * p[0] * square;
            // The number of jumping pixels scatters by chance. Where darks show the distribution of the
            // pixels' noise, the fitted spread of the read noise absorbs it.
            if c.ordinary.is_none() {
                let pixels = (c.shape.0 * c.shape.1) as f64;
                s.unsure = libm::hypot(s.unsure, spread * libm::sqrt(few / (p[0] * pixels).max(1.0)));
            }
            s.read.add_white(p[0] * variance);
            s.two_levels =
                TwoLevels { share: p[0], variance, spread, stays: p[2], differ: amplitudes_differ(p) };
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let columns = d.image.ncols();
        for y in 0..d.image.nrows() {
            for x in 0..columns {
                let i = (y * columns + x) as u32;
                let mut own = d.random(self.id(), 0, i);
                if own.uniform() < p[0] {
                    let half = 0.5 * p[1] * if amplitudes_differ(p) { own.exponential() } else { 1.0 };
                    let up = level(d, self.id(), i, p[2]);
                    d.image[(y, x)] += if up { half } else { -half };
                }
            }
        }
    }
}

/// Maximum number of earlier frames in which a level is traced.
const BACK: u64 = 200;

/// Returns true if the pixel is at its upper level in this frame. The level is drawn anew with chance 1 -
/// |stays| and else kept (stays > 0) or inverted (stays < 0). The frame in which it was drawn last depends on
/// the frame's number alone, so frames may be drawn in any order.
fn level(d: &Drawing<'_>, id: &str, pixel: u32, stays: f64) -> bool {
    // Frame 0 is left out: its numbers selected the pixels.
    let mut turned = false;
    for frame in (d.frame.saturating_sub(BACK)..=d.frame).rev() {
        let mut random = d.random(id, frame + 1, pixel);
        let up = random.uniform() < 0.5;
        if stays == 0.0 || random.uniform() >= stays.abs() {
            return up != turned;
        }
        turned ^= stays < 0.0;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hundredth of the pixels jumps by 20 e, at 0.5 DN/e: their variances spread by 6.2 DN^4, of which
    /// four tenths may stay.
    #[test]
    fn what_any_pixel_has_is_no_telegraph_noise() {
        let seen = |steady_dn4| Seen { peak_e: 2000.0, peak_dn: 1000.0, steady_dn4, ..Seen::default() };
        let stands = |steady_dn4| {
            RandomTelegraphNoise.contradicted(&[0.01, 20.0, 0.0, 0.0], &[], &seen(steady_dn4)).is_none()
        };
        assert!((spread(&[0.01, 20.0, 0.0, 0.0]) * 0.5f64.powi(4) - 6.1875).abs() < 1e-9);
        assert!(stands(Some((6.0, 0.5))) && stands(Some((2.5, 0.5))) && stands(None));
        // Not known well enough, and known to be nothing.
        assert!(stands(Some((0.0, 1.0))) && !stands(Some((0.0, 0.5))));
        let alone = |together_dn4| {
            let all = Seen { together_dn4, ..seen(Some((6.0, 0.5))) };
            RandomTelegraphNoise.contradicted(&[0.01, 20.0, 0.0, 0.0], &[], &all).is_none()
        };
        assert!(alone(Some((0.5, 0.1))) && alone(Some((3.0, 1.0))) && !alone(Some((3.0, 0.5))));
    }
}
