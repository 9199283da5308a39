//! The protocols that motors speak: a row in [`Protocol`] and in its two matches, and a file beside
//! this one.

pub mod cansimple;
pub(crate) mod codec;
pub mod gim;
pub mod mit;
pub mod myactuator;
pub mod odrive;
pub mod ranges;
pub mod robstride;

use cansimple::Axis;
use codec::Codec;
use mit::{Mit, ReplyFormat};
use myactuator::Rmd;
use odrive::RotorAxis;
use ranges::Ranges;
use robstride::Private;

/// The protocol that a motor speaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Protocol {
    /// MIT, as one vendor implements it.
    Mit(Mit),
    /// SteadyWin's own, over CAN or on a serial line.
    Native,
    /// RobStride's private one.
    RobStride(Private),
    /// The CANSimple dialect of other SteadyWin drivers.
    CanSimple(Axis),
    /// MyActuator's own.
    MyActuator(Rmd),
    /// That of ODrive's drivers with firmware 0.6.
    Odrive(RotorAxis),
}

impl Protocol {
    /// Returns the protocol with this name in configurations, of a motor with these ranges and this
    /// form of MIT replies.
    ///
    /// # Panics
    ///
    /// When the checker has no codec for the protocol: the frames of its motors could not be
    /// checked.
    #[must_use]
    pub fn named(name: &str, ranges: Ranges, reply: ReplyFormat) -> Self {
        match name {
            "mit" => Self::Mit(Mit { ranges, reply }),
            "gim" => Self::Native,
            "robstride" => Self::RobStride(Private { ranges }),
            "cansimple" => Self::CanSimple(Axis { ranges, gear_ratio: cansimple::GEAR_RATIO }),
            "myactuator" => Self::MyActuator(Rmd { ranges }),
            "odrive" => Self::Odrive(RotorAxis { gear_ratio: odrive::GEAR_RATIO }),
            other => panic!("the checker does not know the protocol {other}"),
        }
    }

    /// Returns the protocol of a motor with this gear ratio: rotor turns per turn of the output shaft.
    /// It has an effect where frames contain values of the rotor.
    #[must_use]
    pub const fn with_gear_ratio(self, gear_ratio: f64) -> Self {
        match self {
            Self::CanSimple(axis) => Self::CanSimple(Axis { gear_ratio, ..axis }),
            Self::Odrive(_) => Self::Odrive(RotorAxis { gear_ratio }),
            other => other,
        }
    }

    /// Returns the meaning of its frames.
    pub(crate) const fn codec(&self) -> &dyn Codec {
        match self {
            Self::Mit(mit) => mit,
            Self::Native => &gim::Native,
            Self::RobStride(private) => private,
            Self::CanSimple(axis) => axis,
            Self::MyActuator(rmd) => rmd,
            Self::Odrive(axis) => axis,
        }
    }

    /// Returns the meaning of a command to motor of this protocol.
    ///
    /// # Panics
    ///
    /// When its form is not that of a command.
    #[must_use]
    pub fn order(&self, frame: &motord_bus::Frame) -> codec::Meaning {
        self.codec().order(frame)
    }

    /// Returns the meaning of a command in a log; `None` when it does not have eight bytes.
    pub(crate) fn meaning(&self, frame: &motord_bus::Frame) -> Option<codec::Meaning> {
        let bytes: [u8; 8] = frame.payload().try_into().ok()?;
        Some(match self {
            Self::Mit(mit) => codec::Meaning::of(bytes, &mit.ranges),
            Self::Native => gim::decode(bytes),
            other => other.order(frame),
        })
    }

    /// Returns the step of the positions in its commands, rad; 0 where they have none.
    pub(crate) fn position_code(&self) -> f64 {
        self.codec().codes().map_or(0.0, |codes| codes.position)
    }
}
