//! The effective limits of a joint, and their origins.

use std::fmt;

/// One effective limit of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Its key in the configuration.
    pub key: &'static str,
    /// The unit of its values.
    pub unit: &'static str,
    /// The lowest value, of a limit that has two ends.
    pub min: Option<f32>,
    /// The highest value. `None`: there is no limit.
    pub max: Option<f32>,
    /// Its origin.
    pub origin: Origin,
}

/// The origin of a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Its key, in this line of the file, counted from 1.
    File {
        /// The line.
        line: usize,
    },
    /// Another key, which is in this line of the file.
    Key {
        /// The other key.
        key: &'static str,
        /// Its line, counted from 1.
        line: usize,
    },
    /// This fact of the motor's model.
    Model(&'static str),
    /// The largest value that the motor's protocol can encode, with a margin.
    Protocol,
    /// Another limit of the joint, by this rule.
    Rule(&'static str),
    /// The cautious value of motord.
    Default,
}

impl Origin {
    /// One word: `file`, `model`, `protocol`, `rule` or `default`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::File { .. } | Self::Key { .. } => "file",
            Self::Model(_) => "model",
            Self::Protocol => "protocol",
            Self::Rule(_) => "rule",
            Self::Default => "default",
        }
    }

    /// Returns the line of the file, counted from 1.
    #[must_use]
    pub const fn line(self) -> Option<usize> {
        match self {
            Self::File { line } | Self::Key { line, .. } => Some(line),
            _ => None,
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { line } => write!(f, "line {line}"),
            Self::Key { key, line } => write!(f, "{key} in line {line}"),
            Self::Model(fact) => write!(f, "{fact} of the model"),
            Self::Protocol => write!(f, "end of the protocol's scale"),
            Self::Rule(rule) => write!(f, "{rule}"),
            Self::Default => write!(f, "default"),
        }
    }
}
