//! Campaigns of simulated cameras on disk whose labels and files are rewritten, and which the program reads.

use crate::support::{expect, radcam};
use radcam::dataset::image::{read_single, tiff_bytes};
use radcam::ndarray::Array2;
use std::path::Path;

/// Set of a plan: exposure and light relative to the model's.
pub fn set_of_plan(kind: &str, frames: u32, exposure: f64, illumination: f64) -> String {
    format!(
        "[[set]]\nkind = \"{kind}\"\nframes = {frames}\nexposure = {exposure}\nillumination = {illumination}\nconfiguration = 0\n"
    )
}

/// A small campaign on disk with its rows as text fields.
pub struct Campaign {
    /// Folder in which the campaign is `c`.
    pub dir: tempfile::TempDir,
    /// Rows of the list of frames.
    pub rows: Vec<Vec<String>>,
}

impl Campaign {
    pub fn new(sensor: &str, plan: &str, seed: u32) -> Self {
        Self::of_region(sensor, plan, [160, 128], seed)
    }

    /// Campaign of a catalogue sensor or a model file, with so many columns and rows.
    pub fn of_region(sensor: &str, plan: &str, [columns, rows]: [u32; 2], seed: u32) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let at = dir.path().join("c");
        let (at, seed, region) = (at.to_str().unwrap(), seed.to_string(), format!("0,0,{columns},{rows}"));
        expect(0, &["simulate", sensor, "--plan", plan, "--region", &region, "--seed", &seed, "-o", at]);
        let text = std::fs::read_to_string(dir.path().join("c/frames.csv")).unwrap();
        let rows = text.lines().skip(1).map(|l| l.split(',').map(String::from).collect()).collect();
        Self { dir, rows }
    }

    pub fn path(&self) -> String {
        self.dir.path().join("c").to_str().unwrap().into()
    }

    /// Writes the rows back.
    pub fn save(&self) {
        let path = Path::new(&self.path()).join("frames.csv");
        let text = std::fs::read_to_string(&path).unwrap();
        let header = text.lines().next().unwrap().to_string();
        let rows: Vec<String> =
            std::iter::once(header).chain(self.rows.iter().map(|r| r.join(","))).collect();
        std::fs::write(path, rows.join("\n") + "\n").unwrap();
    }

    /// Leaves the rows that are wanted, by kind and exposure in seconds.
    pub fn keep(&mut self, wanted: impl Fn(&str, f64) -> bool) {
        self.rows.retain(|r| wanted(&r[1], r[4].parse().unwrap()));
        self.save();
    }

    /// Leaves out the rows at these places.
    pub fn leave_out(&mut self, places: &[usize]) {
        let mut place = 0..;
        self.rows.retain(|_| !places.contains(&place.next().unwrap()));
        self.save();
    }

    /// Takes the black level out of the manifest: that of imported files does not know it.
    pub fn forget_black_level(&self) {
        self.forget("black_level_dn");
    }

    /// Takes a value out of the manifest.
    pub fn forget(&self, name: &str) {
        let manifest = Path::new(&self.path()).join("dataset.toml");
        let text = std::fs::read_to_string(&manifest).unwrap();
        let without: Vec<&str> = text.lines().filter(|l| !l.starts_with(name)).collect();
        std::fs::write(&manifest, without.join("\n") + "\n").unwrap();
    }

    /// Places of the rows of a set.
    pub fn of(&self, set: u32) -> Vec<usize> {
        (0..self.rows.len()).filter(|r| self.rows[*r][2] == set.to_string()).collect()
    }

    /// Numbers of the sets of a kind with this many frames at least, in the order of time.
    pub fn sets(&self, kind: &str, frames: usize) -> Vec<u32> {
        let mut out: Vec<u32> = Vec::new();
        for row in self.rows.iter().filter(|r| r[1] == kind) {
            let set = row[2].parse().unwrap();
            if !out.contains(&set) && self.of(set).len() >= frames {
                out.push(set);
            }
        }
        out
    }

    pub fn frame(&self, row: usize) -> Array2<u16> {
        read_single(&Path::new(&self.path()).join(&self.rows[row][0])).unwrap()
    }

    pub fn put(&self, row: usize, codes: &Array2<u16>) {
        let path = Path::new(&self.path()).join(&self.rows[row][0]);
        std::fs::write(path, tiff_bytes(codes, 16).unwrap()).unwrap();
    }

    /// A flat in the middle of the range, with so many frames at least, that follows another level if one
    /// does.
    pub fn flat(&self, frames: usize) -> u32 {
        self.flat_of(self.sets("flat", frames))
    }

    pub fn flat_of(&self, flats: Vec<u32>) -> u32 {
        let level = |set: u32| self.frame(self.of(set)[0]).mapv(f64::from).mean().unwrap();
        let mut inside: Vec<u32> =
            flats.into_iter().filter(|f| (600.0..2200.0).contains(&level(*f))).collect();
        let steps = |f: &u32| self.before(*f).is_some_and(|b| (level(*f) / level(b) - 1.0).abs() > 0.2);
        if inside.iter().any(steps) {
            inside.retain(steps);
        }
        inside[inside.len() / 2]
    }

    /// The set before, in the order of time.
    pub fn before(&self, set: u32) -> Option<u32> {
        let row = self.of(set)[0].checked_sub(1)?;
        self.rows[row][2].parse().ok()
    }

    /// Scales the signal of a frame above a level.
    pub fn scale(&self, row: usize, by: f64, above: f64) {
        let codes = self.frame(row).mapv(|v| (above + by * (f64::from(v) - above)).round().max(0.0) as u16);
        self.put(row, &codes);
    }

    pub fn change_darks(&self, to: impl Fn(usize) -> Array2<u16>) {
        (0..self.rows.len())
            .filter(|row| self.rows[*row][1] == "dark")
            .for_each(|row| self.put(row, &to(row)));
    }

    /// JSON output of a verb, whatever its exit code.
    pub fn said(&self, verb: &str) -> serde_json::Value {
        let output = radcam(&[verb, &self.path(), "--json"]);
        assert!(output.status.code() != Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}
