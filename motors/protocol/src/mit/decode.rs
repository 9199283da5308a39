//! Decoding and encoding of replies by a profile.

use super::{Asked, Reply, State};
use crate::error::DecodeError;
use crate::fault::Faults;
use crate::profile::{FaultReply, FaultReport, Profile, Status, Temperature};
use crate::scale::Scales;
use crate::state::StateCodes;

/// Status of a reply without one.
const NO_STATUS: u8 = 0;
/// Number of bits below the four of a status of newer firmware ([`Flags`](crate::profile::Flags)).
const FLAGS_SHIFT: u32 = 4;

impl Profile {
    /// Decodes `payload` as the reply to a request for `asked`.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// When the number of bytes is not that of such a reply.
    pub fn decode(&self, payload: &[u8], asked: Asked, scales: &Scales) -> Result<Reply, DecodeError> {
        let id = payload.first().map_or(0, |first| first & self.reply.id_mask);
        match (asked, &self.faults) {
            (Asked::State, _) | (Asked::Fault, FaultReport::InEveryReply(_) | FaultReport::Never) => {
                self.decode_state(payload, scales).map(Reply::State)
            }
            (Asked::Fault, FaultReport::Asked(reply)) => {
                must_fit(payload, &reply.lengths)?;
                let number = number(payload, reply.bytes);
                Ok(Reply::Fault { id, number, faults: reply.faults(number) })
            }
            (Asked::Clear, _) => {
                must_fit(payload, &self.reply.lengths)?;
                Ok(Reply::Cleared { id })
            }
        }
    }

    /// Returns `true` when the length of `payload` is that of a reply with a state.
    #[must_use]
    #[inline]
    pub fn fits_state(&self, payload: &[u8]) -> bool {
        let [least, most] = self.reply.lengths;
        (least..=most).contains(&payload.len())
    }

    /// Returns the state in `payload`, whatever the request was.
    ///
    /// Real-time: does not allocate or block; takes constant time.
    ///
    /// # Errors
    ///
    /// When the number of bytes is not that of a state.
    #[inline(always)]
    pub fn decode_state(&self, payload: &[u8], scales: &Scales) -> Result<State, DecodeError> {
        must_fit(payload, &self.reply.lengths)?;
        let &[first, a, b, c, d, e, ..] = payload else { return Err(length(payload, &self.reply.lengths)) };
        let codes = StateCodes::unpack([a, b, c, d, e]);
        let [position, velocity, torque] = codes.scaled(scales);
        let temperatures = match self.reply.temperatures {
            [] => [None; 2],
            [first, others @ ..] => {
                [first.read(payload), others.first().and_then(|field| field.read(payload))]
            }
        };
        let status = match self.faults {
            FaultReport::InEveryReply(status) => payload.get(status.at).map(|byte| byte >> status.shift),
            FaultReport::Asked(_) => self.flags(payload),
            FaultReport::Never => None,
        };
        let id = first & self.reply.id_mask;
        Ok(State { id, position, velocity, torque, codes, temperatures, status })
    }

    /// Returns the status of newer firmware; `None` where all its bits are zero.
    #[inline]
    fn flags(&self, payload: &[u8]) -> Option<u8> {
        let flags = self.reply.flags.as_ref()?;
        payload.get(flags.at).map(|byte| byte >> FLAGS_SHIFT).filter(|status| *status != 0)
    }

    /// Returns the faults that `state` reports; `None` where the motor reports them on request. A
    /// motor that never reports a fault has none.
    #[must_use]
    #[inline]
    pub fn faults_of(&self, state: &State) -> Option<Faults> {
        match self.faults {
            FaultReport::InEveryReply(status) => Some(status.faults(state.status?)),
            FaultReport::Asked(_) => None,
            FaultReport::Never => Some(Faults::NONE),
        }
    }

    /// Returns `true` when the status of `state` reports the motor as enabled; `None` where the
    /// state has no status. Where every reply has one, a status that no document lists counts as
    /// enabled, because the motor may be on.
    #[must_use]
    #[inline]
    pub fn is_on(&self, state: &State) -> Option<bool> {
        match self.faults {
            FaultReport::InEveryReply(status) => status.is_on(state.status?),
            FaultReport::Asked(_) => self.reply.flags.as_ref()?.is_on(state.status?),
            FaultReport::Never => None,
        }
    }

    /// Returns `true` when `state` reports a fault that it does not name: the motor names it on
    /// request.
    #[must_use]
    #[inline]
    pub fn has_unnamed_fault(&self, state: &State) -> bool {
        let (Some(status), Some(flags)) = (state.status, &self.reply.flags) else { return false };
        flags.is_on(status).is_some() && status & flags.fault != 0
    }

    /// Returns the first bytes of `reply`, as many as its layout has, with the bytes of `filler`
    /// where they have no meaning. For tools and tests; the host only receives replies.
    #[must_use]
    pub fn encode_over(&self, reply: &Reply, filler: [u8; 8]) -> ([u8; 8], usize) {
        let mut bytes = filler;
        let known = self.known_bytes(reply);
        bytes[0] = reply.id();
        match (reply, &self.faults) {
            (Reply::State(state), faults) => {
                bytes[1..6].copy_from_slice(&state.codes.pack());
                let status = state.status.unwrap_or(NO_STATUS);
                match faults {
                    FaultReport::InEveryReply(Status { at: 0, shift, .. }) => bytes[0] |= status << shift,
                    FaultReport::InEveryReply(Status { at, shift, .. }) => bytes[*at] = status << shift,
                    FaultReport::Asked(_) | FaultReport::Never => {}
                }
                let fields = self.reply.temperatures.iter().zip(state.temperatures);
                fields.for_each(|(field, celsius)| field.write(celsius, &mut bytes));
                if let Some(flags) = self.reply.flags {
                    bytes[flags.at] |= status << FLAGS_SHIFT;
                }
            }
            (Reply::Fault { number, .. }, FaultReport::Asked(FaultReply { bytes: count, .. })) => {
                bytes[1..=*count].copy_from_slice(&number.to_le_bytes()[..*count]);
            }
            (Reply::Fault { .. } | Reply::Cleared { .. }, _) => {}
        }
        (bytes, known)
    }

    /// Returns the documented number of bytes of `reply`.
    #[must_use]
    pub fn known_bytes(&self, reply: &Reply) -> usize {
        match (reply, &self.faults) {
            (Reply::Fault { .. }, FaultReport::Asked(reply)) => reply.lengths[0],
            _ => self.reply.lengths[0],
        }
    }
}

impl Temperature {
    /// Returns the temperature, °C; `None` when `payload` ends before it.
    fn read(&self, payload: &[u8]) -> Option<f32> {
        let bytes = payload.get(self.at..self.at + self.bytes())?;
        let code = bytes.iter().fold(0, |code, byte| code << 8 | i32::from(*byte)) & (self.codes() - 1);
        let code = if code < i32::from(self.negative_from) { code } else { code - self.codes() };
        Some(code as f32 / self.per_celsius)
    }

    /// Writes the nearest code, with zeros above it. Without a temperature, writes 0 °C.
    fn write(&self, celsius: Option<f32>, bytes: &mut [u8; 8]) {
        let code = celsius.unwrap_or_default() * self.per_celsius;
        // The cast rounds towards zero, saturates, and converts NaN to 0.
        let nearest = (code + if code < 0.0 { -0.5 } else { 0.5 }) as i32;
        let largest = i32::from(self.negative_from) - 1;
        let code = nearest.clamp(largest + 1 - self.codes(), largest) & (self.codes() - 1);
        let [_, _, high, low] = code.to_be_bytes();
        bytes[self.at..self.at + self.bytes()].copy_from_slice(&[high, low][2 - self.bytes()..]);
    }

    /// Returns the number of bytes that hold its bits.
    const fn bytes(&self) -> usize {
        self.bits.div_ceil(8) as usize
    }

    /// Returns the number of its codes.
    const fn codes(&self) -> i32 {
        1 << self.bits
    }
}

/// Returns the little-endian number of `bytes` bytes after the first byte.
fn number(payload: &[u8], bytes: usize) -> u32 {
    payload.iter().skip(1).take(bytes).rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
}

#[inline]
fn must_fit(payload: &[u8], lengths: &[usize; 2]) -> Result<(), DecodeError> {
    let &[least, most] = lengths;
    if (least..=most).contains(&payload.len()) { Ok(()) } else { Err(length(payload, lengths)) }
}

#[cold]
const fn length(payload: &[u8], &[least, most]: &[usize; 2]) -> DecodeError {
    DecodeError::Length { least, most, received: payload.len() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mit::FAMILY;
    use crate::profile::{ROBSTRIDE, STEADYWIN};

    fn scales() -> Scales {
        Scales::by_current(0.1, 8.0).unwrap()
    }

    #[test]
    fn steadywin_reply_is_read_as_requested() {
        let bytes = [7, 0x02, 0x34, 0x56, 0x78, 0x9A];
        let codes = StateCodes { position: 0x0234, velocity: 0x567, torque: 0x89A };
        let reply = |asked| STEADYWIN.decode(&bytes, asked, &scales()).unwrap();
        assert!(matches!(reply(Asked::State), Reply::State(state) if state.codes == codes));
        let fault = Reply::Fault { id: 7, number: 0x02, faults: Faults::OVER_VOLTAGE };
        assert_eq!(reply(Asked::Fault), fault);
        assert_eq!(reply(Asked::Clear), Reply::Cleared { id: 7 });
        assert!([Asked::State, Asked::Fault, Asked::Clear].iter().all(|&asked| reply(asked).id() == 7));
    }

    #[test]
    fn reply_of_other_length_is_refused() {
        for profile in Profile::all() {
            let [least, most] = profile.reply.lengths;
            for received in 0..=64 {
                let reply = profile.decode(&[0x55; 64][..received], Asked::State, &scales());
                if (least..=most).contains(&received) {
                    assert_eq!(reply, profile.decode(&[0x55; 64][..least], Asked::State, &scales()));
                } else {
                    assert_eq!(reply, Err(DecodeError::Length { least, most, received }), "{}", profile.name);
                }
            }
        }
    }

    #[test]
    fn every_motor_code_survives_a_round_trip() {
        // MyActuator's frames have bytes without a meaning, and are no replies in MIT.
        for profile in Profile::all().filter(|profile| profile.speaks(FAMILY.name)) {
            for code in 0..=u16::MAX {
                let codes = StateCodes { position: code, velocity: code >> 4, torque: code & 0x0FFF };
                let [a, b, c, d, e] = codes.pack();
                let bytes = [0x11, a, b, c, d, e, code as u8, (code >> 8) as u8];
                let payload = &bytes[..profile.reply.lengths[0]];
                let reply = profile.decode(payload, Asked::State, &scales()).unwrap();
                let (written, known) = profile.encode_over(&reply, [0xA5; 8]);
                assert_eq!(&written[..known], payload, "{}", profile.name);
                assert!(matches!(reply, Reply::State(state) if state.codes == codes));
            }
        }
    }

    /// Damiao's codes 2 to 7 and 15 are not documented.
    #[test]
    fn undocumented_status_does_not_mean_off() {
        let is_on = |profile: &Profile, code: u8| {
            let state =
                profile.decode_state(&[code << 4 | 1, 0x80, 0, 0x80, 0x08, 0, 25, 25], &scales()).unwrap();
            profile.is_on(&state)
        };
        for code in 0..=0x0F {
            let is_off = code == 0x0 || (0x8..=0xE).contains(&code);
            assert_eq!(is_on(&crate::profile::DAMIAO, code), Some(!is_off), "{code:#x}");
            assert_eq!(is_on(&STEADYWIN, code), None);
        }
    }

    /// RobStride's manuals of 2026-04-10: mode (0 reset, 1 calibration, 2 motor), fault, warning.
    #[test]
    fn robstride_status_is_read_above_its_temperature() {
        let read = |status: u8| {
            let bytes = [1, 0x80, 0, 0x80, 0x08, 0, status << 4 | 0x01, 0x2C];
            ROBSTRIDE.decode_state(&bytes, &scales()).unwrap()
        };
        for (status, is_on, has_fault) in [
            (0b0000, None, false),
            (0b0001, Some(false), false),
            (0b0010, Some(false), true),
            (0b0100, Some(false), false),
            (0b1000, Some(true), false),
            (0b1001, Some(true), false),
            (0b1011, Some(true), true),
            // The sign of older firmware's temperature.
            (0b1111, None, false),
        ] {
            let state = read(status);
            assert_eq!(state.temperatures, [Some(30.0), None], "{status:04b}");
            assert_eq!(ROBSTRIDE.is_on(&state), is_on, "{status:04b}");
            assert_eq!(ROBSTRIDE.has_unnamed_fault(&state), has_fault, "{status:04b}");
            assert_eq!(ROBSTRIDE.faults_of(&state), None, "the word is asked for");
        }
    }

    #[test]
    fn temperature_beyond_its_codes_is_written_as_end() {
        for (profile, celsius, end) in [
            (&crate::profile::DAMIAO, 300.0, 215.0),
            (&crate::profile::DAMIAO, -300.0, -40.0),
            (&ROBSTRIDE, 300.0, 204.7),
            (&ROBSTRIDE, -300.0, -204.8),
        ] {
            let bytes = [1, 0x80, 0, 0x80, 0x08, 0, 0, 0];
            let state = profile.decode_state(&bytes, &scales()).unwrap();
            let state = State { temperatures: [Some(celsius); 2], ..state };
            let (written, _) = profile.encode_over(&Reply::State(state), bytes);
            assert_eq!(profile.decode_state(&written, &scales()).unwrap().temperatures[0], Some(end));
        }
    }

    #[test]
    fn moving_state_is_never_a_fault_report() {
        for profile in Profile::all() {
            // Every state except those with both velocity and torque at their most negative ends.
            for velocity in 0x020..=0xFFF {
                let codes = StateCodes { position: 0, velocity, torque: 0 };
                let [a, b, c, d, e] = codes.pack();
                assert!(!profile.is_fault_report(&[1, a, b, c, d, e, 0, 0]), "{}", profile.name);
            }
            for torque in 1..=0xFFF {
                let [a, b, c, d, e] = StateCodes { position: 0, velocity: 0, torque }.pack();
                assert!(!profile.is_fault_report(&[1, a, b, c, d, e, 0, 0]), "{}", profile.name);
            }
        }
    }
}
