//! The model against measurements: where it fails, and which effect is missing.
//!
//! In: an examined dataset. Out: measured values with their errors ([`observables`]), a fit of the sensor to
//! them ([`inference`]), names, sizes and costs of the missing effects ([`diagnosis`]); [`model`] writes them
//! into a model file. Begin with [`diagnosis::Diagnosis`].

pub mod diagnosis;
pub mod inference;
pub mod model;
pub mod observables;
