//! Checks before the first cycle that the motors are the configured ones: by the lock file, and by
//! their reports.
//!
//! A motor with another torque constant or gear ratio gives another torque than it is sent, and
//! nothing on the wire shows that. A motor that differs is never enabled
//! ([`Cycle::mark_mismatch`](motord_core::cycle::Cycle::mark_mismatch)). A motor that does not
//! answer yet is offline, and is checked by the lock file only. The cycle reads registers itself,
//! at a motor's first answer and after each silence (`core/src/control/motor/registers.rs`).

use motord_bus::{Bus, Duration, Monotonic};
use motord_configuration::lock::{Finding, Lock, LockError, Verdict, findings, mismatches};
use motord_protocol::commissioning::{Error, Link, Question, Survey, Wire, constants, survey};
use motord_settings::settings::{MotorSettings, Settings};
use std::path::Path;

/// A motor on a wire answers within a millisecond or so. One that is late is asked by
/// `motorctl setup`, which waits longer.
const TIMEOUT: Duration = Duration::from_millis(10);

/// The buses, and the joints whose motors differ from their configuration.
pub type Checked = (Vec<Box<dyn Bus>>, Vec<usize>);

/// Marks the motors that differ from the configuration, by the lock beside its `file` or by what
/// they report. Logs each difference with its cure. Returns the buses, and the indices of these
/// motors. Blocks for some milliseconds per motor. Sends stop frames to the motors, and read
/// requests to native ones.
///
/// # Errors
///
/// When there is a lock file that cannot be read.
pub fn check(settings: &Settings, file: &Path, buses: Vec<Box<dyn Bus>>) -> Result<Checked, LockError> {
    let mut found = Lock::load(file)?.map_or_else(Vec::new, |lock| mismatches(settings, &lock));
    let (buses, reported): (Vec<_>, Vec<_>) =
        buses.into_iter().enumerate().map(|(index, bus)| ask_bus(settings, index, bus)).unzip();
    found.extend(reported.into_iter().flatten());
    let mut mismatched = Vec::new();
    for finding in found {
        tracing::error!(see = "mismatch", "{finding}. It will not be enabled.");
        mismatched.extend(settings.motors.iter().position(|motor| motor.name == finding.motor));
    }
    mismatched.sort_unstable();
    mismatched.dedup();
    Ok((buses, mismatched))
}

/// The bus, and the differences that its motors tell. A simulated motor is made of the
/// configuration, and not asked.
fn ask_bus(settings: &Settings, index: usize, bus: Box<dyn Bus>) -> (Box<dyn Bus>, Vec<Finding>) {
    let kind = &settings.buses[index].kind;
    if kind.is_simulated() {
        return (bus, Vec::new());
    }
    let mut link = match kind.is_line() {
        true => Link::over(bus, Monotonic, Wire::Serial),
        false => Link::over(bus, Monotonic, Wire::Can).with_timeout(TIMEOUT),
    };
    let mut found = Vec::new();
    for motor in settings.motors.iter().filter(|motor| motor.bus == index) {
        match ask(motor, &mut link) {
            Ok(Some(survey)) => {
                let reported = survey.reported(&motor.name, &settings.buses[index].name);
                found.extend(findings(settings, motor, Some(&reported)));
            }
            Ok(None) => {}
            // The others would not be reached either.
            Err(Error::Bus(_)) => break,
            Err(error) => tracing::warn!("{}: {error}", motor.name),
        }
    }
    found.retain(|finding| finding.verdict == Verdict::Differs);
    (link.into_bus(), found)
}

/// A motor's words, if it answers.
fn ask(motor: &MotorSettings, link: &mut Link) -> Result<Option<Survey>, Error> {
    // A motor with ids of 29 bits is sent no frame with 11: its number may be an id of another one.
    if motor.addresses().command_id.is_extended() {
        return Ok(None);
    }
    // A motor that should speak MIT is sent nothing that only a native motor should read.
    let family = motor.protocol.family();
    let question = match family.question {
        Question::Both if !family.has_items => Question::MitOnly,
        question => question,
    };
    survey(link, motor.id, question, constants())
}
