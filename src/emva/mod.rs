//! The quantities of EMVA 1288's linear model, under the names and definitions of the reference tool (PyPI `emva1288` 1.0.2), each with a
//! standard error.
//!
//! The definitions are the tool's (`Data1288` and `Results1288`, whose equation numbers are those of EMVA Standard 1288, release 4.0 Linear) and
//! were compared with its results, not yet with the text of the standard. Errors are propagated to first order from independent inputs; their
//! coverage is tested for K, sigma_d, DSNU1288_DN and PRNU1288, and not yet for the others. The temporal part takes pairs of frames at every exposure with their dark, the
//! spatial part the one bright set of more than two frames and the dark of its exposure. As in the tool, numbers of the fits (the point of
//! saturation, 70 % of it for the gain, 5 % to 95 % for linearity) are those of the list of points in the order of their exposure.

mod points;
mod quantities;

pub use points::{Points, Spatial, Temporal, of_dataset};
pub use quantities::{Evaluation, evaluate};

/// Why a dataset has no EMVA 1288 evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EmvaError {
    /// The dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::DatasetError),
    /// What the standard needs is not there.
    #[error("EMVA 1288: {0}")]
    Missing(String),
    /// The user asked for the end.
    #[error("interrupted")]
    Interrupted,
}
