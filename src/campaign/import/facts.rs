//! What is known of a frame, and where it comes from.

use crate::dataset::{CameraInfo, Kind};
use std::collections::BTreeMap;

/// Exposures that differ by less are one exposure, rounded in different ways.
const SAME_EXPOSURE: f64 = 0.01;

/// Whether two exposures are the same but for rounding.
pub(super) fn same_exposure(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME_EXPOSURE * a.abs().max(b.abs())
}

/// What names and headers say of a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// What it shows.
    pub kind: Option<Kind>,
    /// Exposure, s.
    pub exposure_s: Option<f64>,
    /// Light, relative.
    pub illumination: Option<f64>,
    /// Position of card and light.
    pub configuration: Option<u32>,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Sensor temperature, degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Temperature that the cooler is set to, degrees Celsius.
    pub set_temperature_c: Option<f64>,
    /// Maker.
    pub vendor: Option<String>,
    /// Model.
    pub model: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// When it was taken, s from any moment that is the same for all.
    pub time_s: Option<f64>,
    /// Number of its set, where it says so.
    pub set: Option<u32>,
    /// Filter in front of the sensor.
    pub filter: Option<String>,
    /// Further settings by their GenICam names (`GainRaw`, `BlackLevelRaw`, `BinningHorizontal`, ...) or,
    /// where GenICam has none, by those of FITS. All frames of a dataset share them.
    pub differs: Vec<(String, String)>,
    /// The camera with its settings, where it says all of it.
    pub camera: Option<CameraInfo>,
    /// True for a frame of the sky or another object, by its name: neither dark nor flat.
    pub object: bool,
    /// A bias frame: it has no exposure of its own.
    pub bias: bool,
    /// The exposure is stated as 0: that of a bias frame; of others it is not known.
    pub zero_exposure: bool,
    /// Rows run from the bottom to the top.
    pub bottom_up: Option<bool>,
    /// Colour pattern of two by two pixels, row by row, such as RGGB; none of monochrome sensors.
    pub mosaic: Option<String>,
    /// Keyword and section of the part that light reaches (TRIMSEC or DATASEC of FITS).
    pub trim_section: Option<(String, String)>,
    /// Section of the overscan (BIASSEC of FITS).
    pub bias_section: Option<String>,
    /// Why it is no raw frame.
    pub processed: Option<String>,
    /// True if the unit of the exposure stands with it.
    pub unit_stated: bool,
    /// Values with more than one reading, `key: why`. A person must settle it.
    pub doubts: Vec<String>,
    /// Where the header and the names disagree: the header counts.
    pub overruled: Vec<String>,
    /// Where each value comes from.
    pub from: BTreeMap<String, String>,
}

impl Facts {
    pub(super) fn set_kind(&mut self, kind: Kind, from: &str) {
        self.kind = Some(kind);
        self.from.insert("kind".into(), from.into());
    }

    /// A setting, where it is not known yet.
    pub(super) fn set_feature(&mut self, name: &str, value: &str, from: &str) {
        if self.feature(name).is_none() {
            self.differs.push((name.into(), value.into()));
            self.from.insert(name.into(), from.into());
        }
    }

    /// Value of a setting.
    pub fn feature(&self, name: &str) -> Option<&str> {
        self.differs.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    fn doubts(&self, key: &str) -> bool {
        self.doubts.iter().any(|d| d.starts_with(&format!("{key}:")))
    }

    /// These, of the header, and where they say nothing those of names. Where they contradict each other the
    /// header counts and it is said; where the unit decides it is asked.
    pub(super) fn or(mut self, names: Self) -> Self {
        // What radcam wrote, names do not doubt.
        let names = if self.camera.is_some() { Self::default() } else { names };
        if let (Some(a), Some(b)) = (self.exposure_s, names.exposure_s)
            && !same_exposure(a, b)
        {
            let of = |f: &Self| f.from.get("exposure_s").cloned().unwrap_or_default();
            let text = format!("exposure_s: {} says {a} s, and {} says {b} s", of(&self), of(&names));
            let factor = (a / b).max(b / a);
            if !self.unit_stated && [1e3, 1e6].iter().any(|f| same_exposure(factor, *f)) {
                self.doubts.push(text + ": the header states no unit");
                self.exposure_s = None;
            } else {
                self.overruled.push(text);
            }
        }
        if let (Some(a), Some(b)) = (self.kind, names.kind)
            && a != b
        {
            let of = |f: &Self| f.from.get("kind").cloned().unwrap_or_default();
            self.overruled.push(format!("kind: {} says {a}, and {} says {b}", of(&self), of(&names)));
        }
        // A doubt about names is settled by a header.
        for doubt in &names.doubts {
            let settled = (doubt.starts_with("kind:") && self.kind.is_some())
                || (doubt.starts_with("exposure_s:")
                    && (self.exposure_s.is_some() || self.doubts("exposure_s")));
            if !settled {
                self.doubts.push(doubt.clone());
            }
        }
        if !self.doubts("exposure_s") {
            if self.exposure_s.is_none() {
                self.unit_stated = names.unit_stated;
            }
            self.take(&names, "exposure_s", |f| &mut f.exposure_s);
        }
        if !self.doubts("kind") || names.doubts("kind") {
            self.take(&names, "kind", |f| &mut f.kind);
        }
        self.bias |= names.bias;
        self.object |= names.object;
        if self.zero_exposure && self.bias && self.exposure_s.is_none() && !self.doubts("exposure_s") {
            self.exposure_s = Some(0.0);
        }
        self.take(&names, "illumination", |f| &mut f.illumination);
        self.take(&names, "configuration", |f| &mut f.configuration);
        self.take(&names, "gain_db", |f| &mut f.gain_db);
        self.take(&names, "temperature_c", |f| &mut f.temperature_c);
        self.take(&names, "set_temperature_c", |f| &mut f.set_temperature_c);
        self.take(&names, "vendor", |f| &mut f.vendor);
        self.take(&names, "model", |f| &mut f.model);
        self.take(&names, "serial", |f| &mut f.serial);
        self.take(&names, "time_s", |f| &mut f.time_s);
        self.take(&names, "set", |f| &mut f.set);
        self.take(&names, "filter", |f| &mut f.filter);
        self.take(&names, "camera", |f| &mut f.camera);
        self.take(&names, "rows", |f| &mut f.bottom_up);
        self.take(&names, "mosaic", |f| &mut f.mosaic);
        self.take(&names, "processed", |f| &mut f.processed);
        self.take(&names, "trim_section", |f| &mut f.trim_section);
        self.take(&names, "bias_section", |f| &mut f.bias_section);
        for (name, value) in &names.differs {
            match self.feature(name) {
                Some(said) if !crate::features::same_value(said, value) => {
                    let of = |f: &Self| f.from.get(name).cloned().unwrap_or_default();
                    let text = format!("{name}: {} says {said}, and {} says {value}", of(&self), of(&names));
                    self.overruled.push(text);
                }
                Some(_) => {}
                None => {
                    let from = names.from.get(name).cloned().unwrap_or_default();
                    self.set_feature(name, value, &from);
                }
            }
        }
        self.overruled.extend(names.overruled);
        self
    }

    /// These of a whole file, for a page that says some of them itself: what it says is no contradiction.
    pub(super) fn beside(mut self, page: &Self) -> Self {
        if page.exposure_s.is_some() || page.doubts("exposure_s") {
            self.exposure_s = None;
            self.doubts.retain(|d| !d.starts_with("exposure_s:"));
        }
        if page.kind.is_some() || page.doubts("kind") {
            self.kind = None;
            self.doubts.retain(|d| !d.starts_with("kind:"));
        }
        self.differs.retain(|(name, _)| page.feature(name).is_none());
        self.overruled.clear();
        self
    }

    /// Takes a value that is not known here.
    fn take<T: Clone>(&mut self, other: &Self, key: &str, of: impl Fn(&mut Self) -> &mut Option<T>) {
        if of(self).is_some() {
            return;
        }
        let mut other = other.clone();
        if let Some(value) = of(&mut other).take() {
            *of(self) = Some(value);
            if let Some(from) = other.from.get(key) {
                self.from.insert(key.into(), from.clone());
            }
        }
    }
}

/// A value of a setting as a manifest has it: a whole number, a number or a text.
pub(super) fn feature_value(text: &str) -> toml::Value {
    match (text.parse::<i64>(), text.parse::<f64>()) {
        (Ok(whole), _) => whole.into(),
        (_, Ok(number)) if number.is_finite() => number.into(),
        _ => text.into(),
    }
}
