//! Frames of one file of any format.

use super::{Facts, headers, npy, ome, slice_labels, stacks};
use crate::dataset::image::{self, Images, NUMPY, Stack, Values};
use ndarray::{Array3, Axis};
use std::collections::BTreeMap;
use std::path::Path;

/// Options for a file with several arrays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Axis that counts the frames of NumPy arrays and of HDF5 datasets with three axes; default: the
    /// first.
    pub frames_axis: Option<usize>,
    /// Path of the dataset of frames in HDF5 files; default: the only candidate.
    pub hdf5_dataset: Option<String>,
}

/// Open file of frames.
pub struct Source {
    kind: Kind,
    /// Numbers of the pages that are frames.
    pages: Vec<usize>,
    /// Facts of single pages, if the file states them.
    told: BTreeMap<usize, Facts>,
    /// Descriptions of skipped frames.
    notes: Vec<String>,
    /// True if every dataset reader can read the file.
    is_image: bool,
}

enum Kind {
    Images(Images),
    Array(npy::Stack),
}

/// Maximum difference of three planes of a cube, relative to their mean, if they are frames: colours
/// differ by more.
const SAME_LEVEL: f64 = 0.02;

impl Source {
    /// Opens a file.
    ///
    /// # Errors
    ///
    /// The file has a format that radcam does not read, or is damaged.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Self, String> {
        let start = crate::input::start(path, 6).map_err(|e| e.to_string())?;
        let of = |kind, pages| {
            let is_image = matches!(&kind, Kind::Images(images) if images.is_plain());
            Self { kind, pages, told: BTreeMap::new(), notes: Vec::new(), is_image }
        };
        if start == NUMPY {
            let array = npy::read(path, options.frames_axis)?;
            let pages = (0..array.len_of(Axis(0))).collect();
            return Ok(of(Kind::Array(array), pages));
        }
        let images = Images::open_with(path, options.hdf5_dataset.as_deref(), options.frames_axis);
        let images = images.map_err(|e| e.to_string())?;
        let (pages, found) = (images.frames(), images.stacks());
        if !found.is_empty() {
            if options.frames_axis.is_none() {
                found.iter().try_for_each(|stack| frames_come_first(&images, stack))?;
            }
            let stacks::Told { facts, notes } = stacks::told(&found)?;
            let pages = facts.keys().copied().collect();
            return Ok(Self { told: facts, notes, ..of(Kind::Images(images), pages) });
        }
        let mut told = ome::planes(path, &pages);
        if told.is_empty() && !image::begins_as_fits(&start) {
            told = headers::of_pages(path, &pages);
        }
        if told.is_empty() && !image::begins_as_fits(&start) {
            told = slice_labels::facts(path, &pages);
        }
        let out = Self { told, ..of(Kind::Images(images), pages) };
        out.refuse_colours()?;
        Ok(out)
    }

    /// Returns the numbers of the pages that are frames.
    pub fn pages(&self) -> &[usize] {
        &self.pages
    }

    /// Returns the facts of a page, if the file states them per page.
    pub fn told(&self, page: usize) -> Option<&Facts> {
        self.told.get(&page)
    }

    /// Returns true if the file states nothing beyond the facts of its pages.
    pub fn tells_all(&self) -> bool {
        matches!(&self.kind, Kind::Images(images) if !images.stacks().is_empty())
    }

    /// Returns descriptions of skipped frames.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Returns true for the values of a frame that was never written.
    pub fn is_blank(&self, page: usize, values: &Values) -> bool {
        matches!(&self.kind, Kind::Images(images) if images.is_blank(page, values))
    }

    /// Returns true if the file marks its pixels as a colour-filter mosaic.
    pub fn is_mosaic(&self) -> bool {
        match &self.kind {
            Kind::Images(images) => self.pages.first().is_some_and(|page| images.is_mosaic(*page)),
            Kind::Array(_) => false,
        }
    }

    /// Returns true if the file can be copied into a dataset unchanged, provided that its codes can.
    pub fn is_image(&self) -> bool {
        self.is_image
    }

    /// Returns the bits per pixel in the file, 8, 16 or 32; 16 for arrays, whose values are converted to
    /// codes.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub fn stored_bits(&self) -> Result<u8, String> {
        match &self.kind {
            Kind::Images(images) if self.is_image => images.stored_bits().map_err(|e| e.to_string()),
            _ => Ok(16),
        }
    }

    /// Reads the values of a page: codes if they are whole and fit into 16 bits.
    ///
    /// # Errors
    ///
    /// There is no such page, or it cannot be read.
    pub fn values(&self, page: usize) -> Result<Values, String> {
        let values = match &self.kind {
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

    /// Refuses a FITS cube of three planes with different levels: they may be the colours of one
    /// picture.
    fn refuse_colours(&self) -> Result<(), String> {
        let Kind::Images(images) = &self.kind else { return Ok(()) };
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

/// Maximum number of frames of a stack, and of their rows and columns, examined to find the frame axis.
const LOOKED_AT: usize = 16;
const CORNER: usize = 256;

/// Refuses a stack of an HDF5 file whose first axis may not count the frames; values stored per frame
/// prove that it does.
fn frames_come_first(images: &Images, stack: &Stack) -> Result<(), String> {
    if !stack.keys.is_empty() || !stack.of_frames.is_empty() || stack.frames < 2 {
        return Ok(());
    }
    let mut array = Array3::zeros((0, 0, 0));
    let mut shape = (stack.frames, 0, 0);
    for page in stack.first..stack.first + stack.frames.min(LOOKED_AT) {
        let values = images.values(page).map_err(|e| e.to_string())?;
        let size = match &values {
            Values::Codes(codes) => codes.dim(),
            Values::Numbers(numbers) => numbers.dim(),
        };
        (shape.1, shape.2) = size;
        let corner = match values.region(0..size.0.min(CORNER), 0..size.1.min(CORNER)) {
            Values::Codes(codes) => codes.mapv(f64::from),
            Values::Numbers(numbers) => numbers,
        };
        if array.is_empty() {
            array = Array3::zeros((0, corner.nrows(), corner.ncols()));
        }
        array.push(Axis(0), corner.view()).map_err(|e| e.to_string())?;
    }
    npy::frames_come_first(&array, shape)
        .map_err(|why| format!("{} {why}", stack.paths.first().map_or("", |p| p.as_str())))
}
