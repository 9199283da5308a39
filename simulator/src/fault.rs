//! Faults of a bus or a motor, and the lines that ask for them: `fl-hip delayed 2ms`.

use core::str::FromStr;
use motord_bus::frame::ControllerState;
use motord_bus::{Duration, Unsupported};

/// One fault. The faults of a motor add up until [`Fault::Ok`] ends all of them. A bus has one link state at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// `ok`, `on`: ends every fault. Its effects (a vendor fault, heat, a power cycle) stay. A motor without power boots.
    Ok,
    /// `off`: the motor is unplugged from the bus. It neither hears nor answers, and goes on executing its last command.
    Off,
    /// `stuck`: the reported position stands still.
    Stuck,
    /// `garbage`: answers have the right id and length, and random bytes.
    Garbage,
    /// `wrong`: answers are well formed and false: position 1 rad off, velocity and torque with the other sign.
    Wrong,
    /// `slow 10ms`: reported states are refreshed only that often.
    Slow(Duration),
    /// `delayed 2ms`: answers come later by this time.
    Delayed(Duration),
    /// `intermittent 50%`: that fraction of the answers is lost, 0 to 1.
    Intermittent(f64),
    /// `duplicate`: every answer is sent twice.
    Duplicate,
    /// `reorder`: every other answer is sent after its successor.
    Reorder,
    /// `short`: answers lack their last two bytes.
    Short,
    /// `fault 0x02`: the drive raises this number of its vendor's fault list (SteadyWin: bits of GIM document, table 9).
    Raise(u32),
    /// `power-cycle`: the motor restarts: silent while it boots, then stopped, its position within one turn.
    PowerCycle,
    /// `power-off`: the motor has no power: limp, silent, and it forgets what it has not stored.
    PowerOff,
    /// `refuse 0x0B`: native commands that write configuration or parameters, and calibrations, get this result code (GIM
    /// document, table 5) and have no effect.
    Refuse(u8),
    /// `temperature 120`: the winding has this temperature now, °C.
    Temperature(f64),
    /// `voltage 60`: the supply, V.
    Voltage(f64),
    /// `load 5`: constant torque of the outside world on the output, N·m.
    Load(f64),
    /// `bus-off`: the controller has left the bus. Frames are accepted and lost, as Linux does without carrier.
    BusOff,
    /// `tx-full`, `tx-full 1`: each send accepts this many frames and refuses the rest; what waits is still sent.
    TxFull(usize),
    /// `no-ack`: no node acknowledges. The queue fills, and its old frames are sent when the fault ends.
    NoAck,
    /// `down`: the interface is down.
    Down,
    /// `gone`: the interface is unplugged. `ok` plugs a serial port in again, perhaps under another name.
    Gone,
    /// `flood 8000`: so many frames a second with ids of no motor.
    Flood(u32),
    /// `warning`, `passive`, `active`: the controller reports this state once; nothing else changes.
    Report(ControllerState),
    /// `extended`, `remote`, `fd`: one frame that no motor sends.
    Unsupported(Unsupported),
    /// `bitrate 500000`: the host's controller has this bit rate from now on.
    Bitrate(u32),
    /// `overflow 5`: so many received frames were lost.
    Overflow(u32),
    /// `echo`: the RS485 adapter gives the host back what it sends.
    Echo,
    /// `glue 16ms`: the adapter collects bytes for this time, and hands them over at once.
    Glue(Duration),
    /// `loss 1%`: that fraction of the bytes is lost in each direction, 0 to 1.
    Loss(f64),
    /// `corrupt 1%`: that fraction of the bytes is changed in each direction, 0 to 1.
    Corruption(f64),
    /// `silent`: no byte passes, in either direction.
    Silent,
    /// `blocked`: the port takes no byte of the host (`EAGAIN`).
    Blocked,
}

/// A fault and the name of its bus or motor, as in `front-left bus-off`.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultVerb {
    /// Name of a bus or motor.
    pub target: String,
    /// Its fault.
    pub fault: Fault,
}

/// The reason why a line is not a [`FaultVerb`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VerbError {
    /// The line has no target, no verb, or more words than its verb takes.
    Words {
        /// The number of words.
        received: usize,
    },
    /// No such verb.
    Verb,
    /// The verb's argument is missing, malformed or out of range.
    Argument {
        /// An example.
        expected: &'static str,
    },
}

impl core::fmt::Display for VerbError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Words { received } => {
                write!(f, "{received} words; expected a target, a verb and at most one argument")
            }
            Self::Verb => write!(f, "no such verb"),
            Self::Argument { expected } => write!(f, "bad argument; expected something like {expected}"),
        }
    }
}

impl core::error::Error for VerbError {}

impl FromStr for FaultVerb {
    type Err = VerbError;

    fn from_str(line: &str) -> Result<Self, VerbError> {
        let mut words = line.split_whitespace();
        let (target, verb, argument) = (words.next(), words.next(), words.next());
        let received = line.split_whitespace().count();
        match (target, verb) {
            (Some(target), Some(verb)) if received <= 3 => {
                Ok(Self { target: target.to_owned(), fault: fault(verb, argument)? })
            }
            _ => Err(VerbError::Words { received }),
        }
    }
}

/// The words that follow a verb.
#[derive(Clone, Copy)]
enum Form {
    /// Nothing.
    Bare(Fault),
    /// An argument.
    With { example: &'static str, read: fn(&str) -> Option<Fault> },
    /// An argument, or this instead.
    Either { otherwise: Fault, example: &'static str, read: fn(&str) -> Option<Fault> },
}

/// All verbs; the documentation of [`Fault`] says what they do.
const VERBS: [(&str, Form); 39] = {
    use Form::{Bare, Either, With};
    let slow = Fault::Slow(Duration::from_millis(10));
    let delayed = Fault::Delayed(Duration::from_millis(2));
    // The latency timer of common USB adapters.
    let glue = Fault::Glue(Duration::from_millis(16));
    [
        ("ok", Bare(Fault::Ok)),
        ("on", Bare(Fault::Ok)),
        ("off", Bare(Fault::Off)),
        ("stuck", Bare(Fault::Stuck)),
        ("garbage", Bare(Fault::Garbage)),
        ("wrong", Bare(Fault::Wrong)),
        ("slow", Either { otherwise: slow, example: "10ms", read: |text| duration(text).map(Fault::Slow) }),
        (
            "delayed",
            Either { otherwise: delayed, example: "2ms", read: |text| duration(text).map(Fault::Delayed) },
        ),
        (
            "intermittent",
            Either {
                otherwise: Fault::Intermittent(0.5),
                example: "50%",
                read: |text| percentage(text).map(Fault::Intermittent),
            },
        ),
        ("duplicate", Bare(Fault::Duplicate)),
        ("reorder", Bare(Fault::Reorder)),
        ("short", Bare(Fault::Short)),
        ("fault", With { example: "0x02", read: |text| number(text).map(Fault::Raise) }),
        ("power-cycle", Bare(Fault::PowerCycle)),
        ("power-off", Bare(Fault::PowerOff)),
        ("refuse", With { example: "0x0B", read: |text| byte(text).map(Fault::Refuse) }),
        ("temperature", With { example: "120", read: |text| finite(text).map(Fault::Temperature) }),
        ("voltage", With { example: "60", read: |text| finite(text).map(Fault::Voltage) }),
        ("load", With { example: "5.0", read: |text| finite(text).map(Fault::Load) }),
        ("bus-off", Bare(Fault::BusOff)),
        (
            "tx-full",
            Either {
                otherwise: Fault::TxFull(0),
                example: "1",
                read: |text| text.parse().ok().map(Fault::TxFull),
            },
        ),
        ("no-ack", Bare(Fault::NoAck)),
        ("down", Bare(Fault::Down)),
        ("gone", Bare(Fault::Gone)),
        (
            "flood",
            Either {
                otherwise: Fault::Flood(8000),
                example: "8000",
                read: |text| rate(text).map(Fault::Flood),
            },
        ),
        ("bitrate", With { example: "500000", read: |text| rate(text).map(Fault::Bitrate) }),
        ("active", Bare(Fault::Report(ControllerState::Active))),
        ("warning", Bare(Fault::Report(ControllerState::Warning))),
        ("passive", Bare(Fault::Report(ControllerState::Passive))),
        ("extended", Bare(Fault::Unsupported(Unsupported::Extended))),
        ("remote", Bare(Fault::Unsupported(Unsupported::Remote))),
        ("fd", Bare(Fault::Unsupported(Unsupported::Fd))),
        ("overflow", With { example: "5", read: |text| text.parse().ok().map(Fault::Overflow) }),
        ("echo", Bare(Fault::Echo)),
        ("glue", Either { otherwise: glue, example: "16ms", read: |text| duration(text).map(Fault::Glue) }),
        ("loss", With { example: "1%", read: |text| percentage(text).map(Fault::Loss) }),
        ("corrupt", With { example: "1%", read: |text| percentage(text).map(Fault::Corruption) }),
        ("silent", Bare(Fault::Silent)),
        ("blocked", Bare(Fault::Blocked)),
    ]
};

fn fault(verb: &str, argument: Option<&str>) -> Result<Fault, VerbError> {
    let (_, form) = VERBS.iter().find(|(name, _)| *name == verb).ok_or(VerbError::Verb)?;
    match (*form, argument) {
        (Form::Bare(fault), None) => Ok(fault),
        (Form::Bare(_), Some(_)) => Err(VerbError::Words { received: 3 }),
        (Form::Either { otherwise, .. }, None) => Ok(otherwise),
        (Form::With { example, .. }, None) => Err(VerbError::Argument { expected: example }),
        (Form::With { example, read } | Form::Either { example, read, .. }, Some(text)) => {
            read(text).ok_or(VerbError::Argument { expected: example })
        }
    }
}

fn duration(text: &str) -> Option<Duration> {
    let split = text.find(|letter: char| letter.is_ascii_alphabetic())?;
    let (number, unit) = text.split_at(split);
    let scale = match unit {
        "s" => 1.0,
        "ms" => 1e-3,
        "us" => 1e-6,
        _ => return None,
    };
    Duration::try_from_secs_f64(number.parse::<f64>().ok()? * scale).ok()
}

fn percentage(text: &str) -> Option<f64> {
    let percent = finite(text.strip_suffix('%')?)?;
    (0.0..=100.0).contains(&percent).then_some(percent / 100.0)
}

fn number(text: &str) -> Option<u32> {
    match text.strip_prefix("0x") {
        Some(hex) => u32::from_str_radix(hex, 16).ok(),
        None => text.parse().ok(),
    }
}

fn byte(text: &str) -> Option<u8> {
    number(text).and_then(|number| u8::try_from(number).ok())
}

fn rate(text: &str) -> Option<u32> {
    text.parse().ok().filter(|rate| *rate > 0)
}

fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Why a fault could not be injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InjectError {
    /// Neither the bus nor a motor on it has this name.
    NoSuchTarget,
    /// A fault of buses, asked for a motor.
    NotForMotors,
    /// A fault of motors, asked for a bus.
    NotForBuses,
    /// A fault of serial ports, asked for another bus.
    OnlySerial,
    /// The text is not the memory of a motor.
    NoMemory,
    /// The port could not be plugged in again: the `errno` of the pseudo terminal.
    Unplugged(i32),
}

impl core::fmt::Display for InjectError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoSuchTarget => f.write_str("no bus or motor of this name"),
            Self::NotForMotors => f.write_str("only a bus can have this fault"),
            Self::NotForBuses => f.write_str("only a motor can have this fault"),
            Self::OnlySerial => f.write_str("only a serial port can have this fault"),
            Self::NoMemory => f.write_str("not the memory of a motor"),
            Self::Unplugged(errno) => write!(f, "no pseudo terminal: os error {errno}"),
        }
    }
}

impl core::error::Error for InjectError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verb_is_read_as_it_is_documented() {
        let cases = [
            ("fl-hip off", Fault::Off),
            ("fl-hip on", Fault::Ok),
            ("fl-hip delayed 2ms", Fault::Delayed(Duration::from_millis(2))),
            ("fl-hip slow 500us", Fault::Slow(Duration::from_micros(500))),
            ("fl-hip intermittent 50%", Fault::Intermittent(0.5)),
            ("fl-hip fault 0x02", Fault::Raise(2)),
            ("fl-hip fault 8", Fault::Raise(8)),
            ("fl-hip  power-cycle", Fault::PowerCycle),
            ("fl-hip load -2.5", Fault::Load(-2.5)),
            ("fl-hip tx-full", Fault::TxFull(0)),
            ("fl-hip tx-full 1", Fault::TxFull(1)),
            ("fl-hip flood 100", Fault::Flood(100)),
            ("fl-hip passive", Fault::Report(ControllerState::Passive)),
            ("fl-hip remote", Fault::Unsupported(Unsupported::Remote)),
            ("arm echo", Fault::Echo),
            ("arm glue 1ms", Fault::Glue(Duration::from_millis(1))),
            ("arm corrupt 0.5%", Fault::Corruption(0.005)),
        ];
        for (line, fault) in cases {
            let target = line.split_whitespace().next().unwrap().into();
            assert_eq!(line.parse(), Ok(FaultVerb { target, fault }), "{line}");
        }
    }

    #[test]
    fn a_line_that_is_no_verb_says_what_is_expected() {
        let expected = |text| VerbError::Argument { expected: text };
        let cases = [
            ("", VerbError::Words { received: 0 }),
            ("fl-hip", VerbError::Words { received: 1 }),
            ("fl-hip off now", VerbError::Words { received: 3 }),
            ("fl-hip delayed 2 ms", VerbError::Words { received: 4 }),
            ("fl-hip explode", VerbError::Verb),
            ("fl-hip explode 2", VerbError::Verb),
            ("fl-hip fault", expected("0x02")),
            ("fl-hip fault 0x100000000", expected("0x02")),
            ("fl-hip delayed -1ms", expected("2ms")),
            ("fl-hip delayed 2", expected("2ms")),
            ("fl-hip intermittent 101%", expected("50%")),
            ("fl-hip intermittent nan%", expected("50%")),
            ("fl-hip load inf", expected("5.0")),
            ("fl-hip flood 0", expected("8000")),
        ];
        for (line, error) in cases {
            assert_eq!(line.parse::<FaultVerb>(), Err(error), "{line}");
        }
    }
}
