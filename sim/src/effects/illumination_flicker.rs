//! Illumination flicker: the lamp is a little brighter or darker in each frame.

use super::{
    Campaign, Drawing, Effect, MAINS_HZ, NO_TURN, ONE_EXPOSURE, Page, Parameter, Plain, Prediction, Seen,
    Stage, other_ripple, ripple_left, spread_of, takes,
};

/// Light of each frame times 1 + rel N(0, 1), or a lamp ripple sampled by exposures at random phase.
pub struct IlluminationFlicker;

/// Indexes of the parameters.
const REL: usize = 0;
const RIPPLE_HZ: usize = 1;

/// Returns the relative standard deviation of a frame's light at this exposure.
fn rel_at(p: &[f64], exposure_s: f64) -> f64 {
    p[REL] * ripple_left(p[RIPPLE_HZ], exposure_s).abs()
}

impl Effect for IlluminationFlicker {
    fn id(&self) -> &'static str {
        "illumination-flicker"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["flicker", "flickering", "lamp ripple"]
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
                name: "rel",
                meaning: "standard deviation of the light from frame to frame, relative",
                unit: "1",
                min: 0.0,
                // A lamp that is dark between the peaks of a sine has 1 / sqrt(2).
                max: 0.71,
                starts: &[0.002],
            },
            Parameter {
                name: "ripple_hz",
                meaning: "frequency of a ripple by which short exposures scatter like this, and longer ones less; 0: all alike",
                unit: "Hz",
                min: 0.0,
                max: 1e5,
                starts: &[],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter != RIPPLE_HZ || p[RIPPLE_HZ] > 0.0
    }

    /// Default of models written before the parameter existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == RIPPLE_HZ).then_some(0.0)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        (p[RIPPLE_HZ] > 0.0).then_some("the ripple of a lamp, which longer exposures average")
    }

    /// Starts at the ripple frequencies estimated from the scatter at several exposures, then at the mains
    /// frequencies.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let several = seen.lit_s.0 < ONE_EXPOSURE * seen.lit_s.1;
        let told = seen.flicker_hz.into_iter().flatten().chain(MAINS_HZ).filter(|_| several);
        std::iter::once(vec![0.002, 0.0]).chain(told.map(|hz| vec![0.02, hz])).collect()
    }

    /// A ripple too slow to decrease with the exposure is flicker at all exposures.
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        p[RIPPLE_HZ] > 0.0 && p[RIPPLE_HZ] * seen.lit_s.1 < NO_TURN
    }

    /// Returns a third of the distance to the farther of the two ripples that fit within three standard
    /// errors; amplitudes are converted to rms (divided by root 2).
    fn resolution(&self, parameter: usize, p: &[f64], seen: &Seen) -> f64 {
        let ripples = seen.flickers.filter(|_| p[RIPPLE_HZ] > 0.0);
        match parameter {
            REL => spread_of(ripples, |r| r.rel * std::f64::consts::FRAC_1_SQRT_2, p[REL]),
            _ => spread_of(ripples, |r| r.hz, p[RIPPLE_HZ]),
        }
    }

    fn shown_by(&self) -> Option<&'static str> {
        Some("variance of frame means")
    }

    fn fits_as_well(&self, p: &[f64], seen: &Seen) -> Option<String> {
        let others = other_ripple(seen.flickers.filter(|_| p[RIPPLE_HZ] > 0.0))?;
        let shown = 100.0 * rel_at(p, seen.lit_s.0);
        Some(format!("at {:.2} ms frames scatter by {shown:.2} %, and {others}", 1e3 * seen.lit_s.0))
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.003, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "The lamp, its supply or its shutter varies from frame to frame; all pixels alike.",
            equation: "light of a frame = mean light * (1 + rel N(0,1)), variance of frame means + (rel mu)^2; of a ripple of frequency f under the \
                       exposure T, met at any phase: light = mean light * (1 + sqrt(2) rel sinc(f T) cos(phase)), variance of frame means + \
                       (rel sinc(f T) mu)^2",
            signature: "scatter of the frame means in proportion to the light; nothing within a frame once its mean is taken off; on the mains less \
                        the longer the exposure, and none where it is a whole number of ripples",
            look_alikes: "gain noise looks the same without a light monitor, except that dark charge shares it",
            remedy: "a stabilised, DC-driven lamp; exposures of whole mains periods; a monitor diode",
            measure: "a run of flats with a photodiode beside the camera",
            sets: takes::REFERENCE,
            source: "EMVA 1288 release 4, section 6 (stability of the light source)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        for (s, info) in out.sets.iter_mut().zip(&c.sets) {
            let light = s.signal - out.base.dark_e_per_s * info.exposure_s;
            let light = if info.light.is_some() { light } else { 0.0 };
            let var = (rel_at(p, info.exposure_s) * light).powi(2);
            s.common += var;
            s.with_light += var;
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let mut random = d.random(self.id(), d.frame, 0);
        let at_random = if p[RIPPLE_HZ] > 0.0 {
            std::f64::consts::SQRT_2 * libm::cos(std::f64::consts::TAU * random.uniform())
        } else {
            random.normal()
        };
        let more = rel_at(p, d.exposure_s) * at_random * d.exposure_s;
        d.image.scaled_add(more, d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::super::FittingRipple;
    use super::*;

    /// Frames at any phase of a ripple scatter as predicted: 4000 under one exposure, within five standard
    /// errors of a sample variance of a sine (its fourth moment is 1.5 times the square of its second).
    #[test]
    fn frames_at_any_phase_scatter_as_predicted() {
        let (rate, frames, exposure_s, p) = (1e5, 4000u32, 0.004, [0.2, 100.0]);
        let rate_e_per_s = ndarray::Array2::from_elem((1, 1), rate);
        let nothing = ndarray::Array2::zeros((1, 1));
        let mut memory = super::super::Memory::new();
        let mut of_frame = |frame: u32| {
            let mut drawing = Drawing {
                image: ndarray::Array2::from_elem((1, 1), rate * exposure_s),
                rate_e_per_s: &rate_e_per_s,
                dark_e_per_s: &nothing,
                exposure_s,
                illumination: 1.0,
                setting: 0,
                time_s: 0.0,
                frame: u64::from(frame),
                seed: 31,
                full_scale_dn: 4095.0,
                offset_dn: 0.0,
                gain_dn_per_e: 1.0,
                read_noise_dn: 0.0,
                memory: &mut memory,
            };
            IlluminationFlicker.draw(&p, &mut drawing);
            drawing.image[[0, 0]] / (rate * exposure_s) - 1.0
        };
        let square = (0..frames).map(|k| of_frame(k).powi(2)).sum::<f64>() / f64::from(frames);
        let expected = rel_at(&p, exposure_s).powi(2);
        // sinc(0.4) is 0.757.
        assert!((expected.sqrt() - 0.2 * 0.757).abs() < 1e-4, "{expected}");
        assert!(
            (square / expected - 1.0).abs() < 5.0 * (0.5 / f64::from(frames)).sqrt(),
            "{square} for {expected}"
        );
    }

    #[test]
    fn ripples_that_fit_as_well_widen_the_error_and_are_said() {
        let ripples = [(100.0, 0.1), (350.0, 0.3)].map(|(hz, rel)| FittingRipple { hz, rel });
        let seen = Seen { flickers: Some(ripples), lit_s: (0.004, 0.05), ..Seen::default() };
        let p = [0.1 / std::f64::consts::SQRT_2, 100.0];
        assert!(
            (IlluminationFlicker.resolution(0, &p, &seen) - 0.2 / 3.0 / std::f64::consts::SQRT_2).abs()
                < 1e-12
        );
        assert!((IlluminationFlicker.resolution(1, &p, &seen) - 250.0 / 3.0).abs() < 1e-9);
        let said = IlluminationFlicker.fits_as_well(&p, &seen).unwrap();
        assert!(
            said.contains("at 4.00 ms frames scatter by 5.35 %") && said.contains("350 Hz with 30 %"),
            "{said}"
        );
        let all_alike = [0.1, 0.0];
        assert!(IlluminationFlicker.fits_as_well(&all_alike, &seen).is_none());
        assert!(IlluminationFlicker.resolution(0, &all_alike, &seen) == 0.0);
    }
}
