//! Frame: pixels in DN, and the data that the camera sends with them.

use crate::pixel_format::PixelFormat;
use ndarray::Array2;
pub use radcam_sim::Region;

/// State of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Status {
    /// Every byte arrived, in the requested format and region.
    Complete,
    /// Damaged for this reason; the frame must not be used, and is counted.
    Damaged(String),
}

/// One frame of a stream.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Codes in DN, (rows, columns).
    pub pixels: Array2<u16>,
    /// State of the pixels.
    pub status: Status,
    /// Frame number by the camera's own count; the 16 bits of GigE Vision are unwrapped.
    pub id: u64,
    /// Device clock at the start of the frame, ns, if the camera reports it.
    pub timestamp_ns: Option<u64>,
    /// Sensor temperature when the frame was taken, degrees Celsius, if the camera reports it.
    pub temperature_c: Option<f64>,
}

impl Frame {
    /// Creates a frame to be filled.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            pixels: Array2::zeros((height, width)),
            status: Status::Damaged("nothing received yet".into()),
            id: 0,
            timestamp_ns: None,
            temperature_c: None,
        }
    }

    /// Returns the pixels row by row, in memory of the requested size; reallocates only if the size changes.
    pub fn pixels_mut(&mut self, width: usize, height: usize) -> &mut [u16] {
        if self.pixels.dim() != (height, width) {
            self.pixels = Array2::zeros((height, width));
        }
        self.pixels.as_slice_mut().unwrap_or_default()
    }

    /// Returns true if no pixel exceeds the largest code of the format.
    pub fn fits(&self, format: PixelFormat) -> bool {
        self.pixels.iter().fold(0, |a, &b| a | b) <= format.full_scale_dn()
    }
}
