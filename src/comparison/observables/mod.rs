//! Observables of a campaign: measured numbers with errors, each of some frames of one half.
//!
//! # To add a statistic
//!
//! Write one file here with a type that implements [`Statistic`], and put both names on the list at the end
//! of this file, which is the order of reports. Nothing else changes. [`mean`] is the shortest; [`kurtosis`]
//! shows every part.
//!
//! 1. **Sums** ([`Statistic::sums`], [`Statistic::add`]). [`Summary`] already has variances, covariances, row
//!    and column means, histograms and profiles. For anything else `add` gets the image of deviations of
//!    every frame (rows * columns, DN): frame k minus the mean of the frames before it, times the root of
//!    (k - 1) / k. If frames are independent, each deviation has the variance of a frame and all are
//!    independent. The mean of each frame is subtracted, and excluded pixels (defects, clipped ones) are 0. A
//!    deviation keeps the fraction ((k - 1) / k)^(m/2) (1 + (-1)^m / (k - 1)^(m - 1)) of a frame's cumulant
//!    of order m > 2: for k = 2 nothing of the third.
//! 2. **Measured values** ([`Statistic::of_chunk`] for some frames of a set, [`Statistic::of_half`] for all
//!    sets of a half). Each value has the error shown by the data, or 0 if `expect` gives the error. Of a
//!    table only the values that it states are used; `of_chunk` is not called.
//! 3. **Expected values** ([`Statistic::expect`]): value and standard error under a prediction. [`View`] has
//!    what most statistics need, corrected for the number of frames: [`View::lag`] for covariances, `noise`
//!    for the variance. `set()` gives all moments that effects act on
//!    ([`SetPrediction`](radcam_sim::predict::SetPrediction)); each has an `unsure_*`, the part that no
//!    equation predicts, to be added to the error in quadrature. The value is differentiated with steps of
//!    1e-5, so it must have no rounding, random numbers or steps. The error must hold for noise shared by
//!    neighbours, for a level that moves during a set (`moving`), and for noise of less than a code
//!    (`rough`).
//! 4. **Words** ([`Statistic::id`], [`Statistic::name`], [`Statistic::meaning`]).
//!
//! Test the sum and its error with random draws in the file. `radcam compare DATASET --json` then lists z of
//! every value; on datasets that the model describes (`shared/practice/clean`, `radcam simulate`) their root
//! mean square is 1. `tests/it/models.rs` compares drawn and expected values for every effect.

mod before_sets;
mod campaign;
mod codes;
mod expect;
mod field;
mod left_out;
pub mod line_peak;
mod observations;
mod read;
mod ripple;
mod scene;
mod shapes;
mod table;
mod warm_up;

pub(crate) use campaign::{NO_PATCH, NO_TIMES};
pub use campaign::{ObserveError, of_dataset};
pub use expect::{
    Expected, HEAVY_DOF, View, expectations, expectations_beside, in_quadrature, lightened,
    nominal_expectations,
};
mod line_shape;

pub use field::{Field, LINE_LAGS};
pub use observations::{Identity, Observations, Setting};
pub use ripple::Ripples;
pub use scene::{Direction, ScenePair};
pub use table::observations as of_table;

use crate::statistics::jackknife::Value;
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use crate::statistics::pass::{Extra, Summary};
use crate::statistics::steady::Levels;
use read::Chunk;
pub(crate) use read::{LeftOut, Work, record};
use serde::{Deserialize, Serialize};

/// Half of a campaign for cross-validation: each half is fitted while the other is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Half {
    /// Fitted first, judged second.
    First,
    /// Judged first, fitted second.
    Second,
    /// Known beforehand: given to both fits and judged in none.
    Both,
}

impl Half {
    /// Halves that take turns.
    pub const TURNS: [Self; 2] = [Self::First, Self::Second];

    /// Returns the other half; `Both` stays `Both`.
    pub fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
            Self::Both => Self::Both,
        }
    }

    /// Returns the index of the half, 0 or 1.
    pub fn place(self) -> usize {
        usize::from(self == Self::Second)
    }
}

/// One observable of a campaign.
#[derive(Debug, Clone, Copy)]
pub struct Observable {
    /// Statistic of the value.
    pub statistic: &'static dyn Statistic,
    /// Index among the values of the statistic: a lag, a bit, a direction.
    pub index: usize,
    /// Index of the set in [`Observations::campaign`]; `None` for the whole campaign.
    pub set: Option<usize>,
    /// Half in which the value is fitted and judged.
    pub half: Half,
    /// Range of the campaign's frames.
    pub frames: (usize, usize),
    /// Measured value.
    pub measured: Value,
    /// Number of pixels.
    pub pixels: f64,
    /// Mean and variance of the frame means, DN and DN^2; 0 for the whole campaign.
    pub frame_means: (f64, f64),
}

impl Observable {
    /// Returns the name in reports.
    pub fn name(&self) -> String {
        self.statistic.name(self.index)
    }

    /// Returns true if the observable belongs to this statistic.
    pub fn is(&self, statistic: &dyn Statistic) -> bool {
        self.statistic.id() == statistic.id()
    }
}

/// Ratios of jackknife errors to those of independent normal pixels, pooled over all chunks: the jackknife of
/// one chunk is noisy.
#[derive(Debug, Clone, Copy)]
pub struct Inflation {
    /// Ratio for variances.
    pub variance: f64,
    /// Ratio for covariances within a frame.
    pub covariance: f64,
    /// Ratio for covariances of successive frames.
    pub successive: f64,
    /// Ratio for the spread of the pixel variances.
    pub unequal: f64,
}

/// Frames of one set in one half, as input of a statistic.
pub struct ChunkView<'a> {
    chunk: &'a Chunk,
    /// Campaign indices of the set's frames.
    rows: &'a [usize],
    /// Ratios of errors to those of independent normal pixels.
    pub inflation: &'a Inflation,
    extra: usize,
}

impl ChunkView<'_> {
    /// Returns the summary of the frames.
    pub fn summary(&self) -> &Summary {
        &self.chunk.summary
    }

    /// Returns the sums of the statistic's own [`Statistic::add`] over the degrees of freedom.
    pub fn sums(&self) -> &[f64] {
        self.chunk.summary.extra.get(self.extra).map_or(&[], Vec::as_slice)
    }

    /// Returns the mean of the frame before the chunk if that frame is the first of the set, DN.
    fn before(&self) -> Option<f64> {
        self.chunk.before
    }

    /// Returns the range from the set's first frame to the chunk's last, as campaign indices.
    fn since_the_first(&self) -> (usize, usize) {
        (self.rows[0], self.rows[self.chunk.from] + self.chunk.summary.frames)
    }

    /// Returns the noise of the means from set to set over that within.
    fn between_sets(&self) -> Option<Value> {
        self.chunk.from_set_to_set
    }

    /// Returns the share of occurring codes around the level, and its error.
    fn codes_used(&self) -> Option<(f64, f64)> {
        self.chunk.codes_used
    }

    /// Returns the degrees of freedom of deviations from the pixel means.
    pub fn dof(&self) -> f64 {
        self.chunk.summary.frames as f64 - 1.0
    }
}

/// One half of a campaign, as input of a statistic.
pub struct HalfView<'a> {
    chunks: Vec<&'a Summary>,
    /// Set of each chunk.
    sets: Vec<SetOfChunk>,
    zero_dn: f64,
    /// Code occupancy.
    codes: &'a codes::CodeStatistics,
    /// Variance in the strongest line of the spectrum, DN^2.
    line: Option<[Option<Value>; 3]>,
    /// Excess kurtosis of noisy pixels in short darks.
    noisy_levels: &'a [Option<Levels>; 3],
    /// Still scene at two exposures.
    scene: Option<&'a ScenePair>,
    half: Half,
    /// Strongest peaks of the spectra of row means and of column means.
    peaks: &'a [Option<line_peak::Peak>; 2],
}

/// Properties of the set of a chunk, for statistics of several levels.
#[derive(Debug, Clone, Copy)]
struct SetOfChunk {
    exposure_s: f64,
    /// True if the set follows a scene, whose image persists.
    after_scene: bool,
    /// True for darks and for flats in the position of card and light that most flats have; other positions
    /// have another field.
    in_main_field: bool,
}

impl<'a> HalfView<'a> {
    /// Puts the values of this half at the peak of a spectrum of line means.
    fn put_peak(&self, axis: line_peak::Axis, put: &mut Put<'_>) {
        if let Some(peak) = &self.peaks[axis as usize] {
            peak.put(self.half, put);
        }
    }

    /// Returns the profiles of the chunks of one field, DN, each with its signal, DN. Other positions of card
    /// and light have another shading.
    pub fn profiles(&self, of: fn(&Summary) -> &[f64]) -> Vec<(f64, &'a [f64])> {
        let one_field = self.chunks.iter().zip(&self.sets).filter(|(_, set)| set.in_main_field);
        one_field.map(|(s, _)| (s.frame_means.mean_dn() - self.zero_dn, of(s))).collect()
    }
}

/// Sink for the values of a statistic.
pub struct Put<'a> {
    all: &'a mut Vec<Observable>,
    template: Observable,
}

impl Put<'_> {
    /// Puts a value of the statistic at this index, with the error shown by the data. The error is 0 if
    /// [`Statistic::expect`] gives it and does not read `measured.std_err`.
    pub fn put(&mut self, index: usize, value: f64, std_err: f64) {
        if value.is_finite() {
            self.all.push(Observable { index, measured: Value { value, std_err }, ..self.template });
        }
    }

    /// Puts a value of this number of pixels.
    fn put_of(&mut self, index: usize, pixels: f64, value: f64, std_err: f64) {
        self.all.push(Observable { index, pixels, measured: Value { value, std_err }, ..self.template });
    }

    /// Puts a value of other frames than the chunk's.
    fn put_over(&mut self, index: usize, frames: (usize, usize), value: f64) {
        self.all.push(Observable { index, frames, measured: Value { value, std_err: 0.0 }, ..self.template });
    }
}

/// A statistic of a campaign.
pub trait Statistic: Sync + std::fmt::Debug {
    /// Returns the name in the code and in reports.
    fn id(&self) -> &'static str;
    /// Returns the name of one of several values.
    fn name(&self, _index: usize) -> String {
        self.id().into()
    }
    /// Returns the meaning of a deviation, in words.
    fn meaning(&self, index: usize) -> &'static str;
    /// Returns the unit; empty for ratios.
    fn unit(&self) -> &'static str {
        ""
    }
    /// Returns true for a level of light.
    fn is_level(&self) -> bool {
        false
    }
    /// Returns true for a statistic that follows the light of its set. The error of a lamp setting is common
    /// to all such statistics of a set.
    fn sees_light(&self) -> bool {
        self.is_level()
    }
    /// Returns true for a statistic that judges models but is not fitted: its deviation shows that a model is
    /// wrong, hardly what is missing.
    fn only_judges(&self) -> bool {
        false
    }
    /// Returns the number of sums over the frames beside the shared ones ([`Summary`]).
    fn sums(&self, _layout: &Layout) -> usize {
        0
    }
    /// Adds an image of deviations (rows * columns, DN; see the module's page) to the sums.
    fn add(&self, _image: &[f32], _lines: &Lines, _layout: &Layout, _sums: &mut [f64]) {}
    /// Puts the values for some frames of a set.
    fn of_chunk(&self, _chunk: &ChunkView<'_>, _put: &mut Put<'_>) {}
    /// Puts the values for one half of the campaign.
    fn of_half(&self, _half: &HalfView<'_>, _put: &mut Put<'_>) {}
    /// Returns the expected value, a smooth function of the prediction, and its error.
    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected;
}

/// Adapter from statistics to sums over frames.
#[derive(Debug)]
struct Summed(&'static dyn Statistic);

impl Extra for Summed {
    fn size(&self, layout: &Layout) -> usize {
        self.0.sums(layout)
    }

    fn add(&self, image: &[f32], lines: &Lines, layout: &Layout, sums: &mut [f64]) {
        if !sums.is_empty() {
            self.0.add(image, lines, layout, sums);
        }
    }
}

macro_rules! statistics {
    ($($module:ident::$name:ident)*) => {
        $(pub mod $module;)*
        /// Every statistic, in the order of reports.
        pub static STATISTICS: &[&dyn Statistic] = &[$(&$module::$name),*];
        static SUMMED: &[&'static dyn Extra] = &[$(&Summed(&$module::$name)),*];
    };
}

statistics! {
    mean::Mean
    settling::Settling
    monitor::Monitor
    frame_scatter::FrameScatter
    succession::Succession
    variance::Variance
    kurtosis::Kurtosis
    row_variance::RowVariance
    column_variance::ColumnVariance
    row_shape::RowShape
    column_shape::ColumnShape
    row_spectrum::RowSpectrum
    column_spectrum::ColumnSpectrum
    row_tails::RowTails
    gradient::Gradient
    halves::Halves
    covariance::Covariance
    successive::Successive
    from_set_to_set::FromSetToSet
    unequal::Unequal
    noisy_levels::NoisyLevels
    growth::Growth
    parity::Parity
    tap::Tap
    occupancy::Occupancy
    transition::Transition
    codes_used::CodesUsed
    chunk_codes::ChunkCodes
    gaps::Gaps
    line::Line
    profile::LineProfile
    leak::Leak
}
