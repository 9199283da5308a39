//! The conversion of one frame to an object, and back.

use crate::object::Object;
use crate::options::{Asked, Direction, Protocol};
use crate::refused::Refused;
use crate::scale::Scale;
use crate::{agreement, gim, mit, serial};
use motord_protocol::Profile;
use serde_json::Value;

/// How to read one frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reading {
    pub(super) protocol: Protocol,
    pub(super) direction: Direction,
    pub(super) asked: Asked,
    pub(super) profile: &'static Profile,
    pub(super) scale: Option<Scale>,
}

impl Reading {
    /// The object of a frame.
    pub(super) fn decode(&self, bytes: &[u8]) -> Result<Object, Refused> {
        let object = Object::new(self.profile, self.scale);
        match (self.protocol, self.direction) {
            (Protocol::Mit, Direction::ToMotor) => mit::decode_command(bytes, object),
            (Protocol::Mit, Direction::ToHost) => mit::decode_reply(bytes, self.asked, object),
            (Protocol::GimCan, Direction::ToMotor) => gim::decode_command(bytes, object),
            (Protocol::GimCan, Direction::ToHost) => gim::decode_reply(bytes, self.asked, object),
            (Protocol::GimRs485, direction) => serial::decode(bytes, direction, self.asked, object),
        }
    }

    /// The frame of an object. The frame is decoded again, and an object that says anything else is refused.
    pub(super) fn encode(&self, object: Object, mit_safe: bool) -> Result<Vec<u8>, Refused> {
        let object = object.with_scale(self.profile, self.scale)?;
        let bytes = match (self.protocol, self.direction) {
            (Protocol::Mit, Direction::ToMotor) => mit::command(&object)?.encode().to_vec(),
            (Protocol::Mit, Direction::ToHost) => mit::encode_reply(&object)?,
            (Protocol::GimCan, Direction::ToMotor) => gim::encode_command(&object, mit_safe)?,
            (Protocol::GimCan, Direction::ToHost) => gim::encode_reply(&object)?,
            (Protocol::GimRs485, direction) => serial::encode(&object, direction, mit_safe)?,
        };
        let asked = match object.kind()? {
            "fault_reply" => Asked::GetFault,
            "clear_fault_reply" => Asked::ClearFault,
            "calibration" => Asked::Calibration,
            _ => Asked::State,
        };
        let decoded = Self { asked, scale: object.scale(), ..*self }.decode(&bytes)?;
        agreement::check(&object, &decoded)?;
        if object.has(gim::AS_MIT) {
            self.check_as_mit(&object, &bytes)?;
        }
        Ok(bytes)
    }

    /// The object says how a motor in MIT mode reads the command: it must read it so.
    fn check_as_mit(&self, object: &Object, bytes: &[u8]) -> Result<(), Refused> {
        let payload = match (self.protocol, self.direction) {
            (Protocol::GimCan, Direction::ToMotor) => bytes,
            (Protocol::GimRs485, Direction::ToMotor) => serial::payload(bytes),
            _ => return Err(Refused::UnknownKey { key: gim::AS_MIT.into() }),
        };
        let given = object.object(gim::AS_MIT)?.with_scale(self.profile, self.scale)?;
        let read = mit::decode_command(payload, Object::new(self.profile, given.scale()))?;
        agreement::check(&given, &read)?;
        if mit::command(&given)? == mit::command(&read)? {
            return Ok(());
        }
        let (received, expected) = (Value::from(given).to_string(), Value::from(read).to_string());
        Err(Refused::Contradiction { key: gim::AS_MIT.into(), received, expected })
    }
}
