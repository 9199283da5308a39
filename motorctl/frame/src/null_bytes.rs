//! The bytes of a frame without a meaning. An object keeps them, so that encoding gives the same
//! frame.

use crate::hex;
use crate::object::Object;
use crate::rejected::Rejected;

/// The key of these bytes, in hexadecimal and in their order.
pub(super) const KEY: &str = "null_bytes";

/// Adds the bytes without a meaning to `object` if one of them is not 0, or if the frame is longer
/// than needed.
pub(super) fn write<const N: usize>(
    object: &mut Object,
    bytes: &[u8],
    encode_over: impl Fn([u8; N]) -> [u8; N],
) {
    let null = is_null(encode_over);
    let is_free = |(at, _): &(usize, &u8)| null.get(*at).is_none_or(|&is_null| is_null);
    let free: Vec<u8> = bytes.iter().enumerate().filter(is_free).map(|(_, &byte)| byte).collect();
    if bytes.len() > N || free.iter().any(|&byte| byte != 0) {
        object.insert(KEY, hex::digits(&free));
    }
}

/// Returns the bytes of a frame. Bytes without a meaning come from the object, otherwise from
/// `filler`. Up to `surplus` of them may follow the frame.
pub(super) fn fill<const N: usize>(
    object: &Object,
    filler: [u8; N],
    surplus: usize,
    encode_over: impl Fn([u8; N]) -> [u8; N],
) -> Result<Vec<u8>, Rejected> {
    if !object.has(KEY) {
        return Ok(encode_over(filler).to_vec());
    }
    let given = object.bytes(KEY)?;
    let null = is_null(&encode_over);
    let least = null.iter().filter(|&&is_null| is_null).count();
    let most = least + surplus;
    if !(least..=most).contains(&given.len()) {
        return Err(Rejected::NullBytes { least, most, received: given.len() });
    }
    let mut given = given.into_iter();
    let filler = null.map(|is_null| if is_null { given.next().unwrap_or(0) } else { 0 });
    Ok(encode_over(filler).into_iter().chain(given).collect())
}

/// Returns true for each byte that the encoder leaves unchanged.
fn is_null<const N: usize>(encode_over: impl Fn([u8; N]) -> [u8; N]) -> [bool; N] {
    let (zeros, ones) = (encode_over([0x00; N]), encode_over([0xFF; N]));
    core::array::from_fn(|at| zeros[at] != ones[at])
}
