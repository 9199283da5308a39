//! From the keys of a file to settings: derived defaults, checks between keys, and checks of the
//! whole.
//!
//! A problem does not end the validation. An invalid value is reported and replaced by its default.
//! A bus or motor that cannot be built is left out, and problems that only follow from that are not
//! reported.

mod bus;
mod group;
mod imu;
mod imu_can;
pub(super) mod limits;
mod model;
mod motor;
mod time;

use motord_bus::Duration;
use motord_settings::defaults::BUSY_POLL;
use motord_settings::sensor::SensorSettings;
use motord_settings::settings::{CycleSettings, IpcMode, IpcSettings, SafetySettings, Settings};
use motord_shared::DEFAULT_INSTANCE;

use super::document::Document;
use super::findings::Findings;
use super::keys;
use super::problem::Wrong;
use time::{micros, millis};

/// Least rate of commands to a motor without a warning, Hz: a limb falls far in a longer period,
/// and slower controllers are rare.
const SOUND_RATE_HZ: f64 = 50.0;

/// Checks the whole document. `None` when a bus, motor or group cannot be built; the reason is
/// among the findings.
pub(super) fn settings(document: &Document, findings: &mut Findings<'_>) -> Option<Settings> {
    let instance = instance(&document.daemon, findings);
    let cycle = cycle(&document.cycle, findings);
    let ipc = ipc(&document.ipc, &cycle, findings);
    let safety = safety(&document.safety, &cycle, findings);
    let buses = bus::buses(&document.buses, findings);
    let motors = motor::motors(&document.motors, &document.buses, &buses, findings).into_iter();
    let (motors, simulation): (Vec<_>, Vec<_>) = motors.map(Option::unzip).unzip();
    let groups = group::groups(&document.groups, &document.motors, &document.safety, findings);
    refuse_taken_names(document, findings);
    let imus = imu::imus(&document.sensors.imus, (&document.buses, &buses), findings);
    motor::check_damping(&document.motors, &motors, groups.as_deref().unwrap_or_default(), findings);
    let (buses, motors) =
        (buses.into_iter().collect::<Option<_>>()?, motors.into_iter().collect::<Option<_>>()?);
    let simulation = simulation.into_iter().collect::<Option<_>>()?;
    let sensors = SensorSettings { imus: imus.into_iter().collect::<Option<_>>()? };
    let settings =
        Settings { instance, cycle, ipc, safety, buses, motors, simulation, groups: groups?, sensors };
    bus::check_load(&document.buses, &settings, findings);
    imu_can::check(&document.sensors.imus, &settings, findings);
    bus::check_shared_ids(&document.buses, &settings, findings);
    bus::check_enables(&document.buses, &settings, findings);
    bus::check_reports(&document.buses, &settings, findings);
    motor::check_durations(&document.motors, &settings, findings);
    group::check_supplies(document, &settings, findings);
    check_rates(document, &settings, findings);
    Some(settings)
}

/// Reports a sensor with the name of a motor, bus or group: commands such as `motorctl sim` take
/// each.
fn refuse_taken_names(document: &Document, findings: &mut Findings<'_>) {
    let motors = document.motors.iter().map(|item| ("motor", &item.keys.keys.name.value));
    let buses = document.buses.iter().map(|item| ("bus", &item.keys.name.value));
    let groups = document.groups.iter().map(|item| ("group", &item.keys.name.value));
    let taken: Vec<_> = motors.chain(buses).chain(groups).collect();
    let imus = document.sensors.imus.iter().map(|item| ("IMU", &item.keys.keys.name));
    for (own, entry) in imus {
        let Some(name) = &entry.value else { continue };
        if let Some((what, _)) = taken.iter().find(|(_, other)| other.as_ref() == Some(name)) {
            findings.error(entry.at, Wrong::NameOfAnother { name: name.as_str().into(), what, own });
        }
    }
}

/// Warns of a cycle, or of a bus with turns, that is too slow for a stop.
fn check_rates(document: &Document, settings: &Settings, findings: &mut Findings<'_>) {
    let slow = |rate_hz: f64| {
        let (period_ms, timeout_ms) = (1e3 / rate_hz, 1e3 * settings.safety.setpoint_timeout.as_secs_f64());
        Wrong::SlowMotors { rate_hz, period_ms, timeout_ms, least_hz: SOUND_RATE_HZ }
    };
    let rate_hz = settings.cycle.rate_hz;
    if rate_hz < SOUND_RATE_HZ {
        return findings.warn(document.cycle.rate_hz.at, slow(rate_hz));
    }
    for (bus, item) in settings.buses.iter().zip(&document.buses) {
        let rate_hz = rate_hz / f64::from(bus.every.get());
        if rate_hz < SOUND_RATE_HZ {
            findings.warn(item.keys.every.at, slow(rate_hz));
        }
    }
}

/// The name of the instance. Its rule is stricter than that of other names: it becomes a part of
/// paths and service names.
fn instance(keys: &keys::Daemon, findings: &mut Findings<'_>) -> String {
    let name = findings.name_or(&keys.instance, |name| Wrong::InstanceName { name });
    let name = name.unwrap_or_else(|| DEFAULT_INSTANCE.to_owned());
    if name.bytes().any(|byte| byte.is_ascii_uppercase() || byte == b'_') {
        findings.error(keys.instance.at, Wrong::InstanceName { name: name.clone() });
    }
    name
}

fn cycle(keys: &keys::Cycle, findings: &mut Findings<'_>) -> CycleSettings {
    let rate_hz = keys.rate_hz.value;
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    let cpu = findings.processor(&keys.cpu);
    // Other threads use a processor that is not dedicated.
    let default = if cpu.is_some() { BUSY_POLL } else { Duration::ZERO };
    let busy_poll_us = keys.busy_poll_us.value.unwrap_or(1e6 * default.as_secs_f64());
    findings.within_cycle(keys.busy_poll_us.at, busy_poll_us, period);
    let (require_realtime, priority) = (keys.require_realtime.value, keys.priority.value as u8);
    // The default priority is only checked where real time is required: otherwise the user did not
    // request it.
    if keys.priority.is_written || require_realtime {
        let at = if keys.priority.is_written { keys.priority.at } else { keys.require_realtime.at };
        findings.check_priority(at, priority, require_realtime);
    }
    CycleSettings {
        rate_hz,
        period,
        cpu,
        priority,
        require_realtime,
        max_lateness: millis(keys.max_lateness_ms.value),
        max_missed_ticks: keys.max_skipped_percent.value as f32 / 100.0,
        reply_deadline: period.mul_f64(keys.reply_deadline_percent.value / 100.0),
        busy_poll: micros(busy_poll_us),
        indicator_hz: keys.indicator_hz.value,
    }
}

fn ipc(keys: &keys::Ipc, cycle: &CycleSettings, findings: &mut Findings<'_>) -> IpcSettings {
    findings.within_cycle(keys.lead_us.at, keys.lead_us.value, cycle.period);
    findings.within_cycle(keys.busy_poll_us.at, keys.busy_poll_us.value, cycle.period);
    let (mode, cpu) = (keys.mode.value, findings.processor(&keys.cpu));
    if let (IpcMode::Spin, Some(cpu)) = (mode, cpu)
        && cycle.cpu == Some(cpu)
    {
        findings.error(keys.cpu.at, Wrong::SharedProcessor { cpu });
    }
    let priority = match (keys.priority.value, mode) {
        (Some(wanted), _) => wanted as u8,
        (None, IpcMode::Timed) => IpcSettings::beside(cycle).priority.unwrap_or(0),
        // Polling with a real-time priority blocks every other thread of the processor.
        (None, IpcMode::Spin) => 0,
    };
    if keys.priority.value.is_some() {
        findings.check_priority(keys.priority.at, priority, cycle.require_realtime);
    }
    IpcSettings {
        mode,
        lead: micros(keys.lead_us.value),
        busy_poll: micros(keys.busy_poll_us.value),
        cpu,
        priority: (priority > 0).then_some(priority),
    }
}

fn safety(keys: &keys::Safety, cycle: &CycleSettings, findings: &mut Findings<'_>) -> SafetySettings {
    let default = SafetySettings::of(cycle);
    findings.two_cycles(&keys.setpoint_timeout_ms, cycle.period);
    SafetySettings {
        setpoint_timeout: keys.setpoint_timeout_ms.value.map_or(default.setpoint_timeout, millis),
        setpoint_horizon_max: millis(keys.setpoint_horizon_max_ms.value),
        safe_stop: keys.safe_stop.value,
        damp: Duration::from_secs_f64(keys.damp_seconds.value),
        rest_velocity: keys.rest_velocity_rad_s.value as f32,
        lost_cycles: keys.lost_cycles.value as u32,
        start_jump: keys.start_jump_rad.value as f32,
        start_ramp: millis(keys.start_ramp_ms.value),
        start_timeout: millis(keys.start_timeout_ms.value),
        fault_poll_hz: keys.fault_poll_hz.value,
        deadman: deadman(keys, (cycle, default.deadman), findings),
        require_deadman: keys.require_deadman.value,
        stop_on_foreign_master: keys.stop_on_foreign_master.value,
        error_feedback: keys.error_feedback.value,
    }
}

/// Warns when the switch acts within the allowed lateness of a cycle: it would stop a healthy
/// daemon.
fn deadman(
    keys: &keys::Safety,
    (cycle, default): (&CycleSettings, Duration),
    findings: &mut Findings<'_>,
) -> Duration {
    findings.two_cycles(&keys.deadman_ms, cycle.period);
    let Some(deadman_ms) = keys.deadman_ms.value else { return default };
    if millis(deadman_ms) < default {
        let late_ms = 1e3 * default.as_secs_f64();
        findings.warn(keys.deadman_ms.at, Wrong::DeadmanBeforeLateness { deadman_ms, late_ms });
    }
    millis(deadman_ms)
}
