//! Compares a given object with the object that its frame decodes to.

use crate::object::{Object, Quantities};
use crate::rejected::Rejected;
use crate::{hex, null_bytes};
use serde_json::Value;

/// Members that do not follow from the bytes of a frame: time and interface of a log line, the
/// vendor's filler.
const CONTEXT: [&str; 4] = ["time", "interface", "motor", "as_mit"];

/// Compares a given object with the decoded one.
///
/// # Errors
///
/// A member of `given` is not in the frame, or the frame has another value.
pub(super) fn check(given: &Object, decoded: &Object) -> Result<(), Rejected> {
    for (key, received) in given.entries() {
        let expected = decoded.get(key);
        let is_rounded = expected.is_some() && is_rounded(key, given);
        if CONTEXT.contains(&key.as_str()) || is_rounded || is_same(key, received, expected) {
            continue;
        }
        let key = key.clone();
        return Err(match expected {
            None => Rejected::UnknownKey { key },
            Some(expected) => Rejected::Contradiction {
                key,
                received: received.to_string(),
                expected: expected.to_string(),
            },
        });
    }
    Ok(())
}

/// Returns true for a value that was rounded to a code. `Object::code` compares it with the
/// object's own code. A given payload is used unchanged, so nothing is rounded.
fn is_rounded(key: &str, given: &Object) -> bool {
    if given.has("payload") {
        return false;
    }
    Quantities::have_key(key, given) || key == "position_rad" && !given.has("value") && given.has("conf_id")
}

fn is_same(key: &str, given: &Value, decoded: Option<&Value>) -> bool {
    match (given, decoded) {
        (Value::String(given), None) if key == null_bytes::KEY => {
            hex::bytes(given).is_ok_and(|bytes| bytes.iter().all(|&byte| byte == 0))
        }
        (Value::String(given), Some(Value::String(decoded)))
            if [null_bytes::KEY, "payload"].contains(&key) =>
        {
            hex::bytes(given).is_ok_and(|bytes| hex::digits(&bytes) == *decoded)
        }
        (Value::Object(given), Some(Value::Object(decoded))) => {
            given.iter().all(|(key, given)| is_same(key, given, decoded.get(key)))
        }
        (Value::Number(given), Some(Value::Number(decoded))) => {
            let (given, is_float) = (given.as_f64(), decoded.is_f64());
            // 32-bit floats: a typed number has fewer digits than the printed one.
            let single = |value: Option<f64>| value.map(|value| value as f32);
            given == decoded.as_f64() || is_float && single(given) == single(decoded.as_f64())
        }
        (given, decoded) => Some(given) == decoded,
    }
}
