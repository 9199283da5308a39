//! A drive in ODrive's CANSimple.
//!
//! No command is answered, so every state is one that the drive sends by itself, and a heartbeat
//! reports its mode. The drive keeps its inputs, also those of other modes, and the bus may lose a frame:
//!
//! ```text
//!   stop       axis idle, in every turn
//!   start      torque 0, torque mode, torque 0; then in turn torque 0, torque mode and closed loop, until
//!              a heartbeat reports the closed loop; then torque 0 in its place
//!   setpoint   torque, velocity or position; the mode follows the second of another mode, and every
//!              eighth
//! ```
//!
//! A drive whose heartbeats or torques end counts as off.
//!
//! Real-time: after [`ODriveDialect::new`] nothing here allocates, blocks or loops.

use super::frame::{self, AxisState, ControlMode, Heartbeat, Reply, faults};
use crate::cansimple::{Estimates, Id};
use crate::drive::{
    Arrived, Command, Dialect, DriveSettings, Measured, MotorSide, Question, Reported, Setpoint, Shape,
    Status, Supply, Transmission,
};
use crate::fault::Faults;
use core::f32::consts::TAU;
use motord_bus::{Duration, Frame, Instant};
use motord_shared::SetpointMode;

/// Inputs of a mode before its frame: one of them may be lost, and the drive would follow an old one.
const FIRST_INPUTS: u8 = 2;
/// Inputs from one mode frame to the next.
const INPUTS: u8 = 8;
/// A heartbeat and a torque are older than this only from a drive that sends none: the factory sends a
/// heartbeat every 100 ms.
const REPORT_AGE_MAX: Duration = Duration::from_millis(350);

/// The progress of the commands, which depends on those that were sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Progress {
    /// The next command of a start; 0 while it is stopped.
    step: u8,
    /// The mode that was set last.
    mode: ControlMode,
    /// The mode of the last inputs.
    input: ControlMode,
    /// Number of inputs since they have this mode, and since the last mode frame.
    inputs: u8,
}

impl Progress {
    const STOPPED: Self = Self { step: 0, mode: ControlMode::Torque, input: ControlMode::Torque, inputs: 0 };
}

/// The dialect of one motor.
#[derive(Debug)]
pub struct ODriveDialect {
    node: u8,
    gear_ratio: f32,
    transmission: Transmission,
    /// Largest torque of the rotor, N·m.
    torque_max: f32,
    progress: Progress,
    /// The progress before the last command.
    before: Progress,
    /// The last heartbeat, and its time; `None` since a start began without one.
    heartbeat: Option<(Heartbeat, Instant)>,
    /// The last reported torque of the motor at the output, N·m, and its time.
    torque: Option<(f32, Instant)>,
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
            progress: Progress::STOPPED,
            before: Progress::STOPPED,
            heartbeat: None,
            torque: None,
            celsius: None,
        }
    }

    /// Forgets what the motor reported: it is silent, and may return after a loss of power.
    #[cold]
    fn forget(&mut self) {
        self.progress = Progress::STOPPED;
        (self.heartbeat, self.torque, self.celsius) = (None, None, None);
    }

    fn is_running(&self) -> bool {
        self.heartbeat.is_some_and(|(beat, _)| beat.state.is_running())
    }

    /// Returns the next command to a motor that is to start. A heartbeat from before the start does not
    /// confirm it.
    fn starting(&mut self) -> frame::Command {
        let step = self.progress.step;
        // The last three of the six commands repeat.
        self.progress.step = if step == 5 { 3 } else { step + 1 };
        match step {
            0 => {
                self.heartbeat = None;
                frame::Command::Torque(0.0)
            }
            1 | 4 => frame::Command::SetMode(ControlMode::Torque),
            5 if !self.is_running() => frame::Command::SetState(AxisState::ClosedLoop),
            _ => frame::Command::Torque(0.0),
        }
    }

    /// Returns the command for a setpoint. `None` where a value is not finite.
    fn setpoint(&mut self, setpoint: &Setpoint) -> Option<frame::Command> {
        let (mode, command) = self.input(setpoint)?;
        let progress = &mut self.progress;
        if progress.input != mode {
            (progress.input, progress.inputs) = (mode, 0);
        }
        if progress.inputs >= if mode == progress.mode { INPUTS } else { FIRST_INPUTS } {
            (progress.mode, progress.inputs) = (mode, 0);
            return Some(frame::Command::SetMode(mode));
        }
        progress.inputs += 1;
        Some(command)
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
    fn beat(&mut self, heartbeat: Heartbeat, at: Instant) -> Reported {
        let before = self.faults();
        self.heartbeat = Some((heartbeat, at));
        let faults = self.faults();
        if faults.is_none() || faults == before { Reported::Unprompted } else { Reported::Fault(faults) }
    }

    fn faults(&self) -> Faults {
        self.heartbeat.map_or(Faults::NONE, |(beat, _)| faults(beat.errors))
    }

    /// Returns the state that arrived `at`, joint side. `None` for estimates that no number has at the
    /// output.
    fn state(&self, estimates: Estimates, at: Instant) -> Option<Reported> {
        let [position, velocity] = estimates.at_output(self.gear_ratio).map(finite);
        let torque = self.torque.filter(|_| self.is_running()).map_or(0.0, |(torque, _)| torque);
        let motor = Measured::<MotorSide>::new(position?, velocity?, torque, self.celsius);
        let status = Status {
            faults: self.heartbeat.map(|_| self.faults()),
            has_unnamed_fault: false,
            runs: Some(self.runs(at)),
        };
        Some(Reported::State(self.transmission.to_joint(&motor), Duration::ZERO, status))
    }

    /// Returns whether the motor runs `at` this time. One that is to run does so only by heartbeats after
    /// the start, and while it reports its torque. One that is to stop may run until a heartbeat reports
    /// that it is idle.
    fn runs(&self, at: Instant) -> bool {
        let is_young = |reported: Instant| at.since(reported) <= REPORT_AGE_MAX;
        let beat = self.heartbeat.filter(|(_, reported)| is_young(*reported)).map(|(beat, _)| beat);
        if self.progress.step == 0 {
            return beat.is_none_or(|beat| !beat.state.is_idle());
        }
        let has_torque = self.torque.is_some_and(|(_, reported)| is_young(reported));
        beat.is_some_and(|beat| beat.state.is_running()) && has_torque
    }
}

/// Returns a number that is finite.
fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

impl Dialect for ODriveDialect {
    fn encode(&mut self, command: &Command, frame: &mut Frame) -> Option<Question> {
        self.before = self.progress;
        let command = match command {
            Command::Nothing => {
                self.forget();
                return None;
            }
            Command::Wait | Command::GetIndicator(_) | Command::GetSupply | Command::GetRegister(_) => {
                return None;
            }
            Command::Control(setpoint) => self.setpoint(setpoint)?,
            Command::Neutral if self.progress.step == 0 => frame::Command::SetState(AxisState::Idle),
            Command::Start | Command::Neutral => self.starting(),
            // Heartbeats have the faults.
            Command::Stop | Command::GetFault => {
                self.progress = Progress::STOPPED;
                frame::Command::SetState(AxisState::Idle)
            }
            Command::ClearFault => frame::Command::ClearErrors,
            Command::SetZero => frame::Command::SetZero,
        };
        *frame = command.frame(self.node)?;
        Some(Question::Unanswered)
    }

    /// A frame that does not decode is no sign of a second motor: nothing asked for any frame.
    fn classify(&self, arrived: Arrived<'_>, _open: Option<Question>) -> Shape {
        let is_of_node = !arrived.id.is_extended() && Id::of(arrived.id.raw()).node == self.node;
        if is_of_node { Shape::Unprompted } else { Shape::Unreadable }
    }

    fn accept(&mut self, _arrived: Arrived<'_>, _question: Question, _latency: Duration) -> Reported {
        Reported::Unprompted
    }

    fn accept_unprompted(&mut self, arrived: Arrived<'_>) -> Reported {
        let at = arrived.at;
        match self.decode(arrived) {
            Some(Reply::Heartbeat(heartbeat)) => return self.beat(heartbeat, at),
            Some(Reply::Estimates(estimates)) => {
                return self.state(estimates, at).unwrap_or(Reported::Unprompted);
            }
            Some(Reply::Bus { volts, amperes }) => {
                return Reported::Supply(Supply { voltage: volts, current: finite(amperes) });
            }
            Some(Reply::Torque(torque)) => {
                self.torque = finite(torque * self.gear_ratio).map(|torque| (torque, at)).or(self.torque);
            }
            Some(Reply::Temperature(celsius)) => self.celsius = finite(celsius),
            None => {}
        }
        Reported::Unprompted
    }

    #[cold]
    fn unsent(&mut self) {
        self.progress = self.before;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drive::{Impedance, JointSide};
    use crate::execution_time::ExecutionTime;
    use crate::profile::Profile;
    use motord_bus::FrameId;

    /// A drive that keeps every input, and sends a heartbeat after each command.
    #[derive(Debug, Default)]
    struct Twin {
        mode: u8,
        is_running: bool,
        /// Of the modes 1 to 3.
        inputs: [Option<f32>; 4],
        /// Input of the mode while it runs.
        followed: Vec<(u8, Option<f32>)>,
    }

    impl Twin {
        fn receive(&mut self, frame: &Frame) {
            let [a, b, c, d, ..] = *frame.payload() else { panic!("eight bytes") };
            let value = f32::from_le_bytes([a, b, c, d]);
            match frame.id().raw() & 0x1F {
                0x07 => self.is_running = a == 8,
                0x0B => self.mode = a,
                0x0C => self.inputs[3] = Some(value),
                0x0D => self.inputs[2] = Some(value),
                0x0E => self.inputs[1] = Some(value),
                other => panic!("{other:#X}"),
            }
            if self.is_running {
                self.followed.push((self.mode, self.inputs[usize::from(self.mode)]));
            }
        }
    }

    fn dialect() -> ODriveDialect {
        let (profile, model) = Profile::of_model("ODrive-S1").unwrap();
        ODriveDialect::new(&DriveSettings {
            id: 5,
            host_id: FrameId::new(0x0A9).unwrap(),
            profile,
            scales: model.scales().unwrap(),
            gear_ratio: 1.0,
            transmission: Transmission::new(1.0, 0.0),
            limits: [10.0, 10.0],
            wraps: false,
            duration: ExecutionTime::MAX,
            error_feedback: true,
        })
    }

    fn setpoint(mode: SetpointMode, value: f32) -> Command {
        let values = Impedance::<JointSide>::new(value, value, 0.0, 0.0, value);
        Command::Control(Setpoint { values, mode })
    }

    /// Sends a command and the heartbeat that follows it. A frame that is `lost` is not received; one that
    /// is not sent is taken back.
    fn turn(dialect: &mut ODriveDialect, twin: &mut Twin, command: &Command, lost: Option<bool>) {
        let mut frame = Frame::EMPTY;
        dialect.encode(command, &mut frame).unwrap();
        match lost {
            None => twin.receive(&frame),
            Some(true) => dialect.unsent(),
            Some(false) => {}
        }
        let beat = Frame::classic(
            FrameId::new(0x0A1).unwrap(),
            [0, 0, 0, 0, if twin.is_running { 8 } else { 1 }, 0, 0, 0],
        );
        dialect.accept_unprompted(Arrived::new(&beat, Instant::from_nanos(1)));
    }

    /// Goal: no lost frame leaves a drive in another mode than its setpoints for long, and no mode begins
    /// with an old input.
    /// Method: a drive that was left in position mode with an input starts, follows torques, positions,
    /// one torque, and velocities. Each frame is lost once, or is not sent.
    #[test]
    fn lost_frame_leaves_no_wrong_mode() {
        for (lost, unsent) in (0..80).flat_map(|lost| [(lost, false), (lost, true)]) {
            let (mut dialect, mut sent) = (dialect(), 0);
            let mut twin =
                Twin { mode: 3, inputs: [None, Some(7.0), Some(7.0), Some(7.0)], ..Twin::default() };
            let mut run = |twin: &mut Twin, command: Command, turns: usize| {
                for _ in 0..turns {
                    turn(&mut dialect, twin, &command, (sent == lost).then_some(unsent));
                    sent += 1;
                }
            };
            run(&mut twin, Command::Start, 12);
            assert!(twin.is_running, "frame {lost}");
            let begun =
                |followed: &[(u8, Option<f32>)]| followed.iter().all(|known| *known == (1, Some(0.0)));
            assert!(begun(&twin.followed), "frame {lost}: {:?}", twin.followed);
            for (mode, value, number) in [
                (SetpointMode::Torque, 1.0, 1),
                (SetpointMode::Position, 2.0, 3),
                (SetpointMode::Torque, 3.0, 1),
                (SetpointMode::Speed, 4.0, 2),
            ] {
                twin.followed.clear();
                run(&mut twin, setpoint(mode, value), 16);
                let input = if number == 1 { value } else { value / TAU };
                assert_eq!(twin.followed.last(), Some(&(number, Some(input))), "frame {lost}");
                let old = twin.followed.iter().any(|(_, input)| *input == Some(7.0));
                assert!(!old, "frame {lost}: {:?}", twin.followed);
            }
        }
    }

    /// One input of another mode, and back: the mode that follows later has a new input.
    #[test]
    fn abandoned_change_leaves_no_old_input() {
        let (mut dialect, mut twin) = (dialect(), Twin::default());
        let mut run = |twin: &mut Twin, command: Command, turns: usize| {
            (0..turns).for_each(|_| turn(&mut dialect, twin, &command, None));
        };
        run(&mut twin, Command::Start, 12);
        run(&mut twin, setpoint(SetpointMode::Position, 5.0), 1);
        run(&mut twin, setpoint(SetpointMode::Torque, 0.0), 40);
        twin.followed.clear();
        run(&mut twin, setpoint(SetpointMode::Position, 1.0), 16);
        let positions: Vec<_> = twin.followed.iter().filter(|(mode, _)| *mode == 3).collect();
        assert!(
            positions.len() > 8 && positions.iter().all(|known| known.1 == Some(1.0 / TAU)),
            "{positions:?}"
        );
    }

    /// The start does not end without torques, and a silent heartbeat is no running drive.
    #[test]
    fn drive_without_reports_is_off() {
        let mut dialect = dialect();
        let frame = |part: u16, payload| Frame::classic(FrameId::new(0x0A0 | part).unwrap(), payload);
        let millis = |millis: u64| Instant::from_nanos(millis * 1_000_000);
        dialect.encode(&Command::Start, &mut { Frame::EMPTY });
        let runs = |dialect: &mut ODriveDialect, at| match dialect
            .accept_unprompted(Arrived::new(&frame(0x09, [0; 8]), millis(at)))
        {
            Reported::State(_, _, status) => status.runs,
            other => panic!("{other:?}"),
        };
        assert_eq!(runs(&mut dialect, 1), Some(false));
        dialect.accept_unprompted(Arrived::new(&frame(0x01, [0, 0, 0, 0, 8, 0, 0, 0]), millis(2)));
        assert_eq!(runs(&mut dialect, 3), Some(false), "no torque");
        dialect.accept_unprompted(Arrived::new(&frame(0x1C, [0; 8]), millis(4)));
        assert_eq!([runs(&mut dialect, 5), runs(&mut dialect, 360)], [Some(true), Some(false)]);
    }
}
