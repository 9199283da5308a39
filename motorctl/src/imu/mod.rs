//! `motorctl imu`: commissioning of IMUs.

mod level;

use crate::failure::Failure;
use clap::Subcommand;
use motord_direct as direct;

/// The commands about IMUs.
#[derive(Debug, Subcommand)]
pub(crate) enum ImuCommand {
    /// Find IMUs on serial ports and CAN interfaces, and print their lines for the configuration. Needs no daemon.
    ///
    /// The command only listens: these devices send by themselves. It tries the protocols and baud rates of the vendors on each
    /// port, which takes up to 7 s, and measures the rate. A port that a daemon or another program uses is left out. A device
    /// whose output is switched off is silent. On a CAN interface it finds HiPNUC devices, also beside a daemon; a Damiao sends
    /// only on request, and a request to a wrong id could command a motor. Exit status 69: none was found.
    #[command(
        after_help = "Examples:\n  motorctl imu find\n  motorctl imu find --device /dev/ttyUSB0 --baud 921600\n  motorctl imu find --bus can0\n  motorctl imu find --json | jq -r '.imus[].lines'"
    )]
    Find(direct::ImuFind),
    /// Compute `mount-rpy-deg` of an IMU from the direction of gravity, while the robot is level and at rest.
    ///
    /// Roll and pitch of the mount change so that gravity is along z of the body; yaw stays as it is configured, because
    /// gravity does not show it. The command prints the line for the configuration, and changes nothing. It refuses while the
    /// robot moves. An accelerometer with an error of 0.1 m/s² is 0.6° off.
    #[command(
        after_help = "Examples:\n  motorctl imu level base\n  motorctl imu level base --seconds 10 --json"
    )]
    Level(level::Arguments),
}

/// Runs a command about IMUs.
pub(crate) fn run(instance: &str, command: &ImuCommand) -> Result<(), Failure> {
    match command {
        ImuCommand::Find(arguments) => Ok(direct::find_imus(arguments)?),
        ImuCommand::Level(arguments) => level::run(instance, arguments),
    }
}
