//! The frames of a motor at zero and at the ends of each quantity, for a comparison with its manual.

use motord_protocol::mit::{Command, Impedance, Reply, State};
use motord_protocol::profile::FaultReport;
use motord_protocol::{Field, Model, Profile, Scales, StateCodes};
use serde::Serialize;

/// The id of the motor.
const ID: u8 = 1;
/// The upper of the two codes beside zero, in every field.
const MIDDLE: StateCodes = StateCodes { position: 0x8000, velocity: 0x800, torque: 0x800 };

/// A frame.
#[derive(Debug, Serialize)]
pub(super) struct Golden {
    pub(super) model: &'static str,
    /// `to-motor` or `to-host`.
    pub(super) direction: &'static str,
    /// The command, or the quantity that has the value. All other quantities are zero.
    pub(super) frame: String,
    pub(super) value: Option<f64>,
    pub(super) unit: &'static str,
    /// The payload.
    pub(super) payload: String,
}

/// A quantity of a frame: its name, unit and codes.
type Quantity = (&'static str, &'static str, Field);

/// Returns the frames of a model.
pub(super) fn golden(profile: &Profile, model: &'static Model) -> Vec<Golden> {
    let Ok(scales) = model.scales() else { return Vec::new() };
    let commands = special(profile, &scales).into_iter().chain(controls(profile, &scales));
    let replies = states(profile, &scales).into_iter().chain(reports(profile));
    let row = |direction| {
        move |(frame, value, unit, bytes): Row| Golden {
            model: model.name,
            direction,
            frame,
            value,
            unit,
            payload: hex(&bytes),
        }
    };
    commands.map(row("to-motor")).chain(replies.map(row("to-host"))).collect()
}

/// Name, value, unit and payload.
type Row = (String, Option<f64>, &'static str, Vec<u8>);

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect()
}

/// Every frame that is no control frame, as far as the motor has it.
fn special(profile: &Profile, scales: &Scales) -> Vec<Row> {
    let has_clear = profile.special.clear.is_some();
    let is_asked = profile.is_asked_for_faults();
    let all = [
        ("start", Command::Start, true),
        ("stop", Command::Stop, true),
        ("set zero", Command::SetZero, true),
        ("clear fault", Command::ClearFault, has_clear),
        ("get fault", Command::GetFault, is_asked),
    ];
    let known = all.into_iter().filter(|(_, _, is_known)| *is_known);
    known
        .filter_map(|(name, command, _)| {
            let bytes = profile.encode(&command, scales).ok()?;
            Some((name.to_owned(), None, "", bytes.to_vec()))
        })
        .collect()
}

/// Control frames with one quantity at its ends.
fn controls(profile: &Profile, scales: &Scales) -> Vec<Row> {
    let quantities: [Quantity; 5] = [
        ("position", "rad", scales.position),
        ("velocity", "rad/s", scales.velocity),
        ("kp", "Nm/rad", scales.kp),
        ("kd", "Nm s/rad", scales.kd),
        ("torque", "Nm", scales.torque),
    ];
    let with = |name: &str, value: f64| {
        let of = |other| if name == other { value as f32 } else { 0.0 };
        let [position, velocity, kp, kd, torque] = quantities.map(|(name, ..)| of(name));
        Command::Control(Impedance { position, velocity, kp, kd, torque })
    };
    let zero = ("all zero", "", 0.0);
    let ends = quantities.iter().flat_map(|(name, unit, field)| {
        let ends = if field.min() < 0.0 { vec![field.min(), field.max()] } else { vec![field.max()] };
        ends.into_iter().map(move |end| (*name, *unit, end))
    });
    let rows = core::iter::once(zero).chain(ends).filter_map(|(name, unit, value)| {
        let bytes = profile.encode(&with(name, value), scales).ok()?;
        Some((name.to_owned(), Some(value), unit, bytes.to_vec()))
    });
    rows.collect()
}

/// States with one quantity at its ends, of a motor without a fault.
fn states(profile: &Profile, scales: &Scales) -> Vec<Row> {
    let quantities: [Quantity; 3] = [
        ("position", "rad", scales.position),
        ("velocity", "rad/s", scales.velocity),
        ("torque", "Nm", scales.torque),
    ];
    let zero = ("all zero", "", 0.0);
    let ends = quantities
        .iter()
        .flat_map(|(name, unit, field)| [(*name, *unit, field.min()), (*name, *unit, field.max())]);
    let mut rows: Vec<Row> = Vec::new();
    for (name, unit, value) in core::iter::once(zero).chain(ends) {
        let code =
            |of: &str, field: &Field| field.encode(if name == of { value } else { 0.0 }).unwrap_or_default();
        let [position, velocity, torque] = quantities.map(|(of, _, field)| code(of, &field));
        let codes = StateCodes { position, velocity, torque };
        rows.push((name.to_owned(), Some(value), unit, state(profile, scales, codes, [0.0; 2])));
    }
    for (index, temperature) in profile.reply.temperatures.iter().enumerate() {
        for celsius in [-1000.0, 1000.0] {
            let mut celsiuses = [0.0; 2];
            celsiuses[index] = celsius;
            let bytes = state(profile, scales, MIDDLE, celsiuses);
            let read = profile.decode_state(&bytes, scales).ok();
            let value = read.and_then(|state| state.temperatures[index]).map(f64::from);
            rows.push((format!("temperature of {}", temperature.of), value, "°C", bytes));
        }
    }
    rows
}

/// Returns the payload of a state.
fn state(profile: &Profile, scales: &Scales, codes: StateCodes, celsius: [f32; 2]) -> Vec<u8> {
    let [position, velocity, torque] = codes.scaled(scales);
    let temperatures = celsius.map(Some);
    let state = State { id: ID, position, velocity, torque, codes, temperatures, status: healthy(profile) };
    written(profile, &Reply::State(state))
}

/// Returns the status of a motor that runs, or is healthy.
fn healthy(profile: &Profile) -> Option<u8> {
    let FaultReport::InEveryReply(status) = profile.faults else { return None };
    (0..=u8::MAX >> status.shift).rev().find(|code| status.faults(*code).is_none())
}

/// Reports of each fault: on request, or in a state.
fn reports(profile: &Profile) -> Vec<Row> {
    let words = profile.fault_numbers();
    let rows = words.map(|(number, faults)| {
        let names: Vec<_> = motord_shared::Fault::of_bits(faults.0).map(motord_shared::Fault::name).collect();
        let reply = match profile.faults {
            FaultReport::Asked(_) => Reply::Fault { id: ID, number, faults },
            _ => Reply::State(State {
                id: ID,
                position: 0.0,
                velocity: 0.0,
                torque: 0.0,
                codes: MIDDLE,
                temperatures: [Some(0.0); 2],
                status: Some(number as u8),
            }),
        };
        (format!("fault {}", names.join(" ")), None, "", written(profile, &reply))
    });
    rows.collect()
}

fn written(profile: &Profile, reply: &Reply) -> Vec<u8> {
    let (bytes, known) = profile.encode_over(reply, [0; 8]);
    bytes[..known].to_vec()
}
