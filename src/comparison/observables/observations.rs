//! Observations of a campaign: the complete input of the fits and the judge.

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
    /// Stated scatter. It is not fitted: few settings determine their scatter badly, and a bend would seem to
    /// reduce it.
    Stated(f64),
    /// Upper bound of an unstated scatter, which is fitted.
    Below(f64),
}

/// Identity of observations. A copy gets a new one, because it may be changed.
#[derive(Debug)]
pub struct Identity(u64);

impl Default for Identity {
    fn default() -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self(NEXT.fetch_add(1, Ordering::Relaxed))
    }
}

impl Identity {
    /// Returns a number that no other identity has.
    pub fn value(&self) -> u64 {
        self.0
    }
}

impl Clone for Identity {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Everything observed in a campaign.
#[derive(Debug, Clone)]
pub struct Observations {
    /// Identity of these observations.
    pub identity: Identity,
    /// Geometry, sets and frames.
    pub campaign: Campaign,
    /// Set numbers of the dataset.
    pub set_numbers: Vec<u32>,
    /// Frame means of every set in order of time, DN, excluded frames omitted; empty for tables.
    pub frame_means_dn: Vec<Vec<f64>>,
    /// Kinds of the sets.
    pub kinds: Vec<Kind>,
    /// The observables.
    pub list: Vec<Observable>,
    /// Scene at the long and the short exposure, in each half.
    pub scenes: [Option<ScenePair>; 2],
    /// Codes filled by samples, in each half.
    pub codes: [codes::Filled; 2],
    /// True for a table of statistics without frames.
    pub is_table: bool,
    /// True for a table without exposures: the means are taken as given and define the light.
    pub means_given: bool,
    /// Statistics that could not be measured, with the reason.
    pub missing: Vec<String>,
    /// Faults of the data.
    pub data_faults: Vec<DataFault>,
    /// True if there were flats and a fault left out all of them.
    pub flats_left_out: bool,
    /// Steps of the exposure that the levels follow; set once they were searched for, with the gain and dark
    /// current of the first fit. The steps depend little on either.
    pub exposure_steps: std::sync::OnceLock<[Option<radcam_sim::effects::ExposureStep>; 3]>,
    /// Features of the camera that changed pixel values.
    pub left_on: Vec<LeftOn>,
    /// Known relative error of the light levels.
    pub light_rel_std: Option<f64>,
    /// Scatter of the light from setting to setting; `None` if the light was set once or is stated as exact.
    pub setting: Option<Setting>,
    /// Strongest peaks of the spectra of row means and of column means; `None` if noise alone may explain
    /// them.
    pub peaks: [Option<line_peak::Peak>; 2],
    /// Numbers of rows and columns with valid pixels.
    pub lines: (usize, usize),
    /// Frequencies of ripples in the row means of flats, cycles per row, the strongest first.
    pub row_cycles: Vec<f64>,
    /// Ripples of a lamp, from the fading of light bands with the exposure.
    pub ripples: Ripples,
    /// Ripples of a lamp, from the fading of the scatter of whole frames with the exposure.
    pub flickers: Ripples,
    /// Frequencies of column stripes that move from frame to frame, cycles per column, the strongest first.
    pub column_cycles: Vec<f64>,
    /// Line of steps on which all occurring codes lie.
    pub stretch: Option<Stretch>,
    /// Exposures before the sets.
    pub before_sets: Before,
    /// Correlation of the noise of successive frames in flats; `None` if it is 0 within its error.
    pub successive: Option<f64>,
    /// Field of the light.
    pub field: Field,
    /// Number of chunks of frames at the level of every set; all darks share one.
    pub alike: Vec<f64>,
    /// For every set, the first of the consecutive sets under the same light: the light stays constant until
    /// another level is set.
    pub light_settings: Vec<usize>,
    /// Largest relative standard deviation of the signal over the pixels of a flat set.
    pub largest_spread: f64,
    /// True for sets that follow a scene: their carry-over has the contrast of the scene.
    pub after_scene: Vec<bool>,
    /// Spatial variance of the dark charge of every dark set in excess of the shortest darks, DN^2.
    pub dark_spread_dn2: Vec<f64>,
    /// Covariance of the pixel variances between short darks, DN^4: the part that stays with the pixels.
    pub steady_dn4: Option<Value>,
    /// Covariance of the variances of pixels two columns and two rows apart, DN^4: noisy regions of the
    /// sensor.
    pub together_dn4: Option<[Value; 2]>,
    /// Distribution of the noise of single pixels in short darks.
    pub pixel_noise: Option<PixelNoise>,
    /// Code below which one in two hundred samples of the darks lies.
    pub darkest_dn: Option<f64>,
    /// True if the camera states that it has no black level: its darks are cut off at code 0 by design.
    pub no_black_level: bool,
}

impl Observations {
    /// Returns the observables of one statistic.
    pub fn of<'a>(&'a self, statistic: &'a dyn Statistic) -> impl Iterator<Item = &'a Observable> {
        self.list.iter().filter(move |o| o.is(statistic))
    }

    /// Returns true if dark charge can be separated from black level and light: darks have two exposures, or
    /// flats of one light have, with a dark or another known light beside them. If the darks of the campaign
    /// have two exposures, those of the half must have them too: flats alone determine it badly.
    pub fn tells_dark_current(&self, half: Option<Half>) -> bool {
        if half.is_some() && self.exposures_differ(None, true) {
            return self.exposures_differ(half, true);
        }
        self.exposures_differ(half, true)
            || (self.exposures_differ(half, false) && self.has_another_level(half))
    }

    /// Returns the step of the converter, DN; 1 unless all codes are multiples of another step.
    pub fn code_step_dn(&self) -> f64 {
        self.stretch.map_or(1.0, |line| line.step)
    }

    /// Returns the number of flats beyond one for each light: they separate drift from the scatter of
    /// settings.
    pub fn repeated_lights(&self) -> usize {
        let lit = self.campaign.sets.iter().zip(&self.kinds).filter(|(_, kind)| **kind == Kind::Flat);
        let mut lights: Vec<u64> = lit.map(|(set, _)| set.illumination.to_bits()).collect();
        let flats = lights.len();
        lights.sort_unstable();
        lights.dedup();
        flats - lights.len()
    }

    /// Returns true if light leaks into the darks: their growth with the exposure is then not dark current.
    pub fn light_leaks_into_darks(&self) -> bool {
        self.data_faults.iter().any(DataFault::is_leak)
    }

    /// Returns true if darks have two exposures.
    pub fn darks_tell_dark_current(&self) -> bool {
        self.exposures_differ(None, true)
    }

    /// Returns true if a dark, or flats of two lights of a known lamp, separate dark charge from the light of
    /// the flats.
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
            // All lights of a known lamp count as one.
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
