//! Transfer of frames into a dataset: copied or linked unchanged, or rewritten if a dataset cannot hold
//! them so.

use super::source::Source;
use super::{ImportError, Map, Region};
use crate::dataset::{image, write_whole};
use crate::input;
use ndarray::{Array2, s};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// State of the transfer into a dataset.
pub struct Taken<'a> {
    map: &'a Map,
    root: &'a Path,
    link: bool,
    /// Files and pages transferred so far, after resolving links.
    taken: BTreeSet<(PathBuf, usize)>,
    /// Names in the dataset of files copied whole.
    copies: BTreeMap<PathBuf, String>,
    /// File read last.
    open: Option<(PathBuf, Source)>,
    written: usize,
    shape: (usize, usize),
}

impl<'a> Taken<'a> {
    pub fn new(map: &'a Map, root: &'a Path, link: bool) -> Self {
        Self {
            map,
            root,
            link,
            taken: BTreeSet::new(),
            copies: BTreeMap::new(),
            open: None,
            written: 0,
            shape: (0, 0),
        }
    }

    /// Returns rows and columns of the frames.
    pub fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// Transfers a frame into the dataset, with reversed row order if `turned`; returns its name there.
    pub fn frame(&mut self, file: &str, turned: bool) -> Result<String, ImportError> {
        let (path, page) = file.rsplit_once('#').filter(|(_, p)| p.parse::<usize>().is_ok()).unzip();
        let source = PathBuf::from(path.unwrap_or(file));
        let fault = |message: String| ImportError::File { path: source.clone(), message };
        let number = page.and_then(|p| p.parse().ok()).unwrap_or(0);
        if source.canonicalize().is_ok_and(|whole| !self.taken.insert((whole, number))) {
            return Err(fault("is named twice in the map, by a link".into()));
        }
        let opened = match self.open.take().filter(|(of, _)| *of == source) {
            Some((_, opened)) => opened,
            None => Source::open(&source, &self.map.read_options()).map_err(fault)?,
        };
        let (_, opened) = self.open.insert((source.clone(), opened));
        let scale = self.map.scale();
        let as_it_is = opened.is_image()
            && !turned
            && scale.is_identity()
            && self.map.plane.is_none()
            && self.map.region.is_none();
        let number = if page.is_none() { opened.pages().first().copied().unwrap_or(0) } else { number };
        let values = opened.values(number).map_err(fault)?;
        let as_it_is = as_it_is && matches!(values, image::Values::Codes(_));
        let mut pixels = scale.codes(values).map_err(fault)?;
        if let Some(numbers) = self.map.region {
            let region = Region::from_numbers(numbers, pixels.dim()).ok_or_else(|| {
                let (rows, columns) = pixels.dim();
                fault(format!(
                    "is {columns} x {rows} px, and region = {numbers:?} of the map is no part of that"
                ))
            })?;
            pixels = region.of(&pixels).to_owned();
        }
        let pixels = self.anew(if turned { pixels.slice_move(s![..;-1, ..]) } else { pixels });
        self.check(&pixels).map_err(fault)?;
        if as_it_is {
            let page = page.map(|p| format!("#{p}")).unwrap_or_default();
            return Ok(self.copy(&source)? + &page);
        }
        if self.link {
            return Err(fault("its codes are written anew, and cannot be linked; leave --link out".into()));
        }
        let name = format!("frames/{:05}.tiff", self.written);
        self.written += 1;
        let bytes = image::tiff_bytes(&pixels, self.map.bit_depth).map_err(|e| fault(e.to_string()))?;
        write_whole(&self.root.join(&name), &bytes)?;
        Ok(name)
    }

    /// The map may contradict the files.
    fn check(&mut self, pixels: &Array2<u16>) -> Result<(), String> {
        if self.shape != (0, 0) && self.shape != pixels.dim() {
            let ((h, w), (rows, columns)) = (pixels.dim(), self.shape);
            return Err(format!("is {w} x {h} px, and the frames before it {columns} x {rows} px"));
        }
        self.shape = pixels.dim();
        let largest = pixels.iter().max().copied().unwrap_or(0);
        if u32::from(largest) >> self.map.bit_depth != 0 {
            return Err(format!("holds {largest} DN, more than bit_depth = {} allows", self.map.bit_depth));
        }
        Ok(())
    }

    /// Extracts one plane of a mosaic, or the whole frame.
    fn anew(&self, pixels: Array2<u16>) -> Array2<u16> {
        match self.map.plane {
            Some([y, x]) => pixels.slice(s![usize::from(y)..;2, usize::from(x)..;2]).to_owned(),
            None => pixels,
        }
    }

    fn copy(&mut self, source: &Path) -> Result<String, ImportError> {
        if let Some(name) = self.copies.get(source) {
            return Ok(name.clone());
        }
        let extension = source.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        let name = format!("frames/{:05}.{extension}", self.written);
        self.written += 1;
        let to = self.root.join(&name);
        let fault = |message: String| ImportError::File { path: source.into(), message };
        if self.link {
            // The link is resolved first: a link to a relative link would point to the wrong place.
            let whole = source.canonicalize().map_err(|e| fault(e.to_string()))?;
            std::fs::hard_link(whole, &to).map_err(|e| {
                fault(format!("cannot be linked into {}: {e}; leave --link out", self.root.display()))
            })?;
        } else {
            let copy = || std::io::copy(&mut input::open(source)?, &mut std::fs::File::create_new(&to)?);
            copy().map_err(|e| fault(e.to_string()))?;
        }
        self.copies.insert(source.into(), name.clone());
        Ok(name)
    }
}
