//! HDF5 reader: stacks of frames in NeXus, DataExchange and plain files. The crate `hdf5-reader`
//! decodes.

use super::{ImageError, Stack, Values};
use hdf5_reader::error::Error;
use hdf5_reader::group::Group;
use hdf5_reader::storage::FileStorage;
use hdf5_reader::{
    Attribute, Dataset, Datatype, FilterRegistry, Hdf5File, OpenOptions, SliceInfo, SliceInfoElem,
};
use ndarray::{Array2, ArrayD, Ix2};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

/// Maximum compression ratio: deflate reaches about 1000:1 (RFC 1951).
const MAX_PACKING: u64 = 1100;
/// Minimum width and height of a dataset that is taken for frames without being named: tables and axis
/// vectors are narrower.
const MIN_SIDE_PX: u64 = 8;
/// Memory for decoded chunks: a chunk of many frames is decoded once, not once per frame.
const CHUNK_CACHE_BYTES: usize = 256 << 20;
/// Maximum number of groups visited.
const MAX_GROUPS: usize = 10_000;
/// Maximum depth of groups visited.
const MAX_DEPTH: usize = 32;
/// Maximum number of datasets listed in a message.
const MAX_LISTED: usize = 12;
/// Filter id of LZF, the compression of h5py (registered filters of the HDF Group).
const LZF: u16 = 32_000;
/// Other registered filters, with their names for messages.
const FILTERS: [(&str, &str); 8] = [
    ("32001", "Blosc"),
    ("32004", "LZ4"),
    ("32008", "bitshuffle"),
    ("32013", "ZFP"),
    ("32015", "Zstandard"),
    ("32017", "SZ"),
    ("32026", "Blosc2"),
    ("307", "bzip2"),
];

/// HDF5 file and its datasets of frames.
pub(super) struct Hdf5 {
    parts: Vec<Part>,
}

impl std::fmt::Debug for Hdf5 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.parts.iter().map(|p| &p.stack)).finish()
    }
}

/// One dataset of frames.
struct Part {
    dataset: Dataset,
    /// Axis that counts the frames, of three axes.
    axis: Option<usize>,
    bytes_each: u8,
    stack: Stack,
}

/// A dataset that may be frames.
struct Candidate {
    dataset: Dataset,
    paths: Vec<String>,
    /// True if NeXus marks the dataset as the signal.
    is_signal: bool,
}

/// Group with the names of its members.
struct Node {
    path: String,
    group: Group,
    datasets: Vec<String>,
    class: String,
    signal: String,
}

/// Contents of a file.
struct Tree {
    nodes: Vec<Node>,
    /// Descriptions of unreadable parts.
    faults: Vec<String>,
}

/// Describes an error of the decoder.
fn words(error: &Error) -> String {
    match error {
        Error::UnexpectedEof { .. } | Error::OffsetOutOfBounds(_) => {
            "cut short or damaged: it points behind its end".into()
        }
        Error::Io(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => {
            "cut short: the file ends before its data do".into()
        }
        Error::UnsupportedFilter(id) => {
            let name = FILTERS.iter().find(|(n, _)| id.ends_with(&format!(" {n}"))).map_or("", |f| f.1);
            format!(
                "packed with a filter that radcam does not read ({id}{}{name}); h5repack -f GZIP=4 IN OUT packs it \
                 anew",
                if name.is_empty() { "" } else { ", " }
            )
        }
        Error::UnsupportedLayoutClass(3) => {
            "a virtual dataset, whose frames lie in other files: give those".into()
        }
        Error::Context { source, .. } => words(source),
        other => other.to_string(),
    }
}

fn fault(error: &Error) -> ImageError {
    ImageError::Hdf5(words(error))
}

/// Decompresses LZF (liblzf 3.6).
fn lzf(data: &[u8]) -> Result<Vec<u8>, Error> {
    let broken = || Error::DecompressionError("LZF data are damaged".into());
    let mut out = Vec::with_capacity(data.len().saturating_mul(2));
    let mut at = 0;
    let mut next = |n: usize| {
        let part = data.get(at..at + n).ok_or_else(broken);
        at += n;
        part
    };
    while let Ok(&[control]) = next(1) {
        let control = usize::from(control);
        if control < 32 {
            out.extend(next(control + 1)?);
            continue;
        }
        let long = if control >> 5 == 7 { usize::from(next(1)?[0]) } else { 0 };
        let back = ((control & 31) << 8) + usize::from(next(1)?[0]) + 1;
        let from = out.len().checked_sub(back).ok_or_else(broken)?;
        // The copy may overlap its own end.
        for k in 0..(control >> 5) + long + 2 {
            out.push(out[from + k]);
        }
    }
    Ok(out)
}

impl Hdf5 {
    /// Finds the frames. `choice` is the path of the dataset to read, `axis` the axis that counts the
    /// frames, of three axes.
    pub(super) fn open(path: &Path, choice: Option<&str>, axis: Option<usize>) -> Result<Self, ImageError> {
        // No memory mapping: if another program truncated a mapped file, radcam would crash.
        let storage = FileStorage::from_file(crate::input::open(path)?).map_err(|e| fault(&e))?;
        let bytes = std::fs::metadata(path)?.len();
        let most = bytes.saturating_mul(MAX_PACKING).saturating_add(1 << 16);
        let limit = usize::try_from(super::input::max_unpacked_bytes(bytes)).unwrap_or(usize::MAX);
        let mut filters = FilterRegistry::new();
        filters.register(LZF, Box::new(|_, data, _| lzf(data)));
        let options = OpenOptions {
            filter_registry: Some(filters),
            chunk_cache_bytes: CHUNK_CACHE_BYTES,
            max_chunk_bytes: limit,
            max_read_bytes: limit,
            ..OpenOptions::default()
        };
        let file = Hdf5File::from_storage_with_options(Arc::new(storage), options).map_err(|e| fault(&e))?;
        let tree = Tree::of(file.root_group().map_err(|e| fault(&e))?);
        let mut all = tree.candidates(choice.is_some());
        let chosen = tree.choose(&mut all, choice)?;
        let mut parts = Vec::new();
        let mut first = 0;
        for candidate in chosen {
            let part = tree.part(candidate, axis, first, (most, bytes))?;
            first += part.stack.frames;
            parts.push(part);
        }
        Ok(Self { parts })
    }

    pub(super) fn pages(&self) -> usize {
        self.parts.iter().map(|p| p.stack.frames).sum()
    }

    pub(super) fn stacks(&self) -> impl Iterator<Item = &Stack> {
        self.parts.iter().map(|p| &p.stack)
    }

    /// Returns the bits per stored number.
    pub(super) fn bits(&self) -> u8 {
        self.parts.iter().map(|p| 8 * p.bytes_each).max().unwrap_or(16)
    }

    fn part(&self, page: usize) -> Result<(&Part, usize), ImageError> {
        let holds = |p: &&Part| (p.stack.first..p.stack.first + p.stack.frames).contains(&page);
        let part = self.parts.iter().find(holds).ok_or(ImageError::NoPage(page))?;
        Ok((part, page - part.stack.first))
    }

    /// Returns true if all values are the fill value of chunks: a frame that was never written.
    pub(super) fn is_blank(&self, page: usize, values: &Values) -> bool {
        let Ok((part, _)) = self.part(page) else { return false };
        let zero = match values {
            Values::Codes(codes) => codes.iter().all(|v| *v == 0),
            Values::Numbers(numbers) => numbers.iter().all(|v| *v == 0.0 || v.is_nan()),
        };
        zero && part.stack.frames > 1 && part.dataset.chunks().is_some()
    }

    pub(super) fn values(&self, page: usize) -> Result<Values, ImageError> {
        let (part, frame) = self.part(page)?;
        part.values(frame as u64)
    }
}

/// Runs a body with the Rust type of a dataset's numbers.
macro_rules! of_type {
    ($dtype:expr, $t:ident => $body:expr, else $other:expr) => {
        match $dtype {
            Datatype::FixedPoint { size: 1, signed: false, .. } => {
                type $t = u8;
                $body
            }
            Datatype::FixedPoint { size: 2, signed: false, .. } => {
                type $t = u16;
                $body
            }
            Datatype::FixedPoint { size: 4, signed: false, .. } => {
                type $t = u32;
                $body
            }
            Datatype::FixedPoint { size: 8, signed: false, .. } => {
                type $t = u64;
                $body
            }
            Datatype::FixedPoint { size: 1, signed: true, .. } => {
                type $t = i8;
                $body
            }
            Datatype::FixedPoint { size: 2, signed: true, .. } => {
                type $t = i16;
                $body
            }
            Datatype::FixedPoint { size: 4, signed: true, .. } => {
                type $t = i32;
                $body
            }
            Datatype::FixedPoint { size: 8, signed: true, .. } => {
                type $t = i64;
                $body
            }
            Datatype::FloatingPoint { size: 4, .. } => {
                type $t = f32;
                $body
            }
            Datatype::FloatingPoint { size: 8, .. } => {
                type $t = f64;
                $body
            }
            _ => $other,
        }
    };
}

/// Returns the bytes per number, or `None` for a type that is not a plain number.
fn bytes_each(dtype: &Datatype) -> Option<u8> {
    of_type!(dtype, T => Some(size_of::<T>() as u8), else None)
}

/// Returns the sizes without trailing axes of length 1, which some programs write for a single channel.
fn sizes(dataset: &Dataset) -> &[u64] {
    let mut shape = dataset.shape();
    while let [.., _, _, 1] = shape {
        shape = &shape[..shape.len() - 1];
    }
    shape
}

impl Part {
    #[allow(clippy::unnecessary_cast)] // one of the types is f64
    fn values(&self, frame: u64) -> Result<Values, ImageError> {
        let whole = || SliceInfoElem::Slice { start: 0, end: u64::MAX, step: 1 };
        let sizes = sizes(&self.dataset);
        let mut at: Vec<SliceInfoElem> =
            self.dataset.shape().iter().map(|_| SliceInfoElem::Index(0)).collect();
        let mut rest = frame;
        let leading = sizes.len() - 2;
        match self.axis.filter(|a| leading == 1 && *a < 3) {
            Some(axis) => {
                (0..3).for_each(|k| at[k] = if k == axis { SliceInfoElem::Index(frame) } else { whole() })
            }
            None => {
                for k in (0..leading).rev() {
                    at[k] = SliceInfoElem::Index(rest % sizes[k].max(1));
                    rest /= sizes[k].max(1);
                }
                (at[leading], at[leading + 1]) = (whole(), whole());
            }
        }
        let selection = SliceInfo { selections: at };
        fn plane<T>(array: Result<ArrayD<T>, Error>) -> Result<Array2<T>, ImageError> {
            let array = array.map_err(|e| fault(&e))?;
            array.into_dimensionality::<Ix2>().map_err(|e| ImageError::Hdf5(e.to_string()))
        }
        let dtype = self.dataset.dtype();
        if let Datatype::FixedPoint { size: 2, signed: false, .. } = dtype {
            return Ok(Values::Codes(plane(self.dataset.read_slice::<u16>(&selection))?));
        }
        if let Datatype::FixedPoint { size: 1, signed: false, .. } = dtype {
            return Ok(Values::Codes(plane(self.dataset.read_slice::<u8>(&selection))?.mapv(u16::from)));
        }
        of_type!(
            dtype,
            T => Ok(Values::Numbers(plane(self.dataset.read_slice::<T>(&selection))?.mapv(|v| v as f64))),
            else Err(ImageError::Hdf5(format!("{} holds no plain numbers", self.stack.path())))
        )
    }
}

/// Returns the text of a scalar attribute.
fn attribute_text(attribute: &Attribute) -> Option<String> {
    if attribute.num_elements().ok()? != 1 {
        return None;
    }
    let number = attribute.read_as_f64().ok().map(|n| n.to_string());
    number.or_else(|| attribute.read_string().ok()).map(|t| t.trim_matches('\0').trim().to_string())
}

/// Returns true for a name whose values count frame by frame: exposures and temperatures.
fn is_of_frames(name: &str) -> bool {
    let lower = name.to_lowercase();
    ["time", "expos", "temp"].iter().any(|part| lower.contains(part))
}

/// Returns the numbers of an attribute.
#[allow(clippy::unnecessary_cast)] // one of the types is f64
fn attribute_numbers(attribute: &Attribute) -> Option<Vec<f64>> {
    of_type!(
        &attribute.datatype,
        T => attribute.read_1d::<T>().ok().map(|values| values.into_iter().map(|v| v as f64).collect()),
        else None
    )
}

/// Returns the text of the attribute with this name.
fn text_of(attributes: &[Attribute], name: &str) -> String {
    attributes.iter().find(|a| a.name == name).and_then(attribute_text).unwrap_or_default()
}

/// Returns the unit of a dataset.
fn unit_of(dataset: &Dataset) -> String {
    let attributes = dataset.attributes();
    let found = ["units", "unit"].into_iter().map(|name| text_of(&attributes, name));
    found.into_iter().find(|text| !text.is_empty()).unwrap_or_default()
}

/// Returns the numbers of a dataset with one axis or none.
#[allow(clippy::unnecessary_cast)] // one of the types is f64
fn numbers(dataset: &Dataset) -> Option<Vec<f64>> {
    /// Maximum number of values, one per frame.
    const MAX_NUMBERS: u64 = 1 << 24;
    if dataset.ndim() > 1 || dataset.num_elements().ok()? > MAX_NUMBERS {
        return None;
    }
    of_type!(
        dataset.dtype(),
        T => dataset.read_array::<T>().ok().map(|a| a.iter().map(|v| *v as f64).collect()),
        else None
    )
}

/// Returns true for a name that states the kind of frame.
fn names_a_kind(path: &str) -> bool {
    let name = path.rsplit('/').next().unwrap_or(path).to_lowercase();
    let mut words = name.split(|c: char| !c.is_alphabetic());
    words.any(|w| {
        let word = w.trim_end_matches('s');
        ["dark", "flat", "white", "bia", "bias", "flatfield", "darkfield", "darkframe", "flatframe"]
            .contains(&word)
    })
}

fn parent(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(parent, _)| parent)
}

impl Tree {
    /// Walks the groups. Damaged groups are skipped, and reported if no frames are found.
    fn of(root: Group) -> Self {
        let mut out = Self { nodes: Vec::new(), faults: Vec::new() };
        let mut seen = BTreeSet::new();
        let mut next = vec![(String::new(), root, 0)];
        while let Some((path, group, depth)) = next.pop() {
            // Links may form a loop.
            if !seen.insert(group.address()) || out.nodes.len() == MAX_GROUPS {
                continue;
            }
            let (mut groups, datasets) = match group.member_names() {
                Ok(names) => names,
                Err(e) => {
                    out.faults.push(format!("{path}/: {}", words(&e)));
                    continue;
                }
            };
            // The member order of a file is meaningless. The last group pushed is visited first.
            groups.sort_by(|a, b| b.cmp(a));
            for name in groups.into_iter().filter(|_| depth < MAX_DEPTH) {
                match group.group(&name) {
                    Ok(inner) => next.push((format!("{path}/{name}"), inner, depth + 1)),
                    Err(e) => out.faults.push(format!("{path}/{name}: {}", words(&e))),
                }
            }
            let attributes = group.attributes().unwrap_or_default();
            let (class, signal) = (text_of(&attributes, "NX_class"), text_of(&attributes, "signal"));
            out.nodes.push(Node { path, group, datasets, class, signal });
        }
        out.nodes.sort_by(|a, b| a.path.cmp(&b.path));
        out
    }

    /// Lists datasets that may be frames, each once with all its names; of any size if `any_size`.
    fn candidates(&self, any_size: bool) -> Vec<Candidate> {
        let mut found: BTreeMap<u64, Candidate> = BTreeMap::new();
        for node in &self.nodes {
            for name in &node.datasets {
                let Ok(dataset) = node.group.dataset(name) else { continue };
                let [.., rows, columns] = sizes(&dataset)[..] else { continue };
                let side = if any_size { 1 } else { MIN_SIDE_PX };
                if rows < side || columns < side || bytes_each(dataset.dtype()).is_none() {
                    continue;
                }
                let is_signal = node.signal == *name
                    || (node.class == "NXdetector" && name == "data")
                    || !text_of(&dataset.attributes(), "signal").is_empty();
                let address = dataset.address();
                let entry = found.entry(address).or_insert(Candidate {
                    dataset,
                    paths: Vec::new(),
                    is_signal: false,
                });
                entry.paths.push(format!("{}/{name}", node.path));
                entry.is_signal |= is_signal;
            }
        }
        let mut out: Vec<Candidate> = found.into_values().collect();
        out.iter_mut().for_each(|c| c.paths.sort());
        out.sort_by(|a, b| a.paths.cmp(&b.paths));
        out
    }

    /// Chooses the frame datasets: the named one, the NeXus signal, the only one, or all whose names
    /// state a kind.
    fn choose(&self, all: &mut Vec<Candidate>, choice: Option<&str>) -> Result<Vec<Candidate>, ImageError> {
        let listed = |all: &[Candidate]| {
            let shape = |c: &Candidate| {
                let sizes: Vec<String> = c.dataset.shape().iter().map(ToString::to_string).collect();
                format!("{} ({})", c.paths[0], sizes.join(" x "))
            };
            let texts: Vec<String> = all.iter().take(MAX_LISTED).map(shape).collect();
            let more = all.len().saturating_sub(MAX_LISTED);
            texts.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
        };
        if let Some(choice) = choice {
            let path = format!("/{}", choice.trim_matches('/'));
            let place = all.iter().position(|c| c.paths.contains(&path));
            return match place {
                Some(place) => Ok(vec![all.swap_remove(place)]),
                None => {
                    let faults: Vec<&String> =
                        self.faults.iter().filter(|f| path.starts_with(parent(f))).take(1).collect();
                    let why = faults.first().map_or(String::new(), |f| format!(" ({f})"));
                    Err(ImageError::NoFrames(format!(
                        "an HDF5 file without a dataset of frames {path}{why}; it has {}",
                        if all.is_empty() { "none".into() } else { listed(all) }
                    )))
                }
            };
        }
        if all.iter().any(|c| c.is_signal) {
            all.retain(|c| c.is_signal);
        }
        if all.is_empty() {
            return Err(match self.faults.first() {
                Some(fault) => ImageError::Hdf5(fault.clone()),
                None => ImageError::NoFrames(
                    "an HDF5 file without frames: it has no dataset of two axes or more with numbers; links to other \
                     files are not followed, so give those"
                        .into(),
                ),
            });
        }
        if all.len() == 1 {
            return Ok(std::mem::take(all));
        }
        let says = |c: &Candidate| c.paths.iter().any(|p| names_a_kind(p));
        if all.iter().all(says) {
            return Ok(std::mem::take(all));
        }
        // DataExchange stores the projections as data, next to data_white and data_dark.
        let exchange = |c: &Candidate| c.paths.iter().any(|p| parent(p).ends_with("exchange"));
        let projections = |c: &Candidate| c.paths.iter().any(|p| p.ends_with("exchange/data"));
        if all.iter().all(exchange) && all.iter().all(|c| says(c) || projections(c)) {
            return Ok(std::mem::take(all));
        }
        Err(ImageError::NoFrames(format!(
            "an HDF5 file with {} datasets that may be frames: {}; say which with --hdf5-dataset PATH of `radcam import`",
            all.len(),
            listed(all)
        )))
    }

    /// Builds a part from a dataset and the values stored with it.
    fn part(
        &self,
        candidate: Candidate,
        axis: Option<usize>,
        first: usize,
        (most_bytes, file_bytes): (u64, u64),
    ) -> Result<Part, ImageError> {
        let Candidate { dataset, paths, .. } = candidate;
        let each = bytes_each(dataset.dtype()).unwrap_or(8);
        let sizes = sizes(&dataset).to_vec();
        let leading = &sizes[..sizes.len() - 2];
        let axis = axis.filter(|a| leading.len() == 1 && *a < 3);
        let claimed = sizes.iter().try_fold(u64::from(each), |n, k| n.checked_mul(*k));
        if claimed.is_none_or(|n| n > most_bytes) {
            return Err(ImageError::Hdf5(format!(
                "{} claims the size {sizes:?}, more than the file can hold",
                paths[0]
            )));
        }
        let frames: u64 = axis.map_or(leading.iter().product(), |a| sizes[a]);
        let frames = usize::try_from(frames).unwrap_or(0);
        if frames == 0 {
            return Err(ImageError::NoFrames(format!("an HDF5 file whose {} has no frames yet", paths[0])));
        }
        let pixels = sizes.iter().product::<u64>() / frames as u64;
        if super::is_packed_too_much(pixels, 1, 8, file_bytes) {
            return Err(ImageError::Hdf5(format!(
                "{} has frames of {pixels} px in {file_bytes} bytes: large images are packed 64 to 1 at most",
                paths[0]
            )));
        }
        let mut stack = Stack { paths, first, frames, ..Stack::default() };
        let outer = leading.first().filter(|_| leading.len() > 1).map_or(frames, |n| *n as usize);
        self.describe(&dataset, outer, &mut stack)?;
        Ok(Part { dataset, axis, bytes_each: each, stack })
    }

    /// Reads image keys and the values of the dataset, of its parent groups and of detectors: one for
    /// all frames, one per frame, or one per place on the outer axis.
    fn describe(&self, dataset: &Dataset, outer: usize, stack: &mut Stack) -> Result<(), ImageError> {
        let paths = stack.paths.clone();
        let above = |node: &Node| paths.iter().any(|p| p.starts_with(&format!("{}/", node.path)));
        let beside = |node: &Node| paths.iter().any(|p| parent(p) == node.path);
        let detector = |node: &Node| {
            let name = node.path.rsplit('/').next().unwrap_or_default().to_lowercase();
            node.class == "NXdetector" || name.contains("detector") || name.contains("camera")
        };
        let mut attributes = dataset.attributes();
        for node in self.nodes.iter().filter(|n| above(n) || detector(n)) {
            attributes.extend(node.group.attributes().unwrap_or_default());
            for name in &node.datasets {
                let Ok(value) = node.group.dataset(name) else { continue };
                if value.address() == dataset.address() || value.ndim() > 1 {
                    continue;
                }
                let Ok(count) = value.num_elements() else { continue };
                let is_key = matches!(name.as_str(), "image_key" | "image_key_control") && beside(node);
                if is_key && (name == "image_key" || stack.keys.is_empty()) {
                    let keys = numbers(&value).unwrap_or_default();
                    if keys.len() != stack.frames {
                        return Err(ImageError::Hdf5(format!(
                            "{}/{name} has {} values, and {} has {} frames",
                            node.path,
                            keys.len(),
                            stack.path(),
                            stack.frames
                        )));
                    }
                    stack.keys = keys.into_iter().map(|k| k as i64).collect();
                } else if count == 1 {
                    let number = numbers(&value).and_then(|n| n.first().copied());
                    let text = || value.read_string().ok();
                    let Some(text) = number.map(|n| n.to_string()).or_else(text) else { continue };
                    stack.said.push((name.clone(), format!("{} {}", text.trim(), unit_of(&value))));
                } else if is_of_frames(name)
                    && let Some(each) = stack.each(numbers(&value).unwrap_or_default(), outer)
                {
                    let unit = unit_of(&value);
                    let texts = each.into_iter().map(|v| format!("{v} {unit}")).collect();
                    stack.of_frames.push((name.clone(), texts));
                }
            }
        }
        for attribute in attributes.iter().filter(|a| is_of_frames(&a.name)) {
            let values = attribute_numbers(attribute).unwrap_or_default();
            if let Some(each) = stack.each(values, outer).filter(|each| each.len() > 1) {
                let texts = each.iter().map(f64::to_string).collect();
                stack.of_frames.push((attribute.name.clone(), texts));
            }
        }
        let said = attributes.iter().filter_map(|a| Some((a.name.clone(), attribute_text(a)?)));
        stack.said.extend(said);
        Ok(())
    }
}
