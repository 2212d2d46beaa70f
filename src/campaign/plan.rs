//! Plans: what to capture, as TOML files.
//!
//! Exposures are given in seconds (`exposure_s`) or relative to the exposure that brings the card at
//! illumination 1 close to full scale (`exposure`); `capture` measures that exposure before it starts.

use crate::dataset::{CameraInfo, Kind};
use crate::frame::Region;
use crate::light::Light;
use crate::pixel_format::PixelFormat;
use radcam_sim::Scene;
use radcam_sim::effects::Take;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name and major version of the file format.
pub const FORMAT: &str = "radcam-plan/1";

/// Fraction of full scale reached by relative exposure 1 at illumination 1.
pub const FULL_EXPOSURE_LEVEL: f64 = 0.85;

/// State of the bench: light, configuration and scene.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BenchState {
    /// Light relative to the campaign's unit; 0: dark, the lens covered.
    pub illumination: f64,
    /// Position of card and light (Section V of the paper).
    pub configuration: u32,
    /// Scene in front of the camera.
    pub scene: Scene,
}

/// GenICam features that drive a bench, as named in a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GenicamBench {
    /// Float or integer feature of the light, multiplied by `illumination_scale`.
    pub illumination: String,
    /// Value of the feature at illumination 1.
    #[serde(default = "one")]
    pub illumination_scale: f64,
    /// Boolean feature that covers the lens; without it dark is illumination 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark: Option<String>,
    /// Integer feature of the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub configuration: Option<String>,
    /// Enumeration feature of the scene, with the entries `Card`, `Patch` and `Chart`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Settling time of the light after a change, s.
    #[serde(default)]
    pub settle_s: f64,
    /// Relative standard uncertainty of each light level.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub illumination_rel_std: Option<f64>,
}

fn one() -> f64 {
    1.0
}

impl GenicamBench {
    /// Returns the bench features of a camera served by `radcam serve`.
    pub fn served() -> Self {
        Self {
            illumination: "BenchIllumination".into(),
            illumination_scale: 1.0,
            dark: Some("BenchDark".into()),
            configuration: Some("BenchConfiguration".into()),
            scene: Some("BenchScene".into()),
            settle_s: 0.0,
            illumination_rel_std: Some(0.0),
        }
    }
}

/// A capture plan: settings and sets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// [`FORMAT`].
    pub format: String,
    /// Purpose of the plan.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Exposure that counts as 1, s; measured if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_exposure_s: Option<f64>,
    /// True if that exposure was searched for before the first frame. A simulated camera that resumes
    /// the campaign exposes those frames again.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub searched: bool,
    /// Settings of the camera for the whole campaign.
    #[serde(default, skip_serializing_if = "CameraPlan::is_default")]
    pub camera: CameraPlan,
    /// GenICam features that drive the bench; without them the operator is asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<GenicamBench>,
    /// Light at illumination 1 in photons, measured with a photodiode.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Light>,
    /// Sets in time order.
    #[serde(rename = "set")]
    pub sets: Vec<SetPlan>,
}

/// Settings of the camera; absent settings are left unchanged.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPlan {
    /// Gain, dB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain_db: Option<f64>,
    /// Black level, DN.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_level_dn: Option<f64>,
    /// PFNC name; if absent, the deepest format of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel_format: Option<PixelFormat>,
    /// First column, first row, width, height, pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<[u32; 4]>,
    /// Frames discarded at the start of each set, for a camera that applies new settings late. Discarded
    /// frames are not available to the search for lag.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub settle_frames: u32,
    /// Frames per second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// Other features, by GenICam name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<String, toml::Value>,
}

fn is_zero(n: &u32) -> bool {
    *n == 0
}

impl CameraPlan {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Refuses impossible numbers.
    fn check(&self) -> Result<(), String> {
        let info = CameraInfo {
            gain_db: self.gain_db,
            black_level_dn: self.black_level_dn,
            ..CameraInfo::default()
        };
        info.check()?;
        match self.frame_rate_hz {
            Some(rate) if !(rate.is_finite() && rate > 0.0) => {
                Err(format!("camera.frame_rate_hz is {rate} Hz, and must be above 0 Hz"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the region, if the plan names one.
    pub fn region(&self) -> Option<Region> {
        self.region.map(|[x, y, width, height]| Region { x, y, width, height })
    }
}

/// Frames with the same settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetPlan {
    /// Kind of the frames.
    pub kind: Kind,
    /// Number of frames.
    pub frames: u32,
    /// Exposure, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Exposure relative to the full exposure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f64>,
    /// Relative light; 0 for darks.
    #[serde(default)]
    pub illumination: f64,
    /// Position of card and light.
    #[serde(default)]
    pub configuration: u32,
}

impl SetPlan {
    fn new(kind: Kind, frames: u32, exposure: f64, illumination: f64) -> Self {
        Self { kind, frames, exposure_s: None, exposure: Some(exposure), illumination, configuration: 0 }
    }

    /// Returns the bench state that the set needs.
    pub fn bench(&self) -> BenchState {
        let scene = match self.kind {
            Kind::Scene => Scene::Patch,
            Kind::Target => Scene::Chart,
            Kind::Dark | Kind::Flat => Scene::Card,
        };
        BenchState { illumination: self.illumination, configuration: self.configuration, scene }
    }
}

/// Errors of a plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// Not TOML, or a key is missing, unknown or of the wrong type.
    #[error("not a plan: {0}")]
    Syntax(String),
    /// Set that cannot be captured.
    #[error("set {set}: {message}")]
    Set {
        /// Number of the set, from 0.
        set: usize,
        /// Description of the fault.
        message: String,
    },
    /// Fault of the plan as a whole.
    #[error("{0}")]
    Plan(String),
}

impl Plan {
    fn of(about: &str, sets: Vec<SetPlan>) -> Self {
        Self {
            format: FORMAT.into(),
            about: about.into(),
            full_exposure_s: None,
            searched: false,
            camera: CameraPlan::default(),
            bench: None,
            light: None,
            sets,
        }
    }

    /// Returns a one-minute plan: two dark exposures and eight exposures of the card, four frames each.
    pub fn quick() -> Self {
        let mut sets = vec![SetPlan::new(Kind::Dark, 4, 1.0, 0.0), SetPlan::new(Kind::Dark, 4, 6.0, 0.0)];
        sets.extend((1..=8).map(|i| SetPlan::new(Kind::Flat, 4, f64::from(i) / 8.0, 1.0)));
        Self::of("A quick look: gain and constant noise", sets)
    }

    /// Returns the plan of a full characterisation: darks at four exposures, an exposure sweep of 12
    /// levels, a light sweep of 7, a reference at start, middle and end, bright-to-dark transitions, and
    /// one still scene at two exposures.
    pub fn standard() -> Self {
        let n = 8;
        let dark = |exposure| SetPlan::new(Kind::Dark, n, exposure, 0.0);
        let flat = |exposure, light| SetPlan::new(Kind::Flat, n, exposure, light);
        let scene = |exposure| SetPlan::new(Kind::Scene, n, exposure, 1.0);
        let reference = flat(1.0, 0.5);
        let mut sets: Vec<_> = [0.02, 1.0, 4.0, 16.0].map(dark).into();
        sets.push(reference.clone());
        // Exposure sweep: five steps in equal ratios from 1/50, then seven in equal differences.
        sets.extend((0..5).map(|i| flat(50f64.powf(f64::from(i) / 4.0 - 1.0), 1.0)));
        sets.extend((2..=8).map(|i| flat(f64::from(i) / 8.0, 1.0)));
        sets.push(reference.clone());
        sets.extend([0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0].map(|light| flat(1.0, light)));
        // Bright-to-dark transitions, twice: after a flat and after the scene.
        sets.extend([dark(1.0), scene(1.0), dark(1.0), scene(0.25), reference]);
        Self::of("Full characterisation", sets)
    }

    /// Returns an EMVA 1288 measurement (release 4.0 Linear, sections 6.5, 7.1 and 8): pairs at 50
    /// equally spaced exposures up to saturation with their darks, pairs of darks at six long exposures,
    /// and 100 flats and 100 darks at half of saturation. Darks come first, so that the lens is covered
    /// only once.
    pub fn emva1288() -> Self {
        // Exposure 1 brings the mean to 85 % of full scale. The steps end at 1.25 times that: past
        // saturation at any black level.
        let step = |i: u32| 0.025 * f64::from(i);
        let half = step(24);
        let mut sets: Vec<_> = (1..=50).map(|i| SetPlan::new(Kind::Dark, 2, step(i), 0.0)).collect();
        sets.extend((1..=6).map(|i| SetPlan::new(Kind::Dark, 2, 10.0 * f64::from(i), 0.0)));
        sets.push(SetPlan::new(Kind::Dark, 100, half, 0.0));
        sets.extend((1..=50).map(|i| SetPlan::new(Kind::Flat, 2, step(i), 1.0)));
        sets.push(SetPlan::new(Kind::Flat, 100, half, 1.0));
        Self::of("EMVA 1288", sets)
    }

    /// Converts the frames requested on an effect's page (`radcam effects ID`) into a plan.
    pub fn of_takes(about: &str, takes: &[Take]) -> Self {
        let set = |t: &Take| {
            let kind = match t.scene {
                None => Kind::Dark,
                Some(Scene::Card) => Kind::Flat,
                Some(Scene::Patch) => Kind::Scene,
                Some(Scene::Chart) => Kind::Target,
            };
            SetPlan::new(kind, t.frames, t.exposure, t.light)
        };
        Self::of(about, takes.iter().map(set).collect())
    }

    /// Returns a built-in plan: `quick`, `standard` or `emva1288`.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "quick" => Some(Self::quick()),
            "standard" => Some(Self::standard()),
            "emva1288" => Some(Self::emva1288()),
            _ => None,
        }
    }

    /// Reads and checks a plan.
    ///
    /// ```
    /// use radcam::plan::Plan;
    /// let text = Plan::standard().to_toml()?;
    /// assert_eq!(Plan::from_toml(&text)?, Plan::standard());
    /// # Ok::<(), radcam::plan::PlanError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// The text is not a plan: line, key or set, and the fault.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        let table: toml::Table =
            toml::from_str(text).map_err(|e| PlanError::Syntax(crate::input::echo_lines(&e.to_string())))?;
        match table.get("format").and_then(|f| f.as_str()) {
            Some(FORMAT) => {}
            other => {
                let other = other.unwrap_or("missing");
                return Err(PlanError::Plan(format!(
                    "format is {}, and this program reads \"{FORMAT}\"",
                    crate::input::echo(other)
                )));
            }
        }
        let plan: Self =
            toml::from_str(text).map_err(|e| PlanError::Syntax(crate::input::echo_lines(&e.to_string())))?;
        plan.check()?;
        Ok(plan)
    }

    /// Writes the plan as TOML.
    ///
    /// # Errors
    ///
    /// A value cannot be written as TOML.
    pub fn to_toml(&self) -> Result<String, PlanError> {
        toml::to_string(self).map_err(|e| PlanError::Syntax(e.to_string()))
    }

    fn check(&self) -> Result<(), PlanError> {
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if self.sets.is_empty() {
            return Err(PlanError::Plan("the plan has no [[set]]".into()));
        }
        if self.full_exposure_s.is_some_and(|e| !positive(e)) {
            return Err(PlanError::Plan("full_exposure_s must be above 0 s".into()));
        }
        if let Some(light) = &self.light {
            light.check().map_err(|message| PlanError::Plan(format!("light.{message}")))?;
        }
        self.camera.check().map_err(PlanError::Plan)?;
        for (set, plan) in self.sets.iter().enumerate() {
            if plan.exposure_s.or(plan.exposure).is_some_and(|e| e > 1e6) {
                return Err(PlanError::Set { set, message: "the exposure must be at most 1e6".into() });
            }
            let fault = |message: &str| Err(PlanError::Set { set, message: message.into() });
            match (plan.exposure_s, plan.exposure) {
                (Some(e), None) | (None, Some(e)) if positive(e) => {}
                (Some(_), None) | (None, Some(_)) => return fault("the exposure must be above 0"),
                _ => return fault("give either exposure_s (seconds) or exposure (relative to the full one)"),
            }
            if plan.frames == 0 {
                return fault("frames must be 1 or more");
            }
            if !(0.0..=1e6).contains(&plan.illumination) {
                return fault("illumination must lie within 0 to 1e6");
            }
            if plan.kind == Kind::Dark && plan.illumination != 0.0 {
                return fault("a dark set has illumination 0");
            }
            if plan.kind != Kind::Dark && plan.illumination == 0.0 {
                return fault("only a dark set has illumination 0");
            }
        }
        Ok(())
    }

    /// Returns true if any exposure is relative, so that the full exposure must be known.
    pub fn needs_full_exposure(&self) -> bool {
        self.full_exposure_s.is_none() && self.sets.iter().any(|s| s.exposure_s.is_none())
    }

    /// Returns the plan with every exposure in seconds, each rounded by `nearest` to one that the camera
    /// allows.
    pub fn absolute(&self, full_exposure_s: f64, nearest: impl Fn(f64) -> f64) -> Self {
        let full = self.full_exposure_s.unwrap_or(full_exposure_s);
        let mut plan = self.clone();
        plan.full_exposure_s = Some(full);
        for set in &mut plan.sets {
            let wanted = set.exposure_s.unwrap_or(set.exposure.unwrap_or(1.0) * full);
            set.exposure_s = Some(nearest(wanted));
            set.exposure = None;
        }
        plan
    }

    /// Returns the duration of a plan whose exposures are in seconds, s, at the given maximum frame
    /// rate. Each set takes half a second to begin.
    pub fn seconds(&self, frame_rate_hz: Option<f64>) -> f64 {
        let period_s = frame_rate_hz.filter(|r| *r > 0.0).map_or(0.0, |r| 1.0 / r);
        let of = |s: &SetPlan| 0.5 + f64::from(s.frames) * s.exposure_s.unwrap_or(0.0).max(period_s);
        self.sets.iter().map(of).sum()
    }

    /// Returns the number of frames of the whole plan.
    pub fn frames(&self) -> u64 {
        self.sets.iter().map(|s| u64::from(s.frames)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_plan_has_what_the_readme_says() {
        let plan = Plan::standard();
        let count = |f: &dyn Fn(&&SetPlan) -> bool| plan.sets.iter().filter(f).count();
        assert_eq!(plan.frames() as usize, 8 * plan.sets.len());
        assert_eq!(count(&|s| s.kind == Kind::Dark), 4 + 2);
        assert_eq!(count(&|s| s.kind == Kind::Scene), 2);
        assert_eq!(count(&|s| s.illumination == 0.5), 3);
        assert_eq!(count(&|s| s.kind == Kind::Flat), 3 + 12 + 7);
    }

    #[test]
    fn faults_are_named() {
        let good = "format = \"radcam-plan/1\"\n[[set]]\nkind = \"flat\"\nframes = 2\nexposure_s = 0.1\nillumination = 1.0\n";
        Plan::from_toml(good).unwrap();
        for (from, to, part) in [
            ("plan/1", "plan/2", "radcam-plan/2"),
            ("exposure_s = 0.1", "", "either exposure_s"),
            ("exposure_s = 0.1", "exposure_s = 0.1\nexposure = 1.0", "either exposure_s"),
            ("0.1", "-0.1", "above 0"),
            ("frames = 2", "frames = 0", "1 or more"),
            ("= 1.0", "= 0.0", "only a dark set"),
            ("\"flat\"", "\"dark\"", "illumination 0"),
            ("\"flat\"", "\"flot\"", "flot"),
            ("frames", "farmes", "farmes"),
        ] {
            let message = Plan::from_toml(&good.replace(from, to)).expect_err(to).to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
