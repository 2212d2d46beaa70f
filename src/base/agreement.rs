//! Agreement grades shared by all commands and reports.

use serde::{Deserialize, Serialize};

/// p-value below which a model does not describe the campaign.
pub const P_LIMIT: f64 = 1e-3;
/// p-value below which the agreement is doubtful.
pub const DOUBT: f64 = 0.05;

/// Agreement of a model with a campaign: the grade used by all commands and reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Agreement {
    /// Deviations within the noise.
    Holds,
    /// Deviations that occur by chance less than once in twenty campaigns.
    Doubtful,
    /// Deviations that occur by chance less than once in a thousand campaigns.
    Fails,
}

impl Agreement {
    /// Returns the grade for a p-value.
    pub fn of(p_value: f64) -> Self {
        match p_value {
            p if p >= DOUBT => Self::Holds,
            p if p >= P_LIMIT => Self::Doubtful,
            _ => Self::Fails,
        }
    }

    /// Describes the agreement of a model.
    pub fn words(self) -> &'static str {
        match self {
            Self::Holds => "the model agrees with the measurements to within the noise",
            Self::Doubtful => {
                "the model may agree: deviations as large come by chance less than once in twenty campaigns"
            }
            Self::Fails => "THE MODEL DOES NOT AGREE WITH THE MEASUREMENTS",
        }
    }

    /// Describes the agreement of levels with the line through them.
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
