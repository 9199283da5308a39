//! Decides the command of each motor in each cycle, as a pure function of state, inputs and time.
//! No clock, no I/O, no allocation after [`Control::new`]. Nothing here returns an error: every
//! problem becomes a state, a counter or an event.
//!
//! One cycle: [`request`](Control::request) and [`offer`](Control::offer) take the requests of
//! clients, [`decide`](Control::decide) makes one command per motor, [`receive`](Control::receive)
//! takes the replies of the motors, [`end_cycle`](Control::end_cycle) handles missed replies.
//!
//! | file | decides |
//! |---|---|
//! | `group/` | the phases of a group, its owner, its setpoints, the causes that stop it |
//! | `motor/` | the modes of a motor, its limits, the plausibility of its reports |
//! | `admin.rs` | requests of clients and operators |
//! | `imu.rs` | the samples of IMUs, and their loss |
//! | `gravity.rs` | whether orientation and acceleration of an IMU at rest agree about gravity |
//! | `repetition.rs` | whether a sensor repeats one sample |
//! | `time_base.rs`, `bus_health.rs` | the health of the time base and of the buses |
//! | `hold.rs` | which buses are held, because none of their motors answers |

mod admin;
mod answers;
mod bus_health;
mod context;
mod event;
mod gravity;
mod group;
mod hold;
mod imu;
mod indicators;
mod motor;
mod repetition;
mod requester;
mod time_base;

pub use event::{Event, Events, Losses};
pub use imu::ImuReading;
pub use motor::{Applied, Circumstances, ForeignFrames, damp, limit};
pub use repetition::Repetition;
pub use time_base::Wake;

use bus_health::BusHealth;
use context::Context;
use group::{Consequence, Group};
use imu::Imus;
use indicators::Indicators;
use motor::{Motor, Turn};
use motord_bus::{Duration, FrameId, Instant};
use motord_protocol::drive::{Command, JointSide, Measured, Reported, Status};
use motord_settings::settings::Settings;
use motord_shared::{
    AdminReply, BusCondition, Cause, GroupState, ImuState, JointIndicators, JointState, Lease, Phase,
    SetpointMessage,
};
use requester::Leases;
use time_base::TimeBase;

/// The knowledge of a sensor's reader, and the index of the sensor in the configuration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading<'a> {
    /// That of an IMU.
    Imu(usize, &'a ImuReading),
}

/// A motor that has not answered by this time is reported once.
const SILENT_START: Duration = Duration::from_secs(2);

/// The group of a joint, and its index in that group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct GroupSlot {
    group: usize,
    slot: usize,
}

/// The state of every group with its motors, and the rules they follow.
#[derive(Debug)]
pub struct Control {
    groups: Vec<Group>,
    /// By joint.
    slots: Vec<GroupSlot>,
    buses: Vec<BusHealth>,
    indicators: Indicators,
    imus: Imus,
    /// By joint.
    commands: Vec<Command>,
    time_base: TimeBase,
    leases: Leases,
    context: Context,
    /// The motors that never answered have been reported.
    silence_reported: bool,
    shutting_down: bool,
}

impl Control {
    /// Creates the state in which every motor is stopped and no group is owned. Allocates; nothing
    /// after it does. `boot_id` makes the leases differ from those of the previous daemon.
    ///
    /// # Panics
    ///
    /// When a motor of the settings is not in exactly one group.
    #[must_use]
    pub fn new(settings: &Settings, boot_id: u64) -> Self {
        let groups = settings.groups.iter().enumerate();
        let turns = turns(settings);
        let joints = |bus: usize| {
            let on_bus = settings.motors.iter().enumerate().filter(move |(_, motor)| motor.bus == bus);
            on_bus.map(|(joint, _)| joint).collect()
        };
        Self {
            groups: groups.map(|(index, group)| Group::new(index, group, &settings.motors, &turns)).collect(),
            slots: slots(settings),
            buses: (0..settings.buses.len())
                .map(|bus| {
                    let is_line = settings.buses[bus].is_line();
                    BusHealth::new(joints(bus), is_line, question_turn(settings, bus))
                })
                .collect(),
            indicators: Indicators::new(settings),
            imus: Imus::new(&settings.sensors.imus),
            commands: vec![Command::Nothing; settings.motors.len()],
            time_base: TimeBase::new(&settings.cycle),
            leases: Leases::new(boot_id),
            context: Context::new(settings),
            silence_reported: false,
            shutting_down: false,
        }
    }

    /// Offers a setpoint message. A message with an error is counted by its reason, and nothing of
    /// it is used. Does not allocate; bounded by the joints of a message.
    pub fn offer(&mut self, message: &SetpointMessage, now: Instant) {
        let Self { groups, context, .. } = self;
        let group = Lease::from_raw(message.lease).and_then(|lease| groups.get_mut(lease.group()));
        if let Some(group) = group {
            group.offer(message, now, context);
        }
    }

    /// Marks a motor that differs from its configuration: its group is never enabled.
    pub fn mark_mismatch(&mut self, joint: usize) {
        let GroupSlot { group, slot } = self.slots[joint];
        self.groups[group].motors[slot].is_mismatched = true;
    }

    /// Returns the ends of the codes that the motor of `joint` reported: position, rad, velocity,
    /// rad/s, torque, N·m. `None` until they are read, and where the motor does not report them.
    #[must_use]
    pub fn reported_ends(&self, joint: usize) -> Option<[f32; 3]> {
        self.motor(joint).reported_ends()
    }

    /// Records that `bus` was opened again: its motors may be others. Their registers are read
    /// again before they start. Its queue is empty. Bounded by motors.
    pub fn bus_reopened(&mut self, bus: usize) {
        self.bus_emptied(bus);
        let motors = self.groups.iter_mut().flat_map(|group| &mut group.motors);
        motors.filter(|motor| motor.settings.bus == bus).for_each(Motor::expire_registers);
    }

    /// Returns the command of a joint in this cycle.
    #[must_use]
    pub fn command(&self, joint: usize) -> &Command {
        &self.commands[joint]
    }

    /// Returns whether motors are asked for their faults or for indicators.
    #[must_use]
    pub fn has_questions(&self) -> bool {
        self.polls_faults() || !self.indicators.is_empty()
    }

    fn polls_faults(&self) -> bool {
        self.context.safety.fault_poll_hz > 0.0
    }

    /// Begins a cycle: handles timeouts, and makes one command per joint. Does not allocate;
    /// bounded by motors and groups.
    pub fn decide(&mut self, wake: Wake) -> &[Command] {
        let elapsed = self.context.begin(wake);
        if wake.missed_ticks > 0 {
            self.context.push(Event::MissedTicks { missed_ticks: wake.missed_ticks });
        }
        if let Some(cause) = self.time_base.check(&wake, elapsed) {
            self.stop_moving(cause);
        }
        self.imus.watch(&mut self.context);
        if self.imus.forbid_motion() {
            self.stop_moving(Cause::ImuLost);
        }
        self.report_silence();
        self.groups.iter_mut().for_each(|group| group.begin_turns(&mut self.context));
        self.watch_silence();
        let Self { groups, buses, commands, context, .. } = self;
        for group in groups {
            group.decide(elapsed, buses, context, commands);
        }
        &self.commands
    }

    /// Reports, once, the motors that have never answered.
    fn report_silence(&mut self) {
        let Self { groups, context, .. } = self;
        if self.silence_reported || context.uptime() < SILENT_START {
            return;
        }
        self.silence_reported = true;
        let motors = groups.iter().flat_map(|group| &group.motors);
        for motor in motors.filter(|motor| motor.has_never_answered()) {
            context.push(Event::Silent { motor: motor.joint });
        }
        self.imus.report_silence(&mut self.context);
    }

    /// Takes a reply of the motor of `joint` that arrived at `at`. Does not use an implausible
    /// state. Does not allocate; bounded by motors.
    pub fn receive(&mut self, joint: usize, reported: &Reported, at: Instant) {
        let GroupSlot { group, slot } = self.slots[joint];
        let consequence = self.groups[group].receive(slot, reported, at, &mut self.context);
        self.apply(joint, consequence);
    }

    /// As [`receive`](Self::receive), for a state that arrived at `at`, the time since its command,
    /// and the status in it.
    #[inline(always)]
    pub fn receive_state(
        &mut self,
        joint: usize,
        (state, latency, status): (Measured<JointSide>, Duration, Status),
        at: Instant,
    ) {
        let GroupSlot { group, slot } = self.slots[joint];
        let context = &mut self.context;
        let consequence = self.groups[group].receive_state(slot, state, (at, latency), status, context);
        if consequence != Consequence::None {
            self.apply(joint, consequence);
        }
    }

    /// Applies the consequence of a reply of the motor of `joint` to the robot. Bounded by motors.
    #[cold]
    fn apply(&mut self, joint: usize, consequence: Consequence) {
        match consequence {
            Consequence::None => {}
            Consequence::StopAll => self.stop_all(Cause::MotorFault, Some(joint)),
            Consequence::Indicator(number, value) => self.indicators.take(joint, number, value),
        }
    }

    /// Takes the reading of a sensor. Constant time.
    pub fn receive_reading(&mut self, reading: Reading<'_>) {
        match reading {
            Reading::Imu(imu, reading) => self.imus.receive(imu, reading, &mut self.context),
        }
    }

    /// Records that the bus did not accept the command of this joint in this cycle.
    pub fn unsent(&mut self, joint: usize) {
        if matches!(self.commands[joint], Command::SetZero | Command::ClearFault) {
            let GroupSlot { group, slot } = self.slots[joint];
            self.groups[group].motors[slot].resume_request();
        }
    }

    /// Records that the motor of `joint` does not answer the command of this cycle.
    pub fn expect_no_answer(&mut self, joint: usize) {
        let GroupSlot { group, slot } = self.slots[joint];
        self.groups[group].motors[slot].expect_no_answer();
    }

    /// Records that the motor of `joint` answered one question twice.
    pub fn receive_duplicate(&mut self, joint: usize) {
        let GroupSlot { group, slot } = self.slots[joint];
        self.groups[group].receive_duplicate(slot, &mut self.context);
    }

    /// Records `frames` with the command id of `joint` that arrived by `at` and are not from this
    /// program. Does not allocate; bounded by the motors of a group.
    pub fn receive_foreign(&mut self, joint: usize, id: FrameId, frames: ForeignFrames, at: Instant) {
        let GroupSlot { group, slot } = self.slots[joint];
        self.groups[group].receive_foreign(slot, (id, frames), at, &mut self.context);
    }

    /// Ends the cycle: no further reply of it is read. Bounded by motors.
    pub fn end_cycle(&mut self) {
        let Self { groups, context, .. } = self;
        groups.iter_mut().for_each(|group| group.end_cycle(context));
        self.stop_for_lost_motors();
    }

    /// Records that the states of this cycle are published and no longer new. Bounded by IMUs.
    pub fn published(&mut self) {
        self.context.publications += 1;
        self.imus.published();
    }

    /// Begins a cycle of the line `bus`. Returns whether it is the turn of the questions.
    pub fn begin_questions(&mut self, bus: usize) -> bool {
        let Self { buses, context, .. } = self;
        let turn = buses[bus].question_turn.as_mut();
        turn.is_some_and(|turn| turn.begin_cycle(context.now, context.period))
    }

    /// Returns the question that a motor of `bus` should be asked now, if any: for its faults or an
    /// indicator. Bounded by the motors of the bus; constant time in most cycles.
    #[inline]
    pub fn question(&mut self, bus: usize) -> Option<(usize, Command)> {
        // In most cycles no motor of the bus is due.
        let now = self.context.wake.begun;
        let is_due = now >= self.buses[bus].poll_at || self.indicators.are_due(now);
        if is_due { self.due_question(bus) } else { None }
    }

    #[cold]
    fn due_question(&mut self, bus: usize) -> Option<(usize, Command)> {
        // In turn, because a motor that does not answer is due for ever.
        let health = &mut self.buses[bus];
        health.prefers_indicator = !health.prefers_indicator;
        if health.prefers_indicator {
            return self.indicator_poll(bus).or_else(|| self.fault_question(bus));
        }
        self.fault_question(bus).or_else(|| self.indicator_poll(bus))
    }

    fn fault_question(&mut self, bus: usize) -> Option<(usize, Command)> {
        self.fault_poll(bus).map(|joint| (joint, Command::GetFault))
    }

    /// Returns the motor of `bus` to be asked for an indicator or its supply now, if any.
    fn indicator_poll(&mut self, bus: usize) -> Option<(usize, Command)> {
        let Self { groups, slots, indicators, context, .. } = self;
        let Wake { cycle, begun, .. } = context.wake;
        let may_be_polled = |joint: usize| {
            let GroupSlot { group, slot } = slots[joint];
            groups[group].motors[slot].may_be_polled(cycle)
        };
        indicators.next(bus, begun, may_be_polled)
    }

    /// Returns the joint of `bus` whose motor should be asked for its faults now, if any. Round
    /// robin; bounded by the motors of the bus.
    fn fault_poll(&mut self, bus: usize) -> Option<usize> {
        if !self.polls_faults() {
            return None;
        }
        let Wake { cycle, begun, .. } = self.context.wake;
        let health = &self.buses[bus];
        let count = health.joints.len();
        let is_due = |&turn: &usize| {
            let motor = self.motor(health.joints[turn]);
            motor.poll_at(cycle).is_some_and(|at| at <= begun)
        };
        let Some(turn) = (health.poll_next..count).chain(0..health.poll_next).find(is_due) else {
            self.buses[bus].poll_at = self.first_poll(bus);
            return None;
        };
        let joint = health.joints[turn];
        self.buses[bus].poll_next = (turn + 1) % count;
        Some(joint)
    }

    /// Returns a time before which no motor of `bus` is due to be asked for its faults: the time of
    /// a motor only rises. Bounded by the motors of the bus.
    fn first_poll(&self, bus: usize) -> Instant {
        let motors = self.buses[bus].joints.iter().map(|&joint| self.motor(joint));
        motors.filter_map(Motor::poll_after).min().unwrap_or(Instant::FAR_FUTURE)
    }

    /// Records the condition of a bus. Returns whether it has just become unable to receive frames.
    #[must_use]
    pub fn bus_changed(&mut self, bus: usize, condition: BusCondition) -> bool {
        let health = &mut self.buses[bus];
        if health.condition == condition {
            return false;
        }
        let before = health.reported();
        health.condition = condition;
        let condition = health.reported();
        if condition != before {
            self.context.push(Event::Bus { bus, condition });
        }
        !health.is_up()
    }

    /// Returns the condition of a bus for clients.
    #[must_use]
    #[inline]
    pub fn bus_condition(&self, bus: usize) -> BusCondition {
        self.buses[bus].reported()
    }

    /// Records frames that a bus lost until `now`.
    #[cold]
    pub fn frames_lost(&mut self, bus: usize, losses: Losses, now: Instant) {
        self.context.note_loss(bus, now);
        self.buses[bus].lost(losses);
    }

    /// Records whether a bus accepted all frames of this cycle. Reports the frames that it lost, at
    /// most once a second.
    pub fn bus_accepted(&mut self, bus: usize, all: bool) {
        let health = &mut self.buses[bus];
        health.record_acceptance(all);
        if health.has_losses()
            && let Some(losses) = health.due_losses(self.context.now)
        {
            self.context.push(Event::FramesLost { bus, losses });
        }
    }

    /// Damps and stops every group; none can be enabled afterwards.
    pub fn shut_down(&mut self) {
        self.shutting_down = true;
        self.stop_all(Cause::Shutdown, None);
    }

    /// Stops every motor without damping it first.
    pub fn stop_now(&mut self) {
        let Self { groups, context, .. } = self;
        let moving = groups.iter_mut().filter(|group| group.phase() != Phase::Disarmed);
        moving.for_each(|group| group.disarm(context));
    }

    /// Damps and stops every group, and latches the stop, for a request of process `pid`. Does not
    /// allocate; bounded by groups and motors.
    pub fn emergency_stop(&mut self, pid: u32) {
        let Self { groups, context, .. } = self;
        groups.iter_mut().for_each(|group| group.stop_for(Cause::EmergencyStop, pid, context));
    }

    /// Ends the ownership of `lease`, whose process exited. Bounded by motors.
    pub fn end_owner(&mut self, lease: Lease) {
        if let Some(group) = self.groups.get_mut(lease.group()) {
            group.end_owner(lease, &mut self.context);
        }
    }

    /// Stops every group for `cause`, and names the joint that caused it, if any. Bounded by
    /// motors.
    pub fn stop_all(&mut self, cause: Cause, joint: Option<usize>) {
        let Self { groups, context, .. } = self;
        groups.iter_mut().for_each(|group| group.stop(cause, joint, context));
    }

    /// Stops every group that is not disarmed.
    fn stop_moving(&mut self, cause: Cause) {
        let Self { groups, context, .. } = self;
        let moving = groups.iter_mut().filter(|group| group.phase() != Phase::Disarmed);
        moving.for_each(|group| group.stop(cause, None, context));
    }

    /// Returns the joints whose motors were started and have not confirmed a stop since.
    pub fn unstopped(&self) -> impl Iterator<Item = usize> {
        self.groups
            .iter()
            .flat_map(|group| &group.motors)
            .filter(|motor| motor.may_run())
            .map(|motor| motor.joint)
    }

    /// Returns whether every group is disarmed.
    #[must_use]
    pub fn is_disarmed(&self) -> bool {
        self.groups.iter().all(|group| group.phase() == Phase::Disarmed)
    }

    /// Returns the events since [`clear_events`](Self::clear_events).
    pub fn events(&self) -> impl Iterator<Item = Event> + '_ {
        self.context.events().iter()
    }

    /// Removes the events. Returns the number that did not fit.
    pub fn clear_events(&mut self) -> u32 {
        self.context.events_mut().clear()
    }

    /// Returns the next answer to a request that could not be answered immediately, with its
    /// ticket.
    pub fn next_answer(&mut self) -> Option<(u32, AdminReply)> {
        self.context.answers_mut().pop()
    }

    /// Returns the age of the oldest setpoint in use by an active group.
    #[must_use]
    pub fn setpoint_age(&self) -> Option<Duration> {
        let active = self.groups.iter().filter(|group| group.phase() == Phase::Active);
        active.filter_map(|group| group.setpoint_age(self.context.wake.begun)).max()
    }

    /// Writes the state of every joint after this cycle into `states`, by joint. Returns the number
    /// of joints.
    pub fn report_joints(&self, states: &mut [JointState]) -> usize {
        // By group: a joint would have to be looked up.
        for motor in self.groups.iter().flat_map(|group| &group.motors) {
            if let Some(state) = states.get_mut(motor.joint) {
                *state = motor.report(self.context.publications);
            }
        }
        self.slots.len().min(states.len())
    }

    /// Returns the indicators of the joints that have some, by joint.
    pub fn joint_indicators(&self) -> impl Iterator<Item = JointIndicators> + '_ {
        self.indicators.report(|joint| self.motor(joint).measured().is_some())
    }

    /// Returns the state of every IMU after this cycle, in the order of the configuration.
    pub fn imu_states(&self) -> impl Iterator<Item = ImuState> + '_ {
        self.imus.states()
    }

    /// Returns the state of every group after this cycle, by group.
    pub fn group_states(&self) -> impl Iterator<Item = GroupState> + '_ {
        self.groups.iter().map(|group| group.report(self.context.wake.begun))
    }

    /// Returns whether an emergency stop is latched.
    #[must_use]
    pub fn is_emergency_stopped(&self) -> bool {
        self.groups.iter().any(|group| group.cause() == Some(Cause::EmergencyStop))
    }

    /// Returns whether [`shut_down`](Self::shut_down) was called.
    #[must_use]
    pub const fn is_shutting_down(&self) -> bool {
        self.shutting_down
    }

    fn motor(&self, joint: usize) -> &Motor {
        let GroupSlot { group, slot } = self.slots[joint];
        &self.groups[group].motors[slot]
    }
}

/// By joint.
fn turns(settings: &Settings) -> Vec<Turn> {
    let mut counts = vec![0; settings.buses.len()];
    let turn = |bus: usize| {
        let (index, settings_of) = (counts[bus], &settings.buses[bus]);
        counts[bus] += 1;
        if settings_of.is_line() || settings_of.has_turns() {
            return Turn::once_in(settings_of.every, settings.first_turn(bus, index));
        }
        Turn::EACH_CYCLE
    };
    settings.motors.iter().map(|motor| motor.bus).map(turn).collect()
}

/// The turn of a line for questions.
fn question_turn(settings: &Settings, bus: usize) -> Option<Turn> {
    let motors = settings.motors.iter().filter(|motor| motor.bus == bus).count();
    let has_turn = settings.turns(bus) > motors;
    has_turn.then(|| Turn::once_in(settings.buses[bus].every, settings.first_turn(bus, motors)))
}

fn slots(settings: &Settings) -> Vec<GroupSlot> {
    let mut slots = vec![None; settings.motors.len()];
    for (group, members) in settings.groups.iter().enumerate() {
        for (slot, &joint) in members.motors.iter().enumerate() {
            let other = slots[joint].replace(GroupSlot { group, slot });
            assert!(other.is_none(), "{:?} is in more than one group", settings.motors[joint].name);
        }
    }
    for (motor, slot) in settings.motors.iter().zip(&slots) {
        assert!(slot.is_some(), "{:?} is in no group", motor.name);
    }
    slots.into_iter().flatten().collect()
}
