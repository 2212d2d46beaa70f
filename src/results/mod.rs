//! Results for people: any data source, report contents, reports.
//!
//! In: a dataset folder, statistics of parts of a campaign ([`reduction`]), an EMVA 1288 descriptor or a
//! table, opened by [`source`]. Out: noise, diagnosis, report contents as data ([`study`]) and their page
//! ([`report`]). [`reproduce`] repeats Section VII of the paper; [`investigate`] goes from a camera to a
//! verdict by itself. Begin with [`source::Source`].

pub mod investigate;
pub mod reduction;
pub mod report;
pub mod reproduce;
pub mod source;
pub mod study;
