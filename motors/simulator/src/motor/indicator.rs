//! The answers to retrieve indicator (GIM document, table 10), from the same mechanics as all other
//! answers.

use super::Motor;
use super::configuration::rpm;
use crate::body::COPPER_LOSS;
use core::f64::consts::TAU;

/// Share of the winding's temperature rise that reaches the driver board.
const BOARD_RISE: f64 = 0.3;

impl Motor {
    /// Returns an indicator in the units of the table; `None` for an id that is not in the table.
    /// The d axis carries no current.
    pub(super) fn indicator(&self, id: u8) -> Option<f32> {
        let iq = self.q_current();
        let (sin, cos) = self.electrical_angle().sin_cos();
        let (i_alpha, i_beta) = (-iq * sin, iq * cos);
        let half_beta = i_beta * 3.0_f64.sqrt() / 2.0;
        let (vd, vq) = self.dq_voltage();
        let value = match id {
            0x00 => self.supply,
            0x01 => self.board_temperature(),
            0x02 => self.body.winding,
            0x03 => self.electrical_power(),
            0x04 | 0x07 => i_alpha,
            0x05 => -i_alpha / 2.0 + half_beta,
            0x06 => -i_alpha / 2.0 - half_beta,
            0x08 => i_beta,
            0x09 | 0x0B => iq,
            0x0A | 0x0C => 0.0,
            0x0D => vq,
            0x0E => vd,
            0x0F => vd * cos - vq * sin,
            0x10 => vd * sin + vq * cos,
            0x11 => self.electrical_angle(),
            0x12 => self.rotor_angle().rem_euclid(TAU),
            0x13 => self.position(),
            0x14 => rpm(self.body.velocity),
            0x15 => self.body.torque * self.body.velocity,
            _ => return None,
        };
        Some(value as f32)
    }

    /// Returns the power that the drive draws, W: that of the shaft, and the loss of the winding.
    pub(super) fn electrical_power(&self) -> f64 {
        let iq = self.q_current();
        let copper_loss = COPPER_LOSS * self.settings.winding_resistance * iq * iq;
        self.body.torque * self.body.velocity + copper_loss
    }

    /// Returns the temperature of the board, °C.
    pub(super) fn board_temperature(&self) -> f64 {
        let air = self.settings.ambient_celsius;
        air + BOARD_RISE * (self.body.winding - air)
    }

    fn rotor_angle(&self) -> f64 {
        self.body.position * self.settings.gear_ratio
    }

    fn electrical_angle(&self) -> f64 {
        (self.rotor_angle() * f64::from(self.settings.pole_pairs)).rem_euclid(TAU)
    }

    /// Returns the steady-state voltages of a machine without saliency, per phase, V.
    fn dq_voltage(&self) -> (f64, f64) {
        let iq = self.q_current();
        let rotor_velocity = self.body.velocity * self.settings.gear_ratio;
        let electrical = rotor_velocity * f64::from(self.settings.pole_pairs);
        let (resistance, inductance) =
            (self.settings.winding_resistance / 2.0, self.settings.winding_inductance / 2.0);
        let back_emf = self.settings.back_emf() * rotor_velocity;
        (-electrical * inductance * iq, resistance * iq + back_emf)
    }
}
