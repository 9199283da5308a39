//! The MIT protocol, from the motor's side (MIT document 1.1 and 1.2). The
//! [`AnyDrive`](crate::drives::AnyDrive) holds the differences between vendors.

use super::configuration::int;
use super::{Mode, Motor};
use crate::body::Law;
use crate::drives::{Answer, Asked, Status};
use crate::settings::{InFault, ReplyTiming};
use crate::wire::{Control, MitCommand, Scale, State};
use motord_bus::{Frame, FrameId, Instant};

impl Motor {
    /// Executes any eight bytes: those that are not a special frame are a control frame.
    pub(super) fn mit(&mut self, at: Instant, frame: &Frame) -> Option<Frame> {
        if self.is_protocol_request(frame) {
            return self.change_from_mit(frame);
        }
        let command = self.drive.decode(frame.payload())?;
        // A change of id takes effect after its own answer.
        let host_id = self.host_address();
        let behaviour = &self.settings.behaviour;
        let is_silent =
            behaviour.in_fault == InFault::Silent && !self.drive.answers_in_fault(behaviour.firmware);
        match command {
            MitCommand::GetFault => {
                let state = self.state(at);
                return Some(self.answer(Asked::Fault, host_id, state));
            }
            MitCommand::ClearFault => {
                self.acknowledge();
                let state = self.state(at);
                return Some(self.answer(Asked::Clear, host_id, state));
            }
            _ if self.mode == Mode::Fault && is_silent => return None,
            _ => {}
        }
        let before = self.state(at);
        self.obey(at, frame, command);
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.state(at),
        };
        Some(self.answer(Asked::State, host_id, state))
    }

    pub(super) fn answer(&self, asked: Asked, host_id: FrameId, state: State) -> Frame {
        let temperatures = [self.body.winding, self.board_temperature()];
        let status = match self.mode {
            Mode::Fault => Status::Fault,
            Mode::Running => Status::On,
            _ => Status::Off,
        };
        let (id, fault, filler) = (self.mit_id(), self.fault, self.filler());
        let firmware = self.settings.behaviour.firmware;
        self.drive.answer(&Answer {
            asked,
            host_id,
            id,
            state,
            status,
            fault,
            temperatures,
            firmware,
            filler,
        })
    }

    /// Returns the id, which fills one byte of an answer, whatever its configuration holds.
    fn mit_id(&self) -> u8 {
        self.configuration.int(int::CAN_ID) as u8
    }

    fn obey(&mut self, at: Instant, frame: &Frame, command: MitCommand) {
        match (command, self.mode) {
            (MitCommand::Start, Mode::Stopped) => {
                self.mode = Mode::Running;
                self.control_until = self.host_loss(at);
            }
            (MitCommand::Stop, Mode::Running) => {
                self.mode = Mode::Stopped;
                self.control_until = Instant::FAR_FUTURE;
                if !self.settings.behaviour.remembers_control {
                    self.law = Law::LIMP;
                }
            }
            (MitCommand::SetZero, _) => {
                self.set_zero();
                self.silent_until = at + self.settings.behaviour.zeroing_silence;
            }
            (MitCommand::Control(control), Mode::Stopped) if !self.settings.behaviour.needs_start => {
                self.mode = Mode::Running;
                self.execute(at, frame, self.law_of(control), self.host_loss(at));
            }
            (MitCommand::Control(control), Mode::Running) => {
                self.execute(at, frame, self.law_of(control), self.host_loss(at));
            }
            (MitCommand::Control(control), Mode::Stopped) if self.settings.behaviour.remembers_control => {
                self.law = self.law_of(control);
            }
            _ => {}
        }
    }

    pub(super) fn law_of(&self, control: Control) -> Law {
        self.law_with(control, self.scales())
    }

    /// Returns the law of a control frame whose codes have these scales of position, velocity and torque.
    pub(super) fn law_with(&self, control: Control, [position, velocity, torque]: [Scale; 3]) -> Law {
        let [kp, kd] = self.settings.gain_ends.map(Scale::from_zero);
        let target = position.value(control.position) + self.origin;
        Law {
            reference: target,
            target,
            rate: 0.0,
            velocity: velocity.value(control.velocity),
            kp: kp.value(control.kp),
            kd: kd.value(control.kd),
            torque: torque.value(control.torque),
        }
    }
}
