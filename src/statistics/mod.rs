//! Streaming, mergeable sums over frames, one accumulator per file.
//!
//! In: the frames of a set, one after the other. Out: [`pass::Summary`], the temporal and spatial statistics
//! of the set from one pass; [`moments::Moments`], mean and variance of every pixel. Values that a model is
//! compared with are made of them in [`observables`](crate::observables). Begin with [`pass`].

pub(crate) mod between_sets;
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
