//! Properties of the decoders of IMU streams, tested by random samples, noise and damage.
//!
//! The checksum of Xsens has eight bits: one of 256 beginnings in noise, whose items end where they
//! must, passes for a message.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::imu::damiao::{self, Register, Reply};
use motord_protocol::imu::hipnuc::can::{self, Tpdo};
use motord_protocol::imu::hipnuc::serial;
use motord_protocol::imu::xsens::{self, MESSAGE_LEN_MAX};
use motord_protocol::imu::{DeviceTime, Measured, Parts, Quaternion, Sample, SampleError, SampleField};
use proptest::prelude::*;

/// A decoded message: a sample or the reason for which it is none.
type Event = Result<Sample, SampleError>;

/// A vendor's stream.
struct Vendor {
    encode: fn(&Sample) -> Vec<u8>,
    decode: fn(&[&[u8]]) -> Vec<Event>,
    /// The bytes with which a sample begins.
    start: &'static [u8],
}

const HIPNUC: Vendor = Vendor {
    encode: |sample| serial::encode(sample).to_vec(),
    decode: |chunks| {
        let mut decoder = serial::Decoder::new();
        chunks.iter().flat_map(|chunk| chunk.iter()).filter_map(|byte| decoder.push(*byte)).collect()
    },
    start: &[0x5A, 0xA5, 0x4C, 0x00],
};

const XSENS: Vendor = Vendor {
    encode: |sample| xsens::encode(sample, &mut [0; MESSAGE_LEN_MAX]).to_vec(),
    decode: |chunks| {
        let mut decoder = xsens::Decoder::new();
        chunks.iter().flat_map(|chunk| chunk.iter()).filter_map(|byte| decoder.push(*byte)).collect()
    },
    start: &[0xFA, 0xFF, 0x36, 0x4B],
};

impl Vendor {
    /// Returns the samples of a stream, as they arrive.
    fn samples(&self, stream: &[u8]) -> Vec<Sample> {
        (self.decode)(&[stream]).into_iter().flatten().collect()
    }

    /// Returns the sample as this vendor's frame stands for it.
    fn rounded(&self, sample: &Sample) -> Sample {
        let samples = self.samples(&(self.encode)(sample));
        assert_eq!(samples.len(), 1);
        samples[0]
    }

    /// Makes the beginnings of samples frequent in `noise`.
    fn mislead(&self, noise: &[(u8, u8)]) -> Vec<u8> {
        noise
            .iter()
            .flat_map(|(byte, kind)| if *kind < 20 { self.start.to_vec() } else { vec![*byte] })
            .collect()
    }
}

prop_compose! {
    fn sample()(
        parts in prop::array::uniform4(-1.0..1.0_f32).prop_filter("a rotation", |parts| norm(*parts) > 0.1),
        velocity in prop::array::uniform3(-30.0..30.0_f32),
        acceleration in prop::array::uniform3(-200.0..200.0_f32),
        celsius in any::<i8>(),
        ticks in any::<u32>(),
        counter in any::<u16>(),
        status in any::<u16>(),
    ) -> Sample {
        Sample {
            orientation: Some(Quaternion::new(parts.map(|part| part / norm(parts))).unwrap()),
            angular_velocity: Some(velocity),
            acceleration: Some(acceleration),
            temperature_celsius: Some(celsius.into()),
            time: Some(DeviceTime { ticks, per_second: 1000 }),
            counter: Some(counter),
            status: Some(status.into()),
        }
    }
}

fn norm(parts: [f32; 4]) -> f32 {
    parts.iter().map(|part| part * part).sum::<f32>().sqrt()
}

fn noise(most: usize) -> impl Strategy<Value = Vec<(u8, u8)>> {
    prop::collection::vec((any::<u8>(), any::<u8>()), 0..most)
}

/// Returns the numbers of `expected` that are not in `found` in their order, and of `found` that
/// are not in `expected`.
///
/// Each of the latter passed the checksum by chance, and can take the place of one that it
/// overlaps.
fn lost_and_false(found: &[Sample], expected: &[Sample]) -> (usize, usize) {
    let mut at = 0;
    let kept = expected.iter().filter(|sample| match found[at..].iter().position(|other| other == *sample) {
        Some(offset) => {
            at += offset + 1;
            true
        }
        None => false,
    });
    let kept = kept.count();
    (expected.len() - kept, found.len() - kept)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1024))]

    #[test]
    fn encoded_sample_is_decoded_to_its_values(sample in sample()) {
        for vendor in [HIPNUC, XSENS] {
            let rounded = vendor.rounded(&sample);
            let pairs = [
                (sample.acceleration.unwrap(), rounded.acceleration.unwrap()),
                (sample.angular_velocity.unwrap(), rounded.angular_velocity.unwrap()),
            ];
            for (value, again) in pairs.iter().flat_map(|(a, b)| a.iter().zip(b)) {
                prop_assert!((value - again).abs() <= value.abs() * 1e-6);
            }
            let parts = [sample, rounded].map(|sample| sample.orientation.unwrap().parts());
            prop_assert!(parts[0].iter().zip(&parts[1]).all(|(a, b)| (a - b).abs() < 1e-6));
            prop_assert_eq!(rounded.temperature_celsius, sample.temperature_celsius);
            prop_assert_eq!(rounded.time.map(|time| time.ticks), sample.time.map(|time| time.ticks));
            prop_assert_eq!(rounded.status, sample.status);
        }
        prop_assert_eq!(XSENS.rounded(&sample).counter, sample.counter);
    }

    #[test]
    fn every_split_of_a_stream_gives_same_samples(
        samples in prop::collection::vec(sample(), 1..4),
        noise in noise(40),
        at in any::<prop::sample::Index>(),
    ) {
        for vendor in [HIPNUC, XSENS] {
            let mut stream = vendor.mislead(&noise);
            stream.extend(samples.iter().flat_map(vendor.encode));
            let (first, second) = stream.split_at(at.index(stream.len() + 1));
            let single: Vec<_> = stream.chunks(1).collect();
            let whole = (vendor.decode)(&[&stream]);
            prop_assert_eq!(&(vendor.decode)(&[first, second]), &whole);
            prop_assert_eq!(&(vendor.decode)(&single), &whole);
        }
    }

    #[test]
    fn noise_between_samples_costs_none(
        samples in prop::collection::vec((sample(), noise(300)), 1..5),
        tail in noise(40),
    ) {
        for vendor in [HIPNUC, XSENS] {
            let mut decoded = Vec::new();
            let mut stream = Vec::new();
            for (sample, noise) in &samples {
                stream.extend(vendor.mislead(noise));
                stream.extend((vendor.encode)(sample));
                // The sample arrives with its last byte, not later.
                decoded.push(vendor.rounded(sample));
                let found = vendor.samples(&stream);
                let (lost, wrong) = lost_and_false(&found, &decoded);
                prop_assert!(lost <= wrong, "lost {}, false {}", lost, wrong);
                prop_assert!(wrong > 0 || found.last() == decoded.last());
            }
            stream.extend(vendor.mislead(&tail));
            let (lost, wrong) = lost_and_false(&vendor.samples(&stream), &decoded);
            prop_assert!(lost <= wrong, "lost {}, false {}", lost, wrong);
        }
    }

    #[test]
    fn damage_costs_only_the_samples_it_hits(
        samples in prop::collection::vec(sample(), 3..6),
        damage in noise(60),
        removed in 0..80_usize,
        at in any::<prop::sample::Index>(),
    ) {
        for vendor in [HIPNUC, XSENS] {
            let frames: Vec<_> = samples.iter().map(vendor.encode).collect();
            let stream = frames.concat();
            let start = at.index(stream.len());
            let end = (start + removed).min(stream.len());
            let damaged = [&stream[..start], &vendor.mislead(&damage), &stream[end..]].concat();
            let mut intact = Vec::new();
            let mut from = 0;
            for (sample, frame) in samples.iter().zip(&frames) {
                let to = from + frame.len();
                if to <= start || from >= end {
                    intact.push(vendor.rounded(sample));
                }
                from = to;
            }
            let (lost, wrong) = lost_and_false(&vendor.samples(&damaged), &intact);
            prop_assert!(lost <= wrong, "lost {}, false {}", lost, wrong);
        }
    }
}

proptest! {
    // Each case flips every bit of a sample.
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn a_flipped_bit_never_gives_a_sample(before in sample(), hit in sample(), after in sample()) {
        for vendor in [HIPNUC, XSENS] {
            let [first, frame, last] = [before, hit, after].map(|sample| (vendor.encode)(&sample));
            let expected = [vendor.rounded(&before), vendor.rounded(&after)];
            for bit in 0..frame.len() * 8 {
                let mut flipped = frame.clone();
                flipped[bit / 8] ^= 1 << (bit % 8);
                let stream = [&first[..], &flipped, &last].concat();
                prop_assert_eq!(&vendor.samples(&stream)[..], &expected, "bit {}", bit);
            }
        }
    }
}

// Samples of IMUs that send each quantity in a frame.

const NODE: u8 = 8;
const PERIOD: u64 = 5000;

const ACCELERATION: [u8; 6] = [0x4A, 0x00, 0x1F, 0x00, 0xC8, 0x03];
const VELOCITY: [u8; 6] = [0x15, 0x00, 0x14, 0x01, 0x34, 0x00];
const ORIENTATION: [u8; 8] = [0x88, 0x13, 0x88, 0x13, 0x88, 0x13, 0x88, 0x13];

fn incomplete(missing: SampleField) -> Result<Option<Sample>, SampleError> {
    Err(SampleError::Incomplete { missing })
}

#[test]
fn hipnuc_sample_needs_frames_of_its_node() {
    let mut decoder = can::Decoder::new(NODE, Parts::ALL, PERIOD / 2);
    assert_eq!(decoder.push(0x188, &ACCELERATION, 0), Ok(None));
    // Another node, another TPDO of this node, its SDO answers, and a motor.
    for id in [0x189, 0x289, 0x688, 0x588, 0x008] {
        assert_eq!(decoder.push(id, &ORIENTATION, 100), Ok(None));
    }
    assert_eq!(decoder.push(0x288, &VELOCITY, 200), Ok(None));
    assert_eq!(decoder.push(0x388, &VELOCITY, 300), Ok(None));
    let sample = decoder.push(0x488, &ORIENTATION, 400).unwrap().unwrap();
    assert_eq!(sample.orientation.unwrap().parts(), [0.5; 4]);
    let expected = [(Tpdo::Acceleration, &ACCELERATION), (Tpdo::AngularVelocity, &VELOCITY)];
    let [acceleration, velocity] = expected.map(|(tpdo, payload)| tpdo.decode(payload).unwrap());
    assert_eq!(acceleration, Measured::Acceleration(sample.acceleration.unwrap()));
    assert_eq!(velocity, Measured::AngularVelocity(sample.angular_velocity.unwrap()));
    assert_eq!((sample.time, sample.counter, sample.temperature_celsius), (None, None, None));
}

#[test]
fn undecodable_frame_drops_its_sample_once() {
    let mut decoder = can::Decoder::new(NODE, Parts::ALL, PERIOD / 2);
    assert_eq!(decoder.push(0x188, &ACCELERATION, 0), Ok(None));
    let length = SampleError::Length { least: 6, most: 6, received: 4 };
    assert_eq!(decoder.push(0x288, &VELOCITY[..4], 200), Err(length));
    assert_eq!(decoder.push(0x488, &ORIENTATION, 400), Ok(None));
    assert_eq!(decoder.push(0x188, &ACCELERATION, PERIOD), Ok(None));
    assert_eq!(decoder.push(0x288, &VELOCITY, PERIOD + 200), Ok(None));
    // A quaternion that is no rotation.
    assert!(matches!(decoder.push(0x488, &[0; 8], PERIOD + 400), Err(SampleError::NotUnit { .. })));
    assert_eq!(decoder.push(0x188, &ACCELERATION, 2 * PERIOD), Ok(None));
    // The orientation arrives without the velocity; then the next sample is whole.
    assert_eq!(decoder.push(0x488, &ORIENTATION, 2 * PERIOD + 400), incomplete(SampleField::AngularVelocity));
    assert_eq!(decoder.push(0x188, &ACCELERATION, 3 * PERIOD), Ok(None));
    assert_eq!(decoder.push(0x288, &VELOCITY, 3 * PERIOD + 200), Ok(None));
    assert!(decoder.push(0x488, &ORIENTATION, 3 * PERIOD + 400).unwrap().is_some());
}

#[test]
fn damiao_sample_has_temperature_of_its_acceleration() {
    let profile = &damiao::FIRMWARE_1024;
    let mut decoder = damiao::Decoder::new(profile, Parts::ALL, PERIOD / 2);
    let reply =
        |measured, temperature_celsius| profile.encode(&Reply::Measured { measured, temperature_celsius });
    let identity = Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 0.0 };
    let acceleration = reply(Measured::Acceleration([0.0, 0.0, 9.81]), Some(42));
    let velocity = reply(Measured::AngularVelocity([1.0, 2.0, 3.0]), None);
    let orientation = reply(Measured::Orientation(identity), None);
    assert_eq!(decoder.push(&acceleration, 0), Ok(None));
    assert_eq!(decoder.push(&profile.encode(&Reply::Confirmed { register: 0xFE, code: 0 }), 50), Ok(None));
    assert_eq!(decoder.push(&velocity, 100), Ok(None));
    let sample = decoder.push(&orientation, 200).unwrap().unwrap();
    assert_eq!(sample.temperature_celsius, Some(42.0));
    assert!(sample.acceleration.unwrap().iter().zip([0.0, 0.0, 9.81]).all(|(a, b)| (a - b).abs() < 0.004));
    // The reply to the last request of a sample arrives late: after the first of the next.
    assert_eq!(decoder.push(&acceleration, PERIOD), Ok(None));
    assert_eq!(decoder.push(&velocity, PERIOD + 100), Ok(None));
    assert_eq!(decoder.push(&orientation, 2 * PERIOD + 10), incomplete(SampleField::Orientation));
    assert_eq!(decoder.push(&acceleration, 2 * PERIOD + 100), Ok(None));
    let register = SampleError::UnknownRegister { received: 9 };
    assert_eq!(decoder.push(&[9, 0, 0, 0, 0, 0, 0, 0], 2 * PERIOD + 200), Err(register));
    assert_eq!(decoder.push(&velocity, 2 * PERIOD + 300), Ok(None));
}

#[test]
fn requests_follow_order_of_parts() {
    let fields: Vec<_> = Parts::ALL.in_order().collect();
    assert_eq!(fields, [SampleField::Acceleration, SampleField::AngularVelocity, SampleField::Orientation]);
    let registers = [Register::Acceleration, Register::AngularVelocity, Register::Orientation];
    assert!(registers.map(|register| register as u8).is_sorted());
    assert!(
        [Tpdo::Acceleration, Tpdo::AngularVelocity, Tpdo::Orientation].map(|tpdo| tpdo.id(NODE)).is_sorted()
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn arbitrary_payloads_decode_to_finite_values(payload in prop::collection::vec(any::<u8>(), 0..=10)) {
        let measured = Tpdo::ALL.into_iter().filter_map(|tpdo| tpdo.decode(&payload).ok());
        let replies = damiao::PROFILES.iter().filter_map(|profile| match profile.decode(&payload) {
            Ok(Reply::Measured { measured, .. }) => Some(measured),
            Ok(Reply::Confirmed { .. }) | Err(_) => None,
        });
        for measured in measured.chain(replies) {
            let values = match measured {
                Measured::Acceleration([x, y, z]) | Measured::AngularVelocity([x, y, z]) => [x, y, z, 0.0],
                Measured::Angles([x, y, z]) => [x, y, z, 0.0],
                Measured::Orientation(value) => value.parts(),
            };
            prop_assert!(values.iter().all(|value| value.is_finite()));
        }
    }

    #[test]
    fn every_code_survives_a_round_trip(codes in prop::array::uniform3(any::<u16>()), register in 1..=3_u8) {
        let [[a, b], [c, d], [e, f]] = codes.map(u16::to_le_bytes);
        for profile in damiao::PROFILES {
            let second = if register == 1 { 25 } else { 0 };
            let payload = [register, second, a, b, c, d, e, f];
            prop_assert_eq!(profile.encode(&profile.decode(&payload).unwrap()), payload);
        }
        let payload = [a, b, c, d, e, f];
        for tpdo in [Tpdo::Acceleration, Tpdo::AngularVelocity, Tpdo::Angles] {
            let frame = can::encode(NODE, &tpdo.decode(&payload).unwrap());
            prop_assert_eq!((frame.id(), frame.payload()), (tpdo.id(NODE), &payload[..]));
        }
    }
}
