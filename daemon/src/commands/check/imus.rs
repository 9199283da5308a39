//! The cost of the IMUs: bytes on their serial lines, frames on their buses.

use motord_settings::imu_load::ImuLoad;
use motord_settings::sensor::imu::{ImuSerial, ImuSettings};
use motord_settings::settings::Settings;
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
    #[serde(skip_serializing_if = "Option::is_none")]
    can: Option<CanReport<'a>>,
}

/// The CAN bus of an IMU.
#[derive(Serialize)]
struct CanReport<'a> {
    bus: &'a str,
    /// Requests, and frames of the device.
    frames_per_second: f64,
    /// Part of the bus that they take at worst.
    utilisation: f64,
}

impl<'a> CanReport<'a> {
    fn of(settings: &'a Settings, imu: &ImuSettings) -> Option<Self> {
        let ImuLoad { bus, frames_per_second, utilisation } = ImuLoad::of(settings, imu)?;
        Some(Self { bus: &settings.buses[bus].name, frames_per_second, utilisation })
    }
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
pub(super) fn reports(settings: &Settings) -> Vec<ImuReport<'_>> {
    let report = |imu| report(settings, imu);
    settings.sensors.imus.iter().map(report).collect()
}

fn report<'a>(settings: &'a Settings, imu: &'a ImuSettings) -> ImuReport<'a> {
    ImuReport {
        name: &imu.name,
        kind: imu.source.type_name(),
        rate_hz: imu.rate_hz,
        line: imu.source.serial().map(|serial| LineReport::of(serial, imu.rate_hz)),
        can: CanReport::of(settings, imu),
    }
}

/// Prints a line for each IMU; nothing without one.
pub(super) fn print(settings: &Settings, out: &mut impl Write) -> io::Result<()> {
    if settings.sensors.imus.is_empty() {
        return Ok(());
    }
    let reports = reports(settings);
    let width = reports.iter().map(|imu| imu.name.len()).max().unwrap_or(0).max("IMU".len());
    writeln!(
        out,
        "\n{:<width$}  {:<13}  {:>8}  {:>13}  {:>7}  highest  line",
        "IMU", "type", "rate", "load", "of line"
    )?;
    for ImuReport { name, kind, rate_hz, line, can } in reports {
        let rate = format!("{rate_hz} Hz");
        write!(out, "{name:<width$}  {kind:<13}  {rate:>8}  ")?;
        let [load, part, highest, location] = match (line, can) {
            (Some(LineReport { device, baud, bytes_per_second, utilisation, rate_hz_max }), _) => [
                format!("{bytes_per_second:.0} bytes/s"),
                format!("{:.1} %", 100.0 * utilisation),
                format!("{rate_hz_max} Hz"),
                format!("{device} at {baud} baud"),
            ],
            (None, Some(CanReport { bus, frames_per_second, utilisation })) => [
                format!("{frames_per_second:.0} frames/s"),
                format!("{:.1} %", 100.0 * utilisation),
                "-".to_owned(),
                format!("bus {bus}, at worst"),
            ],
            (None, None) => ["-"; 4].map(str::to_owned),
        };
        writeln!(out, "{load:>13}  {part:>7}  {highest:>7}  {location}")?;
    }
    Ok(())
}
