//! `[[imu]]`: the sources of orientation and acceleration.

use motord_settings::imu::{ImuSettings, ImuSimulation, ImuSource, Mount};
use motord_shared::limits::IMUS_MAX;

use super::time::{micros, millis};
use crate::document::ImuTables;
use crate::entry::Item;
use crate::file::fnv1a;
use crate::findings::Findings;
use crate::problem::Wrong;
use crate::value::ImuType;

/// Samples after which it is lost, by default; and at least this time.
const LOST_SAMPLES: f64 = 3.0;
const LOST_LEAST_MS: f64 = 5.0;

/// All IMUs, in the order of the file; `None` for one that cannot be built.
pub(super) fn imus(items: &[Item<ImuTables>], findings: &mut Findings<'_>) -> Vec<Option<ImuSettings>> {
    if let Some(beyond) = items.get(IMUS_MAX) {
        findings.error(beyond.at, Wrong::TooMany { max: IMUS_MAX });
    }
    let names = items.iter().map(|imu| &imu.keys.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "IMU" });
    items.iter().map(|imu| self::imu(&imu.keys, findings)).collect()
}

fn imu(tables: &ImuTables, findings: &mut Findings<'_>) -> Option<ImuSettings> {
    let keys = &tables.keys;
    let name = findings.name(&keys.name);
    let sample_ms = 1e3 / keys.rate_hz.value;
    let lost_ms =
        keys.lost_after_ms.value.unwrap_or_else(|| f64::max(LOST_SAMPLES * sample_ms, LOST_LEAST_MS));
    if lost_ms < 2.0 * sample_ms {
        findings.error(keys.lost_after_ms.at, Wrong::LostWithinSamples { lost_ms, sample_ms });
    }
    let source = source(keys.kind.value?, tables);
    Some(ImuSettings {
        name: name?,
        source,
        rate_hz: keys.rate_hz.value,
        mount: Mount::from_roll_pitch_yaw(keys.mount_rpy_deg.value.map(f64::to_radians)),
        lost_after: millis(lost_ms),
        when_lost: keys.when_lost.value,
    })
}

fn source(kind: ImuType, tables: &ImuTables) -> ImuSource {
    let ImuTables { keys, simulation } = tables;
    match kind {
        ImuType::Simulated => {
            // Two IMUs of one file have different names, so their noise differs.
            let from_name = || keys.name.value.as_ref().map_or(0, |name| fnv1a(name.as_bytes()));
            ImuSource::Simulated(ImuSimulation {
                noise: simulation.noise_rad_s.value,
                bias: simulation.bias_rad_s.value,
                delay: micros(simulation.delay_us.value),
                seed: simulation.seed.value.map_or_else(from_name, i64::cast_unsigned),
            })
        }
    }
}
