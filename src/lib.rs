//! x
pub mod bench;
pub mod camera;
pub mod capture;
pub mod dataset;
pub mod frame;
pub mod pixel_format;
pub mod plan;
