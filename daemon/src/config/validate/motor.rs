//! `[[motor]]`, its limits, and its ids on the bus.

use motord_bus::{Duration, FrameId};
use motord_protocol::model::MODELS;
use motord_protocol::{Model, TorqueScale};
use motord_shared::limits::JOINTS_MAX;
use toml::Spanned;

use super::limits::{self, Capability};
use super::micros;
use crate::config::problem::Wrong;
use crate::config::written::Integer;
use crate::config::{Findings, range, written};
use motord_core::drive;
use motord_core::joint::Transmission;
use motord_core::settings::{
    BeyondRange, BusKind, BusSettings, FaultPolicy, GroupSettings, MotorProtocol, MotorSettings,
    MotorSimulation, SafeStop,
};

type Written = Spanned<written::Motor>;

/// All motors, in the order of the file; `None` when one is not understood.
pub(super) fn motors(
    written: &[Written],
    buses: &[BusSettings],
    findings: &mut Findings<'_>,
) -> Option<Vec<MotorSettings>> {
    if !findings.counted(written, "motor", JOINTS_MAX) {
        return None;
    }
    // Collected twice: the first bad motor must not hide the others.
    let motors: Vec<_> = written.iter().map(|motor| self::motor(motor, buses, findings)).collect();
    let names = written.iter().map(|motor| motor.get_ref().name.as_ref());
    let are_named_apart = findings.unique(names, |name| Wrong::DuplicateName { name, what: "motor" });
    let motors = motors.into_iter().collect::<Option<Vec<_>>>()?;
    judge_ids(written, &motors, buses, findings);
    are_named_apart.then_some(motors)
}

fn motor(written: &Written, buses: &[BusSettings], findings: &mut Findings<'_>) -> Option<MotorSettings> {
    let keys = written.get_ref();
    let Identity { name, id, bus, protocol, model } = identity(written, buses, findings)?;
    let host_id = host_id(keys, id, &buses[bus], findings)?;
    let torque_scale = torque_scale(keys, model, findings)?;
    let capability = capability(keys, model, torque_scale, findings);
    let limits = limits::limits(&keys.limits, &capability, findings);
    let damping_kd = range::DAMPING_KD.default.min(limits.kd.into());
    let simulation = simulation(&keys.simulation, &capability, limits.position, findings);
    Some(MotorSettings {
        name,
        bus,
        id,
        host_id,
        protocol,
        model: model.name.to_owned(),
        torque_scale,
        rated_torque: capability.rated_torque as f32,
        peak_torque: capability.peak_torque as f32,
        overload: Duration::from_secs_f64(findings.number(&keys.overload_seconds, range::OVERLOAD_SECONDS)),
        max_velocity: capability.max_velocity as f32,
        transmission: capability.transmission,
        capabilities: drive::capabilities(protocol),
        damping_kd: findings.number(&keys.damping_kd, range::DAMPING_KD.or(damping_kd)) as f32,
        beyond_range: capability.beyond_range,
        fault_policy: keys.fault_policy.unwrap_or(FaultPolicy::StopGroup),
        limits,
        simulation,
    })
}

/// The keys that every motor must have.
struct Identity {
    name: String,
    id: u8,
    bus: usize,
    protocol: MotorProtocol,
    model: &'static Model,
}

fn identity(written: &Written, buses: &[BusSettings], findings: &mut Findings<'_>) -> Option<Identity> {
    let (table, keys) = (written.span(), written.get_ref());
    let name = findings.required(&keys.name, &table, "name", "every [[motor]] needs a name");
    let name = name.and_then(|name| findings.name(name));
    let id = findings.required(&keys.id, &table, "id", "give the motor's CAN id (ConfID 0x12)");
    let id =
        id.and_then(|id| findings.in_range(*id.get_ref() as f64, id.span(), range::ID)).map(|id| id as u8);
    let bus = findings.required(&keys.bus, &table, "bus", "name the [[bus]] the motor is on");
    let bus = bus.and_then(|bus| self::bus(bus, buses, findings));
    let protocol = findings.required(&keys.protocol, &table, "protocol", "give mit or gim");
    let model = findings.required(&keys.model, &table, "model", "give the motor's model, such as GIM8108-8");
    let model = model.and_then(|model| self::model(model, findings));
    if let (Some(protocol), Some(bus)) = (protocol, bus)
        && *protocol.get_ref() == MotorProtocol::Mit
        && is_serial(&buses[bus])
    {
        findings.error(protocol.span(), Wrong::MitOverSerial(buses[bus].name.clone()));
    }
    Some(Identity { name: name?, id: id?, bus: bus?, protocol: *protocol?.get_ref(), model: model? })
}

fn is_serial(bus: &BusSettings) -> bool {
    matches!(bus.kind, BusKind::Serial { .. })
}

fn bus(written: &Spanned<String>, buses: &[BusSettings], findings: &mut Findings<'_>) -> Option<usize> {
    let index = buses.iter().position(|bus| bus.name == *written.get_ref());
    if index.is_none() {
        findings.error(written.span(), Wrong::UnknownBus(written.get_ref().clone()));
    }
    index
}

fn model(written: &Spanned<String>, findings: &mut Findings<'_>) -> Option<&'static Model> {
    let model = Model::by_name(written.get_ref());
    if model.is_none() {
        let known = MODELS.map(|model| model.name).join(", ");
        findings.error(written.span(), Wrong::UnknownModel { model: written.get_ref().clone(), known });
    }
    model
}

fn torque_scale(keys: &written::Motor, model: &Model, findings: &mut Findings<'_>) -> Option<TorqueScale> {
    let constant = range::TORQUE_CONSTANT_NM_PER_A.or(model.torque_constant.into());
    let constant = findings.number(&keys.torque_constant_nm_per_a, constant);
    let gear_ratio = findings.number(&keys.gear_ratio, range::GEAR_RATIO.or(model.gear_ratio.into()));
    // The ranges leave only products that a float holds.
    TorqueScale::new(constant, gear_ratio).ok()
}

/// Without a key: on CAN an id that is the motor's own and yields to every command, on a serial bus the host's 0.
fn host_id(keys: &written::Motor, id: u8, bus: &BusSettings, findings: &mut Findings<'_>) -> Option<FrameId> {
    let range = match is_serial(bus) {
        true => range::HOST_ID_SERIAL,
        false => range::HOST_ID_CAN.or(range::HOST_ID_OFFSET + f64::from(id)),
    };
    FrameId::new(findings.integer(&keys.host_id, range) as u16)
}

fn capability(
    keys: &written::Motor,
    model: &Model,
    torque_scale: TorqueScale,
    findings: &mut Findings<'_>,
) -> Capability {
    let peak_torque =
        findings.number(&keys.peak_torque_nm, range::PEAK_TORQUE_NM.or(model.peak_torque.into()));
    let rated_torque = range::RATED_TORQUE_NM.or(peak_torque.min(model.rated_torque.into()));
    let rated_torque = findings.number(&keys.rated_torque_nm, rated_torque);
    limits::judge_peak(&keys.rated_torque_nm, rated_torque, peak_torque, findings);
    let max_velocity = range::MAX_VELOCITY_RAD_S.or(model.max_velocity.into());
    let direction = direction(&keys.direction, findings);
    let offset = findings.number(&keys.offset_rad, range::OFFSET_RAD);
    Capability {
        transmission: Transmission::new(direction as f32, offset as f32),
        beyond_range: keys.beyond_range.unwrap_or(BeyondRange::Stop),
        full_scale_torque: torque_scale.full_scale().into(),
        rated_torque,
        peak_torque,
        max_velocity: findings.number(&keys.max_velocity_rad_s, max_velocity),
    }
}

fn direction(written: &Integer, findings: &mut Findings<'_>) -> f64 {
    match written.as_ref().map(|written| (written.span(), *written.get_ref())) {
        None | Some((_, 1)) => 1.0,
        Some((_, -1)) => -1.0,
        Some((place, other)) => {
            findings.error(place, Wrong::Direction(other));
            1.0
        }
    }
}

fn simulation(
    written: &written::Simulation,
    capability: &Capability,
    [low, high]: [f32; 2],
    findings: &mut Findings<'_>,
) -> MotorSimulation {
    let at_start = range::INITIAL_POSITION_RAD;
    let at_start = at_start.or(at_start.default.clamp(low.into(), high.into()));
    let value = findings.number(&written.initial_position_rad, at_start);
    if let Some(written) = &written.initial_position_rad
        && !(low..=high).contains(&(value as f32))
    {
        findings.error(written.span(), Wrong::InitialPosition { value, low, high });
    }
    MotorSimulation {
        initial_position: capability.to_motor(value),
        load_inertia: findings.number(&written.load_inertia_kg_m2, range::LOAD_INERTIA_KG_M2),
        reply_latency: micros(findings.number(&written.reply_latency_us, range::REPLY_LATENCY_US)),
    }
}

/// The ids of a bus: a command id names one motor, and on CAN a reply id does too, because the arbitration needs every
/// id to have one sender and a native reply says its sender by nothing else. On a serial bus one request is open at a
/// time, so every reply may go to the same host.
fn judge_ids(
    written: &[Written],
    motors: &[MotorSettings],
    buses: &[BusSettings],
    findings: &mut Findings<'_>,
) {
    for (index, motor) in motors.iter().enumerate() {
        let place = |key: &Integer| key.as_ref().map_or(written[index].span(), Spanned::span);
        let host_place = place(&written[index].get_ref().host_id);
        let on_this_bus = || motors.iter().filter(|other| other.bus == motor.bus);
        let before = || motors[..index].iter().filter(|other| other.bus == motor.bus);
        if let Some(other) = before().find(|other| other.id == motor.id) {
            let place = place(&written[index].get_ref().id);
            findings.error(place, Wrong::DuplicateId { id: motor.id, other: other.name.clone() });
            continue;
        }
        if is_serial(&buses[motor.bus]) {
            continue;
        }
        let host_id = motor.host_id.raw();
        if let Some(other) = before().find(|other| other.host_id == motor.host_id) {
            let wrong = Wrong::DuplicateHostId { host_id, other: other.name.clone() };
            findings.error(host_place, wrong);
        } else if on_this_bus().any(|other| u16::from(other.id) == host_id) {
            findings.error(host_place, Wrong::HostIdIsCommandId { host_id });
        } else if let Some(command) =
            on_this_bus().map(|other| other.id).filter(|&id| u16::from(id) > host_id).max()
        {
            findings.warn(host_place, Wrong::HostIdOutranks { host_id, command });
        }
    }
}

/// Whether a safe stop can damp: each motor whose group damps or holds has a damping, and within its limit.
pub(super) fn judge_damping(
    written: &[Written],
    motors: &[MotorSettings],
    groups: &[GroupSettings],
    findings: &mut Findings<'_>,
) {
    for group in groups.iter().filter(|group| group.safe_stop != SafeStop::Stop) {
        for &index in &group.motors {
            let (keys, motor) = (written[index].get_ref(), &motors[index]);
            let place = keys.damping_kd.as_ref().map_or_else(|| written[index].span(), Spanned::span);
            let (damping, kd_max) = (f64::from(motor.damping_kd), f64::from(motor.limits.kd));
            if damping == 0.0 {
                findings.error(place, Wrong::NoDamping);
            } else if damping > kd_max {
                findings.error(place, Wrong::DampingBeyondLimit { damping, kd_max });
            }
        }
    }
}
