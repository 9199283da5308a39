//! The problems of a configuration, as texts for people: the problem, and the remedy.

use std::fmt;
use std::io;
use std::path::PathBuf;

use motord_shared::limits::NAME_BYTES_MAX;
use motord_untrusted::printable_line;

use super::units::{Shown, short};

/// An error or a warning, and its place.
#[derive(Debug)]
pub struct Problem {
    /// The file, as named by the caller.
    pub file: PathBuf,
    /// The place in the file; `None` for a problem of the file itself.
    pub location: Option<Location>,
    /// The problem itself.
    pub wrong: Wrong,
}

impl std::error::Error for Problem {}

/// A place in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location {
    /// Counted from 1.
    pub line: usize,
    /// Characters from the begin of the line, counted from 1.
    pub column: usize,
    /// The dotted key, `motor.limits.kp-max`; `None` where the text is no TOML.
    pub key: Option<String>,
}

impl Location {
    /// Returns the place of the byte at `offset`.
    pub(super) fn at(text: &[u8], offset: usize, key: Option<String>) -> Self {
        let before = &text[..offset.min(text.len())];
        let begin = before.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let column = 1 + String::from_utf8_lossy(&before[begin..]).chars().count();
        Self { line: line(text, offset), column, key }
    }
}

/// Returns the line of the byte at `offset`, counted from 1.
pub(super) fn line(text: &[u8], offset: usize) -> usize {
    1 + text.iter().take(offset).filter(|byte| **byte == b'\n').count()
}

impl fmt::Display for Problem {
    /// `FILE:LINE:COLUMN: KEY: what is wrong; what to do`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:", self.file.display())?;
        if let Some(location) = &self.location {
            write!(f, "{}:{}:", location.line, location.column)?;
            if let Some(key) = &location.key {
                write!(f, " {key}:")?;
            }
        }
        write!(f, " {}", self.wrong)
    }
}

/// A problem without its place.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "each variant's message is its documentation")]
pub enum Wrong {
    // The file.
    #[error("cannot be read ({0}); check the path and its permissions")]
    Unreadable(io::Error),
    #[error("is {0}; name a regular file")]
    NotRegular(&'static str),
    #[error("may be changed by every user of this machine; forbid it with `chmod o-w`")]
    WorldWritable,
    #[error("is larger than {bytes_max} bytes; no configuration is: name another file")]
    TooLarge { bytes_max: u64 },
    #[error("has no keys; `motord init --file FILE` writes a first configuration")]
    Empty,
    #[error("is not UTF-8 here; save the file as UTF-8")]
    NotUtf8,
    #[error("is no text, perhaps a program or a compressed file; name the configuration, a TOML file")]
    NoText,
    #[error(
        "is no configuration of motord, although it is TOML: it has none of its tables, such as [cycle], [[bus]] and [[motor]]; name another file, or write one with `motord init --file FILE`"
    )]
    NoConfiguration,
    #[error(
        "is a lock file of `motorctl setup`, and no configuration; name the configuration beside it, such as motord.toml"
    )]
    LockFile,
    #[error(
        "is UTF-16, and not UTF-8; save the file as UTF-8, or convert it with `iconv -f UTF-16 -t UTF-8`"
    )]
    Utf16,
    #[error(
        "is {0}, and no TOML: a table is [cycle], a key in it rate-hz = 1000; `motord init` writes an example"
    )]
    OtherFormat(&'static str),
    #[error("has a carriage return without a line feed here; save the file with the line ends of Unix")]
    LoneReturn,
    #[error("`{bracket}` has no end; write `{close}` after the last item")]
    Unclosed { bracket: &'static str, close: &'static str },

    // The text.
    #[error("{0}")]
    Toml(String),
    /// Of a vendor's file.
    #[error("{0}")]
    Vendor(String),
    #[error("is missing; {0}")]
    Missing(String),
    #[error("unknown key `{key}`; {hint}")]
    UnknownKey { key: String, hint: String },
    #[error("unknown table {table}; {hint}")]
    UnknownTable { table: String, hint: String },
    #[error("there can be several of this table; write `[[{0}]]`, with two brackets")]
    ListOfTables(&'static str),
    #[error("there is only one such table; write `[{0}]`, with one bracket")]
    OneTable(&'static str),
    #[error("`[{old}]` is the old name of `[{new}]`, and both are there; move its keys to `[{new}]`")]
    OldAndNewName { old: &'static str, new: &'static str },
    #[error("does not belong to a bus of type `{kind}`; remove it, or change the type")]
    NotOfThisBus { kind: &'static str },

    // Any value.
    #[error("expected {expected}, found {found}; {cure}")]
    Type { expected: Box<str>, found: Box<str>, cure: Box<str> },
    #[error("unknown value `{word}`; {hint}")]
    UnknownWord { word: String, hint: String },
    #[error("{value} is not a finite number; give a number {expected}")]
    NotFinite { value: f64, expected: String },
    #[error("{} is out of range; give a number {expected}{hint}", Shown(*.value))]
    OutOfRange { value: f64, expected: String, hint: String },
    #[error("{} rad is more than a turn{degrees}", Shown(*.value))]
    ManyTurns { value: f64, degrees: String },
    #[error("{name:?} cannot be a name; use 1 to {NAME_BYTES_MAX} letters, digits, `-` and `_`")]
    Name { name: String },
    #[error("{name:?} has {letters} letters; use at most {NAME_BYTES_MAX}")]
    LongName { name: String, letters: usize },
    #[error(
        "looks like radians, and this key is in degrees; {radians} rad is {}°: write mount-rpy-deg = {cure}", short(radians.to_degrees())
    )]
    RadiansAsDegrees { radians: f64, cure: String },
    #[error(
        "{name:?} is the name of a {what} too, and a command with it could mean either; give the {own} another name"
    )]
    NameOfAnother { name: Box<str>, what: &'static str, own: &'static str },
    #[error(
        "{name:?} is the name of a motor too, and the group has other motors: `motorctl hold {name}` could mean either; give the \
         group another name"
    )]
    GroupNamedAsJoint { name: String },
    #[error("{wrong}; {count} times, also in lines {lines}")]
    Repeated { wrong: Box<Self>, count: usize, lines: String },
    #[error("{name:?} cannot be an instance; use only a-z, 0-9 and `-`, 1 to {NAME_BYTES_MAX} of them")]
    InstanceName { name: String },
    #[error("{name:?} is taken by an earlier {what}; every {what} needs its own name")]
    DuplicateName { name: String, what: &'static str },
    #[error("more than {max}; motord is built for at most {max}: remove some")]
    TooMany { max: usize },

    // Times against the cycle.
    #[error("{value_ms} ms is less than 2 cycles of {period_ms} ms; give it at least {} ms", 2.0 * period_ms)]
    LessThanTwoCycles { value_ms: f64, period_ms: f64 },
    #[error(
        "{value_us} µs is not shorter than a cycle of {period_us} µs; shorten it, or lower cycle.rate-hz"
    )]
    NotWithinCycle { value_us: f64, period_us: f64 },

    #[error(
        "{deadman_ms} ms is so short that the dead man's switch would act on a daemon that is only late, within \
         cycle.max-lateness-ms; give it at least {late_ms} ms, or lower cycle.max-lateness-ms"
    )]
    DeadmanBeforeLateness { deadman_ms: f64, late_ms: f64 },

    #[error(
        "at {rate_hz} Hz a stop reaches the motors up to {period_ms} ms late, and the loss of a controller is noticed after \
         {timeout_ms} ms; give at least {least_hz} Hz"
    )]
    SlowMotors { rate_hz: f64, period_ms: f64, timeout_ms: f64, least_hz: f64 },

    // This machine.
    #[error("processor {cpu} is not online, or motord may not use it; use one of {allowed:?}")]
    Processor { cpu: i64, allowed: Vec<usize> },
    #[error(
        "the cycle uses processor {cpu} too, and `spin` never releases it; give the IPC thread another one"
    )]
    SharedProcessor { cpu: usize },
    #[error(
        "SCHED_FIFO {priority} is beyond what motord may take here ({allowed}); raise RLIMIT_RTPRIO \
         (LimitRTPRIO= of systemd), or run without real time"
    )]
    Priority { priority: u8, allowed: u8 },
    #[error("there is no interface {0:?} on this machine now; `ip link` lists those that exist")]
    NoInterface(String),
    #[error("there is no device {0:?} on this machine now; `ls /dev/serial/by-id` lists those that exist")]
    NoDevice(String),

    // Telemetry.
    #[error(
        "{path:?} is no absolute path that ends with .prom; write one, such as /var/lib/motord/motord.prom"
    )]
    MetricsFile { path: String },
    #[error("{address:?} is no loopback address with its port, such as 127.0.0.1:9464")]
    MetricsAddress { address: String },
    #[error("{name:?} is no host name; write it without a port, such as robot.lan")]
    HostName { name: String },

    // IMUs.
    #[error("lists {0} numbers; give three: roll, pitch and yaw in degrees, such as [0, 0, 90]")]
    AngleCount(usize),
    #[error("{lost_ms} ms is less than 2 samples of {sample_ms} ms; give it at least {} ms", 2.0 * sample_ms)]
    LostWithinSamples { lost_ms: f64, sample_ms: f64 },

    #[error("does not belong to an IMU of type `{kind}`; remove it, or change the type")]
    NotOfThisImu { kind: &'static str },
    #[error("{baud} bit/s is no rate of this device; give one of {known}")]
    ImuBaud { baud: u32, known: String },
    #[error(
        "{rate_hz} samples per second of {bytes} bytes need {needed:.0} bit/s, and the line has {baud}; at most {rate_hz_max} Hz: \
         lower it here and in the device, or raise the baud rate of both"
    )]
    ImuLineFull { rate_hz: f64, bytes: usize, needed: f64, baud: u32, rate_hz_max: f64 },
    #[error("{name:?} is used by {other} already; a serial line carries one device: give each its own")]
    ImuDeviceTaken { name: String, other: String },

    #[error(
        "{0:?} is a serial bus, and this {1} speaks over CAN only; name a bus of type socketcan or simulated"
    )]
    SensorOnLine(String, &'static str),
    #[error(
        "the id {id:#05x} that follows from it is that of {other} on the same bus, and only one node may send an id; give another \
         {key}, here and on the device"
    )]
    SensorId { id: u16, other: String, key: &'static str },
    #[error(
        "the motor {motor:?} replies with the id {id:#05x}, and this device takes frames with that id for commands (CANopen); give the \
         motor another host-id, here and on the motor"
    )]
    ImuObeys { id: u32, motor: String },
    #[error(
        "the device sends {least} to {most} samples per second, one in a whole number of ms; the nearest rate is {nearest} Hz"
    )]
    ImuRate { least: f64, most: f64, nearest: f64 },
    #[error(
        "the device is asked in each cycle of {cycle_hz} Hz, or in each second, third and so on; the nearest rate is {nearest} Hz"
    )]
    ImuNotAskedAt { cycle_hz: f64, nearest: f64 },
    #[error(
        "the frames of the {what} delay the last reply to {last_us:.0} µs after the commands, later than the reply deadline of \
         {deadline_us:.0} µs at {rate_hz} Hz; give it another bus, or lower cycle.rate-hz to at most {rate_hz_max} Hz"
    )]
    SensorOverloads { what: &'static str, rate_hz: f64, last_us: f64, deadline_us: f64, rate_hz_max: f64 },
    #[error(
        "with the {what} the bus needs {percent:.1} % of its time at worst; give it another bus, or lower rate-hz"
    )]
    SensorFillsBus { what: &'static str, percent: f64 },

    // Buses.
    #[error("{name:?} cannot be an interface; use its Linux name, 1 to 15 characters, such as can0")]
    InterfaceName { name: String },
    #[error("{path:?} is no absolute path; name the device, such as /dev/ttyUSB0")]
    DevicePath { path: String },
    #[error("{name:?} is used by an earlier bus; two buses cannot share it: give each its own")]
    DuplicateDevice { name: String },
    #[error("{name:?} is another name of {other:?}, which an earlier bus uses; two buses cannot share it")]
    OtherName { name: String, other: String },
    #[error(
        "bus {other:?} has motors with the ids {ids} of this bus too: if adapters or cables of the two are exchanged, motors obey the \
         commands of the other bus, and motord cannot notice it; give each motor of the robot its own id, here and with \
         `motorctl id --set-id`"
    )]
    SharedIds { ids: String, other: String },
    #[error(
        "the motor {motor:?} needs no enable, so after a power cut it follows control frames from before the cut that wait for its power; \
         let motord discard them: give it CAP_NET_ADMIN (docs/guide/install.md), or take the interface down and up before the power \
         returns"
    )]
    NoEnable { motor: String },
    #[error("no motor is on this bus; remove it, or put one there")]
    EmptyBus,
    #[error(
        "the last reply of {motors} motors arrives {last_us:.0} µs after the commands, later than the reply deadline of \
         {deadline_us:.0} µs at {rate_hz} Hz; lower cycle.rate-hz to at most {rate_hz_max} Hz, or move motors to another bus"
    )]
    Overloaded { motors: usize, rate_hz: f64, last_us: f64, deadline_us: f64, rate_hz_max: f64 },
    #[error(
        "{motors} motors at {rate_hz} Hz need {percent:.1} % of this bus at worst, which leaves little for anything \
         else; at most 80 % is sound: lower cycle.rate-hz, or move motors to another bus"
    )]
    Tight { motors: usize, rate_hz: f64, percent: f64 },
    #[error(
        "a cycle with a fault poll needs {percent:.1} % of this bus at worst: faults are asked for only in cycles \
         that happen to have room; lower cycle.rate-hz for a poll that is certain"
    )]
    FaultPollTight { percent: f64 },

    #[error(
        "{turns} turns of {turn_us:.0} µs do not fit into {every} cycles of this serial bus; give it every = {least} or more"
    )]
    TurnsOverlap { turns: usize, turn_us: f64, every: u32, least: u32 },
    #[error(
        "a motor gets a command every {round_ms:.0} ms and needs {turns} to start, more than safety.start-timeout-ms \
         {start_ms:.0}; lower `every`, or raise the timeout"
    )]
    SlowStart { turns: u32, round_ms: f64, start_ms: f64 },

    // Motors.
    #[error("there is no bus {0:?}; {1}")]
    UnknownBus(String, String),
    #[error("{bus:?} is a serial bus, and {protocol:?} is spoken over CAN only; use protocol = \"gim\"")]
    OnlyOverCan { bus: String, protocol: &'static str },
    #[error("motors of {motors} do not speak the protocol {protocol:?}; use protocol = {spoken:?}")]
    NotSpoken { motors: &'static str, protocol: &'static str, spoken: &'static str },
    #[error("a command of this protocol has no duration; remove it, or use protocol = \"gim\"")]
    NoDuration,
    #[error(
        "a command that ends after {duration_ms} ms can end before the next, which comes every {round_ms} ms; give it at least {least_ms} ms, or 0 for none"
    )]
    ShortDuration { duration_ms: i64, round_ms: f64, least_ms: f64 },
    #[error("its group cannot be enabled without this joint; add may-be-excluded = true if it may")]
    NeedlesslyExcluded,
    #[error("unknown model {model:?}; {hint}")]
    UnknownModel { model: String, hint: String },
    #[error("has no effect on a {model}, whose torque code is in N·m and not a current; remove it")]
    NoCurrentCode { model: &'static str },
    #[error(
        "has no effect on a {model}, whose codes end where its torque constant and gear ratio say, or which has none; remove it"
    )]
    NoEnds { model: &'static str },
    #[error(
        "{value} {unit} is beyond ±{end} {unit}, where the codes of a {model} end: a motor that reaches it has other codes, and gives \
         other torques and velocities than it is sent; name its model, give {key} as its manual has it, or lower this to {end}",
        unit = unit_and_key[0],
        key = unit_and_key[1],
    )]
    BeyondCodes { value: f64, end: f64, model: &'static str, unit_and_key: &'static [&'static str; 2] },
    #[error(
        "is missing, and the sources differ on the largest torque code of {motors}: 24 N·m in the protocol document V4.2, 18 N·m in a \
         driver for V4.3, and other values for large models; read it in the vendor's tool or its document for this motor and firmware, \
         and write torque-end-nm: with a wrong one each torque is wrong by the same factor"
    )]
    NoTorqueEnd { motors: &'static str },
    #[error("id {id} is used by {other:?} on the same bus; give every motor of a bus its own")]
    DuplicateId { id: u8, other: String },
    #[error(
        "node id {node} owns the ids {:#05x} to {:#05x} of its bus, and {id:#05x} is for {what} of the motor {other:?}: one \
         would read the other's frames as commands; give the node another id (`motorctl id --protocol cansimple`), or another bus",
        u16::from(*node) << 5,
        u16::from(*node) << 5 | 0x1F
    )]
    NodeOwnsId { node: u8, id: u16, what: &'static str, other: String },
    #[error(
        "id {host_id:#05x} is a motor's command id on the same bus, and only one node may send an id; the default of this motor is {default:#05x}"
    )]
    HostIdIsCommandId { host_id: u32, default: u16 },
    #[error(
        "id {host_id:#05x} is the reply id of {other:?} too, so replies could not be told apart; the default of this motor is {default:#05x}"
    )]
    DuplicateHostId { host_id: u32, other: String, default: u16 },
    #[error(
        "motors of {motors} reply with the id {host_id:#05x} like {other:?}, and replies that begin together destroy each other: a bus \
         carries one such motor; give this one another bus"
    )]
    SharedReplies { host_id: u32, other: String, motors: &'static str },
    #[error(
        "host id {host_id:#04x} is that of {other:?} on the same line too, so a late reply of one can be taken for the other's; give every motor of the line its own, here and with `motorctl id --set-host-id`"
    )]
    SharedHostId { host_id: u32, other: String },
    #[error(
        "replies with id {host_id:#05x} outrank commands with id {command:#05x} on this bus and delay them; the default of this motor is {default:#05x}"
    )]
    HostIdOutranks { host_id: u32, command: u32, default: u16 },
    #[error("direction {0} is neither 1 nor -1; give one of them, and the gear ratio by gear-ratio")]
    Direction(i64),
    #[error(
        "expected two numbers, the lowest and the highest position, found {0}; write decimals with a point, such as position-rad = \
         [-0.5, 0.5]"
    )]
    PositionCount(usize),
    #[error("the lowest position {low} is not below the highest {high}; exchange them, or widen the range")]
    PositionOrder { low: f64, high: f64 },
    #[error(
        "{} is beyond ±{end} at the motor, the end of its protocol's scale; use at most {usable} there{degrees}", Shown(*.value)
    )]
    BeyondScale { value: f64, end: f64, usable: f64, degrees: String },
    #[error(
        "{value} is at the end of the protocol's scale (±{end} at the motor), where a command can equal a special frame \
         and a reply can be a clamped one; use at most {usable} there"
    )]
    NoMargin { value: f64, end: f64, usable: f64 },
    #[error(
        "is not given, so the joint may turn from {low} to {high} rad; write the ends of its travel, such as position-rad = \
         [-0.5, 0.5]"
    )]
    NoPositionLimits { low: f64, high: f64 },
    #[error(
        "{value} rad/s is more than the {fastest} rad/s that the motor reaches without load, so it limits nothing; lower it, or \
         give max-velocity-rad-s as it is at your supply voltage"
    )]
    FasterThanMotor { value: f64, fastest: f64 },
    #[error(
        "{value} rad/s is {:.1} times the {known} rad/s that a {model} reaches without load; check unit, model and supply voltage: the \
         default of velocity-rad-s and the check for jumps of the position follow it", value / known
    )]
    FasterThanModel { value: f64, model: &'static str, known: f64 },
    #[error("{value} N·m is more than the motor's peak of {peak} N·m; lower it, or correct peak-torque-nm")]
    BeyondPeak { value: f64, peak: f64 },
    #[error(
        "0 does not damp, but the safe stop of the motor's group does; give a damping, or safe-stop = \"stop\" to the group"
    )]
    NoDamping,
    #[error("a GIM motor does not use it: the speed loop of its drive brakes it in a safe stop; remove it")]
    DampingUnused,
    #[error(
        "{damping} is more than limits.kd-max {kd_max}; a safe stop could not apply it: lower it, or raise kd-max"
    )]
    DampingBeyondLimit { damping: f64, kd_max: f64 },
    #[error("is compared too rarely: write at least {least_hz} for cycle.indicator-hz")]
    SupplyNotAsked { least_hz: f64 },
    #[error(
        "no motor of group {group:?} reports its supply; write 0 for this group, or remove it: the protocols gim, robstride, cansimple, myactuator and odrive report it"
    )]
    SupplyNotReported { group: String },
    #[error(
        "bus {bus:?} has no time for the question: the cycle may have at most {rate_hz_max} Hz for that; lower cycle.rate-hz, or use fewer motors on the bus"
    )]
    NoTimeForSupply { bus: String, rate_hz_max: f64 },
    #[error("stops at {stop} V, not below {warn} V where the warning begins; lower it")]
    SupplyStopBeforeWarning { warn: f32, stop: f32 },
    #[error(
        "the state of {motor:?} is what an ODrive sends by itself, at most every ms, every 10 ms from the factory, and each motor of the bus has a turn of {turn_ms} ms; write the interval of its reports as `every`, in cycles"
    )]
    TurnBeforeReports { motor: String, turn_ms: f64 },
    #[error("derating begins at {derate} °C, not below {max} °C where the torque must be zero; lower it")]
    DerateOrder { derate: f64, max: f64 },
    #[error(
        "{value} rad is outside the joint's position limits {low} to {high} rad; start the simulation inside them{degrees}"
    )]
    InitialPosition { value: f64, low: f32, high: f32, degrees: String },

    // Groups.
    #[error("there is no motor {0:?}; {1}")]
    UnknownJoint(String, String),
    #[error(
        "{joint:?} is in group {group:?} already; a joint has one owner, so remove it from one of the groups"
    )]
    JointInTwoGroups { joint: String, group: String },
    #[error("motor {0:?} is in no group, so no client could move it; add it to one")]
    JointInNoGroup(String),
    #[error("{count} motors are in no group, so no client could move them; add them to one: {names}")]
    JointsInNoGroup { count: usize, names: String },
    #[error("the group has no joints; list some, or remove it")]
    EmptyGroup,
}

impl Wrong {
    /// Bytes that are not UTF-8: text in another encoding, or no text.
    pub(super) fn no_utf8(bytes: &[u8]) -> Self {
        let is_of_text = |byte: &u8| !byte.is_ascii_control() || byte.is_ascii_whitespace();
        if bytes.iter().all(is_of_text) { Self::NotUtf8 } else { Self::NoText }
    }

    /// Converts a message of the TOML library about `excerpt`, where nothing better is known.
    pub(super) fn toml(message: &str, excerpt: &str) -> Self {
        let excerpt: String = excerpt.lines().next().unwrap_or_default().chars().take(40).collect();
        let about = if excerpt.is_empty() { String::new() } else { format!("`{excerpt}`: ") };
        Self::Toml(plain(&format!("{about}{message}; docs/configuration.md shows the form")))
    }
}

/// Escapes characters that a terminal obeys or hides: a problem is one line, and a file must not
/// control the terminal.
pub(super) fn plain(text: &str) -> String {
    printable_line(text).into_owned()
}
