//! The conversion of one frame to an object, and back.

use crate::object::Object;
use crate::options::{AnsweredCommand, Direction, FrameProtocol};
use crate::rejected::Rejected;
use crate::scale::Scale;
use crate::{agreement, gim, mit, serial};
use motord_protocol::Profile;
use serde_json::Value;

/// Converts frames of one protocol and direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Codec {
    pub(super) protocol: FrameProtocol,
    pub(super) direction: Direction,
    pub(super) asked: AnsweredCommand,
    pub(super) profile: &'static Profile,
    pub(super) scale: Option<Scale>,
}

impl Codec {
    /// Decodes a frame.
    pub(super) fn decode(&self, bytes: &[u8]) -> Result<Object, Rejected> {
        let object = Object::new(self.profile, self.scale);
        match (self.protocol, self.direction) {
            (FrameProtocol::Mit, Direction::ToMotor) => mit::decode_command(bytes, object),
            (FrameProtocol::Mit, Direction::ToHost) => mit::decode_reply(bytes, self.asked, object),
            (FrameProtocol::GimCan, Direction::ToMotor) => gim::decode_command(bytes, object),
            (FrameProtocol::GimCan, Direction::ToHost) => gim::decode_reply(bytes, self.asked, object),
            (FrameProtocol::GimRs485, direction) => serial::decode(bytes, direction, self.asked, object),
        }
    }

    /// Encodes an object. Decodes the frame again, and rejects an object that contradicts it.
    pub(super) fn encode(&self, object: Object, mit_safe: bool) -> Result<Vec<u8>, Rejected> {
        let object = object.with_scale(self.profile, self.scale)?;
        let bytes = match (self.protocol, self.direction) {
            (FrameProtocol::Mit, Direction::ToMotor) => {
                self.profile.encode_codes(mit::command(&object)?).to_vec()
            }
            (FrameProtocol::Mit, Direction::ToHost) => mit::encode_reply(&object)?,
            (FrameProtocol::GimCan, Direction::ToMotor) => gim::encode_command(&object, mit_safe)?,
            (FrameProtocol::GimCan, Direction::ToHost) => gim::encode_reply(&object)?,
            (FrameProtocol::GimRs485, direction) => serial::encode(&object, direction, mit_safe)?,
        };
        let asked = match object.kind()? {
            "fault_reply" => AnsweredCommand::GetFault,
            "clear_fault_reply" => AnsweredCommand::ClearFault,
            "calibration" => AnsweredCommand::Calibration,
            _ => AnsweredCommand::State,
        };
        let decoded = Self { asked, scale: object.scale(), ..*self }.decode(&bytes)?;
        agreement::check(&object, &decoded)?;
        if object.has(gim::AS_MIT) {
            self.check_as_mit(&object, &bytes)?;
        }
        Ok(bytes)
    }

    /// Rejects an object whose member `as_mit` contradicts its frame.
    fn check_as_mit(&self, object: &Object, bytes: &[u8]) -> Result<(), Rejected> {
        let payload = match (self.protocol, self.direction) {
            (FrameProtocol::GimCan, Direction::ToMotor) => bytes,
            (FrameProtocol::GimRs485, Direction::ToMotor) => serial::payload(bytes),
            _ => return Err(Rejected::UnknownKey { key: gim::AS_MIT.into() }),
        };
        let given = object.object(gim::AS_MIT)?.with_scale(self.profile, self.scale)?;
        let read = mit::decode_command(payload, Object::new(self.profile, given.scale()))?;
        agreement::check(&given, &read)?;
        if mit::command(&given)? == mit::command(&read)? {
            return Ok(());
        }
        let (received, expected) = (Value::from(given).to_string(), Value::from(read).to_string());
        Err(Rejected::Contradiction { key: gim::AS_MIT.into(), received, expected })
    }
}
