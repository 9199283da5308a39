//! Abilities of a motor that the daemon's decisions and the plan of its bus depend on.

use crate::scale::Scales;

/// The way in which a motor reports its supply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SupplyReport {
    /// It does not.
    None,
    /// In answer to a question.
    Question,
    /// By itself, where it is set up so.
    Unasked,
    /// The indicator with this number is its voltage, V.
    Indicator(u8),
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
    /// The motor answers no command. Its states are those that it sends by itself.
    pub only_reports: bool,
    /// Number of indicators that the motor reports on request. Their numbers start at 0.
    pub indicators: u8,
    /// The way in which the motor reports its supply.
    pub supply: SupplyReport,
    /// Number of registers that the motor reports on request, and without which it must not start.
    /// Their numbers start at 0.
    pub registers: u8,
    /// The registers are the ends of the codes of position, velocity and torque: no state has a
    /// meaning without them.
    pub scales_by_registers: bool,
    /// A motor that is not yet enabled reports its state by itself, at intervals of several cycles, and
    /// answers commands without it.
    pub reports_stopped_state: bool,
    /// A state that answers a stop confirms the stop, unless the state reports that the motor runs.
    /// Otherwise the motor confirms a stop by a separate message.
    pub state_confirms_stop: bool,
    /// The motor follows the first impedance that it receives, also one from before a loss of power. It
    /// gets none before its start is answered.
    pub runs_without_enable: bool,
}

impl Capabilities {
    /// The abilities of a motor that follows impedances in codes with these scales, and has no other.
    #[must_use]
    pub const fn of_impedances(scales: &Scales) -> Self {
        Self {
            impedance: true,
            position_end: Some(scales.position.max() as f32),
            velocity_end: Some(scales.velocity.max() as f32),
            answers_fault_question: false,
            only_reports: false,
            indicators: 0,
            supply: SupplyReport::None,
            registers: 0,
            scales_by_registers: false,
            reports_stopped_state: false,
            state_confirms_stop: true,
            runs_without_enable: false,
        }
    }
}
