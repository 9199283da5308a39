//! `motorctl frame`: frames to JSON objects, and back.
//!
//! One object per frame, with the same keys in both directions, so that what one command prints the other reads. It needs
//! no daemon and no bus: logs and frames typed by hand are enough.

mod agreement;
mod gim;
mod hex;
mod member;
mod mit;
mod null_bytes;
mod object;
mod refused;
mod robot;
mod scale;
mod serial;

use clap::{Args, Subcommand, ValueEnum};
use motord_protocol::profile::PROFILES;
use motord_protocol::{Model, Profile, ScaleError};
use object::Object;
use refused::Refused;
use robot::{Robot, RobotError};
use scale::Scale;
use serde_json::{Value, json};
use std::io::{self, BufRead, Write};
use std::path::PathBuf;
use std::str::FromStr;

/// The two ways.
#[derive(Debug, Subcommand)]
pub(crate) enum Frame {
    /// Decode frames, one JSON object a line.
    ///
    /// A frame that cannot be read gives {"kind":"reject","reason":…} and, in the end, exit status 65.
    #[command(override_usage = DECODE_USAGE, after_help = DECODE_EXAMPLES)]
    Decode(Decode),
    /// Encode JSON objects as `decode` prints them, one frame in hexadecimal a line.
    ///
    /// Quantities are physical values (pos_rad, vel_rad_s, kp, kd, torque_nm) or raw codes (pos_int, vel_int, kp_int,
    /// kd_int, torque_int); where both are given they must agree. An object that is no frame, has an unknown key or
    /// contradicts itself gives {"kind":"reject","reason":…} and, in the end, exit status 65.
    #[command(after_help = ENCODE_EXAMPLES)]
    Encode(Encode),
}

const DECODE_USAGE: &str =
    "motorctl frame decode [OPTIONS] --protocol <PROTOCOL> --direction <DIRECTION> <HEX>...
       motorctl frame decode --config <FILE> [--protocol <PROTOCOL>] -";

const DECODE_EXAMPLES: &str = "\
Examples:
  motorctl frame decode --protocol mit --direction to-motor --torque-constant 0.125 --gear-ratio 8 \\
      8A3D80F19A333816
  motorctl frame decode --protocol mit --direction to-host --asked get_fault '101#01 02 00 00 00 00'
  motorctl frame decode --protocol gim-rs485 --direction to-motor 010008099100000000000000
  candump -L can0 | motorctl frame decode --config /etc/motord/motord.toml -";

const ENCODE_EXAMPLES: &str = "\
Examples:
  motorctl frame encode --protocol mit --direction to-motor '{\"kind\":\"stop_motor\"}'
  motorctl frame encode --protocol mit --direction to-motor --torque-constant 0.125 --gear-ratio 8 \\
      '{\"kind\":\"dynamic_control\",\"pos_rad\":1.0,\"vel_rad_s\":0,\"kp\":50,\"kd\":1,\"torque_nm\":2}'
  motorctl frame encode --protocol gim-can --direction to-motor --mit-safe '{\"kind\":\"stop_motor\"}'";

#[derive(Debug, Args)]
pub(crate) struct Decode {
    /// With --config, in place of what it says of every motor: for logs of motors that were set to another one then.
    #[arg(long, value_enum, required_unless_present = "config")]
    protocol: Option<Protocol>,
    #[arg(long, value_enum, required_unless_present = "config")]
    direction: Option<Direction>,
    #[command(flatten)]
    constants: Constants,
    /// The request that the frame answers, where the meaning of the frame depends on it.
    #[arg(long, value_enum, default_value_t = Asked::State)]
    asked: Asked,
    /// A motord configuration: decode lines of `candump -L` with the names, protocols and constants of its motors.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["direction", "asked", "torque_constant"])]
    config: Option<PathBuf>,
    /// Frames in hexadecimal, with or without spaces and an id before `#`; `-` reads them from standard input, one a
    /// line.
    #[arg(required = true, value_name = "HEX")]
    frames: Vec<String>,
}

#[derive(Debug, Args)]
pub(crate) struct Encode {
    #[arg(long, value_enum)]
    protocol: Protocol,
    #[arg(long, value_enum)]
    direction: Direction,
    #[command(flatten)]
    constants: Constants,
    /// Fill the free bytes of native commands such that a motor in MIT mode takes them for no torque.
    #[arg(long)]
    mit_safe: bool,
    /// JSON objects; `-`, or none, reads them from standard input.
    #[arg(value_name = "OBJECT", default_value = "-")]
    objects: Vec<String>,
}

/// The scale of the torque codes.
#[derive(Debug, Args)]
struct Constants {
    /// The rotor's torque constant, N·m/A. Without it torques are raw codes only.
    #[arg(long, value_name = "X", requires = "gear_ratio")]
    torque_constant: Option<f64>,
    /// Rotor turns per turn of the output shaft.
    #[arg(long, value_name = "Y", requires = "torque_constant")]
    gear_ratio: Option<f64>,
    /// Whose MIT it is: a profile (steadywin and others) or, so that codes get their physical values, a model
    /// (GIM8108-8).
    #[arg(long, value_name = "NAME", default_value = "steadywin")]
    profile: Facts,
}

/// A profile, by its own name or by that of a model.
#[derive(Debug, Clone, Copy)]
struct Facts {
    profile: &'static Profile,
    model: Option<&'static Model>,
}

impl FromStr for Facts {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        if let Some(profile) = Profile::by_name(name) {
            return Ok(Self { profile, model: None });
        }
        let model = Profile::of_model(name).map(|(profile, model)| Self { profile, model: Some(model) });
        model.ok_or_else(|| {
            let names: Vec<_> = PROFILES.iter().map(|profile| profile.name).collect();
            format!("neither a model nor one of the profiles {}", names.join(", "))
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Protocol {
    /// Impedance control over CAN.
    Mit,
    /// Native commands over CAN.
    GimCan,
    /// Native commands over RS485 and RS232.
    GimRs485,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Direction {
    /// Commands.
    #[value(alias = "to_motor")]
    ToMotor,
    /// Replies.
    #[value(alias = "to_host")]
    ToHost,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Asked {
    /// Any command not listed here.
    State,
    /// The MIT reply holds the fault number.
    #[value(alias = "get-fault")]
    GetFault,
    /// The MIT reply holds nothing.
    #[value(alias = "clear-fault")]
    ClearFault,
    /// A native reply that begins with B4 is no indicator.
    Calibration,
}

/// How to read one frame.
#[derive(Debug, Clone, Copy)]
struct Reading {
    protocol: Protocol,
    direction: Direction,
    asked: Asked,
    profile: &'static Profile,
    scale: Option<Scale>,
}

impl Reading {
    /// The object of a frame.
    fn decode(&self, bytes: &[u8]) -> Result<Object, Refused> {
        let object = Object::new(self.profile, self.scale);
        match (self.protocol, self.direction) {
            (Protocol::Mit, Direction::ToMotor) => mit::decode_command(bytes, object),
            (Protocol::Mit, Direction::ToHost) => mit::decode_reply(bytes, self.asked, object),
            (Protocol::GimCan, Direction::ToMotor) => gim::decode_command(bytes, object),
            (Protocol::GimCan, Direction::ToHost) => gim::decode_reply(bytes, self.asked, object),
            (Protocol::GimRs485, direction) => serial::decode(bytes, direction, self.asked, object),
        }
    }

    /// The frame of an object. The frame is decoded again, and an object that says anything else is refused.
    fn encode(&self, object: Object, mit_safe: bool) -> Result<Vec<u8>, Refused> {
        let object = object.with_scale(self.profile, self.scale)?;
        let bytes = match (self.protocol, self.direction) {
            (Protocol::Mit, Direction::ToMotor) => mit::command(&object)?.encode().to_vec(),
            (Protocol::Mit, Direction::ToHost) => mit::encode_reply(&object)?,
            (Protocol::GimCan, Direction::ToMotor) => gim::encode_command(&object, mit_safe)?,
            (Protocol::GimCan, Direction::ToHost) => gim::encode_reply(&object)?,
            (Protocol::GimRs485, direction) => serial::encode(&object, direction, mit_safe)?,
        };
        let asked = match object.kind()? {
            "fault_reply" => Asked::GetFault,
            "clear_fault_reply" => Asked::ClearFault,
            "calibration" => Asked::Calibration,
            _ => Asked::State,
        };
        let decoded = Self { asked, scale: object.scale(), ..*self }.decode(&bytes)?;
        agreement::check(&object, &decoded)?;
        Ok(bytes)
    }
}

/// Why the command did not do all it was asked to.
#[derive(Debug, thiserror::Error)]
pub(crate) enum FrameFailure {
    /// Some frames were refused. Each has told its reason in the output.
    #[error("{refused} of {total} refused")]
    Refused {
        /// How many.
        refused: usize,
        /// Of how many.
        total: usize,
    },
    /// The torque constant or the gear ratio is no positive number.
    #[error(transparent)]
    Scale(#[from] ScaleError),
    /// The configuration cannot be used.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Standard input or output failed.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl FrameFailure {
    /// The exit status, of sysexits(3).
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Refused { .. } => 65,
            Self::Scale(_) => 64,
            Self::Robot(_) => 78,
            Self::Io(_) => 74,
        }
    }
}

/// Runs `motorctl frame`.
pub(crate) fn run(frame: Frame) -> Result<(), FrameFailure> {
    match frame {
        Frame::Decode(arguments) => decode_all(&arguments),
        Frame::Encode(arguments) => encode_all(&arguments),
    }
}

impl Constants {
    fn scale(&self) -> Result<Option<Scale>, ScaleError> {
        match (self.torque_constant.zip(self.gear_ratio), self.profile.model) {
            (Some((constant, ratio)), Some(model)) => Scale::of_model(model, constant, ratio).map(Some),
            (Some((constant, ratio)), None) => Scale::new(constant, ratio).map(Some),
            (None, Some(model)) => {
                let (constant, ratio) = (model.torque_constant.into(), model.gear_ratio.into());
                Scale::of_model(model, constant, ratio).map(Some)
            }
            (None, None) => Ok(None),
        }
    }
}

fn decode_all(arguments: &Decode) -> Result<(), FrameFailure> {
    let mut report = Report::default();
    let Decode { protocol, direction, constants, asked, config, frames } = arguments;
    if let Some(path) = config {
        let mut robot = Robot::read(path, *protocol)?;
        for_each_line(frames, |line| report.object(robot.decode(line)))?;
    } else if let (Some(protocol), Some(direction)) = (*protocol, *direction) {
        let (profile, scale) = (constants.profile.profile, constants.scale()?);
        let reading = Reading { protocol, direction, asked: *asked, profile, scale };
        for_each_line(frames, |line| {
            report.object(hex::bytes_of_frame(line).and_then(|bytes| reading.decode(&bytes)))
        })?;
    }
    report.finish()
}

fn encode_all(arguments: &Encode) -> Result<(), FrameFailure> {
    let mut report = Report::default();
    let Encode { protocol, direction, .. } = *arguments;
    let (profile, scale) = (arguments.constants.profile.profile, arguments.constants.scale()?);
    let reading = Reading { protocol, direction, asked: Asked::State, profile, scale };
    for argument in &arguments.objects {
        let text = if argument == "-" { io::read_to_string(io::stdin())? } else { argument.clone() };
        for value in serde_json::Deserializer::from_str(&text).into_iter::<Value>() {
            let bytes = value
                .and_then(serde_json::from_value)
                .map_err(Refused::Json)
                .and_then(|object| reading.encode(object, arguments.mit_safe));
            report.line(bytes.map(|bytes| hex::digits(&bytes)))?;
        }
    }
    report.finish()
}

/// Calls `act` with every argument, and in place of `-` with every line of standard input that is not blank.
fn for_each_line(
    arguments: &[String],
    mut act: impl FnMut(&str) -> Result<(), io::Error>,
) -> Result<(), io::Error> {
    for argument in arguments {
        if argument != "-" {
            act(argument)?;
            continue;
        }
        for line in io::stdin().lock().split(b'\n') {
            let line = line?;
            let line = String::from_utf8_lossy(&line);
            if !line.trim().is_empty() {
                act(line.trim())?;
            }
        }
    }
    Ok(())
}

/// The count of printed lines.
#[derive(Default)]
struct Report {
    refused: usize,
    total: usize,
}

impl Report {
    fn object(&mut self, object: Result<Object, Refused>) -> Result<(), io::Error> {
        self.line(object.map(|object| Value::from(object).to_string()))
    }

    fn line(&mut self, line: Result<String, Refused>) -> Result<(), io::Error> {
        self.total += 1;
        let line = line.unwrap_or_else(|refused| {
            self.refused += 1;
            json!({ "kind": "reject", "reason": refused.to_string() }).to_string()
        });
        writeln!(io::stdout(), "{line}")
    }

    fn finish(self) -> Result<(), FrameFailure> {
        let Self { refused, total } = self;
        if refused == 0 { Ok(()) } else { Err(FrameFailure::Refused { refused, total }) }
    }
}
