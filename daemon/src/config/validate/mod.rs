//! From what is written to what is meant: defaults, ranges, and whether the whole makes sense.
//!
//! Nothing here stops at the first problem: a bad value is reported, replaced by its default, and judging goes on.

mod bus;
mod group;
mod limits;
mod motor;

use motord_bus::Duration;
use motord_shared::DEFAULT_INSTANCE;
use toml::Spanned;

use crate::config::problem::Wrong;
use crate::config::written::{self, Document};
use crate::config::{Findings, range};
use motord_core::settings::{CycleSettings, IpcMode, IpcSettings, SafeStop, SafetySettings, Settings};

/// Judges the whole document. `None` when something is missing that nothing can stand in for, and that the rest refers
/// to: motors to buses, groups to motors. The reason is among the findings then.
pub(super) fn settings(document: &Document, findings: &mut Findings<'_>) -> Option<Settings> {
    let instance = match &document.daemon.instance {
        Some(name) => instance(name, findings)?,
        None => DEFAULT_INSTANCE.to_owned(),
    };
    let cycle = cycle(&document.cycle, findings);
    let ipc = ipc(&document.exchange, &cycle, findings);
    let safety = safety(&document.safety, &cycle, findings);
    let buses = bus::buses(&document.bus, findings)?;
    let motors = motor::motors(&document.motor, &buses, findings)?;
    let groups = group::groups(&document.group, &motors, safety.safe_stop, findings)?;
    motor::judge_damping(&document.motor, &motors, &groups, findings);
    let settings = Settings { instance, cycle, ipc, safety, buses, motors, groups };
    bus::judge_load(&document.bus, &settings, findings);
    Some(settings)
}

/// Its rule is stricter than that of the other names: it becomes a part of paths and service names.
fn instance(written: &Spanned<String>, findings: &mut Findings<'_>) -> Option<String> {
    let name = findings.name(written)?;
    if name.bytes().any(|byte| byte.is_ascii_uppercase() || byte == b'_') {
        findings.error(written.span(), Wrong::InstanceName { name });
        return None;
    }
    Some(name)
}

fn cycle(written: &written::Cycle, findings: &mut Findings<'_>) -> CycleSettings {
    let rate_hz = findings.number(&written.rate_hz, range::RATE_HZ);
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    let busy_poll = micros(findings.number(&written.busy_poll_us, range::BUSY_POLL_US));
    findings.within_cycle(&written.busy_poll_us, busy_poll, period);
    let deadline_percent = findings.number(&written.reply_deadline_percent, range::REPLY_DEADLINE_PERCENT);
    let require_realtime = written.require_realtime.as_ref().is_some_and(|value| *value.get_ref());
    let priority = findings.integer(&written.priority, range::PRIORITY) as u8;
    let place = written.priority.as_ref().map(Spanned::span);
    let place = place.or(written.require_realtime.as_ref().filter(|_| require_realtime).map(Spanned::span));
    findings.judge_priority(place, priority, require_realtime);
    CycleSettings {
        rate_hz,
        period,
        cpu: findings.processor(&written.cpu),
        priority,
        require_realtime,
        max_lateness: millis(findings.number(&written.max_lateness_ms, range::MAX_LATENESS_MS)),
        max_missed_ticks: findings.number(&written.max_skipped_percent, range::MAX_SKIPPED_PERCENT) as f32
            / 100.0,
        reply_deadline: period.mul_f64(deadline_percent / 100.0),
        busy_poll,
    }
}

fn ipc(written: &written::Exchange, cycle: &CycleSettings, findings: &mut Findings<'_>) -> IpcSettings {
    let lead = micros(findings.number(&written.lead_us, range::LEAD_US));
    findings.within_cycle(&written.lead_us, lead, cycle.period);
    let mode = written.mode.unwrap_or(IpcMode::Timed);
    let cpu = findings.processor(&written.cpu);
    if let (IpcMode::Spin, Some(cpu), Some(place)) = (mode, cpu, &written.cpu)
        && cycle.cpu == Some(cpu)
    {
        findings.error(place.span(), Wrong::SharedProcessor { cpu });
    }
    let priority = written.priority.as_ref().map(|place| {
        let priority = findings.integer(&written.priority, range::PRIORITY) as u8;
        findings.judge_priority(Some(place.span()), priority, cycle.require_realtime);
        priority
    });
    IpcSettings { mode, lead, cpu, priority }
}

fn safety(written: &written::Safety, cycle: &CycleSettings, findings: &mut Findings<'_>) -> SafetySettings {
    let cycle_ms = 1e3 * cycle.period.as_secs_f64();
    let timeout = range::SETPOINT_TIMEOUT_MS;
    let timeout = timeout.or(timeout.default.max(2.0 * cycle_ms));
    let setpoint_timeout_ms = findings.number(&written.setpoint_timeout_ms, timeout);
    findings.two_cycles(&written.setpoint_timeout_ms, setpoint_timeout_ms, cycle.period);
    let late_ms = 1e3 * cycle.max_lateness.as_secs_f64() + range::DEADMAN_CYCLES * cycle_ms;
    let deadman_ms = findings.number(&written.deadman_ms, range::DEADMAN_MS.or(late_ms));
    findings.two_cycles(&written.deadman_ms, deadman_ms, cycle.period);
    if let Some(written) = &written.deadman_ms
        && deadman_ms < late_ms
    {
        findings.warn(written.span(), Wrong::DeadmanBeforeLateness { deadman_ms, late_ms });
    }
    SafetySettings {
        setpoint_timeout: millis(setpoint_timeout_ms),
        safe_stop: written.safe_stop.unwrap_or(SafeStop::Damp),
        damp: Duration::from_secs_f64(findings.number(&written.damp_seconds, range::DAMP_SECONDS)),
        rest_velocity: findings.number(&written.rest_velocity_rad_s, range::REST_VELOCITY_RAD_S) as f32,
        lost_cycles: findings.integer(&written.lost_cycles, range::LOST_CYCLES) as u32,
        start_jump: findings.number(&written.start_jump_rad, range::START_JUMP_RAD) as f32,
        start_ramp: millis(findings.number(&written.start_ramp_ms, range::START_RAMP_MS)),
        start_timeout: millis(findings.number(&written.start_timeout_ms, range::START_TIMEOUT_MS)),
        fault_poll_hz: findings.number(&written.fault_poll_hz, range::FAULT_POLL_HZ),
        deadman: millis(deadman_ms),
        error_feedback: written.error_feedback.unwrap_or(true),
    }
}

fn millis(value: f64) -> Duration {
    Duration::from_secs_f64(value * 1e-3)
}

fn micros(value: f64) -> Duration {
    Duration::from_secs_f64(value * 1e-6)
}
