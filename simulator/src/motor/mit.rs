//! The MIT protocol, from the motor's side (MIT document 1.1 and 1.2).

use super::configuration::int;
use super::{Mode, Motor};
use crate::body::Law;
use crate::settings::{InFault, ReplyTiming};
use crate::wire::{Control, KD, KP, MitCommand, POSITION, VELOCITY};
use motord_bus::{Frame, Instant};

impl Motor {
    /// Any eight bytes are a command: those that are not special are a control frame.
    pub(super) fn mit(&mut self, at: Instant, frame: &Frame, bytes: [u8; 8]) -> Option<[u8; 6]> {
        let command = MitCommand::decode(bytes);
        match command {
            MitCommand::GetFault => return Some([self.mit_id(), self.fault, 0, 0, 0, 0]),
            MitCommand::ClearFault => {
                self.acknowledge();
                return Some([self.mit_id(), 0, 0, 0, 0, 0]);
            }
            _ if self.mode == Mode::Fault && self.settings.behaviour.in_fault == InFault::Silent => {
                return None;
            }
            _ => {}
        }
        let before = self.state(at);
        self.obey(at, frame, command);
        let state = match self.settings.behaviour.reply_timing {
            ReplyTiming::BeforeCommand => before,
            ReplyTiming::AfterCommand => self.state(at),
        };
        Some(state.mit(self.mit_id()))
    }

    /// The id fills one byte of an answer, whatever its configuration holds.
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
            (MitCommand::Control(control), Mode::Running) => {
                self.execute(at, frame, self.law_of(control), self.host_loss(at));
            }
            (MitCommand::Control(control), Mode::Stopped) if self.settings.behaviour.remembers_control => {
                self.law = self.law_of(control);
            }
            _ => {}
        }
    }

    fn law_of(&self, control: Control) -> Law {
        let target = POSITION.value(control.position) + self.origin;
        Law {
            reference: target,
            target,
            rate: 0.0,
            velocity: VELOCITY.value(control.velocity),
            kp: KP.value(control.kp),
            kd: KD.value(control.kd),
            torque: self.torque_scale().value(control.torque),
        }
    }
}
