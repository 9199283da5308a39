//! `motorctl frame`: frames to JSON objects, and back.
//!
//! One object per frame, with the same keys in both directions, so that what one command prints the other reads. It needs
//! no daemon and no bus: logs and frames typed by hand are enough.

#![forbid(unsafe_code)]

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
mod strict;

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
use strict::Strict;

/// The two directions of conversion.
#[derive(Debug, Subcommand)]
pub enum Frame {
    /// Decode frames into JSON objects, one per line.
    ///
    /// A frame that cannot be decoded prints {"kind":"reject","reason":…}. The exit status is then 65.
    #[command(override_usage = DECODE_USAGE, after_help = DECODE_EXAMPLES)]
    Decode(Decode),
    /// Encode JSON objects, in the format of `decode`, into hexadecimal frames, one per line.
    ///
    /// Quantities are physical values (pos_rad, vel_rad_s, kp, kd, torque_nm) or raw codes (pos_int, vel_int, kp_int,
    /// kd_int, torque_int). If an object has both, they must agree. An object that is not a frame, has an unknown key or
    /// contradicts itself prints {"kind":"reject","reason":…}. The exit status is then 65.
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

#[expect(missing_docs, reason = "clap would show it in place of the text of the command")]
#[derive(Debug, Args)]
pub struct Decode {
    /// Protocol of the frames. With --config it replaces the configured protocol of every motor.
    #[arg(long, value_enum, required_unless_present = "config")]
    protocol: Option<Protocol>,
    /// Direction of the frames.
    #[arg(long, value_enum, required_unless_present = "config")]
    direction: Option<Direction>,
    #[command(flatten)]
    constants: Constants,
    /// The command that a reply answers. The meaning of some replies depends on it.
    #[arg(long, value_enum, default_value_t = Asked::State)]
    asked: Asked,
    /// Configuration of motord. Decodes lines of `candump -L` with the names, protocols and constants of its motors.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["direction", "asked", "torque_constant"])]
    config: Option<PathBuf>,
    /// Frames in hexadecimal. Spaces, and an id before `#`, are allowed. `-` reads frames from standard input, one per
    /// line.
    #[arg(required = true, value_name = "HEX")]
    frames: Vec<String>,
}

#[expect(missing_docs, reason = "clap would show it in place of the text of the command")]
#[derive(Debug, Args)]
pub struct Encode {
    /// Protocol of the frames.
    #[arg(long, value_enum)]
    protocol: Protocol,
    /// Direction of the frames.
    #[arg(long, value_enum)]
    direction: Direction,
    #[command(flatten)]
    constants: Constants,
    /// Fill the unused bytes of native commands so that a motor in MIT mode reads zero torque from them.
    #[arg(long)]
    mit_safe: bool,
    /// JSON objects. `-` reads them from standard input.
    #[arg(value_name = "OBJECT", default_value = "-")]
    objects: Vec<String>,
}

/// The scale of the torque codes.
#[derive(Debug, Args)]
struct Constants {
    /// Torque constant of the rotor, N·m/A. Without it, or a model, torques are raw codes only.
    #[arg(long, value_name = "X", requires = "gear_ratio")]
    torque_constant: Option<f64>,
    /// Rotor turns per turn of the output shaft.
    #[arg(long, value_name = "Y", requires = "torque_constant")]
    gear_ratio: Option<f64>,
    /// Vendor profile of the MIT protocol (steadywin and others), or a motor model (GIM8108-8). A model also gives codes
    /// their physical values.
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
            format!("expected a motor model, or one of the profiles {}", names.join(", "))
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
    /// Commands from the host to a motor.
    #[value(alias = "to_motor")]
    ToMotor,
    /// Replies from a motor to the host.
    #[value(alias = "to_host")]
    ToHost,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Asked {
    /// Any command that is not in this list.
    State,
    /// Get fault: the MIT reply holds the fault number.
    #[value(alias = "get-fault")]
    GetFault,
    /// Clear fault: the MIT reply holds no data.
    #[value(alias = "clear-fault")]
    ClearFault,
    /// Calibration: a native reply that begins with B4 is its result, not an indicator.
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
        if object.has(gim::AS_MIT) {
            self.check_as_mit(&object, &bytes)?;
        }
        Ok(bytes)
    }

    /// The object says how a motor in MIT mode reads the command: it must read it so.
    fn check_as_mit(&self, object: &Object, bytes: &[u8]) -> Result<(), Refused> {
        let payload = match (self.protocol, self.direction) {
            (Protocol::GimCan, Direction::ToMotor) => bytes,
            (Protocol::GimRs485, Direction::ToMotor) => serial::payload(bytes),
            _ => return Err(Refused::UnknownKey { key: gim::AS_MIT.into() }),
        };
        let given = object.object(gim::AS_MIT)?.with_scale(self.profile, self.scale)?;
        let read = mit::decode_command(payload, Object::new(self.profile, given.scale()))?;
        agreement::check(&given, &read)?;
        if mit::command(&given)? == mit::command(&read)? {
            return Ok(());
        }
        let (received, expected) = (Value::from(given).to_string(), Value::from(read).to_string());
        Err(Refused::Contradiction { key: gim::AS_MIT.into(), received, expected })
    }
}

/// Why the command did not do all it was asked to.
#[derive(Debug, thiserror::Error)]
pub enum FrameFailure {
    /// Some frames were refused. The output holds the reason of each.
    #[error("{refused} of {total} inputs were rejected")]
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
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Refused { .. } => 65,
            Self::Scale(_) => 64,
            Self::Robot(_) => 78,
            Self::Io(_) => 74,
        }
    }
}

/// Runs `motorctl frame`: from its arguments or standard input to standard output.
///
/// # Errors
///
/// When an input was refused, or could not be read.
pub fn run(frame: Frame) -> Result<(), FrameFailure> {
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
        for given in serde_json::Deserializer::from_str(&text).into_iter::<Strict>() {
            let object = given.map_err(Refused::Json).and_then(Object::given);
            let bytes = object.and_then(|object| reading.encode(object, arguments.mit_safe));
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
