//! Checks `[[motor]]` and its ids on the bus.

use motord_bus::{Duration, FrameId, IdFilter, IdSet};
use motord_protocol::drive::{Addresses, Transmission};
use motord_protocol::gim::ExecutionTime;
use motord_protocol::profile::{ReplyId, STEADYWIN};
use motord_protocol::{DriveConstants, Model, Profile, Scales, register};
use motord_settings::defaults::DAMPING_KD;
use motord_settings::settings::{
    BusSettings, GroupSettings, MotorSettings, MotorSimulation, SafeStop, Settings, WindingSettings,
};
use motord_shared::limits::JOINTS_MAX;

use super::limits::{self, Capability};
use super::model::{check_ends, check_reach, ends, model, registers, require_torque_end, scales};
use super::time::micros;
use crate::document::MotorTables;
use crate::entry::{self, Entry, degrees};
use crate::findings::Findings;
use crate::keys;
use crate::problem::Wrong;

pub(super) type Item = entry::Item<MotorTables>;
type BusItem = entry::Item<keys::Bus>;

/// The header of a serial frame has one byte for the receiver (GIM document, table 3).
const SERIAL_HOST_ID_MAX: i64 = 0xFF;
/// Least duration of a command, in turns: a lost frame must not end it.
const DURATION_TURNS: u32 = 3;

/// Returns all motors with their simulation, in the order of the file; `None` for one that cannot
/// be built.
pub(super) fn motors(
    items: &[Item],
    bus_items: &[BusItem],
    buses: &[Option<BusSettings>],
    findings: &mut Findings<'_>,
) -> Vec<Option<(MotorSettings, MotorSimulation)>> {
    findings.count(items, "motor", JOINTS_MAX);
    let names = items.iter().map(|motor| &motor.keys.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "motor" });
    let addresses: Vec<_> =
        items.iter().map(|motor| address(&motor.keys.keys, bus_items, buses, findings)).collect();
    check_ids(items, &addresses, findings);
    items.iter().zip(addresses).map(|(item, address)| motor(&item.keys, address, findings)).collect()
}

fn motor(
    item: &MotorTables,
    address: Option<Address>,
    findings: &mut Findings<'_>,
) -> Option<(MotorSettings, MotorSimulation)> {
    let keys = &item.keys;
    let name = findings.name(&keys.name);
    let (profile, model) = model(&keys.model, findings).unzip();
    check_constants(keys, model, findings);
    check_ends(keys, model, findings);
    require_torque_end(keys, profile, findings);
    let constants = constants(keys, model);
    let scales = model.and_then(|model| scales(keys, model));
    check_reach(keys, (model, scales.as_ref()), findings);
    let capability = capability(keys, model, scales, findings);
    let limits = limits::limits(&item.limits, &capability, findings);
    let simulation = simulation(&item.simulation, &capability, limits.position, findings);
    let Address { bus, id, host_id, .. } = address?;
    let protocol = keys.protocol.value?;
    let settings = MotorSettings {
        name: name?,
        bus,
        id,
        host_id,
        protocol,
        model: model?.name.to_owned(),
        profile: profile?,
        scales: scales?,
        constants: constants.filter(|_| model.is_some_and(|model| protocol.family().uses_constants(model))),
        winding: WindingSettings {
            rated_torque: capability.rated_torque as f32,
            peak_torque: capability.peak_torque as f32,
            overload: Duration::from_secs_f64(keys.overload_seconds.value),
        },
        max_velocity: capability.max_velocity as f32,
        transmission: capability.transmission,
        capabilities: (protocol.family().capabilities)(profile?, &scales?),
        registers: registers(keys, &capability, &limits),
        duration: ExecutionTime::from_millis(keys.control_duration_ms.value as u32)?,
        damping_kd: keys.damping_kd.value.unwrap_or(DAMPING_KD.min(limits.kd.into())) as f32,
        beyond_range: capability.beyond_range,
        fault_policy: keys.fault_policy.value,
        may_be_excluded: keys.may_be_excluded.value,
        excluded: excluded(keys, findings),
        limits,
    };
    Some((settings, simulation))
}

/// The bus of a motor, and its ids there.
struct Address {
    bus: usize,
    is_serial: bool,
    id: u8,
    host_id: FrameId,
    /// That of the model and its protocol.
    default_host_id: u16,
    on_wire: Addresses,
    profile: &'static Profile,
}

impl Address {
    /// Returns whether some id commands both motors, or `motorctl` cannot name one alone: it names a
    /// motor by its id, without its protocol.
    fn is_named_alike(&self, other: &Self) -> bool {
        // The ids of a node are checked as a whole.
        let is_node = self.on_wire.node.is_some() || other.on_wire.node.is_some();
        let obeys = |one: &Self, other: &Self| !is_node && one.obeys(other.on_wire.commands);
        self.on_wire.commands.overlaps(other.on_wire.commands)
            || obeys(self, other)
            || obeys(other, self)
            || self.id == other.id
    }

    /// Returns whether its replies have its host id. In another id the host id is a part or has no
    /// effect, and does not decide the priority.
    fn has_reply_id(&self) -> bool {
        self.on_wire.replies == IdFilter::exact(self.host_id).into()
    }

    /// Returns an id of `node` that this motor uses, and its use in words.
    fn uses(&self, node: IdFilter) -> Option<(FrameId, &'static str)> {
        let of = |ids: IdSet| ids.overlap(node.into()).map(|ids| ids.lowest().max(node.lowest()));
        let obeyed = self.on_wire.obeyed(&self.profile.ids).find(|id| node.matches(*id));
        let request = FrameId::new(register::REQUEST_ID).filter(|_| self.profile.has_registers);
        let commands = of(self.on_wire.receives()).or(obeyed).map(|id| (id, "commands"));
        let replies = of(self.on_wire.replies).map(|id| (id, "replies"));
        let registers = request.filter(|id| node.matches(*id)).map(|id| (id, "requests to the registers"));
        commands.or(replies).or(registers)
    }

    /// Returns whether the motor reads one of the ids as a command, or as a request to its
    /// registers. These have one id for all motors of the bus.
    fn obeys(&self, ids: IdSet) -> bool {
        let is_request = FrameId::new(register::REQUEST_ID).is_some_and(|id| ids.matches(id));
        self.on_wire.commands.overlaps(ids)
            || self.on_wire.obeyed(&self.profile.ids).any(|id| ids.matches(id))
            || self.profile.has_registers && is_request
    }
}

/// `None` when a part is not known, or its bus cannot be built.
fn address(
    keys: &keys::Motor,
    bus_items: &[BusItem],
    buses: &[Option<BusSettings>],
    findings: &mut Findings<'_>,
) -> Option<Address> {
    let names = bus_items.iter().map(|bus| &bus.keys.name);
    let bus = findings.find(keys.bus.at, (keys.bus.value.as_deref()?, "bus"), names, Wrong::UnknownBus)?;
    let settings = buses[bus].as_ref()?;
    let is_serial = settings.is_line();
    let named = keys.model.value.as_deref().and_then(Profile::of_model);
    let profile = named.map_or_else(|| &*STEADYWIN, |(profile, _)| profile);
    if let Some(protocol) = keys.protocol.value {
        if is_serial && protocol.family().answers_on_line.is_none() {
            findings.error(
                keys.protocol.at,
                Wrong::OnlyOverCan { bus: settings.name.clone(), protocol: protocol.name() },
            );
        }
        if !protocol.family().is_spoken_by(profile) {
            let (motors, protocol) = (profile.motors, protocol.name());
            let spoken = profile.protocols.first().unwrap_or(&"mit");
            findings.error(keys.protocol.at, Wrong::NotSpoken { motors, protocol, spoken });
        }
    }
    let ids = &profile.ids;
    let family = keys.protocol.value.unwrap_or_default().family();
    let [least_id, largest_id] = (family.ids)(profile).map(i64::from);
    let id = at_most(&keys.id, keys.id.value?, largest_id, least_id, findings)?;
    let default = if is_serial { 0 } else { (family.default_host_id)(profile, id as u8).into() };
    let largest = if is_serial { SERIAL_HOST_ID_MAX } else { ids.largest_reply.into() };
    let host_id = at_most(&keys.host_id, keys.host_id.value.unwrap_or(default), largest, 0, findings)?;
    let (id, host_id) = (id as u8, FrameId::new(host_id as u16)?);
    let on_wire = (family.addresses)(id, host_id);
    let default_host_id = (family.default_host_id)(profile, id);
    Some(Address { bus, is_serial, id, host_id, default_host_id, on_wire, profile })
}

/// Returns the id, if its vendor allows it.
fn at_most(
    entry: &Entry<Option<i64>>,
    id: i64,
    largest: i64,
    least: i64,
    findings: &mut Findings<'_>,
) -> Option<i64> {
    if !(least..=largest).contains(&id) {
        let expected = format!("from {least} to {largest}");
        findings.error(entry.at, Wrong::OutOfRange { value: id as f64, expected, hint: String::new() });
    }
    (least..=largest).contains(&id).then_some(id)
}

/// Reports constants of a current that are written for a motor whose codes are torques: they would
/// have no effect.
fn check_constants(keys: &keys::Motor, model: Option<&Model>, findings: &mut Findings<'_>) {
    let Some(model) = model.filter(|model| ends(keys, model).is_some()) else { return };
    let reports_rotor = keys.protocol.value.is_some_and(|protocol| protocol.family().reports_rotor);
    let ratio = (!reports_rotor).then_some(&keys.gear_ratio);
    for entry in [Some(&keys.torque_constant_nm_per_a), ratio].into_iter().flatten() {
        if entry.is_written {
            findings.error(entry.at, Wrong::NoCurrentCode { model: model.name });
        }
    }
}

/// Returns the constants of the codes, as written or of the model.
fn constants(keys: &keys::Motor, model: Option<&Model>) -> Option<DriveConstants> {
    let of_model = DriveConstants::of(model?);
    Some(DriveConstants {
        torque_constant: keys.torque_constant_nm_per_a.value.unwrap_or(of_model.torque_constant),
        gear_ratio: keys.gear_ratio.value.unwrap_or(of_model.gear_ratio),
        ..of_model
    })
}

fn capability(
    keys: &keys::Motor,
    model: Option<&Model>,
    scales: Option<Scales>,
    findings: &mut Findings<'_>,
) -> Capability {
    let of_model = |fact: fn(&Model) -> f32| model.map_or(f64::INFINITY, |model| fact(model).into());
    let [torque_end, velocity_end] =
        scales.map_or([f64::INFINITY; 2], |scales| [scales.torque.max(), scales.velocity.max()]);
    let peak_torque =
        keys.peak_torque_nm.value.unwrap_or(of_model(|model| model.peak_torque).min(torque_end));
    let rated_torque = of_model(|model| model.rated_torque).min(peak_torque);
    let rated_torque = keys.rated_torque_nm.value.unwrap_or(rated_torque);
    limits::check_peak(keys.rated_torque_nm.at, rated_torque, peak_torque, findings);
    Capability {
        transmission: Transmission::new(direction(&keys.direction, findings), keys.offset_rad.value as f32),
        beyond_range: keys.beyond_range.value,
        scales,
        rated_torque,
        peak_torque,
        max_velocity: (keys.max_velocity_rad_s.value)
            .unwrap_or(of_model(|model| model.max_velocity).min(velocity_end)),
    }
}

fn direction(entry: &Entry<i64>, findings: &mut Findings<'_>) -> f32 {
    match entry.value {
        1 => 1.0,
        -1 => -1.0,
        other => {
            findings.error(entry.at, Wrong::Direction(other));
            1.0
        }
    }
}

fn simulation(
    keys: &keys::Simulation,
    capability: &Capability,
    [low, high]: [f32; 2],
    findings: &mut Findings<'_>,
) -> MotorSimulation {
    let value = keys.initial_position_rad.value.unwrap_or(0.0_f64.clamp(low.into(), high.into()));
    if !(low..=high).contains(&(value as f32)) {
        let wrong = Wrong::InitialPosition { value, low, high, degrees: degrees(value) };
        findings.error(keys.initial_position_rad.at, wrong);
    }
    MotorSimulation {
        initial_position: capability.to_motor(value),
        load_inertia: keys.load_inertia_kg_m2.value,
        armature: keys.armature_kg_m2.value,
        viscous_friction: keys.viscous_friction_nm_s_per_rad.value,
        coulomb_friction: keys.coulomb_friction_nm.value,
        reply_latency: micros(keys.reply_latency_us.value),
    }
}

/// Checks the ids of a bus. A command id names one motor. On CAN a reply id names one motor, too:
/// the arbitration needs one sender for every id, and nothing else in a GIM reply names its sender.
/// On a serial bus one request is open at a time, so all replies may have one host id. A late reply
/// may then be taken for that of another motor: a warning.
fn check_ids(items: &[Item], addresses: &[Option<Address>], findings: &mut Findings<'_>) {
    let named = |index: usize| items[index].keys.keys.name.value.clone().unwrap_or_default();
    let on_bus = |bus| {
        let known =
            addresses.iter().enumerate().filter_map(|(index, address)| Some((index, address.as_ref()?)));
        known.filter(move |(_, other)| other.bus == bus)
    };
    for (index, motor) in addresses.iter().enumerate() {
        let Some(motor) = motor else { continue };
        let keys = &items[index].keys.keys;
        let replies = motor.on_wire.replies;
        let mut before = on_bus(motor.bus).take_while(|(other, _)| *other < index);
        if let Some((other, _)) = before.clone().find(|(_, other)| other.is_named_alike(motor)) {
            findings.error(keys.id.at, Wrong::DuplicateId { id: motor.id, other: named(other) });
            continue;
        }
        if motor.on_wire.node.is_some() {
            let wrong = owned_id(motor, on_bus(motor.bus).filter(|(other, _)| *other != index), named);
            wrong.into_iter().for_each(|wrong| findings.error(keys.id.at, wrong));
            continue;
        }
        if motor.is_serial {
            let mut alike = before.filter(|(_, other)| other.host_id == motor.host_id);
            // One warning for each id, at the second motor that has it.
            if let (Some((other, _)), None) = (alike.next(), alike.next()) {
                let host_id = motor.host_id.raw();
                findings.warn(keys.host_id.at, Wrong::SharedHostId { host_id, other: named(other) });
            }
            continue;
        }
        let (host_id, default) = (motor.host_id.raw(), motor.default_host_id);
        let is_reply_id = motor.has_reply_id();
        let last = on_bus(motor.bus).filter(|(_, other)| other.has_reply_id());
        let last = last.map(|(_, other)| other.on_wire.command_id.raw()).max();
        let is_shared =
            matches!(motor.profile.ids.reply, ReplyId::Shared(shared) if u32::from(shared) == host_id);
        if let Some((other, _)) = before.find(|(_, other)| other.on_wire.replies.overlaps(replies)) {
            let (other, motors) = (named(other), motor.profile.motors);
            let wrong = match is_shared {
                true => Wrong::SharedReplies { host_id, other, motors },
                false => Wrong::DuplicateHostId { host_id, other, default },
            };
            findings.error(keys.host_id.at, wrong);
        } else if on_bus(motor.bus).any(|(_, other)| other.obeys(replies)) {
            findings.error(keys.host_id.at, Wrong::HostIdIsCommandId { host_id, default });
        } else if let Some(command) = last.filter(|&last| is_reply_id && !is_shared && last > host_id) {
            findings.warn(keys.host_id.at, Wrong::HostIdOutranks { host_id, command, default });
        }
    }
}

/// Returns the error of a node that owns an id which one of the `others` uses.
fn owned_id<'a>(
    motor: &Address,
    mut others: impl Iterator<Item = (usize, &'a Address)>,
    named: impl Fn(usize) -> String,
) -> Option<Wrong> {
    let owned = motor.on_wire.node?;
    let (other, (used, what)) = others.find_map(|(other, address)| Some((other, address.uses(owned)?)))?;
    Some(Wrong::NodeOwnsId { node: motor.id, id: used.raw() as u16, what, other: named(other) })
}

/// Warns about an excluded joint that may not be excluded: its group cannot start.
fn excluded(keys: &keys::Motor, findings: &mut Findings<'_>) -> bool {
    let excluded = keys.excluded.value;
    if excluded && !keys.may_be_excluded.value {
        findings.warn(keys.excluded.at, Wrong::NeedlesslyExcluded);
    }
    excluded
}

/// Reports commands that may end before the next one.
pub(super) fn check_durations(items: &[Item], settings: &Settings, findings: &mut Findings<'_>) {
    for (motor, item) in settings.motors.iter().zip(items) {
        let (at, duration_ms) =
            (item.keys.keys.control_duration_ms.at, i64::from(motor.duration.as_millis()));
        let round = settings.buses[motor.bus].every.get() * settings.cycle.period;
        let [round_ms, least_ms] = [round, DURATION_TURNS * round].map(|time| 1e3 * time.as_secs_f64());
        if duration_ms == 0 {
            continue;
        }
        if !motor.protocol.family().has_durations {
            findings.error(at, Wrong::NoDuration);
        } else if (duration_ms as f64) < least_ms {
            findings.error(at, Wrong::ShortDuration { duration_ms, round_ms, least_ms });
        }
    }
}

/// Reports a motor without usable damping whose group damps or holds in a safe stop. A GIM motor
/// needs none.
pub(super) fn check_damping(
    items: &[Item],
    motors: &[Option<MotorSettings>],
    groups: &[GroupSettings],
    findings: &mut Findings<'_>,
) {
    let damped = groups.iter().filter(|group| group.safe_stop != SafeStop::Stop);
    for &index in damped.flat_map(|group| &group.motors) {
        let (at, Some(motor)) = (items[index].keys.keys.damping_kd.at, &motors[index]) else { continue };
        let (damping, kd_max) = (f64::from(motor.damping_kd), f64::from(motor.limits.kd));
        if !motor.capabilities.impedance {
            if items[index].keys.keys.damping_kd.value.is_some() {
                findings.warn(at, Wrong::DampingUnused);
            }
        } else if damping == 0.0 {
            findings.error(at, Wrong::NoDamping);
        } else if damping > kd_max {
            findings.error(at, Wrong::DampingBeyondLimit { damping, kd_max });
        }
    }
}
