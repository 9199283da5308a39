//! `[[model]]`: the motors of a vendor.

use super::table::{Table, keep, plain, suggestion};
use crate::model::Model;
use crate::scale::{Ends, Scales};

/// Largest values that any motor has: ends of codes, ratios, torques, currents, velocities.
const MOST: f64 = 10_000.0;
/// Keys of the ends of the codes.
const END_KEYS: [&str; 5] = ["position-end-rad", "velocity-end-rad-s", "torque-end-nm", "kp-end", "kd-end"];
/// The other keys.
const KEYS: [&str; 11] = [
    "name",
    "gear-ratio",
    "torque-constant-nm-per-a",
    "rated-torque-nm",
    "peak-torque-nm",
    "rated-current-a",
    "peak-current-a",
    "max-velocity-rad-s",
    "phase-resistance-ohm",
    "pole-pairs",
    "rated-voltage-v",
];
const INERTIA: &str = "rotor-inertia-kg-m2";
/// Pairs of poles, and voltage, where they are not published.
const POLE_PAIRS: i64 = 14;
const VOLTAGE: f32 = 24.0;

/// Reads every `[[model]]`.
pub(super) fn read(root: &Table<'_>) -> Vec<Model> {
    let by_current = by_current(root);
    let items = root.list("model");
    if items.is_empty() && !root.has("model") {
        root.problem("model", "is missing; write a table [[model]] for each motor");
    }
    let mut models: Vec<Model> = Vec::new();
    for item in &items {
        let Some(model) = model(item, by_current) else { continue };
        if models.iter().any(|other| other.name.eq_ignore_ascii_case(model.name)) {
            item.problem("name", format!("`{}` is the name of an earlier model; give another", model.name));
        }
        models.push(model);
    }
    models
}

/// Returns whether the torque code is a current.
fn by_current(root: &Table<'_>) -> bool {
    match root.text("torque-code") {
        None | Some("torque") => false,
        Some("current") => true,
        Some(other) => {
            let hint = suggestion(other, ["torque", "current"].into_iter());
            root.problem("torque-code", format!("unknown value `{}`; {hint}", plain(other)));
            false
        }
    }
}

fn model(table: &Table<'_>, by_current: bool) -> Option<Model> {
    let known: Vec<_> = KEYS.into_iter().chain(END_KEYS).chain([INERTIA]).collect();
    table.refuse_unknown(&known);
    let name = table.require("name", table.text("name"), "give the vendor's name of the motor");
    let name = name.filter(|name| is_name(table, name));
    let number = |key: &str| table.require(key, table.single(key, MOST), "give the value of the data sheet");
    let [ratio, constant] = [number("gear-ratio"), number("torque-constant-nm-per-a")];
    let [rated, peak, velocity] = ["rated-torque-nm", "peak-torque-nm", "max-velocity-rad-s"].map(number);
    let optional = |key: &str| table.single(key, MOST);
    let ends = if by_current { no_ends(table) } else { ends(table).map(Some) };
    let model = Model {
        name: keep(name?),
        gear_ratio: ratio?,
        torque_constant: constant?,
        rated_torque: rated?,
        peak_torque: peak?,
        rated_current: optional("rated-current-a").unwrap_or(0.0),
        peak_current: optional("peak-current-a").unwrap_or(0.0),
        max_velocity: velocity?,
        phase_resistance: optional("phase-resistance-ohm").unwrap_or(0.0),
        pole_pairs: table.integer("pole-pairs", 1, 0xFF).unwrap_or(POLE_PAIRS) as u8,
        rated_voltage: optional("rated-voltage-v").unwrap_or(VOLTAGE),
        ends: ends?,
        rotor_inertia: optional(INERTIA),
    };
    check(table, &model);
    Some(model)
}

/// Reports a name of a model that is none.
fn is_name(table: &Table<'_>, name: &str) -> bool {
    let is_letter = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    let is_name = (1..=32).contains(&name.len()) && name.chars().all(is_letter);
    if !is_name {
        table.problem(
            "name",
            format!("\"{}\" is no name; use 1 to 32 letters, digits, `-`, `_` and `.`", plain(name)),
        );
    }
    is_name
}

fn ends(table: &Table<'_>) -> Option<Ends> {
    let hint = "give the value of the largest code";
    let end = |key| table.require(key, table.number(key, MOST), hint);
    let [position, velocity, torque] = [END_KEYS[0], END_KEYS[1], END_KEYS[2]].map(end);
    let ends = Ends::new(position?, velocity?, torque?);
    let gain = |key, default| if table.has(key) { table.number(key, MOST) } else { Some(default) };
    Some(ends.with_gains(gain(END_KEYS[3], ends.kp)?, gain(END_KEYS[4], ends.kd)?))
}

/// Reports ends of codes that the torque constant decides.
fn no_ends(table: &Table<'_>) -> Option<Option<Ends>> {
    for key in END_KEYS.into_iter().filter(|key| table.has(key)) {
        table.problem(key, "has no effect where torque-code = \"current\"; remove it");
    }
    Some(None)
}

/// Reports mechanical data that contradict each other, or that the codes cannot hold.
fn check(table: &Table<'_>, model: &Model) {
    let Model { rated_torque, peak_torque, max_velocity, .. } = *model;
    if rated_torque > peak_torque {
        table.problem("rated-torque-nm", format!("{rated_torque} N·m is above the peak torque, {peak_torque} N·m; exchange them, or correct one"));
    }
    let Ok(Ends { velocity, torque, .. }) = model.scales().as_ref().map(Scales::ends) else {
        table.problem(
            "torque-constant-nm-per-a",
            "gives torque codes without an end; correct it, or gear-ratio",
        );
        return;
    };
    if f64::from(peak_torque) > torque {
        table.problem("peak-torque-nm", format!("{peak_torque} N·m is beyond the largest torque code, {torque} N·m; cut it at that, or correct the end"));
    }
    if f64::from(max_velocity) > velocity {
        table.problem("max-velocity-rad-s", format!("{max_velocity} rad/s is beyond the largest velocity code, {velocity} rad/s; cut it at that, or correct the end"));
    }
}
