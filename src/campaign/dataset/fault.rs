//! Data faults of a campaign, as in the JSON.

use serde::{Deserialize, Serialize};

/// Kinds of faults, named as in the JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FaultKind {
    /// Stated exposure or light disagrees with the level.
    SettingLabel,
    /// Dark and flat exchanged.
    KindLabel,
    /// Duplicate frames.
    CopiedFrames,
    /// Averaged or filtered over time before they were saved, in these sets only.
    DependentFrames,
    /// The first frame was exposed under the settings of the set before.
    StaleFrame,
    /// Single frame with another level.
    OddFrame,
    /// Another gain, black level or orientation.
    OtherSettings,
    /// Frames or sets with equal settings but different light.
    UnequalLight,
}

/// Fault in the recorded data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataFault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Numbers of the affected sets.
    pub sets: Vec<u32>,
    /// Files of the affected frames, if only single frames of a set are affected.
    pub frames: Vec<String>,
    /// Sentence with the fault, its place and the value that would fit.
    pub text: String,
    /// True if the listed frames, or else the sets, are excluded.
    pub left_out: bool,
}

impl DataFault {
    /// Returns true for a light leak into darks: these darks stay, but their growth with exposure is not
    /// dark current.
    pub fn is_leak(&self) -> bool {
        self.kind == FaultKind::KindLabel && !self.left_out
    }

    /// Returns true if all frames are averages of several: no remaining set has the camera's gain.
    pub fn is_of_means(&self) -> bool {
        self.kind == FaultKind::DependentFrames && !self.left_out
    }
}

impl std::fmt::Display for DataFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "slip in the data: {}", self.text)
    }
}
