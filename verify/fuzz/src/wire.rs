//! The bytes that arrive from motors: payloads, frames on a bus, the stream of a serial line.

use crate::input::Input;
use crate::robot::{self, Robot};
use motord_bus::frame::{Content, ErrorFrame, Frame, FrameId, Unsupported};
use motord_bus::serial::framing::{Decoder, FRAME_LEN_MAX, SerialFrame};
use motord_bus::{Duration, Instant};
use motord_core::drive::{Drive, Received};
use motord_protocol::Profile;
use motord_protocol::drive::{Command, Impedance, Reported, Setpoint};
use motord_protocol::gim::{self, Pending};
use motord_protocol::mit::{self, Asked, CommandCodes, ControlCodes};
use motord_protocol::profile::shipped;
use motord_protocol::{Scales, StateCodes};

/// Decodes the replies of every protocol. A decoded state is a number within the ranges of its
/// codes. A reply that is encoded again decodes to the same value.
pub fn replies(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let (profile, model) = (input.pick(&shipped()).0, input.any::<u8>());
    let model = &profile.models[usize::from(model) % profile.models.len()];
    let scales = model.scales().expect("a model in the table has scales");
    let (asked, id) = (input.pick(&[Asked::State, Asked::Fault, Asked::Clear]), input.any());
    // Longer than any frame, because the decoders take slices.
    let payload = input.bytes(12);
    mit_reply(profile, &scales, asked, id, payload);
    native_reply(&scales, payload);
}

fn mit_reply(profile: &Profile, scales: &Scales, asked: Asked, id: u8, payload: &[u8]) {
    let _sorted =
        (profile.is_from(id, payload), profile.is_fault_report(payload), profile.fits_state(payload));
    if let Ok(state) = profile.decode_state(payload, scales) {
        within(state.codes, scales);
        let _status = (profile.faults_of(&state), profile.is_on(&state), state.hottest());
    }
    if let Ok(reply) = profile.decode(payload, asked, scales) {
        let (again, len) = profile.encode_over(&reply, [0; 8]);
        let again = profile.decode(&again[..len], asked, scales).expect("what is encoded is a reply");
        assert_eq!(format!("{reply:?}"), format!("{again:?}"), "{payload:02X?}");
    }
}

fn native_reply(scales: &Scales, payload: &[u8]) {
    for pending in [Pending::Calibration, Pending::Other] {
        let Ok(reply) = gim::decode_reply(payload, pending, scales) else { continue };
        if let gim::Reply::State { outcome: Ok(state), .. } = reply {
            within(state.codes, scales);
        }
        let again = gim::decode_reply(&reply.encode_over([0; 8]), pending, scales);
        assert_eq!(again.map(|again| again.encode_over([0; 8])), Ok(reply.encode_over([0; 8])));
    }
}

fn within(codes: StateCodes, scales: &Scales) {
    let ends = [&scales.position, &scales.velocity, &scales.torque].map(motord_protocol::Field::max);
    for (value, end) in codes.scaled(scales).into_iter().zip(ends) {
        assert!(f64::from(value.abs()) <= end * (1.0 + 1e-6), "{value} is beyond {end}");
    }
}

/// Decodes the commands of every protocol, as tools and logs do. Every eight bytes are an MIT
/// command. Encoding it again never changes whether it is a special command, nor the meaning of a
/// native one.
pub fn commands(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let scales = input.pick(&shipped()).0.models[0].scales().expect("a model in the table has scales");
    let payload = input.bytes(12);
    let decoded = mit::decode_command(payload, &scales);
    assert_eq!(decoded.is_ok(), payload.len() == 8);
    if let Ok(codes) = CommandCodes::decode(payload) {
        // A control command with the beginning of a special one is encoded as its neighbour.
        let again = codes.encode();
        assert_eq!(CommandCodes::decode(&again).map(CommandCodes::encode), Ok(again), "{codes:?}");
        let is_special = |bytes: &[u8]| !matches!(CommandCodes::decode(bytes), Ok(CommandCodes::Control(_)));
        assert_eq!(is_special(&again), is_special(payload), "{codes:?}");
    }
    if let Ok(mit::Command::Control(wanted)) = decoded {
        let nearest = ControlCodes::nearest(&wanted, &scales).expect("what was decoded is finite");
        assert_eq!(Some(nearest), payload.try_into().ok().map(ControlCodes::unpack));
    }
    if let Ok(command) = gim::decode_command(payload) {
        assert_eq!(gim::decode_command(&command.encode()), Ok(command));
        let _marked = command.encode_mit_safe();
    }
    let _matched = gim::repeats(payload, input.bytes(12));
}

/// Runs one drive of every protocol: requests and payloads in any order and at any time. A reported
/// state is a number, and nothing is a reply before the first request.
pub fn drive(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let settings = robot::mixed();
    let motor = &settings.motors[usize::from(input.any::<u8>()) % settings.motors.len()];
    let mut drive = Drive::new(motor, Duration::from_micros(200), input.any());
    let (mut now, mut asked) = (Instant::from_nanos(1_000_000_000), false);
    while !input.is_empty() {
        // Some steps are longer than the latest reply.
        now = now + Duration::from_micros(u64::from(input.any::<u8>()) * input.pick(&[1, 10, 1000]));
        match input.any::<u8>() % 4 {
            0 | 1 => asked |= drive.request(&command(&mut input), now).is_some(),
            2 => {
                let frame = Frame::new(motor.host_id, input.bytes(8)).expect("at most eight bytes");
                check(drive.receive(&frame, now), asked);
            }
            _ if input.any() => drive.withdraw(),
            _ => check(drive.refuse(), asked),
        }
    }
}

fn check(received: Received, asked: bool) {
    let Received::Reply(reported) = received else { return };
    assert!(asked, "{reported:?} answers no request");
    if let Reported::State(state, ..) = reported {
        let values = [state.position, state.velocity, state.torque];
        assert!(values.iter().all(|value| value.is_finite()), "{values:?}");
    }
}

fn command(input: &mut Input<'_>) -> Command {
    let mut value = || f32::from(input.any::<i16>()) / 256.0;
    let impedance = Impedance::new(value(), value(), value().abs(), value().abs(), value());
    let control = Command::Control(Setpoint::impedance(impedance));
    match input.any::<u8>() % 11 {
        0 => Command::Stop,
        1 => Command::Start,
        2 => Command::Neutral,
        3 => Command::SetZero,
        4 => Command::GetFault,
        5 => Command::GetIndicator(input.any()),
        6 => Command::ClearFault,
        7 => Command::Wait,
        8 => Command::Nothing,
        9 => Command::GetRegister(input.any()),
        _ => control,
    }
}

/// Runs a disabled robot of four vendors' dialects, with any content on its buses. Its motors
/// receive only frames that stop them or request their faults.
pub fn disarmed(bytes: &[u8]) {
    let mut input = Input::new(bytes);
    let mut robot = Robot::new(robot::mixed());
    for _ in 0..CYCLES_MAX {
        if input.is_empty() {
            break;
        }
        for _ in 0..input.any::<u8>() % 6 {
            let bus = usize::from(input.any::<u8>());
            let content = content(&mut input, &robot);
            robot.deliver(bus, content);
        }
        robot.step();
        assert!(robot.take_sent().iter().all(robot::Sent::is_harmless), "a motor of a disarmed robot");
    }
}

/// Most cycles of one run, enough for every case of a motor that takes turns.
const CYCLES_MAX: usize = 24;

/// Returns any content that a bus can report. Usually a frame with the reply id of a motor: others
/// do not reach a decoder.
fn content(input: &mut Input<'_>, robot: &Robot) -> Content {
    let known = robot.reply_id(input.any());
    let id = if input.any::<u8>() < 200 { known } else { id(input.any()) };
    match input.any::<u8>() {
        0..=20 => Content::Error(ErrorFrame { class: input.any(), data: input.any::<u64>().to_le_bytes() }),
        21..=30 => Content::Refused(id),
        31..=40 => {
            use Unsupported::{Extended, Fd, Length, Remote, Unmatched};
            Content::Unsupported(input.pick(&[Extended, Remote, Fd, Length, Unmatched]))
        }
        _ => Content::Frame(Frame::new(id, input.bytes(8)).expect("it has at most eight bytes")),
    }
}

/// Returns any id: one with the upper bit has 29 bits.
fn id(raw: u16) -> FrameId {
    let id = if raw & 0x8000 == 0 { FrameId::new(raw & 0x7FF) } else { FrameId::extended(raw.into()) };
    id.expect("it has eleven bits, or 29")
}

/// Decodes the stream of a serial line. Each byte is either skipped or part of an accepted frame,
/// and none is lost. An expected frame is found after any of it, except after one of its own bytes,
/// which could be its beginning.
pub fn serial(bytes: &[u8]) {
    let Some((&seed, stream)) = bytes.split_first() else { return };
    let accept = |frame: &SerialFrame| frame.receiver() & 3 == seed & 3;
    let mut decoder = Decoder::new();
    let mut taken = 0;
    for byte in stream {
        let Some(frame) = decoder.push(*byte, accept) else { continue };
        let mut buffer = [0; FRAME_LEN_MAX];
        let written = frame.write(&mut buffer);
        assert_eq!(SerialFrame::decode(written), Ok(frame));
        taken += written.len();
    }
    decoder.reset();
    assert_eq!(decoder.skipped() as usize + taken, stream.len());
    let awaited = SerialFrame::normal(seed, [seed; 8]);
    let mut buffer = [0; FRAME_LEN_MAX];
    let mut decoder = Decoder::new();
    let noise = stream.iter().copied().filter(|byte| *byte != seed);
    let found = noise.chain(awaited.write(&mut buffer).iter().copied());
    assert_eq!(found.filter_map(|byte| decoder.push(byte, |frame| *frame == awaited)).last(), Some(awaited));
    let _refused = SerialFrame::decode(stream);
}
