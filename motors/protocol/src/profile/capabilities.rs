//! Abilities of a motor that the daemon's decisions and the plan of its bus depend on.

use super::Profile;
use crate::gim::INDICATORS;
use crate::register::ENDS;
use crate::scale::Scales;

/// Protocol that a motor is configured for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotorProtocol {
    /// MIT over CAN.
    Mit,
    /// SteadyWin's GIM protocol, over CAN, RS485 or RS232.
    Gim,
}

impl MotorProtocol {
    /// Returns its name in configurations and on command lines.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mit => "mit",
            Self::Gim => "gim",
        }
    }
}

/// The abilities of a motor, independent of its vendor and its protocol.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capabilities {
    /// The motor computes stiffness, damping and torque itself, and accepts only setpoints in
    /// impedance mode. Otherwise it also accepts torque, speed and position setpoints, and the
    /// cycle converts an impedance to a torque.
    pub impedance: bool,
    /// The motor reports positions within ± this value, motor side, rad. `None`: the positions are
    /// unbounded.
    pub position_end: Option<f32>,
    /// The motor clamps the speeds that it reports to ± this value, rad/s. `None`: the speeds are
    /// unbounded.
    pub velocity_end: Option<f32>,
    /// The motor answers a question for its faults. Otherwise every state contains them.
    pub answers_fault_question: bool,
    /// Number of indicators that the motor reports on request. Their numbers start at 0.
    pub indicators: u8,
    /// Number of registers that the motor reports on request, and without which it must not start. Their numbers start at 0.
    pub registers: u8,
    /// The registers are the ends of the codes of position, velocity and torque: no state has a meaning without them.
    pub scales_by_registers: bool,
    /// A state that answers a stop confirms the stop, unless the state reports that the motor runs. Otherwise the motor
    /// confirms a stop by a separate message.
    pub state_confirms_stop: bool,
    /// Fewest bytes of a reply with a state, for the plan of its bus.
    pub reply_bytes: u32,
}

impl Profile {
    /// Returns the abilities of a motor of this vendor that speaks `protocol` with these codes. Sources: GIM document 3.2.12
    /// (a stop is answered by a separate message) and table 2 (the bytes of a reply).
    #[must_use]
    pub const fn capabilities(&self, protocol: MotorProtocol, scales: &Scales) -> Capabilities {
        match protocol {
            MotorProtocol::Mit => Capabilities {
                impedance: true,
                position_end: Some(scales.position.max() as f32),
                velocity_end: Some(scales.velocity.max() as f32),
                answers_fault_question: self.is_asked_for_faults(),
                indicators: 0,
                registers: if self.has_registers { ENDS.len() as u8 } else { 0 },
                scales_by_registers: self.has_registers,
                state_confirms_stop: true,
                reply_bytes: self.reply.lengths[0] as u32,
            },
            MotorProtocol::Gim => Capabilities {
                impedance: false,
                position_end: None,
                velocity_end: None,
                answers_fault_question: true,
                indicators: INDICATORS.len() as u8,
                registers: 0,
                scales_by_registers: false,
                state_confirms_stop: false,
                reply_bytes: 8,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DAMIAO, STEADYWIN};
    use super::*;
    use crate::scale::Ends;

    #[test]
    fn capabilities_follow_vendor_and_protocol() {
        let scales = Scales::of(&Ends::new(12.5, 30.0, 10.0));
        let mit = STEADYWIN.capabilities(MotorProtocol::Mit, &scales);
        assert!(mit.impedance && mit.answers_fault_question && mit.state_confirms_stop);
        assert_eq!((mit.position_end, mit.velocity_end, mit.reply_bytes), (Some(12.5), Some(30.0), 6));
        assert!(!DAMIAO.capabilities(MotorProtocol::Mit, &scales).answers_fault_question);
        let gim = STEADYWIN.capabilities(MotorProtocol::Gim, &scales);
        assert!(!gim.impedance && !gim.state_confirms_stop && gim.indicators > 0);
    }
}
