//! Effects missing from the paper's model. An effect is one file here and one line of `effects!` at the end.
//!
//! Each effect does two things that check each other: it draws (acts on a frame at its stage of the chain)
//! and it predicts (shifts the expected statistics of a campaign).

use crate::predict::{Campaign, Prediction};

/// Stage of the chain at which an effect acts, in the order in which the drawing (`draw.rs`) and the
/// prediction (`chain.rs`) run them. A new stage joins a range in both.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// On the light, before charge is counted.
    Light,
    /// On the charge in the pixels, after shot noise.
    Charge,
    /// On charge that is limited or spills: full well, blooming.
    Well,
    /// On charge that moves to the output: transfer, smear.
    Transfer,
    /// At read-out, after the read noise of the sensor is added, before the amplifier.
    Read,
    /// The amplifier, DN above the black level.
    Amplifier,
    /// The converter.
    Converter,
    /// In the camera, after conversion.
    Firmware,
}

impl Stage {
    /// Returns the name of the stage in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Charge => "charge generation and collection",
            Self::Well => "full well",
            Self::Transfer => "charge transfer",
            Self::Read => "read-out",
            Self::Amplifier => "amplifier",
            Self::Converter => "analogue-to-digital converter",
            Self::Firmware => "camera firmware",
        }
    }
}

/// A parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name, with the unit as a suffix if there is one.
    pub name: &'static str,
    /// Description in a few words; for a choice, the meaning of each value.
    pub meaning: &'static str,
    /// Unit; `1` for a ratio, `choice` for one of several forms.
    pub unit: &'static str,
    /// Smallest physical value.
    pub min: f64,
    /// Largest physical value.
    pub max: f64,
    /// Start values of a search, of several sizes; each is tried. Empty: the starts depend on the campaign
    /// ([`Effect::starts`]), and the parameter is not a size.
    pub starts: &'static [f64],
}

/// Data needed to tell an effect from others, in increasing order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Needs {
    /// A table of means at known exposures.
    Means,
    /// A table of means and variances.
    Variances,
    /// A table that has covariances of neighbours too.
    Covariances,
    /// Frames.
    Frames,
}

/// Observations of a campaign before any fit: hints for the start values of a search.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seen {
    /// Signal of the brightest frames, e.
    pub peak_e: f64,
    /// Signal of the brightest frames, DN above zero.
    pub peak_dn: f64,
    /// Highest code reached by many samples, DN above zero; parts of the field may be far brighter than its
    /// mean.
    pub highest_dn: f64,
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// Time from the first frame to the last, s.
    pub duration_s: f64,
    /// Typical time from frame to frame, s.
    pub frame_s: f64,
    /// Shortest and longest exposure to light, s.
    pub lit_s: (f64, f64),
    /// Rows.
    pub rows: f64,
    /// Columns.
    pub columns: f64,
    /// True if the mean is measured at three or more levels of known light.
    pub means: bool,
    /// Number of light levels with measured noise; a curve needs three or more.
    pub lit_levels: usize,
    /// Number of flat sets; a change with time shows between two or more.
    pub flat_sets: usize,
    /// True if covariances of neighbours are measured.
    pub neighbours: bool,
    /// Noise of darks, DN.
    pub dark_noise_dn: f64,
    /// Growth of the darks' mean with the exposure, e/s; 0 if the campaign does not show it.
    pub dark_e_per_s: f64,
    /// Correlation of the noise of successive frames in flats; `None` if it is zero within its error.
    pub successive: Option<f64>,
    /// Strongest line in the noise spectrum in read-out order, cycles per pixel.
    pub line_cycles_per_px: Option<f64>,
    /// Strongest frequency of column stripes that move from frame to frame, cycles per column.
    pub column_cycles: Option<f64>,
    /// Frequencies of the ripple in row means of flats, cycles per row, strongest first.
    pub row_cycles: [Option<f64>; 3],
    /// Lamp ripple frequencies that explain these bands, Hz, most likely first.
    pub ripple_hz: [Option<f64>; 3],
    /// Slowest and fastest ripple that fit these bands within three standard errors.
    pub ripples: Option<[FittingRipple; 2]>,
    /// Lamp ripple frequencies that explain the scatter of the frames, Hz, most likely first.
    pub flicker_hz: [Option<f64>; 3],
    /// Slowest and fastest ripple that fit this scatter within three standard errors.
    pub flickers: Option<[FittingRipple; 2]>,
    /// Steps of the exposure that the levels of the flats follow, the best of each shape.
    pub exposure_steps: [Option<ExposureStep>; 3],
    /// Number of codes per code that occurs, around the levels.
    pub code_step_dn: Option<f64>,
    /// Distance of the codes that occur if all lie on one regular grid, DN; else 1.
    pub stretch_dn: f64,
    /// A code on that grid, DN.
    pub stretch_zero_dn: f64,
    /// Covariance of the pixels' variances between short darks, and its standard error, DN^4: excess noise
    /// that stays with its pixels.
    pub steady_dn4: Option<(f64, f64)>,
    /// Covariance of the variances of pixels two columns or two rows apart, whichever is more significant,
    /// and its standard error, DN^4: noisy pixels that are parts of the sensor.
    pub together_dn4: Option<(f64, f64)>,
    /// Quantile 1/200 of the samples of the darks, from the black level, DN.
    pub darkest_dn: Option<f64>,
    /// Quantile 1/200 of the samples of the darks, as a code of the files, DN.
    pub darkest_code: Option<f64>,
}

/// Returns the share of a lamp ripple's amplitude that remains after an exposure, with its sign: sinc(f T),
/// since an exposure is a running mean (Bracewell 2000, The Fourier Transform and Its Applications, ch. 4).
pub fn ripple_left(ripple_hz: f64, exposure_s: f64) -> f64 {
    let x = std::f64::consts::PI * ripple_hz * exposure_s;
    if x < 1e-9 { 1.0 } else { libm::sin(x) / x }
}

/// Ripple frequencies of lamps on the mains: twice the mains frequency.
const MAINS_HZ: [f64; 2] = [100.0, 120.0];
/// Turns of a ripple within the longest exposure below which it does not fade with the exposure: it loses 2
/// in 100 of its strength.
const NO_TURN: f64 = 0.1;
/// Minimum ratio of the shortest exposure to the longest at which all count as one (a named choice).
const ONE_EXPOSURE: f64 = 0.9;
/// Maximum ratio of the fitting amplitudes at which the lamp's amplitude counts as known (a named choice).
const MAX_AMPLITUDE_RATIO: f64 = 1.5;

/// Describes the slowest and fastest fitting ripple if the exposures do not determine the lamp's.
fn other_ripple(ripples: Option<[FittingRipple; 2]>) -> Option<String> {
    let [slow, fast] = ripples.filter(|[slow, fast]| fast.rel > MAX_AMPLITUDE_RATIO * slow.rel)?;
    Some(format!(
        "these exposures do not tell the ripple of the lamp: {:.0} Hz with an amplitude of {:.3} % fits as well as {:.0} Hz with {:.0} %; shorter \
         exposures, in unequal steps, tell",
        slow.hz,
        100.0 * slow.rel,
        fast.hz,
        100.0 * fast.rel
    ))
}

/// Returns a third of the distance from a value to that of the farther of two ripples within three standard
/// errors; 0 without ripples.
fn spread_of(ripples: Option<[FittingRipple; 2]>, value: fn(&FittingRipple) -> f64, own: f64) -> f64 {
    ripples.iter().flatten().map(|r| (value(r) - own).abs() / 3.0).fold(0.0, f64::max)
}

/// Lamp ripple that fits the bands of a campaign, or the scatter of its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittingRipple {
    /// Frequency, Hz.
    pub hz: f64,
    /// Amplitude at this frequency, relative to the light.
    pub rel: f64,
}

/// Exposure step that the levels of a campaign's flats follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureStep {
    /// Rounding of exposures to whole steps: 1: down, 2: to the nearest, 3: up.
    pub shape: f64,
    /// Step, s: the middle of those that give every exposure the same number of steps.
    pub step_s: f64,
    /// Standard error of the step, s.
    pub std_err_s: f64,
}

impl Seen {
    /// Minimum number of light levels for a curve: a line through the darks takes up two.
    pub const MIN_CURVE_LEVELS: usize = 3;

    /// Returns true if the noise is measured at enough light levels for a curve.
    pub fn shows_a_curve(&self) -> bool {
        self.lit_levels >= Self::MIN_CURVE_LEVELS
    }

    /// Returns start values near the brightest level for a charge at which the range ends, e. Shading and
    /// noise reach some per cent above that level. A limit that only these reach needs steps as fine.
    fn near_peak(&self) -> Vec<Vec<f64>> {
        [1.0, 0.9, 0.97, 1.03, 1.06, 1.1, 1.15, 1.22, 1.3]
            .into_iter()
            .map(|part| vec![part * self.peak_e.max(1.0)])
            .filter(|start| !self.exceeds(start[0]))
            .collect()
    }

    /// Returns true if many samples hold far more charge than this, e, so that it is no full well.
    pub fn exceeds(&self, charge_e: f64) -> bool {
        self.highest_dn * self.peak_e > FAR_ABOVE * charge_e * self.peak_dn
    }
}

/// Reason why a charge is no full well.
const BRIGHTER_PIXELS: &str = "many samples hold far more charge than that, and are not cut off";

/// Maximum ratio of the brightest samples to a full well that noise and unequal pixels explain (a named
/// choice).
const FAR_ABOVE: f64 = 1.5;

impl Parameter {
    /// Returns true if the parameter selects one of several forms (its unit is `choice`). It is not fitted;
    /// every start is tried.
    pub fn is_choice(&self) -> bool {
        self.unit == "choice"
    }

    /// Returns true if the parameter may be 0, so that its value is the strength of the effect.
    pub fn is_size(&self) -> bool {
        self.min <= 0.0 && self.max >= 0.0 && !self.is_choice() && !self.starts.is_empty()
    }

    /// Returns the meaning without the prefix that names the choice (up to the colon).
    pub fn plain_meaning(&self) -> &'static str {
        let of_choice = |of: &str| of.starts_with("shape") && of.ends_with(|c: char| c.is_ascii_digit());
        self.meaning.split_once(": ").filter(|(of, _)| of_choice(of)).map_or(self.meaning, |(_, plain)| plain)
    }
}

/// A combination of parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Together {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Value.
    pub value: f64,
    /// Derivative with respect to each parameter.
    pub slopes: Vec<f64>,
    /// Model error if nothing tells the parts apart, per electron of the brightest signal.
    pub unsure_per_e: f64,
}

/// Camera data from which examples are derived.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plain {
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Signal near full scale, e.
    pub range_e: f64,
    /// Exposure that reaches this signal, s.
    pub bright_s: f64,
    /// Constant noise, e.
    pub noise_e: f64,
    /// Frame time, s.
    pub frame_s: f64,
    /// Rows.
    pub rows: f64,
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// Dark charge of the longest darks, 16 times the full exposure, e.
    pub long_dark_e: f64,
    /// Black level, DN.
    pub black_dn: f64,
}

impl Plain {
    /// Derives the data from a model.
    pub fn of(model: &crate::Model) -> Self {
        let gain = model.base.gain_dn_per_e;
        let range_e = 0.85 * f64::from(model.full_scale_dn()) / gain;
        let bright_s = range_e / (model.bench.photon_flux_per_s * model.base.quantum_efficiency).max(1e-9);
        Self {
            gain_dn_per_e: gain,
            range_e,
            bright_s,
            noise_e: libm::sqrt(model.constant_noise_var_dn2(0.0)) / gain,
            frame_s: bright_s + model.camera.readout_s,
            rows: f64::from(model.camera.height),
            full_scale_dn: f64::from(model.full_scale_dn()),
            long_dark_e: 16.0 * bright_s * model.base.dark_current_e_per_s,
            black_dn: model.base.black_level_dn,
        }
    }
}

/// Description of an effect for its page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Page {
    /// Mechanism, in a sentence or two.
    pub what: &'static str,
    /// Equation used here.
    pub equation: &'static str,
    /// Statistics that change, and the change.
    pub signature: &'static str,
    /// Differences from effects that look similar.
    pub look_alikes: &'static str,
    /// Remedies, the first one first, separated by semicolons.
    pub remedy: &'static str,
    /// Measurement that separates it from its look-alikes.
    pub measure: &'static str,
    /// Sets of frames for that measurement: one of [`takes`].
    pub sets: &'static [Take],
    /// Reference.
    pub source: &'static str,
}

/// Set of frames to capture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Take {
    /// Scene before the camera; `None`: no light.
    pub scene: Option<crate::Scene>,
    /// Frames.
    pub frames: u32,
    /// Exposure, relative to the one that brings the card close to full scale.
    pub exposure: f64,
    /// Light, relative.
    pub light: f64,
}

/// Measurements that separate effects from their look-alikes.
pub mod takes {
    use super::Take;
    use crate::Scene;

    const fn dark(frames: u32, exposure: f64) -> Take {
        Take { scene: None, frames, exposure, light: 0.0 }
    }
    const fn flat(frames: u32, exposure: f64, light: f64) -> Take {
        Take { scene: Some(Scene::Card), frames, exposure, light }
    }
    const fn scene(exposure: f64) -> Take {
        Take { scene: Some(Scene::Patch), frames: 32, exposure, light: 1.0 }
    }

    /// Many short darks, and as many bright flats to compare them with.
    pub const DARKS: &[Take] = &[dark(128, 0.02), flat(32, 1.0, 0.5), dark(32, 1.0), flat(32, 1.0, 1.0)];
    /// Exposures in small steps up to full scale at one light, and one light level against another at one
    /// exposure.
    pub const SWEEP: &[Take] = &[
        dark(32, 0.02),
        flat(16, 0.1, 1.0),
        flat(16, 0.2, 1.0),
        flat(16, 0.3, 1.0),
        flat(16, 0.4, 1.0),
        flat(16, 0.5, 1.0),
        flat(16, 0.6, 1.0),
        flat(16, 0.7, 1.0),
        flat(16, 0.8, 1.0),
        flat(16, 0.9, 1.0),
        flat(16, 1.0, 1.0),
        flat(16, 1.05, 1.0),
        flat(16, 1.0, 0.5),
        flat(16, 0.5, 0.5),
        dark(32, 1.0),
    ];
    /// Many frames at few levels: covariances of neighbours against the mean.
    pub const PAIRS: &[Take] = &[
        dark(64, 0.02),
        flat(64, 0.1, 1.0),
        flat(64, 0.3, 1.0),
        flat(64, 0.6, 1.0),
        flat(64, 0.95, 1.0),
        dark(64, 1.0),
    ];
    /// From bright to dark and back, over and over.
    pub const TRANSITIONS: &[Take] = &[
        dark(64, 0.02),
        flat(8, 1.0, 1.0),
        dark(8, 1.0),
        flat(8, 1.0, 1.0),
        dark(8, 1.0),
        flat(8, 1.0, 1.0),
        dark(8, 1.0),
        flat(8, 1.0, 1.0),
        dark(8, 1.0),
        flat(64, 1.0, 0.5),
    ];
    /// One level over and over, and a dimmer one.
    pub const REFERENCE: &[Take] = &[dark(16, 1.0), flat(128, 1.0, 0.8), flat(128, 1.0, 0.2), dark(16, 1.0)];
    /// Long darks at start and end, with a reference between.
    pub const LONG: &[Take] = &[
        dark(16, 16.0),
        flat(32, 1.0, 0.5),
        dark(16, 0.02),
        flat(64, 1.0, 0.9),
        flat(32, 1.0, 0.5),
        dark(16, 0.02),
        dark(16, 16.0),
    ];
    /// A still scene with a bright patch, at several exposures.
    pub const SCENES: &[Take] =
        &[dark(32, 0.02), flat(16, 0.5, 1.0), scene(1.0), scene(0.5), scene(0.25), scene(0.1), dark(16, 1.0)];
}

/// An effect.
pub trait Effect: Sync + Send {
    /// Identifier, as in `[[effect]] id = "..."`.
    fn id(&self) -> &'static str;
    /// Synonyms, in lower case.
    fn also_called(&self) -> &'static [&'static str] {
        &[]
    }
    /// Returns the stage of the chain at which it acts.
    fn stage(&self) -> Stage;
    /// Returns the stage for these values, if a choice among the parameters decides it.
    fn stage_with(&self, _values: &[f64]) -> Stage {
        self.stage()
    }
    /// Returns the parameters.
    fn parameters(&self) -> &'static [Parameter];
    /// Returns the entry of a model file that can be read without the effect, for an effect of formulas.
    fn written(&self) -> Option<crate::EffectValues> {
        None
    }
    /// Returns true if a fit keeps the sign of the parameters: positive and negative values are two forms of
    /// the effect, and the statistics have a kink between them. Every combination of signs is tried.
    fn keeps_sign(&self) -> bool {
        false
    }
    /// Returns the data that a campaign must have for a search of the effect.
    fn needs(&self) -> Needs {
        Needs::Frames
    }
    /// Returns the start values of a search: lists of all parameters, each of which is tried. A start must
    /// change the prediction: an effect that changes nothing measured is not searched for.
    fn starts(&self, _seen: &Seen) -> Vec<Vec<f64>> {
        let parameters = self.parameters();
        let tries = parameters.iter().map(|p| p.starts.len()).max().unwrap_or(1);
        let of =
            |p: &Parameter, k: usize| p.starts.get(k).or(p.starts.last()).copied().unwrap_or(p.min.max(0.0));
        (0..tries).map(|k| parameters.iter().map(|p| of(p, k)).collect()).collect()
    }
    /// Returns true if a fitted spread of the read noise absorbs most of the effect. A fit with the effect
    /// then starts at a lower read noise, since no slope leads there.
    fn read_noise_absorbs_it(&self) -> bool {
        false
    }
    /// Returns the standard error of a parameter beyond that of the fit, in its own unit: from values that
    /// give the same codes, or fit this campaign as well.
    fn resolution(&self, _parameter: usize, _p: &[f64], _seen: &Seen) -> f64 {
        0.0
    }
    /// Returns true if a parameter is a whole number that the codes show. Its starts are tried one by one,
    /// and it is not fitted.
    fn is_whole(&self, _parameter: usize) -> bool {
        false
    }
    /// Returns true if a parameter matters for the choices in these values.
    fn uses(&self, _p: &[f64], _parameter: usize) -> bool {
        true
    }
    /// Returns a redundant direction in the parameters: a move along it changes no code of a camera of this
    /// full scale. Fits keep the values orthogonal to it.
    fn redundant(&self, _p: &[f64], _full_scale_dn: f64) -> Option<Vec<f64>> {
        None
    }
    /// Describes the form that the choices select.
    fn form(&self, _p: &[f64]) -> Option<&'static str> {
        None
    }
    /// Returns a combination of parameters that may be known where single ones are not.
    fn together(&self, _p: &[f64]) -> Option<Together> {
        None
    }
    /// Returns sizes that the frames of a campaign show: one of them may be known where no parameter alone
    /// is.
    fn in_frames(&self, p: &[f64], _seen: &Seen) -> Vec<Together> {
        self.together(p).into_iter().collect()
    }
    /// Returns twice the logarithm of how many times rarer the effect is than its look-alikes. Of two that a
    /// campaign cannot tell apart, the more common one ranks first.
    fn rarer(&self) -> f64 {
        0.0
    }
    /// Returns true if frames depend on earlier frames; the exposures before the first frame are then
    /// unknown.
    fn has_memory(&self) -> bool {
        false
    }
    /// Returns the number of frames after which nothing is left of a level; `None`: a remainder always stays.
    fn forgets_after(&self, _p: &[f64]) -> Option<usize> {
        None
    }
    /// Returns the default of a parameter to draw with if a model gives no value; `None`: a value is
    /// required.
    fn usual(&self, _parameter: usize) -> Option<f64> {
        None
    }
    /// Returns true if these values are a limit of the shape at which the effect is another one.
    fn is_another(&self, _p: &[f64], _seen: &Seen) -> bool {
        false
    }
    /// Returns the contradiction between the campaign and the effect at these values and standard errors. The
    /// effect may fit, but its name is then not given.
    fn contradicted(&self, _p: &[f64], _std_err: &[f64], _seen: &Seen) -> Option<&'static str> {
        None
    }
    /// Describes other values that fit the campaign as well; `None` if the campaign tells them apart.
    fn fits_as_well(&self, _p: &[f64], _seen: &Seen) -> Option<String> {
        None
    }
    /// Returns the values of the forms with the same means and another noise. Each implies another gain, and
    /// few frames do not tell them apart.
    fn forms_with_same_means(&self, _p: &[f64]) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// Returns true if darks alone can show the effect.
    fn shows_in_darks(&self) -> bool {
        matches!(self.stage(), Stage::Read | Stage::Converter | Stage::Firmware)
    }
    /// Returns true if the lamp and not the camera has the effect.
    fn is_of_the_lamp(&self) -> bool {
        false
    }
    /// Returns true if the effect changes the level of flats of one light with time.
    fn is_drift_of_level(&self) -> bool {
        false
    }
    /// Returns true if the effect gives each set a light of its own; else the light stays until another level
    /// is set.
    fn sets_each(&self) -> bool {
        false
    }
    /// Returns true if the effect with these values depends on the times of frames.
    fn is_in_time(&self, _: &[f64]) -> bool {
        false
    }
    /// Returns true if the effect bends the mean over the light, so that noise alone cannot show it.
    fn bends_means(&self) -> bool {
        false
    }
    /// Returns true if the effect adds scatter, which makes standard errors larger.
    fn adds_scatter(&self) -> bool {
        !self.bends_means()
    }
    /// Returns the statistic that is the effect's scatter itself. The effect is excluded if less is measured
    /// than it would cause, though its scatter may excuse other deviations.
    fn shown_by(&self) -> Option<&'static str> {
        None
    }
    /// Returns the statistics that tell the effect from its look-alikes, by their names in the code. The name
    /// of the effect is not given if they deviate with it.
    fn told_by(&self) -> &'static [&'static str] {
        &[]
    }
    /// Returns values that are plain to see in a campaign of the standard plan; `None` if flats, darks and a
    /// scene of unknown contrast do not show the effect.
    fn example(&self, plain: &Plain) -> Option<Vec<f64>>;
    /// Multiplies the strength of the values by `by`, within the bounds.
    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        let of = |(v, p): (&f64, &Parameter)| if p.is_size() { (v * by).clamp(p.min, p.max) } else { *v };
        values.iter().zip(self.parameters()).map(of).collect()
    }
    /// Returns the description for its page.
    fn page(&self) -> Page;
    /// Shifts the expected statistics. `p` are the values of [`parameters`](Self::parameters).
    fn predict(&self, p: &[f64], campaign: &Campaign, out: &mut Prediction);
    /// Applies the effect to a frame.
    fn draw(&self, p: &[f64], frame: &mut Drawing<'_>);
}

/// A frame on its way through the chain.
///
/// `image` holds the expected charge (e) at [`Stage::Light`], charge (e) until the amplifier, DN above the
/// black level until the end of [`Stage::Converter`], and DN with the black level at [`Stage::Firmware`].
#[derive(Debug)]
pub struct Drawing<'a> {
    /// The frame, (rows, columns).
    pub image: ndarray::Array2<f64>,
    /// Electrons per second from the light, (rows, columns).
    pub rate_e_per_s: &'a ndarray::Array2<f64>,
    /// Dark charge per second, e/s, (rows, columns).
    pub dark_e_per_s: &'a ndarray::Array2<f64>,
    /// Exposure, s.
    pub exposure_s: f64,
    /// Light relative to the bench's unit.
    pub illumination: f64,
    /// Number of the setting of light and exposure, counted from the first.
    pub setting: u64,
    /// Time, s.
    pub time_s: f64,
    /// Number of the frame.
    pub frame: u64,
    /// Seed of the noise.
    pub seed: u64,
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// Black level at zero exposure, DN; the image counts from it before conversion.
    pub offset_dn: f64,
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Read noise, root mean square over the pixels, DN.
    pub read_noise_dn: f64,
    /// Images kept from frame to frame, by the identifier of the effect.
    pub memory: &'a mut Memory,
}

/// Images that effects keep from frame to frame.
pub type Memory = std::collections::BTreeMap<&'static str, ndarray::Array2<f64>>;

impl Drawing<'_> {
    /// Returns the random stream of an effect: the same for the same frame, effect and index.
    pub fn random(&self, effect: &str, frame: u64, index: u32) -> crate::rng::PixelRng {
        let tag = effect.bytes().fold(17u32, |h, b| h.wrapping_mul(31).wrapping_add(u32::from(b)));
        crate::rng::PixelRng::new(self.seed, crate::rng::Stream::Effect, frame, index, tag & 0x7fff_fff0)
    }

    /// Adds one normal number of standard deviation `sd` to each row (axis 0) or column (axis 1).
    pub fn add_to_lines(&mut self, effect: &str, axis: usize, sd: f64) {
        for i in 0..self.image.len_of(ndarray::Axis(axis)) {
            let e = sd * self.random(effect, self.frame, i as u32).normal();
            self.image.index_axis_mut(ndarray::Axis(axis), i).mapv_inplace(|v| v + e);
        }
    }

    /// Returns the image shifted by whole pixels; the border is repeated.
    pub fn shifted(&self, dy: i32, dx: i32) -> ndarray::Array2<f64> {
        shifted(&self.image, dy, dx)
    }
}

/// Returns an image moved down by `dy` and right by `dx`; the border is repeated.
pub fn shifted(image: &ndarray::Array2<f64>, dy: i32, dx: i32) -> ndarray::Array2<f64> {
    let (rows, columns) = image.dim();
    let at = |i: usize, d: i32, n: usize| (i as i64 - i64::from(d)).clamp(0, n as i64 - 1) as usize;
    ndarray::Array2::from_shape_fn((rows, columns), |(y, x)| image[(at(y, dy, rows), at(x, dx, columns))])
}

mod chain;
mod custom;
mod own;
pub use chain::{Chain, predict};
pub use custom::{Described, TARGETS, UNBOUNDED, custom};
pub use exposure_offset::{steps_of_a_number, whole_steps};
pub use own::{OwnEffect, OwnPage};

macro_rules! effects {
    ($($module:ident::$name:ident)*) => {
        $(mod $module;)*
        /// Every effect of the catalogue.
        pub static EFFECTS: &[&dyn Effect] = &[$(&$module::$name),*];
    };
}

effects! {
    nonlinearity::Nonlinearity
    brighter_fatter::BrighterFatter
    interpixel_crosstalk::InterpixelCrosstalk
    readout_lowpass::ReadoutLowpass
    spatial_filter::SpatialFilter
    temporal_filter::TemporalFilter
    image_lag::ImageLag
    illumination_setting::IlluminationSetting
    illumination_flicker::IlluminationFlicker
    illumination_drift::IlluminationDrift
    light_banding::LightBanding
    gain_drift::GainDrift
    offset_noise::OffsetNoise
    offset_drift::OffsetDrift
    black_level_clamp::BlackLevelClamp
    dark_current_drift::DarkCurrentDrift
    row_noise::RowNoise
    column_noise::ColumnNoise
    column_gain_noise::ColumnGainNoise
    read_noise_correlation::ReadNoiseCorrelation
    periodic_interference::PeriodicInterference
    random_telegraph_noise::RandomTelegraphNoise
    adc_nonlinearity::AdcNonlinearity
    charge_transfer_inefficiency::ChargeTransferInefficiency
    smear::Smear
    exposure_offset::ExposureOffset
    full_well_saturation::FullWellSaturation
    black_clipping::BlackClipping
    stray_light::StrayLight
    tap_mismatch::TapMismatch
    blooming::Blooming
    coarse_quantization::CoarseQuantization
    companding::Companding
}

/// Effects registered by the program.
static OWN: std::sync::RwLock<Vec<&'static dyn Effect>> = std::sync::RwLock::new(Vec::new());

/// Registers a user's effect for the lifetime of the program: models may name it, and a diagnosis tries it as
/// well.
///
/// `examples/row-gain-noise` is a program with an effect of its own.
///
/// # Errors
///
/// An effect with this identifier exists already; the message names it.
pub fn register(effect: &'static dyn Effect) -> Result<(), String> {
    let mut own = OWN.write().unwrap_or_else(std::sync::PoisonError::into_inner);
    let taken = EFFECTS.iter().chain(own.iter()).any(|e| e.id() == effect.id());
    if taken || effect.id() == "custom" {
        return Err(format!("there is an effect \"{}\" already", effect.id()));
    }
    own.push(effect);
    Ok(())
}

/// Unregisters a user's effect. Returns false if there was none with this identifier.
pub fn unregister(id: &str) -> bool {
    let mut own = OWN.write().unwrap_or_else(std::sync::PoisonError::into_inner);
    let before = own.len();
    own.retain(|e| e.id() != id);
    own.len() < before
}

/// Returns every effect, registered ones last.
pub fn all() -> Vec<&'static dyn Effect> {
    let own = OWN.read().unwrap_or_else(std::sync::PoisonError::into_inner);
    EFFECTS.iter().chain(own.iter()).copied().collect()
}

/// Identifiers of effects excluded from searches.
static LEFT_OUT: std::sync::RwLock<Vec<String>> = std::sync::RwLock::new(Vec::new());

/// Excludes an effect from every search for the lifetime of the program; models may still name it.
pub fn leave_out(id: &str) {
    LEFT_OUT.write().unwrap_or_else(std::sync::PoisonError::into_inner).push(id.into());
}

/// Returns every effect that a search considers, registered ones last.
pub fn considered() -> Vec<&'static dyn Effect> {
    let left_out = LEFT_OUT.read().unwrap_or_else(std::sync::PoisonError::into_inner);
    all().into_iter().filter(|e| left_out.iter().all(|id| id != e.id())).collect()
}

/// Finds an effect by its identifier.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    all().into_iter().find(|e| e.id() == id)
}

/// [`Effect::example`] of an effect for a camera.
pub fn example(id: &str, model: &crate::Model) -> Option<Vec<f64>> {
    find(id)?.example(&Plain::of(model))
}
