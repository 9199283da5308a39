//! The drive of a vendor, from its profile to the facts of the simulator, which shares no type with
//! it.

use motord_protocol::Faults;
use motord_protocol::profile::{FaultReply, FaultReport, Healthy, Profile, Status, Temperature};
use motord_simulator::{DriveFacts, FaultFacts, TemperatureFacts};

/// The part whose temperature is that of the winding.
const WINDING: &str = "motor";

/// Returns the facts of a vendor's drive.
pub(crate) fn drive(profile: &Profile) -> DriveFacts {
    let special = profile.special;
    let named = |faults: &[Faults]| {
        let number = profile.fault_numbers().find(|(_, known)| faults.contains(known));
        number.map_or(0, |(number, _)| number)
    };
    DriveFacts {
        start: special.start,
        stop: special.stop,
        zero: special.zero,
        clear: special.clear,
        bytes: profile.reply.lengths[0],
        id_bits: profile.reply.id_mask,
        temperatures: profile.reply.temperatures.iter().map(temperature).collect(),
        faults: faults(&profile.faults),
        conditions: [
            named(&[Faults::OVER_VOLTAGE]),
            named(&[Faults::UNDER_VOLTAGE]),
            named(&[Faults::OVER_TEMPERATURE, Faults::MOTOR_OVER_TEMPERATURE]),
        ],
        has_registers: profile.has_registers,
    }
}

fn temperature(field: &Temperature) -> TemperatureFacts {
    TemperatureFacts {
        of_winding: field.of == WINDING,
        byte: field.at,
        bits: field.bits,
        codes_per_ten: (10.0 * field.per_celsius).round() as u32,
    }
}

fn faults(report: &FaultReport) -> FaultFacts {
    match *report {
        FaultReport::Asked(FaultReply { bytes: number, lengths: [bytes, _], .. }) => {
            FaultFacts::Asked { number, bytes }
        }
        FaultReport::InEveryReply(Status { at: byte, shift, healthy, .. }) => {
            let healthy = match healthy {
                Healthy::Mode { off, on } => [off, on],
                Healthy::Code(code) => [code; 2],
            };
            FaultFacts::Code { byte, shift, healthy }
        }
        FaultReport::Never => FaultFacts::Never,
    }
}
