//! Reads files of vendors as a user writes them: one that is sound, and spoiled ones, each with the
//! problem that is reported.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a test that cannot set itself up has failed")]

use motord_protocol::profile::{FaultReport, Profile, ReplyId, SpecialFrames, parse};
use motord_protocol::{Ends, Faults};
use proptest::prelude::*;

/// A motor that is not supported, with every kind of key but flags and faults in every reply.
const SOUND: &str = r#"vendor = "acme"
motors = "Acme A series"

[ids]
largest = 0x1F
reply-offset = 0x20
also-receives = [0x100]

[special-frames]
zero = "FF FF FF FF FF FF FF F1"

[reply]
bytes = [7, 8]
id-bits = 0x1F

[[reply.temperature]]
of = "motor"
byte = 6

[faults]
report = "asked"
number-bytes = 2
bytes = [6, 8]
zeros = [0, 0, 0, 0xFE, 0xFF, 0xFF, 0, 0]

[faults.bits]
0 = "over-voltage"
9 = "encoder"

[[model]]
name = "A-10"
position-end-rad = 12.5
velocity-end-rad-s = 45
torque-end-nm = 24
gear-ratio = 9
torque-constant-nm-per-a = 0.1
rated-torque-nm = 8
peak-torque-nm = 20.5
max-velocity-rad-s = 30
"#;

/// The faults of a motor that reports them in every reply.
const IN_EVERY_REPLY: &str = r#"report = "in-every-reply"
byte = 0
shift = 5
off = 0
on = 1
[faults.codes]
2 = "over-voltage"
"#;

/// A part of the sound file, what it becomes, and the problem.
type Spoiled = (&'static str, &'static str, &'static str);

const SPOILED: &[Spoiled] = &[
    // The text, keys and values.
    (
        "largest = 0x1F",
        "largest 0x1F",
        "5:9: key with no value, expected `=`; a key is written as largest = 15",
    ),
    (
        "vendor = \"acme\"",
        "vendor = \"Acme Inc\"",
        "1:10: vendor: \"Acme Inc\" is no name; use 1 to 32 of a-z",
    ),
    ("motors =", "motor =", "2:1: motor: unknown key `motor`; did you mean `motors`?"),
    ("largest = 0x1F", "", "4:1: ids.largest: is missing; give the largest id of a motor, such as 15"),
    (
        "largest = 0x1F",
        "largest = \"31\"",
        "5:11: ids.largest: expected an integer, found \"31\"; write an integer",
    ),
    ("byte = 6", "byte = 8", "18:8: reply.temperature.byte: 8 is out of range; give an integer from 0 to 7"),
    (
        "\"over-voltage\"",
        "\"overvoltage\"",
        "27:5: faults.bits.0: unknown fault `overvoltage`; did you mean `over-voltage`?",
    ),
    ("\"asked\"", "\"ask\"", "21:10: faults.report: unknown value `ask`; did you mean `asked`?"),
    // Ids.
    (
        "reply-offset = 0x20",
        "reply-offset = 0xF0",
        "6:16: ids.reply-offset: a reply with the id 0x101 is a command of 0x100 + id (also-receives)",
    ),
    (
        "reply-offset",
        "largest-reply = 0x3E\nreply-offset",
        "7:16: ids.reply-offset: gives a reply the id 0x3f, beyond largest-reply = 0x3e",
    ),
    (
        "also-receives",
        "shared-reply = 0\nalso-receives",
        "7:16: ids.shared-reply: excludes reply-offset; remove one of them",
    ),
    (
        "[0x100]",
        "[0x7F0]",
        "7:17: ids.also-receives: 0x7f0 gives a command the id 0x80f, and 0x7ff is the largest",
    ),
    // Special frames.
    (
        "FF FF FF FF FF FF FF F1",
        "FF FF FF FF 7F FF FF F1",
        "10:8: special-frames.zero: a control frame can have these bytes; a special frame begins with six bytes FF",
    ),
    (
        "FF FF FF FF FF FF FF F1",
        "FF FF FF FF FF FF FF FC",
        "10:8: special-frames.zero: is the frame of start too; give another",
    ),
    (
        "FF FF FF FF FF FF FF F1",
        "FF FF FF FF FF FF 00 FB",
        "10:8: special-frames.zero: is the question for the faults; give another frame",
    ),
    (
        "FF FF FF FF FF FF FF F1",
        "FF FF F1",
        "10:8: special-frames.zero: `FF FF F1` is no frame; write its eight bytes",
    ),
    // The reply.
    ("bytes = [7, 8]", "bytes = [8, 7]", "13:9: reply.bytes: is reversed: fewest bytes first; write [7, 8]"),
    (
        "id-bits = 0x1F",
        "id-bits = 0x0F",
        "14:11: reply.id-bits: 0xf cannot hold the largest id 0x1f; add bits, or lower ids.largest",
    ),
    (
        "id-bits = 0x1F",
        "id-bits = 0x2F",
        "14:11: reply.id-bits: 0x2f has a gap; give the lowest bits of the byte",
    ),
    (
        "byte = 6",
        "byte = 5",
        "18:8: reply.temperature.byte: the temperature of motor overlaps position, velocity and torque in byte 5 of the reply",
    ),
    (
        "byte = 6",
        "byte = 6\n[[reply.temperature]]\nof = \"driver\"\nbyte = 6",
        "21:8: reply.temperature.byte: the temperature of driver overlaps the temperature of motor in byte 6",
    ),
    (
        "byte = 6",
        "byte = 7\nbits = 16",
        "18:8: reply.temperature.byte: the temperature of motor is in byte 8, counted from 0, and a reply has at most 8 bytes",
    ),
    // Faults.
    (
        "0xFE, 0xFF, 0xFF, 0, 0]",
        "0xFE, 0xFF, 0, 0, 0]",
        "24:9: faults.zeros: a state of a moving motor can have all these bits zero, and would be read as a fault report",
    ),
    (
        "zeros = [0, 0, 0, 0xFE",
        "zeros = [0, 0, 0xFF, 0xFE",
        "28:5: faults.bits.9: this bit is zero in every report, by zeros",
    ),
    ("9 = \"encoder\"", "17 = \"encoder\"", "28:6: faults.bits.17: the number has 2 bytes, without this bit"),
    ("9 = \"encoder\"", "0x0 = \"encoder\"", "28:7: faults.bits.0x0: 0 is there twice; remove one of them"),
    // Models.
    (
        "position-end-rad = 12.5",
        "position-end-rad = -12.5",
        "32:20: model.position-end-rad: -12.5 is out of range: the range would be reversed; give a number above 0",
    ),
    (
        "torque-end-nm = 24",
        "torque-end-nm = 0",
        "34:17: model.torque-end-nm: 0 is out of range: the range would be empty; give a number above 0",
    ),
    (
        "torque-end-nm = 24",
        "torque-end-nm = inf",
        "34:17: model.torque-end-nm: inf is not a finite number; give a number above 0",
    ),
    (
        "torque-end-nm = 24",
        "torque-end-nm = 20",
        "38:18: model.peak-torque-nm: 20.5 N·m is beyond the largest torque code, 20 N·m",
    ),
    (
        "rated-torque-nm = 8",
        "rated-torque-nm = 21",
        "37:19: model.rated-torque-nm: 21 N·m is above the peak torque, 20.5 N·m",
    ),
    (
        "max-velocity-rad-s = 30",
        "max-velocity-rad-s = 50",
        "39:22: model.max-velocity-rad-s: 50 rad/s is beyond the largest velocity code, 45 rad/s",
    ),
    (
        "motors =",
        "torque-code = \"current\"\nmotors =",
        "33:20: model.position-end-rad: has no effect where torque-code = \"current\"; remove it",
    ),
];

/// The same for a motor that reports its faults in every reply.
const SPOILED_STATUS: &[Spoiled] = &[
    ("shift = 5", "shift = 4", "22:8: faults.byte: the fault code overlaps the id in byte 0 of the reply"),
    ("on = 1", "on = 0", "25:6: faults.on: 0 is the code of a disabled motor too; give another"),
    ("on = 1", "on = 8", "25:6: faults.on: 8 is out of range; give an integer from 0 to 7"),
    (
        "2 = \"over-voltage\"",
        "1 = \"over-voltage\"",
        "26:1: faults.codes.: 1 is the code of a motor without a fault too",
    ),
    (
        "2 = \"over-voltage\"",
        "2 = \"encoder\"\n0x2 = \"position\"",
        "28:7: faults.codes.0x2: 2 is there twice; remove one of them",
    ),
    ("byte = 0\nshift = 5", "byte = 7", "22:8: faults.byte: the shortest reply has 7 bytes, without byte 7"),
];

fn with_status() -> String {
    let (before, rest) = SOUND.split_once("report = \"asked\"").unwrap();
    let (_, models) = rest.split_once("[[model]]").unwrap();
    format!("{before}{IN_EVERY_REPLY}\n[[model]]{models}")
}

#[test]
fn sound_file_is_read_as_it_says() {
    let profile = parse(SOUND).unwrap();
    assert_eq!((profile.name, profile.motors, profile.protocols), ("acme", "Acme A series", &["mit"][..]));
    assert_eq!((profile.ids.reply, profile.ids.also_receives), (ReplyId::Offset(0x20), &[0x100][..]));
    let zero = [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xF1];
    assert_eq!(profile.special, SpecialFrames { zero, ..SpecialFrames::COMMON });
    let FaultReport::Asked(reply) = profile.faults else { unreachable!("it is asked") };
    assert_eq!(reply.words, [(1, Faults::OVER_VOLTAGE), (1 << 9, Faults::ENCODER)]);
    let [model] = profile.models else { unreachable!("it has one model") };
    assert_eq!(model.ends, Some(Ends::new(12.5, 45.0, 24.0)));
    assert_eq!((model.gear_ratio, model.peak_torque, model.rated_current), (9.0, 20.5, 0.0));
    assert!(matches!(parse(&with_status()).unwrap().faults, FaultReport::InEveryReply(_)));
}

#[test]
fn spoiled_files_are_refused_with_their_reason() {
    let asked = SPOILED.iter().map(|row| (SOUND.to_owned(), row));
    let status = SPOILED_STATUS.iter().map(|row| (with_status(), row));
    let mut wrong = Vec::new();
    for (sound, (part, spoiled, expected)) in asked.chain(status) {
        assert!(sound.contains(part), "{part}");
        let problems = parse(&sound.replacen(part, spoiled, 1)).err().unwrap_or_default();
        let found: Vec<_> = problems.iter().map(ToString::to_string).collect();
        if !found.iter().any(|problem| problem.starts_with(expected)) {
            wrong.push(format!("{spoiled}: {found:?}, expected {expected:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_problem_of_a_file_is_reported() {
    let text = SOUND.replace("largest = 0x1F", "largest = 0").replace("gear-ratio", "ratio");
    let keys: Vec<_> = parse(&text).unwrap_err().into_iter().map(|problem| problem.key).collect();
    assert_eq!(keys, ["ids.largest", "model.gear-ratio", "model.ratio"]);
}

#[test]
fn other_motors_frames_are_never_sent() {
    let text = SOUND.replace("zero =", "clear-fault = \"none\"\nzero =");
    let faults = "report = \"never\"\n\n[[model]]";
    let (before, rest) = text.split_once("report = \"asked\"").unwrap();
    let text = format!("{before}{faults}{}", rest.split_once("[[model]]").unwrap().1);
    let profile: Profile = parse(&text).unwrap();
    let scales = profile.models[0].scales().unwrap();
    for command in [motord_protocol::mit::Command::ClearFault, motord_protocol::mit::Command::GetFault] {
        assert_eq!(profile.encode(&command, &scales), Ok(SpecialFrames::COMMON.stop));
    }
}

#[test]
fn documented_example_is_a_sound_file() {
    let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/extending.md");
    let page = std::fs::read_to_string(page).unwrap();
    let (_, rest) = page.split_once("## A new motor vendor").unwrap();
    let (_, rest) = rest.split_once("```toml\n").unwrap();
    let (example, _) = rest.split_once("```").unwrap();
    let profile = parse(example).unwrap_or_else(|problems| panic!("{problems:?}"));
    assert_eq!((profile.name, profile.models.len()), ("acme", 1));
}

proptest! {
    #[test]
    fn damaged_file_never_panics(at in 0..SOUND.len(), byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = SOUND.as_bytes().to_vec();
        bytes[at] = byte;
        if cut {
            bytes.truncate(at);
        }
        if let Ok(text) = String::from_utf8(bytes) && let Err(problems) = parse(&text) {
            prop_assert!(!problems.is_empty());
        }
    }
}
