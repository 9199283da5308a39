//! `motorctl frame`: converts frames to JSON objects, and back.
//!
//! One object per frame, with the same keys in both directions. `encode` reads the output of
//! `decode`. The command needs no daemon and no bus.

#![forbid(unsafe_code)]

mod agreement;
mod codec;
mod failure;
mod gim;
mod hex;
mod member;
mod mit;
mod null_bytes;
mod object;
mod options;
mod output;
mod rejected;
mod robot;
mod scale;
mod serial;
mod strict;

pub use failure::FrameFailure;

use clap::{Args, Subcommand};
use codec::Codec;
use object::Object;
use options::{AnsweredCommand, Constants, Direction, FrameProtocol};
use output::ObjectWriter;
use rejected::Rejected;
use robot::LoggedRobot;
use std::io::{self, BufRead, BufReader, Read};
use std::path::PathBuf;
use strict::Strict;

/// Limit on a line of standard input, bytes. A frame has at most a few hundred; the rest of a longer
/// line is skipped.
const LINE_BYTES_MAX: usize = 4096;
/// Limit on the objects of standard input, and on one of its lines, bytes.
const INPUT_BYTES_MAX: u64 = 64 << 20;

/// The two directions of conversion.
#[derive(Debug, Subcommand)]
pub enum FrameCommand {
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
    protocol: Option<FrameProtocol>,
    /// Direction of the frames.
    #[arg(long, value_enum, required_unless_present = "config")]
    direction: Option<Direction>,
    #[command(flatten)]
    constants: Constants,
    /// The command that a reply answers. Some replies depend on it.
    #[arg(long, value_enum, default_value_t = AnsweredCommand::State)]
    asked: AnsweredCommand,
    /// Configuration of motord. Lines of `candump -L` are decoded with the names, protocols and
    /// constants of its motors.
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
    let Decode { protocol, direction, constants, asked, config, frames } = arguments;
    if let Some(path) = config {
        let mut robot = LoggedRobot::read(path, *protocol)?;
        for_each_line(frames, &mut report, |line| robot.decode(line))?;
    } else if let (Some(protocol), Some(direction)) = (*protocol, *direction) {
        let (profile, scale) = (constants.profile.profile, constants.scale()?);
        let reading = Codec { protocol, direction, asked: *asked, profile, scale };
        let decode = |line: &str| hex::bytes_of_frame(line).and_then(|bytes| reading.decode(&bytes));
        for_each_line(frames, &mut report, decode)?;
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

/// Prints the object of every argument; for `-`, of every line of standard input that is not blank.
/// Prints each immediately if no further line has arrived.
fn for_each_line(
    arguments: &[String],
    report: &mut ObjectWriter,
    mut decode: impl FnMut(&str) -> Result<Object, Rejected>,
) -> Result<(), io::Error> {
    for argument in arguments {
        if argument != "-" {
            report.object(decode(argument))?;
            continue;
        }
        let (mut input, mut line) = (BufReader::new(io::stdin().lock()), Vec::new());
        while read_line(&mut input, &mut line)? {
            let text = String::from_utf8_lossy(&line);
            if !text.trim().is_empty() {
                report.object(decode(text.trim()))?;
            }
            if !input.buffer().contains(&b'\n') {
                report.flush()?;
            }
        }
    }
    Ok(())
}

/// Replaces `line` by the next line, of which it keeps [`LINE_BYTES_MAX`] bytes. Returns `false` at
/// the end of the input. A line of more than [`INPUT_BYTES_MAX`] bytes is an error: it may have no
/// end.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    let (mut is_begun, mut skipped) = (false, 0);
    loop {
        let arrived = input.fill_buf()?;
        if arrived.is_empty() {
            return Ok(is_begun);
        }
        is_begun = true;
        let end = arrived.iter().position(|byte| *byte == b'\n');
        let (part, used) = end.map_or((arrived, arrived.len()), |end| (&arrived[..end], end + 1));
        let kept = part.len().min(LINE_BYTES_MAX - line.len());
        line.extend_from_slice(&part[..kept]);
        skipped += (part.len() - kept) as u64;
        input.consume(used);
        if skipped > INPUT_BYTES_MAX {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line has no end: this is no text"));
        }
        if end.is_some() {
            return Ok(true);
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endless_line_is_cut_and_next_one_whole() {
        let long = vec![b'A'; 10 * LINE_BYTES_MAX];
        let text = [b"01\n\n", &long[..], b"\n02"].concat();
        let mut input = BufReader::with_capacity(1000, &text[..]);
        let (mut line, mut lengths) = (Vec::new(), Vec::new());
        while read_line(&mut input, &mut line).is_ok_and(|is_line| is_line) {
            lengths.push(line.len());
        }
        assert_eq!(lengths, [2, 0, LINE_BYTES_MAX, 2]);
        assert_eq!(line, b"", "the end of the input");
        let mut endless = BufReader::new(io::repeat(0));
        assert!(read_line(&mut endless, &mut line).is_err());
        assert!(line.len() <= LINE_BYTES_MAX);
    }
}
