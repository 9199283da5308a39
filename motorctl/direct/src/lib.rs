//! The commands of `motorctl` that use a bus without a daemon. They lock the bus; a running daemon
//! holds the same lock.

#![forbid(unsafe_code)]

mod address;
mod failure;
mod file;
mod find;
mod guard;
mod guide;
mod imu;
mod imu_bus;
mod imu_sdo;
mod imu_serial;
mod imu_set;
mod imu_values;
mod jog;
mod journal;
mod memory;
mod motion;
mod motor;
mod output;
mod replace;
mod service;
mod setup;
mod status;
mod target;
mod zero;

pub use failure::DirectFailure;
pub use imu::{ImuFind, find as find_imus};
pub use imu_set::{ImuSet, run as set_imu};
pub use output::Confirm;
pub use status::{Indicators, NamedFault, clear_fault, print_faults};
pub use target::Target;
pub use zero::{Arguments as Zero, run as zero};

use clap::{Args, Subcommand};
use motion::{Bounds, Goal, finite};
use motord_protocol::gim::{ConfigurationItem, Parameter};
use std::path::PathBuf;
use target::Protocol;

/// The commands on a bus.
#[derive(Debug, Subcommand)]
pub enum DirectCommand {
    /// Find the motors of one or several buses, without moving one.
    ///
    /// Motors in MIT mode stop. No frame moves or changes a motor of any protocol. Motors without
    /// power, with another bit rate or with a fault are silent. Do not scan a bus on which another
    /// program drives motors.
    #[command(
        after_help = "Examples:\n  motorctl scan --bus can0\n  motorctl scan --bus can0 --ids 1-32 --json | jq '.motors | length'"
    )]
    Scan(find::Arguments),
    /// Check whether a motor answers, and measure its answering time.
    #[command(
        after_help = "Examples:\n  motorctl ping --bus can0 --id 3\n  motorctl ping --bus /dev/ttyUSB0 --id 3 --json | jq .answer_us"
    )]
    Ping(ObjectArguments),
    /// Show or change a motor's id, host id, bit rate and protocol.
    ///
    /// Connect the motor alone: every motor with the old id would change. Each change is read back under the new address.
    #[command(
        after_help = "Examples:\n  motorctl id --bus can0 --id 3\n  motorctl id --bus can0 --id 3 --set-id 5 --set-host-id 0x105 --yes"
    )]
    Id(address::Arguments),
    /// Show the version of a motor's firmware.
    #[command(after_help = "Example:\n  motorctl version --bus can0 --id 3")]
    Version(ObjectArguments),
    /// Start a motor: it is energised and follows the next control command.
    #[command(after_help = "Example:\n  motorctl start --bus can0 --id 3 --yes")]
    Start {
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
        /// No argument: names the command that is meant.
        #[arg(hide = true, value_parser = no_group_starts)]
        group: Option<String>,
    },
    /// Stop a motor, which then is limp.
    #[command(
        after_help = "Examples:\n  motorctl stop --bus can0 --id 3\n  motorctl stop --bus can0 --id 3 --control"
    )]
    Stop {
        /// The motor.
        #[command(flatten)]
        target: Target,
        /// End only the control command that is being executed; the motor stays started.
        #[arg(long)]
        control: bool,
        /// No argument: names the command that is meant.
        #[arg(hide = true, value_parser = no_group_stops)]
        group: Option<String>,
    },
    /// Hold a torque for a duration, then stop.
    ///
    /// The motor converts the torque to a current with its stored torque constant and gear ratio.
    /// Compare them with its data sheet first (`motorctl config list`). The command stops the motor
    /// at the end, at Ctrl-C and beyond a bound. With --config, the limits of the joint are bounds.
    #[command(
        after_help = "Example:\n  motorctl torque 0.3 --seconds 0.5 --max-travel-rad 3 --max-rad-s 30 --bus can0 --id 3 --yes"
    )]
    Torque {
        /// Torque at the output shaft, N·m.
        #[arg(value_name = "NM", value_parser = finite, allow_negative_numbers = true)]
        torque: f64,
        /// Refuse a larger torque, N·m.
        #[arg(long, value_name = "NM", default_value_t = 2.0, value_parser = |text: &str| motion::ranged(text, 0.0, 200.0))]
        max_nm: f64,
        /// The motor and the bounds of its motion.
        #[command(flatten)]
        motion: MotionArguments,
    },
    /// Hold a speed for a duration, then stop.
    ///
    /// The command stops the motor at the end, at Ctrl-C and beyond a bound. With --config, the
    /// limits of the joint are bounds.
    #[command(after_help = "Example:\n  motorctl speed 0.5 --seconds 0.5 --bus can0 --id 3 --yes")]
    Speed {
        /// Speed of the output shaft, rad/s.
        #[arg(value_name = "RAD/S", value_parser = finite, allow_negative_numbers = true)]
        speed: f64,
        /// The motor and the bounds of its motion.
        #[command(flatten)]
        motion: MotionArguments,
    },
    /// Go to a position, hold it for a duration, then stop.
    ///
    /// The command stops the motor at the end, at Ctrl-C and beyond a bound. With --config, the
    /// limits of the joint are bounds.
    #[command(after_help = "Example:\n  motorctl position 0.2 --seconds 1 --bus can0 --id 3 --yes")]
    Position {
        /// Position of the output shaft, rad, as the motor counts it.
        #[arg(value_name = "RAD", value_parser = finite, allow_negative_numbers = true)]
        position: f64,
        /// The motor and the bounds of its motion.
        #[command(flatten)]
        motion: MotionArguments,
    },
    /// PTS control, which no driver supports. The command quotes the vendor's document and sends
    /// nothing.
    #[command(hide = true)]
    Pts,
    /// Move a joint slowly and softly while a key is held.
    ///
    /// The command stops the motor at the end, at Ctrl-C, beyond a bound and when the terminal
    /// closes. If this process is killed, a motor in MIT mode, or in RobStride's private protocol
    /// without a timeout, continues with the last command. A GIM motor continues for 200 ms or
    /// permanently, depending on how its drive reads the duration of a command. Keep the switch of
    /// its supply at hand.
    #[command(
        after_help = "Examples:\n  motorctl jog --bus can0 --id 3 --seconds 0.5 --yes\n  motorctl jog --bus can0 --id 3 --seconds 0.5 --backward --rad-s 0.1 --yes"
    )]
    Jog(jog::Arguments),
    /// Read what a motor measures: voltages, currents, temperatures, angles, power.
    ///
    /// For a joint, the daemon returns its values, each about a second old. With --bus or --config
    /// the command uses the bus without a daemon. Only GIM motors measure them.
    #[command(
        after_help = "Examples:\n  motorctl indicator --bus can0 --id 3\n  motorctl indicator bus-voltage iq --bus can0 --id 3 --json | jq '.[0].value'"
    )]
    Indicator(status::Indicators),
    /// The gains of the running control loops. They are lost when the motor is powered off.
    #[command(subcommand)]
    Parameter(ParameterCommand),
    /// The stored configuration of a motor.
    #[command(subcommand)]
    Config(ConfigCommand),
    /// Compare the motors with their configuration, and store their answers in the lock file.
    ///
    /// Nothing moves; motors in MIT mode stop. The lock file of `motord.toml` is `motord.lock.toml`
    /// in the same directory. motord does not enable a motor that differs. Values that MIT mode
    /// cannot read are unknown: compare the label. Exit status 1: a motor differs or does not
    /// answer.
    #[command(
        after_help = "Examples:\n  motorctl setup --config motord.toml\n  motorctl setup --config motord.toml --json | jq .answered\n  motorctl setup --config motord.toml --write\n  motorctl setup --guide --config motord.toml"
    )]
    Setup(setup::Arguments),
    /// Give a new motor the place of a broken one.
    ///
    /// Exactly one joint of the bus has no motor, and exactly one new motor answers: otherwise nothing
    /// is written. The motor gets the id, host id and protocol of the configuration, and the limits and
    /// gains that the lock file has of the former one. Its zero is the present pose, because the
    /// zero of the former motor fits no other.
    #[command(after_help = "Example:\n  motorctl replace fl-knee --config motord.toml")]
    Replace(replace::Arguments),
    /// Change the protocol that a motor speaks over CAN.
    ///
    /// A SteadyWin motor in MIT mode cannot be changed back over CAN. Its serial port (RS485, RS232)
    /// keeps the GIM protocol, and can. A RobStride motor changes between its private protocol and
    /// MIT in both directions, and takes the new one when it is powered off and on.
    #[command(
        after_help = "Examples:\n  motorctl protocol mit --bus can0 --id 3 --yes\n  motorctl protocol gim --bus /dev/ttyUSB0 --id 3 --yes\n  motorctl protocol robstride --config motord.toml --joint knee --yes"
    )]
    Protocol {
        /// The new protocol.
        #[arg(value_name = "PROTOCOL")]
        to: Protocol,
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
    },
    /// Calibrate the phase order or the encoder of a motor. Its shaft turns.
    #[command(after_help = "Example:\n  motorctl calibrate encoder --bus can0 --id 3 --yes")]
    Calibrate {
        /// The part that is calibrated.
        what: service::CalibrationPart,
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
    },
    /// Put a motor into firmware mode for the vendor's tool. It leaves the bus.
    #[command(after_help = "Example:\n  motorctl firmware-mode --bus can0 --id 3 --repeat-id 3 --yes")]
    FirmwareMode(service::Firmware),
}

/// `motorctl parameter`.
#[derive(Debug, Subcommand)]
pub enum ParameterCommand {
    /// Read one parameter, or all.
    #[command(after_help = "Example:\n  motorctl parameter get --bus can0 --id 3 --json | jq '.[0].value'")]
    Get {
        /// Its name or number.
        #[arg(value_name = "NAME", value_parser = memory::parse_parameter)]
        parameter: Option<&'static Parameter>,
        /// The motor and the output format.
        #[command(flatten)]
        output: ReadArguments,
    },
    /// Change a parameter, and read it back. No document gives its unit: change it in small steps.
    #[command(after_help = "Example:\n  motorctl parameter set position-kp 110 --bus can0 --id 3 --yes")]
    Set {
        /// Its name or number.
        #[arg(value_name = "NAME", value_parser = memory::parse_parameter)]
        parameter: &'static Parameter,
        /// The new value, 0 to 4294967295.
        value: u32,
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
    },
}

/// `motorctl config`.
#[derive(Debug, Subcommand)]
pub enum ConfigCommand {
    /// Read one item.
    #[command(
        after_help = "Example:\n  motorctl config get torque-constant --bus can0 --id 3 --json | jq .value"
    )]
    Get {
        /// The name of the item, from `motorctl config list`.
        #[arg(value_name = "NAME", value_parser = memory::parse_item)]
        item: &'static ConfigurationItem,
        /// The motor and the output format.
        #[command(flatten)]
        output: ReadArguments,
    },
    /// Read all items.
    #[command(after_help = "Example:\n  motorctl config list --bus can0 --id 3")]
    List(ReadArguments),
    /// Change one item, and read it back.
    #[command(after_help = "Example:\n  motorctl config set over-voltage 52 --bus can0 --id 3 --yes")]
    Set {
        /// Its name.
        #[arg(value_name = "NAME", value_parser = memory::parse_item)]
        item: &'static ConfigurationItem,
        /// The new value.
        #[arg(allow_hyphen_values = true)]
        value: String,
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
    },
    /// Write all items to a file.
    #[command(after_help = "Example:\n  motorctl config dump knee.toml --force --bus can0 --id 3")]
    Dump {
        /// The file; standard output without it.
        file: Option<PathBuf>,
        /// Replace a file that exists.
        #[arg(long)]
        force: bool,
        /// The motor.
        #[command(flatten)]
        target: Target,
    },
    /// Compare a motor with a file. Exit status 1: they differ.
    #[command(
        after_help = "Example:\n  motorctl config dump knee.toml --force --bus can0 --id 3 && \\\n    motorctl config diff knee.toml --bus can0 --id 3"
    )]
    Diff {
        /// The file of `motorctl config dump`.
        file: PathBuf,
        /// The motor and the output format.
        #[command(flatten)]
        output: ReadArguments,
    },
    /// Write each item that differs from a file, and read it back. The first refusal ends the
    /// command.
    #[command(
        after_help = "Example:\n  motorctl config dump knee.toml --force --bus can0 --id 3 && \\\n    motorctl config apply knee.toml --bus can0 --id 3 --yes"
    )]
    Apply {
        /// The file of `motorctl config dump`.
        file: PathBuf,
        /// The journal, which contains each write before it is sent. Default: the file's name with
        /// .journal.
        #[arg(long, value_name = "FILE")]
        journal: Option<PathBuf>,
        /// The motor and the consent.
        #[command(flatten)]
        change: ChangeArguments,
    },
    /// Give every item the driver's default. Connect the motor alone.
    #[command(after_help = "Example:\n  motorctl config reset --bus can0 --id 3 --yes")]
    Reset(ChangeArguments),
}

/// The options of a command that reads one motor.
#[derive(Debug, Args)]
pub struct ReadArguments {
    /// The motor.
    #[command(flatten)]
    pub target: Target,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// The options of a command that asks one motor, and prints one object.
#[derive(Debug, Args)]
pub struct ObjectArguments {
    /// The motor.
    #[command(flatten)]
    target: Target,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The options of a command that changes one motor.
#[derive(Debug, Args)]
pub struct ChangeArguments {
    /// The motor.
    #[command(flatten)]
    target: Target,
    /// The consent.
    #[command(flatten)]
    confirm: Confirm,
}

/// The options of a command that moves one motor.
#[derive(Debug, Args)]
pub struct MotionArguments {
    /// The motor.
    #[command(flatten)]
    target: Target,
    /// The bounds of the motion.
    #[command(flatten)]
    bounds: Bounds,
}

/// `motorctl fault get`.
pub fn get_fault(reading: &ReadArguments) -> Result<(), DirectFailure> {
    status::fault(&reading.target, reading.json)
}

/// Refuses the name of a group after `motorctl start`.
fn no_group_starts(group: &str) -> Result<String, String> {
    Err(format!("`start` starts one motor, without motord; `motorctl enable {group}` starts a group"))
}

/// Refuses the name of a group after `motorctl stop`.
fn no_group_stops(group: &str) -> Result<String, String> {
    let meant = "stops a group, `motorctl estop` every motor";
    Err(format!("`stop` stops one motor, without motord; `motorctl disable {group}` {meant}"))
}

/// Runs a command on the bus.
pub fn run(command: DirectCommand) -> Result<(), DirectFailure> {
    match command {
        DirectCommand::Scan(arguments) => find::run(&arguments),
        DirectCommand::Ping(ObjectArguments { target, json }) => find::ping(&target, json),
        DirectCommand::Id(arguments) => address::run(&arguments),
        DirectCommand::Version(ObjectArguments { target, json }) => status::version(&target, json),
        DirectCommand::Start { change, group: _ } => status::start(&change.target, change.confirm),
        DirectCommand::Stop { target, control, group: _ } => status::stop(&target, control),
        DirectCommand::Torque { torque, max_nm, motion } => {
            motion::torque(&motion.target, torque, max_nm, &motion.bounds)
        }
        DirectCommand::Speed { speed, motion } => {
            motion::run(&motion.target, Goal::Speed(speed), &motion.bounds)
        }
        DirectCommand::Position { position, motion } => {
            motion::run(&motion.target, Goal::Position(position), &motion.bounds)
        }
        DirectCommand::Pts => service::pts(),
        DirectCommand::Jog(arguments) => jog::run(&arguments),
        DirectCommand::Indicator(arguments) => status::indicators(&arguments),
        DirectCommand::Setup(arguments) => match arguments.guide() {
            Some((config, joints)) => guide::run(config, joints),
            None => setup::run(&arguments),
        },
        DirectCommand::Replace(arguments) => replace::run(&arguments),
        DirectCommand::Parameter(command) => parameter(command),
        DirectCommand::Config(command) => config(command),
        DirectCommand::Protocol { to, change } => address::protocol(&change.target, to, change.confirm),
        DirectCommand::Calibrate { what, change } => service::calibrate(&change.target, what, change.confirm),
        DirectCommand::FirmwareMode(arguments) => service::firmware_mode(&arguments),
    }
}

fn parameter(command: ParameterCommand) -> Result<(), DirectFailure> {
    match command {
        ParameterCommand::Get { parameter, output } => {
            memory::get_parameter(&output.target, parameter, output.json)
        }
        ParameterCommand::Set { parameter, value, change } => {
            memory::set_parameter(&change.target, parameter, value, change.confirm)
        }
    }
}

fn config(command: ConfigCommand) -> Result<(), DirectFailure> {
    match command {
        ConfigCommand::Get { item, output } => memory::get(&output.target, Some(item), output.json),
        ConfigCommand::List(output) => memory::get(&output.target, None, output.json),
        ConfigCommand::Set { item, value, change } => {
            memory::set(&change.target, item, &value, change.confirm)
        }
        ConfigCommand::Dump { file, force, target } => file::dump(&target, file.as_deref(), force),
        ConfigCommand::Diff { file, output } => file::diff(&output.target, &file, output.json),
        ConfigCommand::Apply { file, journal, change } => {
            file::apply(&change.target, &file, journal.as_deref(), change.confirm)
        }
        ConfigCommand::Reset(change) => file::reset(&change.target, change.confirm),
    }
}
