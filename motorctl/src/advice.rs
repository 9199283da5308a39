//! Instructions for the operator of a stopped group.

use motord_client::Cause;

/// The next steps of the operator after a stop with this `cause`, in a group named `group`.
pub(crate) fn advice(cause: Option<Cause>, group: &str) -> String {
    let remedy = cause.map_or("Install motorctl and motord from one version", remedy);
    format!("{remedy}. Then: motorctl reset {group}, and enable it.")
}

fn remedy(cause: Cause) -> &'static str {
    match cause {
        Cause::SetpointTimeout | Cause::OwnerLost => "Start the controller again",
        Cause::EmergencyStop => "Make sure that the danger is over",
        Cause::MotorLost => "Check the motor's power, its CAN cable and its id",
        Cause::MotorFault => {
            "See its faults in motorctl status, remove their cause, and motorctl fault clear JOINT"
        }
        Cause::TimeBase | Cause::Overload => {
            "Free the computer of other load, or pin the cycle to its own processor"
        }
        Cause::BusOff => "Check the wiring, the termination and the bit rate of the bus",
        Cause::BusGone => "Plug the adapter in, bring the interface up",
        Cause::TransmitStall => {
            "Check that a motor on the bus has power: without one nobody acknowledges a frame"
        }
        Cause::Implausible | Cause::EncoderStuck => "Check the motor's encoder and cable",
        Cause::Overspeed | Cause::FollowingError => {
            "Check the controller's setpoints and that the joint moves freely"
        }
        Cause::DuplicateId => "Unplug all motors of the bus but one and give each its own id",
        Cause::OverTemperature => "Let the motor cool down",
        Cause::Shutdown => "Start the daemon again",
        Cause::StartFailed => "Check the motor's power and that its protocol is the configured one",
        Cause::Suspended => "Keep the computer from suspending",
        Cause::RangeEnd => "Turn the joint back to the middle of its range by hand",
    }
}
