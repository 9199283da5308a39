//! The options for reading frames: protocol, direction, constants.

use crate::scale::Scale;
use clap::{Args, ValueEnum};
use motord_configuration::vendors::register_beside;
use motord_protocol::{Model, MotorProtocol, Profile, ScaleError, gim, mit};
use std::path::Path;
use std::str::FromStr;

/// The configuration beside which other motors are looked for.
const CONFIGURATION: &str = "/etc/motord/motord.toml";

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum FrameProtocol {
    /// Impedance control over CAN.
    Mit,
    /// GIM commands over CAN.
    GimCan,
    /// GIM commands over RS485 and RS232.
    GimRs485,
}

impl FrameProtocol {
    /// Returns the frames of a motor on a CAN bus; `None` for a family that this command does not decode.
    pub(super) fn over_can(protocol: MotorProtocol) -> Option<Self> {
        let name = protocol.family().name;
        let families = [(mit::FAMILY.name, Self::Mit), (gim::FAMILY.name, Self::GimCan)];
        families.into_iter().find_map(|(family, frames)| (family == name).then_some(frames))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Direction {
    /// Commands from the host to a motor.
    #[value(alias = "to_motor")]
    ToMotor,
    /// Replies from a motor to the host.
    #[value(alias = "to_host")]
    ToHost,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum AnsweredCommand {
    /// Any command that is not in this list.
    State,
    /// Get fault: the MIT reply holds the fault number.
    #[value(alias = "get-fault")]
    GetFault,
    /// Clear fault: the MIT reply holds no data.
    #[value(alias = "clear-fault")]
    ClearFault,
    /// Calibration: a GIM reply that begins with B4 is its result, not an indicator.
    Calibration,
}

/// The scale of the torque codes.
#[derive(Debug, Args)]
pub(super) struct Constants {
    /// Torque constant of the rotor, N·m/A. Without it and without a model, torques are raw codes.
    #[arg(long, value_name = "X", requires = "gear_ratio")]
    torque_constant: Option<f64>,
    /// Rotor turns per turn of the output shaft.
    #[arg(long, value_name = "Y", requires = "torque_constant")]
    gear_ratio: Option<f64>,
    /// Vendor profile of the MIT protocol (steadywin and others), or a motor model (GIM8108-8). A model also gives codes
    /// their physical values.
    #[arg(long, value_name = "NAME", default_value = "steadywin")]
    pub(super) profile: Facts,
}

/// A profile, selected by its own name or by a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facts {
    pub(super) profile: &'static Profile,
    model: Option<&'static Model>,
}

impl FromStr for Facts {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let is_known = Profile::by_name(name).is_some() || Profile::of_model(name).is_some();
        if !is_known && let Err(problems) = register_beside(Path::new(CONFIGURATION)) {
            return Err(problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"));
        }
        if let Some(profile) = Profile::by_name(name) {
            return Ok(Self { profile, model: None });
        }
        let model = Profile::of_model(name).map(|(profile, model)| Self { profile, model: Some(model) });
        model.ok_or_else(|| {
            let names: Vec<_> = Profile::all().map(|profile| profile.name).collect();
            format!("expected a motor model, or one of the profiles {}", names.join(", "))
        })
    }
}

impl Constants {
    /// Returns the scale of the codes; `None` where neither constants nor a model were given.
    pub(super) fn scale(&self) -> Result<Option<Scale>, ScaleError> {
        match (self.torque_constant.zip(self.gear_ratio), self.profile.model) {
            (Some((constant, ratio)), Some(model)) => Scale::of_model(model, constant, ratio).map(Some),
            (Some((constant, ratio)), None) => Scale::new(constant, ratio).map(Some),
            (None, Some(model)) => {
                let (constant, ratio) = (model.torque_constant.into(), model.gear_ratio.into());
                Scale::of_model(model, constant, ratio).map(Some)
            }
            (None, None) => Ok(None),
        }
    }
}
