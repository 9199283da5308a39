//! `[[imu]]`: the sources of orientation and acceleration.

use motord_bus::Identity;
use motord_protocol::imu::{BITS_PER_BYTE, SerialProtocol};
use motord_settings::sensor::imu::{ImuCan, ImuSerial, ImuSettings, ImuSimulation, ImuSource, Mount};
use motord_shared::limits::IMUS_MAX;

use super::bus::{self, Buses};
use super::imu_can;
use super::time::{micros, millis};
use crate::entry::Item;
use crate::file::fnv1a;
use crate::findings::Findings;
use crate::keys::{self, ImuTables};
use crate::problem::Wrong;
use crate::value::{Choice, ImuType};

/// Samples after which it is lost, by default; and at least this time.
const LOST_SAMPLES: f64 = 3.0;
const LOST_LEAST_MS: f64 = 5.0;
/// Samples per second of an IMU without a serial line, by default.
const OTHER_RATE_HZ: f64 = 200.0;

/// All IMUs, in the order of the file; `None` for one that cannot be built.
pub(super) fn imus(
    items: &[Item<ImuTables>],
    buses: Buses<'_>,
    findings: &mut Findings<'_>,
) -> Vec<Option<ImuSettings>> {
    if let Some(beyond) = items.get(IMUS_MAX) {
        findings.error(beyond.at, Wrong::TooMany { max: IMUS_MAX });
    }
    let names = items.iter().map(|imu| &imu.keys.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "IMU" });
    refuse_taken_devices(items, buses.0, findings);
    items.iter().map(|imu| self::imu(&imu.keys, buses, findings)).collect()
}

/// Reports a device that a bus or an earlier IMU uses, also under another name.
fn refuse_taken_devices(items: &[Item<ImuTables>], buses: &[Item<keys::Bus>], findings: &mut Findings<'_>) {
    let owner =
        |what: &str, name: &Option<String>| format!("{what} {:?}", name.as_deref().unwrap_or_default());
    let mut taken: Vec<(&str, String)> = Vec::new();
    for Item { keys, .. } in buses {
        let device = keys.device.value.as_deref();
        taken.extend(device.map(|device| (device, owner("bus", &keys.name.value))));
    }
    for Item { keys: ImuTables { keys, .. }, .. } in items {
        let Some(device) = keys.device.value.as_deref() else { continue };
        match taken.iter().find(|(other, _)| is_same_device(device, other)) {
            Some((_, other)) => {
                let (name, other) = (device.to_owned(), other.clone());
                findings.error(keys.device.at, Wrong::ImuDeviceTaken { name, other });
            }
            None => taken.push((device, owner("IMU", &keys.name.value))),
        }
    }
}

/// Returns whether both paths lead to one device. A device that is not there has one name.
fn is_same_device(one: &str, other: &str) -> bool {
    one == other
        || Identity::of_device(one).is_some_and(|identity| Some(identity) == Identity::of_device(other))
}

fn imu(tables: &ImuTables, buses: Buses<'_>, findings: &mut Findings<'_>) -> Option<ImuSettings> {
    let keys = &tables.keys;
    let name = findings.name(&keys.name);
    let rate_hz = keys.rate_hz.value.unwrap_or_else(|| default_rate_hz(keys.kind.value));
    let sample_ms = 1e3 / rate_hz;
    let lost_ms =
        keys.lost_after_ms.value.unwrap_or_else(|| f64::max(LOST_SAMPLES * sample_ms, LOST_LEAST_MS));
    if lost_ms < 2.0 * sample_ms {
        findings.error(keys.lost_after_ms.at, Wrong::LostWithinSamples { lost_ms, sample_ms });
    }
    let kind = keys.kind.value?;
    refuse_keys_of_other_types(kind, tables, findings);
    let source = source(kind, rate_hz, (tables, buses), findings);
    Some(ImuSettings {
        name: name?,
        source: source?,
        rate_hz,
        mount: Mount::from_roll_pitch_yaw(keys.mount_rpy_deg.value.map(f64::to_radians)),
        lost_after: millis(lost_ms),
        when_lost: keys.when_lost.value,
    })
}

fn default_rate_hz(kind: Option<ImuType>) -> f64 {
    match kind {
        Some(ImuType::Serial(protocol)) => protocol.rate_hz_default().into(),
        Some(ImuType::Can(protocol)) => protocol.rate_hz_default().into(),
        Some(ImuType::Simulated | ImuType::External) | None => OTHER_RATE_HZ,
    }
}

fn source(
    kind: ImuType,
    rate_hz: f64,
    (tables, buses): (&ImuTables, Buses<'_>),
    findings: &mut Findings<'_>,
) -> Option<ImuSource> {
    match kind {
        ImuType::Simulated => Some(ImuSource::Simulated(simulation(tables))),
        ImuType::Serial(protocol) => serial(protocol, rate_hz, &tables.keys, findings).map(ImuSource::Serial),
        ImuType::Can(protocol) => Some(ImuSource::Can(ImuCan {
            bus: bus::of_sensor(&tables.keys.bus, "IMU", buses, findings)?,
            device: imu_can::device(protocol, &tables.keys),
            simulation: simulation(tables),
        })),
        ImuType::External => Some(ImuSource::External),
    }
}

fn simulation(ImuTables { keys, simulation }: &ImuTables) -> ImuSimulation {
    // Two IMUs of one file have different names, so their noise differs.
    let from_name = || keys.name.value.as_ref().map_or(0, |name| fnv1a(name.as_bytes()));
    ImuSimulation {
        noise: simulation.noise_rad_s.value,
        bias: simulation.bias_rad_s.value,
        delay: micros(simulation.delay_us.value),
        seed: simulation.seed.value.map_or_else(from_name, i64::cast_unsigned),
    }
}

/// Reports keys of another type: the type is wrong, or the key has no effect.
fn refuse_keys_of_other_types(kind: ImuType, tables: &ImuTables, findings: &mut Findings<'_>) {
    let ImuTables { keys, simulation } = tables;
    let is_serial = matches!(kind, ImuType::Serial(_));
    let is_simulated = matches!(kind, ImuType::Simulated | ImuType::Can(_));
    let has = |key| matches!(kind, ImuType::Can(protocol) if protocol.has(key));
    let owners = [
        (keys.device.is_written, keys.device.at, is_serial),
        (keys.baud.is_written, keys.baud.at, is_serial),
        (keys.bus.is_written, keys.bus.at, matches!(kind, ImuType::Can(_))),
        (keys.node_id.is_written, keys.node_id.at, has("node-id")),
        (keys.can_id.is_written, keys.can_id.at, has("can-id")),
        (keys.master_id.is_written, keys.master_id.at, has("master-id")),
        (keys.firmware.is_written, keys.firmware.at, has("firmware")),
        (simulation.noise_rad_s.is_written, simulation.noise_rad_s.at, is_simulated),
        (simulation.bias_rad_s.is_written, simulation.bias_rad_s.at, is_simulated),
        (simulation.delay_us.is_written, simulation.delay_us.at, is_simulated),
        (simulation.seed.is_written, simulation.seed.at, is_simulated),
    ];
    for (_, at, _) in owners.into_iter().filter(|(is_written, _, is_own)| *is_written && !is_own) {
        findings.error(at, Wrong::NotOfThisImu { kind: kind.word() });
    }
}

fn serial(
    protocol: SerialProtocol,
    rate_hz: f64,
    keys: &keys::Imu,
    findings: &mut Findings<'_>,
) -> Option<ImuSerial> {
    let device = findings.device(&keys.device);
    let baud = keys.baud.value.map_or_else(|| protocol.baud_default(), |baud| baud as u32);
    if !protocol.bauds().contains(&baud) {
        let known: Vec<_> = protocol.bauds().iter().map(ToString::to_string).collect();
        findings.error(keys.baud.at, Wrong::ImuBaud { baud, known: known.join(", ") });
    } else if rate_hz > protocol.rate_hz_max(baud) {
        let bytes = protocol.sample_len();
        let needed = rate_hz * f64::from(bytes as u32 * BITS_PER_BYTE);
        let rate_hz_max = protocol.rate_hz_max(baud).floor();
        findings.error(keys.rate_hz.at, Wrong::ImuLineFull { rate_hz, bytes, needed, baud, rate_hz_max });
    }
    Some(ImuSerial { protocol, device: device?, baud })
}
