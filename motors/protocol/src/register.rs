//! Access to the registers of Damiao motors: one request id for all motors of a bus, and an answer
//! with the motor's reply id that repeats the first four bytes. Sources: DM_CAN.py, motorbridge,
//! openarm_can, LeRobot; not confirmed on hardware.

/// Id of every request.
pub const REQUEST_ID: u16 = 0x7FF;
/// Id of the motor's replies (MST_ID).
pub const REPLY_ID: u8 = 7;
/// The motor's id (ESC_ID).
pub const ID: u8 = 8;
/// Control mode (CTRL_MODE), see [`MIT_MODE`].
pub const MODE: u8 = 10;
/// The value of [`MODE`] of a motor that speaks MIT.
pub const MIT_MODE: u32 = 1;
/// Largest position that a code can have, rad.
pub const PMAX: u8 = 21;
/// Largest velocity that a code can have, rad/s.
pub const VMAX: u8 = 22;
/// Largest torque that a code can have, N·m.
pub const TMAX: u8 = 23;

/// The registers with the ends of the codes.
pub const ENDS: [u8; 3] = [PMAX, VMAX, TMAX];
/// The vendor's names of [`ENDS`].
pub const END_NAMES: [&str; 3] = ["PMAX", "VMAX", "TMAX"];
/// The largest number of a register.
const LARGEST: u8 = 81;

/// Returns `true` when `payload` is the answer of the motor `id` to an access to any of its
/// registers, and no state: a state with these bytes has the position code 0x33, 0x55 or 0xAA and a
/// third of the velocity range backward, in a motor that is disabled. Real-time: constant time.
#[must_use]
#[inline]
pub const fn is_answer(id: u8, payload: &[u8]) -> bool {
    matches!(*payload, [first, 0, 0x33 | 0x55 | 0xAA, register, _, _, _, _] if first == id && register <= LARGEST)
}

/// Returns the index in [`ENDS`] of the register in the answer to [`read`], and its value; `None`
/// for any other payload. The number may be anything.
#[must_use]
pub fn end_of(id: u8, payload: &[u8]) -> Option<(usize, f32)> {
    let found = |(index, &register)| Some((index, value(id, register, payload)?));
    ENDS.iter().enumerate().find_map(found)
}

/// Returns the request for the value of `register` of the motor `id`.
#[must_use]
pub const fn read(id: u8, register: u8) -> [u8; 8] {
    [id, 0, 0x33, register, 0, 0, 0, 0]
}

/// Returns the request to change `register` of the motor `id`. The value is lost with the power
/// unless the motor stores it.
#[must_use]
pub const fn write(id: u8, register: u8, value: u32) -> [u8; 8] {
    let [a, b, c, d] = value.to_le_bytes();
    [id, 0, 0x55, register, a, b, c, d]
}

/// Returns the request to store the registers of the motor `id`, which must be disabled.
#[must_use]
pub const fn store(id: u8) -> [u8; 8] {
    [id, 0, 0xAA, 0, 0, 0, 0, 0]
}

/// Returns the value in the answer to [`read`]; `None` for any other payload. The number may be
/// anything.
#[must_use]
pub fn value(id: u8, register: u8, payload: &[u8]) -> Option<f32> {
    number(id, register, payload).map(f32::from_bits)
}

/// Like [`value`], of a register that holds an integer.
#[must_use]
pub fn number(id: u8, register: u8, payload: &[u8]) -> Option<u32> {
    let [first, rest] = [payload.first_chunk::<4>()?, payload.get(4..)?.first_chunk::<4>()?];
    let is_whole = payload.len() == 8 && *first == [id, 0, 0x33, register];
    is_whole.then(|| u32::from_le_bytes(*rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes from DM_CAN.py `__send_data` with 0x33 (read_motor_param), and IEEE 754: 12.5 is
    /// 0x41480000, 8 is 0x41000000.
    #[test]
    fn request_and_answer_are_the_vendors_bytes() {
        assert_eq!(read(1, 21), [0x01, 0x00, 0x33, 0x15, 0, 0, 0, 0]);
        let answer = [0x01, 0x00, 0x33, 0x15, 0x00, 0x00, 0x48, 0x41];
        assert_eq!(value(1, PMAX, &answer), Some(12.5));
        assert_eq!(value(2, VMAX, &[0x02, 0x00, 0x33, 0x16, 0x00, 0x00, 0x00, 0x41]), Some(8.0));
        assert_eq!(write(1, ID, 0x0203), [0x01, 0x00, 0x55, 0x08, 0x03, 0x02, 0x00, 0x00]);
        assert_eq!(store(1), [0x01, 0x00, 0xAA, 0x00, 0, 0, 0, 0]);
        assert_eq!(number(1, REPLY_ID, &[0x01, 0x00, 0x33, 0x07, 0x11, 0, 0, 0]), Some(0x11));
        assert_eq!(value(2, PMAX, &answer), None, "another motor");
        assert_eq!(value(1, VMAX, &answer), None, "another register");
        assert_eq!((end_of(1, &answer), end_of(2, &answer)), (Some((0, 12.5)), None));
        assert!(is_answer(1, &answer) && !is_answer(2, &answer) && !is_answer(1, &answer[..7]));
        assert!(!is_answer(1, &[0x11, 0x00, 0x33, 0x15, 0, 0, 0, 0]), "an enabled motor reports its state");
        assert!(
            !is_answer(1, &[0x01, 0x00, 0x33, 0x7F, 0xF7, 0xFF, 25, 25]),
            "a motor at rest reports its state"
        );
        for len in 0..8 {
            assert_eq!(value(1, PMAX, &answer[..len]), None);
        }
    }
}
