//! The state of the robot as `status` and `watch` print it, for scripts and for operators.

use crate::advice::{Advice, motorctl};
use crate::imu_report::{ImuReport, imu_table};
use crate::joint_report::{IndicatorReport, JointReport, UNKNOWN, joint_table};
use motord_client::{
    Bus, BusCondition, Cause, FirstStop, Group, Indicator, JointDescription, Lease, MotorMode, Phase,
    Process, Rejection, RobotDescription, State, Telemetry,
};
use motord_terminal::{Cell, Colour, Palette, Table, printable, printable_line};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::io::{self, Write};

/// The robot after one cycle, as `--json` prints it.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct RobotReport {
    pub(crate) instance: String,
    pub(crate) version: String,
    pub(crate) pid: u32,
    pub(crate) rate_hz: f64,
    /// Longest time without a setpoint of an owner.
    pub(crate) setpoint_timeout_ms: f64,
    pub(crate) cycle: u64,
    /// True if the cycle has real-time scheduling and locked memory.
    pub(crate) realtime: bool,
    pub(crate) emergency_stop: bool,
    pub(crate) shutting_down: bool,
    /// True if the configuration file changed after the daemon read it.
    pub(crate) config_changed: bool,
    /// Ticks that were missed since the daemon started.
    pub(crate) overruns: u64,
    pub(crate) groups: Vec<GroupReport>,
    pub(crate) joints: Vec<JointReport>,
    pub(crate) buses: Vec<BusReport>,
    pub(crate) imus: Vec<ImuReport>,
}

/// A group of joints.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct GroupReport {
    pub(crate) name: String,
    pub(crate) phase: &'static str,
    /// The owner's lease; `null` without an owner.
    pub(crate) lease: Option<u64>,
    /// The owner's process; `null` without an owner, or if the daemon does not know the process.
    pub(crate) owner: Option<ProcessReport>,
    /// Age of the setpoint in use when the cycle began; `null` when there is none.
    pub(crate) setpoint_age_us: Option<f64>,
    /// Mean time between two setpoint messages of the owner, or of the one that was stopped for
    /// `setpoint-timeout`; `null` when not known.
    pub(crate) setpoint_period_us: Option<f64>,
    /// Horizon of the setpoint in use; `null` without one.
    pub(crate) setpoint_horizon_us: Option<f64>,
    /// The period is more than half the timeout: the remedy.
    #[serde(skip)]
    pub(crate) slow_owner: Option<String>,
    /// Cycles from the states that the setpoint in use answers to the cycle that first used it;
    /// `null` when not known.
    pub(crate) control_cycles: Option<u64>,
    pub(crate) accepted: u32,
    /// Accepted setpoint messages that missed the first cycle after the one that they answer.
    pub(crate) late: u32,
    /// Rejected setpoint messages by reason; only reasons that occurred.
    pub(crate) rejected: BTreeMap<&'static str, u32>,
    /// The latched stop; `null` when there is none.
    pub(crate) stop: Option<StopReport>,
}

/// The stop of a group, and the remedy.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct StopReport {
    pub(crate) cause: &'static str,
    pub(crate) sentence: &'static str,
    /// The joint that caused the stop.
    pub(crate) joint: Option<String>,
    /// The bus of this joint, if the bus is the cause.
    #[serde(skip)]
    pub(crate) bus: Option<String>,
    /// The process that requested the stop.
    pub(crate) asked_by: Option<ProcessReport>,
    /// The stop to which this emergency stop was added.
    pub(crate) first: Option<FirstStopReport>,
    pub(crate) advice: String,
    /// The commands of the advice.
    #[serde(skip)]
    pub(crate) steps: Advice,
}

/// A stop whose cause an emergency stop has replaced.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct FirstStopReport {
    pub(crate) cause: &'static str,
    pub(crate) sentence: &'static str,
    /// The joint that caused the stop.
    pub(crate) joint: Option<String>,
    /// The bus of this joint, if the bus is the cause.
    #[serde(skip)]
    bus: Option<String>,
    /// The process that requested the stop.
    pub(crate) asked_by: Option<ProcessReport>,
}

impl FirstStopReport {
    pub(crate) fn new(first: &FirstStop, robot: &RobotDescription) -> Self {
        let cause = Cause::try_from(first.cause).ok();
        let joint = first.joint.and_then(|joint| robot.joints.get(joint));
        Self {
            cause: cause.map_or(UNKNOWN, Cause::name),
            sentence: sentence(cause),
            joint: joint.map(|joint| joint.name.clone()),
            bus: joint.filter(|_| is_of_bus(cause)).map(|joint| joint.bus.clone()),
            asked_by: first.by.as_ref().map(ProcessReport::from),
        }
    }

    /// Returns the sentence of its cause, with the bus, the joint or the process that it comes
    /// from.
    pub(crate) fn describe(&self) -> String {
        format!("{}{}", self.sentence, origin(&self.bus, &self.joint, &self.asked_by))
    }
}

/// Returns the bus, the joint or the process that caused a stop, in brackets after a space;
/// otherwise an empty text.
fn origin(bus: &Option<String>, joint: &Option<String>, asked_by: &Option<ProcessReport>) -> String {
    let bus = bus.as_ref().map(|bus| format!("bus {bus}"));
    let origin =
        bus.or_else(|| joint.clone()).or_else(|| asked_by.as_ref().map(|process| format!("by {process}")));
    origin.map_or_else(String::new, |origin| format!(" ({origin})"))
}

const fn is_of_bus(cause: Option<Cause>) -> bool {
    matches!(cause, Some(Cause::BusOff | Cause::BusGone | Cause::TransmitStall | Cause::PowerLost))
}

fn sentence(cause: Option<Cause>) -> &'static str {
    cause.map_or("This motorctl does not know the cause.", Cause::sentence)
}

/// A process that owns a group or requested a stop.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct ProcessReport {
    pub(crate) pid: u32,
    /// `null` when the daemon does not know it.
    pub(crate) program: Option<String>,
}

impl fmt::Display for ProcessReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "pid {}", self.pid)?;
        // A process chooses its own name.
        self.program.iter().try_for_each(|program| write!(f, ", {}", printable_line(program)))
    }
}

impl From<&Process> for ProcessReport {
    fn from(Process { pid, program }: &Process) -> Self {
        Self { pid: *pid, program: Some(program.clone()).filter(|program| !program.is_empty()) }
    }
}

impl StopReport {
    /// Returns the bus, the joint or the process that caused the stop, in brackets after a space;
    /// otherwise an empty text.
    pub(crate) fn origin(&self) -> String {
        origin(&self.bus, &self.joint, &self.asked_by)
    }

    /// Returns the sentence of the cause with its origin, and the first cause where this is another
    /// one.
    pub(crate) fn reason(&self) -> String {
        let first = self.first.as_ref().map(|first| format!(" The first cause: {}", first.describe()));
        format!("{}{}{}", self.sentence, self.origin(), first.unwrap_or_default())
    }
}

/// A bus and its counters.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct BusReport {
    pub(crate) name: String,
    pub(crate) condition: &'static str,
    pub(crate) sent: u32,
    pub(crate) dropped: u32,
    pub(crate) received: u32,
    pub(crate) unexpected_id: u32,
    pub(crate) duplicate: u32,
    pub(crate) malformed: u32,
    pub(crate) errors: u32,
    pub(crate) lost: u32,
}

impl RobotReport {
    /// `state` with the names of `robot`.
    pub(crate) fn new(robot: &RobotDescription, state: &State) -> Self {
        let groups = robot.groups.iter().map(|group| group.name.as_str()).zip(state.groups());
        Self {
            instance: robot.instance.clone(),
            version: robot.version.clone(),
            pid: robot.pid,
            rate_hz: robot.rate_hz,
            setpoint_timeout_ms: robot.setpoint_timeout.as_secs_f64() * 1e3,
            cycle: state.cycle(),
            realtime: state.realtime(),
            emergency_stop: state.emergency_stop(),
            shutting_down: state.shutting_down(),
            config_changed: state.config_changed(),
            overruns: state.overruns(),
            groups: groups.map(|(name, group)| GroupReport::new(name, &group, robot)).collect(),
            joints: joints(robot, state),
            buses: robot.buses.iter().zip(state.buses()).map(BusReport::from).collect(),
            imus: imus(robot, state),
        }
    }

    /// Adds the names of the owners and of the programs that requested stops, and the stops before
    /// emergency stops.
    pub(crate) fn add_history(&mut self, robot: &RobotDescription, telemetry: &Telemetry) {
        for (group, history) in self.groups.iter_mut().zip(&telemetry.groups) {
            // The history also has the previous owner.
            group.owner = history.owner.as_ref().filter(|_| group.lease.is_some()).map(ProcessReport::from);
            let Some(stop) = &mut group.stop else { continue };
            stop.first = history.first.as_ref().map(|first| FirstStopReport::new(first, robot));
            let Some(process) = &history.stopped_by else { continue };
            if let Some(requester) = stop.asked_by.as_mut().filter(|requester| requester.pid == process.pid) {
                *requester = process.into();
            }
        }
    }

    /// Returns the troubles of the robot as sentences; none for a healthy robot.
    pub(crate) fn troubles(&self) -> Vec<String> {
        let alarms = [
            (self.emergency_stop, "The emergency stop is latched."),
            (self.shutting_down, "The daemon is shutting down."),
        ];
        let alarms = alarms.iter().filter(|(alarm, _)| *alarm).map(|(_, sentence)| (*sentence).to_owned());
        let stops = self.groups.iter().filter_map(|group| Some(group.stop.as_ref()?.describe(&group.name)));
        let joints = self.joints.iter().filter_map(JointReport::trouble);
        let buses = self.buses.iter().filter(|bus| bus.condition != BusCondition::Active.name());
        let buses = buses.map(|bus| format!("Bus {} is {}.", bus.name, bus.condition));
        let imus = self.imus.iter().filter_map(ImuReport::trouble);
        alarms.chain(stops).chain(joints).chain(buses).chain(imus).collect()
    }

    /// Writes the state as tables.
    ///
    /// # Errors
    ///
    /// `out` cannot be written.
    pub(crate) fn write(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        let Self { instance, version, pid, rate_hz, cycle, overruns, .. } = self;
        let realtime = match self.realtime {
            true => Cell::plain("real-time"),
            false => Cell::new("not real-time", Colour::Magenta),
        };
        writeln!(
            out,
            "{}: motord {}, process {pid}, {rate_hz} Hz, {}, cycle {cycle}, missed ticks {overruns}",
            printable(instance),
            printable(version),
            palette.paint(&realtime)
        )?;
        for (alarm, sentence) in [
            (self.emergency_stop, "The emergency stop is latched."),
            (self.shutting_down, "The daemon is shutting down."),
            (self.config_changed, "The configuration file has changed. Restart the daemon to use it."),
        ] {
            if alarm {
                writeln!(out, "{}", palette.paint(&Cell::new(sentence, Colour::Red)))?;
            }
        }
        writeln!(out)?;
        write_groups(&self.groups, out, palette)?;
        writeln!(out)?;
        joint_table(&self.joints).write(out, palette)?;
        // Motors on a bus that is not up cannot answer: the bus has the advice.
        let is_reached = |joint: &&JointReport| {
            !self.buses.iter().any(|bus| bus.name == joint.bus && bus.remedy().is_some())
        };
        let joints = self.joints.iter().filter(is_reached);
        for advice in joints.filter_map(|joint| joint.advice.as_ref()) {
            writeln!(out, "{}", palette.paint(&Cell::new(advice, Colour::Red)))?;
        }
        writeln!(out)?;
        bus_table(&self.buses).write(out, palette)?;
        for advice in self.buses.iter().filter_map(BusReport::advice) {
            writeln!(out, "{}", palette.paint(&Cell::new(advice, Colour::Red)))?;
        }
        if self.imus.is_empty() { Ok(()) } else { self.write_imus(out, palette) }
    }

    fn write_imus(&self, out: &mut dyn Write, palette: Palette) -> io::Result<()> {
        writeln!(out)?;
        imu_table(&self.imus).write(out, palette)?;
        for trouble in self.imus.iter().filter_map(ImuReport::trouble) {
            writeln!(out, "{}", palette.paint(&Cell::new(trouble, Colour::Red)))?;
        }
        Ok(())
    }
}

fn imus(robot: &RobotDescription, state: &State) -> Vec<ImuReport> {
    let imus = robot.imus.iter().zip(state.imus());
    imus.map(|(description, imu)| ImuReport::new(description, &imu, state.publish_ns())).collect()
}

fn joints(robot: &RobotDescription, state: &State) -> Vec<JointReport> {
    let mut joints: Vec<_> = robot.joints.iter().zip(state.joints()).map(JointReport::from).collect();
    for (index, joint) in joints.iter_mut().enumerate() {
        let known = state.indicators(index).map(|indicators| indicators.iter().map(indicator).collect());
        joint.indicators = known.unwrap_or_default();
        joint.advice = obstacle(joint, &robot.joints[index], robot);
    }
    joints
}

/// Returns the obstacle to the motion of `joint`, and the remedy.
fn obstacle(joint: &JointReport, description: &JointDescription, robot: &RobotDescription) -> Option<String> {
    let (name, motorctl) = (&joint.name, motorctl(&robot.instance));
    if joint.mode == MotorMode::Offline.name() {
        let bus = robot.buses.iter().position(|bus| *bus == joint.bus);
        let device = bus.and_then(|bus| robot.devices.get(bus)).filter(|device| !device.is_empty());
        let scan = device.map_or_else(String::new, |device| {
            format!(" To find it, stop the daemon and run `motorctl scan --bus {device}`.")
        });
        let protocol = &description.protocol;
        return Some(format!(
            "{name} does not answer: check its power and wiring, its id and host id, the bit rate of {}, and that it speaks \
             the configured protocol, {protocol}.{scan}",
            joint.bus
        ));
    }
    if joint.mismatch {
        return Some(format!(
            "{name} differs from its configuration, or has not reported its registers, and its group is not enabled: the daemon's \
             log names the difference; `{motorctl} explain mismatch`"
        ));
    }
    let position = joint.position_rad.filter(|_| joint.outside_limits)?;
    Some(format!(
        "{}: move it by hand, or correct its limits. If the angle is not the real one, `{motorctl} explain outside-limits` \
         describes how to find out whether its zero is wrong.",
        description.outside(position)
    ))
}

fn indicator((indicator, value): (Indicator, f32)) -> (&'static str, IndicatorReport) {
    (indicator.name(), IndicatorReport { value, unit: indicator.unit() })
}

impl GroupReport {
    fn new(name: &str, group: &Group, robot: &RobotDescription) -> Self {
        let horizon = group.setpoint_horizon.unwrap_or_default();
        let rejected = Rejection::ALL.iter().map(|reason| (reason.name(), group.rejected(*reason)));
        Self {
            name: name.to_owned(),
            phase: group.phase.map_or(UNKNOWN, Phase::name),
            lease: group.lease.map(Lease::raw),
            owner: None,
            setpoint_age_us: group.setpoint_age.map(|age| age.as_secs_f64() * 1e6),
            setpoint_period_us: group.setpoint_period.map(|period| period.as_secs_f64() * 1e6),
            slow_owner: group.setpoint_period.and_then(|period| robot.slow_owner(period, horizon)),
            setpoint_horizon_us: group.setpoint_horizon.map(|horizon| horizon.as_secs_f64() * 1e6),
            control_cycles: group.control_cycles,
            accepted: group.accepted,
            late: group.late,
            rejected: rejected.filter(|(_, count)| *count > 0).collect(),
            stop: group.latched.then(|| StopReport::new(name, group, robot)),
        }
    }

    fn owner(&self) -> String {
        match (&self.owner, self.lease) {
            (Some(process), _) => process.to_string(),
            (None, Some(lease)) => format!("lease {lease}"),
            (None, None) => "none".to_owned(),
        }
    }

    /// Returns true if more than 5 % of the setpoints were late: the controller is too slow.
    pub(crate) const fn is_often_late(&self) -> bool {
        self.late > self.accepted / 20
    }
}

impl StopReport {
    fn new(name: &str, group: &Group, robot: &RobotDescription) -> Self {
        let described = group.cause_joint.and_then(|joint| robot.joints.get(joint));
        let joint = described.map(|joint| &joint.name);
        let mut steps =
            Advice::new(group.cause, &robot.instance, name, joint.map(String::as_str), group.owned);
        if group.cause == Some(Cause::SetpointTimeout)
            && let Some(remedy) = group
                .setpoint_period
                .and_then(|period| robot.slow_owner(period, group.setpoint_horizon.unwrap_or_default()))
        {
            steps.remedy = remedy.into();
        }
        Self {
            cause: group.cause.map_or(UNKNOWN, Cause::name),
            sentence: sentence(group.cause),
            joint: joint.cloned(),
            bus: described.filter(|_| is_of_bus(group.cause)).map(|joint| joint.bus.clone()),
            asked_by: group.cause_pid.map(|pid| ProcessReport { pid, program: None }),
            first: None,
            advice: steps.to_string(),
            steps,
        }
    }

    /// Describes the stop of the group `name`.
    fn describe(&self, name: &str) -> String {
        let stop = format!("{name} is stopped for {}: {}{}", self.cause, self.sentence, self.origin());
        let Some(first) = &self.first else { return stop };
        format!("{stop} {name} was first stopped for {}: {}", first.cause, first.describe())
    }
}

impl BusReport {
    /// Returns the remedy for a bus that is not up, without its full stop.
    pub(crate) fn remedy(&self) -> Option<&'static str> {
        let is = |condition: BusCondition| self.condition == condition.name();
        if is(BusCondition::Off) {
            Some(Cause::BusOff.advice())
        } else if is(BusCondition::Down) || is(BusCondition::Gone) {
            Some(Cause::BusGone.advice())
        } else if is(BusCondition::Held) {
            Some(Cause::PowerLost.advice())
        } else if is(BusCondition::Exchanged) {
            Some("Give each adapter a fixed name and plug it in again: `motorctl explain exchanged`")
        } else {
            None
        }
    }

    /// Returns the advice for a bus that is not up.
    fn advice(&self) -> Option<String> {
        let remedy = self.remedy()?;
        let condition = match self.condition == BusCondition::Exchanged.name() {
            true => format!("Another adapter has the name of bus {}, and is not used", self.name),
            false => format!("Bus {} is {}", self.name, self.condition),
        };
        Some(format!("{condition}. {remedy}."))
    }
}

impl From<(&String, Bus)> for BusReport {
    fn from((name, bus): (&String, Bus)) -> Self {
        let Bus { condition, sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost } =
            bus;
        let (name, condition) = (name.clone(), condition.map_or(UNKNOWN, BusCondition::name));
        Self { name, condition, sent, dropped, received, unexpected_id, duplicate, malformed, errors, lost }
    }
}

fn write_groups(groups: &[GroupReport], out: &mut dyn Write, palette: Palette) -> io::Result<()> {
    let has_horizon = groups.iter().any(|group| group.setpoint_horizon_us.is_some());
    let horizon = has_horizon.then_some("horizon ms");
    let columns = ["group", "phase", "owner", "setpoint age µs", "period ms"].into_iter().chain(horizon);
    let mut table = Table::new(&columns.chain(["accepted", "late", "rejected"]).collect::<Vec<_>>());
    for group in groups {
        let rejected: Vec<String> =
            group.rejected.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
        let mut row = vec![
            Cell::plain(&group.name),
            Cell::plain(group.phase),
            Cell::plain(group.owner()),
            Cell::number(group.setpoint_age_us, 0),
            Cell::number(group.setpoint_period_us.map(|period| period / 1e3), 1),
        ];
        row.extend(
            has_horizon.then(|| Cell::number(group.setpoint_horizon_us.map(|horizon| horizon / 1e3), 1)),
        );
        row.extend([
            Cell::plain(group.accepted),
            Cell::new(group.late, if group.is_often_late() { Colour::Magenta } else { Colour::Plain }),
            Cell::new(if rejected.is_empty() { "0".into() } else { rejected.join(", ") }, Colour::Plain),
        ]);
        table.row(row);
    }
    table.write(out, palette)?;
    for (group, slow) in groups.iter().filter_map(|group| Some((group, group.slow_owner.as_ref()?))) {
        if group.stop.is_none() {
            writeln!(
                out,
                "{}",
                palette.paint(&Cell::new(format!("{}: {slow}.", group.name), Colour::Magenta))
            )?;
        }
    }
    for (group, stop) in groups.iter().filter_map(|group| Some((group, group.stop.as_ref()?))) {
        let sentence = palette.paint(&Cell::new(stop.describe(&group.name), Colour::Red));
        writeln!(out, "{sentence}\n  {}", printable(&stop.advice))?;
        writeln!(out, "  See `motorctl explain {}`.", stop.cause)?;
    }
    Ok(())
}

fn bus_table(buses: &[BusReport]) -> Table {
    let mut table = Table::new(&[
        "bus",
        "condition",
        "sent",
        "dropped",
        "received",
        "unexpected id",
        "duplicate",
        "malformed",
        "errors",
        "lost",
    ]);
    for bus in buses {
        let good = bus.condition == BusCondition::Active.name();
        let mut row = vec![
            Cell::plain(&bus.name),
            Cell::new(bus.condition, if good { Colour::Plain } else { Colour::Red }),
            Cell::plain(bus.sent),
            Cell::counter(bus.dropped),
            Cell::plain(bus.received),
        ];
        row.extend(
            [bus.unexpected_id, bus.duplicate, bus.malformed, bus.errors, bus.lost].map(Cell::counter),
        );
        table.row(row);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_for_silent_joint_separates_its_sentences() {
        let joint = JointReport { mode: MotorMode::Offline.name(), bus: "left".into(), ..Default::default() };
        let description = JointDescription { protocol: "mit".into(), ..Default::default() };
        let (buses, devices) = (vec!["left".into()], vec!["can0".into()]);
        let robot = RobotDescription { buses, devices, ..Default::default() };
        let advice = obstacle(&joint, &description, &robot).unwrap();
        assert!(advice.contains("protocol, mit. To find it, stop the daemon"), "{advice}");
    }
}
