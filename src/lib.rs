//! x
pub mod bench;
pub mod camera;
pub mod capture;
pub mod dataset;
pub mod fit;
pub mod frame;
pub mod noise;
pub mod pixel_format;
pub mod plan;
pub mod statistics;
