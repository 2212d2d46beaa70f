//! Campaign writer: a crash loses at most the frame in flight.
//!
//! A frame is written to a temporary file, synced and renamed; then its row is appended and synced. The
//! folder is locked during writing.

use super::tag::FrameTag;
use super::{COLUMNS, CameraInfo, Dataset, DatasetError, FrameRow, Manifest, image};
use crate::input;
use crate::output::{self, Held, HoldError, folder_of};
use ndarray::Array2;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use tiff::encoder::colortype::{Gray8, Gray16};

/// Open campaign.
#[derive(Debug)]
pub struct Writer {
    root: PathBuf,
    rows: File,
    camera: CameraInfo,
    written: Vec<FrameRow>,
    /// Last field, so that it is dropped last.
    _held: Folder,
}

/// Prefix of temporary files.
const ASIDE: &str = ".radcam-";

/// Folder of a campaign, locked for one writer until dropped. A newly created folder that stayed empty
/// is removed.
#[derive(Debug)]
pub struct Folder(#[allow(dead_code)] Held); // held, not read

impl Folder {
    /// Creates the folder if it does not exist, and locks it.
    ///
    /// # Errors
    ///
    /// Another program writes there, or the path is a link or cannot be created.
    pub fn hold(root: &Path) -> Result<Self, DatasetError> {
        Held::take(root).map(Self).map_err(|e| match e {
            HoldError::Busy => busy(root),
            HoldError::Io(e) => DatasetError::io(root)(e),
        })
    }

    /// Locks an existing folder.
    ///
    /// # Errors
    ///
    /// As [`hold`](Self::hold), and if the folder does not exist.
    pub fn existing(root: &Path) -> Result<Self, DatasetError> {
        fs::metadata(root).map_err(DatasetError::io(root))?;
        Self::hold(root)
    }

    /// Refuses a folder that holds more than an unfinished start (a campaign that never got its
    /// manifest); `beside` are names of further allowed files.
    pub(crate) fn must_be_free(&self, root: &Path, beside: &[&str]) -> Result<(), DatasetError> {
        if unfinished_start(root, beside).map_err(DatasetError::io(root))? {
            return Ok(());
        }
        let message = "is not empty; choose a new folder, or continue it with --resume".into();
        Err(DatasetError::Manifest { path: root.into(), message })
    }
}

fn busy(root: &Path) -> DatasetError {
    let message = "another program is writing to this dataset".into();
    DatasetError::Manifest { path: root.into(), message }
}

/// Writes a whole file by atomic rename: temporary file, sync, rename.
///
/// # Errors
///
/// The path is a link, device, FIFO, socket or folder, or the file cannot be written; nothing of it is
/// left then.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    Aside::write(path, bytes)?.put_in_place()?;
    synchronise(folder_of(path))
}

/// Temporary file, possibly not yet synced. Deleted on drop unless persisted.
#[derive(Debug)]
pub(crate) struct Aside {
    file: tempfile::NamedTempFile,
    path: PathBuf,
}

impl Aside {
    /// Writes the temporary file for `path`.
    pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<Self, DatasetError> {
        let write = || {
            output::must_be_file_or_new(path)?;
            // Default permissions of a new file, instead of owner-only.
            let mut aside = tempfile::Builder::new();
            aside.prefix(ASIDE);
            #[cfg(unix)]
            aside.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
            let mut file = aside.tempfile_in(folder_of(path))?;
            file.write_all(bytes)?;
            Ok(Self { file, path: path.into() })
        };
        write().map_err(DatasetError::io(path))
    }

    /// Syncs and renames the file; the directory entry is durable only after [`synchronise`].
    pub(crate) fn put_in_place(self) -> Result<(), DatasetError> {
        let Self { file, path } = self;
        let place = || {
            file.as_file().sync_all()?;
            output::must_be_file_or_new(&path)?;
            file.persist(&path)?;
            Ok(())
        };
        place().map_err(DatasetError::io(&path))
    }
}

/// Syncs the directory entries of a folder.
pub(crate) fn synchronise(folder: &Path) -> Result<(), DatasetError> {
    output::synchronise(folder).map_err(DatasetError::io(folder))
}

fn name(number: usize) -> String {
    format!("frames/{number:05}.tiff")
}

/// Creates the folder of the frames if it does not exist.
fn frames_folder(root: &Path) -> Result<(), DatasetError> {
    let path = root.join("frames");
    output::folder(&path).map_err(DatasetError::io(&path))
}

/// Opens `frames.csv` for appending, and locks it while it is open.
fn lock(root: &Path) -> Result<File, DatasetError> {
    let path = root.join("frames.csv");
    let rows = output::append(&path, false).map_err(DatasetError::io(&path))?;
    rows.try_lock().map_err(|_| busy(root))?;
    Ok(rows)
}

/// Removes leftovers of an interrupted run. Safe because the folder lock is held.
fn remove_leftovers(root: &Path) -> Result<(), DatasetError> {
    for folder in [root, &root.join("frames")] {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        for left in entries.filter(|e| e.file_name().to_string_lossy().starts_with(ASIDE)) {
            fs::remove_file(left.path()).map_err(DatasetError::io(&left.path()))?;
        }
    }
    Ok(())
}

/// Returns true if a folder holds only an unfinished start: a campaign that never got its manifest.
fn unfinished_start(root: &Path, beside: &[&str]) -> std::io::Result<bool> {
    for entry in fs::read_dir(root)? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let ours = match &*name {
            "frames" => fs::read_dir(entry.path())?.next().is_none(),
            "frames.csv" => input::table(&entry.path())?.lines().count() <= 1,
            name => name.starts_with(ASIDE) || beside.contains(&name),
        };
        if !ours {
            return Ok(false);
        }
    }
    Ok(true)
}

impl Writer {
    /// Starts a campaign in a new or empty folder.
    ///
    /// `beside` are further files, by name. The manifest is written last: a folder without one is not
    /// yet a campaign and can be started again.
    ///
    /// # Errors
    ///
    /// The folder is not empty or cannot be written.
    pub fn create(root: &Path, manifest: &Manifest, beside: &[(&str, &str)]) -> Result<Self, DatasetError> {
        Self::create_in(Folder::hold(root)?, root, manifest, beside)
    }

    /// As [`Self::create`], in a folder that is already locked.
    pub(crate) fn create_in(
        held: Folder,
        root: &Path,
        manifest: &Manifest,
        beside: &[(&str, &str)],
    ) -> Result<Self, DatasetError> {
        held.must_be_free(root, &beside.iter().map(|(name, _)| *name).collect::<Vec<_>>())?;
        frames_folder(root)?;
        for (name, text) in beside {
            write_whole(&root.join(name), text.as_bytes())?;
        }
        let text = toml::to_string(manifest).map_err(|e| DatasetError::Manifest {
            path: root.join("dataset.toml"),
            message: e.to_string(),
        })?;
        write_whole(&root.join("frames.csv"), format!("{}\n", COLUMNS.join(",")).as_bytes())?;
        write_whole(&root.join("dataset.toml"), text.as_bytes())?;
        let rows = lock(root)?;
        remove_leftovers(root)?;
        let camera = manifest.camera.clone();
        Ok(Self { root: root.into(), rows, camera, written: Vec::new(), _held: held })
    }

    /// Continues a campaign. A last row truncated by a crash is removed; every complete row is kept.
    ///
    /// # Errors
    ///
    /// The folder is not a dataset, a frame cannot be read, or another program writes to it.
    pub fn resume(root: &Path) -> Result<(Self, Manifest), DatasetError> {
        Self::resume_in(Folder::existing(root)?, root)
    }

    /// As [`Self::resume`], in a folder that is already locked.
    pub(crate) fn resume_in(held: Folder, root: &Path) -> Result<(Self, Manifest), DatasetError> {
        let path = root.join("frames.csv");
        // Lock first: another program may be in the middle of a row.
        let rows = lock(root)?;
        frames_folder(root)?;
        let text = input::bytes(&path).map_err(DatasetError::io(&path))?;
        let whole = text.iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1);
        if (1..text.len()).contains(&whole) {
            tracing::warn!(file = %path.display(), bytes = text.len() - whole, "cut off an unfinished row");
            rows.set_len(whole as u64).and_then(|()| rows.sync_all()).map_err(DatasetError::io(&path))?;
        }
        remove_leftovers(root)?;
        let dataset = Dataset::open(root)?;
        for row in dataset.rows() {
            dataset.read(row)?;
        }
        let manifest = dataset.manifest().clone();
        let camera = manifest.camera.clone();
        let written = dataset.rows().to_vec();
        let writer = Self { root: root.into(), rows, camera, written, _held: held };
        Ok((writer, manifest))
    }

    /// Returns the rows that are safely on disk.
    pub fn written(&self) -> &[FrameRow] {
        &self.written
    }

    /// Appends a frame. The writer chooses the name in `row.file`.
    ///
    /// # Errors
    ///
    /// The frame cannot be written; the campaign is unchanged.
    pub fn append(&mut self, mut row: FrameRow, pixels: &Array2<u16>) -> Result<(), DatasetError> {
        row.file = name(self.written.len());
        let fault = |message: String| DatasetError::Frame {
            file: row.file.clone(),
            set: row.set,
            index: row.index,
            message,
        };
        let tag = FrameTag::of(&row, &self.camera);
        let text = serde_json::to_string(&tag).map_err(|e| fault(e.to_string()))?;
        let bytes = if self.camera.bit_depth <= 8 {
            image::described_bytes::<Gray8>(pixels.mapv(|dn| dn as u8).view(), &text)
        } else {
            image::described_bytes::<Gray16>(pixels.view(), &text)
        }
        .map_err(|e| fault(e.to_string()))?;
        // A frame whose row was lost in a crash keeps its file; if the new frame is identical (simulated
        // again), that file is reused.
        let mut number = self.written.len();
        let there = loop {
            match input::bytes(&self.root.join(name(number))) {
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => break false,
                Err(e) => return Err(fault(e.to_string())),
                Ok(found) if found == bytes => break true,
                Ok(_) => number += 1,
            }
        };
        row.file = name(number);
        if !there {
            write_whole(&self.root.join(&row.file), &bytes)?;
        }
        let fault = |message: String| DatasetError::Frame {
            file: row.file.clone(),
            set: row.set,
            index: row.index,
            message,
        };
        let mut line = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        line.serialize(&row).map_err(|e| fault(e.to_string()))?;
        let line = line.into_inner().map_err(|e| fault(e.to_string()))?;
        let path = self.root.join("frames.csv");
        self.rows.write_all(&line).map_err(DatasetError::io(&path))?;
        self.rows.sync_data().map_err(DatasetError::io(&path))?;
        self.written.push(row);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Kind;
    use std::fs::OpenOptions;

    fn row(set: u32, index: u32) -> FrameRow {
        FrameRow {
            file: String::new(),
            kind: Kind::Flat,
            set,
            index,
            exposure_s: 0.01,
            illumination: 1.0,
            configuration: 0,
            temperature_c: None,
            timestamp_s: Some(0.5),
        }
    }

    #[test]
    fn a_name_beyond_ascii_survives_in_the_frames() {
        let dir = tempfile::tempdir().unwrap();
        let camera = CameraInfo {
            vendor: "Müller & 山田 😀".into(),
            width: 3,
            height: 1,
            bit_depth: 12,
            ..Default::default()
        };
        let mut writer = Writer::create(&dir.path().join("c"), &Manifest::new(camera.clone()), &[]).unwrap();
        writer.append(row(0, 0), &ndarray::array![[1, 2, 3]]).unwrap();
        let tag = FrameTag::read(&dir.path().join("c/frames/00000.tiff")).unwrap();
        assert_eq!((tag.camera, tag.exposure_s, tag.set), (camera, 0.01, 0));
    }

    #[test]
    fn what_cannot_be_put_in_place_leaves_nothing_aside() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.toml");
        fs::create_dir_all(path.join("inside")).unwrap();
        let said = write_whole(&path, b"text").unwrap_err().to_string();
        assert!(said.contains("x.toml"), "{said}");
        let left: Vec<_> = fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["x.toml"]);
    }

    #[test]
    fn a_campaign_survives_a_crash_in_mid_row() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        let camera = CameraInfo { width: 3, height: 2, bit_depth: 12, ..Default::default() };
        let manifest = Manifest::new(camera);
        let image = ndarray::array![[1u16, 2, 3], [4, 5, 4095]];
        let mut writer = Writer::create(&root, &manifest, &[]).unwrap();
        for i in 0..3 {
            writer.append(row(0, i), &image).unwrap();
        }
        let second = Writer::resume(&root).unwrap_err().to_string();
        assert!(second.contains("another program"), "{second}");
        drop(writer);

        // Simulated crash: a frame without a row, and half a row.
        fs::write(root.join("frames/00003.tiff"), b"II*").unwrap();
        let mut csv = OpenOptions::new().append(true).open(root.join("frames.csv")).unwrap();
        csv.write_all(b"frames/00003.ti").unwrap();

        let (mut writer, manifest) = Writer::resume(&root).unwrap();
        assert_eq!((writer.written().len(), manifest.camera.bit_depth), (3, 12));
        writer.append(row(0, 3), &image).unwrap();
        drop(writer);
        let dataset = Dataset::open(&root).unwrap();
        assert_eq!(dataset.sets()[0].rows.len(), 4);
        assert_eq!(dataset.read_set(&dataset.sets()[0]).unwrap()[3], image);
        let rubbish = fs::read(root.join("frames/00003.tiff")).unwrap();
        assert_eq!(rubbish, b"II*", "a frame without a row is left as it is");
        // An unfinished start may be restarted; any other contents may not.
        let early = dir.path().join("early");
        fs::create_dir_all(early.join("frames")).unwrap();
        fs::write(early.join("plan.toml"), "x").unwrap();
        drop(Writer::create(&early, &manifest, &[("plan.toml", "y")]).unwrap());
        let other = dir.path().join("other");
        fs::create_dir_all(&other).unwrap();
        fs::write(other.join("thesis.txt"), "x").unwrap();
        assert!(Writer::create(&other, &manifest, &[]).is_err());
        assert!(Writer::create(&root, &manifest, &[]).unwrap_err().to_string().contains("--resume"));
    }
}
