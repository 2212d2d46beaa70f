//! The model against measurements: where it fails, and which effect is missing.
//!
//! In: an examined dataset. Out: statistics with their errors ([`observables`]), a fit of the sensor to them
//! ([`inference`]), and names, sizes and costs of the effects that the model lacks ([`diagnosis`]), which a
//! [`model`] file then has. Begin with [`diagnosis::Diagnosis`].

pub mod diagnosis;
pub mod inference;
pub mod model;
pub mod observables;
