//! The transitions between the phases of a group. The module [`group`](super) has the diagram.

use super::{Group, Latched};
use crate::control::Event;
use crate::control::context::Context;
use crate::control::motor::Motor;
use motord_bus::{Duration, Instant};
use motord_settings::settings::SafeStop;
use motord_shared::{Cause, MotorMode, Phase};

/// A damped group is at rest when every joint has been slow for this long.
const REST_TIME: Duration = Duration::from_millis(50);

impl Group {
    pub(super) fn advance(&mut self, cx: &mut Context) {
        match self.phase {
            Phase::Starting => self.advance_start(cx),
            Phase::Damping => self.advance_damping(cx),
            Phase::Disarmed | Phase::Active => {}
        }
    }

    fn advance_start(&mut self, cx: &mut Context) {
        let failed = match self.motors.iter().find(|motor| !motor.is_ready()) {
            None => match self.first_jump(cx) {
                None => return self.activate(cx),
                Some(motor) => Some(motor.joint),
            },
            Some(motor) => {
                let late = cx.now.since(self.since) > cx.safety.start_timeout;
                // A fault may stop its joint only, but then this joint cannot start.
                (late || motor.mode() != MotorMode::Starting).then_some(motor.joint)
            }
        };
        if let Some(joint) = failed {
            self.stop(Cause::StartFailed, Some(joint), cx);
        }
    }

    /// Begins to start every motor. None of them is in fault.
    pub(crate) fn start(&mut self, cx: &mut Context) {
        self.over_voltage = false;
        self.each_motor(cx, Motor::begin_start);
        self.enter(Phase::Starting, cx);
    }

    fn activate(&mut self, cx: &mut Context) {
        self.each_motor(cx, Motor::activate);
        self.enter(Phase::Active, cx);
    }

    fn advance_damping(&mut self, cx: &mut Context) {
        self.let_go(cx.now, false);
        if self.held_until.is_some() {
            return;
        }
        let slow =
            |motor: &Motor| motor.mode() != MotorMode::Damping || motor.is_at_rest(cx.safety.rest_velocity);
        let resting = self.motors.iter().all(slow);
        self.resting_since = if resting { self.resting_since.or(Some(cx.now)) } else { None };
        let rested = self.resting_since.is_some_and(|since| cx.now.since(since) >= REST_TIME);
        if rested || cx.now.since(self.since) >= cx.safety.damp {
            self.disarm(cx);
        }
    }

    /// Stops every motor without damping it first.
    pub(crate) fn disarm(&mut self, cx: &mut Context) {
        self.each_motor(cx, Motor::rest);
        self.enter(Phase::Disarmed, cx);
    }

    /// Latches `cause`, and stops following setpoints. A disarmed group latches only a shutdown and
    /// a lost directory. An excluded motor causes no stop.
    pub(crate) fn stop(&mut self, cause: Cause, joint: Option<usize>, cx: &mut Context) {
        if !self.motors.iter().any(|motor| motor.is_excluded() && Some(motor.joint) == joint) {
            self.stop_as(Latched { cause, joint, pid: None }, cx);
        }
    }

    /// As [`stop`](Self::stop), for a request of process `pid`. A request latches also in a
    /// disarmed group.
    pub(crate) fn stop_for(&mut self, cause: Cause, pid: u32, cx: &mut Context) {
        self.stop_as(Latched { cause, joint: None, pid: Some(pid) }, cx);
    }

    fn stop_as(&mut self, latched: Latched, cx: &mut Context) {
        let Latched { cause, joint, pid } = latched;
        let moving = self.phase != Phase::Disarmed;
        let latches = moving || pid.is_some() || matches!(cause, Cause::Shutdown | Cause::DirectoryLost);
        if latches && self.latch(latched) {
            cx.push(Event::Stopped { group: self.index, cause, motor: joint, pid });
        }
        if moving {
            self.begin_damping(may_hold(cause), cx);
        }
    }

    /// Latches the first cause: later ones are consequences. An emergency stop replaces any other
    /// cause.
    fn latch(&mut self, latched: Latched) -> bool {
        let emergency = latched.cause == Cause::EmergencyStop && self.cause() != Some(Cause::EmergencyStop);
        let latches = self.cause.is_none() || emergency;
        if latches {
            self.cause = Some(latched);
        }
        latches
    }

    /// Begins the safe stop of a group that is starting or active: stops its motors immediately,
    /// damps them, or first holds them if the cause `may_hold`. A later cause that may not hold
    /// ends a hold.
    pub(crate) fn begin_damping(&mut self, may_hold: bool, cx: &mut Context) {
        if !matches!(self.phase, Phase::Starting | Phase::Active) {
            return self.let_go(cx.now, !may_hold);
        }
        self.each_motor(cx, Motor::begin_damping);
        match self.safe_stop {
            SafeStop::Stop => self.disarm(cx),
            SafeStop::Hold if may_hold => {
                self.enter(Phase::Damping, cx);
                self.held_until = Some(cx.now + cx.safety.damp);
            }
            SafeStop::Damp | SafeStop::Hold => self.enter(Phase::Damping, cx),
        }
    }

    /// Ends a hold when its time is over, or immediately. The group is damped from `now` on.
    fn let_go(&mut self, now: Instant, at_once: bool) {
        if self.held_until.take_if(|until| at_once || *until <= now).is_some() {
            self.begin(Phase::Damping, now);
        }
    }

    fn enter(&mut self, phase: Phase, cx: &mut Context) {
        self.begin(phase, cx.now);
        cx.push(Event::Group { group: self.index, phase });
    }

    /// No way of setpoints outlives the phase in which it began: none begins but in `Active`.
    const fn begin(&mut self, phase: Phase, now: Instant) {
        self.setpoints.end_interpolation();
        self.phase = phase;
        self.since = now;
        self.resting_since = None;
        self.held_until = None;
    }

    fn each_motor(&mut self, cx: &mut Context, change: impl Fn(&mut Motor)) {
        for motor in &mut self.motors {
            change(motor);
            motor.changed(cx);
        }
    }
}

/// Returns whether a group may hold: only its owner failed, so the reports of its motors are
/// usable.
fn may_hold(cause: Cause) -> bool {
    matches!(cause, Cause::SetpointTimeout | Cause::OwnerLost | Cause::OwnerDied | Cause::Disabled)
}
