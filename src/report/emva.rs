//! The EMVA 1288 datasheet.

use crate::dataset::CameraInfo;
use crate::emva::{Evaluation, Plot, Points};

/// What stands at the head.
#[derive(Debug)]
pub struct Head<'a> {
    /// The camera.
    pub camera: &'a CameraInfo,
    /// Dataset or descriptor.
    pub source: String,
    /// The command that made it.
    pub command: String,
}

/// The page.
pub fn html(_head: &Head<'_>, _points: &Points, _evaluation: &Evaluation, _plots: &[Plot]) -> String {
    String::new()
}
