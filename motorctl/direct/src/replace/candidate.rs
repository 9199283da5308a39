//! The motor that takes the place of a missing one.

use super::Replacement;
use crate::file::FACTORY_ID;
use crate::find::{frame_id, is_doubled};
use crate::target::Protocol;
use clap::ValueEnum;
use motord_bus::{FrameId, IdSet};
use motord_protocol::commissioning::{Family, Found, Report, Unprompted};
use motord_settings::settings::MotorSettings;

/// Ids of new RobStride motors. The vendor's documents give none: motorbridge's examples have 127.
const ROBSTRIDE_FACTORY_IDS: [u8; 2] = [FACTORY_ID, 127];

/// Returns the ids that new motors in the protocol of `joint` may have.
fn factory_ids(joint: &MotorSettings) -> &'static [u8] {
    let is_robstride = joint.protocol.name() == Protocol::RobStride.name();
    if is_robstride { &ROBSTRIDE_FACTORY_IDS } else { &[FACTORY_ID] }
}

/// Returns whether the address of the joint's motor is one id: a new motor with it looks like that of the joint.
fn has_one_id(joint: &MotorSettings) -> bool {
    let is_that = |protocol: &&Protocol| protocol.name() == joint.protocol.name();
    Protocol::value_variants().iter().find(is_that).is_some_and(|protocol| protocol.has_one_id())
}

/// Returns numbers as text.
fn list(ids: impl Iterator<Item = String>, separator: &str) -> String {
    ids.collect::<Vec<_>>().join(separator)
}

/// Describes motors that answered: id and protocol.
fn named<'f>(found: impl Iterator<Item = &'f Found>) -> String {
    let name = |found: &Found| match found.family {
        Family::Unknown { .. } => "unknown",
        family => Protocol::of(family).name(),
    };
    list(found.map(|found| format!("{} ({})", found.id, name(found))), ", ")
}

impl Replacement<'_> {
    fn bus(&self) -> &str {
        self.settings.buses[self.joint.bus].device()
    }

    fn neighbours(&self) -> impl Iterator<Item = &MotorSettings> {
        self.settings.motors.iter().filter(|motor| motor.bus == self.joint.bus)
    }

    /// Checks that the frames to a new motor are none of another motor of the bus, and that its answers are not
    /// those of another joint's motor.
    ///
    /// # Errors
    ///
    /// The text names the joint.
    pub(super) fn check_factory_ids(&self) -> Result<(), String> {
        if !has_one_id(self.joint) {
            return Ok(());
        }
        for &id in factory_ids(self.joint) {
            let new = MotorSettings { id, ..self.joint.clone() };
            let is_same =
                |motor: &MotorSettings| motor.id == id && motor.protocol.name() == self.joint.protocol.name();
            let shared = self.neighbours().find(|motor| is_same(motor) || overlap(&new, motor));
            if let Some(motor) = shared {
                return Err(format!(
                    "{}: {} shares an id with new motors, which have the id {id}: give the new one the id {} and its zero alone on the \
                     cable, with `motorctl id` and `motorctl zero`",
                    self.bus(),
                    motor.name,
                    self.joint.id
                ));
            }
        }
        Ok(())
    }

    /// Returns the only motor that no joint has, if that of the joint is the only missing one.
    ///
    /// # Errors
    ///
    /// The bus is unclear: the text names what to do first.
    pub(super) fn new_motor(&self, report: &Report) -> Result<Found, String> {
        self.check_other_nodes(report)?;
        self.check_doubled(report)?;
        self.check_missing(report)?;
        let bus = self.bus();
        let is_unowned = |found: &&Found| !self.neighbours().any(|motor| self.is_motor_of(motor, found));
        let new: Vec<_> = report.found.iter().filter(is_unowned).collect();
        match *new {
            [found] if factory_ids(self.joint).contains(&found.id) || found.id == self.joint.id => Ok(*found),
            [found] => Err(format!(
                "{bus}: the motor with id {} is not new, and no joint has it: give it the id {FACTORY_ID} first, alone on the cable",
                named([found].into_iter())
            )),
            [] => Err(format!(
                "{bus}: no new motor answers: check its power and wires. It may have another bit rate, or another protocol than its model"
            )),
            _ => Err(format!(
                "{bus}: several motors answer that no joint has, with the ids {}: take the power from all but one",
                named(new.into_iter())
            )),
        }
    }

    /// Refuses frames that no motor was asked for.
    fn check_other_nodes(&self, report: &Report) -> Result<(), String> {
        let bus = self.bus();
        let custom = report.unprompted.iter().find_map(|driver| match driver {
            Unprompted::CustomFault { id } => Some(*id),
            Unprompted::CanSimple { .. } => None,
        });
        if let Some(id) = custom {
            return Err(format!(
                "{bus}: a driver with the \"custom\" protocol reports a fault with id {}: take its power",
                frame_id(id)
            ));
        }
        if let Some(advice) = report.unasked_formats.advice().next() {
            return Err(format!("{bus}: without a request, {advice}"));
        }
        if report.unasked.is_empty() {
            return Ok(());
        }
        let ids = list(report.unasked.iter().map(|id: &FrameId| frame_id(*id)), ", ");
        Err(format!(
            "{bus}: frames arrive without a request, with the ids {ids}: stop the program or node that sends them"
        ))
    }

    /// Refuses two motors with one id.
    fn check_doubled(&self, report: &Report) -> Result<(), String> {
        let alike = |found: &Found| {
            let found = *found;
            report.found.iter().filter(move |other| is_doubled(&found, other))
        };
        let doubled = report.found.iter().find(|found| alike(found).count() > 1);
        let Some(id) = report.collisions.first().copied().or(doubled.map(|found| found.id)) else {
            return Ok(());
        };
        let kinds = doubled.map_or_else(String::new, |found| format!(": {}", named(alike(found))));
        let ids = list(factory_ids(self.joint).iter().map(u8::to_string), " or ");
        Err(format!(
            "{}: several motors answer as id {id}{kinds}: take the power from all but one. A new motor has the id {ids}: the joint with \
             this id must have no power while another one is replaced",
            self.bus()
        ))
    }

    /// Refuses unless the motor of the joint is the only missing one.
    fn check_missing(&self, report: &Report) -> Result<(), String> {
        let (bus, name) = (self.bus(), &self.joint.name);
        let has_motor =
            |motor: &MotorSettings| report.found.iter().any(|found| self.is_motor_of(motor, found));
        if has_motor(self.joint) {
            return Err(format!(
                "{bus}: the motor of {name} answers: take its power, and give it to the new one. If it is the new one, take its power once, \
                 then run:\n  motorctl setup --config {} --joint {name}",
                self.config.display()
            ));
        }
        let factory = factory_ids(self.joint);
        let others = self
            .neighbours()
            .filter(|motor| motor.name != *name && !factory.contains(&motor.id) && !has_motor(motor));
        let others = list(others.map(|motor| motor.name.clone()), ", ");
        if others.is_empty() {
            return Ok(());
        }
        Err(format!(
            "{bus}: beside {name} no motor answers for: {others}. Give them power, so that the new motor takes no wrong place"
        ))
    }

    /// Returns whether an answer is that of the motor of `joint`. The motor of the replaced joint counts only
    /// in the protocol of the configuration.
    fn is_motor_of(&self, joint: &MotorSettings, found: &Found) -> bool {
        let (spoken, wanted) = (Protocol::of(found.family), joint.protocol.name());
        if spoken.has_one_id() || has_one_id(joint) {
            return found.id == joint.id && spoken.name() == wanted;
        }
        let is_native = found.family == Family::Native;
        let is_complete = joint.name != self.joint.name || is_native == (wanted == Protocol::Gim.name());
        let has_host_id = found.host_id.is_none() || found.host_id == Some(joint.host_id);
        found.id == joint.id && has_host_id && is_complete
    }
}

/// Returns whether a motor reads frames to the other one, or from it, as its own.
fn overlap(one: &MotorSettings, other: &MotorSettings) -> bool {
    let ids = |motor: &MotorSettings| -> Vec<IdSet> {
        let addresses = motor.addresses();
        vec![addresses.receives(), addresses.replies]
    };
    let obeys = |one: &MotorSettings, other: &MotorSettings| {
        let mut obeyed = one.addresses().obeyed(&one.profile.ids);
        obeyed.any(|id| ids(other).iter().any(|ids| ids.matches(id)))
    };
    let is_same_kind = one.protocol.name() == other.protocol.name();
    let is_shared = ids(one).iter().any(|ours| ids(other).iter().any(|theirs| ours.overlaps(*theirs)));
    // Motors of one family obey the ids of all of them together.
    is_shared || !is_same_kind && (obeys(one, other) || obeys(other, one))
}
