//! `motorctl imu`: commissioning of IMUs, and the check of their gravity by `motorctl doctor`.

mod level;

use crate::failure::Failure;
use crate::imu_report::sentences;
use crate::status;
use clap::Subcommand;
use motord_client::{Imu, ImuContradiction, ImuDescription};
use motord_direct as direct;
use motord_doctor::Finding;

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
    /// Set rate, baud rate, node or bit rate of an IMU, and measure its samples.
    ///
    /// Writes to a HiPNUC or Xsens on a serial port, or to a HiPNUC on a CAN interface, which must send samples: the command
    /// finds its type and baud rate by them. The device stores the values. The rate and a new baud rate act at once, and the
    /// command then measures the rate that arrives. Node and bit rate on CAN act after a power cycle; they are read back. An
    /// Xsens then sends the outputs that motord needs, and no others. The command refuses values that the device does not have
    /// or its line cannot carry, and a port or bus that a daemon uses. A Damiao has no rate: motord asks it. Exit status 1: the
    /// device does not do as asked, or another rate arrives.
    #[command(
        after_help = "Examples:\n  motorctl imu set --device /dev/ttyUSB0 --rate-hz 200 --yes\n  motorctl imu set --device /dev/ttyUSB0 --baud 921600 --rate-hz 400 --yes --json | jq .measured_hz\n  motorctl imu set --bus can0 --node 8 --rate-hz 200 --yes\n  motorctl imu set --bus can0 --node 8 --new-bitrate 1000000 --yes"
    )]
    Set(direct::ImuSet),
    /// Compute `mount-rpy-deg` of an IMU from the direction of gravity, while the robot is level and at rest.
    ///
    /// Roll and pitch of the mount change so that gravity is along z of the body; yaw stays as it is configured, because
    /// gravity in one pose does not show it. `--two-poses` measures yaw as well, and is needed within 10° of ±90° of pitch, where noise
    /// would decide roll and yaw. The command prints the line for the configuration, and changes nothing. It refuses while the
    /// robot moves, or while the IMU contradicts gravity. An accelerometer with an error of 0.1 m/s² is 0.6° off.
    #[command(
        after_help = "Examples:\n  motorctl imu level base\n  motorctl imu level base --seconds 10 --json\n  motorctl imu level base --two-poses"
    )]
    Level(level::Arguments),
}

/// Runs a command about IMUs.
pub(crate) fn run(instance: &str, command: &ImuCommand) -> Result<(), Failure> {
    match command {
        ImuCommand::Find(arguments) => Ok(direct::find_imus(arguments)?),
        ImuCommand::Set(arguments) => Ok(direct::set_imu(arguments)?),
        ImuCommand::Level(arguments) => level::run(instance, arguments),
    }
}

/// Returns a finding of `doctor` for each IMU of a running daemon; none without a daemon. Waits for
/// a state only where there is an IMU.
pub(crate) fn findings(instance: &str) -> Vec<Finding> {
    let Ok(client) = status::connect(instance) else { return Vec::new() };
    let imus = client.description().imus.clone();
    if imus.is_empty() {
        return Vec::new();
    }
    let Ok(state) = client.wait(status::TIMEOUT) else { return Vec::new() };
    let finding = |(of, imu): (ImuDescription, Imu)| {
        const CHECK: &str = "IMU gravity";
        let names: Vec<_> = imu.contradictions().map(ImuContradiction::name).collect();
        let finding = match names.is_empty() {
            true => Finding::good(CHECK, "no contradiction"),
            false => Finding::warn(CHECK, names.join(", "), sentences(&names))
                .mended_by("motorctl explain imu-contradicts".to_owned()),
        };
        finding.of(&of.name)
    };
    imus.into_iter().zip(state.imus()).map(finding).collect()
}
