//! Joined datasets and row subsets.

use super::{Dataset, DatasetError, FrameRow, Manifest, Set, split_page};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

impl Dataset {
    /// Joins several datasets of one camera under the same settings: sets and times of each follow those
    /// of the previous one.
    ///
    /// Their light levels are treated as different, because equal light in two campaigns is not known.
    /// The pause between them is not known.
    ///
    /// # Errors
    ///
    /// Datasets of different cameras, settings or units of light, or one dataset given twice.
    pub fn join(datasets: Vec<Self>) -> Result<Self, DatasetError> {
        let mut datasets = datasets.into_iter();
        let Some(mut all) = datasets.next() else {
            return Err(DatasetError::Manifest { path: "datasets".into(), message: "none is given".into() });
        };
        let Some(second) = datasets.next() else { return Ok(all) };
        all.parts.push((all.root.clone(), 0));
        all.rows_of_files = Arc::default();
        all.rows.iter_mut().for_each(|r| r.file = all.root.join(&r.file).to_string_lossy().into_owned());
        for next in std::iter::once(second).chain(datasets) {
            let files: HashSet<PathBuf> = all
                .rows
                .iter()
                .take(1)
                .chain(all.parts.iter().skip(1).map(|(_, at)| &all.rows[*at]))
                .filter_map(|r| Path::new(split_page(&r.file).ok()?.0).canonicalize().ok())
                .collect();
            let first_file = next
                .rows
                .first()
                .and_then(|r| next.root.join(split_page(&r.file).ok()?.0).canonicalize().ok());
            if first_file.is_some_and(|file| files.contains(&file)) {
                return Err(DatasetError::Manifest { path: next.root, message: "is given twice".into() });
            }
            let differs = all.manifest.differences(&next.manifest);
            if !differs.is_empty() {
                return Err(DatasetError::Manifest {
                    path: next.root,
                    message: format!(
                        "{} in {}: only datasets of one camera under one set of settings go together",
                        differs.join("; "),
                        all.root.display()
                    ),
                });
            }
            let first = all.rows.len();
            let number = all.sets.iter().map(|s| s.number.saturating_add(1)).max().unwrap_or(0);
            let least = next.sets.iter().map(|s| s.number).min().unwrap_or(0);
            let ends = all.rows.iter().filter_map(|r| Some(r.timestamp_s? + r.exposure_s));
            let end_s = ends.fold(0.0, f64::max);
            let renumbered = |k: u32| number.saturating_add(k - least);
            all.rows.extend(next.rows.into_iter().map(|r| FrameRow {
                file: next.root.join(&r.file).to_string_lossy().into_owned(),
                set: renumbered(r.set),
                timestamp_s: r.timestamp_s.map(|t| t + end_s),
                ..r
            }));
            all.sets.extend(next.sets.into_iter().map(|s| Set {
                number: renumbered(s.number),
                rows: s.rows.into_iter().map(|i| first + i).collect(),
            }));
            all.folders.extend(next.folders);
            all.parts.push((next.root, first));
        }
        Ok(all)
    }

    /// Builds a campaign from rows with absolute paths in given folders.
    pub(crate) fn of_parts(
        root: &Path,
        manifest: Manifest,
        rows: Vec<FrameRow>,
        folders: Vec<PathBuf>,
    ) -> Result<Self, DatasetError> {
        let rows = rows.into_iter().enumerate().map(|(i, row)| (i as u64 + 1, row)).collect();
        Self::within(folders, root.into(), manifest, rows, root)
    }

    /// Returns the dataset with absolute paths, so that its rows can be combined with others.
    pub(crate) fn absolute(mut self) -> Result<Self, DatasetError> {
        if self.folders.is_empty() {
            let root = self.root.canonicalize().map_err(DatasetError::io(&self.root))?;
            for row in &mut self.rows {
                let file = root.join(&row.file);
                let Some(file) = file.to_str() else {
                    let message = format!("{} is not UTF-8: rename it", file.display());
                    return Err(DatasetError::Manifest { path: root, message });
                };
                row.file = file.into();
            }
            self.folders.push(root);
            self.rows_of_files = Arc::default();
        }
        Ok(self)
    }

    /// Returns a dataset with only the selected rows.
    pub(super) fn only(&self, keeps: impl Fn(usize) -> bool) -> Self {
        let out: Vec<bool> = (0..self.rows.len()).map(|row| !keeps(row)).collect();
        let mut place = Vec::with_capacity(out.len());
        let mut kept = 0;
        for out in &out {
            place.push(kept);
            kept += usize::from(!out);
        }
        let of_set = |set: &Set| {
            let rows: Vec<usize> = set.rows.iter().filter(|r| !out[**r]).map(|r| place[*r]).collect();
            (!rows.is_empty()).then_some(Set { number: set.number, rows })
        };
        let rows = self.rows.iter().zip(&out).filter(|(_, out)| !**out).map(|(r, _)| r.clone()).collect();
        let parts =
            self.parts.iter().map(|(root, first)| (root.clone(), place.get(*first).copied().unwrap_or(kept)));
        Self {
            rows,
            sets: self.sets.iter().filter_map(of_set).collect(),
            parts: parts.collect(),
            ..self.clone()
        }
    }

    /// Returns the folders that rows with absolute paths may point into; empty for a dataset folder.
    pub fn folders(&self) -> &[PathBuf] {
        &self.folders
    }

    /// Returns the number of the joined dataset that a row belongs to, and true for its first row.
    pub fn part_of(&self, row: usize) -> (usize, bool) {
        let part = self.parts.iter().rposition(|(_, first)| *first <= row).unwrap_or(0);
        (part, self.parts.get(part).is_some_and(|(_, first)| *first == row))
    }

    /// Returns the folders of the joined datasets; empty if none were joined.
    pub fn parts(&self) -> Vec<&Path> {
        self.parts.iter().map(|(root, _)| root.as_path()).collect()
    }
}
