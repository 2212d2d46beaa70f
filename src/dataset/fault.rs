//! What is wrong with the data of a campaign, in words and as the JSON has it.

use serde::{Deserialize, Serialize};

/// What was wrong, in the words of the contract.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum FaultKind {
    /// Stated exposure or light disagrees with the level.
    SettingLabel,
    /// Dark and flat exchanged.
    KindLabel,
    /// One frame several times.
    CopiedFrames,
    /// Averaged or filtered over time before they were saved, in these sets only.
    DependentFrames,
    /// The first frame was exposed under the settings of the set before.
    StaleFrame,
    /// One frame of another level.
    OddFrame,
    /// Another gain, black level or orientation.
    OtherSettings,
    /// Frames or sets of equal settings under unequal light.
    UnequalLight,
}

/// A slip of the hand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataFault {
    /// Which kind.
    pub kind: FaultKind,
    /// Numbers of its sets.
    pub sets: Vec<u32>,
    /// Files of its frames, where they are single ones of a set.
    pub frames: Vec<String>,
    /// One sentence: what, where, and the value that would fit.
    pub text: String,
    /// Whether its sets, or its frames where it has some, are left out.
    pub left_out: bool,
}

impl std::fmt::Display for DataFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "slip in the data: {}", self.text)
    }
}
