//! One integration binary, laid out as `src/` is: the library's public face, the real program, the real
//! libaravis.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // tests may stop where they stumble, and say what they skipped

mod bands;
mod blind;
mod calibration;
mod camera;
mod cases_numbers;
mod conformance;
mod containers;
mod cost;
mod dark_faults;
mod data_faults;
mod dataset;
mod docs;
mod effect_shapes;
mod effects;
mod eight_bits;
mod emva;
mod far_slips;
mod few_darks;
mod flat_field;
mod flicker;
mod frame_headers;
mod fuzz;
#[cfg(feature = "hdf5")]
mod hdf5;
mod hostile_files;
#[cfg(feature = "aravis")]
mod hostile_network;
mod hostile_outputs;
mod import;
mod import_cases;
mod import_files;
mod import_levels;
mod import_names;
mod investigate;
mod jitter_of_the_samples;
mod judge;
mod killed;
mod laws;
mod mixed_frames;
mod models;
mod monitor;
mod mosaics;
mod near_slips;
#[cfg(feature = "aravis")]
mod network;
mod no_slips;
mod noise;
#[cfg(feature = "aravis")]
mod outages;
mod outside;
mod own_effects;
mod predictions;
mod program;
mod real;
mod reduction;
mod report;
mod rewritten;
mod rooms;
mod sensors;
#[cfg(feature = "aravis")]
mod serve;
mod source;
mod support;
mod tiff_files;
mod unlike_kinds;
mod workbench;
mod wrong_inputs;
