//! A frame: its pixels in DN, and what the camera said of it.

use crate::pixel_format::PixelFormat;
use ndarray::Array2;
pub use radcam_sim::Region;

/// Whether a frame may be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Status {
    /// Every byte arrived, in the format and region that were asked for.
    Complete,
    /// Something is wrong with it; it must not be used, and is counted.
    Damaged(String),
}

/// One frame of a stream.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Codes in DN, (rows, columns).
    pub pixels: Array2<u16>,
    /// Whether the pixels may be used.
    pub status: Status,
    /// Number of the frame by the camera's own count; the 16 bits of GigE Vision are unwrapped.
    pub id: u64,
    /// Device clock at the start of the frame, ns, where the camera tells.
    pub timestamp_ns: Option<u64>,
    /// Sensor temperature when the frame was taken, degrees Celsius, where the camera tells.
    pub temperature_c: Option<f64>,
}

impl Frame {
    /// A frame to be filled.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            pixels: Array2::zeros((height, width)),
            status: Status::Damaged("nothing received yet".into()),
            id: 0,
            timestamp_ns: None,
            temperature_c: None,
        }
    }

    /// The pixels row by row, in memory of the size asked for; reallocates only when that changes.
    pub fn pixels_mut(&mut self, width: usize, height: usize) -> &mut [u16] {
        if self.pixels.dim() != (height, width) {
            self.pixels = Array2::zeros((height, width));
        }
        self.pixels.as_slice_mut().unwrap_or_default()
    }

    /// Largest code that a pixel of the format can hold is not passed by any pixel.
    pub fn fits(&self, format: PixelFormat) -> bool {
        self.pixels.iter().fold(0, |a, &b| a | b) <= format.full_scale_dn()
    }
}
