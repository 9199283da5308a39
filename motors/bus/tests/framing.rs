//! Compares the framing with frames derived from the vendor's document, in both directions.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_bus::serial::framing::{Decoder, FRAME_LEN_MAX, FrameType, SerialFrame};
use serde_json::{Value, json};

fn hex(digits: &str) -> Vec<u8> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}

fn vectors() -> Vec<Value> {
    let all = include_str!("../../protocol/tests/golden_vectors.json");
    let all: Vec<Value> = serde_json::from_str(all).unwrap();
    all.into_iter().filter(|vector| vector["protocol"] == "gim-rs485").collect()
}

#[test]
fn serial_frames_are_read_and_written_as_documented() {
    let vectors = vectors();
    assert!(vectors.len() >= 10, "{}", vectors.len());
    for vector in vectors {
        let (name, bytes) = (&vector["name"], hex(vector["hex"].as_str().unwrap()));
        let frame = SerialFrame::decode(&bytes).unwrap();
        let [id, frame_type, len, crc] = frame.header();
        let header = json!({ "id": id, "type": frame_type, "len": len, "crc": crc });
        assert_eq!(header, vector["decoded"]["header"], "{name}");
        let is_ack = vector["decoded"]["kind"] == "ack_error";
        assert_eq!(frame.frame_type() == FrameType::Ack, is_ack, "{name}");

        let mut decoder = Decoder::new();
        let found = bytes.iter().filter_map(|&byte| decoder.push(byte, |_| true));
        assert!(found.eq([frame]), "{name}");
        assert_eq!(frame.write(&mut [0; FRAME_LEN_MAX]), bytes, "{name}");
    }
}
