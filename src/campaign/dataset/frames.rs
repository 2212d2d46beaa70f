//! Frame reading: frames are checked against the manifest and cached for the next pass.

use super::{Dataset, DatasetError, FrameRow, Set, image, planes_in_words, split_page};
use crate::input::echo;
use ndarray::Array2;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError};

/// Part of a frame, rows and columns counted from 0.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Region {
    /// Range of rows.
    pub rows: Range<usize>,
    /// Range of columns.
    pub columns: Range<usize>,
}

impl Region {
    /// Returns the number of pixels.
    pub(crate) fn pixels(&self) -> usize {
        self.rows.len() * self.columns.len()
    }
}

/// Region retained of frames of size (rows, columns).
#[derive(Debug, Clone)]
pub(super) struct Cut {
    region: Region,
    whole: (usize, usize),
}

impl Dataset {
    /// Returns the campaign with only these pixels of each frame, counted from the current cut; `None`
    /// if none remain.
    pub(crate) fn cut_to(&self, region: Region) -> Option<Self> {
        if region.pixels() == 0 {
            return None;
        }
        let mut part = self.clone();
        let camera = &mut part.manifest.camera;
        let (shape, corner) = ((camera.height, camera.width), self.cut.as_ref());
        let whole = corner.map_or(shape, |cut| cut.whole);
        let (top, left) = corner.map_or((0, 0), |cut| (cut.region.rows.start, cut.region.columns.start));
        (camera.height, camera.width) = (region.rows.len(), region.columns.len());
        let rows = region.rows.start + top..region.rows.end + top;
        let columns = region.columns.start + left..region.columns.end + left;
        part.cut = Some(Cut { region: Region { rows, columns }, whole });
        part.kept = Arc::default();
        // Excluded sets that were exposed are read with the same cut.
        if let Some((all, passed_over)) = self.passed_over.as_deref() {
            part.passed_over = Some(Arc::new((all.cut_to(region)?, passed_over.clone())));
        }
        Some(part)
    }

    /// Returns the campaign with all pixels of its frames.
    pub(crate) fn uncut(mut self) -> Self {
        if let Some(Cut { whole, .. }) = self.cut.take() {
            (self.manifest.camera.height, self.manifest.camera.width) = whole;
            self.kept = Arc::default();
        }
        self
    }

    /// Returns one colour plane of a mosaic, as a campaign of half the size: the pixel at this row and
    /// column, 0 or 1, of every 2 x 2 cell.
    ///
    /// # Errors
    ///
    /// The dataset is already one plane, or holds statistics whose frames are not read again.
    pub fn plane(mut self, plane: [u8; 2]) -> Result<Self, DatasetError> {
        let fault =
            |message: &str| DatasetError::Manifest { path: self.root.clone(), message: message.into() };
        if self.manifest.plane.is_some() {
            return Err(fault("is one plane of a mosaic already; leave --plane out"));
        }
        if self.reduced.is_some() {
            return Err(fault("holds statistics of all pixels; take the plane where the frames are reduced"));
        }
        let camera = &mut self.manifest.camera;
        let half = |pixels: usize, from: u8| pixels.saturating_sub(from.into()).div_ceil(2);
        (camera.height, camera.width) = (half(camera.height, plane[0]), half(camera.width, plane[1]));
        camera.pixel_format = format!("Mono{}", camera.bit_depth);
        self.manifest.plane = Some(plane);
        self.kept = Arc::default();
        Ok(self)
    }

    /// Refuses a colour mosaic, for statistics that are valid only for pixels of one kind: its planes
    /// differ in light and, with a white balance, in gain.
    ///
    /// # Errors
    ///
    /// The dataset is a mosaic: its format and what to do.
    pub fn must_be_monochrome(&self) -> Result<(), DatasetError> {
        let camera = &self.manifest.camera;
        if !camera.is_mosaic() {
            return Ok(());
        }
        let message = format!(
            "pixel_format is {}: a colour mosaic, whose planes differ in light and gain; measure each colour by itself with {}",
            echo(&camera.pixel_format),
            planes_in_words(&camera.pixel_format)
        );
        Err(DatasetError::Manifest { path: self.root.clone(), message })
    }

    /// Reads one frame, (rows, columns) in DN, and checks size and range against the manifest.
    ///
    /// # Errors
    ///
    /// The frame cannot be read, or has another size or larger codes than the manifest says.
    pub fn read(&self, row: &FrameRow) -> Result<Array2<u16>, DatasetError> {
        if let Some(known) = self.kept.get(&row.file) {
            return Ok(Arc::unwrap_or_clone(known));
        }
        let mut buffer = image::Buffer::default();
        self.read_into(row, &mut buffer)?;
        Ok(buffer.into_array())
    }

    /// Reads one frame through a bounded cache, so that several passes decode it once.
    pub(crate) fn frame(&self, row: &FrameRow) -> Result<Arc<Array2<u16>>, DatasetError> {
        if let Some(known) = self.kept.get(&row.file) {
            return Ok(known);
        }
        let frame = Arc::new(self.read(row)?);
        self.kept.put(&row.file, &frame);
        Ok(frame)
    }

    /// Frees the cache of [`frame`](Self::frame).
    pub(crate) fn forget_frames(&self) {
        self.kept.clear();
    }

    /// Reads one frame into a recycled buffer, which is faster for many frames.
    ///
    /// # Errors
    ///
    /// As [`read`](Self::read).
    pub fn read_into(&self, row: &FrameRow, buffer: &mut image::Buffer) -> Result<(), DatasetError> {
        let fault = |message: String| DatasetError::Frame {
            file: row.file.clone(),
            set: row.set,
            index: row.index,
            message,
        };
        let (name, page) = split_page(&row.file).map_err(fault)?;
        let mut root = &self.root;
        let roots = || self.parts.iter().map(|(root, _)| root).chain(&self.folders);
        if let Some(of_part) = roots().find(|root| Path::new(name).starts_with(root)) {
            root = of_part;
        }
        // `root.join(name)` would repeat a name that already begins with the root.
        let path = if roots().next().is_none() { root.join(name) } else { name.into() };
        // A link inside the folder may point out of it.
        let whole = match (path.canonicalize(), root.canonicalize()) {
            (Ok(path), Ok(root)) if path.starts_with(&root) => path,
            (Ok(_), Ok(_)) => return Err(fault("the path leaves the dataset folder".into())),
            (Err(e), _) | (_, Err(e)) => {
                return Err(fault(format!("{}: {e}", echo(&path.display().to_string()))));
            }
        };
        self.must_be_one_row(row, (whole, page)).map_err(fault)?;
        let read = if row.file.len() == name.len() {
            image::read_into(&path, None, buffer)
        } else {
            self.opened.stack(&path).and_then(|images| images.read_into(page, buffer))
        };
        read.map_err(|e| match e {
            image::ImageError::Stack(_) => fault(format!("{e}; a row names its page as {name}#0")),
            e => fault(e.to_string()),
        })?;
        let camera = &self.manifest.camera;
        if let Some(plane) = self.manifest.plane {
            buffer.keep_plane(plane);
        }
        let shape = self.cut.as_ref().map_or((camera.height, camera.width), |cut| cut.whole);
        if buffer.shape() != shape {
            let (h, w) = buffer.shape();
            let of = self.manifest.plane.map_or(String::new(), |[y, x]| format!("has a plane {y},{x} that "));
            return Err(fault(format!(
                "{of}is {w} x {h} px, and dataset.toml says {} x {} px",
                shape.1, shape.0
            )));
        }
        if let Some(Cut { region, .. }) = &self.cut {
            buffer.crop(&region.rows, &region.columns);
        }
        let full_scale = camera.full_scale_dn();
        if buffer.dn().iter().fold(0, |a, &b| a | b) > full_scale {
            let largest = buffer.dn().iter().max().copied().unwrap_or(0);
            return Err(fault(format!(
                "holds {largest} DN, and bit_depth = {} in dataset.toml allows at most {full_scale} DN",
                camera.bit_depth
            )));
        }
        Ok(())
    }

    /// Refuses a file that another row also names, through a link or a loop of links.
    fn must_be_one_row(&self, row: &FrameRow, file: (PathBuf, usize)) -> Result<(), String> {
        let mut known = self.rows_of_files.lock().unwrap_or_else(PoisonError::into_inner);
        let first = known.entry(file).or_insert_with(|| row.file.clone());
        if *first == row.file {
            return Ok(());
        }
        Err(format!("is the file of row {} too, by a link: a frame is named twice", echo(first)))
    }

    /// Reads the frames of a set in time order.
    ///
    /// # Errors
    ///
    /// A frame cannot be read, or has another size or larger codes than the manifest says.
    pub fn read_set(&self, set: &Set) -> Result<Vec<Array2<u16>>, DatasetError> {
        set.rows.iter().map(|&i| self.read(&self.rows[i])).collect()
    }
}
