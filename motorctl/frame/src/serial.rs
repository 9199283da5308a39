//! GIM frames on a serial line: a header before the payload.

use crate::object::Object;
use crate::options::{AnsweredCommand, Direction};
use crate::rejected::Rejected;
use crate::{gim, hex};
use motord_bus::serial::framing::{FRAME_LEN_MAX, FrameType, SerialFrame};
use motord_protocol::DecodeError;
use serde_json::json;

/// Bytes before the payload (GIM document, table 3).
const HEADER_LEN: usize = 4;
/// The kind of a frame that reports an unreadable request.
const ACK: &str = "ack_error";

/// Decodes a frame into `object`.
pub(super) fn decode(
    bytes: &[u8],
    direction: Direction,
    asked: AnsweredCommand,
    mut object: Object,
) -> Result<Object, Rejected> {
    let frame = SerialFrame::decode(bytes)?;
    let payload = frame.payload();
    match (frame.frame_type(), direction) {
        (FrameType::Ack, _) => object.insert("kind", ACK),
        (FrameType::Normal, Direction::ToMotor) => object = gim::decode_command(payload, object)?,
        (FrameType::Normal, Direction::ToHost) => object = gim::decode_reply(payload, asked, object)?,
    }
    let [id, frame_type, len, crc] = frame.header();
    object.insert("header", json!({ "id": id, "type": frame_type, "len": len, "crc": crc }));
    if !payload.is_empty() {
        object.insert("payload", hex::digits(payload));
    }
    Ok(object)
}

/// Encodes a frame from the payload of the object, otherwise from its other members.
pub(super) fn encode(object: &Object, direction: Direction, mit_safe: bool) -> Result<Vec<u8>, Rejected> {
    let receiver = object.object("header")?.byte("id")?;
    let is_ack = object.kind()? == ACK;
    let payload = match direction {
        _ if object.has("payload") => object.bytes("payload")?,
        _ if is_ack => Vec::new(),
        Direction::ToMotor => gim::encode_command(object, mit_safe)?,
        Direction::ToHost => gim::encode_reply(object)?,
    };
    let frame = if is_ack {
        SerialFrame::ack(receiver, &payload)
    } else {
        payload[..].try_into().ok().map(|payload| SerialFrame::normal(receiver, payload))
    };
    let frame = frame.ok_or(DecodeError::Length { least: 0, most: 8, received: payload.len() })?;
    Ok(frame.write(&mut [0; FRAME_LEN_MAX]).to_vec())
}

/// Returns the bytes after the header of a frame.
pub(super) fn payload(frame: &[u8]) -> &[u8] {
    frame.get(HEADER_LEN..).unwrap_or_default()
}
