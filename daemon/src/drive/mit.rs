//! A drive in MIT mode. Source: MIT document.

use super::Answer;
use crate::control::{Command, Heard};
use crate::joint::{Impedance, Measured, Motor, Transmission};
use motord_bus::Duration;
use motord_protocol::TorqueScale;
use motord_protocol::mit::{self, Asked, ControlCodes, Reply};

#[derive(Debug)]
pub(super) struct Mit {
    id: u8,
    scale: TorqueScale,
    transmission: Transmission,
    asked: Asked,
    feedback: Option<Feedback>,
}

/// Carries the rounding error of the torque code from frame to frame, so that the mean of the codes is the torque asked
/// for: zero lies half a code off, and a code is up to 0.3 N·m.
#[derive(Debug, Default)]
struct Feedback {
    /// What the frames before sent too much, in codes; within ±0.5.
    carried: f64,
}

impl Mit {
    pub(super) fn new(id: u8, scale: TorqueScale, transmission: Transmission, error_feedback: bool) -> Self {
        let feedback = error_feedback.then(Feedback::default);
        Self { id, scale, transmission, asked: Asked::State, feedback }
    }

    pub(super) fn encode(&mut self, command: &Command) -> Option<[u8; 8]> {
        let (asked, command) = match command {
            Command::Nothing => return None,
            Command::Stop => (Asked::State, mit::Command::Stop),
            Command::Start => (Asked::State, mit::Command::Start),
            Command::SetZero => (Asked::State, mit::Command::SetZero),
            Command::GetFault => (Asked::Fault, mit::Command::GetFault),
            Command::ClearFault => (Asked::Clear, mit::Command::ClearFault),
            Command::Neutral => return self.control(&Impedance::NEUTRAL),
            Command::Control(joint, _) => return self.control(&self.transmission.to_motor(joint)),
        };
        self.asked = asked;
        if let Some(feedback) = &mut self.feedback {
            feedback.carried = 0.0;
        }
        command.encode(&self.scale).ok()
    }

    fn control(&mut self, wanted: &Impedance<Motor>) -> Option<[u8; 8]> {
        self.asked = Asked::State;
        // Without stiffness the position means nothing, so it is sent as zero: 0x80, the first byte of zero, is no
        // native command, should this motor have left MIT mode unseen (protocol note 1.3).
        let position = if wanted.kp > 0.0 { wanted.position } else { 0.0 };
        let Impedance { velocity, kp, kd, torque, .. } = *wanted;
        let mut codes =
            ControlCodes::nearest(&mit::Impedance { position, velocity, kp, kd, torque }, &self.scale)
                .ok()?;
        if let Some(feedback) = &mut self.feedback {
            codes.torque = feedback.quantise(torque, &self.scale);
        }
        Some(codes.pack())
    }

    pub(super) fn decode(&self, payload: &[u8], latency: Duration) -> Answer {
        let reply = match mit::decode_reply(payload, self.asked, &self.scale) {
            Ok(reply) if reply.id() == self.id => reply,
            Ok(_) => return Answer::Stranger,
            Err(_) => return Answer::Malformed,
        };
        Answer::Heard(match reply {
            Reply::State(state) => {
                let motor = Measured::new(state.position, state.velocity, state.torque, None);
                Heard::State(self.transmission.to_joint(&motor), latency)
            }
            Reply::Fault { fault, .. } => Heard::Fault(fault),
            Reply::Cleared { .. } => Heard::Cleared,
        })
    }
}

impl Feedback {
    /// The code for `torque`: one of its two neighbours, such that the error of all codes so far stays within half a
    /// code. Beyond the ends of the scale nothing is carried.
    fn quantise(&mut self, torque: f32, scale: &TorqueScale) -> u16 {
        let exact = scale.field().quantise(f64::from(torque)).unwrap_or_default();
        let wanted = exact - self.carried;
        let code = wanted.round().clamp(exact.floor(), exact.ceil());
        self.carried = (code - wanted).clamp(-0.5, 0.5);
        code as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_many_frames_is_the_torque_asked_for() {
        let scale = TorqueScale::new(0.125, 8.0).unwrap();
        let code = 2.0 * f64::from(scale.full_scale()) / 4095.0;
        for thirds in -30..30 {
            let torque = (f64::from(thirds) * 0.3 * code) as f32;
            let exact = scale.field().quantise(f64::from(torque)).unwrap();
            let mut feedback = Feedback::default();
            let codes: Vec<f64> = (0..1000).map(|_| f64::from(feedback.quantise(torque, &scale))).collect();
            let mean = codes.iter().sum::<f64>() / 1000.0;
            assert!((mean - exact).abs() <= 0.001, "{exact} became {mean}");
            assert!(
                codes.iter().all(|code| (code - exact).abs() < 1.0),
                "only the two neighbours of {exact}"
            );
        }
    }
}
