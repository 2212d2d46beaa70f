//! Campaigns: from files on a disk to sets of frames that were looked at.
//!
//! In: folders, stacks, headers and names of any program ([`import`]), and [`plan`]s of campaigns to be
//! taken. Out: a [`dataset`], whose file formats are decoded in [`dataset::image`]; its slips, named and left
//! out ([`data_faults`]); a first look at its sets: pixels that count, level of the darks. A frame is one
//! exposure of an area of pixels of one kind: mosaics are split by [`dataset::Dataset::plane`], and lines of
//! a line scan have no form yet. Begin with [`dataset::Dataset`].

pub mod data_faults;
pub mod dataset;
pub(crate) mod first_look;
pub mod import;
pub mod plan;
