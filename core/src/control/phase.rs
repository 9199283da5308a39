//! Moves groups from phase to phase; the drawing is above [`Group`](super::group::Group).

use super::{Control, Event};
use crate::settings::SafeStop;
use motord_bus::Duration;
use motord_shared::{Cause, MotorMode, Phase};

/// A damped group is at rest when every joint has been slow for this long.
const REST_TIME: Duration = Duration::from_millis(50);

impl Control {
    pub(super) fn advance(&mut self, group: usize) {
        match self.groups[group].phase() {
            Phase::Starting => self.advance_start(group),
            Phase::Damping => self.advance_damping(group),
            Phase::Disarmed | Phase::Active => {}
        }
    }

    pub(super) fn advance_start(&mut self, index: usize) {
        let group = &self.groups[index];
        let unready = group.motors.iter().copied().find(|&motor| !self.motors[motor].is_ready());
        match unready {
            None => match self.first_jump(index) {
                None => self.activate(index),
                Some(motor) => self.stop(index, Cause::StartFailed, Some(motor)),
            },
            Some(motor) => {
                let late = self.tick.begun.since(group.since()) > self.safety.start_timeout;
                // A fault may be its joint's matter only, but then this joint does not start any more.
                if late || self.motors[motor].mode() != MotorMode::Starting {
                    self.stop(index, Cause::StartFailed, Some(motor));
                }
            }
        }
    }

    pub(super) fn activate(&mut self, index: usize) {
        for place in 0..self.groups[index].motors.len() {
            let motor = self.groups[index].motors[place];
            self.motors[motor].activate();
            self.motor_changed(motor);
        }
        self.enter(index, Phase::Active);
    }

    pub(super) fn advance_damping(&mut self, index: usize) {
        let now = self.tick.begun;
        let Self { groups, motors, safety, .. } = self;
        let group = &mut groups[index];
        group.let_go(now, false);
        if group.is_held() {
            return;
        }
        let slow = |motor: &usize| {
            let motor = &motors[*motor];
            motor.mode() != MotorMode::Damping || motor.is_at_rest(safety.rest_velocity)
        };
        let resting = group.motors.iter().all(slow);
        group.resting_since = if resting { group.resting_since.or(Some(now)) } else { None };
        let rested = group.resting_since.is_some_and(|since| now.since(since) >= REST_TIME);
        if rested || now.since(group.since()) >= safety.damp {
            self.disarm(index);
        }
    }

    pub(super) fn disarm(&mut self, index: usize) {
        for place in 0..self.groups[index].motors.len() {
            let motor = self.groups[index].motors[place];
            self.motors[motor].rest();
            self.motor_changed(motor);
        }
        self.enter(index, Phase::Disarmed);
    }

    /// Stops every group that is not stopped.
    pub(super) fn stop_moving(&mut self, cause: Cause) {
        for group in 0..self.groups.len() {
            if self.groups[group].phase() != Phase::Disarmed {
                self.stop(group, cause, None);
            }
        }
    }

    /// Latches `cause` and leaves setpoints behind in this very cycle. Silence of a stopped group's motor is no cause.
    pub(super) fn stop(&mut self, index: usize, cause: Cause, motor: Option<usize>) {
        let moving = self.groups[index].phase() != Phase::Disarmed;
        let latches = moving || matches!(cause, Cause::EmergencyStop | Cause::Shutdown);
        if latches && self.groups[index].latch(cause, motor) {
            self.events.push(Event::Stopped { group: index, cause, motor });
        }
        if moving {
            self.begin_damping(index, may_hold(cause));
        }
    }

    /// Damps the group if it is not damped or stopped yet, after holding it where that is its way to stop and the reason
    /// allows it. A later reason that does not allow it ends the holding.
    pub(super) fn begin_damping(&mut self, index: usize, may_hold: bool) {
        let group = &mut self.groups[index];
        if !matches!(group.phase(), Phase::Starting | Phase::Active) {
            group.let_go(self.now, !may_hold);
            return;
        }
        for place in 0..self.groups[index].motors.len() {
            let motor = self.groups[index].motors[place];
            self.motors[motor].begin_damping();
            self.motor_changed(motor);
        }
        match self.groups[index].safe_stop {
            SafeStop::Stop => self.disarm(index),
            SafeStop::Hold if may_hold => {
                self.enter(index, Phase::Damping);
                self.groups[index].hold(self.now, self.safety.damp);
            }
            SafeStop::Damp | SafeStop::Hold => self.enter(index, Phase::Damping),
        }
    }

    pub(super) fn enter(&mut self, index: usize, phase: Phase) {
        self.groups[index].enter(phase, self.now);
        self.events.push(Event::Group { group: index, phase });
    }

    pub(super) fn disown(&mut self, index: usize) {
        if self.groups[index].forget_owner().is_some() {
            self.events.push(Event::Owner { group: index, pid: None });
        }
    }

    pub(super) fn motor_changed(&mut self, motor: usize) {
        self.events.push(Event::Motor { motor, mode: self.motors[motor].mode() });
    }
}

/// A robot is only held still while everything but its owner is well: what its motors tell is true, and on time.
fn may_hold(cause: Cause) -> bool {
    matches!(cause, Cause::SetpointTimeout | Cause::OwnerLost)
}
