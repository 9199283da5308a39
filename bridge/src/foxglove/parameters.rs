//! The parameters: the description of the robot, read-only.

use crate::urdf;
use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, ParameterType, ParameterValue,
    SetParametersResponder,
};
use motord_client::RobotDescription;
use std::collections::HashSet;
use std::path::Path;

/// The parameters, which have the same values until the bridge ends.
#[derive(Debug)]
pub(crate) struct ReadOnly(Vec<Parameter>);

/// Returns the parameters of `robot`, with the file `urdf`.
pub(crate) fn all(robot: &RobotDescription, urdf: Option<&Path>) -> Result<ReadOnly, String> {
    let mut parameters = vec![
        text("/motord/instance", &robot.instance),
        text("/motord/version", &robot.version),
        number("/motord/rate_hz", robot.rate_hz),
        number("/motord/setpoint_timeout_s", robot.setpoint_timeout.as_secs_f64()),
    ];
    for joint in &robot.joints {
        let limits = &joint.limits;
        for (limit, value) in [
            ("position_min_rad", limits.position[0]),
            ("position_max_rad", limits.position[1]),
            ("velocity_max_rad_s", limits.velocity),
            ("torque_max_nm", limits.torque),
            ("kp_max", limits.kp),
            ("kd_max", limits.kd),
        ] {
            parameters.push(number(&format!("/motord/joints/{}/{limit}", joint.name), value.into()));
        }
    }
    if let Some(path) = urdf {
        parameters.push(text("/robot_description", &urdf::read(path)?));
    }
    Ok(ReadOnly(parameters))
}

fn text(name: &str, value: &str) -> Parameter {
    let value = Some(ParameterValue::String(value.to_owned()));
    Parameter { name: name.to_owned(), r#type: None, value }
}

fn number(name: &str, value: f64) -> Parameter {
    let value = Some(ParameterValue::Float64(value));
    Parameter { name: name.to_owned(), r#type: Some(ParameterType::Float64), value }
}

impl ReadOnly {
    /// Returns the parameters with these names, each once; all without names.
    fn named<'a>(&self, names: impl Iterator<Item = &'a str>) -> Vec<Parameter> {
        let names: HashSet<&str> = names.collect();
        let is_named = |parameter: &&Parameter| names.is_empty() || names.contains(parameter.name.as_str());
        self.0.iter().filter(is_named).cloned().collect()
    }
}

impl ParameterHandler for ReadOnly {
    fn get(
        &self,
        _client: AnyClient,
        names: Vec<String>,
        _request: Option<String>,
        responder: GetParametersResponder,
    ) {
        responder.respond(self.named(names.iter().map(String::as_str)));
    }

    /// Answers with the values as they are.
    fn set(
        &self,
        client: AnyClient,
        parameters: Vec<Parameter>,
        _request: Option<String>,
        responder: SetParametersResponder,
    ) {
        client.send_warning("the parameters of motord cannot be set: change its configuration");
        responder.respond(self.named(parameters.iter().map(|parameter| parameter.name.as_str())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{JointDescription, JointLimits};

    #[test]
    fn limits_and_urdf_are_parameters() {
        let limits = JointLimits { position: [-1.0, 2.0], ..JointLimits::default() };
        let joint = JointDescription { name: "knee".to_owned(), limits, ..JointDescription::default() };
        let robot = RobotDescription { joints: vec![joint], ..RobotDescription::default() };
        let urdf = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
        let parameters = all(&robot, Some(Path::new(urdf))).unwrap();
        let names = ["/motord/joints/knee/position_max_rad", "/robot_description", "unknown"];
        let [limit, urdf] = &parameters.named(names.into_iter())[..] else { panic!("{parameters:?}") };
        assert_eq!(limit.value, Some(ParameterValue::Float64(2.0)));
        assert!(matches!(&urdf.value, Some(ParameterValue::String(text)) if text.contains("[package]")));
        assert_eq!(parameters.named(std::iter::empty()).len(), parameters.0.len());
    }
}
