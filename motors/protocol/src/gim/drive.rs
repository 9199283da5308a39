//! A drive in GIM mode, over CAN or a serial line. Source: GIM document.
//!
//! GIM motors report their state only in answer to control commands. A stopped motor is asked for
//! its shaft angle (indicator 0x13), at intervals for its speed (0x14), and is commanded to stop,
//! so that it confirms its stop. GIM commands have no impedance: control sends a torque instead.
//!
//! Real-time: nothing here allocates, blocks or loops.

use super::{ExecutionTime, Finite, Indicator, Pending, RPM, Reply};
use crate::Scales;
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Impedance, JointSide, Measured, MotorSide, Question, Reported,
    Shape, Status, Transmission,
};
use motord_bus::{Duration, Frame, FrameId, Instant};
use motord_shared::SetpointMode;

/// While stopped, one of this many turns asks for the speed, and one commands stop. Until the motor
/// has confirmed a stop, the next turn and every second one after it command it: the bus may have
/// refused the first.
const ROUND: u32 = 10;
/// A velocity older than this is not combined with a new angle to a state.
const VELOCITY_MAX_AGE: Duration = Duration::from_millis(500);

/// The last confirmation of the motor that still holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Confirmed {
    /// None since the last command of another kind.
    Nothing,
    /// It started, and was not commanded to stop since. Otherwise it refuses control commands.
    Start,
    /// It stopped, and was commanded nothing but stops and requests since.
    Stop,
}

impl Confirmed {
    /// Returns the confirmation that holds after `command`.
    const fn after(self, command: &Command) -> Self {
        match (self, command) {
            (Self::Start, Command::Stop) => Self::Nothing,
            (Self::Start, _)
            | (_, Command::Nothing | Command::Wait | Command::GetSupply | Command::GetRegister(_)) => self,
            (Self::Stop, Command::Stop | Command::GetFault | Command::GetIndicator(_)) => self,
            (Self::Stop | Self::Nothing, _) => Self::Nothing,
        }
    }
}

/// The dialect of one motor in GIM mode.
#[derive(Debug)]
pub struct GimDialect {
    command_id: FrameId,
    scales: Scales,
    transmission: Transmission,
    /// Sent with every control command.
    duration: ExecutionTime,
    asked: super::Command,
    /// The last request is for an indicator of telemetry, not for a part of the state.
    awaits_indicator: bool,
    turn: u32,
    confirmed: Confirmed,
    /// The last accepted state, motor side.
    state: Measured<MotorSide>,
    /// When it last reported its velocity.
    velocity_at: Instant,
    /// Its velocity is older than [`VELOCITY_MAX_AGE`], and may have changed.
    is_velocity_old: bool,
}

impl GimDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let state = Measured::new(0.0, 0.0, 0.0, None);
        let DriveSettings { id, scales, transmission, duration, .. } = *settings;
        Self {
            command_id: FrameId::from(id),
            scales,
            transmission,
            duration,
            asked: super::Command::StopMotor,
            awaits_indicator: false,
            turn: 0,
            confirmed: Confirmed::Nothing,
            state,
            velocity_at: Instant::FAR_FUTURE,
            is_velocity_old: false,
        }
    }

    /// Returns the next command of the round to a stopped motor.
    fn stopped(&mut self) -> super::Command {
        let turn = self.turn;
        self.turn = (turn + 1) % ROUND;
        match turn {
            0 => super::Command::StopMotor,
            turn if self.confirmed != Confirmed::Stop && turn % 2 == 1 => super::Command::StopMotor,
            2 => super::Command::RetrieveIndicator { ind_id: Indicator::SHAFT_SPEED },
            _ => self.state_question(),
        }
    }

    /// Returns the question for the angle, or first for an old velocity.
    const fn state_question(&self) -> super::Command {
        let old = self.is_velocity_old;
        let ind_id = if old { Indicator::SHAFT_SPEED } else { Indicator::SHAFT_ANGLE };
        super::Command::RetrieveIndicator { ind_id }
    }

    const fn record_velocity(&mut self, velocity: f32, at: Instant) {
        self.state.velocity = velocity;
        (self.velocity_at, self.is_velocity_old) = (at, false);
    }

    fn control(&self, joint: &Impedance<JointSide>, mode: SetpointMode) -> Option<super::Command> {
        let wanted = self.transmission.to_motor(joint);
        let duration = self.duration;
        Some(match mode {
            SetpointMode::Speed => {
                super::Command::SpeedControl { speed_rpm: Finite::new(wanted.velocity * RPM)?, duration }
            }
            SetpointMode::Position => {
                super::Command::PositionControl { position: Finite::new(wanted.position)?, duration }
            }
            // Control has converted each impedance to a torque.
            SetpointMode::Torque | SetpointMode::Impedance => {
                super::Command::TorqueControl { torque: Finite::new(wanted.torque)?, duration }
            }
        })
    }

    /// Returns the last accepted state, joint side.
    fn reported(&self, latency: Duration) -> Reported {
        Reported::State(self.transmission.to_joint(&self.state), latency, Status::default())
    }
}

impl Dialect for GimDialect {
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        if !matches!(
            command,
            Command::Stop
                | Command::Nothing
                | Command::Wait
                | Command::GetIndicator(_)
                | Command::GetSupply
                | Command::GetRegister(_)
        ) {
            self.turn = 0;
        }
        self.confirmed = self.confirmed.after(command);
        self.asked = match command {
            // An indicator is its voltage.
            Command::Nothing | Command::Wait | Command::GetSupply | Command::GetRegister(_) => return None,
            Command::Stop => self.stopped(),
            Command::Start => super::Command::StartMotor,
            Command::GetFault => super::Command::GetFault,
            Command::GetIndicator(ind_id) => super::Command::RetrieveIndicator { ind_id: *ind_id },
            Command::ClearFault => super::Command::AcknowledgeFault,
            // The zero of a GIM motor is a configuration item (ConfID 0x14), which the cycle does
            // not write.
            Command::SetZero => super::Command::StopMotor,
            Command::Neutral if self.confirmed != Confirmed::Start => self.state_question(),
            Command::Neutral => self.control(&Impedance::NEUTRAL, SetpointMode::Torque)?,
            Command::Control(setpoint) => self.control(&setpoint.values, setpoint.mode)?,
        };
        self.awaits_indicator = matches!(command, Command::GetIndicator(_));
        frame.set(self.command_id, self.asked.encode_mit_safe().unwrap_or_else(|| self.asked.encode()));
        Some(match command {
            Command::GetFault => Question::Fault,
            Command::ClearFault => Question::Clear,
            _ => Question::State,
        })
    }

    fn classify(&self, arrived: Arrived<'_>, _open: Option<Question>) -> Shape {
        match super::decode_reply(arrived.payload, Pending::Other, &self.scales) {
            // A reply names its command, so a report cannot be a state.
            Ok(reply @ Reply::Fault(_)) if reply.answers(&self.asked) => Shape::Report,
            Ok(reply) if reply.answers(&self.asked) => Shape::Plain,
            Ok(_) | Err(_) => Shape::Unreadable,
        }
    }

    fn accept(&mut self, arrived: Arrived<'_>, _question: Question, latency: Duration) -> Reported {
        let Arrived { payload, at, .. } = arrived;
        let Ok(reply) = super::decode_reply(payload, Pending::Other, &self.scales) else {
            return Reported::Refused;
        };
        match reply {
            Reply::Indicator { ind_id, outcome } if self.awaits_indicator => {
                Reported::Indicator(ind_id, outcome.map_or(f32::NAN, Finite::get))
            }
            Reply::State { outcome: Ok(state), .. } => {
                let temperature = Some(f32::from(state.temperature_celsius));
                self.state = Measured::new(state.position, state.velocity, state.torque, temperature);
                self.record_velocity(state.velocity, at);
                self.reported(latency)
            }
            Reply::Indicator { ind_id: Indicator::SHAFT_ANGLE, outcome: Ok(angle) } => {
                self.state.position = angle.get();
                self.is_velocity_old = at.since(self.velocity_at) > VELOCITY_MAX_AGE;
                if self.is_velocity_old { Reported::Alive } else { self.reported(latency) }
            }
            Reply::Indicator { ind_id: Indicator::SHAFT_SPEED, outcome: Ok(speed) } => {
                let velocity = speed.get() / RPM;
                // A velocity that no state can hold is a damaged payload: no checksum covers a
                // payload on a line.
                if f64::from(velocity.abs()) <= self.scales.velocity.max() {
                    self.record_velocity(velocity, at);
                }
                Reported::Alive
            }
            Reply::Fault(Ok(fault)) => Reported::Fault(fault.faults()),
            Reply::Done { outcome: Ok(()), .. } => match self.asked {
                super::Command::AcknowledgeFault => Reported::Cleared,
                super::Command::StopMotor => {
                    // No later answer of a stopped motor contains its torque or its temperature.
                    (self.state.torque, self.state.temperature) = (0.0, None);
                    self.confirmed = Confirmed::Stop;
                    Reported::Stopped
                }
                _ => {
                    if self.asked == super::Command::StartMotor {
                        self.confirmed = Confirmed::Start;
                    }
                    Reported::Alive
                }
            },
            _ => Reported::Refused,
        }
    }
}
