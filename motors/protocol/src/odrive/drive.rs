//! A drive in ODrive's CANSimple.
//!
//! No command is answered, so every state is one that the drive sends by itself, and a heartbeat tells
//! whether it runs. A drive keeps its inputs, also those of other modes:
//!
//! ```text
//!   stop       axis idle, in every turn
//!   start      torque 0, torque mode, closed loop; then torque 0 until a heartbeat reports the closed loop
//!   setpoint   torque, velocity or position; before the first of another mode that input, and the mode
//! ```
//!
//! Real-time: after [`ODriveDialect::new`] nothing here allocates, blocks or loops.

use super::frame::{self, AxisState, ControlMode, Heartbeat, Reply, faults};
use crate::cansimple::Id;
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Measured, MotorSide, Question, Reported, Setpoint, Shape,
    Status, Supply, Transmission,
};
use crate::fault::Faults;
use core::f32::consts::TAU;
use motord_bus::{Duration, Frame, FrameId};
use motord_shared::SetpointMode;

/// The dialect of one motor.
#[derive(Debug)]
pub struct ODriveDialect {
    node: u8,
    gear_ratio: f32,
    transmission: Transmission,
    /// Largest torque of the rotor, N·m.
    torque_max: f32,
    /// Commands since the start began; 0 while it is stopped.
    step: u8,
    /// The mode that was set since the start.
    mode: ControlMode,
    /// The input of another mode was sent; its mode follows.
    is_changing: bool,
    /// The last heartbeat; `None` since a start began without one.
    heartbeat: Option<Heartbeat>,
    /// The last reported torque of the motor at the output, N·m.
    torque: f32,
    /// The last reported temperature, °C.
    celsius: Option<f32>,
}

impl ODriveDialect {
    /// Does not allocate.
    #[must_use]
    pub fn new(settings: &DriveSettings) -> Self {
        let DriveSettings { id, transmission, limits: [_, torque], gear_ratio, .. } = *settings;
        Self {
            node: id,
            gear_ratio,
            transmission,
            torque_max: torque / gear_ratio,
            step: 0,
            mode: ControlMode::Torque,
            is_changing: false,
            heartbeat: None,
            torque: 0.0,
            celsius: None,
        }
    }

    /// Forgets what the motor reported: it is silent, and may return after a loss of power.
    #[cold]
    fn forget(&mut self) {
        self.stop();
        (self.heartbeat, self.torque, self.celsius) = (None, 0.0, None);
    }

    const fn stop(&mut self) {
        (self.step, self.mode, self.is_changing) = (0, ControlMode::Torque, false);
    }

    fn is_running(&self) -> bool {
        self.heartbeat.is_some_and(|beat| beat.is_running())
    }

    /// Returns the next command to a motor that is to start. A heartbeat from before the start does not
    /// confirm it.
    fn starting(&mut self) -> frame::Command {
        let step = self.step;
        self.step = step.saturating_add(1);
        match step {
            0 => {
                self.heartbeat = None;
                frame::Command::Torque(0.0)
            }
            1 => frame::Command::SetMode(ControlMode::Torque),
            2 => frame::Command::SetState(AxisState::ClosedLoop),
            _ => frame::Command::Torque(0.0),
        }
    }

    /// Returns the command for a setpoint. `None` where a value is not finite.
    fn setpoint(&mut self, setpoint: &Setpoint) -> Option<frame::Command> {
        let (mode, input) = self.input(setpoint)?;
        if mode == self.mode {
            return Some(input);
        }
        // The drive would follow an old input between the two frames.
        self.is_changing = !self.is_changing;
        if self.is_changing {
            return Some(input);
        }
        self.mode = mode;
        Some(frame::Command::SetMode(mode))
    }

    /// Returns the mode of a setpoint, and its input at the rotor.
    fn input(&self, setpoint: &Setpoint) -> Option<(ControlMode, frame::Command)> {
        let wanted = self.transmission.to_motor(&setpoint.values);
        let turns = |radians: f32| finite(radians * self.gear_ratio / TAU);
        Some(match setpoint.mode {
            SetpointMode::Position => {
                (ControlMode::Position, frame::Command::Position(turns(wanted.position)?))
            }
            SetpointMode::Speed => (ControlMode::Velocity, frame::Command::Velocity(turns(wanted.velocity)?)),
            // Control has converted each impedance to a torque.
            SetpointMode::Torque | SetpointMode::Impedance => {
                let torque = finite(wanted.torque / self.gear_ratio)?;
                let most = self.torque_max;
                (ControlMode::Torque, frame::Command::Torque(torque.clamp(-most, most)))
            }
        })
    }

    /// Returns the content of a frame from this motor.
    #[inline]
    fn decode(&self, arrived: Arrived<'_>) -> Option<Reply> {
        let is_formed = !arrived.id.is_extended() && arrived.format == motord_bus::Format::Classic;
        let id = Id::of(arrived.id.raw());
        Reply::decode(id, arrived.payload).filter(|_| is_formed && id.node == self.node)
    }

    /// Takes a heartbeat. Reports faults that the last one did not have.
    fn beat(&mut self, heartbeat: Heartbeat) -> Reported {
        let before = self.faults();
        self.heartbeat = Some(heartbeat);
        let faults = self.faults();
        if faults.is_none() || faults == before { Reported::Unprompted } else { Reported::Fault(faults) }
    }

    fn faults(&self) -> Faults {
        self.heartbeat.map_or(Faults::NONE, |beat| faults(beat.errors))
    }

    /// Returns the state, joint side. `None` for estimates that no number has at the output.
    fn state(&self, [position, velocity]: [f32; 2]) -> Option<Reported> {
        let at_output = |turns: f32| finite(turns * TAU / self.gear_ratio);
        let torque = if self.is_running() { self.torque } else { 0.0 };
        let motor =
            Measured::<MotorSide>::new(at_output(position)?, at_output(velocity)?, torque, self.celsius);
        let status = Status {
            faults: self.heartbeat.map(|beat| faults(beat.errors)),
            has_unnamed_fault: false,
            runs: self.runs(),
        };
        Some(Reported::State(self.transmission.to_joint(&motor), Duration::ZERO, status))
    }

    /// Returns whether the motor runs, by its last heartbeat. A motor that was started runs only by a
    /// heartbeat after the start.
    fn runs(&self) -> Option<bool> {
        if self.step > 0 { Some(self.is_running()) } else { self.heartbeat.map(|beat| !beat.is_idle()) }
    }
}

/// Returns a number that is finite.
fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

impl Dialect for ODriveDialect {
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        let command = match command {
            Command::Nothing => {
                self.forget();
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetSupply | Command::GetRegister(_) => {
                return None;
            }
            Command::Control(setpoint) => self.setpoint(setpoint)?,
            Command::Neutral if self.step == 0 => frame::Command::SetState(AxisState::Idle),
            Command::Start | Command::Neutral => self.starting(),
            // Heartbeats have the faults.
            Command::Stop | Command::GetFault => {
                self.stop();
                frame::Command::SetState(AxisState::Idle)
            }
            Command::ClearFault => frame::Command::ClearErrors,
            Command::SetZero => frame::Command::SetZero,
        };
        let (id, payload) = command.encode(self.node);
        frame.set(FrameId::new(id.raw())?, payload);
        Some(Question::Unanswered)
    }

    fn classify(&self, arrived: Arrived<'_>, _open: Option<Question>) -> Shape {
        self.decode(arrived).map_or(Shape::Unreadable, |_| Shape::Unprompted)
    }

    fn accept(&mut self, _arrived: Arrived<'_>, _question: Question, _latency: Duration) -> Reported {
        Reported::Unprompted
    }

    fn accept_unprompted(&mut self, arrived: Arrived<'_>) -> Reported {
        match self.decode(arrived) {
            Some(Reply::Heartbeat(heartbeat)) => return self.beat(heartbeat),
            Some(Reply::Estimates { position, velocity }) => {
                return self.state([position, velocity]).unwrap_or(Reported::Unprompted);
            }
            Some(Reply::Bus { volts, amperes }) => {
                return Reported::Supply(Supply { voltage: volts, current: Some(amperes) });
            }
            Some(Reply::Torque(torque)) => {
                self.torque = finite(torque * self.gear_ratio).unwrap_or(self.torque);
            }
            Some(Reply::Temperature(celsius)) => self.celsius = finite(celsius),
            None => {}
        }
        Reported::Unprompted
    }
}
