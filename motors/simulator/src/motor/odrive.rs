//! ODrive's CANSimple of firmware 0.6, from the drive's side: the manual "CAN protocol", and the messages
//! and numbers in ODrive's repository ros_odrive.
//!
//! An id is the node in the upper six bits and the command in the lower five. Values have the low byte
//! first, and are those of the rotor. The drive answers no command. It sends its reports by itself. What
//! the sources leave open, the drive does as follows:
//!
//! - It stores the inputs of each control mode separately, also while idle. It enters the closed loop with
//!   the inputs that it stored last, in torque mode too. Without an input it holds the present position,
//!   or exerts no torque. If it does not remember control, it forgets the inputs before it enters.
//! - An input of another control mode than the present one has no effect until that mode is set.
//! - It begins in the control mode of positions. Its only input mode is passthrough. With another input
//!   mode, and with voltages, it exerts no torque.
//! - A fault disarms it, also while idle, until the errors are cleared. Then it is idle.
//! - As a procedure's result it reports busy in the closed loop, as firmware 0.6.11 does, and disarmed in
//!   fault.
//! - A new position applies to the stored inputs, which keep their numbers. It lasts until the power is
//!   lost, unless the drive stores it, and only within half a turn of the output.
//! - Bytes that a command leaves out are zeros, as of clients that end a frame after its value.
//! - It has no watchdog.

use super::axis::{ControlMode, Controller, Input, NEVER};
use super::cansimple::{CLOSED_LOOP, IDLE, floats};
use super::configuration::{int, rpm};
use super::{Mode, Motor};
use crate::body::Law;
use core::f64::consts::TAU;
use motord_bus::{Duration, Frame, Instant};

/// Intervals of the reports from the factory.
const HEARTBEAT: Duration = Duration::from_millis(100);
const ESTIMATES: Duration = Duration::from_millis(10);
/// Interval of the supply's report.
const SUPPLY: Duration = Duration::from_millis(100);
/// Unit of the feed-forwards of a position, turns/s and N·m.
const MILLI: f64 = 0.001;
/// Results of a procedure.
const SUCCESS: u8 = 0;
const BUSY: u8 = 1;
const DISARMED: u8 = 3;
/// The fault number of an emergency stop.
const EMERGENCY_STOP: u32 = 0x80;

/// ODrive's errors, by SteadyWin's fault numbers.
const ERRORS: [(u32, u32); 7] = [
    // Timing, DC bus over-voltage, DC bus under-voltage.
    (0x01, 1 << 2),
    (0x02, 1 << 8),
    (0x04, 1 << 9),
    // Motor over-temperature, gate driver, current limit.
    (0x08, 1 << 13),
    (0x10, 1 << 5),
    (0x40, 1 << 12),
    (EMERGENCY_STOP, 1 << 25),
];
/// The error of another fault.
const SYSTEM_LEVEL: u32 = 1 << 1;

impl Motor {
    /// Executes a command. Returns no answer.
    pub(super) fn odrive(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        let mut bytes = [0; 8];
        frame.payload().iter().zip(&mut bytes).for_each(|(from, to)| *to = *from);
        let [low, high] = [[0, 1, 2, 3], [4, 5, 6, 7]].map(|at| u32::from_le_bytes(at.map(|at| bytes[at])));
        let [first, second] = [low, high].map(|bits| f64::from(f32::from_bits(bits)));
        match frame.id().raw() & 0x1F {
            0x02 => self.raise(EMERGENCY_STOP),
            0x07 => self.request_state(low),
            0x0B => self.set_controller_mode(low, high),
            0x0C => {
                let [_, _, _, _, a, b, c, d] = bytes;
                let [velocity, torque] = [[a, b], [c, d]].map(|code| f64::from(i16::from_le_bytes(code)));
                self.input(at, frame, ControlMode::Position, [first, velocity * MILLI, torque * MILLI]);
            }
            0x0D => self.input(at, frame, ControlMode::Velocity, [0.0, first, second]),
            0x0E => self.input(at, frame, ControlMode::Torque, [0.0, 0.0, first]),
            0x16 => self.reboot(at, bytes[0]),
            0x18 => self.acknowledge(),
            0x19 => self.set_absolute_position(first),
            _ => {}
        }
        None
    }

    /// Enters a state of the axis: idle or closed loop.
    fn request_state(&mut self, state: u32) {
        if state == u32::from(CLOSED_LOOP) && self.mode == Mode::Stopped {
            if !self.settings.behaviour.remembers_control {
                self.axis.controller.inputs = Controller::FACTORY.inputs;
            }
            self.mode = Mode::Running;
            self.law = self.closed_loop_law();
        } else if state == u32::from(IDLE) && self.mode == Mode::Running {
            self.mode = Mode::Stopped;
            self.end_control();
        }
    }

    fn set_controller_mode(&mut self, control: u32, input: u32) {
        self.axis.controller.mode = match (control, input) {
            (1, 1) => Some(ControlMode::Torque),
            (2, 1) => Some(ControlMode::Velocity),
            (3, 1) => Some(ControlMode::Position),
            _ => None,
        };
        if self.mode == Mode::Running {
            self.law = self.closed_loop_law();
        }
    }

    /// Stores an input. Follows it in the closed loop, if it is one of the present control mode.
    fn input(&mut self, at: Instant, frame: &Frame, mode: ControlMode, input: Input) {
        if !input.iter().all(|value| value.is_finite()) {
            return;
        }
        let controller = &mut self.axis.controller;
        controller.inputs[mode as usize] = Some(input);
        if self.mode == Mode::Running && controller.mode == Some(mode) {
            let law = self.closed_loop_law();
            self.execute(at, frame, law, Instant::FAR_FUTURE);
        }
    }

    /// Returns the law of the present control mode for its last input.
    fn closed_loop_law(&self) -> Law {
        let Controller { mode, inputs } = self.axis.controller;
        let Some(mode) = mode else { return Law::LIMP };
        let radians = self.radians_per_turn();
        let present = [self.position() / radians, 0.0, 0.0];
        let [turns, velocity, torque] = inputs[mode as usize].unwrap_or(present);
        let (velocity, torque) = (velocity * radians, torque * self.settings.gear_ratio);
        match mode {
            ControlMode::Torque => Law { torque, ..Law::LIMP },
            ControlMode::Velocity => Law { torque, ..self.speed_law(rpm(velocity)) },
            ControlMode::Position => {
                Law { velocity, torque, ..self.position_law(turns * radians, Duration::ZERO) }
            }
        }
    }

    /// Returns the angle of the output shaft for one turn of the rotor, rad.
    fn radians_per_turn(&self) -> f64 {
        TAU / self.settings.gear_ratio
    }

    /// Reboots an idle drive. The action 1 stores its configuration before.
    fn reboot(&mut self, at: Instant, action: u8) {
        if self.mode == Mode::Running || action > 1 {
            return;
        }
        if action == 1 {
            self.configuration.refresh();
        }
        self.restart(at);
    }

    /// Makes the present position that of `turns` of the rotor until the power is lost.
    fn set_absolute_position(&mut self, turns: f64) {
        let origin = self.body.position - turns * self.radians_per_turn();
        if origin.is_finite() {
            let zero = (origin.rem_euclid(TAU) * 65536.0 / TAU) as u32 as u16;
            self.configuration.set_int(int::ZERO_POSITION, i32::from(zero));
            self.move_origin(origin);
        }
    }

    /// Returns the intervals of heartbeat, estimates, torques and supply.
    pub(super) fn report_periods(&self) -> [Duration; 4] {
        let period = self.settings.report_period;
        match (self.settings.is_new, self.settings.reports_torque) {
            (true, _) => [HEARTBEAT, ESTIMATES, NEVER, NEVER],
            (false, false) => [HEARTBEAT, period, NEVER, NEVER],
            (false, true) => [HEARTBEAT, period, period, SUPPLY],
        }
    }

    /// Active errors, state of the axis, and result of the procedure.
    pub(super) fn odrive_heartbeat(&self) -> Frame {
        let [a, b, c, d] = self.active_errors().to_le_bytes();
        let (state, result) = match self.mode {
            Mode::Running => (CLOSED_LOOP, BUSY),
            Mode::Fault => (IDLE, DISARMED),
            _ => (IDLE, SUCCESS),
        };
        self.node_frame(0x01, [a, b, c, d, state, result, 0, 0])
    }

    fn active_errors(&self) -> u32 {
        let raised = ERRORS.into_iter().filter(|(number, _)| self.fault & number != 0);
        match raised.fold(0, |errors, (_, error)| errors | error) {
            0 if self.fault != 0 => SYSTEM_LEVEL,
            errors => errors,
        }
    }

    /// Target and estimate of the rotor's torque, N·m.
    pub(super) fn torques(&mut self, at: Instant) -> Frame {
        let (ratio, peak) = (self.settings.gear_ratio, self.settings.torque_peak);
        let is_running = self.mode == Mode::Running;
        let target = if is_running { self.body.commanded(&self.law).clamp(-peak, peak) } else { 0.0 };
        let [.., estimate] = self.report(at);
        self.node_frame(0x1C, floats([target / ratio, estimate / ratio]))
    }

    /// Voltage, V, and current, A, of the supply.
    pub(super) fn bus_supply(&self) -> Frame {
        let current = if self.supply > 0.0 { self.electrical_power() / self.supply } else { 0.0 };
        self.node_frame(0x17, floats([self.supply, current]))
    }
}
