//! Changes from cycle to cycle, as sentences, and the safe stops.
//!
//! Events that begin and end between two recorded cycles are not detected.

use motord_shared::description::RobotDescription;
use motord_shared::limits::GROUPS_MAX;
use motord_shared::message::{FLAG_EMERGENCY_STOP, FLAG_SHUTDOWN, IMU_LOST};
use motord_shared::{
    BusCondition, Cause, CycleRecord, Fault, GroupState, ImuContradiction, ImuState, JointState, MotorMode,
    Phase, StateMessage,
};
use std::fmt;

/// The severity of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Every change of a motor's mode.
    Debug,
    /// Phases, owners and resets of a group, a cleared fault, a shutdown of the daemon.
    Info,
    /// Missed ticks, a changed bus condition.
    Warning,
    /// A stop or a fault: a person must inspect the robot.
    Error,
}

/// A change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Event {
    /// The severity.
    pub level: Level,
    /// The joint, group or bus; empty for the whole robot.
    pub subject: String,
    /// A sentence without its subject.
    pub text: String,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.subject, self.text)
    }
}

/// Compares each state with the previous one.
#[derive(Debug, Default)]
pub struct Events {
    before: Option<Box<StateMessage>>,
}

impl Events {
    /// Returns the changes since the previous state; none for the first.
    pub fn of(&mut self, state: &StateMessage, robot: &RobotDescription) -> Vec<Event> {
        let mut events = Vec::new();
        match &mut self.before {
            None => self.before = Some(Box::new(*state)),
            Some(before) => {
                whole(&mut events, before, state);
                let names = robot.groups.iter().map(|group| group.name.as_str());
                for ((name, before), group) in names.zip(before.groups()).zip(state.groups()) {
                    of_group(&mut events, name, before, group, robot);
                }
                let names = robot.joints.iter().map(|joint| joint.name.as_str());
                for ((name, before), joint) in names.zip(before.joints()).zip(state.joints()) {
                    of_joint(&mut events, name, before, joint);
                }
                let names = robot.imus.iter().map(|imu| imu.name.as_str());
                for ((name, before), imu) in names.zip(before.imus()).zip(state.imus()) {
                    of_imu(&mut events, name, before, imu);
                }
                for ((name, before), bus) in robot.buses.iter().zip(before.buses()).zip(state.buses()) {
                    if before.condition != bus.condition {
                        let condition = named(BusCondition::try_from(bus.condition));
                        push(&mut events, Level::Warning, name, format!("is {condition}"));
                    }
                }
                **before = *state;
            }
        }
        events
    }
}

fn push(events: &mut Vec<Event>, level: Level, subject: &str, text: String) {
    events.push(Event { level, subject: subject.to_owned(), text });
}

fn named<T: ToString, E>(code: Result<T, E>) -> String {
    code.map_or_else(|_| "unknown".to_owned(), |code| code.to_string())
}

fn whole(events: &mut Vec<Event>, before: &StateMessage, state: &StateMessage) {
    let missed = state.overruns.saturating_sub(before.overruns);
    if missed > 0 {
        push(events, Level::Warning, "", format!("ticks missed: {missed}"));
    }
    let set = state.flags & !before.flags;
    let cleared = before.flags & !state.flags;
    for (is_so, level, text) in [
        (set & FLAG_EMERGENCY_STOP != 0, Level::Error, "emergency stop"),
        (cleared & FLAG_EMERGENCY_STOP != 0, Level::Info, "the emergency stop was reset"),
        (set & FLAG_SHUTDOWN != 0, Level::Info, "the daemon is shutting down"),
    ] {
        if is_so {
            push(events, level, "", text.to_owned());
        }
    }
}

fn of_group(
    events: &mut Vec<Event>,
    name: &str,
    before: &GroupState,
    group: &GroupState,
    robot: &RobotDescription,
) {
    if before.lease != group.lease {
        let text = if group.lease == 0 { "has no owner" } else { "has an owner" };
        push(events, Level::Info, name, text.to_owned());
    }
    if before.phase != group.phase {
        push(events, Level::Info, name, format!("is {}", named(Phase::try_from(group.phase))));
    }
    if before.cause != group.cause && group.cause != 0 {
        let cause = Cause::try_from(group.cause);
        let is_of_bus =
            matches!(cause, Ok(Cause::BusOff | Cause::BusGone | Cause::TransmitStall | Cause::PowerLost));
        let joint = robot.joints.get(group.cause_joint as usize);
        let origin = joint.map_or_else(String::new, |joint| match is_of_bus {
            true => format!(" (bus {})", joint.bus),
            false => format!(" ({})", joint.name),
        });
        push(events, Level::Error, name, format!("is stopped: {}{origin}", named(cause)));
    }
    if before.cause != 0 && group.cause == 0 {
        push(events, Level::Info, name, "was reset".to_owned());
    }
}

fn of_joint(events: &mut Vec<Event>, name: &str, before: &JointState, joint: &JointState) {
    if before.mode != joint.mode {
        push(events, Level::Debug, name, format!("is {}", named(MotorMode::try_from(joint.mode))));
    }
    if before.fault != joint.fault && joint.fault != 0 {
        let known = Fault::ALL.iter().filter(|fault| joint.fault & fault.bit() != 0);
        let names: Vec<&str> = known.map(|fault| fault.name()).collect();
        push(events, Level::Error, name, format!("reports {} ({:#x})", names.join(", "), joint.fault));
    }
    if before.fault != 0 && joint.fault == 0 {
        push(events, Level::Info, name, "reports no fault any more".to_owned());
    }
}

fn of_imu(events: &mut Vec<Event>, name: &str, before: &ImuState, imu: &ImuState) {
    let [was_lost, is_lost] = [before, imu].map(|imu| imu.flags & IMU_LOST != 0);
    match (was_lost, is_lost) {
        (false, true) => push(events, Level::Error, name, "is lost".to_owned()),
        (true, false) => push(events, Level::Info, name, "delivers samples".to_owned()),
        _ => {}
    }
    match (before.contradictions(), imu.contradictions()) {
        (before, now) if before == now => {}
        (_, 0) => push(events, Level::Info, name, "agrees with gravity again".to_owned()),
        (_, now) => {
            let names: Vec<_> = ImuContradiction::of_bits(now).map(ImuContradiction::name).collect();
            push(events, Level::Warning, name, format!("contradicts gravity: {}", names.join(", ")));
        }
    }
}

/// Detects the groups that are stopped for a cause.
#[derive(Debug, Default)]
pub struct Stops {
    /// The causes of the previous cycle, by group; `None` before the first.
    causes: Option<[u32; GROUPS_MAX]>,
    is_leaving: bool,
}

impl Stops {
    /// Returns the cause if a group was stopped in this cycle. A cause latched before the first
    /// cycle does not count.
    pub fn of(&mut self, record: &CycleRecord) -> Option<Cause> {
        self.is_leaving = record.state.flags & FLAG_SHUTDOWN != 0;
        let mut causes = [0; GROUPS_MAX];
        for (cause, group) in causes.iter_mut().zip(record.state.groups()) {
            *cause = group.cause;
        }
        let known = self.causes.replace(causes).unwrap_or(causes);
        let changed = causes.iter().zip(known).find(|(cause, known)| **cause != *known && **cause != 0);
        changed.and_then(|(cause, _)| Cause::try_from(*cause).ok())
    }

    /// Returns `true` if the daemon was shutting down in the last cycle: a missing next cycle is
    /// then no death.
    #[must_use]
    pub fn is_leaving(&self) -> bool {
        self.is_leaving
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_shared::description::{GroupDescription, ImuDescription, JointDescription};
    use motord_shared::message::IMU_CONTRADICTIONS_SHIFT;

    #[test]
    fn loss_and_return_of_imus_are_events() {
        let imu = ImuDescription { name: "base".into(), ..Default::default() };
        let robot = RobotDescription { imus: vec![imu], ..Default::default() };
        let mut events = Events::default();
        let mut text_of = |flags| {
            let mut state = StateMessage { imu_count: 1, ..StateMessage::default() };
            state.imus[0].flags = flags;
            events.of(&state, &robot).first().map(|event| (event.level, event.to_string()))
        };
        let lost = Some((Level::Error, "base is lost".to_owned()));
        let back = Some((Level::Info, "base delivers samples".to_owned()));
        let found = [0, IMU_LOST, IMU_LOST, 0, 0].map(&mut text_of);
        assert_eq!(found, [None, lost, None, back, None]);
        let in_g = ImuContradiction::AccelerationInG.bit() << IMU_CONTRADICTIONS_SHIFT;
        let named = Some((Level::Warning, "base contradicts gravity: acceleration-in-g".to_owned()));
        let agrees = Some((Level::Info, "base agrees with gravity again".to_owned()));
        assert_eq!([in_g, in_g, 0].map(&mut text_of), [named, None, agrees]);
    }

    #[test]
    fn each_change_is_one_event() {
        let joint =
            JointDescription { name: "knee".into(), bus: "left".into(), ..JointDescription::default() };
        let group = GroupDescription { name: "legs".into(), joints: vec![0] };
        let robot = RobotDescription { joints: vec![joint], groups: vec![group], ..Default::default() };
        let mut events = Events::default();
        let mut state = StateMessage { joint_count: 1, group_count: 1, ..StateMessage::default() };
        assert_eq!(events.of(&state, &robot), [], "the first has nothing before it");
        state.cycle += 1;
        assert_eq!(events.of(&state, &robot), []);
        state.overruns = 2;
        state.groups[0].cause = Cause::MotorFault.code();
        state.joints[0].fault = Fault::OverVoltage.bit();
        let found: Vec<String> = events.of(&state, &robot).iter().map(Event::to_string).collect();
        assert_eq!(
            found,
            [" ticks missed: 2", "legs is stopped: motor-fault (knee)", "knee reports over-voltage (0x2)"]
        );
        assert_eq!(events.of(&state, &robot), []);
        state.groups[0].cause = Cause::BusOff.code();
        assert_eq!(events.of(&state, &robot)[0].to_string(), "legs is stopped: bus-off (bus left)");
    }
}
