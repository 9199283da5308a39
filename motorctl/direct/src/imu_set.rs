//! `motorctl imu set`: rate, baud rate, node and bit rate of an IMU, written to the device.

use crate::failure::DirectFailure;
use crate::imu_values::{Set, Values};
use crate::output::Confirm;
use crate::output::print_line;
use crate::{imu_sdo, imu_serial};
use motord_terminal::{Interrupt, json};
use std::io;

/// The options of `motorctl imu set`.
#[derive(Debug, clap::Args)]
pub struct ImuSet {
    /// The serial port of a HiPNUC or Xsens.
    #[arg(long, value_name = "PATH", required_unless_present = "bus", conflicts_with_all = ["bus", "node"])]
    pub(crate) device: Option<String>,
    /// The present baud rate of the device. Without it, all of the vendors are tried.
    #[arg(long, value_name = "BIT/S", requires = "device", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) baud: Option<u32>,
    /// The CAN interface of a HiPNUC.
    #[arg(long, value_name = "INTERFACE", requires = "node")]
    pub(crate) bus: Option<String>,
    /// The present CANopen node of the device.
    #[arg(long, value_name = "NODE", requires = "bus", value_parser = clap::value_parser!(u8).range(1..=127))]
    pub(crate) node: Option<u8>,
    #[command(flatten)]
    pub(crate) values: Values,
    /// The consent.
    #[command(flatten)]
    confirm: Confirm,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

impl ImuSet {
    /// Refuses options of the other kind of line. The command line accepts an option whose required one conflicts with a given one.
    fn check(&self) -> Result<(), DirectFailure> {
        let Values { baud, node, bitrate, .. } = self.values;
        let reason = match &self.device {
            Some(_) if node.is_some() || bitrate.is_some() => {
                "--new-node and --new-bitrate need --bus and --node"
            }
            None if baud.is_some() || self.baud.is_some() => "--baud and --new-baud need --device",
            _ => return Ok(()),
        };
        Err(DirectFailure::Usage(reason.to_owned()))
    }
}

/// Writes to the device, and measures its samples.
///
/// # Errors
///
/// The device or its line cannot have the value, the port or bus is in use, or the device does not do as asked.
pub fn run(arguments: &ImuSet) -> Result<(), DirectFailure> {
    arguments.check()?;
    let interrupt = Interrupt::register();
    let consent = |effect: String| arguments.confirm.ask(&effect);
    let set = match (&arguments.device, &arguments.bus, arguments.node) {
        (Some(device), ..) => imu_serial::set(device, arguments.baud, arguments.values, &interrupt, consent)?,
        (None, Some(bus), Some(node)) => imu_sdo::set(bus, node, arguments.values, &interrupt, consent)?,
        _ => return Err(DirectFailure::Usage("name the IMU: --device, or --bus and --node".to_owned())),
    };
    if arguments.json {
        json::write_line(&mut io::stdout().lock(), &set)?;
    } else {
        print_line(&set.sentence())?;
    }
    check_rate(&set)
}

/// Fails when another rate than the one asked for arrives.
fn check_rate(set: &Set) -> Result<(), DirectFailure> {
    const TOLERANCE: f64 = 0.1;
    let wrong = set.asked.rate_hz.filter(|rate| (set.measured_hz / f64::from(*rate) - 1.0).abs() > TOLERANCE);
    match wrong {
        None => Ok(()),
        Some(rate) => Err(DirectFailure::Imu {
            address: set.address(),
            reason: format!(
                "{:.1} Hz arrive instead of {rate} Hz: the device took another rate, the line is too slow, or this computer is too busy to count",
                set.measured_hz
            ),
        }),
    }
}
