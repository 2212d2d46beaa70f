//! Frames of files on their way into a dataset: copied or linked as they are, or written anew where a dataset cannot have them so.

use super::{ImportError, Map};
use crate::dataset::{image, write_whole};
use ndarray::{Array2, Array3, ArrayViewD, Axis, Ix2, Ix3, s};
use ndarray_npy::ViewNpyExt;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// The frames of a numpy array (frames, rows, columns) or (rows, columns) of whole numbers that fit into 16 bits; `None` of any other file.
pub fn npy(path: &Path) -> Result<Option<Array3<u16>>, String> {
    let mut start = [0; 6];
    let file = File::open(path).map_err(|e| e.to_string())?;
    if BufReader::new(file).read_exact(&mut start).is_err() || start != *b"\x93NUMPY" {
        return Ok(None);
    }
    // Types in the order of what cameras' programs write.
    let frames = of::<u16>(path)
        .or_else(|first| of::<u8>(path).map_err(|_| first))
        .or_else(|first| of::<i32>(path).map_err(|_| first))
        .or_else(|first| of::<u32>(path).map_err(|_| first))
        .or_else(|first| of::<i64>(path).map_err(|_| first))
        .or_else(|first| of::<i16>(path).map_err(|_| first))?;
    Ok(Some(frames))
}

fn of<T>(path: &Path) -> Result<Array3<u16>, String>
where
    T: ndarray_npy::ViewElement + Copy + TryInto<u16> + std::fmt::Display,
{
    // The whole file, and no memory for what a header claims beyond it.
    let bytes = std::fs::read(path).map_err(|e| e.to_string())?;
    let array = ArrayViewD::<T>::view_npy(&bytes).map_err(|e| {
        format!("cannot be read as numpy array of whole numbers (uint8, uint16, int32) in the order of this machine: {e}")
    })?;
    let dims = array.ndim();
    let array = match dims {
        2 => array.into_dimensionality::<Ix2>().map(|a| a.insert_axis(Axis(0))),
        _ => array.into_dimensionality::<Ix3>(),
    }
    .map_err(|_| format!("has {dims} axes; frames are (rows, columns), stacks (frames, rows, columns)"))?;
    let mut codes = Vec::with_capacity(array.len());
    for value in &array {
        codes.push((*value).try_into().map_err(|_| format!("holds {value}, and codes are 0 to 65535"))?);
    }
    Array3::from_shape_vec(array.dim(), codes).map_err(|e| e.to_string())
}

/// What was taken into a dataset so far.
pub struct Taken<'a> {
    map: &'a Map,
    root: &'a Path,
    link: bool,
    /// Names in the dataset of files that were copied whole.
    copies: BTreeMap<PathBuf, String>,
    /// The array that was read last.
    array: Option<(PathBuf, Array3<u16>)>,
    written: usize,
    shape: (usize, usize),
}

impl<'a> Taken<'a> {
    pub fn new(map: &'a Map, root: &'a Path, link: bool) -> Self {
        Self { map, root, link, copies: BTreeMap::new(), array: None, written: 0, shape: (0, 0) }
    }

    /// Rows and columns of the frames.
    pub fn shape(&self) -> (usize, usize) {
        self.shape
    }

    /// Brings a frame into the dataset; its name there.
    pub fn frame(&mut self, file: &str) -> Result<String, ImportError> {
        let (path, page) = file.rsplit_once('#').filter(|(_, p)| p.parse::<usize>().is_ok()).unzip();
        let source = PathBuf::from(path.unwrap_or(file));
        let fault = |message: String| ImportError::File { path: source.clone(), message };
        let number = page.and_then(|p| p.parse().ok()).unwrap_or(0);
        if self.array.as_ref().is_none_or(|(of, _)| *of != source) {
            self.array = npy(&source).map_err(fault)?.map(|array| (source.clone(), array));
        }
        let as_it_is = self.array.is_none() && self.map.shift == 0 && self.map.plane.is_none();
        if as_it_is {
            self.check(&image::read(&source, number).map_err(|e| fault(e.to_string()))?).map_err(fault)?;
            let page = page.map(|p| format!("#{p}")).unwrap_or_default();
            return Ok(self.copy(&source)? + &page);
        }
        if self.link {
            return Err(fault("its codes are written anew, and cannot be linked; leave --link out".into()));
        }
        let pixels = match &self.array {
            Some((_, array)) if number < array.len_of(Axis(0)) => {
                array.index_axis(Axis(0), number).to_owned()
            }
            Some((_, array)) => {
                return Err(fault(format!("has {} frames, and no frame {number}", array.len_of(Axis(0)))));
            }
            None => image::read(&source, number).map_err(|e| fault(e.to_string()))?,
        };
        let pixels = self.anew(pixels);
        self.check(&pixels).map_err(fault)?;
        let name = format!("frames/{:05}.tiff", self.written);
        self.written += 1;
        let bytes = image::tiff_bytes(&pixels, self.map.bit_depth).map_err(|e| fault(e.to_string()))?;
        write_whole(&self.root.join(&name), &bytes)?;
        Ok(name)
    }

    /// A map may say what the files do not bear out.
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

    /// Codes shifted down, one plane of a mosaic.
    fn anew(&self, pixels: Array2<u16>) -> Array2<u16> {
        let shifted = pixels.mapv(|v| v >> self.map.shift);
        match self.map.plane {
            Some([y, x]) => shifted.slice(s![usize::from(y)..;2, usize::from(x)..;2]).to_owned(),
            None => shifted,
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
            // A link to a link would point from another place.
            let whole = source.canonicalize().map_err(|e| fault(e.to_string()))?;
            std::fs::hard_link(whole, &to).map_err(|e| {
                fault(format!("cannot be linked into {}: {e}; leave --link out", self.root.display()))
            })?;
        } else {
            std::fs::copy(source, &to).map_err(|e| fault(e.to_string()))?;
        }
        self.copies.insert(source.into(), name.clone());
        Ok(name)
    }
}
