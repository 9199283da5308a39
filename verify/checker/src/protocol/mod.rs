//! The protocols that motors speak: a row in [`Protocol`] and in its match, and a file beside this one.

pub(crate) mod codec;
pub mod gim;
pub mod mit;
pub mod ranges;

use codec::Codec;
use mit::Mit;

/// The protocol that a motor speaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Protocol {
    /// MIT, as one vendor implements it.
    Mit(Mit),
    /// SteadyWin's own, over CAN or on a serial line.
    Native,
}

impl Protocol {
    /// Returns the meaning of its frames.
    pub(crate) const fn codec(&self) -> &dyn Codec {
        match self {
            Self::Mit(mit) => mit,
            Self::Native => &gim::Native,
        }
    }

    /// Returns the step of the positions in its commands, rad; 0 where they have none.
    pub(crate) fn position_code(&self) -> f64 {
        self.codec().ranges().map_or(0.0, |ranges| ranges.codes().position)
    }
}
