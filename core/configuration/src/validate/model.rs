//! Finds the model of a motor, and the ends of its codes.

use motord_protocol::{Ends, Model, Profile, Scales};
use motord_settings::settings::{BeyondRange, LimitSettings, REGISTERS_MAX, RegisterRange};

use super::limits::Capability;

use crate::entry::Entry;
use crate::findings::Findings;
use crate::keys;
use crate::problem::{Wrong, plain};

/// Returns the model that is named, and the facts of its vendor.
pub(super) fn model(
    entry: &Entry<Option<String>>,
    findings: &mut Findings<'_>,
) -> Option<(&'static Profile, &'static Model)> {
    let name = entry.value.as_ref()?;
    let model = Profile::of_model(name);
    if model.is_none() {
        findings.error(entry.at, Wrong::UnknownModel { model: plain(name), hint: hint(name) });
    }
    model
}

/// Returns advice for an unknown model. Suggests only another spelling of the same model: codes of
/// similar names can have other ends.
fn hint(written: &str) -> String {
    let known = || Profile::all().flat_map(|profile| profile.models).map(|model| model.name);
    let begins = format!("{}-", written.to_uppercase());
    let number_written = number(written);
    let is_same = |name: &&str| {
        !number_written.is_empty() && number(name) == number_written || name.starts_with(&begins)
    };
    let mut same = known().filter(is_same);
    match (same.next(), same.next()) {
        (Some(name), None) => format!("did you mean `{name}`?"),
        _ => format!(
            "known are {}; for another motor, name one of the same vendor and give the ends of its codes: position-end-rad, \
             velocity-end-rad-s, torque-end-nm",
            known().collect::<Vec<_>>().join(", ")
        ),
    }
}

/// Returns the part of a name that distinguishes models: everything from the first digit on,
/// without separators and without the ending of Damiao's motors with two encoders.
fn number(name: &str) -> String {
    let first = name.find(|c: char| c.is_ascii_digit()).unwrap_or(name.len());
    let number: String = name[first..].chars().filter(char::is_ascii_alphanumeric).collect();
    let number = number.to_uppercase();
    number.strip_suffix("2EC").map_or(number.clone(), str::to_owned)
}

/// Reports ends of codes that are written for a motor whose codes have none.
pub(super) fn check_ends(keys: &keys::Motor, model: Option<&Model>, findings: &mut Findings<'_>) {
    let Some(model) = model else { return };
    let entries =
        [&keys.position_end_rad, &keys.velocity_end_rad_s, &keys.torque_end_nm, &keys.kp_end, &keys.kd_end];
    if ends(keys, model).is_some() && has_codes(keys) {
        return;
    }
    for entry in entries.into_iter().filter(|entry| entry.is_written) {
        findings.error(entry.at, Wrong::NoEnds { model: model.name });
    }
}

/// Reports a missing end of the torque codes, where no source has it for certain.
pub(super) fn require_torque_end(keys: &keys::Motor, profile: Option<&Profile>, findings: &mut Findings<'_>) {
    let is_needed = keys.protocol.value.is_some_and(|protocol| protocol.family().needs_torque_end);
    if let Some(profile) = profile.filter(|_| is_needed && !keys.torque_end_nm.is_written) {
        findings.error(keys.torque_end_nm.at, Wrong::NoTorqueEnd { motors: profile.motors });
    }
}

/// Returns whether the values of a motor are codes; also where its protocol is not known.
fn has_codes(keys: &keys::Motor) -> bool {
    keys.protocol.value.is_none_or(|protocol| protocol.family().has_codes)
}

/// Returns the ends of the codes: those of the protocol, or of the model. `None` where the torque code
/// is SteadyWin's current.
pub(super) fn ends(keys: &keys::Motor, model: &Model) -> Option<Ends> {
    keys.protocol.value.map_or(model.ends, |protocol| protocol.family().ends_of(model))
}

/// Returns the scales of the codes: as written, or of the model.
pub(super) fn scales(keys: &keys::Motor, model: &Model) -> Option<Scales> {
    let constant = keys.torque_constant_nm_per_a.value.unwrap_or(model.torque_constant.into());
    let ratio = keys.gear_ratio.value.unwrap_or(model.gear_ratio.into());
    let Some(ends) = ends(keys, model) else {
        // Both keys have ranges, so a float holds every product of the two.
        return Scales::by_current(constant, ratio).ok();
    };
    Some(Scales::of(&Ends {
        position: keys.position_end_rad.value.unwrap_or(ends.position),
        velocity: keys.velocity_end_rad_s.value.unwrap_or(ends.velocity),
        torque: keys.torque_end_nm.value.unwrap_or(ends.torque),
        kp: keys.kp_end.value.unwrap_or(ends.kp),
        kd: keys.kd_end.value.unwrap_or(ends.kd),
    }))
}

/// The keys that give the end of a torque code that is a current.
const BY_CURRENT: &str = "torque-constant-nm-per-a and gear-ratio";

/// Reports a peak torque and a velocity that the codes cannot hold: the motor is not the model that
/// is named.
pub(super) fn check_reach(
    keys: &keys::Motor,
    (model, scales): (Option<&Model>, Option<&Scales>),
    findings: &mut Findings<'_>,
) {
    let Some((model, scales)) = model.zip(scales) else { return };
    let by_current = ends(keys, model).is_none();
    let beyond =
        |value, end, unit_and_key| Wrong::BeyondCodes { value, end, model: model.name, unit_and_key };
    let (entry, end) = (&keys.peak_torque_nm, scales.torque.max());
    if let Some(value) = entry.value.filter(|value| *value > end) {
        let key = if by_current { &["N·m", BY_CURRENT] } else { &["N·m", "torque-end-nm"] };
        findings.error(entry.at, beyond(value, end, key));
    }
    // A motor in GIM mode takes velocities as floats. Its states have a torque code.
    let is_coded = has_codes(keys);
    let (entry, end) = (&keys.max_velocity_rad_s, scales.velocity.max());
    if let Some(value) = entry.value.filter(|value| is_coded && *value > end) {
        // The velocity codes of a SteadyWin motor end at the same value whatever its constants are.
        let wrong = match by_current {
            true => Wrong::BeyondScale { value, end, usable: end, degrees: String::new() },
            false => beyond(value, end, &["rad/s", "velocity-end-rad-s"]),
        };
        findings.error(entry.at, wrong);
    } else if let Some(value) = entry.value.filter(|value| *value > FASTER_MAX * known_velocity(model)) {
        let wrong = Wrong::FasterThanModel { value, model: model.name, known: known_velocity(model) };
        findings.warn(entry.at, wrong);
    }
}

/// Velocity without load that a motor may have at another supply voltage, by that of its model.
const FASTER_MAX: f64 = 1.5;

/// Velocity without load of a model, rad/s, as its data sheet has it.
fn known_velocity(model: &Model) -> f64 {
    (f64::from(model.max_velocity) * 1e3).round() / 1e3
}

/// Registers hold single precision, and ends are written with few digits, such as 12.566 for 12.57.
const REGISTER_TOLERANCE: f64 = 1e-3;

/// Returns the ends that the motor may report: those that are written; otherwise all within which
/// the limits are.
pub(super) fn registers(
    keys: &keys::Motor,
    capability: &Capability,
    limits: &LimitSettings,
) -> [RegisterRange; REGISTERS_MAX] {
    let at_motor = limits.position.map(|position| capability.to_motor(position.into()).abs());
    let position = match capability.beyond_range {
        BeyondRange::Stop => at_motor[0].max(at_motor[1]),
        BeyondRange::Wrap => 0.0,
    };
    let reaches = [position, limits.velocity.into(), limits.torque.into()];
    let written = [&keys.position_end_rad, &keys.velocity_end_rad_s, &keys.torque_end_nm];
    core::array::from_fn(|index| match written[index].value {
        Some(end) => RegisterRange {
            least: (end * (1.0 - REGISTER_TOLERANCE)) as f32,
            most: (end * (1.0 + REGISTER_TOLERANCE)) as f32,
            written: Some(end as f32),
        },
        None => RegisterRange::reaching(reaches[index], index),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hint_names_only_another_spelling_of_the_model() {
        for (written, same) in
            [("dm4310", "DM-J4310-2EC"), ("DMH3510", "DM-H3510"), ("RS-03", "RS03"), ("GIM3505", "GIM3505-8")]
        {
            assert_eq!(hint(written), format!("did you mean `{same}`?"));
        }
        for other in
            ["RS07", "DM-J4310X-2EC", "DM4310-48V", "GIM8115-8", "GIM8108", "GIM9999-8", "A4", "", "é4"]
        {
            assert!(hint(other).starts_with("known are GIM3505-8, "), "{other}: {}", hint(other));
        }
    }
}
