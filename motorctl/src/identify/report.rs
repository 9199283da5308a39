//! The output of `motorctl identify`: a table, a JSON object, and lines for the configuration.

use crate::identify::failure::IdentifyFailure;
use crate::identify::known::Known;
use crate::identify::losses::Losses;
use motord_client::JointDescription;
use motord_identify::{Delay, Identified, Value, Why};
use motord_terminal::{Cell, Palette, Table, json, printable};
use serde::Serialize;
use std::fs::OpenOptions;
use std::io::{self, Write};
use std::path::Path;

/// A value, its interval, and the reason if it is not identifiable.
#[derive(Debug, Serialize)]
struct Entry {
    value: Option<f64>,
    lower: Option<f64>,
    upper: Option<f64>,
    is_identified: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<String>,
}

impl Entry {
    fn new(value: &Value, scale: f64) -> Self {
        let finite = |number: f64| Some(number * scale).filter(|number| number.is_finite());
        Self {
            value: finite(value.value),
            lower: finite(value.lower),
            upper: finite(value.upper),
            is_identified: value.why.is_none(),
            why: value.why.map(|why| why.to_string()),
        }
    }
}

/// Everything, as `--json` prints it.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    joint: String,
    model: String,
    inertia_kg_m2: Entry,
    viscous_friction_nm_s_per_rad: Entry,
    coulomb_friction_nm: Entry,
    stiction_nm: Entry,
    gravity_sine_nm: Entry,
    gravity_cosine_nm: Entry,
    offset_nm: Entry,
    #[serde(skip_serializing_if = "Option::is_none")]
    stribeck_nm: Option<Entry>,
    #[serde(skip_serializing_if = "Option::is_none")]
    spring_nm_per_rad: Option<Entry>,
    #[serde(skip_serializing_if = "Option::is_none")]
    torque_scale: Option<Entry>,
    reply_latency_us: Option<Entry>,
    /// Time by which the torque acts later than the stamps explain.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag_us: Option<f64>,
    /// Bounds of the time from a command to its torque.
    action_us: Option<[f64; 2]>,
    /// Shortest, median and longest time from a command to its answer.
    answer_us: Option<[f64; 3]>,
    range_rad: f64,
    fastest_rad_s: f64,
    windows: usize,
    losses: Losses,
    notes: Vec<String>,
    /// Lines of the configuration.
    lines: Vec<String>,
}

/// Heading, unit, digits, and the entry of a row.
type Row<'a> = (&'static str, &'static str, usize, &'a Entry);

impl Report {
    /// Describes what was identified of a joint.
    pub(crate) fn new(
        joint: &JointDescription,
        found: &Identified,
        known: Option<&Known>,
        losses: Losses,
    ) -> Self {
        let micros = |seconds: f64| (seconds * 1e7).round() / 10.0;
        let delay: Option<Delay> = found.delay;
        let entry = |value: &Value| Entry::new(value, 1.0);
        let (lines, lighter) = lines(joint, found);
        let notes = found.notes.iter().map(ToString::to_string).chain(lighter).collect();
        Self {
            joint: joint.name.clone(),
            model: joint.model.clone(),
            inertia_kg_m2: entry(&found.inertia),
            viscous_friction_nm_s_per_rad: entry(&found.viscous),
            coulomb_friction_nm: entry(&found.coulomb),
            stiction_nm: entry(&found.stiction),
            gravity_sine_nm: entry(&found.gravity_sine),
            gravity_cosine_nm: entry(&found.gravity_cosine),
            offset_nm: entry(&found.offset),
            stribeck_nm: found.stribeck.as_ref().map(entry),
            spring_nm_per_rad: found.spring.as_ref().map(entry),
            torque_scale: known.map(|known| entry(&known.scale(&found.inertia))),
            reply_latency_us: delay.map(|delay| Entry::new(&delay.motor, 1e6)),
            lag_us: found.lag().map(micros),
            action_us: delay.map(|delay| delay.action.map(micros)),
            answer_us: delay.map(|delay| delay.answers.map(micros)),
            range_rad: found.range,
            fastest_rad_s: found.fastest,
            windows: found.windows,
            losses,
            notes,
            lines,
        }
    }

    fn rows(&self) -> Vec<Row<'_>> {
        let mut rows: Vec<Row<'_>> = vec![
            ("inertia", "kg·m²", 5, &self.inertia_kg_m2),
            ("viscous friction", "N·m·s/rad", 4, &self.viscous_friction_nm_s_per_rad),
            ("Coulomb friction", "N·m", 4, &self.coulomb_friction_nm),
            ("stiction", "N·m", 3, &self.stiction_nm),
            ("gravity · sin q", "N·m", 3, &self.gravity_sine_nm),
            ("gravity · cos q", "N·m", 3, &self.gravity_cosine_nm),
            ("constant torque", "N·m", 3, &self.offset_nm),
        ];
        rows.extend(self.stribeck_nm.iter().map(|more| ("more at low speed", "N·m", 3, more)));
        rows.extend(self.spring_nm_per_rad.iter().map(|spring| ("spring", "N·m/rad", 2, spring)));
        rows.extend(self.torque_scale.iter().map(|scale| ("true by reported torque", "", 3, scale)));
        rows.extend(self.reply_latency_us.iter().map(|latency| ("reply latency", "µs", 0, latency)));
        rows
    }

    /// Prints the table and the lines, or one JSON object.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn print(&self, out: &mut dyn Write, as_json: bool) -> io::Result<()> {
        if as_json {
            return json::write_line(out, self);
        }
        let mut table = Table::new(&["", "value", "from", "to", "unit", "(95 % interval)"]);
        for (heading, unit, digits, entry) in self.rows() {
            let number = |value| Cell::number(value, digits);
            let why = entry.why.as_ref().map_or_else(String::new, |why| format!("not identifiable: {why}"));
            let value = if entry.is_identified { entry.value } else { None };
            let [value, lower, upper] = [value, entry.lower, entry.upper].map(number);
            table.row(vec![Cell::plain(heading), value, lower, upper, Cell::plain(unit), Cell::plain(why)]);
        }
        table.write(out, Palette::of_stdout())?;
        let Self { range_rad, fastest_rad_s, windows, .. } = self;
        writeln!(
            out,
            "{windows} windows of motion, over {range_rad:.2} rad, up to {fastest_rad_s:.1} rad/s"
        )?;
        self.print_losses(out)?;
        if let (Some([from, to]), Some([least, median, most])) = (self.action_us, self.answer_us) {
            writeln!(
                out,
                "A command acts {from:.0} to {to:.0} µs after it was sent; its answer arrived after {least:.0} to {most:.0} µs, \
                 in the median {median:.0}."
            )?;
        }
        self.notes.iter().try_for_each(|note| writeln!(out, "{}: {note}", printable(&self.joint)))?;
        if self.lines.len() > 1 {
            writeln!(out, "\nBelow the [[motor]] {} of the configuration:\n", printable(&self.joint))?;
            self.lines.iter().try_for_each(|line| writeln!(out, "{line}"))?;
        }
        out.flush()
    }

    fn print_losses(&self, out: &mut dyn Write) -> io::Result<()> {
        let Losses { ticks, missed_ticks, missed_replies, late_replies, plant_lost_s, .. } = self.losses;
        write!(
            out,
            "{missed_ticks} of {ticks} ticks missed, {missed_replies} turns without a reply, {late_replies} late replies"
        )?;
        if plant_lost_s > 0.0 {
            write!(out, "; the plant lost {plant_lost_s:.2} s")?;
        }
        writeln!(out)
    }

    /// Writes the lines into a new file.
    ///
    /// # Errors
    ///
    /// The file exists or cannot be written.
    pub(crate) fn write_lines(&self, path: &Path) -> io::Result<()> {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        self.lines.iter().try_for_each(|line| writeln!(file, "{line}"))
    }
}

/// Least value of `armature-kg-m2`, kg·m².
const ARMATURE_MIN: f64 = 1e-6;

/// Lines for the configuration with what was identified, and a note about a rotor that is estimated
/// too heavy.
fn lines(joint: &JointDescription, found: &Identified) -> (Vec<String>, Option<String>) {
    let mut lines = vec!["[motor.simulation]".to_owned()];
    let mut lighter = None;
    if let Some((total, rotor)) = found.inertia.identified().zip(motord_twin::armature(&joint.model)) {
        // Both, whatever the configuration has: their sum was measured.
        lines.push(format!("armature-kg-m2 = {:.6}", rotor.min(total).max(ARMATURE_MIN)));
        lines.push(format!("load-inertia-kg-m2 = {:.6}", (total - rotor).max(0.0)));
        lighter = (total < rotor).then(|| {
            format!(
                "the rotor of {} is taken for {rotor:.5} kg·m² behind its gear, more than the whole joint has: \
                 the lines give the whole inertia to the rotor",
                joint.model
            )
        });
    }
    let values = [
        ("viscous-friction-nm-s-per-rad", found.viscous.identified()),
        ("coulomb-friction-nm", found.coulomb.identified()),
    ];
    lines.extend(values.iter().filter_map(|(key, value)| value.map(|value| format!("{key} = {value:.6}"))));
    let latency = found.delay.and_then(|delay| delay.motor.identified());
    lines.extend(latency.map(|latency| format!("reply-latency-us = {:.1}", latency * 1e6)));
    (lines, lighter)
}

/// Checks whether anything was identified.
///
/// # Errors
///
/// [`IdentifyFailure::Nothing`] or [`IdentifyFailure::Misfit`] without an inertia: the table was
/// printed.
pub(crate) fn outcome(joint: &str, found: &Identified) -> Result<(), IdentifyFailure> {
    match found.inertia.why {
        None => Ok(()),
        Some(Why::Misfit) => Err(IdentifyFailure::Misfit(joint.to_owned())),
        Some(_) => Err(IdentifyFailure::Nothing(joint.to_owned())),
    }
}
