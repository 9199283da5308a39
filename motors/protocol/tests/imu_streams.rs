//! Properties of the decoders of IMU streams, tested by random samples, noise and damage.
//!
//! The checksum of Xsens has eight bits: one of 256 beginnings in noise, whose items end where they
//! must, passes for a message.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::imu::hipnuc::serial;
use motord_protocol::imu::xsens::{self, MESSAGE_LEN_MAX};
use motord_protocol::imu::{DeviceTime, Quaternion, Sample, SampleError};
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
