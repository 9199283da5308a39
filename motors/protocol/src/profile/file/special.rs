//! `[special-frames]`: the frames that are no control frame.

use super::table::{Table, plain};
use crate::profile::{FaultReport, SpecialFrames};

/// The keys, in the order of the fields.
const KEYS: [&str; 4] = ["start", "stop", "zero", "clear-fault"];
/// Bytes 0xFF at the begin of every special frame, and of no control frame.
const BEGIN: usize = 6;
/// The last byte of a question for the faults.
const QUESTION: u8 = 0xFB;

/// Reads `[special-frames]`. A frame that is not written is that of most vendors.
pub(super) fn read(special: &Table<'_>, faults: Option<&FaultReport>) -> Option<SpecialFrames> {
    special.refuse_unknown(&KEYS);
    let common = SpecialFrames::COMMON;
    let start = frame(special, "start", Some(common.start))?;
    let stop = frame(special, "stop", Some(common.stop))?;
    let zero = frame(special, "zero", Some(common.zero))?;
    let clear = frame(special, "clear-fault", common.clear)?;
    for (key, frame) in [("start", start), ("stop", stop), ("zero", zero)] {
        if frame.is_none() {
            special.problem(key, "every motor has this frame; write its eight bytes");
        }
    }
    let frames = [start?, stop?, zero?];
    check_distinct(special, &frames.into_iter().chain(clear).collect::<Vec<_>>());
    for (key, [.., f_cmd, last]) in KEYS.into_iter().zip(frames.into_iter().chain(clear)) {
        if matches!(faults, Some(FaultReport::Asked(_))) && last == QUESTION && f_cmd != 0xFF {
            special.problem(key, "is the question for the faults; give another frame");
        }
    }
    Some(SpecialFrames { start: frames[0], stop: frames[1], zero: frames[2], clear })
}

/// Reads one frame; `Some(None)` for "none".
#[expect(clippy::option_option, reason = "a frame that is wrong, and one that the motors do not have")]
fn frame(special: &Table<'_>, key: &str, common: Option<[u8; 8]>) -> Option<Option<[u8; 8]>> {
    if !special.has(key) {
        return Some(common);
    }
    let text = special.text(key)?;
    if text == "none" {
        return Some(None);
    }
    let bytes: Option<Vec<u8>> =
        text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).ok()).collect();
    let Some(bytes) = bytes.and_then(|bytes| <[u8; 8]>::try_from(bytes).ok()) else {
        let message = format!(
            "`{}` is no frame; write its eight bytes, such as \"FF FF FF FF FF FF FF FC\"",
            plain(text)
        );
        special.problem(key, message);
        return None;
    };
    if bytes[..BEGIN].iter().any(|byte| *byte != 0xFF) {
        special.problem(key, "a control frame can have these bytes; a special frame begins with six bytes FF, as no control frame does");
    }
    Some(Some(bytes))
}

/// Reports a frame with two meanings.
fn check_distinct(special: &Table<'_>, frames: &[[u8; 8]]) {
    for (index, frame) in frames.iter().enumerate() {
        if let Some(before) = frames[..index].iter().position(|other| other == frame) {
            special.problem(KEYS[index], format!("is the frame of {} too; give another", KEYS[before]));
        }
    }
}
