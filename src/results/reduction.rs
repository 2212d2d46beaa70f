//! Statistics of a campaign, or of a part of it, in a file: everything that `noise`, `compare` and `diagnose`
//! need from its frames.
//!
//! A campaign is read in pieces of successive frames of a set; each piece is reduced independently. A piece
//! depends on its frames and on the first look at every set of the campaign: the valid pixels, the level of
//! the darks, the usual scatter of the frames. A digest of that first look is stored with the piece. When
//! parts are merged, pieces reduced under the first look of the whole campaign are taken unchanged; all
//! others are recomputed from their frames. The statistics of a split campaign therefore equal those of the
//! whole, bit for bit.
//!
//! No frames are read again if all parts know the first look of the whole campaign ([`Options::plan`]). This
//! takes two rounds; the first reads at most eight frames of a set.
//!
//! The file is a line `radcam statistics 1`, a CBOR item (RFC 8949) and the SHA-256 of both.

use crate::data_faults::{SetFacts, examined, facts_of, part_that_jumps};
use crate::dataset::{
    Dataset, DatasetError, FrameRow, HEAD, Key, Manifest, Reduced, Set, is_statistics, write_whole,
};
use crate::first_look::{Look, Seen, record_looks};
use crate::noise::{Mask, NoiseError, level_of};
use crate::observables::{LeftOut, ObserveError, Work, record};
use crate::statistics::level::Level;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Length of a SHA-256 digest, bytes.
const DIGEST: usize = 32;
/// Maximum pixels per byte of a file. Statistics of the smallest set take more than a byte for 64 pixels.
const PIXELS_PER_BYTE: usize = 64;

/// Statistics of a piece, and the data left out of it.
type Piece = (Work, LeftOut);

/// Options of the reduction.
#[derive(Debug, Default)]
pub struct Options {
    /// First look at the whole campaign: the result of [`Options::look_only`] for all its parts. Sets of
    /// which a part has all frames are reduced as parts of that campaign.
    pub plan: Option<Dataset>,
    /// Computes only the first look, from which a plan is made.
    pub look_only: bool,
}

/// Reduces parts of one campaign (datasets or statistics) to the statistics of all of them.
///
/// ```
/// # let folder = tempfile::tempdir()?;
/// # let campaign = folder.path().join("campaign");
/// # let mut camera = radcam::camera::open("sim:cmos12")?;
/// # let mut plan = radcam::plan::Plan::quick();
/// # plan.camera.region = Some([0, 0, 64, 64]);
/// # let mut bench = radcam::bench::of(&mut *camera, &plan);
/// # radcam::capture::Capture::new(&mut *camera, &mut *bench).run(&plan, &campaign)?;
/// use radcam::{dataset::Dataset, reduction, source::Source};
/// let file = folder.path().join("campaign.stats");
/// let stop = std::sync::atomic::AtomicBool::new(false);
/// let reduced = reduction::reduce(vec![Dataset::open(&campaign)?], &Default::default(), &stop, &mut |_, _| {})?;
/// reduction::write(&reduced, &file)?;
/// let (whole, kept) = (Source::open(&campaign)?, Source::open(&file)?);
/// assert_eq!(whole.noise()?.gain_dn_per_e, kept.noise()?.gain_dn_per_e);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// The parts do not belong to one campaign, a frame cannot be read, or the call was stopped.
pub fn reduce(
    parts: Vec<Dataset>,
    options: &Options,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Dataset, ObserveError> {
    let part = gather(parts)?;
    part.must_be_monochrome()?;
    if options.look_only {
        let facts = kept_facts(&part, &|_| true, stop)?;
        let mut looks = record_looks(&examined(&with_facts(&part, &facts), stop)?, stop)?;
        looks.extend(&facts);
        return Ok(part.with_reduced(looks));
    }
    let Some(plan) = &options.plan else {
        let reduced = of_sets(&part, &|_| true, stop, progress).map_err(|e| read_again(&part, e))?;
        return Ok(part.with_reduced(reduced));
    };
    let (whole, own) = planned(plan, &part)?;
    let reduced = of_sets(&whole, &|s| own.contains(&s.number), stop, progress)?;
    Ok(part.with_reduced(reduced))
}

/// Explains a missing frame of a part that was already reduced. Such frames are read again only if the parts
/// were reduced without knowing each other.
fn read_again(part: &Dataset, error: ObserveError) -> ObserveError {
    match error {
        ObserveError::Dataset(DatasetError::Frame { file, set, index, message })
            if part.reduced().is_some_and(Reduced::has::<Piece>) =>
        {
            let message = format!(
                "{message}; merge reads frames again of parts that were reduced without a plan: bring them back, or reduce the parts with the plan \
                 of all (reduce --look, merge --look, reduce --plan)"
            );
            DatasetError::Frame { file, set, index, message }.into()
        }
        e => e,
    }
}

/// Computes the statistics for the data checks, for the wanted sets.
fn kept_facts(
    dataset: &Dataset,
    wanted: &(dyn Fn(&Set) -> bool + Sync),
    stop: &AtomicBool,
) -> Result<Reduced, ObserveError> {
    let all = facts_of(dataset, stop)?;
    // Parts of a campaign need not show it alike: statistics are of whole frames.
    if let Some(part) = part_that_jumps(dataset, &all) {
        let message = format!(
            "{}, and statistics are of whole frames; noise and diagnose leave these rows of the frames out",
            part.in_words()
        );
        return Err(DatasetError::Manifest { path: dataset.root().into(), message }.into());
    }
    let sets = dataset.sets().iter().zip(all).filter(|(set, _)| wanted(set));
    Ok(sets.map(|(set, facts)| (Key::first(dataset, set, usize::MAX), facts)).collect())
}

/// Adds the facts to the dataset, so that no frame is read again.
fn with_facts(dataset: &Dataset, facts: &Reduced) -> Dataset {
    let mut reduced = dataset.reduced().cloned().unwrap_or_default();
    reduced.extend(facts);
    dataset.clone().with_reduced(reduced)
}

fn of_sets(
    dataset: &Dataset,
    wanted: &(dyn Fn(&Set) -> bool + Sync),
    stop: &AtomicBool,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Reduced, ObserveError> {
    let facts = kept_facts(dataset, wanted, stop)?;
    let dataset = &examined(&with_facts(dataset, &facts), stop)?;
    let mut out = record(dataset, wanted, stop, progress)?;
    out.extend(&facts);
    // Reuse the first looks; do not read these frames again.
    let mut known = dataset.reduced().cloned().unwrap_or_default();
    known.extend(&out.all::<Look>().into_iter().collect());
    let dataset = &dataset.clone().with_reduced(known);
    let mask = Mask::of(&Seen::new(dataset, stop, &mut |_| {})?, dataset);
    let mut memory = None;
    for set in dataset.sets().iter().filter(|s| wanted(s)) {
        let level = level_of(dataset, set, &mask, &mut memory, stop).map_err(|e| match e {
            NoiseError::Dataset(e) => ObserveError::Dataset(e),
            NoiseError::Interrupted => ObserveError::Interrupted,
            e => ObserveError::Nothing(e.to_string()),
        })?;
        out.add(mask.key(dataset, set), level);
    }
    Ok(out)
}

/// Combines the whole campaign of a plan with the files of a part. Also returns the sets of which the part
/// has every frame.
fn planned(plan: &Dataset, part: &Dataset) -> Result<(Dataset, BTreeSet<u32>), ObserveError> {
    let differs = plan.manifest().differences(part.manifest());
    if !differs.is_empty() {
        let message = format!("the part is not of the plan's campaign: {}", differs.join("; "));
        return Err(DatasetError::Manifest { path: part.root().into(), message }.into());
    }
    let own: HashMap<(u32, u32), &str> =
        part.rows().iter().map(|r| ((r.set, r.index), r.file.as_str())).collect();
    let mut rows = plan.rows().to_vec();
    let mut sets: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for row in &mut rows {
        let of_set = sets.entry(row.set).or_default();
        of_set.1 += 1;
        if let Some(file) = own.get(&(row.set, row.index)) {
            row.file = (*file).into();
            of_set.0 += 1;
        }
    }
    let found: usize = sets.values().map(|s| s.0).sum();
    if found < part.rows().len() {
        let missing =
            part.rows().iter().find(|r| plan.rows().iter().all(|p| (p.set, p.index) != (r.set, r.index)));
        let (set, index) = missing.map_or((0, 0), |r| (r.set, r.index));
        let message = format!(
            "set {set} index {index} is not in the plan: look at all parts, and merge what that gives"
        );
        return Err(DatasetError::Manifest { path: part.root().into(), message }.into());
    }
    let folders = plan.folders().iter().chain(part.folders()).cloned().collect();
    let reduced = plan.reduced().cloned().unwrap_or_default();
    let whole = Dataset::of_parts(plan.root(), plan.manifest().clone(), rows, folders)?.with_reduced(reduced);
    let complete = sets.into_iter().filter(|(_, (own, all))| own == all).map(|(set, _)| set);
    Ok((whole, complete.collect()))
}

/// Joins parts of one campaign into one dataset, ordered by time if every frame has a timestamp, otherwise by
/// set.
fn gather(parts: Vec<Dataset>) -> Result<Dataset, DatasetError> {
    let Some(first) = parts.first() else {
        return Err(DatasetError::Manifest { path: "parts".into(), message: "none is given".into() });
    };
    let (root, manifest) = (first.root().to_path_buf(), first.manifest().clone());
    let several = parts.len() > 1;
    let (mut rows, mut folders, mut reduced) = (Vec::new(), Vec::new(), Reduced::default());
    let mut from: HashMap<(u32, u32), PathBuf> = HashMap::new();
    for part in parts {
        let fault = |message| DatasetError::Manifest { path: part.root().into(), message };
        let differs = manifest.differences(part.manifest());
        if !differs.is_empty() {
            let message = format!(
                "{} in {}: parts of one campaign have one camera and settings",
                differs.join("; "),
                root.display()
            );
            return Err(fault(message));
        }
        let part = part.absolute()?;
        for row in part.rows() {
            if let Some(other) = from.insert((row.set, row.index), part.root().into()) {
                let message = format!(
                    "set {} index {} stands in {} too: parts of one campaign share no frame",
                    row.set,
                    row.index,
                    other.display()
                );
                return Err(DatasetError::Manifest { path: part.root().into(), message });
            }
        }
        rows.extend_from_slice(part.rows());
        folders.extend_from_slice(part.folders());
        part.reduced().into_iter().for_each(|own| reduced.extend(own));
    }
    folders.sort();
    folders.dedup();
    if several {
        let time = |r: &FrameRow| r.timestamp_s.unwrap_or(0.0);
        if rows.iter().all(|r| r.timestamp_s.is_some()) {
            rows.sort_by(|a, b| time(a).total_cmp(&time(b)));
        } else {
            rows.sort_by_key(|r| (r.set, r.index));
        }
    }
    Ok(Dataset::of_parts(&root, manifest, rows, folders)?.with_reduced(reduced))
}

/// File contents.
#[derive(Serialize, Deserialize)]
struct Stored {
    manifest: String,
    folders: Vec<PathBuf>,
    rows: Vec<FrameRow>,
    looks: Vec<(Key, Look)>,
    pieces: Vec<(Key, Piece)>,
    levels: Vec<(Key, Option<Level>)>,
    facts: Vec<(Key, SetFacts)>,
}

/// Writes the result of [`reduce`].
///
/// # Errors
///
/// The file cannot be written.
pub fn write(reduced: &Dataset, path: &Path) -> Result<(), DatasetError> {
    let fault = |message: String| DatasetError::Manifest { path: path.into(), message };
    let nothing = Reduced::default();
    let kept = reduced.reduced().unwrap_or(&nothing);
    let stored = Stored {
        manifest: toml::to_string(reduced.manifest()).map_err(|e| fault(e.to_string()))?,
        folders: reduced.folders().to_vec(),
        rows: reduced.rows().to_vec(),
        looks: kept.all::<Look>(),
        pieces: kept.all::<Piece>(),
        levels: kept.all::<Option<Level>>(),
        facts: kept.all::<SetFacts>(),
    };
    let mut bytes = HEAD.to_vec();
    ciborium::into_writer(&stored, &mut bytes).map_err(|e| fault(e.to_string()))?;
    let digest = Sha256::digest(&bytes);
    bytes.extend_from_slice(&digest);
    write_whole(path, &bytes)
}

/// Opens a dataset, or a file of statistics as the dataset it was made from.
///
/// # Errors
///
/// The file cannot be read, is damaged, or has invalid contents.
pub fn open(path: &Path) -> Result<Dataset, DatasetError> {
    if !path.is_file() || !is_statistics(path) {
        return Dataset::open(path);
    }
    let bytes = crate::input::bytes(path).map_err(DatasetError::io(path))?;
    from_bytes(&bytes, path)
}

/// Opens a file of statistics from bytes. `path` is used in error messages.
///
/// # Errors
///
/// As [`open`].
pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Dataset, DatasetError> {
    let fault = |message: String| DatasetError::Manifest { path: path.into(), message };
    let Some((inside, digest)) =
        bytes.split_at_checked(bytes.len().saturating_sub(DIGEST)).filter(|(i, _)| i.starts_with(HEAD))
    else {
        return Err(fault("is not a file of statistics of this version".into()));
    };
    if Sha256::digest(inside)[..] != *digest {
        return Err(fault("is damaged or not whole: its checksum is another; reduce again".into()));
    }
    from_cbor(&inside[HEAD.len()..], path)
}

/// Opens the CBOR item of a file of statistics. `path` is used in error messages.
///
/// # Errors
///
/// As [`open`].
pub fn from_cbor(bytes: &[u8], path: &Path) -> Result<Dataset, DatasetError> {
    let fault = |message: String| DatasetError::Manifest { path: path.into(), message };
    let stored: Stored =
        ciborium::from_reader(bytes).map_err(|e| fault(format!("cannot be understood: {e}")))?;
    let manifest = Manifest::from_toml(&stored.manifest).map_err(&fault)?;
    let camera = &manifest.camera;
    let (shape, full) = ((camera.height, camera.width), camera.full_scale_dn());
    let claimed = shape.0.saturating_mul(shape.1);
    let fits = claimed <= (1 << 20).max(bytes.len().saturating_mul(PIXELS_PER_BYTE))
        && stored.looks.iter().all(|(_, l)| l.fits(shape))
        && stored.facts.iter().all(|(key, f)| f.fits(key.indices.len(), shape))
        && stored.pieces.iter().all(|(_, (w, l))| w.fits(shape, full) && l.fits(claimed));
    if !fits {
        let message = format!("its statistics are not of frames of {} x {} px", shape.1, shape.0);
        return Err(fault(message));
    }
    let mut reduced: Reduced = stored.looks.into_iter().collect();
    reduced.extend(&stored.pieces.into_iter().collect());
    reduced.extend(&stored.levels.into_iter().collect());
    reduced.extend(&stored.facts.into_iter().collect());
    Ok(Dataset::of_parts(path, manifest, stored.rows, stored.folders)?.with_reduced(reduced))
}
