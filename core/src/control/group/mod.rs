//! One group of joints: its owner, its motors, its setpoints, and whether it may move.
//!
//! ```text
//!                 enable: owner, fresh setpoint, fresh states,
//!                 no fault, no latched cause, no jump              every motor ready
//!   Disarmed ──────────────────────────────────────────▶ Starting ──────────────────▶ Active
//!       ▲                                                    │                           │
//!       │ every joint at rest, or damped long enough         │ disable, release,         │
//!       └───────────────────────── Damping ◀─────────────────┴─── or a cause, latched ───┘
//! ```
//!
//! Only a reset clears a latched cause; an emergency stop replaces it.

mod offer;
mod phase;
mod setpoints;
mod supply;
mod watch;

pub(super) use watch::Consequence;

use super::Event;
use super::bus_health::BusHealth;
use super::context::Context;
use super::motor::{GroupCommand, Motor, Turn};
use super::requester::{Requester, Right};
use motord_bus::{Duration, Instant};
use motord_protocol::drive::Command;
use motord_settings::settings::{GroupSettings, MotorSettings, SafeStop};
use motord_shared::{Cause, GroupState, Lease, Phase, Rejection};
use setpoints::Setpoints;
use supply::SupplyWatch;

/// One group.
#[derive(Debug)]
pub(super) struct Group {
    /// Its index.
    pub(super) index: usize,
    /// Its motors, in the order of the configuration.
    pub(super) motors: Vec<Motor>,
    /// Some of its motors take turns.
    has_turns: bool,
    safe_stop: SafeStop,
    phase: Phase,
    /// When the phase began. Damping begins again when a hold ends.
    since: Instant,
    /// Begin of the time in which every joint has been at rest while damping.
    resting_since: Option<Instant>,
    /// The current stop holds until this time, and then damps.
    held_until: Option<Instant>,
    /// A motor reported over-voltage: braking feeds the supply, so the group is damped less.
    over_voltage: bool,
    supply: SupplyWatch,
    cause: Option<Latched>,
    owner: Option<Owner>,
    setpoints: Setpoints,
    accepted: u32,
    late: u32,
    rejected: [u32; Rejection::COUNT],
}

/// The cause of a stop, and the joint or the requesting process that it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Latched {
    cause: Cause,
    joint: Option<usize>,
    pid: Option<u32>,
}

/// The owner of a group.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Owner {
    pub(super) lease: Lease,
    pub(super) pid: u32,
    /// Time of its last valid message or request.
    last_seen: Instant,
    /// The last sequence number accepted.
    sequence: u64,
}

impl Group {
    pub(super) fn new(
        index: usize,
        settings: &GroupSettings,
        motors: &[MotorSettings],
        turns: &[Turn],
    ) -> Self {
        let motor = |&joint: &usize| Motor::new(joint, &motors[joint], turns[joint]);
        Self {
            index,
            motors: settings.motors.iter().map(motor).collect(),
            has_turns: settings.motors.iter().any(|&joint| turns[joint].outlasts_cycle),
            safe_stop: settings.safe_stop,
            phase: Phase::Disarmed,
            since: Instant::ZERO,
            resting_since: None,
            held_until: None,
            over_voltage: false,
            supply: SupplyWatch::new(settings.supply),
            cause: None,
            owner: None,
            setpoints: Setpoints::new(settings.motors.len()),
            accepted: 0,
            late: 0,
            rejected: [0; Rejection::COUNT],
        }
    }

    /// Handles timeouts, and writes the command of each joint into `commands`. Does not allocate;
    /// bounded by its motors.
    pub(super) fn decide(
        &mut self,
        elapsed: Duration,
        buses: &[BusHealth],
        cx: &mut Context,
        commands: &mut [Command],
    ) {
        self.watch_heat(elapsed, cx);
        self.watch_buses(buses, cx);
        self.watch_owner(cx);
        self.advance(cx);
        let ramp = cx.now.since(self.since).as_secs_f32() / cx.safety.start_ramp.as_secs_f32();
        let Self { motors, setpoints, held_until, over_voltage, .. } = self;
        setpoints.begin_use(cx.wake.cycle);
        let share = setpoints.share(cx.now);
        for (slot, motor) in motors.iter_mut().enumerate() {
            let wanted = setpoints.get(slot, share);
            let group_command =
                GroupCommand { wanted, ramp, held: held_until.is_some(), over_voltage: *over_voltage };
            commands[motor.joint] = motor.command(&group_command, cx);
            motor.watch_request(cx);
        }
    }

    pub(super) const fn phase(&self) -> Phase {
        self.phase
    }

    pub(super) fn cause(&self) -> Option<Cause> {
        self.cause.map(|latched| latched.cause)
    }

    /// Returns whether its supply permits a start.
    pub(super) fn has_supply(&self, now: Instant) -> bool {
        self.supply.permits_start(&self.motors, now)
    }

    pub(super) const fn owner(&self) -> Option<&Owner> {
        self.owner.as_ref()
    }

    pub(super) fn is_owned_by(&self, lease: Lease) -> bool {
        self.owner.is_some_and(|owner| owner.lease == lease)
    }

    /// Returns whether the right is that of an operator or of the owner of the group.
    pub(super) fn obeys(&self, right: Right) -> bool {
        match right {
            Right::Operator => true,
            Right::Owner(lease) => self.is_owned_by(lease),
            Right::Invalid => false,
        }
    }

    /// Returns whether the process that owns the group sends the request.
    pub(super) fn is_asked_by_owner(&self, requester: &Requester) -> bool {
        self.owner.is_some_and(|owner| requester.lease() == Some(owner.lease) || owner.pid == requester.pid)
    }

    pub(super) fn own(&mut self, lease: Lease, pid: u32, cx: &mut Context) {
        self.owner = Some(Owner { lease, pid, last_seen: cx.now, sequence: 0 });
        cx.push(Event::Owner { group: self.index, pid: Some(pid) });
    }

    /// Records a sign of life of the owner, if it holds `lease`.
    pub(super) fn refresh_owner(&mut self, lease: Lease, now: Instant) {
        if let Some(owner) = self.owner.as_mut().filter(|owner| owner.lease == lease) {
            owner.last_seen = now;
        }
    }

    /// Removes the owner and its setpoints.
    pub(super) fn disown(&mut self, cx: &mut Context) {
        self.setpoints.forget();
        if self.owner.take().is_some() {
            cx.push(Event::Owner { group: self.index, pid: None });
        }
    }

    /// Excludes or includes the motor at `slot`. Removes the setpoints: they were checked for the
    /// previous case.
    pub(super) fn exclude(&mut self, slot: usize, excluded: bool, cx: &mut Context) {
        self.motors[slot].exclude(excluded, cx);
        self.setpoints.forget();
    }

    /// Clears the latched cause, if any.
    pub(super) fn reset(&mut self, cx: &mut Context) {
        if self.cause.take().is_some() {
            cx.push(Event::Reset { group: self.index });
        }
    }

    /// Returns the age of the setpoints in use; `None` when there are none.
    pub(super) fn setpoint_age(&self, now: Instant) -> Option<Duration> {
        self.setpoints.age(now)
    }

    /// Returns the mean interval between the messages of the owner. After a `setpoint-timeout`,
    /// returns that of the stopped owner.
    fn setpoint_period(&self) -> Option<Duration> {
        match self.cause() {
            Some(Cause::SetpointTimeout) => self.setpoints.at_stop.map(|(period, _)| period),
            _ => self.setpoints.period(),
        }
    }

    /// Returns the horizon of the setpoints in use; after `setpoint-timeout`, of the last ones.
    fn setpoint_horizon(&self) -> Duration {
        match self.cause() {
            Some(Cause::SetpointTimeout) => self.setpoints.at_stop.map_or(Duration::ZERO, |(_, last)| last),
            _ => self.setpoints.horizon,
        }
    }

    /// Returns whether the end of the horizon of the setpoints in use is not longer ago than the
    /// limit.
    pub(super) fn has_fresh_setpoints(&self, cx: &Context) -> bool {
        self.setpoints.age_after_horizon(cx.now).is_some_and(|age| age <= cx.safety.setpoint_timeout)
    }

    /// Returns the first motor that would jump if it followed its setpoint from this cycle on.
    pub(super) fn first_jump(&self, cx: &Context) -> Option<&Motor> {
        let share = self.setpoints.share(cx.now);
        let mut included = self.motors.iter().enumerate().filter(|(_, motor)| !motor.is_excluded());
        included.find_map(|(slot, motor)| {
            let wanted = self.setpoints.get(slot, share)?;
            let position = motor.measured()?.position;
            let [low, high] = motor.settings.limits.position;
            // The target is the applied position, not the wanted one: a joint outside its limits
            // would be pulled back into them.
            let target = wanted.values.position.clamp(low, high);
            (wanted.pulls() && (target - position).abs() > cx.safety.start_jump).then_some(motor)
        })
    }

    pub(super) fn report(&self, now: Instant) -> GroupState {
        GroupState {
            lease: self.owner.map_or(0, |owner| owner.lease.raw()),
            sequence: self.owner.map_or(0, |owner| owner.sequence),
            setpoint_age_ns: self.setpoint_age(now).map_or(0, motord_bus::time::nanos),
            setpoint_period_ns: self.setpoint_period().map_or(0, motord_bus::time::nanos),
            phase: self.phase.code(),
            cause: self.cause().map_or(0, Cause::code),
            cause_joint: self.cause.and_then(|latched| latched.joint).map_or(u32::MAX, |joint| joint as u32),
            cause_pid: self.cause.and_then(|latched| latched.pid).unwrap_or(0),
            answered_cycle: self.setpoints.answered,
            used_cycle: self.setpoints.used,
            accepted: self.accepted,
            late: self.late,
            // A message cannot have a longer one.
            setpoint_horizon_ns: self.setpoint_horizon().as_nanos() as u32,
            rejected: self.rejected,
        }
    }
}
