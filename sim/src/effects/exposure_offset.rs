//! Exposure offset: the effective exposure is the commanded one plus a constant, or a whole number of steps.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Effective exposure to light: commanded + t0, or a whole number of steps.
pub struct ExposureOffset;

/// Shapes of whole steps: value of the parameter `shape`, part of a step added before truncation, and name.
const WHOLE: [(f64, f64, &str); 3] =
    [(1.0, 0.0, "cutting"), (2.0, 0.5, "rounding"), (3.0, 1.0, "rounding up")];

/// Part of a step by which a stated exposure may miss a whole number, due to rounding (a named choice).
const ROUNDING: f64 = 0.01;

/// Returns the part of a step added before truncation.
fn added(shape: f64) -> f64 {
    let added = WHOLE.iter().find(|w| w.0 == shape).map_or(0.0, |w| w.1);
    if added < 1.0 { added + ROUNDING } else { added - ROUNDING }
}

/// Returns the number of whole steps that a camera exposes for a commanded exposure: at least one. `shape` 1:
/// truncated to whole steps, 2: to the nearest, 3: up.
pub fn whole_steps(shape: f64, step_s: f64, exposure_s: f64) -> f64 {
    (exposure_s / step_s + added(shape)).floor().max(1.0)
}

/// Returns the shortest and longest step, s, with which an exposure has this number of steps
/// ([`whole_steps`]).
pub fn steps_of_a_number(shape: f64, number: f64, exposure_s: f64) -> (f64, f64) {
    let most = number - added(shape);
    let longest = if number > 1.0 && most > 0.0 { exposure_s / most } else { f64::INFINITY };
    (exposure_s / (number + 1.0 - added(shape)), longest)
}

/// Returns the time of light beyond the commanded exposure, s.
fn longer_s(p: &[f64], exposure_s: f64) -> f64 {
    match p {
        [shape, _, step_s] if *shape >= 1.0 => {
            if *step_s > 0.0 && exposure_s > 0.0 {
                whole_steps(*shape, *step_s, exposure_s) * step_s - exposure_s
            } else {
                0.0
            }
        }
        _ => p[T0],
    }
}

/// Indexes of the parameters.
const T0: usize = 1;
const STEP: usize = 2;

impl Effect for ExposureOffset {
    fn id(&self) -> &'static str {
        "exposure-offset"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["exposure time", "shutter delay", "exposure step", "exposure increment", "line time"]
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: a constant time, 1: cut to whole steps, 2: to the nearest whole step, 3: up to whole steps",
                unit: "choice",
                min: 0.0,
                max: 3.0,
                starts: &[0.0],
            },
            Parameter {
                name: "t0_s",
                meaning: "shape 0: effective less commanded exposure",
                unit: "s",
                min: -1.0,
                max: 1.0,
                starts: &[1e-6, -1e-6, 1e-4],
            },
            Parameter {
                name: "step_s",
                meaning: "shapes 1 to 3: step of the exposure",
                unit: "s",
                min: 0.0,
                max: 1.0,
                starts: &[],
            },
        ]
    }

    /// Defaults of models written before the parameters existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter != T0).then_some(0.0)
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        match parameter {
            T0 => p[0] < 1.0,
            STEP => p[0] >= 1.0,
            _ => true,
        }
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        (p[0] >= 1.0).then_some("exposures in whole steps")
    }

    /// Returns starts: constant times, and the steps that the levels of the flats follow.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let constant = self.parameters()[T0].starts.iter().map(|t0| vec![0.0, *t0, 0.0]);
        let steps = seen.exposure_steps.iter().flatten().map(|s| vec![s.shape, 0.0, s.step_s]);
        constant.chain(steps).collect()
    }

    /// Every step between two changes of an exposure's number of steps fits as well. If the light is not
    /// known either, no slope leads from one to the other.
    fn is_whole(&self, parameter: usize) -> bool {
        parameter == STEP
    }

    fn resolution(&self, parameter: usize, p: &[f64], seen: &Seen) -> f64 {
        let same = seen.exposure_steps.iter().flatten().find(|s| s.shape == p[0] && s.step_s == p[STEP]);
        if parameter == STEP { same.map_or(0.0, |s| s.std_err_s) } else { 0.0 }
    }

    fn needs(&self) -> Needs {
        Needs::Means
    }

    fn fits_as_well(&self, p: &[f64], seen: &Seen) -> Option<String> {
        let other = seen.exposure_steps.iter().flatten().find(|s| p[0] >= 1.0 && s.shape != p[0])?;
        let name = |shape: f64| WHOLE.iter().find(|w| w.0 == shape).map(|w| w.2);
        Some(format!(
            "{} exposures to steps of {:.5e} s fits as well as {} them to steps of {:.5e} s: short exposures in unequal steps tell which",
            name(other.shape)?,
            other.step_s,
            name(p[0])?,
            p[STEP]
        ))
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 5e-4 * plain.bright_s, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "The electronic shutter opens or closes a fixed time early or late, or the camera exposes for a whole number of steps (a row \
                   time, a tick of its clock) and the exposure that was asked for stands in the files.",
            equation: "effective exposure = commanded exposure + t0 (shape 0), or step * number, at least one step: the number cut off (1), rounded (2) \
                       or rounded up (3)",
            signature: "mean against exposure is a straight line that misses zero, in proportion to the light; of whole steps a staircase, whose \
                        deviations are of one size at short and at long exposures",
            look_alikes: "smear does the same on flats, but on a scene only in the columns through what is bright; a toe of the response near black takes the same from every light; lamp settings that do not come back \
                          scatter in proportion to the light",
            remedy: "write the exposure that the camera reads back into the files; add t0 to every exposure; vary the light at a fixed exposure",
            measure: "a still scene with a bright patch at a long and at a short exposure; of whole steps: flats at short exposures in unequal steps",
            sets: takes::SCENES,
            source: "EMVA 1288 release 4, section 6 (linearity by exposure time)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        super::smear::longer(|exposure_s| longer_s(p, exposure_s), c, out);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.scaled_add(longer_s(p, d.exposure_s), d.rate_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
