//! EMVA Standard 1288: the quantities of a camera's datasheet, each with a standard error.
//!
//! The default definitions are those of release 4.0 Linear; equation and section numbers in this module are
//! those of its text (release candidate of 2021-03-15). [`Definitions`] has release 3.1 and those of the
//! reference tool (PyPI `emva1288` 1.0.2), which mostly follows 3.1. docs/emva.md lists the differences,
//! quantity by quantity. The general model of release 4.0 is in [`General`].
//!
//! Errors are propagated to first order from independent inputs: variances of pairs (eq. 19), variances of
//! lines and pixels, the scatter of the responsivity, the calibration of the light. Their coverage is tested
//! on 500 simulated cameras (docs/emva.md).

mod filter;
mod general;
mod histogram;
pub(crate) mod lines;
pub mod names;
mod plots;
mod points;
mod quantities;
mod saturation;
mod spatial;
mod spline;
mod value;

pub use general::General;
pub use plots::plots;
pub(crate) use plots::power;
pub use points::{Dark, Pair, Points, Spatial, Temporal, of_dataset};
pub use quantities::{Evaluation, GainByNoise, Limit, evaluate};

use crate::data_faults::ExamineError;
use serde::{Deserialize, Serialize};

/// Source of the definitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Definitions {
    /// EMVA Standard 1288, release 4.0 Linear (2021).
    #[default]
    #[serde(rename = "release-4.0")]
    Release4,
    /// Release 3.1 (2016).
    #[serde(rename = "release-3.1")]
    Release31,
    /// The reference tool, PyPI `emva1288` 1.0.2.
    #[serde(rename = "reference-tool")]
    ReferenceTool,
}

impl std::fmt::Display for Definitions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Release4 => "release 4.0 Linear",
            Self::Release31 => "release 3.1",
            Self::ReferenceTool => "as the reference tool emva1288 1.0.2",
        })
    }
}

/// Error: a dataset has no EMVA 1288 evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EmvaError {
    /// Error of the dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::DatasetError),
    /// Data that the standard needs are missing.
    #[error("EMVA 1288: {0}")]
    Missing(String),
    /// Interrupted by the user.
    #[error("interrupted")]
    Interrupted,
}

impl From<ExamineError> for EmvaError {
    fn from(error: ExamineError) -> Self {
        match error {
            ExamineError::Dataset(e) => Self::Dataset(e),
            ExamineError::Interrupted => Self::Interrupted,
        }
    }
}
