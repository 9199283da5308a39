//! Samples of IMUs that send each quantity in a frame.

use motord_protocol::imu::damiao::{self, Register, Reply};
use motord_protocol::imu::hipnuc::can::{self, Tpdo};
use motord_protocol::imu::{Measured, Parts, Quaternion, Sample, SampleError, SampleField};
use proptest::prelude::*;

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
