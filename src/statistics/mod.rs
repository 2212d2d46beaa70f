//! Streaming, mergeable statistics of frames, one observable per file.
//!
//! [`pass::Pass`] runs all statistics of a set's noise in one pass; [`moments::Moments`] keeps mean and
//! variance of every pixel.

pub mod code_step;
pub(crate) mod correlated_frames;
pub mod covariance;
pub mod frame_means;
pub mod jackknife;
pub mod layout;
pub mod level;
pub mod lines;
pub mod lit;
pub mod median;
pub mod moments;
pub mod occupancy;
pub(crate) mod outliers;
pub mod pass;
pub mod peak;
pub mod powers;
pub mod profiles;
pub mod quadratic;
pub(crate) mod quantisation;
pub mod spectrum;
pub mod steady;
pub mod step;
pub mod succession;
pub mod successive;
pub mod taps;
pub mod variance;
