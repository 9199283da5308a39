//! The names of native commands in JSON.

use motord_protocol::gim::CommandCode;

const KINDS: [(CommandCode, &str); CommandCode::ALL.len()] = [
    (CommandCode::ResetConfiguration, "reset_configuration"),
    (CommandCode::RefreshConfiguration, "refresh_configuration"),
    (CommandCode::ModifyConfiguration, "modify_configuration"),
    (CommandCode::RetrieveConfiguration, "retrieve_configuration"),
    (CommandCode::StartMotor, "start_motor"),
    (CommandCode::StopMotor, "stop_motor"),
    (CommandCode::TorqueControl, "torque_control"),
    (CommandCode::SpeedControl, "speed_control"),
    (CommandCode::PositionControl, "position_control"),
    (CommandCode::PtsControl, "pts_control"),
    (CommandCode::StopControl, "stop_control"),
    (CommandCode::ModifyParameter, "modify_parameter"),
    (CommandCode::RetrieveParameter, "retrieve_parameter"),
    (CommandCode::GetVersion, "get_version"),
    (CommandCode::GetFault, "get_fault"),
    (CommandCode::AcknowledgeFault, "acknowledge_fault"),
    (CommandCode::RetrieveIndicator, "retrieve_indicator"),
    (CommandCode::Calibration, "calibration"),
    (CommandCode::UpdateFirmware, "update_firmware"),
];

/// A command that is not in the vendor's list.
pub(super) const UNKNOWN: &str = "unknown";

/// The name of the command that begins with this byte.
pub(super) fn name(byte: u8) -> &'static str {
    KINDS.iter().find(|(code, _)| *code as u8 == byte).map_or(UNKNOWN, |(_, name)| name)
}

/// The command with this name.
pub(super) fn code(name: &str) -> Option<CommandCode> {
    KINDS.iter().find(|(_, known)| *known == name).map(|(code, _)| *code)
}
