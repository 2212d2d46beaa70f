//! Evaluations of a campaign: Healey and Kondepudy 1994, and EMVA 1288.
//!
//! Input: an examined dataset or a table. Output: gain and read noise ([`noise`]), the correction of each
//! pixel ([`calibrate`], [`flat_field`], applied by [`correct`]), the standard's quantities ([`emva`]), and
//! the paper's scene variation, surfaces and budget of errors. Begin with [`noise`].

pub mod budget;
pub mod calibrate;
pub mod correct;
pub mod emva;
pub mod flat_field;
pub mod noise;
pub mod scene_variation;
pub mod surfaces;
