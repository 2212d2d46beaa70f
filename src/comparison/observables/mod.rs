//! What a campaign says, as a list of observables: each a number with an error, of some frames of one half.
//!
//! # To add a statistic
//!
//! Write one file here with a type that implements [`Statistic`], and put both names on the list at the end of this file: reports come in
//! that order. Nothing else changes. [`mean`] is the shortest; [`kurtosis`] shows every part.
//!
//! 1. **What is summed** ([`Statistic::sums`], [`Statistic::add`]). Variances, covariances, row and column means, histograms and profiles are
//!    there already ([`Summary`]). For anything else `add` gets every frame's image of deviations (rows * columns, DN): frame k less the
//!    mean of the frames before it, times the root of (k - 1) / k, so that of independent frames each has the variance of a frame and all
//!    are independent. The mean of each frame is taken off, and pixels that do not count (defects, clipped ones) are 0. Of a cumulant of
//!    order m beyond the second such a deviation keeps ((k - 1) / k)^(m/2) (1 + (-1)^m / (k - 1)^(m - 1)) of a frame's: nothing of the third
//!    where k = 2.
//! 2. **What is measured** ([`Statistic::of_chunk`] for some frames of a set, [`Statistic::of_half`] for all sets of a half): values put on
//!    the list, each with the error that the data show, or with 0 where `expect` gives it. Of a table only values that it holds itself are
//!    there; `of_chunk` is not called.
//! 3. **What is expected** ([`Statistic::expect`]): value and standard error under a prediction. [`View`] has what most need, corrected for
//!    the number of frames: [`View::lag`] for covariances, `noise` for the variance. `set()` gives all moments that effects act on
//!    ([`SetPrediction`](radcam_sim::predict::SetPrediction)); each has its `unsure_*`, what no equation says of it, to be added to the error
//!    in quadrature. The value is differentiated by steps of 1e-5: no rounding, no random numbers, no steps. The error should hold for noise
//!    that neighbours share, for a level that moves during a set (`moving`), and for noise of less than a code (`rough`).
//! 4. **Words** ([`Statistic::id`], [`Statistic::name`], [`Statistic::meaning`]).
//!
//! Test the sum and its error by drawn numbers in the file. `radcam compare DATASET --json` then lists z of every value; on datasets that the
//! model describes (`shared/practice/clean`, `radcam simulate`) their root mean square is 1. `tests/it/models.rs` compares drawn and expected
//! values for every effect.

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

/// Whether frames are fitted and judged in turn, or known to both.
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
    /// The two that take turns.
    pub const TURNS: [Self; 2] = [Self::First, Self::Second];

    /// The other one.
    pub fn other(self) -> Self {
        match self {
            Self::First => Self::Second,
            Self::Second => Self::First,
            Self::Both => Self::Both,
        }
    }

    /// 0 or 1.
    pub fn place(self) -> usize {
        usize::from(self == Self::Second)
    }
}

/// One observable.
#[derive(Debug, Clone, Copy)]
pub struct Observable {
    /// What it is.
    pub statistic: &'static dyn Statistic,
    /// Which of the statistic's several: a lag, a bit, a direction.
    pub index: usize,
    /// Place of its set in [`Observations::campaign`]; `None` for the whole campaign.
    pub set: Option<usize>,
    /// Where it is fitted and judged.
    pub half: Half,
    /// Frames of the campaign that it is made of.
    pub frames: (usize, usize),
    /// What was measured.
    pub measured: Value,
    /// Pixels.
    pub pixels: f64,
    /// Mean and variance of the means of its frames, DN and DN^2; 0 of the whole campaign.
    pub frame_means: (f64, f64),
}

impl Observable {
    /// Its name in reports.
    pub fn name(&self) -> String {
        self.statistic.name(self.index)
    }

    /// Whether it is of this statistic.
    pub fn is(&self, statistic: &dyn Statistic) -> bool {
        self.statistic.id() == statistic.id()
    }
}

/// Jackknife errors over those of independent normal pixels, over all chunks: one chunk's own jackknife is noisy.
#[derive(Debug, Clone, Copy)]
pub struct Inflation {
    /// Of variances.
    pub variance: f64,
    /// Of covariances within a frame.
    pub covariance: f64,
    /// Of covariances of successive frames.
    pub successive: f64,
    /// Of the spread of the pixels' variances.
    pub unequal: f64,
}

/// Frames of one set of one half, as a statistic sees them.
pub struct ChunkView<'a> {
    chunk: &'a Chunk,
    /// Places in the campaign of the set's frames.
    rows: &'a [usize],
    /// How errors compare with those of independent normal pixels.
    pub inflation: &'a Inflation,
    extra: usize,
}

impl ChunkView<'_> {
    /// What the frames say.
    pub fn summary(&self) -> &Summary {
        &self.chunk.summary
    }

    /// What the statistic's own [`Statistic::add`] summed up, over the degrees of freedom.
    pub fn sums(&self) -> &[f64] {
        self.chunk.summary.extra.get(self.extra).map_or(&[], Vec::as_slice)
    }

    /// Mean of the frame before, where that is the first of the set, DN.
    fn before(&self) -> Option<f64> {
        self.chunk.before
    }

    /// From the set's first frame to the chunk's last, as places in the campaign.
    fn since_the_first(&self) -> (usize, usize) {
        (self.rows[0], self.rows[self.chunk.from] + self.chunk.summary.frames)
    }

    /// Share of the codes around the level that occur, and its error.
    fn codes_used(&self) -> Option<(f64, f64)> {
        self.chunk.codes_used
    }

    /// Degrees of freedom of what is taken about the pixels' means.
    pub fn dof(&self) -> f64 {
        self.chunk.summary.frames as f64 - 1.0
    }
}

/// One half of a campaign, as a statistic sees it.
pub struct HalfView<'a> {
    chunks: Vec<&'a Summary>,
    /// The set of each.
    sets: Vec<SetOfChunk>,
    zero_dn: f64,
    /// How often codes occur.
    codes: &'a codes::CodeStatistics,
    /// Variance in the strongest line of the spectrum, DN^2.
    line: Option<[Option<Value>; 3]>,
    /// Excess kurtosis of noisy pixels in short darks.
    noisy_levels: &'a [Option<Levels>; 3],
    /// A still scene at two exposures.
    scene: Option<&'a ScenePair>,
    half: Half,
    /// Strongest peaks of the spectra of row means and of column means.
    peaks: &'a [Option<line_peak::Peak>; 2],
}

/// What a statistic of several levels must know of the set of a chunk.
#[derive(Debug, Clone, Copy)]
struct SetOfChunk {
    exposure_s: f64,
    /// A scene came before, which leaves its picture behind.
    after_scene: bool,
    /// Dark, or of the position of card and light that most flats have: others have another field.
    in_main_field: bool,
}

impl<'a> HalfView<'a> {
    /// Puts what one half has at the peak of a spectrum of line means.
    fn put_peak(&self, axis: line_peak::Axis, put: &mut Put<'_>) {
        if let Some(peak) = &self.peaks[axis as usize] {
            peak.put(self.half, put);
        }
    }

    /// Profiles of the chunks of one field, DN, each with its signal, DN: other positions of card and light have
    /// another shading.
    pub fn profiles(&self, of: fn(&Summary) -> &[f64]) -> Vec<(f64, &'a [f64])> {
        let one_field = self.chunks.iter().zip(&self.sets).filter(|(_, set)| set.in_main_field);
        one_field.map(|(s, _)| (s.frame_means.mean_dn() - self.zero_dn, of(s))).collect()
    }
}

/// A value that a statistic puts on the list.
pub struct Put<'a> {
    all: &'a mut Vec<Observable>,
    template: Observable,
}

impl Put<'_> {
    /// A value of the statistic with this index, and the error that the data show: 0 where [`Statistic::expect`] gives it, which then does
    /// not look at `measured.std_err`.
    pub fn put(&mut self, index: usize, value: f64, std_err: f64) {
        if value.is_finite() {
            self.all.push(Observable { index, measured: Value { value, std_err }, ..self.template });
        }
    }

    /// One that is made of so many pixels.
    fn put_of(&mut self, index: usize, pixels: f64, value: f64, std_err: f64) {
        self.all.push(Observable { index, pixels, measured: Value { value, std_err }, ..self.template });
    }

    /// One that is made of other frames than the chunk's.
    fn put_over(&mut self, index: usize, frames: (usize, usize), value: f64) {
        self.all.push(Observable { index, frames, measured: Value { value, std_err: 0.0 }, ..self.template });
    }
}

/// A statistic of a campaign.
pub trait Statistic: Sync + std::fmt::Debug {
    /// Its name in the code and in reports.
    fn id(&self) -> &'static str;
    /// The name of one of several.
    fn name(&self, _index: usize) -> String {
        self.id().into()
    }
    /// What a deviation of it means, in words.
    fn meaning(&self, index: usize) -> &'static str;
    /// Its unit; none for ratios.
    fn unit(&self) -> &'static str {
        ""
    }
    /// True for a level of light.
    fn is_level(&self) -> bool {
        false
    }
    /// True for a statistic that follows the light of its set: the error of a lamp's setting is common to all
    /// of a set that do.
    fn sees_light(&self) -> bool {
        self.is_level()
    }
    /// Whether it judges models and is not followed by fits: where it deviates it says what a model is not, and
    /// hardly what it is.
    fn only_judges(&self) -> bool {
        false
    }
    /// How many sums over the frames it needs beside those that all share ([`Summary`]).
    fn sums(&self, _layout: &Layout) -> usize {
        0
    }
    /// Adds to them an image of deviations (rows * columns), DN, as the module's page describes them.
    fn add(&self, _image: &[f32], _lines: &Lines, _layout: &Layout, _sums: &mut [f64]) {}
    /// Its values for some frames of a set.
    fn of_chunk(&self, _chunk: &ChunkView<'_>, _put: &mut Put<'_>) {}
    /// Its values for one half of the campaign.
    fn of_half(&self, _half: &HalfView<'_>, _put: &mut Put<'_>) {}
    /// What is expected of it: a smooth function of the prediction, and its error.
    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected;
}

/// Statistics as sums over frames.
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
