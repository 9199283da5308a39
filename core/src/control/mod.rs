//! What each motor is told in each cycle: pure decisions on (state, inputs, now). No clock, no I/O, no allocation
//! after [`Control::new`], and no way to fail: what is wrong becomes a state, a counter or an event.
//!
//! One cycle: [`request`](Control::request) and [`offer`](Control::offer) bring what clients want,
//! [`decide`](Control::decide) makes one command per motor of it, [`heard`](Control::heard) takes what the motors
//! answer, [`end_cycle`](Control::end_cycle) draws the consequences of silence, and [`report`](Control::report) tells
//! it all.

mod admin;
mod command;
mod errand;
mod event;
mod group;
mod heat;
mod limit;
mod motor;
mod phase;
mod plausibility;
mod watch;

pub use event::{Event, Events};
pub use limit::{Circumstances, Limited, limit};

use crate::joint::{Impedance, Joint, Measured};
use crate::settings::{MotorSettings, SafetySettings, Settings};
use admin::Answers;
use group::Group;
use motor::Motor;
use motord_bus::{Duration, Instant};
use motord_protocol::FaultBits;
use motord_shared::{
    AdminReply, BusCondition, Cause, Lease, Phase, SetpointMessage, SetpointMode, StateMessage, message,
};

/// A bus that refused frames in this many cycles in a row is stalled.
const STALL_CYCLES: u32 = 3;

/// What one motor is told in a cycle, joint side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Nothing: it is offline, and it is not time to probe it.
    Nothing,
    /// Stop; an MIT motor also tells its state.
    Stop,
    /// Start.
    Start,
    /// No stiffness, no damping, no torque.
    Neutral,
    /// Make the present position zero.
    SetZero,
    /// Tell the fault bits.
    GetFault,
    /// Acknowledge the fault.
    ClearFault,
    /// Follow this.
    Control(Impedance<Joint>, SetpointMode),
}

impl Command {
    /// The motor's state is the answer.
    #[must_use]
    pub const fn is_answered_by_state(&self) -> bool {
        !matches!(self, Self::Nothing | Self::GetFault | Self::ClearFault)
    }
}

/// What one motor answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Heard {
    /// Its state, and how long after the command it came.
    State(Measured<Joint>, Duration),
    /// Its fault bits.
    Fault(FaultBits),
    /// That it heard the request to clear its fault.
    Cleared,
    /// That it heard, and nothing more.
    Alive,
    /// That it stopped.
    Stopped,
    /// That it refuses: it may have a fault.
    Refused,
    /// An answer to a question of an earlier cycle, by now meaningless.
    Late,
}

/// How a cycle began: its tick, and how much later it woke up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Wake {
    /// Its number, from 1.
    pub cycle: u64,
    /// When the cycle should begin.
    pub scheduled: Instant,
    /// When it began.
    pub begun: Instant,
    /// Ticks missed just before it.
    pub missed_ticks: u64,
    /// How long the computer was suspended, since it was started.
    pub suspended: Duration,
}

/// What a bus is able to do, as far as safety cares.
#[derive(Debug, Clone, Copy)]
struct BusHealth {
    condition: BusCondition,
    stalled: u32,
}

impl BusHealth {
    fn cause(&self) -> Option<Cause> {
        match self.condition {
            BusCondition::Off => Some(Cause::BusOff),
            BusCondition::Down | BusCondition::Gone => Some(Cause::BusGone),
            _ if self.stalled >= STALL_CYCLES => Some(Cause::TransmitStall),
            _ => None,
        }
    }
}

/// The state of every motor and group, and the rules they follow.
#[derive(Debug)]
pub struct Control {
    safety: SafetySettings,
    period: Duration,
    max_lateness: Duration,
    max_missed_ticks: f32,
    settings: Vec<MotorSettings>,
    group_of: Vec<usize>,
    motors: Vec<Motor>,
    groups: Vec<Group>,
    buses: Vec<BusHealth>,
    commands: Vec<Command>,
    poll_next: Vec<usize>,
    boot_id: u64,
    epoch: u32,
    tick: Wake,
    /// The time of the call that is running.
    now: Instant,
    elapsed: f32,
    /// How long the computer was suspended before this cycle. A reading may be less, by a delay, and never more.
    suspended: Duration,
    /// The part of the ticks that were missed of late, 0 to 1.
    missed_ticks: f32,
    events: Events,
    answers: Answers,
    started: Option<Instant>,
    told_silent: bool,
    shutting_down: bool,
}

impl Control {
    /// Everything stopped, nothing owned. Allocates; nothing after it does. `boot_id` makes the leases of this daemon
    /// different from those of the one before.
    #[must_use]
    pub fn new(settings: &Settings, boot_id: u64) -> Self {
        let motors = settings.motors.len();
        let mut group_of = vec![0; motors];
        for (index, group) in settings.groups.iter().enumerate() {
            group.motors.iter().for_each(|&motor| group_of[motor] = index);
        }
        let health = BusHealth { condition: BusCondition::Active, stalled: 0 };
        Self {
            safety: settings.safety.clone(),
            period: settings.cycle.period,
            max_lateness: settings.cycle.max_lateness,
            max_missed_ticks: settings.cycle.max_missed_ticks,
            settings: settings.motors.clone(),
            group_of,
            motors: settings.motors.iter().map(Motor::new).collect(),
            groups: settings.groups.iter().map(Group::new).collect(),
            buses: vec![health; settings.buses.len()],
            commands: vec![Command::Nothing; motors],
            poll_next: vec![0; settings.buses.len()],
            boot_id,
            epoch: 0,
            tick: Wake::default(),
            now: Instant::ZERO,
            elapsed: 0.0,
            suspended: Duration::ZERO,
            missed_ticks: 0.0,
            events: Events::new(),
            answers: Answers::new(),
            started: None,
            told_silent: false,
            shutting_down: false,
        }
    }

    /// Offers a setpoint message. What is wrong with it is counted by its reason; nothing of it is used then.
    pub fn offer(&mut self, message: &SetpointMessage, now: Instant) {
        let Self { groups, settings, safety, .. } = self;
        let lease = Lease::from_raw(message.lease);
        let Some(group) = lease.and_then(|lease| groups.get_mut(lease.group())) else { return };
        let _counted = group.offer(message, now, safety.setpoint_timeout, |motor, mode| {
            settings[motor].capabilities.takes(mode)
        });
    }

    /// Begins a cycle: draws the consequences of time, and makes one command per motor. Bounded by motors and groups.
    pub fn decide(&mut self, wake: Wake) -> &[Command] {
        let elapsed = wake.begun.since(self.tick.begun);
        self.elapsed = elapsed.min(2 * self.period).as_secs_f32();
        self.tick = wake;
        self.now = wake.begun;
        self.watch_time(elapsed);
        self.watch_silence();
        self.watch_heat(elapsed);
        for group in 0..self.groups.len() {
            self.watch_buses(group);
            self.watch_owner(group);
            self.advance(group);
        }
        for motor in 0..self.motors.len() {
            let command = self.command(motor);
            self.motors[motor].asked(&command);
            self.commands[motor] = command;
        }
        self.watch_errands();
        &self.commands
    }

    /// A motor answered at `at`. Tells whether that can be true; if not, it is not used.
    pub fn heard(&mut self, motor: usize, heard: Heard, at: Instant) -> bool {
        match heard {
            Heard::State(measured, latency) => return self.heard_state(motor, measured, at, latency),
            Heard::Fault(bits) => self.heard_fault(motor, bits, at),
            Heard::Cleared | Heard::Alive => self.motors[motor].told_alive(),
            Heard::Stopped => self.motors[motor].told_stopped(),
            Heard::Refused => self.motors[motor].told_refusal(),
            Heard::Late => self.motors[motor].told_late(),
        }
        true
    }

    /// The bus did not take a motor's command of this cycle.
    pub fn unsent(&mut self, motor: usize) {
        if matches!(self.commands[motor], Command::SetZero | Command::ClearFault) {
            self.motors[motor].resume_errand();
        }
    }

    /// A motor answered one question twice.
    pub fn heard_twice(&mut self, motor: usize) {
        if self.motors[motor].told_twice() {
            self.stop(self.group_of[motor], Cause::DuplicateId, Some(motor));
        }
    }

    /// Every answer that can come in this cycle has come.
    pub fn end_cycle(&mut self) {
        for motor in 0..self.motors.len() {
            if self.motors[motor].end_cycle(self.tick.cycle, self.safety.lost_cycles) {
                self.motor_changed(motor);
                self.stop(self.group_of[motor], Cause::MotorLost, Some(motor));
            }
        }
    }

    /// The motor of `bus` that should be asked for its faults now, if one should. Round robin.
    pub fn fault_poll(&mut self, bus: usize) -> Option<usize> {
        let count = self.motors.len();
        if self.safety.fault_poll_hz <= 0.0 {
            return None;
        }
        let due = |motor: &usize| {
            self.settings[*motor].bus == bus
                && self.motors[*motor].errand.is_none()
                && self.motors[*motor].poll_at(self.tick.cycle).is_some_and(|at| at <= self.tick.begun)
        };
        let first = self.poll_next[bus];
        let motor = (first..count).chain(0..first).find(due)?;
        self.poll_next[bus] = (motor + 1) % count;
        Some(motor)
    }

    /// What a bus can do now.
    pub fn bus_changed(&mut self, bus: usize, condition: BusCondition) {
        if self.buses[bus].condition != condition {
            self.buses[bus].condition = condition;
            self.events.push(Event::Bus { bus, condition });
        }
    }

    /// Whether a bus took the frames of this cycle.
    pub fn bus_took(&mut self, bus: usize, all: bool) {
        let stalled = &mut self.buses[bus].stalled;
        *stalled = if all { 0 } else { stalled.saturating_add(1) };
    }

    /// Damps and stops everything, for good.
    pub fn shut_down(&mut self) {
        self.shutting_down = true;
        (0..self.groups.len()).for_each(|group| self.stop(group, Cause::Shutdown, None));
    }

    /// Stops every motor without damping it first.
    pub fn stop_now(&mut self) {
        for group in 0..self.groups.len() {
            if self.groups[group].phase() != Phase::Disarmed {
                self.disarm(group);
            }
        }
    }

    /// The motors that were started and have not answered a stop since.
    pub fn unstopped(&self) -> impl Iterator<Item = usize> {
        self.motors.iter().enumerate().filter(|(_, motor)| motor.may_run()).map(|(index, _)| index)
    }

    /// Every group is stopped.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.groups.iter().all(|group| group.phase() == Phase::Disarmed)
    }

    /// What happened since [`clear_events`](Self::clear_events).
    pub fn events(&self) -> impl Iterator<Item = Event> + '_ {
        self.events.iter()
    }

    /// Forgets the events; tells how many did not fit.
    pub fn clear_events(&mut self) -> u32 {
        self.events.clear()
    }

    /// The next answer to a request that could not be answered at once, with its ticket.
    pub fn next_answer(&mut self) -> Option<(u32, AdminReply)> {
        self.answers.pop()
    }

    /// The oldest setpoint in use by an active group, for measuring.
    #[must_use]
    pub fn setpoint_age(&self) -> Option<Duration> {
        let active = self.groups.iter().filter(|group| group.phase() == Phase::Active);
        active.filter_map(|group| group.setpoint_age(self.tick.begun)).max()
    }

    /// Cycles without a reply, over all motors.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.motors.iter().map(|motor| u64::from(motor.missed())).sum()
    }

    /// Time from command to reply of every motor that answered in this cycle, ns; 0 for the others.
    pub fn reply_latencies(&self) -> impl Iterator<Item = u32> + '_ {
        self.motors.iter().map(Motor::reply_latency_ns)
    }

    /// Writes joints, groups and flags of this cycle into `state`; the rest is the cycle's to write.
    pub fn report(&self, state: &mut StateMessage) {
        let stopped = self.groups.iter().any(|group| group.cause() == Some(Cause::EmergencyStop));
        state.flags = if stopped { message::FLAG_EMERGENCY_STOP } else { 0 };
        state.flags |= if self.shutting_down { message::FLAG_SHUTDOWN } else { 0 };
        state.joint_count = self.motors.len() as u32;
        state.group_count = self.groups.len() as u32;
        state.joints.iter_mut().zip(&self.motors).for_each(|(joint, motor)| *joint = motor.report());
        state
            .groups
            .iter_mut()
            .zip(&self.groups)
            .for_each(|(told, group)| *told = group.report(self.tick.begun));
    }
}
