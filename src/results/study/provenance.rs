//! Provenance of a report's numbers: files and their hash, version, command, date.

use crate::dataset::{Dataset, DatasetError};
use crate::source::Source;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Provenance of a report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Dataset folders, descriptors or tables.
    pub datasets: Vec<String>,
    /// SHA-256 of the lines that `sha256sum` prints for all files, names in byte order.
    pub sha256: String,
    /// Number of files.
    pub files: usize,
    /// Number of frames.
    pub frames: usize,
    /// Version of radcam.
    pub version: String,
    /// Command that made the report.
    pub command: String,
    /// Date and time, UTC.
    pub made: String,
}

impl Provenance {
    /// Records the provenance of some paths.
    ///
    /// # Errors
    ///
    /// A file cannot be read.
    pub fn of(paths: &[PathBuf], source: &Source, command: &str) -> Result<Self, DatasetError> {
        let (files, frames) = match source {
            Source::Table(_) => (paths.to_vec(), 0),
            Source::Frames(dataset) => (files_of(dataset, paths), dataset.rows().len()),
        };
        let lines: Vec<String> = files
            .par_iter()
            .map(|path| Ok(format!("{}  {}\n", hash(path)?, path.display())))
            .collect::<Result<_, DatasetError>>()?;
        Ok(Self {
            datasets: paths.iter().map(|p| p.display().to_string()).collect(),
            sha256: hex(&Sha256::digest(lines.concat())),
            files: files.len(),
            frames,
            version: env!("CARGO_PKG_VERSION").into(),
            command: command.into(),
            made: jiff::Timestamp::now().strftime("%Y-%m-%d %H:%M UTC").to_string(),
        })
    }
}

/// Lists the files of a dataset: frames and the files that list them.
fn files_of(dataset: &Dataset, paths: &[PathBuf]) -> Vec<PathBuf> {
    let mut files: BTreeSet<PathBuf> = BTreeSet::new();
    for path in paths {
        if path.is_file() {
            files.insert(path.clone());
        } else {
            files.extend(["dataset.toml", "frames.csv"].map(|name| path.join(name)));
        }
    }
    files.extend(dataset.rows().iter().enumerate().map(|(place, row)| {
        let file = row.file.split_once('#').map_or(&*row.file, |(file, _)| file);
        let part = dataset.parts().get(dataset.part_of(place).0).copied();
        part.unwrap_or(dataset.root()).join(file)
    }));
    let mut files: Vec<PathBuf> = files.into_iter().collect();
    files.sort_by(|a, b| a.as_os_str().as_encoded_bytes().cmp(b.as_os_str().as_encoded_bytes()));
    files
}

fn hash(path: &Path) -> Result<String, DatasetError> {
    let fault = |e| DatasetError::io(path)(e);
    let mut file = crate::input::open(path).map_err(fault)?;
    let (mut state, mut buffer) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer).map_err(fault)? {
            0 => return Ok(hex(&state.finalize())),
            n => state.update(&buffer[..n]),
        }
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected value: `printf abc | sha256sum` (FIPS 180-4, example B.1).
    #[test]
    fn hashes_are_those_of_sha256sum() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        assert_eq!(hash(&path).unwrap(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert!(hash(&folder.path().join("none")).unwrap_err().to_string().contains("none"));
    }
}
