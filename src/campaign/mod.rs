//! Campaigns: from image files to examined sets of frames.
//!
//! Input: folders, stacks, headers and file names of any program ([`import`]), and [`plan`]s of
//! campaigns to be captured. Output: a [`dataset`] whose faulty frames are named and excluded
//! ([`data_faults`]), and a first look at its sets: usable pixels and dark level. Begin with
//! [`dataset::Dataset`].

pub mod data_faults;
pub mod dataset;
pub(crate) mod first_look;
pub mod import;
pub mod plan;
