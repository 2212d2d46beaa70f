//! Import of loose image files into a dataset folder. Formats are decoded in
//! [`dataset::image`](crate::dataset::image); only NumPy's is here.
//!
//! [`survey`] reads the files, [`propose`] sorts them into sets as a [`Map`], the user confirms or
//! completes it, and [`write()`] copies the frames. Unknown values are not guessed: [`Map::missing`]
//! lists values to be filled in.

mod camera;
mod cards;
mod facts;
mod headers;
mod kinds;
mod listing;
mod lists;
mod map;
pub mod names;
mod npy;
mod ome;
mod pixels;
mod plausible;
mod propose;
mod scale;
mod sections;
mod settings;
mod sidecar;
mod slice_labels;
mod source;
mod stacks;
mod stamps;
mod tables;
mod twins;
mod values;
mod words;
mod write;

pub use crate::dataset::Region;
pub use camera::{BOTTOM_UP, PATTERNS, ROW_ORDER, TOP_DOWN, pixel_format};
pub use facts::Facts;
pub use listing::{Listing, list};
pub use map::{MAP_FORMAT, Map, MapSet};
pub use propose::propose;
pub use scale::Scale;
pub use sections::region_of;
pub use source::ReadOptions;
pub use write::{must_be_free, write};

use crate::dataset::{DatasetError, Kind, image};
use facts::same_exposure;
use ndarray::{ArrayView2, s};
use scale::Census;
use source::Source;
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// Errors of an import.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// File that cannot be read or is not a frame.
    #[error("{path}: {message}")]
    File {
        /// The file.
        path: PathBuf,
        /// Fault, and what to do.
        message: String,
    },
    /// Files that do not form one dataset.
    #[error("{0}")]
    Files(String),
    /// Map that cannot be parsed, or is incomplete.
    #[error("{0}")]
    Map(String),
    /// Dataset that cannot be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Stopped by the user.
    #[error("interrupted; nothing was imported")]
    Interrupted,
}

/// Frame found in a file or in a page of one.
#[derive(Debug, Clone)]
pub struct Found {
    /// The file.
    pub path: PathBuf,
    /// Page, if the file has several.
    pub page: Option<usize>,
    /// Known facts of the frame.
    pub facts: Facts,
    /// Rows and columns, without overscan.
    pub shape: (usize, usize),
    /// Region of the frame in the file that is kept, and a description of the removed part; `None` for
    /// whole frames.
    pub region: Option<(Region, String)>,
    /// Mean, DN.
    pub mean_dn: f64,
    /// OR of all pixel codes.
    pub bits: u16,
    /// OR of the codes without the first and last row, where cameras write counters and times.
    pub inner_bits: u16,
    /// Bits per pixel in the file: 8, 16 or 32.
    pub stored_bits: u8,
    /// Means of the four positions in a 2 x 2 cell, DN: (0, 0), (0, 1), (1, 0), (1, 1) as (row, column).
    pub cells_dn: [f64; 4],
    /// Digest of the pixels, if a file of another format has the same name; else 0.
    pub digest: u64,
    /// Scale of the codes in all files; mean, cells and bits are in codes.
    pub scale: Scale,
    /// True if its values are not 16-bit codes and are rounded to codes.
    pub is_rounded: bool,
    /// Number of frames or pixels that the values of all files may be averages of.
    pub in_a_mean: Option<u32>,
}

/// Frames found, and unreadable files.
#[derive(Debug, Default)]
pub struct Survey {
    /// Frames in time order, or sorted by name if any lacks a time.
    pub frames: Vec<Found>,
    /// Files that cannot be read, or differ in size from most, each with the reason.
    pub damaged: Vec<(PathBuf, String)>,
    /// Notes on skipped frames and files.
    pub notes: Vec<String>,
}

/// Reads every file and page. A frame stored in two formats counts once.
///
/// # Errors
///
/// Files of several sizes without a majority, two files of one name with different pixels, or a stop by
/// the user.
pub fn survey(
    paths: &[PathBuf],
    options: &ReadOptions,
    mut step: impl FnMut(usize, usize) -> bool,
) -> Result<Survey, ImportError> {
    let mut out = Survey::default();
    let mut census = Census::default();
    let common = common_folder(paths);
    let twins = twins::names(paths);
    let tables = tables::FrameTables::beside(paths);
    for (at, path) in paths.iter().enumerate() {
        let mut go_on = || step(at, paths.len());
        let digest = twins.contains(&twins::name(path));
        let frames = Source::open(path, options)
            .map_err(|message| ImportError::File { path: path.clone(), message })
            .and_then(|source| {
                let mut names = named(path, &common);
                if !source.tells_all() {
                    let beside = sidecar::facts(path).or(tables.facts(path));
                    names = beside.or(names).or(tables.listed(path));
                }
                frames_of(path, &source, names, digest, &mut census, &mut go_on)
            });
        match frames {
            Ok((frames, notes)) => {
                out.frames.extend(frames);
                out.notes.extend(notes.into_iter().map(|note| format!("{}: {note}", path.display())));
            }
            Err(ImportError::File { message, .. }) => out.damaged.push((path.clone(), message)),
            Err(other) => return Err(other),
        }
    }
    if out.frames.iter().any(|f| f.facts.exposure_s.is_none()) {
        out.notes.extend(tables.unused());
    }
    out.notes.extend(twins::count_once(&mut out.frames)?);
    out.notes.extend(without_objects(&mut out.frames));
    out.damaged.extend(one_size(&mut out.frames)?);
    in_codes(&mut out.frames, &census)?;
    without_shared_stamps(&mut out.frames);
    // Sort by time; by name if any time is unknown.
    if out.frames.iter().all(|f| f.facts.time_s.is_some()) {
        out.frames.sort_by(|a, b| a.facts.time_s.unwrap_or(0.0).total_cmp(&b.facts.time_s.unwrap_or(0.0)));
    }
    Ok(out)
}

/// Removes times derived from names unless all frames have them and most are unique: otherwise the names
/// are those of a session, or the frames follow one another faster than the stamps resolve.
fn without_shared_stamps(frames: &mut [Found]) {
    let is_of_name = |f: &Found| f.facts.from.get("time_s").is_some_and(|from| from == names::NAME);
    let mut times: Vec<u64> =
        frames.iter().filter(|f| is_of_name(f)).filter_map(|f| f.facts.time_s).map(f64::to_bits).collect();
    times.sort_unstable();
    times.dedup();
    if !frames.iter().all(is_of_name) || 2 * times.len() <= frames.len() {
        for frame in frames.iter_mut().filter(|f| is_of_name(f)) {
            frame.facts.time_s = None;
            frame.facts.from.remove("time_s");
        }
    }
}

/// Excludes frames of objects if darks and flats are stated beside them.
fn without_objects(frames: &mut Vec<Found>) -> Option<String> {
    let stated = |kind: Kind| frames.iter().any(|f| f.facts.kind == Some(kind));
    let is_object = |f: &Found| f.facts.object && f.facts.kind.is_none();
    if !stated(Kind::Dark) || !stated(Kind::Flat) {
        return None;
    }
    let objects: Vec<String> =
        frames.iter().filter(|f| is_object(f)).map(|f| f.path.display().to_string()).collect();
    frames.retain(|f| !is_object(f));
    (!objects.is_empty()).then(|| {
        format!(
            "{} frames are stated as light frames or snapshots, neither dark nor flat, and are left out: {}",
            objects.len(),
            few(&objects)
        )
    })
}

/// Reads every frame of a file, and notes on skipped frames. `names`: facts of names and sidecar file.
fn frames_of(
    path: &Path,
    source: &Source,
    names: Facts,
    digest: bool,
    census: &mut Census,
    go_on: &mut impl FnMut() -> bool,
) -> Result<(Vec<Found>, Vec<String>), ImportError> {
    let fault = |message: String| ImportError::File { path: path.into(), message };
    let header = if source.tells_all() { Facts::default() } else { headers::facts(path).map_err(fault)?.0 };
    let mut of_file = header.clone().or(names.clone());
    if source.is_mosaic() {
        of_file.mosaic = of_file.mosaic.or_else(|| Some("a colour filter (CFA)".into()));
    }
    let pages = source.pages();
    let stored_bits = source.stored_bits().map_err(fault)?;
    let mut out: Vec<Found> = Vec::new();
    let (mut blank, mut thumbnails) = (0, 0);
    for &page in pages {
        if !go_on() {
            return Err(ImportError::Interrupted);
        }
        let values = source.values(page).map_err(fault)?;
        if source.is_blank(page, &values) {
            blank += 1;
            continue;
        }
        let (rows, columns) = match &values {
            image::Values::Codes(codes) => codes.dim(),
            image::Values::Numbers(numbers) => numbers.dim(),
        };
        // Programs append a thumbnail to a frame, and not all mark it as one.
        if out.first().is_some_and(|f| 2 * rows <= f.shape.0 && 2 * columns <= f.shape.1) {
            thumbnails += 1;
            continue;
        }
        let region =
            sections::region_of(source.told(page).unwrap_or(&of_file), (rows, columns)).map_err(fault)?;
        let values = match &region {
            Some(region) => values.region(region.rows.clone(), region.columns.clone()),
            None => values,
        };
        census.add(&values, path).map_err(fault)?;
        let digest = if digest { twins::digest(&values) } else { 0 };
        let is_rounded = matches!(values, image::Values::Numbers(_));
        let (pixels, bits, inner_bits) = match values {
            image::Values::Codes(codes) => {
                let of = |part: ArrayView2<'_, u16>| part.iter().fold(0, |a, b| a | b);
                // A frame of one or two rows has no inner rows.
                let rows = codes.nrows();
                let inner = if rows > 2 { of(codes.slice(s![1..rows - 1, ..])) } else { of(codes.view()) };
                (codes.mapv(f64::from), of(codes.view()), inner)
            }
            image::Values::Numbers(numbers) => (numbers, 0, 0),
        };
        let shape = pixels.dim();
        let mean = |pixels: ArrayView2<'_, f64>| pixels.iter().sum::<f64>() / pixels.len().max(1) as f64;
        let cell = |y: usize, x: usize| mean(pixels.slice(s![y.., x..]).slice(s![..;2, ..;2]));
        let whole = shape.0 >= 2 && shape.1 >= 2;
        // The single time of a stack is that of its first page.
        let mut header = header.clone();
        header.time_s = header.time_s.filter(|_| pages.len() == 1);
        let mut facts = match source.told(page) {
            Some(own) => {
                let of_name = Facts { time_s: names.time_s.filter(|_| pages.len() == 1), ..names.clone() };
                let facts = own.clone().or(header.beside(own)).or(of_name);
                Facts { mosaic: facts.mosaic.clone().or(of_file.mosaic.clone()), ..facts }
            }
            None => Facts { time_s: of_file.time_s.filter(|_| pages.len() == 1), ..of_file.clone() },
        };
        // The pattern in a header begins at the first pixel of the file.
        if let Some(region) = &region {
            let first = [region.columns.start, region.rows.start].map(|n| (n % 2) as i64);
            facts.mosaic = facts.mosaic.map(|pattern| words::shifted(&pattern, first));
        }
        out.push(Found {
            path: path.into(),
            page: (pages.len() > 1).then_some(page),
            facts,
            shape,
            region: region.map(|r| (r.clone(), r.cut_off((rows, columns)))),
            mean_dn: mean(pixels.view()),
            bits,
            inner_bits,
            stored_bits,
            cells_dn: if whole { [cell(0, 0), cell(0, 1), cell(1, 0), cell(1, 1)] } else { [0.0; 4] },
            digest,
            scale: Scale::default(),
            is_rounded,
            in_a_mean: None,
        });
    }
    let mut notes = source.notes().to_vec();
    if blank > 0 {
        notes.push(format!(
            "{blank} of {} frames hold nothing but zeros and are left out: never written, or cut off",
            pages.len()
        ));
    }
    if thumbnails > 0 {
        notes.push(format!(
            "{thumbnails} of {} pages are left out: pictures of half the size or less",
            pages.len()
        ));
    }
    if out.is_empty() && blank > 0 {
        return Err(fault(notes.join("; ")));
    }
    Ok((out, notes))
}

/// Converts the survey values to codes of one scale.
fn in_codes(found: &mut [Found], census: &Census) -> Result<(), ImportError> {
    let scale = census.scale().map_err(ImportError::Files)?;
    let bits = census.highest(&scale);
    let in_a_mean = census.in_a_mean();
    for frame in found.iter_mut() {
        frame.in_a_mean = in_a_mean;
        frame.scale = scale;
        frame.mean_dn = scale.of(frame.mean_dn);
        frame.cells_dn = frame.cells_dn.map(|mean| scale.of(mean));
        if frame.is_rounded || !scale.is_identity() {
            // The OR of all codes suffices, as all frames have one depth.
            (frame.bits, frame.inner_bits) = (bits, bits);
        }
    }
    Ok(())
}

/// Returns the facts of a file and its number of pages; header takes precedence over sidecar file, and
/// that over name. Tables of a folder are read only by an import: a lookup for every frame of a stream
/// would cost more than the frame.
///
/// # Errors
///
/// The file cannot be read.
pub fn facts(path: &Path) -> Result<(Facts, usize), ImportError> {
    let (header, pages) =
        headers::facts(path).map_err(|message| ImportError::File { path: path.into(), message })?;
    Ok((header.or(sidecar::facts(path)).or(named(path, path.parent().unwrap_or(Path::new("")))), pages))
}

/// Reads facts from a file name and the folders above it, from the common folder downwards.
fn named(path: &Path, common: &Path) -> Facts {
    let parent = path.parent().unwrap_or(Path::new(""));
    let word = |c: Component<'_>| match c {
        Component::Normal(name) => Some(name.to_string_lossy().into_owned()),
        _ => None,
    };
    let all: Vec<String> = parent.components().filter_map(word).collect();
    let above = common.components().filter_map(word).count();
    let from = above.saturating_sub(1).min(all.len());
    let folders: Vec<&str> = all[from..].iter().rev().map(String::as_str).collect();
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let own = all.len().saturating_sub(above);
    let mut facts = names::facts_in(&folders, own, &name);
    // From the folder above the common one only the kind is used: flat/1ms alone is a flat.
    if let Some(above) = from.checked_sub(1).and_then(|at| all.get(at)).filter(|a| !a.starts_with('.'))
        && facts.kind.is_none()
        && kinds::alone(above)
        && let Some(kind) = kinds::of(above).kind
    {
        facts.set_kind(kind, &format!("the folder {above}"));
    }
    facts
}

/// Returns the deepest folder above all files.
fn common_folder(paths: &[PathBuf]) -> PathBuf {
    let mut folders = paths.iter().map(|p| p.parent().unwrap_or(Path::new("")));
    let first = folders.next().unwrap_or(Path::new(""));
    let shared = |a: PathBuf, b: &Path| -> PathBuf {
        a.components().zip(b.components()).take_while(|(a, b)| a == b).map(|(a, _)| a).collect()
    };
    folders.fold(first.into(), shared)
}

/// Removes files that differ in size from most frames, with the reason.
///
/// # Errors
///
/// Files of several sizes without a majority.
fn one_size(frames: &mut Vec<Found>) -> Result<Vec<(PathBuf, String)>, ImportError> {
    let mut counts: Vec<((usize, usize), usize)> = Vec::new();
    for frame in frames.iter() {
        match counts.iter_mut().find(|(shape, _)| *shape == frame.shape) {
            Some((_, n)) => *n += 1,
            None => counts.push((frame.shape, 1)),
        }
    }
    if counts.len() < 2 {
        return Ok(Vec::new());
    }
    // Most frequent size; on a tie the first.
    let most = counts.iter().map(|(_, n)| *n).max().unwrap_or(0);
    let usual = counts.iter().find(|(_, n)| *n == most).map_or((0, 0), |(shape, _)| *shape);
    let of = |shape: (usize, usize)| format!("{} x {} px", shape.1, shape.0);
    let why = |shape| {
        format!("is {}, and {most} frames are {}; a dataset has frames of one size", of(shape), of(usual))
    };
    let mut odd: Vec<(PathBuf, String)> =
        frames.iter().filter(|f| f.shape != usual).map(|f| (f.path.clone(), why(f.shape))).collect();
    odd.dedup_by(|a, b| a.0 == b.0);
    if 2 * most <= frames.len() {
        let odd: Vec<String> = odd.iter().map(|(path, why)| format!("{}: {why}", path.display())).collect();
        return Err(ImportError::Files(few(&odd)));
    }
    let paths: BTreeSet<&PathBuf> = odd.iter().map(|(path, _)| path).collect();
    frames.retain(|f| !paths.contains(&f.path));
    Ok(odd)
}

/// Maximum number of texts listed in a message.
const LISTED: usize = 8;

/// Lists the first of many texts, and the number of the others.
pub(crate) fn few(texts: &[String]) -> String {
    match texts.len().saturating_sub(LISTED) {
        0 => texts.join("; "),
        more => format!("{}; and {more} more", texts[..LISTED].join("; ")),
    }
}

/// Minimum signal above the darkest frame, relative to full scale, of a lit frame.
const LIT: f64 = 0.02;

/// Returns the colour filter stated in headers.
pub fn stated_mosaic(found: &[Found]) -> Option<String> {
    found.iter().find_map(|f| f.facts.mosaic.clone())
}

/// Returns two files whose headers state different colour filters, with these.
pub fn mosaics_at_odds(found: &[Found]) -> Option<[(&Path, &str); 2]> {
    let mut stated = found.iter().filter_map(|f| Some((f.path.as_path(), f.facts.mosaic.as_deref()?)));
    let first = stated.next()?;
    stated.find(|other| other.1 != first.1).map(|other| [first, other])
}

/// Returns the spread of the four positions of a 2 x 2 cell in the brightest frame, relative to its
/// signal: tens of per cent for raw Bayer frames.
pub fn mosaic(found: &[Found]) -> f64 {
    let lowest = found.iter().map(|f| f.mean_dn).fold(f64::INFINITY, f64::min);
    let brightest = found.iter().max_by(|a, b| a.mean_dn.total_cmp(&b.mean_dn));
    // Darks alone give no answer.
    let Some(brightest) = brightest.filter(|f| f.mean_dn - lowest > LIT * f64::from(f.bits)) else {
        return 0.0;
    };
    let (low, high) = brightest
        .cells_dn
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    (high - low) / (brightest.mean_dn - lowest).max(1.0)
}

/// Minimum spread of cells under a colour filter: those of monochrome sensors agree to a few per mille.
pub const MOSAIC: f64 = 0.1;

/// Returns the usual bit depth that holds these codes.
fn depth_of(bits: u16) -> u8 {
    let needed = (u16::BITS - bits.leading_zeros()) as u8;
    [8, 10, 12, 14, 16].into_iter().find(|d| *d >= needed).unwrap_or(16)
}
