//! Properties that hold for every value and every byte, tested by random inputs.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::Profile;
use motord_protocol::gim::{self, ExecutionTime, Finite, Pending};
use motord_protocol::mit::{self, Asked, CommandCodes, ControlCodes, Impedance};
use motord_protocol::{Field, Scales};
use proptest::prelude::*;

fn scales() -> Scales {
    Scales::by_current(0.125_f32, 8.0_f32).unwrap()
}

/// Returns any float, often a boundary case: within a range, at its ends, zero, subnormal, very
/// large or not finite.
fn value() -> impl Strategy<Value = f32> {
    let edges = [
        0.0,
        -0.0,
        f32::MIN_POSITIVE,
        1e-40,
        -1e-40,
        12.5,
        -12.5,
        65.0,
        -65.0,
        500.0,
        5.0,
        225.0,
        -225.0,
        f32::MAX,
        f32::MIN,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    prop_oneof![prop::num::f32::ANY, -600.0..600.0_f32, -15.0..15.0_f32, prop::sample::select(edges.to_vec())]
}

prop_compose! {
    fn impedance()(position in value(), velocity in value(), kp in value(), kd in value(), torque in value())
        -> Impedance { Impedance { position, velocity, kp, kd, torque } }
}

prop_compose! {
    fn control_codes()(codes in prop::array::uniform5(prop_oneof![any::<u16>(), Just(0), Just(0x0FFF), Just(0xFFFF)]))
        -> ControlCodes {
        let [position, velocity, kp, kd, torque] = codes;
        ControlCodes { position, velocity, kp, kd, torque }
    }
}

/// Returns any bytes, often a prefix of a frame or a whole one.
fn payload() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![
        any::<u8>(),
        prop::sample::select(vec![0x00, 0x81, 0x83, 0x84, 0x93, 0xB4, 0xB5, 0xFB, 0xFC, 0xFF]),
    ];
    prop::collection::vec(byte, 0..=16)
}

fn is_nearest(field: Field, value: f32, decoded: f32) -> bool {
    let clamped = f64::from(value).clamp(field.min(), field.max());
    (f64::from(decoded) - clamped).abs() <= field.step() * 0.5 + (field.max() - field.min()) * 1e-6
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn control_frame_means_nearest_values_or_names_nonfinite(asked in impedance()) {
        let values = [asked.position, asked.velocity, asked.kp, asked.kd, asked.torque];
        let Ok(bytes) = mit::Command::Control(asked).encode(&scales()) else {
            prop_assert!(values.iter().any(|value| !value.is_finite()));
            return Ok(());
        };
        prop_assert!(values.iter().all(|value| value.is_finite()));
        let Ok(mit::Command::Control(decoded)) = mit::decode_command(&bytes, &scales()) else {
            return Err(TestCaseError::fail("a special frame"));
        };
        let guarded = bytes[..5] == [0xFF, 0xFF, 0xFF, 0xFF, 0xFE] || bytes == [0, 1, 0, 0, 0, 0, 0, 0];
        prop_assert!(guarded || is_nearest(scales().position, asked.position, decoded.position));
        prop_assert!(is_nearest(scales().velocity, asked.velocity, decoded.velocity));
        prop_assert!(guarded || is_nearest(scales().kp, asked.kp, decoded.kp));
        prop_assert!(is_nearest(scales().kd, asked.kd, decoded.kd));
        prop_assert!(is_nearest(scales().torque, asked.torque, decoded.torque));
    }

    #[test]
    fn no_codes_make_special_frame_or_zeros(codes in control_codes()) {
        let bytes = codes.pack();
        prop_assert_ne!(bytes, [0; 8]);
        prop_assert_ne!(&bytes[..6], &[0xFF; 6][..]);
        prop_assert!(matches!(CommandCodes::decode(&bytes), Ok(CommandCodes::Control(_))));
    }

    #[test]
    fn allowed_control_frame_is_written_back_unchanged(bytes in any::<[u8; 8]>()) {
        if let Ok(CommandCodes::Control(codes)) = CommandCodes::decode(&bytes) {
            prop_assert_eq!(codes.pack(), bytes);
        }
    }

    #[test]
    fn arbitrary_bytes_decode_to_finite_values(bytes in payload()) {
        for (profile, asked) in Profile::all().flat_map(|profile| {
            [Asked::State, Asked::Fault, Asked::Clear].map(|asked| (profile, asked))
        }) {
            if let Ok(mit::Reply::State(state)) = profile.decode(&bytes, asked, &scales()) {
                prop_assert!(state.position.abs() <= 12.5 && state.velocity.abs() <= 65.0);
                prop_assert!(state.torque.abs() <= scales().full_scale());
                prop_assert!(state.hottest().is_none_or(f32::is_finite));
            }
        }
        for pending in [Pending::Calibration, Pending::Other] {
            if let Ok(gim::Reply::State { outcome: Ok(state), .. }) = gim::decode_reply(&bytes, pending, &scales()) {
                prop_assert!(state.position.abs() <= 12.5 && state.velocity.abs() <= 65.0);
                prop_assert!(state.torque.abs() <= scales().full_scale());
            }
        }
        let _ = mit::decode_command(&bytes, &scales());
    }

    #[test]
    fn understood_gim_frame_is_written_back_unchanged(bytes in payload()) {
        let Ok(filler) = <[u8; 8]>::try_from(&bytes[..]) else { return Ok(()) };
        if let Ok(command) = gim::decode_command(&bytes) {
            prop_assert_eq!(command.encode_over(filler), filler);
            prop_assert_eq!(gim::decode_command(&command.encode()), Ok(command));
        }
        for pending in [Pending::Calibration, Pending::Other] {
            if let Ok(reply) = gim::decode_reply(&bytes, pending, &scales()) {
                prop_assert_eq!(reply.encode_over(filler), filler);
                prop_assert_eq!(gim::decode_reply(&reply.encode_over([0; 8]), pending, &scales()), Ok(reply));
            }
        }
    }

    #[test]
    fn a_gim_target_and_its_duration_arrive_exactly(target in value(), millis in any::<u32>()) {
        let (target, duration) = match (Finite::new(target), ExecutionTime::from_millis(millis)) {
            (Some(target), Some(duration)) => (target, duration),
            (finite, duration) => {
                prop_assert!(finite.is_some() == target.is_finite());
                prop_assert!(duration.is_some() == (millis < 1 << 24));
                return Ok(());
            }
        };
        for command in [
            gim::Command::TorqueControl { torque: target, duration },
            gim::Command::SpeedControl { speed_rpm: target, duration },
            gim::Command::PositionControl { position: target, duration },
        ] {
            prop_assert_eq!(gim::decode_command(&command.encode()), Ok(command));
        }
    }
}
