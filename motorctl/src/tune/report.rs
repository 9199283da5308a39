//! The output of `motorctl tune`: a table, sentences and two lines, or a JSON object.

use crate::failure::CommandFailure;
use crate::tune::known::Known;
use crate::tune::timing::Site;
use motord_client::{JointDescription, Limit};
use motord_identify::{
    Bound, Bounds, Gains, Margins, PHASE_MARGIN_MIN, Plant, Point, Proposal, Response, Wanted,
};
use motord_terminal::{Cell, Palette, Table, json, printable};
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::{self, Write};

/// Share of the rise within which the setpoint arrives without effect.
const SLEW_SHARE: f64 = 0.2;

/// The loop of stiffness and damping.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Loop {
    pub(crate) site: Site,
    pub(crate) known: Known,
    pub(crate) plant: Plant,
    pub(crate) bounds: Bounds,
}

/// The response to steps with some gains.
#[derive(Debug, Serialize)]
pub(crate) struct Measured {
    pub(crate) kp: f64,
    pub(crate) kd: f64,
    steps: usize,
    pub(crate) rise_ms: Option<f64>,
    pub(crate) overshoot_percent: f64,
    settling_ms: Option<f64>,
    pub(crate) ring_hz: Option<f64>,
    pub(crate) damping_ratio: Option<f64>,
    error_rad: f64,
    peak_torque_nm: f64,
    limits: BTreeSet<&'static str>,
    #[serde(skip)]
    pub(crate) curve: Vec<Point>,
}

impl Measured {
    /// Describes the response with `gains`, during which these limits acted.
    pub(crate) fn new(gains: Gains, response: Response, limits: &BTreeSet<&'static str>) -> Self {
        let millis = |seconds: f64| 1e3 * seconds;
        // Each step is slewed; a short slew changes nothing.
        let is_slewed = response.reference > SLEW_SHARE * response.rise.unwrap_or(0.0);
        let shapes = |limit: &&str| is_slewed || *limit != Limit::PositionSlew.name();
        Self {
            kp: gains.kp,
            kd: gains.kd,
            steps: response.steps,
            rise_ms: response.rise.map(millis),
            overshoot_percent: 100.0 * response.overshoot,
            settling_ms: response.settling.map(millis),
            ring_hz: response.ring.map(|ring| ring.frequency),
            damping_ratio: response.ring.map(|ring| ring.damping_ratio),
            error_rad: response.error,
            peak_torque_nm: response.torque_peak,
            limits: limits.iter().copied().filter(shapes).collect(),
            curve: response.curve,
        }
    }
}

/// The proposed gains.
#[derive(Debug, Serialize)]
struct Proposed {
    kp: f64,
    kd: f64,
    bandwidth_hz: f64,
    phase_margin_deg: f64,
    delay_margin_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    bound: Option<&'static str>,
}

/// The report, as `--json` prints it.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) joint: String,
    model: String,
    #[serde(rename = "loop")]
    site: Site,
    inertia_kg_m2: f64,
    viscous_friction_nm_s_per_rad: f64,
    delay_ms: f64,
    bandwidth_hz: f64,
    damping_ratio: f64,
    proposed: Proposed,
    pub(crate) before: Measured,
    pub(crate) after: Option<Measured>,
    notes: Vec<String>,
    lines: [String; 2],
    #[serde(skip)]
    margins: [Margins; 2],
    /// Why the proposed gains were not tried to the end.
    #[serde(skip)]
    pub(crate) untried: Option<Box<dyn CommandFailure>>,
}

impl Report {
    /// Describes the responses before and with the proposal.
    pub(crate) fn new(
        joint: &JointDescription,
        wanted: Wanted,
        found: Loop,
        proposal: Proposal,
        before: Measured,
        after: Option<Measured>,
    ) -> Self {
        let Loop { site, known, plant, .. } = found;
        let Proposal { gains: Gains { kp, kd }, bandwidth, margins, bound } = proposal;
        let proposed = Proposed {
            kp,
            kd,
            bandwidth_hz: bandwidth,
            phase_margin_deg: margins.phase.to_degrees(),
            delay_margin_ms: 1e3 * margins.delay,
            bound: bound.map(name),
        };
        let notes = notes(&found, wanted, &proposal, &before, after.as_ref());
        Self {
            joint: joint.name.clone(),
            model: joint.model.clone(),
            site,
            inertia_kg_m2: known.inertia,
            viscous_friction_nm_s_per_rad: known.viscous,
            delay_ms: 1e3 * plant.delay,
            bandwidth_hz: wanted.bandwidth,
            damping_ratio: wanted.damping_ratio,
            proposed,
            margins: [plant.margins(Gains { kp: before.kp, kd: before.kd }), margins],
            before,
            after,
            notes,
            lines: [format!("kp = {kp}"), format!("kd = {kd}")],
            untried: None,
        }
    }

    /// The same report, of gains whose trial ended.
    pub(crate) fn untried(mut self, failure: Box<dyn CommandFailure>) -> Self {
        self.notes.push("the proposed gains were not tried to the end".to_owned());
        self.untried = Some(failure);
        self
    }

    /// Prints the table, the sentences and the lines, or one JSON object.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn print(&self, out: &mut dyn Write, as_json: bool) -> io::Result<()> {
        if as_json {
            return json::write_line(out, self);
        }
        self.table().write(out, Palette::of_stdout())?;
        let joint = printable(&self.joint);
        self.notes.iter().try_for_each(|note| writeln!(out, "{joint}: {note}"))?;
        writeln!(out, "\nIn the controller of {joint}:\n")?;
        self.lines.iter().try_for_each(|line| writeln!(out, "{line}"))?;
        out.flush()
    }

    fn table(&self) -> Table {
        let mut table = Table::new(&["", "before", "proposed", "unit"]);
        let mut row = |heading: &str, digits, [before, proposed]: [Option<f64>; 2], unit: &str| {
            let [before, proposed] = [before, proposed].map(|value| Cell::number(value, digits));
            table.row(vec![Cell::plain(heading), before, proposed, Cell::plain(unit)]);
        };
        let degrees = self.margins.map(|margins| Some(margins.phase.to_degrees()));
        let delays = self.margins.map(|margins| Some(1e3 * margins.delay));
        row("kp", 2, [Some(self.before.kp), Some(self.proposed.kp)], "N·m/rad");
        row("kd", 3, [Some(self.before.kd), Some(self.proposed.kd)], "N·m·s/rad");
        row("phase margin", 0, degrees, "°");
        row("delay margin", 2, delays, "ms");
        let measured =
            |of: fn(&Measured) -> Option<f64>| [of(&self.before), self.after.as_ref().and_then(of)];
        row("rise, 10 to 90 %", 1, measured(|of| of.rise_ms), "ms");
        row("overshoot", 1, measured(|of| Some(of.overshoot_percent)), "%");
        row("settled within 5 %", 0, measured(|of| of.settling_ms), "ms");
        row("ring", 1, measured(|of| of.ring_hz), "Hz");
        row("damping ratio", 2, measured(|of| of.damping_ratio), "");
        row("error at the end", 1, measured(|of| Some(1e3 * of.error_rad)), "mrad");
        row("largest torque", 2, measured(|of| Some(of.peak_torque_nm)), "N·m");
        table
    }
}

/// The name of a bound in JSON.
fn name(bound: Bound) -> &'static str {
    match bound {
        Bound::Kp => "kp",
        Bound::Kd => "kd",
        Bound::Delay => "delay",
        Bound::Noise => "noise",
    }
}

/// Sentences about the loop, the proposal, and what limits the measurement.
fn notes(
    found: &Loop,
    wanted: Wanted,
    proposal: &Proposal,
    before: &Measured,
    after: Option<&Measured>,
) -> Vec<String> {
    let Loop { site, known, plant, .. } = *found;
    let source = if known.is_read { "of the file" } else { "identified in this run" };
    let mut notes = vec![
        format!(
            "inertia {:.5} kg·m², viscous friction {:.4} N·m·s/rad, {source}",
            known.inertia, known.viscous
        ),
        match site {
            Site::Drive => format!(
                "stiffness and damping act in the drive (MIT), {:.2} ms late: assumed for its loop, and the lag that the identification shows",
                1e3 * plant.delay
            ),
            Site::Cycle => format!(
                "stiffness and damping act in the cycle of the daemon (native protocol), {:.2} ms late: measured, from a state until the middle of the turn that uses it",
                1e3 * plant.delay
            ),
        },
    ];
    notes.extend(proposal.bound.map(|bound| lowered(bound, found, wanted, proposal)));
    let responses = [("before", Some(before)), ("proposed", after)];
    for (which, response) in responses.into_iter().filter_map(|(which, of)| of.map(|of| (which, of))) {
        if !response.limits.is_empty() {
            let limits: Vec<&str> = response.limits.iter().copied().collect();
            notes.push(format!(
                "{which}: the response is not that of the gains, because limits acted ({}): choose a smaller --step-rad",
                limits.join(", ")
            ));
        }
        if response.settling_ms.is_none() {
            notes.push(format!(
                "{which}: the joint did not settle: choose a larger --seconds, or a larger --step-rad against dry friction"
            ));
        }
    }
    notes
}

/// The sentence about a bandwidth that is lower than wanted.
fn lowered(bound: Bound, found: &Loop, wanted: Wanted, proposal: &Proposal) -> String {
    let Bounds { gains: Gains { kp, kd }, velocity_code, .. } = found.bounds;
    let reason = match bound {
        Bound::Delay => format!(
            "with a delay of {:.2} ms more would leave a phase margin below {:.0}°",
            1e3 * found.plant.delay,
            PHASE_MARGIN_MIN.to_degrees()
        ),
        Bound::Kp => format!("the limits permit kp {kp}"),
        Bound::Kd => format!("the limits permit kd {kd}"),
        Bound::Noise => format!("a code of the velocity, {velocity_code:.3} rad/s, is noise of the torque"),
    };
    format!("the proposal has {:.1} Hz instead of {:.1} Hz: {reason}", proposal.bandwidth, wanted.bandwidth)
}
