//! Faults of the data of a campaign, as the JSON has them.

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
    /// Copies of a frame.
    CopiedFrames,
    /// Averaged or filtered over time before they were saved, in these sets only.
    DependentFrames,
    /// The first frame was exposed under the settings of the set before.
    StaleFrame,
    /// Single frame of another level.
    OddFrame,
    /// Another gain, black level or orientation.
    OtherSettings,
    /// Frames or sets of equal settings under unequal light.
    UnequalLight,
}

/// A slip of the hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataFault {
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Numbers of its sets.
    pub sets: Vec<u32>,
    /// Files of its frames, where they are single ones of a set.
    pub frames: Vec<String>,
    /// Sentence with the fault, its place and the value that would fit.
    pub text: String,
    /// True if the frames listed, or else the sets, are left out.
    pub left_out: bool,
}

impl DataFault {
    /// Returns true if it is light that leaks into darks: these stay, and their growth with the exposure is no
    /// dark current.
    pub fn is_leak(&self) -> bool {
        self.kind == FaultKind::KindLabel && !self.left_out
    }

    /// Returns true if all frames are means of several: no set is left that has the gain of the camera.
    pub fn is_of_means(&self) -> bool {
        self.kind == FaultKind::DependentFrames && !self.left_out
    }
}

impl std::fmt::Display for DataFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "slip in the data: {}", self.text)
    }
}
