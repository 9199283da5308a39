//! The output of `motorctl hold`: lines while it holds, and a table at the end.

use motord_terminal::{Cell, Palette, Table, json};
use serde::Serialize;
use std::io::{self, Write};

/// A held joint at one time.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct HeldJoint {
    /// The joint.
    pub(crate) name: String,
    /// The position that the setpoint asks for, rad.
    pub(crate) goal_rad: f32,
    /// Position, rad. null before the motor has reported it.
    pub(crate) position_rad: Option<f32>,
    /// Velocity, rad/s. null before the motor has reported it.
    pub(crate) velocity_rad_s: Option<f32>,
    /// Torque, N·m. null before the motor has reported it.
    pub(crate) torque_nm: Option<f32>,
}

impl HeldJoint {
    /// Distance from the goal, rad.
    fn distance(&self) -> f32 {
        self.position_rad.map_or(0.0, |position| (position - self.goal_rad).abs())
    }
}

/// The held joints at one time: a line of `--json`.
#[derive(Debug, Serialize)]
pub(crate) struct Line {
    /// Time since the motors follow setpoints, s.
    pub(crate) time_s: f64,
    /// The claimed group.
    pub(crate) group: String,
    /// The held joints. The others of the group are only damped.
    pub(crate) joints: Vec<HeldJoint>,
}

/// The range of a joint from the first line to the last.
#[derive(Debug, Clone)]
struct Summary {
    name: String,
    first: f32,
    last: f32,
    lowest: f32,
    highest: f32,
    torque: f32,
}

/// The output, as text or as JSON.
#[derive(Debug)]
pub(crate) struct Report {
    as_json: bool,
    joints: Vec<Summary>,
}

impl Report {
    /// Creates an output without lines.
    pub(crate) fn new(as_json: bool) -> Self {
        Self { as_json, joints: Vec::new() }
    }

    /// Counts the joints at one time. Called in each cycle.
    pub(crate) fn count(&mut self, joints: &[HeldJoint]) {
        if self.joints.is_empty() {
            self.joints = joints.iter().filter_map(Summary::new).collect();
        }
        for joint in joints {
            let summary = self.joints.iter_mut().find(|summary| summary.name == joint.name);
            if let Some((summary, position)) = summary.zip(joint.position_rad) {
                summary.count(position, joint.torque_nm.unwrap_or_default());
            }
        }
    }

    /// Prints a sentence for people.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn print_text(&self, out: &mut dyn Write, sentence: &str) -> io::Result<()> {
        if self.as_json { Ok(()) } else { writeln!(out, "{}", motord_terminal::printable(sentence)) }
    }

    /// Prints the joints at one time; as text only the one that is farthest from its goal.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn line(&self, out: &mut dyn Write, line: &Line) -> io::Result<()> {
        if self.as_json {
            json::write_line(out, line)?;
            return out.flush();
        }
        let farthest = line.joints.iter().max_by(|a, b| a.distance().total_cmp(&b.distance()));
        let Some(joint) = farthest else { return Ok(()) };
        let HeldJoint { name, goal_rad, position_rad, torque_nm, .. } = joint;
        let number = |value: Option<f32>, digits| motord_terminal::number(value.map(f64::from), digits);
        let (position, torque) = (number(*position_rad, 3), number(*torque_nm, 2));
        let which = if line.joints.len() > 1 { "farthest from its goal: " } else { "" };
        let text = format!(
            "{:5.1} s  {which}{name} at {position} rad, goal {goal_rad:.3} rad, {torque} N·m",
            line.time_s
        );
        self.print_text(out, &text)?;
        out.flush()
    }

    /// Prints where each joint was.
    ///
    /// # Errors
    ///
    /// When `out` cannot be written.
    pub(crate) fn summary(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        if self.as_json {
            return Ok(());
        }
        let mut table =
            Table::new(&["joint", "first rad", "last rad", "lowest rad", "highest rad", "max N·m"]);
        for Summary { name, first, last, lowest, highest, torque } in &self.joints {
            let number = |value: &f32, digits| Cell::number(Some(f64::from(*value)), digits);
            let positions = [first, last, lowest, highest].map(|value| number(value, 3));
            table.row([Cell::plain(name)].into_iter().chain(positions).chain([number(torque, 2)]).collect());
        }
        table.write(out, palette)
    }
}

impl Summary {
    fn new(joint: &HeldJoint) -> Option<Self> {
        let at = joint.position_rad?;
        Some(Self { name: joint.name.clone(), first: at, last: at, lowest: at, highest: at, torque: 0.0 })
    }

    fn count(&mut self, position: f32, torque: f32) {
        self.last = position;
        self.lowest = self.lowest.min(position);
        self.highest = self.highest.max(position);
        self.torque = self.torque.max(torque.abs());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(name: &str, goal_rad: f32, position: f32) -> HeldJoint {
        let (velocity_rad_s, torque_nm) = (Some(0.0), Some(-0.25));
        HeldJoint { name: name.into(), goal_rad, position_rad: Some(position), velocity_rad_s, torque_nm }
    }

    #[test]
    fn text_names_the_farthest_joint_and_range() {
        let mut report = Report::new(false);
        for position in [0.1, 0.4, -0.2] {
            report.count(&[joint("hip", 0.0, position), joint("knee", 0.0, 0.0)]);
        }
        let mut out = Vec::new();
        let joints = vec![joint("hip", 0.0, -0.2), joint("knee", 0.0, 0.0)];
        report.line(&mut out, &Line { time_s: 2.0, group: "leg".into(), joints }).unwrap();
        report.summary(&mut out, Palette::of_stdout()).unwrap();
        let text = String::from_utf8(out).unwrap();
        assert!(
            text.starts_with(
                "  2.0 s  farthest from its goal: hip at -0.200 rad, goal 0.000 rad, -0.25 N·m\n"
            ),
            "{text}"
        );
        let hip = text.lines().find(|line| line.starts_with("hip")).unwrap();
        let cells: Vec<&str> = hip.split_whitespace().collect();
        assert_eq!(cells, ["hip", "0.100", "-0.200", "-0.200", "0.400", "0.25"]);
    }
}
