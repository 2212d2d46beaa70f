//! Light banding: a rolling shutter under a lamp that ripples.

use super::{
    Campaign, Drawing, Effect, MAINS_HZ, NO_TURN, ONE_EXPOSURE, Page, Parameter, Plain, Prediction, Seen,
    Stage, Together, other_ripple, ripple_left, spread_of, takes,
};
use crate::predict::Ripple;

/// Light factor common to a row, which changes down the image and from frame to frame.
pub struct LightBanding;

/// Minimum correlation of random light changes from row to row. Rows are read some 10 us apart: lamps do not
/// decorrelate within six rows.
const SHORTEST: f64 = 0.85;

/// Correlation of the first row with the last above which light changes move whole frames: 1/e, of random
/// ones bands as tall as the frame, of a sine those of a fifth of a period (a named choice).
const WHOLE_FRAMES: f64 = 0.368;

/// Error of the number of periods in a frame that sees less than one (a named choice: of eight lamps so slow
/// among 40 that `bands_of_many_lamps` draws the largest deviations are 0.2, 0.13 and 0.07).
const PART_OF_PERIOD: f64 = 0.08;

/// Minimum ripple frequency of a lamp: twice the frequency of the slowest supply, a railway's 16.7 Hz.
const SLOWEST_HZ: f64 = 33.0;
/// Step between tried ripple frequencies, in cycles per longest exposure.
const LOBE: f64 = 0.3;
/// Number of tried ripple frequencies. They reach 21 cycles per longest exposure; a PWM lamp makes about 20.
const LOBES: u32 = 70;

impl Effect for LightBanding {
    fn id(&self) -> &'static str {
        "light-banding"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["banding", "bands", "stripes", "rolling shutter"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn is_of_the_lamp(&self) -> bool {
        true
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: a sine, 1: a wander from row to row",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
            Parameter {
                name: "rel",
                meaning: "amplitude of the ripple, of a wander its standard deviation, relative to the light",
                unit: "1",
                min: 0.0,
                max: 1.0,
                starts: &[0.003],
            },
            Parameter {
                name: "cycles_per_row",
                meaning: "shape 0: periods of the ripple in one row time",
                unit: "1/px",
                min: 1e-4,
                max: 0.5,
                starts: &[],
            },
            Parameter {
                name: "ripple_hz",
                meaning: "shape 0: frequency of the ripple",
                unit: "Hz",
                min: 0.0,
                max: 1e5,
                starts: &[],
            },
            Parameter {
                name: "next_row",
                meaning: "shape 1: correlation from row to row",
                unit: "1",
                min: SHORTEST,
                max: 0.9999,
                starts: &[],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter < 2 || (parameter == 4) == (p[0] >= 0.5)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(if p[0] >= 0.5 { "a slow wander down the rows" } else { "a sine down the rows" })
    }

    /// Returns starts at the peaks of the spectrum of the row means, then at fixed frequencies. Each is
    /// combined with the ripple frequencies estimated from the exposure series. Without an estimate: slow
    /// ripples (0.2 and 1 cycle per frame); peaks also with mains ripple and with a series of ripples closer
    /// than a lobe of sinc(f T), since a fit does not cross from one lobe to the next.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let rows = seen.rows.max(2.0);
        let per_image = [0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5, 6.5, 10.0, 15.0].map(|n| n / rows);
        let peaks = seen.row_cycles.into_iter().flatten().filter(|f| *f > 1e-4);
        let lines = |cycles: f64, hz: &[f64]| -> Vec<Vec<f64>> {
            hz.iter().map(|hz| vec![0.0, 0.003, cycles, *hz, 0.0]).collect()
        };
        let told: Vec<f64> = seen.ripple_hz.into_iter().flatten().collect();
        let (of_peaks, of_others) = if seen.lit_s.0 > ONE_EXPOSURE * seen.lit_s.1 {
            // Frequency and amplitude are degenerate at one exposure: 0 Hz gives the amplitude in the frames.
            (vec![0.0], vec![0.0])
        } else if told.is_empty() {
            let [slow, fast] = [0.2, 1.0].map(|turns| turns / seen.frame_s.max(1e-5));
            let lobes = (1..=LOBES).map(|k| f64::from(k) * LOBE / seen.lit_s.1.max(1e-5));
            ([slow, fast, MAINS_HZ[0], MAINS_HZ[1]].into_iter().chain(lobes).collect(), vec![slow, fast])
        } else {
            (told.clone(), told[..1].to_vec())
        };
        let mut all: Vec<Vec<f64>> = peaks.filter(|f| *f < 0.5).flat_map(|f| lines(f, &of_peaks)).collect();
        all.extend(per_image.into_iter().filter(|f| *f < 0.5).flat_map(|f| lines(f, &of_others)));
        all.extend([0.92, 0.97, 0.99].map(|next| vec![1.0, 0.003, 0.01, 0.0, next]));
        all
    }

    /// Light common to all rows of a frame is flicker; light common to adjacent rows only does not come from
    /// a lamp.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        if p[0] >= 0.5 {
            libm::pow(p[4], seen.rows) > WHOLE_FRAMES || p[4] < 1.001 * SHORTEST
        } else {
            let periods = p[2] * seen.rows;
            periods < 0.25 && libm::cos(std::f64::consts::TAU * periods) > WHOLE_FRAMES
        }
    }

    fn contradicted(&self, p: &[f64], _: &[f64], seen: &Seen) -> Option<&'static str> {
        let (shortest_s, longest_s) = seen.lit_s;
        // Informative exposures: the longest is at least half a ripple period of a lamp, and one is far
        // shorter.
        let tells = longest_s * SLOWEST_HZ > 0.5 && shortest_s < 0.5 * longest_s;
        let stays = p[0] < 0.5 && p[3] * longest_s < NO_TURN;
        (tells && stays).then_some(
            "the bands are as strong at the longest exposure as at the shortest: no lamp ripples so slowly",
        )
    }

    /// Returns a third of the distance to the farther of the two ripples that fit within three standard
    /// errors. Where a frame sees less than a period, its few phases decide on frequency and amplitude, which
    /// only their product tells.
    fn resolution(&self, parameter: usize, p: &[f64], seen: &Seen) -> f64 {
        let ripples = seen.ripples.filter(|_| p[0] < 0.5);
        let periods = p[2] * seen.rows;
        let partly_seen = if p[0] < 0.5 && periods < 1.0 { PART_OF_PERIOD / periods.max(0.1) } else { 0.0 };
        match parameter {
            1 => spread_of(ripples, |r| r.rel, p[1]).hypot(partly_seen * p[1]),
            2 => partly_seen * p[2],
            3 => spread_of(ripples, |r| r.hz, p[3]),
            _ => 0.0,
        }
    }

    /// Returns the amplitude of a sine at the shortest and at the longest exposure: under exposures of many
    /// periods a larger ripple of another frequency leaves as much.
    fn in_frames(&self, p: &[f64], seen: &Seen) -> Vec<Together> {
        let step_hz = 1e-4 * p[3];
        if p[0] >= 0.5 || step_hz <= 0.0 || !seen.lit_s.0.is_finite() {
            return Vec::new();
        }
        let of = |exposure_s: f64| {
            let left = |hz: f64| ripple_left(hz, exposure_s).abs();
            let slope = (left(p[3] + step_hz) - left(p[3] - step_hz)) / (2.0 * step_hz);
            Together {
                name: "rel * |sinc(f T)|",
                unit: "1",
                value: p[1] * left(p[3]),
                slopes: vec![0.0, left(p[3]), 0.0, p[1] * slope, 0.0],
                unsure_per_e: 0.0,
            }
        };
        [seen.lit_s.0, seen.lit_s.1].map(of).into()
    }

    fn fits_as_well(&self, p: &[f64], seen: &Seen) -> Option<String> {
        let others = other_ripple(seen.ripples.filter(|_| p[0] < 0.5))?;
        let shown = 100.0 * p[1] * ripple_left(p[3], seen.lit_s.0).abs();
        Some(format!("at {:.2} ms bands are {shown:.3} % of the signal, and {others}", 1e3 * seen.lit_s.0))
    }

    /// A light field of varying shape correlates columns as well.
    fn told_by(&self) -> &'static [&'static str] {
        &["covariance of column means", "variance of column means", "variance of frame gradients"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.004, 3.2 / plain.rows, 0.6 / plain.bright_s, 0.97])
    }

    fn page(&self) -> Page {
        Page {
            what: "The shutter rolls down the rows while the lamp's light ripples: bands run through flats, at another place in each frame.",
            equation: "light of row y = mean light * (1 + rel sinc(f T) sin(2 pi cycles y + phase)), the phase another in every frame, T the \
                       exposure, f the ripple's frequency; or a wander with the correlation next_row from row to row",
            signature: "row means of flats scatter in proportion to the signal, neighbouring rows alike; gone in darks, and for a sine where the \
                        exposure is a whole number of ripples",
            look_alikes: "row noise is the same in darks, and its rows are independent",
            remedy: "a DC-driven lamp; exposures of whole mains periods; a global shutter",
            measure: "flats at short exposures and bright light, and at whole mains periods",
            sets: takes::SWEEP,
            source: "Janesick 2007; flicker detection in rolling shutters: Sheinin et al. 2017, CVPR, Computational imaging on the electric grid",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for ((s, light), info) in out.sets.iter_mut().zip(&out.light_e).zip(&c.sets) {
            let ripple = if p[0] >= 0.5 {
                ((p[1] * light).powi(2), Ripple::Wander(p[4]))
            } else {
                (0.5 * (p[1] * light * ripple_left(p[3], info.exposure_s)).powi(2), Ripple::Sine(p[2]))
            };
            s.ripples.push(ripple);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let turn = std::f64::consts::TAU;
        let rows = d.image.nrows();
        let mut random = d.random(self.id(), d.frame, 0);
        let factors: Vec<f64> = if p[0] >= 0.5 {
            let mut now = random.normal();
            let fresh = libm::sqrt(1.0 - p[4] * p[4]);
            let wander = |y: usize| {
                if y > 0 {
                    now = p[4] * now + fresh * d.random(self.id(), d.frame, y as u32).normal();
                }
                p[1] * now
            };
            (0..rows).map(wander).collect()
        } else {
            let phase = turn * random.uniform();
            let size = p[1] * ripple_left(p[3], d.exposure_s);
            (0..rows).map(|y| size * libm::sin(turn * p[2] * y as f64 + phase)).collect()
        };
        for ((mut row, rate), factor) in
            d.image.outer_iter_mut().zip(d.rate_e_per_s.outer_iter()).zip(factors)
        {
            row.scaled_add(factor * d.exposure_s, &rate);
        }
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::super::FittingRipple;
    use super::*;

    #[test]
    fn ripples_that_fit_as_well_widen_the_error_and_are_said() {
        let [slow, fast] = [(300.0, 0.01), (2700.0, 0.1)].map(|(hz, rel)| FittingRipple { hz, rel });
        let seen = Seen { ripples: Some([slow, fast]), lit_s: (0.002, 0.01), rows: 480.0, ..Seen::default() };
        let p = [0.0, 0.01, 0.02, 300.0, 0.0];
        let errors: Vec<f64> = (0..5).map(|k| LightBanding.resolution(k, &p, &seen)).collect();
        assert!((errors[1] - 0.03).abs() < 1e-12 && (errors[3] - 800.0).abs() < 1e-9, "{errors:?}");
        assert!(errors[2] == 0.0);
        // Half a period in the frame.
        let few_rows = Seen { rows: 25.0, ..seen };
        let errors: Vec<f64> = (1..3).map(|k| LightBanding.resolution(k, &p, &few_rows)).collect();
        assert!((errors[0] - 0.03f64.hypot(0.0016)).abs() < 1e-12 && (errors[1] - 0.0032).abs() < 1e-12);
        let said = LightBanding.fits_as_well(&p, &seen).unwrap();
        // sinc(0.6) is 0.505.
        assert!(
            said.contains("at 2.00 ms bands are 0.505 %") && said.contains("2700 Hz with 10 %"),
            "{said}"
        );
        let near =
            Seen { ripples: Some([slow, FittingRipple { hz: 302.0, rel: 0.0102 }]), ..Seen::default() };
        assert!(LightBanding.fits_as_well(&p, &near).is_none());
        let wander = [1.0, 0.01, 0.02, 300.0, 0.97];
        assert!(
            LightBanding.fits_as_well(&wander, &seen).is_none()
                && LightBanding.resolution(1, &wander, &seen) == 0.0
        );
    }

    #[test]
    fn a_ripple_that_does_not_fade_is_no_lamps() {
        let stands = |hz: f64, longest_s: f64| {
            let seen = Seen { lit_s: (1e-3, longest_s), rows: 480.0, ..Seen::default() };
            LightBanding.contradicted(&[0.0, 0.003, 0.01, hz, 0.0], &[], &seen).is_none()
        };
        assert!(stands(100.0, 0.02) && !stands(0.0, 0.02));
        // Exposures too short to distinguish ripples.
        assert!(stands(0.0, 0.002));
    }
}
