//! `motorctl frame`: converts frames to JSON objects, and back.
//!
//! One object per frame, with the same keys in both directions. `encode` reads the output of
//! `decode`. The command needs no daemon and no bus.
//!
//! `motorctl models`: the known motors, and the frames of a vendor's file.

#![forbid(unsafe_code)]

mod agreement;
mod codec;
mod gim;
mod golden;
mod hex;
mod input;
mod log;
mod member;
mod mit;
mod models;
mod null_bytes;
mod object;
mod options;
mod output;
mod rejected;
mod robot;
mod scale;
mod serial;
mod strict;

pub use models::{ModelsArguments, run_models};
pub use rejected::FrameFailure;

use clap::{Args, Subcommand};
use codec::Codec;
use input::{Decoder, Frames};
use object::Object;
use options::{AnsweredCommand, Constants, Direction, FrameProtocol};
use output::ObjectWriter;
use rejected::Rejected;
use robot::LoggedRobot;
use std::io::{self, Read};
use std::path::PathBuf;
use strict::Strict;

/// Limit on the objects of standard input, bytes.
const INPUT_BYTES_MAX: u64 = 64 << 20;

/// The two directions of conversion.
#[derive(Debug, Subcommand)]
pub enum FrameCommand {
    /// Decode frames into JSON objects, one per line.
    ///
    /// A frame that cannot be decoded prints {"kind":"reject","reason":…}, of a file also with its line (or the number of its
    /// packet), and of a log with its time and interface. So do a bus-off, other error frames, CAN FD, remote and 29-bit
    /// frames. The exit status is then 65.
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
    "motorctl frame decode [OPTIONS] --protocol <PROTOCOL> --direction <DIRECTION> <HEX|FILE|->...
       motorctl frame decode --config <FILE> [--protocol <PROTOCOL>] [--interface <NAME>] <FILE|->...";

const DECODE_EXAMPLES: &str = "\
Examples:
  motorctl frame decode --protocol mit --direction to-motor --torque-constant 0.125 --gear-ratio 8 \\
      8A3D80F19A333816
  motorctl frame decode --protocol mit --direction to-host --asked get_fault '101#01 02 00 00 00 00'
  motorctl frame decode --protocol gim-rs485 --direction to-motor 010008099100000000000000
  candump can0 | motorctl frame decode --config /etc/motord/motord.toml -
  motorctl frame decode --config /etc/motord/motord.toml candump-2026-03-01_101500.log
  motorctl frame decode --config /etc/motord/motord.toml --interface can0 \\
      trace.trc vector.asc

A log is the output of candump (with -L or -l, or the default form with any -t), a log of Vector (.asc) or a log of PEAK
(.trc). The first line decides, not the name. Logs of Vector and PEAK have numbers instead of interfaces: number N is the Nth
interface of the configuration, in the order of its [[bus]] tables, unless --interface names it. Their `time` is that of the
file; dates count as UTC.";

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
    protocol: Option<FrameProtocol>,
    /// Direction of the frames.
    #[arg(long, value_enum, required_unless_present = "config")]
    direction: Option<Direction>,
    #[command(flatten)]
    constants: Constants,
    /// The command that a reply answers. Some replies depend on it.
    #[arg(long, value_enum, default_value_t = AnsweredCommand::State)]
    asked: AnsweredCommand,
    /// Configuration of motord. Logs are decoded with the names, protocols and constants of its motors.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["direction", "asked", "torque_constant"])]
    config: Option<PathBuf>,
    /// Interface of the frames of logs that name none: logs of Vector and PEAK.
    #[arg(long, value_name = "NAME")]
    interface: Option<String>,
    /// Accepted as by other commands: the output is JSON in any case.
    #[arg(long)]
    json: bool,
    /// Frames in hexadecimal, or names of files with frames or logs. Spaces, and an id before `#`, are allowed. `-` reads
    /// standard input, one frame per line. A file whose name is hexadecimal needs its folder: ./AB.
    #[arg(required = true, value_name = "HEX|FILE")]
    frames: Vec<String>,
}

#[expect(missing_docs, reason = "clap would show it in place of the text of the command")]
#[derive(Debug, Args)]
pub struct Encode {
    /// Protocol of the frames.
    #[arg(long, value_enum)]
    protocol: FrameProtocol,
    /// Direction of the frames.
    #[arg(long, value_enum)]
    direction: Direction,
    #[command(flatten)]
    constants: Constants,
    /// Fill the unused bytes of GIM commands so that a motor in MIT mode reads zero torque.
    #[arg(long)]
    mit_safe: bool,
    /// JSON objects. `-` reads them from standard input.
    #[arg(value_name = "OBJECT", default_value = "-")]
    objects: Vec<String>,
}

/// Runs `motorctl frame`: from its arguments or standard input to standard output.
///
/// # Errors
///
/// An input was rejected, or cannot be read.
pub fn run(frame: FrameCommand) -> Result<(), FrameFailure> {
    match frame {
        FrameCommand::Decode(arguments) => decode_all(&arguments),
        FrameCommand::Encode(arguments) => encode_all(&arguments),
    }
}

fn decode_all(arguments: &Decode) -> Result<(), FrameFailure> {
    let mut report = ObjectWriter::default();
    let Decode { protocol, direction, constants, asked, config, interface, json: _, frames } = arguments;
    let source = match (config, *protocol, *direction) {
        (Some(path), protocol, _) => Frames::OfRobot(LoggedRobot::read(path, protocol)?),
        (None, Some(protocol), Some(direction)) => {
            let (profile, scale) = (constants.profile.profile, constants.scale()?);
            Frames::Alike(Box::new(Codec { protocol, direction, asked: *asked, profile, scale }))
        }
        // The command line requires both.
        (None, ..) => return Ok(()),
    };
    let mut decoder = Decoder { frames: source, interface: interface.as_deref(), report: &mut report };
    for argument in frames {
        decoder.argument(argument)?;
    }
    report.finish()
}

fn encode_all(arguments: &Encode) -> Result<(), FrameFailure> {
    let mut report = ObjectWriter::default();
    let Encode { protocol, direction, .. } = *arguments;
    let (profile, scale) = (arguments.constants.profile.profile, arguments.constants.scale()?);
    let reading = Codec { protocol, direction, asked: AnsweredCommand::State, profile, scale };
    for argument in &arguments.objects {
        let text = if argument == "-" { read_input()? } else { argument.clone() };
        for given in serde_json::Deserializer::from_str(&text).into_iter::<Strict>() {
            let object = given.map_err(Rejected::Json).and_then(Object::given);
            let bytes = object.and_then(|object| reading.encode(object, arguments.mit_safe));
            report.line(bytes.map(|bytes| hex::digits(&bytes)))?;
        }
    }
    report.finish()
}

/// Returns the objects on standard input, whole.
fn read_input() -> io::Result<String> {
    let mut text = String::new();
    io::stdin().take(INPUT_BYTES_MAX + 1).read_to_string(&mut text)?;
    if text.len() as u64 > INPUT_BYTES_MAX {
        let reason = "the input is larger than 64 MiB: encode it in parts";
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, reason));
    }
    Ok(text)
}
