//! Frames of one file, whatever holds them.

use super::npy;
use crate::dataset::image::{Images, Values};
use ndarray::Axis;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A file of frames, opened once.
pub struct Source(Kind);

enum Kind {
    Images(Images),
    Array(npy::Stack),
}

/// Share of their mean by which three planes of a cube differ at most where they are frames: colours differ by
/// more.
const SAME_LEVEL: f64 = 0.02;

impl Source {
    /// Opens a file. `axis` is the one that counts the frames of a NumPy array.
    ///
    /// # Errors
    ///
    /// Where the file is of no kind that radcam reads, or is damaged.
    pub fn open(path: &Path, axis: Option<usize>) -> Result<Self, String> {
        let mut start = Vec::new();
        let file = File::open(path).map_err(|e| e.to_string())?;
        file.take(6).read_to_end(&mut start).map_err(|e| e.to_string())?;
        if start == npy::MAGIC {
            return Ok(Self(Kind::Array(npy::read(path, axis)?)));
        }
        let images = Images::open(path).map_err(|e| e.to_string())?;
        let out = Self(Kind::Images(images));
        out.refuse_colours()?;
        Ok(out)
    }

    /// Numbers of the pages that are frames.
    pub fn pages(&self) -> Vec<usize> {
        match &self.0 {
            Kind::Images(images) => images.frames(),
            Kind::Array(array) => (0..array.len_of(Axis(0))).collect(),
        }
    }

    /// True if the file says that its pixels lie under a colour filter.
    pub fn is_mosaic(&self) -> bool {
        match &self.0 {
            Kind::Images(images) => images.frames().first().is_some_and(|page| images.is_mosaic(*page)),
            Kind::Array(_) => false,
        }
    }

    /// Bytes of the file are frames of a dataset as they are, once their codes are.
    pub fn is_image(&self) -> bool {
        match &self.0 {
            Kind::Images(images) => images.is_plain(),
            Kind::Array(_) => false,
        }
    }

    /// Values of a page: codes where they are whole and fit into 16 bits.
    ///
    /// # Errors
    ///
    /// Where there is no such page, or it cannot be read.
    pub fn values(&self, page: usize) -> Result<Values, String> {
        let values = match &self.0 {
            Kind::Images(images) => images.values(page).map_err(|e| e.to_string())?,
            Kind::Array(array) if page < array.len_of(Axis(0)) => {
                Values::Numbers(array.index_axis(Axis(0), page).to_owned())
            }
            Kind::Array(array) => {
                return Err(format!("has {} frames, and no frame {page}", array.len_of(Axis(0))));
            }
        };
        Ok(values.as_codes())
    }

    /// Three planes of a FITS cube are three frames, or the colours of one picture.
    fn refuse_colours(&self) -> Result<(), String> {
        let Kind::Images(images) = &self.0 else { return Ok(()) };
        if !images.is_cube() || images.frames().len() != 3 {
            return Ok(());
        }
        let mean = |page| Ok::<f64, String>(self.values(page)?.mean());
        let means = [mean(0)?, mean(1)?, mean(2)?];
        let (least, most) =
            means.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        if most - least <= SAME_LEVEL * most.abs() {
            return Ok(());
        }
        Err(format!(
            "is a FITS of three planes with means of {:.0}, {:.0} and {:.0}: colours made from a mosaic; save raw frames",
            means[0], means[1], means[2]
        ))
    }
}
