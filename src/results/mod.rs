//! Results for users: data sources, studies over light and exposure, reports.
//!
//! Input: a dataset folder, statistics of parts of a campaign ([`reduction`]), an EMVA 1288 descriptor or a
//! table, opened by [`source`]. Output: noise, diagnosis and report. [`investigate`] goes from a camera to a
//! verdict automatically. Begin with [`source::Source`].

pub mod investigate;
pub mod reduction;
pub mod report;
pub mod reproduce;
pub mod source;
pub mod study;
