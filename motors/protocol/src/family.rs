//! The facts of a family of motors.

use crate::model::Model;
use crate::profile::{Capabilities, Profile};
use crate::scale::{Ends, Scales};

/// Returns whether the payload of a reply can answer that of a request.
pub type AnswersOnLine = fn(request: &[u8], reply: &[u8]) -> bool;

/// The facts of a family that the rest of motord asks for.
#[derive(Debug)]
pub struct Family {
    /// Its name in configurations and on command lines.
    pub name: &'static str,
    /// Returns whether a reply can answer a request on a serial line, by their payloads alone.
    /// `None`: its motors are on CAN only.
    pub answers_on_line: Option<AnswersOnLine>,
    /// Positions and velocities are codes with ends, which the configuration must know. Otherwise
    /// they are floats.
    pub has_codes: bool,
    /// Each control command ends by itself after a duration.
    pub has_durations: bool,
    /// Its motors report configuration items, and a request for one is harmless to them.
    pub has_items: bool,
    /// The values of the largest codes, where they are the same for every model. `None`: a model has
    /// its own.
    pub ends: Option<Ends>,
    /// The sources differ on the end of the torque codes, so the configuration must have it.
    pub needs_torque_end: bool,
    /// A stopped motor reports the position of its rotor.
    pub reports_rotor: bool,
    /// Returns the smallest and the largest id of a vendor's motor.
    pub ids: fn(&Profile) -> [u8; 2],
    /// The bit rate of a motor from the factory, bit/s, where it is not that of most motors, 1 Mbit/s.
    pub factory_bitrate: Option<u32>,
    /// Returns the abilities of a vendor's motor with these codes.
    pub capabilities: fn(&Profile, &Scales) -> Capabilities,
    /// Returns the id of a vendor's motor's replies, or the part of it that names the host, where the
    /// configuration has none.
    pub default_host_id: fn(&Profile, u8) -> u16,
    /// Returns how the lock file names the answer of a vendor's motor.
    #[cfg(feature = "commissioning")]
    pub reported: fn(&Profile) -> crate::reported::ReportedProtocol,
    /// The requests by which a program without a cycle finds such a motor.
    #[cfg(feature = "commissioning")]
    pub question: crate::reported::Question,
    /// Returns the lengths of a command and of the shortest reply with a state, for the plan of a
    /// bus.
    #[cfg(feature = "drive")]
    pub frame_lengths: fn(&Profile) -> [motord_bus::arithmetic::FrameLength; 2],
    /// Returns the ids on the bus of a motor with this id and host id.
    #[cfg(feature = "drive")]
    pub addresses: fn(u8, motord_bus::FrameId) -> crate::drive::Addresses,
    /// Returns whether a frame of a motor confirms its stop. `None`: every frame does, because the motor
    /// only answers.
    #[cfg(feature = "drive")]
    pub confirms_stop: Option<fn(&motord_bus::Frame) -> bool>,
    /// The frames that a motor sends by itself, for the plan of a bus.
    #[cfg(feature = "drive")]
    pub reports: &'static [crate::drive::UnpromptedFrame],
}

impl Family {
    /// The facts that most families share: motors on CAN, with codes, which only answer. A family states
    /// its name, its abilities, how it is found, and each fact that differs.
    pub(crate) const COMMON: Self = Self {
        name: "",
        answers_on_line: None,
        has_codes: true,
        has_durations: false,
        has_items: false,
        ends: None,
        needs_torque_end: false,
        reports_rotor: false,
        ids: |profile| [1, profile.ids.largest],
        factory_bitrate: None,
        capabilities: |_, scales| Capabilities::of_impedances(scales),
        default_host_id: |profile, id| profile.ids.reply_id(id),
        #[cfg(feature = "commissioning")]
        reported: |_| crate::reported::ReportedProtocol::OtherMit,
        #[cfg(feature = "commissioning")]
        question: crate::reported::Question::Both,
        #[cfg(feature = "drive")]
        frame_lengths: |_| [motord_bus::arithmetic::FrameLength::classic(8); 2],
        #[cfg(feature = "drive")]
        addresses: crate::drive::Addresses::by_id,
        #[cfg(feature = "drive")]
        confirms_stop: None,
        #[cfg(feature = "drive")]
        reports: &[],
    };

    /// Returns whether the motors of a vendor speak it.
    #[must_use]
    pub fn is_spoken_by(&self, profile: &Profile) -> bool {
        profile.speaks(self.name)
    }

    /// Returns the values of the largest codes of a motor of this model. `None` where the torque code is
    /// SteadyWin's current.
    #[must_use]
    pub fn ends_of(&self, model: &Model) -> Option<Ends> {
        self.ends.or(model.ends)
    }

    /// Returns whether constants of a motor of this model convert its codes or its positions.
    #[must_use]
    pub fn uses_constants(&self, model: &Model) -> bool {
        model.ends.is_none() || self.reports_rotor
    }
}
