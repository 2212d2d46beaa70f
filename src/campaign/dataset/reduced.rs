//! Saved statistics of frames, so that the frames need not be read again.

use super::{Dataset, Set};
use serde::{Deserialize, Serialize};
use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// First line of a statistics file.
pub(crate) const HEAD: &[u8] = b"radcam statistics 1\n";
/// Start of the first line in every version.
pub(super) const ANY_HEAD: &[u8] = b"radcam statistics ";

/// Returns true for a file that begins as a statistics file.
pub(crate) fn is_statistics(path: &Path) -> bool {
    crate::input::start(path, HEAD.len() as u64).is_ok_and(|start| start == HEAD)
}

/// Frames of a set, and the settings under which they were read.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Key {
    pub(crate) set: u32,
    /// Frame indices within the set, as numbered in `frames.csv`.
    pub(crate) indices: Vec<u32>,
    /// Range of these in the piece.
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) before: bool,
    pub(crate) clean: bool,
    /// Digest of the first look for a piece, of its mask for a level; for looks the version, as nothing
    /// else affects them.
    pub(crate) under: String,
}

impl Key {
    /// Key of the first frames of a set, independent of read settings.
    pub(crate) fn first(dataset: &Dataset, set: &Set, frames: usize) -> Self {
        let indices: Vec<u32> = set.rows.iter().take(frames).map(|&r| dataset.rows()[r].index).collect();
        Self {
            set: set.number,
            from: 0,
            to: indices.len(),
            indices,
            before: false,
            clean: true,
            under: env!("CARGO_PKG_VERSION").into(),
        }
    }
}

type Table = HashMap<Key, Arc<dyn Any + Send + Sync>>;

/// Saved statistics: for each type one value per key. The computing modules define the types.
#[derive(Clone, Default)]
pub struct Reduced(HashMap<TypeId, Table>);

impl Reduced {
    /// Returns the statistics of this type.
    pub(crate) fn get<T: Any>(&self, of: &Key) -> Option<&T> {
        self.0.get(&TypeId::of::<T>())?.get(of)?.downcast_ref()
    }

    /// Adds statistics.
    pub(crate) fn add<T: Any + Send + Sync>(&mut self, of: Key, value: T) {
        self.0.entry(TypeId::of::<T>()).or_default().insert(of, Arc::new(value));
    }

    /// Adds all statistics of another store.
    pub(crate) fn extend(&mut self, other: &Self) {
        for (of, table) in &other.0 {
            let own = self.0.entry(*of).or_default();
            own.extend(table.iter().map(|(key, value)| (key.clone(), Arc::clone(value))));
        }
    }

    /// Returns all statistics of this type with their keys.
    pub(crate) fn all<T: Any + Clone>(&self) -> Vec<(Key, T)> {
        let table = self.0.get(&TypeId::of::<T>()).into_iter().flatten();
        let mut all: Vec<(Key, T)> = table
            .filter_map(|(key, value)| Some((key.clone(), value.downcast_ref::<T>()?.clone())))
            .collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    }

    /// Returns true if there are statistics of this type.
    pub(crate) fn has<T: Any>(&self) -> bool {
        self.0.get(&TypeId::of::<T>()).is_some_and(|table| !table.is_empty())
    }
}

impl<T: Any + Send + Sync> FromIterator<(Key, T)> for Reduced {
    fn from_iter<I: IntoIterator<Item = (Key, T)>>(all: I) -> Self {
        let mut out = Self::default();
        all.into_iter().for_each(|(key, value)| out.add(key, value));
        out
    }
}

impl std::fmt::Debug for Reduced {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.0.values().flat_map(HashMap::keys)).finish()
    }
}
