//! Observations of a campaign: all that the fits and the judge know of it.

use super::line_peak;
use super::{Field, Half, Observable, Ripples, ScenePair, Statistic, codes, mean};
use crate::data_faults::DataFault;
use crate::dataset::Kind;
use crate::features::LeftOn;
use crate::statistics::code_step::Stretch;
use crate::statistics::jackknife::Value;
use crate::statistics::steady::PixelNoise;
use radcam_sim::predict::{Before, Campaign};
use std::sync::atomic::{AtomicU64, Ordering};

/// Relative scatter of the light from setting to setting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// Stated scatter. It is not fitted: few settings tell little of their scatter, and a bend would seem to
    /// make it less.
    Stated(f64),
    /// Scatter that is not stated is fitted, up to this.
    Below(f64),
}

/// Tells observations from others; a copy, which may be changed, is another.
#[derive(Debug)]
pub struct Identity(u64);

impl Default for Identity {
    fn default() -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self(NEXT.fetch_add(1, Ordering::Relaxed))
    }
}

impl Identity {
    /// A number that no others have.
    pub fn value(&self) -> u64 {
        self.0
    }
}

impl Clone for Identity {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Everything that was observed.
#[derive(Debug, Clone)]
pub struct Observations {
    /// These and no others.
    pub identity: Identity,
    /// Geometry, sets and frames.
    pub campaign: Campaign,
    /// Numbers of the sets as the dataset has them.
    pub set_numbers: Vec<u32>,
    /// Frame means of every set in order of time, DN, without frames left out; empty for tables.
    pub frame_means_dn: Vec<Vec<f64>>,
    /// Kinds of the sets.
    pub kinds: Vec<Kind>,
    /// The observables.
    pub list: Vec<Observable>,
    /// The scene with the long and the short exposure, in each half.
    pub scenes: [Option<ScenePair>; 2],
    /// Codes that samples fill, in each half.
    pub codes: [codes::Filled; 2],
    /// A table of statistics and no frames.
    pub is_table: bool,
    /// A table without exposures: the means are taken as they are, and give the light.
    pub means_given: bool,
    /// Statistics that could not be measured, with the reason.
    pub missing: Vec<String>,
    /// Faults of the data.
    pub data_faults: Vec<DataFault>,
    /// True if there were flats and a fault left out all of them.
    pub flats_left_out: bool,
    /// Steps of the exposure that the levels follow, once they were looked for: by gain and dark current of the
    /// first fit, on which they hang little.
    pub exposure_steps: std::sync::OnceLock<[Option<radcam_sim::effects::ExposureStep>; 3]>,
    /// Features of the camera that changed pixel values.
    pub left_on: Vec<LeftOn>,
    /// Known relative error of the light levels.
    pub light_rel_std: Option<f64>,
    /// Scatter of the light from setting to setting; `None` where the light was set once, or is stated as
    /// exact.
    pub setting: Option<Setting>,
    /// Strongest peaks of the spectra of row means and of column means, where noise alone has none like it.
    pub peaks: [Option<line_peak::Peak>; 2],
    /// Rows and columns that have pixels that count.
    pub lines: (usize, usize),
    /// Frequencies at which row means of flats ripple, cycles per row, the strongest first.
    pub row_cycles: Vec<f64>,
    /// Ripples of a lamp by how light bands fade with the exposure.
    pub ripples: Ripples,
    /// The same by how the scatter of whole frames fades.
    pub flickers: Ripples,
    /// Frequencies of stripes of columns that move from frame to frame, cycles per column, the strongest
    /// first.
    pub column_cycles: Vec<f64>,
    /// Line of steps on which all codes lie that occur.
    pub stretch: Option<Stretch>,
    /// Exposures before the sets.
    pub before_sets: Before,
    /// Correlation of the noise of successive frames in flats; `None` where it is nothing within its errors.
    pub successive: Option<f64>,
    /// The field of the light.
    pub field: Field,
    /// Number of chunks of frames at the level of every set; all darks share one.
    pub alike: Vec<f64>,
    /// First of the sets that follow one another under the same light, for every set: the light stays as it
    /// is until another level is set.
    pub light_settings: Vec<usize>,
    /// Largest relative deviation of the signal over the pixels of a set.
    pub largest_spread: f64,
    /// Sets that follow a scene: what they carry over has its contrast.
    pub after_scene: Vec<bool>,
    /// Spatial variance of the dark charge of every dark set, DN^2: what it has beyond the shortest darks'.
    pub dark_spread_dn2: Vec<f64>,
    /// Covariance of the pixels' variances between short darks, DN^4: what stays with its pixels.
    pub steady_dn4: Option<Value>,
    /// Covariance of the variances of pixels two columns and two rows apart, DN^4: noisy parts of the sensor.
    pub together_dn4: Option<[Value; 2]>,
    /// Distribution of the single pixels' noise in short darks.
    pub pixel_noise: Option<PixelNoise>,
    /// Code below which one in two hundred samples of the darks lies.
    pub darkest_dn: Option<f64>,
    /// True if the camera states that it has no black level: its darks are cut off at code 0 by design.
    pub no_black_level: bool,
}

impl Observations {
    /// Observables of one statistic.
    pub fn of<'a>(&'a self, statistic: &'a dyn Statistic) -> impl Iterator<Item = &'a Observable> {
        self.list.iter().filter(move |o| o.is(statistic))
    }

    /// Returns true if dark charge can be told from the black level and from light: darks have two exposures,
    /// or flats of one light have, and there is a dark or another known light beside them. A half that leaves
    /// it to its flats, where all darks together tell it, tells it badly.
    pub fn tells_dark_current(&self, half: Option<Half>) -> bool {
        if half.is_some() && self.exposures_differ(None, true) {
            return self.exposures_differ(half, true);
        }
        self.exposures_differ(half, true)
            || (self.exposures_differ(half, false) && self.has_another_level(half))
    }

    /// Step of the converter, DN; 1 unless all codes are multiples of another.
    pub fn code_step_dn(&self) -> f64 {
        self.stretch.map_or(1.0, |line| line.step)
    }

    /// Number of flats beyond one for each light: what tells a drift from the scatter of settings.
    pub fn repeated_lights(&self) -> usize {
        let lit = self.campaign.sets.iter().zip(&self.kinds).filter(|(_, kind)| **kind == Kind::Flat);
        let mut lights: Vec<u64> = lit.map(|(set, _)| set.illumination.to_bits()).collect();
        let flats = lights.len();
        lights.sort_unstable();
        lights.dedup();
        flats - lights.len()
    }

    /// Returns true if light leaks into the darks: their growth with the exposure is no dark current.
    pub fn light_leaks_into_darks(&self) -> bool {
        self.data_faults.iter().any(DataFault::is_leak)
    }

    /// Returns true if darks have two exposures.
    pub fn darks_tell_dark_current(&self) -> bool {
        self.exposures_differ(None, true)
    }

    /// Returns true if a dark, or flats of two lights of a known lamp, tell dark charge from the light of the
    /// flats.
    fn has_another_level(&self, half: Option<Half>) -> bool {
        let looked_at = |o: &&Observable| o.half != Half::Both && half.is_none_or(|h| o.half == h);
        let mut sets = self.of(&mean::Mean).filter(looked_at).filter_map(|o| o.set);
        let mut light = None;
        sets.any(|s| {
            let own = self.campaign.sets[s].illumination;
            let another = *light.get_or_insert(own) != own && self.light_rel_std.is_some();
            self.kinds[s] == Kind::Dark || another
        })
    }

    /// Returns true if darks, or flats of one light, have two exposures.
    fn exposures_differ(&self, half: Option<Half>, darks: bool) -> bool {
        let mut exposures: std::collections::BTreeMap<Option<usize>, Vec<f64>> = Default::default();
        let looked_at = |o: &&Observable| o.half != Half::Both && half.is_none_or(|h| o.half == h);
        for o in self.of(&mean::Mean).filter(looked_at) {
            let Some(s) = o.set.filter(|s| (self.kinds[*s] == Kind::Dark) == darks) else { continue };
            let set = &self.campaign.sets[s];
            // The lights of a lamp that is known are one.
            let light = set.light.filter(|_| self.kinds[s] != Kind::Flat || self.light_rel_std.is_none());
            exposures.entry(light).or_default().push(set.exposure_s);
        }
        exposures.values().any(|all| all.iter().any(|e| (e / all[0] - 1.0).abs() > 1e-6))
    }

    /// Returns true if there is an observable of a statistic.
    pub fn has(&self, statistic: &dyn Statistic) -> bool {
        self.list.iter().any(|o| o.is(statistic))
    }
}
