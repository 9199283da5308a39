//! The bytes of the IMUs on their serial lines, and the part of the line that they take.

use motord_core::imu::{ImuSerial, ImuSettings};
use serde::Serialize;
use std::io::{self, Write};

/// An IMU.
#[derive(Serialize)]
pub(super) struct ImuReport<'a> {
    name: &'a str,
    #[serde(rename = "type")]
    kind: &'static str,
    rate_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<LineReport<'a>>,
}

/// The serial line of an IMU.
#[derive(Serialize)]
struct LineReport<'a> {
    device: &'a str,
    baud: u32,
    /// At least: an Xsens MTi sends more when further outputs are selected.
    bytes_per_second: f64,
    /// Part of the line that these bytes take.
    utilisation: f64,
    /// The highest rate that the line carries, rounded down.
    rate_hz_max: f64,
}

impl<'a> LineReport<'a> {
    fn of(serial: &'a ImuSerial, rate_hz: f64) -> Self {
        Self {
            device: &serial.device,
            baud: serial.baud,
            bytes_per_second: serial.bytes_per_second(rate_hz),
            utilisation: serial.utilisation(rate_hz),
            rate_hz_max: serial.protocol.rate_hz_max(serial.baud).floor(),
        }
    }
}

/// The reports of all IMUs, in the order of the configuration.
pub(super) fn reports<'a>(imus: &'a [ImuSettings]) -> Vec<ImuReport<'a>> {
    let report = |imu: &'a ImuSettings| ImuReport {
        name: &imu.name,
        kind: imu.source.type_name(),
        rate_hz: imu.rate_hz,
        line: imu.source.serial().map(|serial| LineReport::of(serial, imu.rate_hz)),
    };
    imus.iter().map(report).collect()
}

/// Prints a line for each IMU; nothing without one.
pub(super) fn print(imus: &[ImuSettings], out: &mut impl Write) -> io::Result<()> {
    if imus.is_empty() {
        return Ok(());
    }
    let reports = reports(imus);
    let width = reports.iter().map(|imu| imu.name.len()).max().unwrap_or(0).max("IMU".len());
    writeln!(
        out,
        "\n{:<width$}  {:<13}  {:>8}  {:>8}  {:>7}  highest  line",
        "IMU", "type", "rate", "bytes/s", "of line"
    )?;
    for ImuReport { name, kind, rate_hz, line } in reports {
        let rate = format!("{rate_hz} Hz");
        write!(out, "{name:<width$}  {kind:<13}  {rate:>8}  ")?;
        match line {
            Some(LineReport { device, baud, bytes_per_second, utilisation, rate_hz_max }) => writeln!(
                out,
                "{bytes_per_second:>8.0}  {:>5.1} %  {:>7}  {device} at {baud} baud",
                100.0 * utilisation,
                format!("{rate_hz_max} Hz"),
            )?,
            None => writeln!(out, "{:>8}  {:>7}  {:>7}  -", "-", "-", "-")?,
        }
    }
    Ok(())
}
