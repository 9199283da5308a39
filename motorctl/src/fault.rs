//! `motorctl fault`: the faults that motors have reported to the daemon, and `motorctl indicator
//! JOINT`: the indicators that it knows.

use crate::failure::Failure;
use crate::status;
use motord_client::{Client, Fault, Faults, Indicator, State};
use motord_direct::{DirectFailure, Indicators, NamedFault, print_faults};
use motord_terminal::{Cell, Palette, Table, json, printable};
use serde::Serialize;
use std::io::{self, Write};

/// The object that `--json` prints.
#[derive(Serialize)]
struct FaultReport {
    /// The instance.
    instance: String,
    /// The joints whose motors report a fault; others are left out.
    joints: Vec<JointFaults>,
}

#[derive(Serialize)]
struct JointFaults {
    /// The joint.
    name: String,
    /// The faults, a bit each.
    bits: u32,
    /// The faults that have a name.
    faults: Vec<NamedFault>,
    /// The bits that no name stands for.
    unknown_bits: u32,
}

/// Lists the faults of all joints.
///
/// # Errors
///
/// No daemon answers, or the output cannot be written.
pub(crate) fn list(instance: &str, as_json: bool) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let report = FaultReport::new(&client, &client.wait(status::TIMEOUT)?);
    let out = &mut io::stdout().lock();
    if as_json {
        json::write_line(out, &report)?;
    } else {
        report.write(out)?;
    }
    Ok(())
}

/// Shows the faults of one joint.
///
/// # Errors
///
/// No daemon answers, it has no such joint, or the output cannot be written.
pub(crate) fn get(instance: &str, joint: &str, as_json: bool) -> Result<(), Failure> {
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    let faults = client.wait(status::TIMEOUT)?.joint(index).map(|joint| joint.faults).unwrap_or_default();
    let faults = JointFaults::new(joint, faults);
    if as_json {
        return Ok(json::write_line(&mut io::stdout().lock(), &faults)?);
    }
    Ok(print_faults(joint, &faults.faults, faults.unknown_bits)?)
}

impl FaultReport {
    fn new(client: &Client, state: &State) -> Self {
        let robot = client.description();
        let joints = robot.joints.iter().zip(state.joints());
        let faulty = joints.filter(|(_, joint)| !joint.faults.is_empty());
        let joints =
            faulty.map(|(description, joint)| JointFaults::new(&description.name, joint.faults)).collect();
        Self { instance: robot.instance.clone(), joints }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        if self.joints.is_empty() {
            return writeln!(out, "{}: no motor reports a fault", printable(&self.instance));
        }
        let mut table = Table::new(&["joint", "fault", "meaning"]);
        for joint in &self.joints {
            for NamedFault { name, meaning } in &joint.faults {
                table.row([joint.name.as_str(), name, meaning].map(Cell::plain).into());
            }
            if joint.unknown_bits != 0 {
                let bits = format!("{:#x}", joint.unknown_bits);
                table.row([joint.name.as_str(), &bits, "In no document."].map(Cell::plain).into());
            }
        }
        table.write(out, Palette::of_stdout())
    }
}

impl JointFaults {
    fn new(name: &str, faults: Faults) -> Self {
        let named = |fault: Fault| NamedFault { name: fault.name(), meaning: fault.sentence() };
        Self {
            name: name.to_owned(),
            bits: faults.bits(),
            faults: faults.iter().map(named).collect(),
            unknown_bits: faults.unknown(),
        }
    }
}

/// Prints the known indicators of a joint.
///
/// # Errors
///
/// No daemon answers, it has no such joint or no indicators of it, or the output cannot be written.
pub(crate) fn print_indicators(instance: &str, asked: &Indicators) -> Result<(), Failure> {
    let joint = asked.joint().unwrap_or_default();
    let client = status::connect(instance)?;
    let index = client.joint_named(joint)?;
    asked.print(|number| {
        let state = client.wait(status::TIMEOUT)?;
        let known = state.indicators(index).ok_or_else(|| none_of(joint))?;
        Ok(Indicator::try_from(u32::from(number)).ok().and_then(|indicator| known.get(indicator)))
    })
}

fn none_of(joint: &str) -> DirectFailure {
    DirectFailure::Usage(format!(
        "the daemon knows no indicators of {joint}: it reads those of the first 16 GIM motors, unless `indicator-hz` is 0"
    ))
}
