//! Checks `[[bus]]`, and the load of its motors.

use std::collections::BTreeSet;
use std::num::NonZero;

use motord_bus::transport::{BusKind, Serial, Simulated, SocketCan};
use motord_bus::{FrameId, Identity};
use motord_protocol::register;
use motord_settings::plan::{BusPlan, WORST_CASE_SOUND};
use motord_settings::settings::{BusSettings, MotorSettings, Settings};
use motord_shared::limits::BUSES_MAX;
use nix::net::if_::if_nametoindex;

use super::time::micros;
use crate::entry::{At, Entry, Item};
use crate::file::fnv1a;
use crate::findings::Findings;
use crate::keys::Bus;
use crate::problem::Wrong;
use crate::value::{BusType, Choice};

/// Commands to a motor that starts: neutral ones, the start, and some more until it has answered.
const START_TURNS: u32 = 15;
/// Shortest turn of a motor that only reports, without a warning, ms. docs/motors.md sets up reports
/// every 2 ms.
const TURN_MS_MIN: f64 = 1.9;
/// `IFNAMSIZ` of Linux without the closing zero.
const INTERFACE_BYTES_MAX: usize = 15;

/// The tables of the buses, and their settings.
pub(super) type Buses<'a> = (&'a [Item<Bus>], &'a [Option<BusSettings>]);

/// All buses, in the order of the file; `None` for one that cannot be built.
pub(super) fn buses(items: &[Item<Bus>], findings: &mut Findings<'_>) -> Vec<Option<BusSettings>> {
    findings.count(items, "bus", BUSES_MAX);
    let names = items.iter().map(|bus| &bus.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "bus" });
    let devices = items.iter().flat_map(|bus| [&bus.keys.interface, &bus.keys.device]);
    findings.unique(devices, |name| Wrong::DuplicateDevice { name });
    refuse_other_names(items, findings);
    items.iter().map(|bus| self::bus(&bus.keys, findings)).collect()
}

/// Reports an interface or a device that an earlier bus has under another name. An interface or
/// device that does not exist on this machine is not compared.
fn refuse_other_names(items: &[Item<Bus>], findings: &mut Findings<'_>) {
    let mut seen: Vec<(Identity, &str)> = Vec::new();
    for Item { keys, .. } in items {
        let (entry, identity): (_, fn(&str) -> _) = match keys.kind.value {
            Some(BusType::SocketCan) => (&keys.interface, Identity::of_interface),
            Some(BusType::Serial) => (&keys.device, Identity::of_device),
            Some(BusType::Simulated) | None => continue,
        };
        let Some(name) = entry.value.as_deref() else { continue };
        let Some(identity) = identity(name) else { continue };
        match seen.iter().find(|(known, other)| *known == identity && *other != name) {
            Some((_, other)) => {
                let (name, other) = (name.to_owned(), (*other).to_owned());
                findings.error(entry.at, Wrong::OtherName { name, other });
            }
            None => seen.push((identity, name)),
        }
    }
}

fn bus(keys: &Bus, findings: &mut Findings<'_>) -> Option<BusSettings> {
    let (name, kind) = (findings.name(&keys.name), kind(keys, findings));
    Some(BusSettings { name: name?, kind: kind?, every: NonZero::new(keys.every.value as u32)? })
}

fn kind(keys: &Bus, findings: &mut Findings<'_>) -> Option<BusKind> {
    let kind = keys.kind.value?;
    refuse_keys_of_other_types(kind, keys, findings);
    let bitrate = keys.bitrate.value as u32;
    match kind {
        BusType::SocketCan => {
            let hint = "give the CAN interface, such as interface = \"can0\"";
            let interface = findings.required(&keys.interface, hint)?;
            let interface = self::interface(interface, &keys.interface, findings)?;
            Some(SocketCan { interface, bitrate }.into())
        }
        BusType::Serial => {
            let device = findings.device(&keys.device)?;
            let baud = keys.baud.value as u32;
            let turnaround = micros(keys.turnaround_us.value);
            Some(Serial { device, baud, turnaround }.into())
        }
        BusType::Simulated => {
            // Two buses of one file have different names, so their noise differs.
            let from_name = || keys.name.value.as_ref().map_or(0, |name| fnv1a(name.as_bytes()));
            let seed = keys.seed.value.map_or_else(from_name, i64::cast_unsigned);
            Some(Simulated { bitrate, seed }.into())
        }
    }
}

/// Reports keys of another type: the type is wrong, or the key has no effect.
fn refuse_keys_of_other_types(kind: BusType, keys: &Bus, findings: &mut Findings<'_>) {
    use BusType::{Serial, Simulated, SocketCan};
    let owners: [(bool, _, &[BusType]); 6] = [
        (keys.interface.is_written, keys.interface.at, &[SocketCan]),
        (keys.bitrate.is_written, keys.bitrate.at, &[SocketCan, Simulated]),
        (keys.device.is_written, keys.device.at, &[Serial]),
        (keys.baud.is_written, keys.baud.at, &[Serial]),
        (keys.turnaround_us.is_written, keys.turnaround_us.at, &[Serial]),
        (keys.seed.is_written, keys.seed.at, &[Simulated]),
    ];
    for (is_written, at, kinds) in owners {
        if is_written && !kinds.contains(&kind) {
            findings.error(at, Wrong::NotOfThisBus { kind: kind.word() });
        }
    }
}

/// Checks that Linux accepts the name. A missing interface is only a warning, because an adapter
/// may be connected later. Searches the interface in the network namespace of this process; `/sys`
/// may show another namespace.
fn interface(name: &str, entry: &Entry<Option<String>>, findings: &mut Findings<'_>) -> Option<String> {
    let is_allowed = |c: char| c.is_ascii_graphic() && c != '/' && c != ':';
    if !(1..=INTERFACE_BYTES_MAX).contains(&name.len())
        || !name.chars().all(is_allowed)
        || name.starts_with('.')
    {
        findings.error(entry.at, Wrong::InterfaceName { name: name.to_owned() });
        return None;
    }
    if if_nametoindex(name).is_err() {
        findings.warn(entry.at, Wrong::NoInterface(name.to_owned()));
    }
    Some(name.to_owned())
}

/// Warns of a bus whose motors have ids of an earlier bus of the same kind. Simulated buses have no
/// adapters and no cables.
pub(super) fn check_shared_ids(items: &[Item<Bus>], settings: &Settings, findings: &mut Findings<'_>) {
    for (bus, item) in items.iter().enumerate() {
        if let Some((other, ids)) =
            (0..bus).find_map(|other| Some((other, shared_ids(settings, [other, bus])?)))
        {
            findings.warn(item.at, Wrong::SharedIds { ids, other: settings.buses[other].name.clone() });
        }
    }
}

/// The ids that motors of both buses have, as text; `None` without one, or where the buses cannot
/// be exchanged.
fn shared_ids(settings: &Settings, buses: [usize; 2]) -> Option<String> {
    let [kind, other_kind] = buses.map(|bus| &settings.buses[bus].kind);
    if kind.is_simulated() || kind.name() != other_kind.name() {
        return None;
    }
    let [ids, other_ids] = buses.map(|bus| {
        let motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        motors.map(|motor| motor.id).collect::<BTreeSet<_>>()
    });
    let shared: Vec<_> = ids.intersection(&other_ids).map(ToString::to_string).collect();
    (!shared.is_empty()).then(|| shared.join(", "))
}

/// Warns of a bus with a queue and a motor that follows what waited in it.
pub(super) fn check_enables(items: &[Item<Bus>], settings: &Settings, findings: &mut Findings<'_>) {
    for (bus, item) in items.iter().enumerate().filter(|(bus, _)| settings.buses[*bus].interface().is_some())
    {
        let mut motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let motor = motors.find(|motor| motor.capabilities.runs_without_enable);
        if let Some(MotorSettings { name, .. }) = motor {
            findings.warn(item.at, Wrong::NoEnable { motor: name.clone() });
        }
    }
}

/// Warns of turns that are shorter than the intervals in which motors report by themselves.
pub(super) fn check_reports(items: &[Item<Bus>], settings: &Settings, findings: &mut Findings<'_>) {
    for (bus, item) in items.iter().enumerate() {
        let mut motors = settings.motors.iter().filter(|motor| motor.bus == bus);
        let turn_ms = 1e3 * settings.cycle.period.as_secs_f64() * f64::from(settings.buses[bus].every.get());
        let motor = motors.find(|motor| motor.capabilities.only_reports && turn_ms < TURN_MS_MIN);
        if let Some(MotorSettings { name, .. }) = motor {
            findings.warn(item.keys.every.at, Wrong::TurnBeforeReports { motor: name.clone(), turn_ms });
        }
    }
}

/// Reports the buses that have no capacity for their motors.
pub(super) fn check_load(items: &[Item<Bus>], settings: &Settings, findings: &mut Findings<'_>) {
    for (bus, (plan, Item { at, keys })) in BusPlan::of(settings).iter().zip(items).enumerate() {
        if plan.motors == 0 {
            if settings.sensors.on_bus(bus).next().is_none() {
                findings.warn(*at, Wrong::EmptyBus);
            }
        } else if settings.buses[bus].is_line() {
            check_turns(keys, plan, settings, bus, findings);
        } else {
            check_can(*at, plan, settings, findings);
        }
        check_start(keys, settings, bus, findings);
    }
}

fn check_can(at: At, plan: &BusPlan, settings: &Settings, findings: &mut Findings<'_>) {
    let rate_hz = settings.cycle.rate_hz;
    let (motors, percent) = (plan.motors, 100.0 * plan.worst_case_utilisation);
    let deadline = settings.cycle.reply_deadline;
    if plan.last_reply.saturating_sub(plan.imu_time) > deadline {
        let [last_us, deadline_us] = [plan.last_reply, deadline].map(|time| 1e6 * time.as_secs_f64());
        let rate_hz_max = plan.rate_hz_max.floor();
        findings.error(at, Wrong::Overloaded { motors, rate_hz, last_us, deadline_us, rate_hz_max });
    } else if plan.worst_case_utilisation > WORST_CASE_SOUND {
        findings.warn(at, Wrong::Tight { motors, rate_hz, percent });
    }
    let polls = settings.safety.fault_poll_hz > 0.0;
    if polls && plan.last_reply <= deadline && plan.fault_poll_utilisation > 1.0 {
        let percent = 100.0 * plan.fault_poll_utilisation;
        findings.warn(at, Wrong::FaultPollTight { percent });
    }
}

/// Reports overlapping turns: a line carries one request at a time.
fn check_turns(keys: &Bus, plan: &BusPlan, settings: &Settings, bus: usize, findings: &mut Findings<'_>) {
    let (every, least) = (settings.buses[bus].every.get(), plan.every_least);
    if every < least {
        let turn_us = 1e6 * plan.transaction_worst.as_secs_f64();
        let wrong = Wrong::TurnsOverlap { every, least, turns: settings.turns(bus), turn_us };
        findings.error(keys.every.at, wrong);
    }
}

/// Reports a motor that takes turns and cannot start within its timeout.
fn check_start(keys: &Bus, settings: &Settings, bus: usize, findings: &mut Findings<'_>) {
    let round = settings.buses[bus].every.get() * settings.cycle.period;
    if settings.buses[bus].has_turns() && START_TURNS * round > settings.safety.start_timeout {
        let [round_ms, start_ms] =
            [round, settings.safety.start_timeout].map(|time| 1e3 * time.as_secs_f64());
        findings.error(keys.every.at, Wrong::SlowStart { turns: START_TURNS, round_ms, start_ms });
    }
}

/// Returns the index of the CAN bus of a sensor, `what`; `None` for one that is unknown or not CAN.
pub(super) fn of_sensor(
    entry: &Entry<Option<String>>,
    what: &'static str,
    (items, buses): Buses<'_>,
    findings: &mut Findings<'_>,
) -> Option<usize> {
    let name =
        findings.required(entry, &format!("name the [[bus]] the {what} is on, such as bus = \"body\""))?;
    let names = items.iter().map(|bus| &bus.keys.name);
    let bus = findings.find(entry.at, (name, "bus"), names, Wrong::UnknownBus)?;
    if buses[bus].as_ref()?.is_line() {
        findings.error(entry.at, Wrong::SensorOnLine(name.to_owned(), what));
        return None;
    }
    Some(bus)
}

/// Reports a sensor, `what`, for which its bus has no capacity. A bus that is too full without it
/// is reported itself.
pub(super) fn check_sensor_load(
    (at, what): (At, &'static str),
    plan: &BusPlan,
    settings: &Settings,
    findings: &mut Findings<'_>,
) {
    let deadline = settings.cycle.reply_deadline;
    if plan.last_reply.saturating_sub(plan.imu_time) > deadline {
        return;
    }
    if plan.last_reply > deadline {
        let [last_us, deadline_us] = [plan.last_reply, deadline].map(|time| 1e6 * time.as_secs_f64());
        let (rate_hz, rate_hz_max) = (settings.cycle.rate_hz, plan.rate_hz_max.floor());
        findings.error(at, Wrong::SensorOverloads { what, rate_hz, last_us, deadline_us, rate_hz_max });
    } else if plan.worst_case_utilisation > 1.0 {
        findings.error(at, Wrong::SensorFillsBus { what, percent: 100.0 * plan.worst_case_utilisation });
    }
}

/// Returns the use that a motor of a bus makes of an id, in words.
pub(super) fn motor_with(settings: &Settings, bus: usize, id: u16) -> Option<String> {
    let motors = || settings.motors.iter().filter(|motor| motor.bus == bus);
    let id = FrameId::new(id)?;
    let obeys = |motor: &&MotorSettings| {
        let mut obeyed = motor.addresses().obeyed(&motor.profile.ids);
        motor.addresses().commands.matches(id) || obeyed.any(|obeyed| obeyed == id)
    };
    if let Some(motor) = motors().find(obeys) {
        return Some(format!("commands to the motor {:?}", motor.name));
    }
    let owns = |motor: &&MotorSettings| motor.addresses().node.is_some_and(|node| node.matches(id));
    if let Some(motor) = motors().find(owns) {
        return Some(format!("an id of the CANSimple node of the motor {:?}", motor.name));
    }
    if let Some(motor) = motors().find(|motor| motor.addresses().replies.matches(id)) {
        return Some(format!("the replies of the motor {:?}", motor.name));
    }
    let is_request = Some(id) == FrameId::new(register::REQUEST_ID);
    let motor = motors().find(|motor| motor.profile.has_registers && is_request)?;
    Some(format!("requests to the registers of the motor {:?}", motor.name))
}
