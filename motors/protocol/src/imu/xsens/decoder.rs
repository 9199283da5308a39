//! Messages in a stream of bytes.

use super::item;
use crate::imu::error::SampleError;
use crate::imu::sample::{Quaternion, Sample};
use crate::imu::window::{Begun, Window};

/// Bytes of the longest message.
pub const MESSAGE_LEN_MAX: usize = AROUND + DATA_LEN_MAX;

/// Bytes of the shortest message with quaternion, acceleration and rate of turn, in `f32`.
pub const SAMPLE_LEN_MIN: usize = AROUND + (3 + 16) + 2 * (3 + 12);

/// Bytes of the longest message with an extended length.
const EXTENDED_LEN_MAX: usize = EXTENDED_HEADER_LEN + EXTENDED_DATA_LEN_MAX + 1;
/// Bytes before the data of such a message: the length is 255, and two bytes with the length
/// follow.
const EXTENDED_HEADER_LEN: usize = 6;
const EXTENDED: u8 = 255;
/// Most bytes of its data (MT0101P, chapter message structure).
const EXTENDED_DATA_LEN_MAX: usize = 2048;

/// Bytes before and after the data.
const AROUND: usize = 5;
const HEADER_LEN: usize = 4;
/// Most bytes of data: the length 255 announces another header.
const DATA_LEN_MAX: usize = 254;
/// Preamble, bus id and message id of MTData2.
const START: [u8; 3] = [0xFA, 0xFF, 0x36];

/// Positions at which a message can end, of the next [`Ends::LEN`] bytes.
#[derive(Debug, Clone, Default)]
struct Ends {
    bits: [u64; 8],
    now: usize,
}

impl Ends {
    /// More than the bytes from a length to the end of its message.
    const LEN: usize = 512;

    /// Advances by one byte. Returns `true` when a message can end with it.
    fn advance(&mut self) -> bool {
        self.now = (self.now + 1) % Self::LEN;
        let (word, bit) = (&mut self.bits[self.now / 64], 1 << (self.now % 64));
        let is_end = *word & bit != 0;
        *word &= !bit;
        is_end
    }

    /// A message can end after `count` more bytes.
    fn mark(&mut self, count: usize) {
        let end = (self.now + count) % Self::LEN;
        self.bits[end / 64] |= 1 << (end % 64);
    }
}

/// Finds samples in a stream of bytes.
#[derive(Debug, Clone, Default)]
pub struct Decoder {
    window: Window<{ 2 * EXTENDED_LEN_MAX }>,
    ends: Ends,
    /// The message with an extended length, or with another bus id, that has begun.
    begun: Option<Begun>,
}

impl Decoder {
    /// Returns a decoder that has received nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { window: Window::new(), ends: Ends { bits: [0; 8], now: 0 }, begun: None }
    }

    /// Takes the next byte. Returns the sample that it completes, or the reason for which the
    /// message that it completes is none. Messages without acceleration, rate of turn and
    /// quaternion are ignored.
    ///
    /// Real-time: does not allocate or block. Takes constant time, except where a message can end:
    /// there it compares at most 255 beginnings, and decodes those that match.
    pub fn push(&mut self, byte: u8) -> Option<Result<Sample, SampleError>> {
        self.window.push(byte);
        let is_end = self.ends.advance();
        if let Some([start @ .., len]) = self.window.last(HEADER_LEN)
            && *start == START
            && usize::from(*len) <= DATA_LEN_MAX
        {
            self.ends.mark(usize::from(*len) + 1);
        }
        let uncommon = self.uncommon();
        let decoded = if is_end { self.message() } else { None }.or(uncommon);
        if matches!(decoded, Some(Ok(_))) {
            self.window.clear();
            self.begun = None;
        }
        decoded
    }

    /// Follows a message with an extended length or another bus id. Returns what an intact one
    /// holds: bytes between messages look like damaged ones.
    fn uncommon(&mut self) -> Option<Result<Sample, SampleError>> {
        if self.begun.is_none() {
            self.begun = self.beginning();
            return None;
        }
        let len = Begun::count(&mut self.begun)?;
        let message = self.window.last(len)?;
        if checksum(&message[..len - 1]) != message[len - 1] {
            return None;
        }
        let (bus_id, is_extended) = (message[1], message[3] == EXTENDED);
        if bus_id != START[1] {
            return Some(Err(SampleError::BusId { received: bus_id }));
        }
        let header = if is_extended { EXTENDED_HEADER_LEN } else { HEADER_LEN };
        match item::decode(&message[header..len - 1]) {
            Ok(sample) => is_measurement(&sample).then_some(Ok(sample)),
            Err(error) => Some(Err(error)),
        }
    }

    /// Returns the message whose header ends with the last byte.
    fn beginning(&self) -> Option<Begun> {
        let is_start = |header: &[u8]| (header[0], header[2]) == (START[0], START[2]);
        if let Some(header @ [.., EXTENDED, high, low]) = self.window.last(EXTENDED_HEADER_LEN)
            && is_start(header)
        {
            let data = usize::from(u16::from_be_bytes([*high, *low]));
            let is_valid = (DATA_LEN_MAX + 1..=EXTENDED_DATA_LEN_MAX).contains(&data);
            return is_valid.then_some(Begun::new(EXTENDED_HEADER_LEN + data + 1, data + 1));
        }
        let header = self.window.last(HEADER_LEN)?;
        let data = usize::from(header[3]);
        let is_other = is_start(header) && header[1] != START[1] && data <= DATA_LEN_MAX;
        is_other.then_some(Begun::new(AROUND + data, data + 1))
    }

    /// Returns the sample of the message that ends with the last byte; of several that could, the
    /// first intact one.
    fn message(&self) -> Option<Result<Sample, SampleError>> {
        let mut rejected = None;
        for len in 0..=DATA_LEN_MAX {
            let Some(message) = self.window.last(AROUND + len) else { break };
            if message[..START.len()] != START || usize::from(message[START.len()]) != len {
                continue;
            }
            match decode(message) {
                Ok(sample) if is_measurement(&sample) => return Some(Ok(sample)),
                Ok(_) => {}
                Err(error) => rejected = Some(Err(error)),
            }
        }
        rejected
    }
}

/// Returns `true` for a message of which motord needs something.
fn is_measurement(sample: &Sample) -> bool {
    sample.orientation.is_some() || sample.angular_velocity.is_some() || sample.acceleration.is_some()
}

/// Decodes a message that has the length in its header.
fn decode(message: &[u8]) -> Result<Sample, SampleError> {
    let received = message[message.len() - 1];
    let expected = checksum(&message[..message.len() - 1]);
    if expected != received {
        return Err(SampleError::Checksum { expected: expected.into(), received: received.into() });
    }
    item::decode(&message[HEADER_LEN..message.len() - 1])
}

/// Returns the checksum of a message without its last byte.
pub(super) fn checksum(message: &[u8]) -> u8 {
    message[1..].iter().fold(0_u8, |sum, byte| sum.wrapping_sub(*byte))
}

/// Encodes a sample as a device would, for simulated devices and tests: `f32` and ENU. Writes to
/// the start of `buffer`, and returns the written bytes.
pub fn encode<'a>(sample: &Sample, buffer: &'a mut [u8; MESSAGE_LEN_MAX]) -> &'a [u8] {
    let mut end = HEADER_LEN;
    let mut item = |identifier: u16, value: &[u8]| {
        buffer[end..end + 2].copy_from_slice(&identifier.to_be_bytes());
        buffer[end + 2] = value.len() as u8;
        buffer[end + 3..][..value.len()].copy_from_slice(value);
        end += 3 + value.len();
    };
    sample.counter.inspect(|counter| item(item::COUNTER, &counter.to_be_bytes()));
    sample.time.inspect(|time| item(item::TIME, &time.ticks.to_be_bytes()));
    let orientation = sample.orientation.map(Quaternion::parts);
    orientation.inspect(|parts| item(item::QUATERNION, parts.map(f32::to_be_bytes).as_flattened()));
    let acceleration = sample.acceleration;
    acceleration.inspect(|value| item(item::ACCELERATION, value.map(f32::to_be_bytes).as_flattened()));
    let velocity = sample.angular_velocity;
    velocity.inspect(|value| item(item::RATE_OF_TURN, value.map(f32::to_be_bytes).as_flattened()));
    sample.temperature_celsius.inspect(|celsius| item(item::TEMPERATURE, &celsius.to_be_bytes()));
    sample.status.inspect(|status| item(item::STATUS, &status.to_be_bytes()));
    buffer[..START.len()].copy_from_slice(&START);
    buffer[START.len()] = (end - HEADER_LEN) as u8;
    buffer[end] = checksum(&buffer[..end]);
    &buffer[..=end]
}
