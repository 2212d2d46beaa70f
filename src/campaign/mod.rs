//! Campaigns: from files on a disk to sets of frames that were looked at.
//!
//! In: folders, stacks, headers and names of any program ([`import`]), and [`plan`]s of campaigns to be taken. Out: a
//! [`dataset`] whose slips are named and left out ([`data_faults`]), and a first look at its sets: pixels that count,
//! level of the darks. Begin with [`dataset::Dataset`].

pub mod data_faults;
pub mod dataset;
pub(crate) mod first_look;
pub mod import;
pub mod plan;
