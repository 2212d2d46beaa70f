//! Known facts of a frame, and their sources.

use crate::dataset::{CameraInfo, Kind};
use std::collections::BTreeMap;

/// Maximum relative difference of two exposures that are equal but for rounding.
const SAME_EXPOSURE: f64 = 0.01;

/// Returns true if two exposures are equal but for rounding.
pub(super) fn same_exposure(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME_EXPOSURE * a.abs().max(b.abs())
}

/// Facts of a frame stated in names and headers.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// Kind of the frame.
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
    /// Set point of the cooler, degrees Celsius.
    pub set_temperature_c: Option<f64>,
    /// Manufacturer.
    pub vendor: Option<String>,
    /// Model.
    pub model: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// Capture time, s since an arbitrary common epoch.
    pub time_s: Option<f64>,
    /// Set number, if stated.
    pub set: Option<u32>,
    /// Filter in front of the sensor.
    pub filter: Option<String>,
    /// Further settings by GenICam name (`GainRaw`, `BlackLevelRaw`, `BinningHorizontal`, ...), or
    /// by FITS name if GenICam has none. All frames of a dataset share them.
    pub differs: Vec<(String, String)>,
    /// Camera with its settings, if all of it is stated.
    pub camera: Option<CameraInfo>,
    /// True for a frame of the sky or another object, by its name: neither dark nor flat.
    pub object: bool,
    /// True for a bias frame, which has no exposure of its own.
    pub bias: bool,
    /// True if the exposure is stated as 0: correct for a bias frame, unknown for others.
    pub zero_exposure: bool,
    /// True if rows run from bottom to top.
    pub bottom_up: Option<bool>,
    /// Colour pattern of 2 x 2 pixels, row by row, such as RGGB; none for monochrome sensors.
    pub mosaic: Option<String>,
    /// Keyword and section of the illuminated area (TRIMSEC or DATASEC of FITS).
    pub trim_section: Option<(String, String)>,
    /// Section of the overscan (BIASSEC of FITS).
    pub bias_section: Option<String>,
    /// Reason that it is not a raw frame.
    pub processed: Option<String>,
    /// True if the exposure is stated with its unit.
    pub unit_stated: bool,
    /// Ambiguous values, `key: why`, which a person must settle.
    pub doubts: Vec<String>,
    /// Contradictions of header and names: the header takes precedence.
    pub overruled: Vec<String>,
    /// Source of each value.
    pub from: BTreeMap<String, String>,
}

impl Facts {
    pub(super) fn set_kind(&mut self, kind: Kind, from: &str) {
        self.kind = Some(kind);
        self.from.insert("kind".into(), from.into());
    }

    /// Sets a setting if it is not known yet.
    pub(super) fn set_feature(&mut self, name: &str, value: &str, from: &str) {
        if self.feature(name).is_none() {
            self.differs.push((name.into(), value.into()));
            self.from.insert(name.into(), from.into());
        }
    }

    /// Returns the value of a setting.
    pub fn feature(&self, name: &str) -> Option<&str> {
        self.differs.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str())
    }

    fn doubts(&self, key: &str) -> bool {
        self.doubts.iter().any(|d| d.starts_with(&format!("{key}:")))
    }

    /// Merges header facts (`self`) with those of names, which fill gaps. On a contradiction the header
    /// takes precedence and a note is kept; if the unit decides it, the user is asked.
    pub(super) fn or(mut self, names: Self) -> Self {
        // Frames written by radcam: names cannot contradict them.
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
        // A header settles a doubt about names.
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

    /// Returns the facts of a whole file for a page that states some itself: differing values of the
    /// page are not contradictions.
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

    /// Copies a value that is unknown here.
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

/// Converts a setting to a manifest value: an integer, a float or a text.
pub(super) fn feature_value(text: &str) -> toml::Value {
    match (text.parse::<i64>(), text.parse::<f64>()) {
        (Ok(whole), _) => whole.into(),
        (_, Ok(number)) if number.is_finite() => number.into(),
        _ => text.into(),
    }
}
