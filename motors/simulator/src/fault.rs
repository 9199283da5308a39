//! Faults of a bus or a motor, and the lines that request them: `fl-hip delayed 2ms`.

use core::str::FromStr;
use motord_bus::frame::ControllerState;
use motord_bus::{Duration, Unsupported};

/// One fault. The faults of a motor accumulate until [`Fault::Ok`] ends them all. A bus has one
/// link state at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// `ok`, `on`: ends every fault. Lasting effects (a vendor fault, heat, a power cycle) stay. A
    /// motor without power boots.
    Ok,
    /// `off`: the motor is unplugged from the bus. It neither receives nor answers, and continues
    /// its last command.
    Off,
    /// `stuck`: the reported position stops updating.
    Stuck,
    /// `garbage`: answers have the right id and length, and random bytes.
    Garbage,
    /// `wrong`: answers are well formed, with false values: position 1 rad off, velocity and torque
    /// with reversed sign.
    Wrong,
    /// `slow 10ms`: reported states are refreshed only at this interval.
    Slow(Duration),
    /// `delayed 2ms`: answers are delayed by this time.
    Delayed(Duration),
    /// `intermittent 50%`: this fraction of the answers is lost, 0 to 1.
    Intermittent(f64),
    /// `duplicate`: every answer is sent twice.
    Duplicate,
    /// `reorder`: every other answer is sent after its successor.
    Reorder,
    /// `short`: answers lack their last two bytes.
    Short,
    /// `fault 0x02`: the drive raises this number of its vendor's fault list (SteadyWin: bits of
    /// GIM document, table 9).
    Raise(u32),
    /// `power-cycle`: the motor restarts: silent while it boots, then stopped, with its position
    /// within one turn.
    PowerCycle,
    /// `restart`: the drive restarts in a moment, as after a dip of its supply: stopped, and it
    /// answers on. Its position is within one turn.
    Restart,
    /// `power-off`: the motor has no power: limp, silent, and without the values that it has not
    /// stored. Of a bus: all its motors, until `ok`.
    PowerOff,
    /// `refuse 0x0B`: native commands that write configuration or parameters, and calibrations,
    /// return this result code (GIM document, table 5) and have no effect.
    Refuse(u8),
    /// `temperature 120`: the winding has this temperature now, °C.
    Temperature(f64),
    /// `voltage 60`: the supply, V.
    Voltage(f64),
    /// `load 5`: constant external torque on the output, N·m.
    Load(f64),
    /// `bus-off`: the controller has left the bus. Frames are accepted and lost, as Linux does
    /// without carrier.
    BusOff,
    /// `tx-full`, `tx-full 1`: each send accepts this many frames and refuses the rest. Waiting
    /// frames are still sent.
    TxFull(usize),
    /// `no-ack`: no node acknowledges. The queue fills, and its old frames are sent when the fault
    /// ends.
    NoAck,
    /// `down`: the interface is down.
    Down,
    /// `gone`: the interface is unplugged. `ok` plugs a serial port in again, perhaps under another
    /// name.
    Gone,
    /// `flood 8000`: frames per second with ids of no motor.
    Flood(u32),
    /// `warning`, `passive`, `active`: the controller reports this state once; nothing else
    /// changes.
    Report(ControllerState),
    /// `extended`, `remote`, `fd`: one frame that no motor sends.
    Unsupported(Unsupported),
    /// `bitrate 500000`: the host's controller has this bit rate from now on.
    Bitrate(u32),
    /// `overflow 5`: number of received frames that were lost.
    Overflow(u32),
    /// `overrun`: the host's controller loses received frames, and reports it once.
    Overrun,
    /// `echo`: the RS485 adapter returns the bytes that the host sends.
    Echo,
    /// `glue 16ms`: the adapter collects bytes for this time, and delivers them together.
    Glue(Duration),
    /// `loss 1%`: this fraction of the bytes is lost in each direction, 0 to 1.
    Loss(f64),
    /// `corrupt 1%`: this fraction of the bytes is changed in each direction, 0 to 1.
    Corruption(f64),
    /// `silent`: no byte passes, in either direction.
    Silent,
    /// `blocked`: the port accepts no byte from the host (`EAGAIN`).
    Blocked,
}

/// A fault and the name of its bus or motor, as in `front-left bus-off`.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultVerb {
    /// Name of a bus or motor.
    pub target: String,
    /// The fault.
    pub fault: Fault,
}

/// Reason for which a line is not a [`FaultVerb`].
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

/// The words after a verb.
#[derive(Clone, Copy)]
enum Form {
    /// Nothing.
    Bare(Fault),
    /// An argument.
    With { example: &'static str, read: fn(&str) -> Option<Fault> },
    /// An optional argument; without one the fault is `otherwise`.
    Either { otherwise: Fault, example: &'static str, read: fn(&str) -> Option<Fault> },
}

/// The targets that can have a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultTarget {
    /// A motor or a bus.
    Any,
    /// A motor.
    Motor,
    /// A bus.
    Bus,
    /// A serial bus.
    Line,
}

/// The word for a fault.
#[derive(Clone, Copy)]
pub struct Verb {
    /// The word.
    pub name: &'static str,
    /// The targets that can have the fault.
    pub target: FaultTarget,
    /// The effect, as text for display.
    pub effect: &'static str,
    form: Form,
}

impl Verb {
    const fn bare(name: &'static str, target: FaultTarget, fault: Fault, effect: &'static str) -> Self {
        Self { name, target, effect, form: Form::Bare(fault) }
    }

    const fn with(
        (name, example): (&'static str, &'static str),
        target: FaultTarget,
        read: fn(&str) -> Option<Fault>,
        effect: &'static str,
    ) -> Self {
        Self { name, target, effect, form: Form::With { example, read } }
    }

    const fn either(
        (name, example): (&'static str, &'static str),
        target: FaultTarget,
        (otherwise, read): (Fault, fn(&str) -> Option<Fault>),
        effect: &'static str,
    ) -> Self {
        Self { name, target, effect, form: Form::Either { otherwise, example, read } }
    }

    /// Returns the verb with an example of its argument, in brackets where it is optional.
    #[must_use]
    pub fn usage(&self) -> String {
        let Self { name, form, .. } = self;
        match form {
            Form::Bare(_) => (*name).to_owned(),
            Form::With { example, .. } => format!("{name} {example}"),
            Form::Either { example, .. } => format!("{name} [{example}]"),
        }
    }

    /// Returns a line for each verb whose target is one of `targets`: its usage and its effect. For
    /// the help of a program.
    #[must_use]
    pub fn list(targets: &[FaultTarget]) -> String {
        let listed = VERBS.iter().filter(|verb| targets.contains(&verb.target));
        listed.map(|verb| format!("  {:<20} {}\n", verb.usage(), verb.effect)).collect()
    }
}

/// All verbs. The documentation of [`Fault`] describes their effects in detail.
pub const VERBS: [Verb; 41] = {
    use FaultTarget::{Any, Bus, Line, Motor};
    let slow = Fault::Slow(Duration::from_millis(10));
    let delayed = Fault::Delayed(Duration::from_millis(2));
    // The latency timer of common USB adapters.
    let glue = Fault::Glue(Duration::from_millis(16));
    [
        Verb::bare("ok", Any, Fault::Ok, "ends every fault; a motor without power boots"),
        Verb::bare("on", Any, Fault::Ok, "the same"),
        Verb::bare(
            "off",
            Motor,
            Fault::Off,
            "unplugged: neither receives nor answers, continues its last command",
        ),
        Verb::bare(
            "power-off",
            Any,
            Fault::PowerOff,
            "has no power: limp and silent; of a bus, all its motors",
        ),
        Verb::bare(
            "power-cycle",
            Motor,
            Fault::PowerCycle,
            "boots: silent, then stopped, its position within one turn",
        ),
        Verb::bare(
            "restart",
            Motor,
            Fault::Restart,
            "restarts without a silence: stopped, and answers on, its position within one turn",
        ),
        Verb::with(
            ("fault", "0x02"),
            Motor,
            |text| number(text).map(Fault::Raise),
            "raises a fault of its vendor's list",
        ),
        Verb::with(
            ("temperature", "120"),
            Motor,
            |text| finite(text).map(Fault::Temperature),
            "its winding has this temperature, °C",
        ),
        Verb::with(
            ("voltage", "60"),
            Motor,
            |text| finite(text).map(Fault::Voltage),
            "its supply has this voltage, V",
        ),
        Verb::with(
            ("load", "5.0"),
            Motor,
            |text| finite(text).map(Fault::Load),
            "an external torque acts on its output, N·m",
        ),
        Verb::bare("stuck", Motor, Fault::Stuck, "its reported position stops updating"),
        Verb::bare("garbage", Motor, Fault::Garbage, "its answers are random bytes"),
        Verb::bare(
            "wrong",
            Motor,
            Fault::Wrong,
            "its answers are false: 1 rad off, velocity and torque reversed",
        ),
        Verb::either(
            ("slow", "10ms"),
            Motor,
            (slow, |text| duration(text).map(Fault::Slow)),
            "its reported states are refreshed only at this interval",
        ),
        Verb::either(
            ("delayed", "2ms"),
            Motor,
            (delayed, |text| duration(text).map(Fault::Delayed)),
            "its answers are delayed by this time",
        ),
        Verb::either(
            ("intermittent", "50%"),
            Motor,
            (Fault::Intermittent(0.5), |text| percentage(text).map(Fault::Intermittent)),
            "this share of its answers is lost",
        ),
        Verb::bare("duplicate", Motor, Fault::Duplicate, "every answer is sent twice"),
        Verb::bare("reorder", Motor, Fault::Reorder, "every other answer is sent after its successor"),
        Verb::bare("short", Motor, Fault::Short, "its answers lack their last two bytes"),
        Verb::with(
            ("refuse", "0x0B"),
            Motor,
            |text| byte(text).map(Fault::Refuse),
            "native commands that write get this result, and have no effect",
        ),
        Verb::bare("bus-off", Bus, Fault::BusOff, "the controller has left the bus: frames are lost"),
        Verb::bare("down", Bus, Fault::Down, "the interface is down"),
        Verb::bare("gone", Bus, Fault::Gone, "the adapter is unplugged"),
        Verb::bare("no-ack", Bus, Fault::NoAck, "no node acknowledges: the queue fills"),
        Verb::either(
            ("tx-full", "1"),
            Bus,
            (Fault::TxFull(0), |text| text.parse().ok().map(Fault::TxFull)),
            "each send accepts this many frames; none without a number",
        ),
        Verb::either(
            ("flood", "8000"),
            Bus,
            (Fault::Flood(8000), |text| rate(text).map(Fault::Flood)),
            "frames per second with ids of no motor",
        ),
        Verb::with(
            ("overflow", "5"),
            Bus,
            |text| text.parse().ok().map(Fault::Overflow),
            "this number of received frames was lost",
        ),
        Verb::bare("overrun", Bus, Fault::Overrun, "the controller reports: received frames were lost"),
        Verb::with(
            ("bitrate", "500000"),
            Bus,
            |text| rate(text).map(Fault::Bitrate),
            "the host's controller has this bit rate",
        ),
        Verb::bare(
            "active",
            Bus,
            Fault::Report(ControllerState::Active),
            "the controller reports: error-active",
        ),
        Verb::bare(
            "warning",
            Bus,
            Fault::Report(ControllerState::Warning),
            "the controller reports: error-warning",
        ),
        Verb::bare(
            "passive",
            Bus,
            Fault::Report(ControllerState::Passive),
            "the controller reports: error-passive",
        ),
        Verb::bare(
            "extended",
            Bus,
            Fault::Unsupported(Unsupported::Extended),
            "one extended frame, which no motor sends",
        ),
        Verb::bare(
            "remote",
            Bus,
            Fault::Unsupported(Unsupported::Remote),
            "one remote frame, which no motor sends",
        ),
        Verb::bare("fd", Bus, Fault::Unsupported(Unsupported::Fd), "one CAN FD frame, which no motor sends"),
        Verb::bare("echo", Line, Fault::Echo, "the adapter returns the bytes that the host sends"),
        Verb::either(
            ("glue", "16ms"),
            Line,
            (glue, |text| duration(text).map(Fault::Glue)),
            "the adapter delivers bytes only at this interval",
        ),
        Verb::with(
            ("loss", "1%"),
            Line,
            |text| percentage(text).map(Fault::Loss),
            "this share of the bytes is lost",
        ),
        Verb::with(
            ("corrupt", "1%"),
            Line,
            |text| percentage(text).map(Fault::Corruption),
            "this share of the bytes is changed",
        ),
        Verb::bare("silent", Line, Fault::Silent, "no byte passes"),
        Verb::bare("blocked", Line, Fault::Blocked, "the port accepts no byte from the host"),
    ]
};

fn fault(verb: &str, argument: Option<&str>) -> Result<Fault, VerbError> {
    let Verb { form, .. } = VERBS.iter().find(|known| known.name == verb).ok_or(VerbError::Verb)?;
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

/// Reason for which a fault could not be injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InjectError {
    /// Neither the bus nor a motor on it has this name.
    NoSuchTarget,
    /// A fault of buses, requested for a motor.
    NotForMotors,
    /// A fault of motors, requested for a bus.
    NotForBuses,
    /// A fault of motors or buses, requested for an IMU.
    NotForImus,
    /// A fault of serial ports, requested for another bus.
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
            Self::NotForImus => {
                f.write_str(
                    "an IMU can have the faults off, stuck, garbage, delayed, intermittent, gone, and corrupt on a serial line",
                )
            }
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
            ("fl-hip restart", Fault::Restart),
            ("fl-hip load -2.5", Fault::Load(-2.5)),
            ("fl-hip tx-full", Fault::TxFull(0)),
            ("fl-hip tx-full 1", Fault::TxFull(1)),
            ("fl-hip flood 100", Fault::Flood(100)),
            ("fl-hip passive", Fault::Report(ControllerState::Passive)),
            ("fl-hip overrun", Fault::Overrun),
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

    /// Goal: the help is correct. Method: every verb of the list is injected into a motor, a bus
    /// and a serial bus.
    #[test]
    fn verbs_apply_to_their_listed_targets() {
        use crate::{BusSettings, Medium, MotorSettings, SerialSlave, SimulatedBus};
        use motord_bus::Instant;
        let bus = |medium| {
            let motor = MotorSettings { name: "motor".into(), ..Default::default() };
            SimulatedBus::new(
                BusSettings { name: "bus".into(), medium, ..Default::default() },
                vec![motor],
                0,
            )
        };
        for verb in VERBS {
            let usage = verb.usage().replace(['[', ']'], "");
            let line = |target| format!("{target} {usage}").parse::<FaultVerb>().unwrap();
            let to_motor = bus(Medium::Can).inject(Instant::ZERO, &line("motor")).is_ok();
            let to_bus = bus(Medium::Can).inject(Instant::ZERO, &line("bus")).is_ok();
            let to_line =
                SerialSlave::new(bus(Medium::Serial), 0).inject(Instant::ZERO, &line("bus")).is_ok();
            let (motor, any_bus) = match verb.target {
                FaultTarget::Any => (true, true),
                FaultTarget::Motor => (true, false),
                FaultTarget::Bus => (false, true),
                FaultTarget::Line => (false, false),
            };
            assert_eq!((to_motor, to_bus), (motor, any_bus), "{usage}");
            // The fault blocks the port, not the slave behind it.
            assert_eq!(to_line || verb.name == "blocked", verb.target != FaultTarget::Motor, "{usage}");
        }
    }

    #[test]
    fn error_of_invalid_verb_names_expected() {
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
