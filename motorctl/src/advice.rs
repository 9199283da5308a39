//! Instructions for the operator of a stopped group.

use motord_client::Cause;

/// The next steps of the operator after a stop with this `cause`, in a group named `group`.
pub(crate) fn advice(cause: Option<Cause>, group: &str) -> String {
    let remedy = cause.map_or("Install the same version of motorctl and motord", remedy);
    format!("{remedy}. Then run `motorctl reset {group}` and `motorctl enable {group}`.")
}

fn remedy(cause: Cause) -> &'static str {
    match cause {
        Cause::SetpointTimeout | Cause::OwnerLost => "Start the controller again",
        Cause::EmergencyStop => "Make sure that the robot may move safely",
        Cause::MotorLost => "Check the motor's power, its CAN cable and its id",
        Cause::MotorFault => {
            "Find the faults in `motorctl status`, remove their cause, and run `motorctl fault clear JOINT`"
        }
        Cause::TimeBase | Cause::Overload => {
            "Reduce the other load of the computer, or give the cycle a processor of its own"
        }
        Cause::BusOff => "Check the wiring, the termination and the bit rate of the bus",
        Cause::BusGone => "Plug in the adapter, and bring the interface up",
        Cause::TransmitStall => {
            "Check that a motor on the bus has power: a CAN frame must be acknowledged by another node"
        }
        Cause::Implausible | Cause::EncoderStuck => "Check the motor's encoder and cable",
        Cause::Overspeed | Cause::FollowingError => {
            "Check the controller's setpoints and that the joint moves freely"
        }
        Cause::DuplicateId => "Connect the motors of the bus one at a time, and give each its own id",
        Cause::OverTemperature => "Let the motor cool down",
        Cause::Shutdown => "Start the daemon again",
        Cause::StartFailed => "Check the motor's power, and that it uses the configured protocol",
        Cause::Suspended => "Disable suspension of the computer",
        Cause::MotorOff => "Check the motor's supply: it may have started anew",
        Cause::RangeEnd => "Turn the joint by hand to the middle of its range",
    }
}
