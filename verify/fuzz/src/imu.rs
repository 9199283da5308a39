//! The bytes that arrive from inertial measurement units.

use crate::input::Input;
use motord_protocol::imu::hipnuc::{can, serial};
use motord_protocol::imu::xsens::{self, MESSAGE_LEN_MAX};
use motord_protocol::imu::{Parts, Quaternion, Sample, SampleError, damiao};

/// Decodes a stream of HiPNUC's. Every sample is a rotation and finite numbers. An intact sample
/// after any bytes is found with its last byte.
pub fn hipnuc_serial(bytes: &[u8]) {
    let mut decoder = serial::Decoder::new();
    bytes.iter().filter_map(|byte| decoder.push(*byte)).flatten().for_each(|sample| sound(&sample));
    let frame = serial::encode(&awaited());
    let found = frame.iter().filter_map(|byte| decoder.push(*byte)).last();
    assert_eq!(found.and_then(Result::ok).and_then(|sample| sample.status), awaited().status);
}

/// Decodes a stream of Xsens's, as [`hipnuc_serial`] does. Its checksum has only eight bits, so
/// bytes and the beginning of the expected message can form another one. The bytes before the
/// expected message are therefore without 0x36, which every message has.
pub fn xsens(bytes: &[u8]) {
    let mut decoder = xsens::Decoder::new();
    bytes.iter().filter_map(|byte| decoder.push(*byte)).flatten().for_each(|sample| sound(&sample));
    let mut buffer = [0; MESSAGE_LEN_MAX];
    let message = xsens::encode(&awaited(), &mut buffer);
    let noise = bytes.iter().filter(|byte| **byte != 0x36);
    let mut decoder = xsens::Decoder::new();
    let found = noise.chain(message).filter_map(|byte| decoder.push(*byte)).last();
    assert_eq!(found.and_then(Result::ok).and_then(|sample| sample.status), awaited().status);
}

/// Decodes frames on a bus with a HiPNUC IMU, at any time. A sample is whole.
pub fn hipnuc_can(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let (node, parts, mut now) = (input.any(), parts(&mut input), 0_u64);
    let mut decoder = can::Decoder::new(node, parts, 2500);
    while !input.is_empty() {
        now = now.wrapping_add(u64::from(input.any::<u8>()) * input.pick(&[1, 20, 1000, u64::MAX / 300]));
        let known = input.pick(&can::Tpdo::ALL).id(node);
        let id = if input.any::<u8>() < 220 { known } else { input.any() };
        whole(decoder.push(id, input.bytes(9), now), parts);
    }
}

/// Decodes replies of a DM-IMU-L1, at any time. A sample is whole. A reply that is encoded again
/// decodes to the same value.
pub fn damiao_imu(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let (profile, parts, mut now) = (input.pick(damiao::PROFILES), parts(&mut input), 0_u64);
    let mut decoder = damiao::Decoder::new(profile, parts, 2500);
    while !input.is_empty() {
        now = now.wrapping_add(u64::from(input.any::<u8>()) * input.pick(&[1, 20, 1000, u64::MAX / 300]));
        let payload = input.bytes(9);
        whole(decoder.push(payload, now), parts);
        let Ok(reply) = profile.decode(payload) else { continue };
        let again = profile.encode(&reply);
        // Normalised parts of a quaternion can take the neighbouring code.
        if payload[0] != 4 {
            assert_eq!(profile.decode(&again), Ok(reply), "{payload:02X?}");
        }
    }
}

fn parts(input: &mut Input<'_>) -> Parts {
    Parts { acceleration: input.any(), angular_velocity: input.any(), orientation: input.any() }
}

fn whole(received: Result<Option<Sample>, SampleError>, parts: Parts) {
    let Ok(Some(sample)) = received else { return };
    sound(&sample);
    let has =
        [sample.acceleration.is_some(), sample.angular_velocity.is_some(), sample.orientation.is_some()];
    assert_eq!(has, [parts.acceleration, parts.angular_velocity, parts.orientation]);
}

/// Checks that a sample is finite, and its orientation a rotation.
fn sound(sample: &Sample) {
    let vectors = [sample.acceleration, sample.angular_velocity];
    assert!(vectors.into_iter().flatten().flatten().all(f32::is_finite), "{sample:?}");
    assert!(sample.temperature_celsius.is_none_or(f32::is_finite), "{sample:?}");
    if let Some(orientation) = sample.orientation {
        let square: f32 = orientation.parts().iter().map(|part| part * part).sum();
        assert!((square - 1.0).abs() < 1e-5, "{sample:?}");
    }
}

fn awaited() -> Sample {
    Sample {
        orientation: Some(Quaternion { w: 1.0, x: 0.0, y: 0.0, z: 0.0 }),
        acceleration: Some([0.0, 0.0, 9.8]),
        status: Some(0x1234),
        ..Sample::default()
    }
}
