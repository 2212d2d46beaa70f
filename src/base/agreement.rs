//! Whether something agrees with measurements, as every verb and report says it.

use serde::{Deserialize, Serialize};

/// Below this chance a model does not describe the campaign.
pub const P_LIMIT: f64 = 1e-3;
/// Below this chance one looks again.
pub const DOUBT: f64 = 0.05;

/// Whether a model describes a campaign: the one word that every verb and report has for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Agreement {
    /// Within the noise.
    Holds,
    /// Chance would do so less than once in twenty campaigns.
    Doubtful,
    /// Chance would do so less than once in a thousand.
    Fails,
}

impl Agreement {
    /// From the chance of deviations as large as those seen.
    pub fn of(p_value: f64) -> Self {
        match p_value {
            p if p >= DOUBT => Self::Holds,
            p if p >= P_LIMIT => Self::Doubtful,
            _ => Self::Fails,
        }
    }

    /// In words, of a model.
    pub fn words(self) -> &'static str {
        match self {
            Self::Holds => "the model agrees with the measurements to within the noise",
            Self::Doubtful => {
                "the model may agree: deviations as large come by chance less than once in twenty campaigns"
            }
            Self::Fails => "THE MODEL DOES NOT AGREE WITH THE MEASUREMENTS",
        }
    }

    /// In words, of levels and the line through them.
    pub fn of_a_line(self) -> &'static str {
        match self {
            Self::Holds => "the levels lie on the line",
            Self::Doubtful => {
                "the levels may lie on the line: chance scatters them as far less than once in twenty campaigns"
            }
            Self::Fails => "THE LEVELS DO NOT LIE ON A LINE",
        }
    }
}
