//! Effects that the paper's model lacks. An effect is one file here and one line of `effects!` at the end.
//!
//! Each does two things that check each other: it draws (acts on a frame at its place in the chain) and it predicts (shifts
//! the expected statistics of a campaign).

use crate::predict::{Campaign, Prediction};

/// Where in the chain an effect acts, in the order in which light travels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// On the light, before charge is counted.
    Light,
    /// On the charge in the pixels, after shot noise.
    Charge,
    /// On the charge that the wells hold, once all of it has come.
    Well,
    /// While the charge is moved.
    Transfer,
    /// Noise added at read-out, before the amplifier.
    Read,
    /// The amplifier, DN above the black level.
    Amplifier,
    /// The converter.
    Converter,
    /// In the camera, after conversion.
    Firmware,
}

impl Stage {
    /// In words.
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
    /// Its name, with the unit in it where it has one.
    pub name: &'static str,
    /// What it is, in a few words; of a choice what each value means.
    pub meaning: &'static str,
    /// Unit; `1` for a ratio, `choice` for one of several forms.
    pub unit: &'static str,
    /// Smallest physical value.
    pub min: f64,
    /// Largest physical value.
    pub max: f64,
    /// Where a search begins, in several sizes; each is tried. Nothing: a place that the campaign hints at ([`Effect::starts`]), and no
    /// size.
    pub starts: &'static [f64],
}

/// What is needed to tell an effect from others, from little to much.
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

/// What a campaign shows before any fit: hints at where a search begins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seen {
    /// Signal of the brightest frames, e.
    pub peak_e: f64,
    /// The same, DN above zero.
    pub peak_dn: f64,
    /// Highest code that many samples fill, DN above zero: parts of the field may be far brighter than its
    /// mean.
    pub highest_dn: f64,
    /// Largest code, DN.
    pub full_scale_dn: f64,
    /// From the first frame to the last, s.
    pub duration_s: f64,
    /// Usual time from frame to frame, s.
    pub frame_s: f64,
    /// Shortest and longest exposure to light, s.
    pub lit_s: (f64, f64),
    /// Rows.
    pub rows: f64,
    /// Columns.
    pub columns: f64,
    /// Curve of the means over the light: true where three levels or more are measured and their light is known.
    pub means: bool,
    /// Levels of light whose noise is measured: a curve is drawn through three or more.
    pub lit_levels: usize,
    /// Flat sets: what changes with time shows between two or more.
    pub flat_sets: usize,
    /// True where covariances of neighbours are measured.
    pub neighbours: bool,
    /// Noise of darks, DN.
    pub dark_noise_dn: f64,
    /// Growth of the darks' mean with the exposure, e/s; 0 where the campaign does not tell it.
    pub dark_e_per_s: f64,
    /// Correlation of the noise of successive frames in flats; `None` where it is nothing within its errors.
    pub successive: Option<f64>,
    /// The strongest line in the spectrum of the noise in read-out order, cycles per pixel.
    pub line_cycles_per_px: Option<f64>,
    /// The strongest frequency of stripes of columns that move from frame to frame, cycles per column.
    pub column_cycles: Option<f64>,
    /// Frequencies at which row means of flats ripple, cycles per row, the strongest first.
    pub row_cycles: [Option<f64>; 3],
    /// Frequencies at which a lamp that makes these bands ripples, Hz, the likeliest first.
    pub ripple_hz: [Option<f64>; 3],
    /// Slowest and fastest ripple that fit these bands within three standard errors.
    pub ripples: Option<[FittingRipple; 2]>,
    /// Frequencies at which a lamp ripples whose frames scatter like this, Hz, the likeliest first.
    pub flicker_hz: [Option<f64>; 3],
    /// Slowest and fastest ripple that fit this scatter within three standard errors.
    pub flickers: Option<[FittingRipple; 2]>,
    /// Steps of the exposure that the levels of the flats follow, the best of each shape.
    pub exposure_steps: [Option<ExposureStep>; 3],
    /// Codes for each one that occurs, about the levels.
    pub code_step_dn: Option<f64>,
    /// Distance of the codes that occur, where all lie on one line of steps; 1 where they do not.
    pub stretch_dn: f64,
    /// A code on that line, DN.
    pub stretch_zero_dn: f64,
    /// Covariance of the pixels' variances between short darks and its error, DN^4: what stays with its pixels.
    pub steady_dn4: Option<(f64, f64)>,
    /// The same of pixels two columns or two rows apart, DN^4, whichever is surer: noisy pixels that are parts of the sensor.
    pub together_dn4: Option<(f64, f64)>,
    /// Code below which one in two hundred samples of the darks lies, from the black level, DN.
    pub darkest_dn: Option<f64>,
    /// Code, as it stands in the files, below which one in two hundred samples of the darks lies, DN.
    pub darkest_code: Option<f64>,
}

/// Part of a lamp ripple's amplitude that an exposure leaves, with its sign: sinc(f T), since an exposure is a
/// running mean (Bracewell 2000, The Fourier Transform and Its Applications, ch. 4).
pub fn ripple_left(ripple_hz: f64, exposure_s: f64) -> f64 {
    let x = std::f64::consts::PI * ripple_hz * exposure_s;
    if x < 1e-9 { 1.0 } else { libm::sin(x) / x }
}

/// Lamps on the mains ripple at twice its frequency.
const MAINS_HZ: [f64; 2] = [100.0, 120.0];
/// A ripple that turns by less within the longest exposure does not fade with it: 2 in 100 of its strength.
const NO_TURN: f64 = 0.1;
/// Smallest ratio of the shortest exposure to the longest at which all count as one (a named choice).
const ONE_EXPOSURE: f64 = 0.9;
/// Largest ratio of the amplitudes that fit at which the campaign tells the lamp's (a named choice).
const MAX_AMPLITUDE_RATIO: f64 = 1.5;

/// Slowest and fastest ripple in words, where the exposures do not tell which is the lamp's.
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

/// Third of the distance from a value to that of the farther of two ripples within three standard errors; 0
/// without these.
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

/// Step of the exposure that the levels of a campaign's flats follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureStep {
    /// 1: exposures are cut to whole steps, 2: to the nearest, 3: up.
    pub shape: f64,
    /// The step, s: the middle of those that give every exposure the same number of steps.
    pub step_s: f64,
    /// Its standard error, s.
    pub std_err_s: f64,
}

impl Seen {
    /// Minimum number of light levels for a curve: a line through the darks takes up two.
    pub const MIN_CURVE_LEVELS: usize = 3;

    /// Returns true if the noise is measured at enough light levels for a curve.
    pub fn shows_a_curve(&self) -> bool {
        self.lit_levels >= Self::MIN_CURVE_LEVELS
    }

    /// Starts of a charge at which something ends: near the brightest level, e. Shading and noise reach some per cent above it, and what only
    /// these reach shows in steps as fine.
    fn near_peak(&self) -> Vec<Vec<f64>> {
        [1.0, 0.9, 0.97, 1.03, 1.06, 1.1, 1.15, 1.22, 1.3]
            .into_iter()
            .map(|part| vec![part * self.peak_e.max(1.0)])
            .filter(|start| !self.exceeds(start[0]))
            .collect()
    }

    /// Returns true if many samples hold far more charge than this, e, so that no well ends there.
    pub fn exceeds(&self, charge_e: f64) -> bool {
        self.highest_dn * self.peak_e > FAR_ABOVE * charge_e * self.peak_dn
    }
}

/// Reason that no well ends at a charge.
const BRIGHTER_PIXELS: &str = "many samples hold far more charge than that, and are not cut off";

/// Ratio of the brightest samples to a full well up to which noise and unequal pixels make them (a named
/// choice).
const FAR_ABOVE: f64 = 1.5;

impl Parameter {
    /// Whether it says which of several kinds, and is not fitted: every start is tried. Its unit is `choice`.
    pub fn is_choice(&self) -> bool {
        self.unit == "choice"
    }

    /// Whether it may be nothing, so that its value says how strong the effect is.
    pub fn is_size(&self) -> bool {
        self.min <= 0.0 && self.max >= 0.0 && !self.is_choice() && !self.starts.is_empty()
    }

    /// Meaning without the name of the choice before its colon.
    pub fn plain_meaning(&self) -> &'static str {
        let of_choice = |of: &str| of.starts_with("shape") && of.ends_with(|c: char| c.is_ascii_digit());
        self.meaning.split_once(": ").filter(|(of, _)| of_choice(of)).map_or(self.meaning, |(_, plain)| plain)
    }
}

/// A combination of parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Together {
    /// Its name.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Its value.
    pub value: f64,
    /// How it grows with each parameter.
    pub slopes: Vec<f64>,
    /// Where nothing tells the parts apart: what it may be off by for that, per electron of the brightest signal.
    pub unsure_per_e: f64,
}

/// A camera as examples need it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plain {
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Signal near full scale, e.
    pub range_e: f64,
    /// Exposure that brings it, s.
    pub bright_s: f64,
    /// Constant noise, e.
    pub noise_e: f64,
    /// Time of a frame, s.
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
    /// Of a model.
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

/// What people want to know of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Page {
    /// What happens, in a sentence or two.
    pub what: &'static str,
    /// The equation used here.
    pub equation: &'static str,
    /// Which statistic moves, and how.
    pub signature: &'static str,
    /// How to tell it from what looks like it.
    pub look_alikes: &'static str,
    /// Remedies, the first one first, separated by semicolons.
    pub remedy: &'static str,
    /// The measurement that separates it from its look-alikes.
    pub measure: &'static str,
    /// That measurement as sets of frames: one of [`takes`].
    pub sets: &'static [Take],
    /// Where it is described.
    pub source: &'static str,
}

/// A set of frames to be taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Take {
    /// What is before the camera; `None`: no light.
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
    /// Exposures in small steps up to full scale at one light, and one light level against another at one exposure.
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
    /// Other words that people use for it, in lower case.
    fn also_called(&self) -> &'static [&'static str] {
        &[]
    }
    /// Its place in the chain.
    fn stage(&self) -> Stage;
    /// The same where a choice among its parameters decides.
    fn stage_with(&self, _values: &[f64]) -> Stage {
        self.stage()
    }
    /// Its parameters.
    fn parameters(&self) -> &'static [Parameter];
    /// Entry of a model file that can be read without it, where formulas make it.
    fn written(&self) -> Option<crate::EffectValues> {
        None
    }
    /// Whether a fit leaves the sign of the parameters as it finds it: where positive and negative are two ways of the same thing, and
    /// the statistics have a kink between them. Every combination of signs is tried.
    fn keeps_sign(&self) -> bool {
        false
    }
    /// What a campaign must have for it to be looked for.
    fn needs(&self) -> Needs {
        Needs::Frames
    }
    /// Where a search begins: values of all parameters, each list of which is tried. They must move what is predicted: what moves
    /// nothing that was measured is not looked for.
    fn starts(&self, _seen: &Seen) -> Vec<Vec<f64>> {
        let parameters = self.parameters();
        let tries = parameters.iter().map(|p| p.starts.len()).max().unwrap_or(1);
        let of =
            |p: &Parameter, k: usize| p.starts.get(k).or(p.starts.last()).copied().unwrap_or(p.min.max(0.0));
        (0..tries).map(|k| parameters.iter().map(|p| of(p, k)).collect()).collect()
    }
    /// True if a fitted spread of the read noise absorbs most of the effect: a fit with it begins at a lower
    /// read noise, since no slope leads there.
    fn read_noise_absorbs_it(&self) -> bool {
        false
    }
    /// Standard error of a parameter beyond that of the fit, in its own unit: from values that give the same
    /// codes, or fit this campaign as well.
    fn resolution(&self, _parameter: usize, _p: &[f64], _seen: &Seen) -> f64 {
        0.0
    }
    /// Whether a parameter is a whole number that the codes show: its starts are tried one by one, and none is fitted.
    fn is_whole(&self, _parameter: usize) -> bool {
        false
    }
    /// Whether a parameter matters where the choices are those of these values.
    fn uses(&self, _p: &[f64], _parameter: usize) -> bool {
        true
    }
    /// Redundant direction in the parameters: moving along it changes no code of a camera of this full scale.
    /// Fits keep the values orthogonal to it.
    fn redundant(&self, _p: &[f64], _full_scale_dn: f64) -> Option<Vec<f64>> {
        None
    }
    /// What the choices mean, in words.
    fn form(&self, _p: &[f64]) -> Option<&'static str> {
        None
    }
    /// What only a combination of parameters may tell, where single ones are not known.
    fn together(&self, _p: &[f64]) -> Option<Together> {
        None
    }
    /// Twice the logarithm of how many times rarer it is than what looks the same: of two that a campaign
    /// cannot tell apart the more common one stands first.
    fn rarer(&self) -> f64 {
        0.0
    }
    /// Whether frames depend on those before them: what was exposed before the first is then not known.
    fn has_memory(&self) -> bool {
        false
    }
    /// Number of frames after which nothing is left of a level; `None`: a part of a part always stays.
    fn forgets_after(&self, _p: &[f64]) -> Option<usize> {
        None
    }
    /// Value of a parameter to draw with where a model gives none; `None`: it must be given.
    fn usual(&self, _parameter: usize) -> Option<f64> {
        None
    }
    /// Whether it is another effect at these values: a limit of its shape.
    fn is_another(&self, _p: &[f64], _seen: &Seen) -> bool {
        false
    }
    /// Contradiction between the campaign and the effect at these values and standard errors: it may fit, and its name
    /// does not stand.
    fn contradicted(&self, _p: &[f64], _std_err: &[f64], _seen: &Seen) -> Option<&'static str> {
        None
    }
    /// Other values that fit the campaign as well, in words; none where it tells them apart.
    fn fits_as_well(&self, _p: &[f64], _seen: &Seen) -> Option<String> {
        None
    }
    /// Values of the forms with the same means and another noise: each means another gain, and few frames
    /// do not tell them apart.
    fn forms_with_same_means(&self, _p: &[f64]) -> Vec<Vec<f64>> {
        Vec::new()
    }
    /// True for an effect that darks alone can show.
    fn shows_in_darks(&self) -> bool {
        matches!(self.stage(), Stage::Read | Stage::Converter | Stage::Firmware)
    }
    /// True for an effect by which flats of one light change their level with time.
    fn is_drift_of_level(&self) -> bool {
        false
    }
    /// True for an effect by which each set has a light of its own; else the light stays until another level is
    /// set.
    fn sets_each(&self) -> bool {
        false
    }
    /// Returns true if the effect with these values changes with time: they depend on the times of frames.
    fn is_in_time(&self, _: &[f64]) -> bool {
        false
    }
    /// Returns true if the effect bends the mean over the light, so that noise alone cannot show it.
    fn bends_means(&self) -> bool {
        false
    }
    /// The statistic that is its scatter itself: where less is measured than it would make it is not there,
    /// though its scatter may excuse other deviations.
    fn shown_by(&self) -> Option<&'static str> {
        None
    }
    /// Statistics that tell it from what looks like it, by their names in the code: its name does not stand where they deviate with it.
    fn told_by(&self) -> &'static [&'static str] {
        &[]
    }
    /// Values at which it is plain to see in a campaign of the standard plan; `None` where flats, darks and a scene of unknown contrast
    /// show nothing of it.
    fn example(&self, plain: &Plain) -> Option<Vec<f64>>;
    /// Values so many times as strong, within the bounds.
    fn scaled(&self, values: &[f64], by: f64) -> Vec<f64> {
        let of = |(v, p): (&f64, &Parameter)| if p.is_size() { (v * by).clamp(p.min, p.max) } else { *v };
        values.iter().zip(self.parameters()).map(of).collect()
    }
    /// What people want to know.
    fn page(&self) -> Page;
    /// Shifts the expected statistics. `p` are the values of [`parameters`](Self::parameters).
    fn predict(&self, p: &[f64], campaign: &Campaign, out: &mut Prediction);
    /// Acts on a frame.
    fn draw(&self, p: &[f64], frame: &mut Drawing<'_>);
}

/// A frame on its way through the chain.
///
/// `image` holds the expected charge (e) at [`Stage::Light`], charge (e) until the amplifier, DN above the black level
/// until the end of [`Stage::Converter`], and DN with the black level at [`Stage::Firmware`].
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
    /// Black level at zero exposure, DN: from it the image counts before conversion.
    pub offset_dn: f64,
    /// A, DN/e.
    pub gain_dn_per_e: f64,
    /// Read noise, root mean square over the pixels, DN.
    pub read_noise_dn: f64,
    /// What an effect keeps from frame to frame, by its identifier.
    pub memory: &'a mut Memory,
}

/// Images that effects keep from frame to frame.
pub type Memory = std::collections::BTreeMap<&'static str, ndarray::Array2<f64>>;

impl Drawing<'_> {
    /// Random numbers of an effect: the same for the same frame, effect and index.
    pub fn random(&self, effect: &str, frame: u64, index: u32) -> crate::rng::PixelRng {
        let tag = effect.bytes().fold(17u32, |h, b| h.wrapping_mul(31).wrapping_add(u32::from(b)));
        crate::rng::PixelRng::new(self.seed, crate::rng::Stream::Effect, frame, index, tag & 0x7fff_fff0)
    }

    /// Adds one normal number of deviation `sd` to each row (axis 0) or column (axis 1).
    pub fn add_to_lines(&mut self, effect: &str, axis: usize, sd: f64) {
        for i in 0..self.image.len_of(ndarray::Axis(axis)) {
            let e = sd * self.random(effect, self.frame, i as u32).normal();
            self.image.index_axis_mut(ndarray::Axis(axis), i).mapv_inplace(|v| v + e);
        }
    }

    /// The image shifted by whole pixels; the border is repeated.
    pub fn shifted(&self, dy: i32, dx: i32) -> ndarray::Array2<f64> {
        shifted(&self.image, dy, dx)
    }
}

/// An image moved down by `dy` and right by `dx`; the border is repeated.
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

/// Effects that a program brought along.
static OWN: std::sync::RwLock<Vec<&'static dyn Effect>> = std::sync::RwLock::new(Vec::new());

/// Makes an effect of your own known for as long as the program runs: models may name it, and a diagnosis tries it as well. An
/// error says which effect has its identifier already.
///
/// `examples/row-gain-noise` is a program with an effect of its own.
///
/// # Errors
///
/// Which effect has its identifier already.
pub fn register(effect: &'static dyn Effect) -> Result<(), String> {
    let mut own = OWN.write().unwrap_or_else(std::sync::PoisonError::into_inner);
    let taken = EFFECTS.iter().chain(own.iter()).any(|e| e.id() == effect.id());
    if taken || effect.id() == "custom" {
        return Err(format!("there is an effect \"{}\" already", effect.id()));
    }
    own.push(effect);
    Ok(())
}

/// Takes an effect of the user's own out again. `false`: there was none of this identifier.
pub fn unregister(id: &str) -> bool {
    let mut own = OWN.write().unwrap_or_else(std::sync::PoisonError::into_inner);
    let before = own.len();
    own.retain(|e| e.id() != id);
    own.len() < before
}

/// Every effect, registered ones last.
pub fn all() -> Vec<&'static dyn Effect> {
    let own = OWN.read().unwrap_or_else(std::sync::PoisonError::into_inner);
    EFFECTS.iter().chain(own.iter()).copied().collect()
}

/// Effects that a search does not consider.
static LEFT_OUT: std::sync::RwLock<Vec<String>> = std::sync::RwLock::new(Vec::new());

/// Leaves an effect out of every search for as long as the program runs; models may name it still.
pub fn leave_out(id: &str) {
    LEFT_OUT.write().unwrap_or_else(std::sync::PoisonError::into_inner).push(id.into());
}

/// Every effect that a search considers, registered ones last.
pub fn considered() -> Vec<&'static dyn Effect> {
    let left_out = LEFT_OUT.read().unwrap_or_else(std::sync::PoisonError::into_inner);
    all().into_iter().filter(|e| left_out.iter().all(|id| id != e.id())).collect()
}

/// An effect by its identifier.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    all().into_iter().find(|e| e.id() == id)
}

/// [`Effect::example`] of an effect for a camera.
pub fn example(id: &str, model: &crate::Model) -> Option<Vec<f64>> {
    find(id)?.example(&Plain::of(model))
}
