//! Golden frames of IMUs, worked out by hand from the vendors' manuals, or printed in them. The sum
//! of each value stands beside its bytes. `docs/imu-protocols.md` names the independent decoders
//! that read the same frames.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

use motord_protocol::imu::damiao::{self, Register, Reply, Setting};
use motord_protocol::imu::hipnuc::can::{self, Tpdo};
use motord_protocol::imu::hipnuc::{command, serial};
use motord_protocol::imu::{DeviceTime, Measured, Quaternion, Sample, SampleError, SerialProtocol, xsens};
use std::f32::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn close<const N: usize>(values: [f32; N], expected: [f32; N]) {
    for (value, expected) in values.into_iter().zip(expected) {
        let tolerance = 1e-5 * expected.abs().max(1.0);
        assert!((value - expected).abs() <= tolerance, "{values:?}, expected {expected}");
    }
}

fn degrees<const N: usize>(values: [f32; N]) -> [f32; N] {
    values.map(|value| value * PI / 180.0)
}

/// The events of a stream of HiPNUC's.
fn hipnuc(stream: &[u8]) -> Vec<Result<Sample, SampleError>> {
    let mut decoder = serial::Decoder::new();
    stream.iter().filter_map(|byte| decoder.push(*byte)).collect()
}

/// The events of a stream of Xsens's.
fn xsens(stream: &[u8]) -> Vec<Result<Sample, SampleError>> {
    let mut decoder = xsens::Decoder::new();
    stream.iter().filter_map(|byte| decoder.push(*byte)).collect()
}

fn only(events: Vec<Result<Sample, SampleError>>) -> Sample {
    assert_eq!(events.len(), 1, "{events:?}");
    events[0].unwrap()
}

/// Checks that the acceleration points up in the world, as specific force does at rest.
fn points_up(sample: &Sample, tolerance: f32) {
    let up = sample.orientation.unwrap().rotate(sample.acceleration.unwrap());
    assert!(up[2] > 9.0 && up[0].abs() < tolerance && up[1].abs() < tolerance, "{up:?}");
}

/// User manual, "0x91 packet": the CRC is 0x516C, and the values stand below the frame.
const MANUAL_0X91: &str = "5A A5 4C 00 6C 51 91 00 A0 3B 01 A8 02 97 BD BB 04 00 9C A0 65 3E A2 26 45 3F 5C E7 30 3F \
    E2 D4 5A C2 E5 9D A0 C1 EB 23 EE C2 78 77 99 41 AB AA D1 C1 AB 2A 0A C2 8D E1 42 42 8F 1D A8 C1 1E 0C 36 C2 \
    E6 E5 5A 3F C1 94 9E 3E B8 C0 9E BE BE DF 8D BE";

#[test]
fn hipnuc_frame_of_manual_has_printed_values() {
    let sample = only(hipnuc(&hex(MANUAL_0X91)));
    // acc(G) 0.2242 0.7701 0.6910; 1 G is 9.8 m/s².
    let acceleration = sample.acceleration.unwrap().map(|value| (value / 9.8 * 1e4).round() / 1e4);
    close(acceleration, [0.2242, 0.7701, 0.6910]);
    // gyr(deg/s) -54.708 -20.077 -119.070.
    let velocity = sample.angular_velocity.unwrap().map(|value| (value * 180.0 / PI * 1e3).round() / 1e3);
    close(velocity, [-54.708, -20.077, -119.070]);
    // quat 0.855 0.310 -0.310 -0.277.
    let orientation = sample.orientation.unwrap().parts().map(|value| (value * 1e3).round() / 1e3);
    close(orientation, [0.855, 0.310, -0.310, -0.277]);
    // timestamp(ms) 310205. The temperature, byte 9, is 0x3B.
    assert_eq!(sample.time, Some(DeviceTime { ticks: 310_205, per_second: 1000 }));
    assert_eq!(sample.temperature_celsius, Some(59.0));
    // The hand held device is accelerated, so only the direction is that of rest.
    points_up(&sample, 3.0);
}

/// The packet of the manual's frame, with other packets beside it, as the vendor's `parse_data`
/// reads them. The checksums are those of `binascii.crc_hqx` of Python, which also gives the
/// manual's 0x516C.
#[test]
fn hipnuc_packet_beside_others_has_printed_values() {
    let expected = only(hipnuc(&hex(MANUAL_0X91)));
    let packet = &hex(MANUAL_0X91)[6..];
    let ins = [&[0x81][..], &[0; 103]].concat();
    let frame = |header: &str, packets: &[&[u8]]| [&hex(header)[..], &packets.concat()].concat();
    for stream in [
        frame("5A A5 B4 00 AF 6F", &[&ins, packet]),
        frame("5A A5 B4 00 9D 45", &[packet, &ins]),
        frame("5A A5 4E 00 C6 46", &[packet, &[0x90, 0x07]]),
    ] {
        assert_eq!(only(hipnuc(&stream)), expected);
        // Behind noise, a header without its frame, and half a frame.
        let late = [&[0x5A, 0xA5, 0x05][..], &stream[..40], &[0; 512], &stream].concat();
        assert_eq!(hipnuc(&late).into_iter().flatten().collect::<Vec<_>>(), [expected]);
    }
    for (stream, received) in [
        (frame("5A A5 04 00 C4 C7", &[&[0x83, 1, 2, 3]]), 0x83),
        (frame("5A A5 68 00 9D 3F", &[&ins]), 0x81),
        (frame("5A A5 B3 00 03 DA", &[&ins, &packet[..75]]), 0x91),
    ] {
        assert_eq!(hipnuc(&stream), [Err(SampleError::OtherPacket { received })]);
        let mut damaged = stream;
        *damaged.last_mut().unwrap() ^= 1;
        assert_eq!(hipnuc(&damaged), [], "it looks like bytes between frames");
    }
}

#[test]
fn hipnuc_frame_by_hand_has_its_values() {
    let frame = hex("5A A5 4C 00 36 67 \
        91 08 02 \
        E7 00 00 00 00 E8 03 00 00 \
        00 00 00 00 00 00 00 00 00 00 80 3F \
        00 00 B4 42 00 00 00 00 00 00 34 C3 \
        00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 B4 42 \
        00 00 00 3F 00 00 00 3F 00 00 00 3F 00 00 00 3F");
    // -25 °C is 0xE7, but the CRC 0x6736 is that of +25 °C, 0x19.
    let events = hipnuc(&frame);
    assert_eq!(events, [Err(SampleError::Checksum { expected: 0x3FED, received: 0x6736 })]);
    let mut frame = frame;
    frame[9] = 0x19;
    let sample = only(hipnuc(&frame));
    assert_eq!(sample.status, Some(0x0208));
    assert_eq!(sample.temperature_celsius, Some(25.0));
    assert_eq!(sample.time, Some(DeviceTime { ticks: 1000, per_second: 1000 }));
    // 0x3F800000 is 1 G; 0x42B40000 is 90 °/s, 0xC3340000 is -180 °/s; 0x3F000000 is 0.5.
    close(sample.acceleration.unwrap(), [0.0, 0.0, 9.8]);
    close(sample.angular_velocity.unwrap(), [FRAC_PI_2, 0.0, -PI]);
    assert_eq!(sample.orientation.unwrap().parts(), [0.5; 4]);
    // Yaw, byte 62, is 90°, and is not encoded: its CRC differs.
    let again = serial::encode(&sample);
    assert_eq!((&again[6..62], &again[66..]), (&frame[6..62], &frame[66..]));
}

#[test]
fn hipnuc_tpdos_of_manual_have_printed_values() {
    let decode = |tpdo: Tpdo, payload: &str| tpdo.decode(&hex(payload)).unwrap();
    // 0x004A is 74 mG, 0x001F is 31, 0x03C8 is 968; 1 mG is 0.0098 m/s².
    let acceleration = decode(Tpdo::Acceleration, "4A 00 1F 00 C8 03");
    let Measured::Acceleration(value) = acceleration else { panic!("{acceleration:?}") };
    close(value, [0.7252, 0.3038, 9.4864]);
    // 0x0015 is 2.1 °/s, 0x0114 is 27.6, 0x0034 is 5.2.
    let velocity = decode(Tpdo::AngularVelocity, "15 00 14 01 34 00");
    let Measured::AngularVelocity(value) = velocity else { panic!("{velocity:?}") };
    close(value, degrees([2.1, 27.6, 5.2]));
    // 0x2710 is 10000: 100°; 0xD8F0 is -10000.
    let angles = decode(Tpdo::Angles, "10 27 F0 D8 00 00");
    let Measured::Angles(value) = angles else { panic!("{angles:?}") };
    close(value, degrees([100.0, -100.0, 0.0]));
    // 0x1388 is 5000: 0.5; 0xEC78 is -5000.
    let orientation = decode(Tpdo::Orientation, "88 13 88 13 78 EC 88 13");
    assert_eq!(orientation, Measured::Orientation(Quaternion::from([0.5, 0.5, -0.5, 0.5])));
    for (measured, id, payload) in [
        (acceleration, 0x188, "4A 00 1F 00 C8 03"),
        (velocity, 0x288, "15 00 14 01 34 00"),
        (angles, 0x388, "10 27 F0 D8 00 00"),
        (orientation, 0x488, "88 13 88 13 78 EC 88 13"),
    ] {
        let frame = can::encode(can::NODE_DEFAULT, &measured);
        assert_eq!((frame.id(), frame.payload()), (id, &hex(payload)[..]));
    }
    // 0x2710 0 0 0 is the manual's example of no rotation; 20000 is the norm 2.
    assert!(
        decode(Tpdo::Orientation, "10 27 00 00 00 00 00 00")
            == Measured::Orientation([1.0, 0.0, 0.0, 0.0].into())
    );
    let twice = Tpdo::Orientation.decode(&hex("20 4E 00 00 00 00 00 00"));
    assert!(matches!(twice, Err(SampleError::NotUnit { received }) if (received - 2.0).abs() < 1e-6));
    for received in [5, 7, 8] {
        let other = SampleError::Length { least: 6, most: 6, received };
        assert_eq!(Tpdo::Acceleration.decode(&[0; 8][..received]), Err(other));
    }
}

#[test]
fn hipnuc_commands_are_those_of_manual() {
    let bytes = |request: motord_protocol::imu::CanRequest| (request.id(), request.payload().to_vec());
    assert_eq!(bytes(command::start(8)), (0, hex("01 08")));
    assert_eq!(bytes(command::stop(8)), (0, hex("02 08")));
    for (request, payload) in [
        (command::set_bit_rate(8, 125_000), "23 00 21 00 48 E8 01 00"),
        (command::set_bit_rate(8, 1_000_000), "23 00 21 00 40 42 0F 00"),
        (command::set_node(8, 9), "23 01 21 00 09 00 00 00"),
        (command::period(8, Tpdo::Acceleration, 0), "2B 00 18 05 00 00 00 00"),
        (command::period(8, Tpdo::AngularVelocity, 5), "2B 01 18 05 05 00 00 00"),
        (command::period(8, Tpdo::Angles, 50), "2B 02 18 05 32 00 00 00"),
        (command::period(8, Tpdo::Orientation, 100), "2B 03 18 05 64 00 00 00"),
    ] {
        assert_eq!(bytes(request.unwrap()), (0x608, hex(payload)));
    }
    let refused = [command::set_bit_rate(8, 800_000), command::set_node(8, 0), command::set_node(8, 65)];
    assert_eq!(refused, [None; 3]);
    assert_eq!([4, 101].map(|period| command::period(8, Tpdo::Angles, period)), [None; 2]);
    assert_eq!(command::serial_rate(50), Some("LOG HI91 ONTIME 0.02\r\n"));
    assert_eq!(command::serial_rate(500), Some("LOG HI91 ONTIME 0.002\r\n"));
    assert_eq!(command::serial_rate_at(100), Some("AT+ODR=100\r\n"));
    assert_eq!(
        (command::serial_rate(400), command::serial_rate_at(500), command::serial_rate(3)),
        (None, None, None)
    );
    assert_eq!(command::serial_baud(921_600), Some("SERIALCONFIG 921600\r\n"));
    assert_eq!(command::serial_baud(9600), None);
}

#[test]
fn damiao_replies_by_hand_have_their_values() {
    let measured = |profile: &damiao::Profile, payload: &str| {
        let reply = profile.decode(&hex(payload)).unwrap();
        assert_eq!(profile.encode(&reply)[..], hex(payload), "{reply:?}");
        let Reply::Measured { measured, temperature_celsius } = reply else { panic!("{reply:?}") };
        (measured, temperature_celsius)
    };
    // 0x8000 is 32768 x 470.4 / 65535 - 235.2 = 0.00359; 0x8555 is 34133 x 470.4 / 65535 - 235.2 =
    // 9.80135.
    let (acceleration, temperature) = measured(&damiao::FIRMWARE_1024, "01 28 00 80 00 00 55 85");
    let Measured::Acceleration(value) = acceleration else { panic!("{acceleration:?}") };
    close(value, [0.003_589, -235.2, 9.801_346]);
    assert_eq!(temperature, Some(40));
    // The same codes are a quarter of it before firmware 1023: 58.8 is 235.2 / 4. 0xF6 is -10.
    let (acceleration, temperature) = measured(&damiao::FIRMWARE_1022, "01 F6 00 80 00 00 55 85");
    let Measured::Acceleration(value) = acceleration else { panic!("{acceleration:?}") };
    close(value, [0.000_897, -58.8, 2.450_336]);
    assert_eq!(temperature, Some(-10));
    // 0xFFFF is 34.88, 0 is -34.88, 0x8000 is half a code: 34.88 / 65535 = 0.000532.
    let (velocity, _) = measured(&damiao::FIRMWARE_1024, "02 00 FF FF 00 00 00 80");
    assert_eq!(velocity, Measured::AngularVelocity([34.88, -34.88, (34.88_f64 / 65_535.0) as f32]));
    // In the order pitch, yaw, roll: 90°, -180°, and 0x8000 is 180 / 65535 = 0.00275°.
    let (angles, _) = measured(&damiao::FIRMWARE_1024, "03 00 FF FF 00 00 00 80");
    let Measured::Angles(value) = angles else { panic!("{angles:?}") };
    close(value, degrees([0.002_747, 90.0, -180.0]));
    // 0x3FFF is 1, 0x1FFF is 8191 x 2 / 16383 - 1 = -0.000061: 11111111 111111|01 11111111
    // 1111|0111 ...
    let (orientation, _) = measured(&damiao::FIRMWARE_1024, "04 FF FD FF F7 FF DF FF");
    let Measured::Orientation(value) = orientation else { panic!("{orientation:?}") };
    close(value.parts(), [1.0, -0.000_061, -0.000_061, -0.000_061]);
    // 0x2FFF is 12287 x 2 / 16383 - 1 = 0.499969: 10111111 111111|10 11111111 1111|1011 ...
    let (orientation, _) = measured(&damiao::FIRMWARE_1024, "04 BF FE FF FB FF EF FF");
    let Measured::Orientation(value) = orientation else { panic!("{orientation:?}") };
    close(value.parts(), [0.5; 4]);
}

#[test]
fn damiao_refuses_other_payloads() {
    let decode = |payload: &str| damiao::FIRMWARE_1024.decode(&hex(payload));
    let length = SampleError::Length { least: 8, most: 8, received: 7 };
    assert_eq!(decode("01 00 00 00 00 00 00"), Err(length));
    assert_eq!(decode("05 00 00 00 00 00 00 00"), Err(SampleError::UnknownRegister { received: 5 }));
    // Four times 1 has the norm 2.
    let twice = decode("04 FF FF FF FF FF FF FF");
    assert!(matches!(twice, Err(SampleError::NotUnit { received }) if (received - 2.0).abs() < 1e-6));
    assert_eq!(decode("CC 0D 01 00 00 00 00 00"), Ok(Reply::Confirmed { register: 0x0D, code: 0 }));
}

#[test]
fn damiao_requests_are_those_of_manual_and_sample() {
    let bytes = |request: motord_protocol::imu::CanRequest| (request.id(), request.payload().to_vec());
    let ask = |profile: &damiao::Profile| bytes(profile.request(0x01, Register::Orientation));
    assert_eq!(ask(&damiao::FIRMWARE_1022), (0x6FF, hex("01 00 04 CC")));
    assert_eq!(ask(&damiao::FIRMWARE_1023), (0x001, hex("01 00 04 CC")));
    assert_eq!(ask(&damiao::FIRMWARE_1024), (0x001, hex("CC 04 00 DD 00 00 00 00")));
    for (setting, payload) in [
        (Setting::PeriodMs(2), "CC 0A 01 DD 02 00 00 00"),
        (Setting::IsActive(true), "CC 0B 01 DD 01 00 00 00"),
        (Setting::CanId(2), "CC 0D 01 DD 02 00 00 00"),
        (Setting::MasterId(0x12), "CC 0E 01 DD 12 00 00 00"),
        (Setting::Save, "CC FE 01 DD 00 00 00 00"),
        (Setting::Restart, "CC 00 01 DD 00 00 00 00"),
    ] {
        assert_eq!(bytes(setting.request(0x01)), (0x001, hex(payload)));
    }
    assert_eq!(damiao::Profile::by_name("damiao-1022"), Some(&damiao::FIRMWARE_1022));
    assert_eq!(damiao::Profile::by_name("damiao"), None);
}

#[test]
fn xsens_precisions_by_hand_have_their_values() {
    // 12.20: 1 is 0x00100000, -9.5 is -9961472 = 0xFF680000, 9.75 is 0x009C0000. The sum of the
    // bytes from 0xFF on is 0x418: 0xE8 completes it to 0x500.
    let fixed = only(xsens(&hex("FA FF 36 22 \
        20 11 10 00 10 00 00 00 00 00 00 00 00 00 00 00 00 00 00 \
        40 21 0C 00 00 00 00 FF 68 00 00 00 9C 00 00 E8")));
    assert_eq!(fixed.orientation.unwrap().parts(), [1.0, 0.0, 0.0, 0.0]);
    assert_eq!(fixed.acceleration, Some([0.0, -9.5, 9.75]));
    // 16.32, fraction first: 1.5 is 0x80000000 and 0x0001, -0.25 is -1 + 0.75: 0xC0000000 and
    // 0xFFFF. The sum is 0x53D.
    let fixed =
        only(xsens(&hex("FA FF 36 15 80 22 12 80 00 00 00 00 01 C0 00 00 00 FF FF 00 00 00 00 00 00 C3")));
    assert_eq!((fixed.angular_velocity, fixed.orientation), (Some([1.5, -0.25, 0.0]), None));
    // f64: 0.5 is 0x3FE0000000000000. The sum is 0x627.
    let double = only(xsens(&hex("FA FF 36 23 20 13 20 3F E0 00 00 00 00 00 00 3F E0 00 00 00 00 00 00 \
        3F E0 00 00 00 00 00 00 3F E0 00 00 00 00 00 00 D9")));
    assert_eq!(double.orientation.unwrap().parts(), [0.5; 4]);
}

#[test]
fn xsens_coordinate_systems_are_converted_to_enu() {
    let decode = |format: &str, quaternion: &str, sum: &str| {
        xsens(&hex(&format!("FA FF 36 13 20 {format} 10 {quaternion} {sum}")))
    };
    let (one, zero) = ("3F 80 00 00", "00 00 00 00");
    let quarter = [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2];
    // NED: half a turn about x: the sensor's x points north, its z up. The sum is 0x24B.
    let ned = only(decode("14", &format!("{zero} {one} {zero} {zero}"), "B5")).orientation.unwrap();
    close(ned.parts().map(|part| -part), quarter);
    close(ned.rotate([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]);
    close(ned.rotate([0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]);
    // NWU: no rotation: the same attitude. The sum is 0x24F.
    let nwu = only(decode("18", &format!("{one} {zero} {zero} {zero}"), "B1")).orientation.unwrap();
    close(nwu.parts(), quarter);
    close(nwu.rotate([0.0, 1.0, 0.0]), [-1.0, 0.0, 0.0]);
    // 3 is none. The sum is 0x253.
    let events = decode("1C", &format!("{one} {zero} {zero} {zero}"), "AD");
    assert_eq!(events, [Err(SampleError::CoordinateSystem { received: 3 })]);
}

/// Recorded from an MTi-300 by the vendor's MT Manager, which also decoded it: from the tests of
/// the library Scottapotamas/xsens-mti, with its checksum.
const RECORDED: &str = "FA FF 36 92 10 20 02 91 8D 10 60 04 01 36 3F A6 \
        20 10 10 3F 35 E0 42 3F 31 CD 15 BD 9F 49 DB BD A9 38 CF 40 20 0C BD 63 5A 90 41 1D 08 D4 3E 5F AA 50 \
        40 10 0C B9 11 68 00 3C C9 01 00 3A 0F 7D 00 40 30 0C BC 3B 29 80 3C 35 FC 00 3C A4 6E 00 \
        80 20 0C 3C AE A2 41 BB 56 D8 00 BA D5 AC 01 80 30 10 3F 80 00 00 37 DF 88 01 B6 89 80 00 B6 08 C0 00 \
        C0 20 0C BE FB FB F2 3F 33 C4 85 BF A0 A2 C1 08 10 04 42 16 80 00 30 10 04 00 01 86 E1 \
        E0 20 04 00 40 00 03 DD";

/// The same items, and 108 bytes of an item that is not decoded: 257 bytes of data, so the length
/// is FF 01 01. The sum of the bytes from 0xFF on is 0x353E.
#[test]
fn xsens_message_of_extended_length_has_its_values() {
    let recorded = hex(RECORDED);
    let items = &recorded[4..recorded.len() - 1];
    let long = [&hex("FA FF 36 FF 01 01")[..], items, &hex("20 20 6C"), &[0; 0x6C], &[0xC2]].concat();
    let expected = only(xsens(&recorded));
    assert_eq!(only(xsens(&long)), expected);
    let stream = [&[0xFA, 0xFF, 0x36, 0xFF][..], &long[..100], &long, &long].concat();
    assert!(xsens(&stream).into_iter().flatten().all(|sample| sample == expected));
    let mut damaged = long;
    damaged[50] ^= 1;
    assert_eq!(xsens(&damaged), []);
}

/// The recorded message from the first device behind an Xbus master: the sum is smaller by 0xFE.
#[test]
fn xsens_message_of_other_bus_id_is_named() {
    let mut other = hex(RECORDED);
    (other[1], *other.last_mut().unwrap()) = (0x01, 0xDB);
    assert_eq!(xsens(&other), [Err(SampleError::BusId { received: 1 })]);
    let both = [other, hex(RECORDED)].concat();
    assert_eq!(xsens(&both).len(), 2, "the next message of the device at the port is decoded");
}

/// See [`RECORDED`].
#[test]
fn xsens_recordings_have_values_of_mt_manager() {
    let sample = only(xsens(&hex(RECORDED)));
    assert_eq!(sample.counter, Some(37_261));
    assert_eq!(sample.time, Some(DeviceTime { ticks: 20_332_454, per_second: 10_000 }));
    close(sample.orientation.unwrap().parts(), [0.710_453, 0.694_536, -0.077_778, -0.082_628]);
    close(sample.acceleration.unwrap(), [-0.055_506, 9.814_655, 0.218_423]);
    close(sample.angular_velocity.unwrap(), [0.021_318, -0.003_278, -0.001_630]);
    assert_eq!((sample.temperature_celsius, sample.status), (Some(37.625), Some(0x0040_0003)));
    points_up(&sample, 0.1);
    // Single precision, and a temperature in 16.32: 24.375 is 0x60000000 and 0x0018.
    let sample = only(xsens(&hex("FA FF 36 37 10 20 02 FE 78 \
        20 10 10 3F 25 0C 01 BB CC 0D D7 BB 22 74 0C 3F 43 AF 57 C0 21 0C 00 0F 64 22 FF FB D6 22 00 1C 80 03 \
        08 12 06 60 00 00 00 00 18 30 13 04 00 01 8D 25 46")));
    assert_eq!((sample.counter, sample.acceleration), (Some(65_144), None));
    close(sample.orientation.unwrap().parts(), [0.644_714, -0.006_227, -0.002_479, 0.764_394]);
    assert_eq!(sample.temperature_celsius, Some(24.375));
}

#[test]
fn xsens_items_of_wrong_size_are_refused() {
    // Acceleration with 8 bytes: FF+36+0B+40+20+08 = 0x1A8.
    let events = xsens(&hex("FA FF 36 0B 40 20 08 00 00 00 00 00 00 00 00 58"));
    assert_eq!(events, [Err(SampleError::ItemSize { item: 0x4020, expected: 12, received: 8 })]);
    // An item that ends after the message: FF+36+04+40+20+0C = 0x1A5.
    let events = xsens(&hex("FA FF 36 04 40 20 0C 00 5B"));
    assert_eq!(events, [Err(SampleError::Truncated { expected: 12, received: 1 })]);
    // Half an identifier: FF+36+01+40 = 0x176.
    let events = xsens(&hex("FA FF 36 01 40 8A"));
    assert_eq!(events, [Err(SampleError::Truncated { expected: 3, received: 1 })]);
    // 0x7FC00000 is NaN: FF+36+0F+40+20+0C+7F+C0 = 0x2EF.
    let events = xsens(&hex("FA FF 36 0F 40 20 0C 7F C0 00 00 00 00 00 00 00 00 00 00 11"));
    assert!(matches!(events[..], [Err(SampleError::NotFinite { received: 0x7FC0_0000, .. })]), "{events:?}");
    // A message without a measurement, and an empty one: FF+36+05+10+20+02+01 = 0x16D.
    assert_eq!(xsens(&hex("FA FF 36 05 10 20 02 01 00 93 FA FF 36 00 CB")), []);
}

#[test]
fn xsens_commands_are_those_of_manual() {
    let sum = |message: &[u8]| message[1..].iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
    assert_eq!(sum(&xsens::command::GO_TO_CONFIG), 0);
    assert_eq!(sum(&xsens::command::GO_TO_MEASUREMENT), 0);
    // The sum of the bytes from 0xFF on is 0xBEA.
    let outputs = hex(
        "FA FF C0 1C 10 20 FF FF 10 60 FF FF 20 10 00 64 40 20 00 64 80 20 00 64 08 10 00 01 E0 20 FF FF 16",
    );
    assert_eq!(xsens::command::outputs(100).unwrap()[..], outputs);
    assert_eq!([0, 401].map(xsens::command::outputs), [None; 2]);
}

/// Reset, and 921600 baud, whose code is 0x0A: FF+18+01+0A = 0x122.
#[test]
fn xsens_baud_rate_has_vendors_code() {
    use xsens::command::{Answer, Answers, RESET, set_baud};
    assert_eq!(RESET, [0xFA, 0xFF, 0x40, 0x00, 0xC1]);
    assert_eq!(set_baud(921_600).unwrap()[..], hex("FA FF 18 01 0A DE"));
    assert_eq!(set_baud(921_601), None);
    assert!(SerialProtocol::Xsens.bauds().iter().all(|baud| set_baud(*baud).is_some()));
    let answered = |stream: &str| {
        let mut answers = Answers::to(&xsens::command::GO_TO_CONFIG);
        hex(stream).into_iter().find_map(|byte| answers.push(byte))
    };
    // Behind half a sample; damaged; the answer to another message; an error 0x04: FF+42+01+04 =
    // 0x146.
    assert_eq!(answered("FA FF 36 36 10 FA FF 31 00 D0"), Some(Answer::Done));
    assert_eq!(answered("FA FF 31 00 D1"), None);
    assert_eq!(answered("FA FF 11 00 F0"), None);
    assert_eq!(answered("FA FF 42 01 04 BA"), Some(Answer::Refused(4)));
}

/// CANopen (CiA 301): the answer to a download, an upload of two bytes, and a refusal.
#[test]
fn hipnuc_sdo_answers_are_those_of_canopen() {
    use command::{Answer, answer, read_back};
    let request = command::period(8, Tpdo::AngularVelocity, 5).unwrap();
    assert_eq!(read_back(&request).payload(), hex("40 01 18 05 00 00 00 00"));
    let of = |id, bytes: &str| answer(&request, id, &hex(bytes));
    assert_eq!(of(0x588, "60 01 18 05 00 00 00 00"), Some(Answer::Written));
    assert_eq!(of(0x588, "4B 01 18 05 05 00 FF FF"), Some(Answer::Value(5)));
    assert_eq!(of(0x588, "80 01 18 05 30 00 09 06"), Some(Answer::Refused(0x0609_0030)));
    for (id, other) in [
        (0x589, "60 01 18 05 00 00 00 00"),
        (0x588, "60 00 18 05 00 00 00 00"),
        (0x588, "60 01 18 05 00 00 00"),
        (0x588, "61 01 18 05 00 00 00 00"),
    ] {
        assert_eq!(of(id, other), None, "{other}");
    }
}

#[test]
fn errors_name_expected_and_received_values() {
    let text = |error: SampleError| error.to_string();
    assert_eq!(
        text(SampleError::Checksum { expected: 0x516C, received: 0x1234 }),
        "the checksum is 0x1234, expected 0x516C: check baud rate and cable"
    );
    assert_eq!(
        text(SampleError::NotUnit { received: 2.0 }),
        "the norm of the quaternion is 2, expected 0.99 to 1.01"
    );
    assert_eq!(
        text(SampleError::ItemSize { item: 0x4020, expected: 12, received: 8 }),
        "item 0x4020 has 8 bytes, expected 12"
    );
}
