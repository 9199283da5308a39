//! An MIT drive that its facts describe, for a vendor without a drive of its own here.
//!
//! The facts are those of the vendor's file, which the host reads as well: an error in the file is in
//! both, and no test on a simulated bus finds it. The encoder and the decoder are separate.

use super::drive::{Answer, Asked, Drive, Status, bits};
use crate::drive_facts::{DriveFacts, FaultFacts, TemperatureFacts};
use crate::settings::RobStrideFirmware;
use crate::wire::{Control, MitCommand};
use motord_bus::Frame;

impl DriveFacts {
    fn decode(&self, payload: &[u8]) -> Option<MitCommand> {
        let is = |frame: &[u8; 8]| payload == frame;
        Some(match payload {
            _ if is(&self.start) => MitCommand::Start,
            _ if is(&self.stop) => MitCommand::Stop,
            _ if is(&self.zero) => MitCommand::SetZero,
            _ if self.clear.as_ref().is_some_and(is) => MitCommand::ClearFault,
            [0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, other, 0xFB]
                if *other != 0xFF && matches!(self.faults, FaultFacts::Asked { .. }) =>
            {
                MitCommand::GetFault
            }
            _ => MitCommand::Control(Control::decode(payload)?),
        })
    }

    fn answer(&self, answer: &Answer) -> Frame {
        let mut payload = [0; 8];
        payload[0] = answer.id & self.id_bits;
        if let (Asked::Fault, FaultFacts::Asked { number, bytes }) = (answer.asked, self.faults) {
            payload[1..=number].copy_from_slice(&answer.fault.to_le_bytes()[..number]);
            return frame(answer, &payload[..bytes]);
        }
        payload[1..6].copy_from_slice(&answer.state.mit());
        for temperature in &self.temperatures {
            temperature.write(answer.temperatures, &mut payload);
        }
        if let FaultFacts::Code { byte, shift, healthy: [stopped, running] } = self.faults {
            let code = match answer.status {
                Status::Fault => answer.fault as u8,
                Status::On => running,
                Status::Off => stopped,
            };
            payload[byte] |= code << shift;
        }
        frame(answer, &payload[..self.bytes])
    }
}

impl TemperatureFacts {
    fn write(&self, [winding, board]: [f64; 2], payload: &mut [u8; 8]) {
        let celsius = if self.of_winding { winding } else { board };
        let code = (celsius * f64::from(self.codes_per_ten) / 10.0).round() as i32 as u32;
        let code = code & ((1 << self.bits) - 1);
        match self.bits {
            8 => payload[self.byte] = code as u8,
            _ => {
                payload[self.byte] |= (code / 256) as u8;
                payload[self.byte + 1] = code as u8;
            }
        }
    }
}

fn frame(answer: &Answer, payload: &[u8]) -> Frame {
    Frame::new(answer.host_id, payload).unwrap_or(Frame::EMPTY)
}

/// The drive of a simulated motor.
#[derive(Debug, Clone)]
pub(crate) enum AnyDrive {
    /// Written from its vendor's sources.
    Written(&'static Drive),
    /// By facts.
    Described(DriveFacts),
}

impl AnyDrive {
    /// Decodes a payload as the motor does; `None` for one that the motor ignores.
    pub(crate) fn decode(&self, payload: &[u8]) -> Option<MitCommand> {
        match self {
            Self::Written(drive) => (drive.decode)(payload),
            Self::Described(facts) => facts.decode(payload),
        }
    }

    /// Returns the frame of an answer.
    pub(crate) fn answer(&self, answer: &Answer) -> Frame {
        match self {
            Self::Written(drive) => (drive.answer)(answer),
            Self::Described(facts) => facts.answer(answer),
        }
    }

    /// Returns whether a drive in fault answers every request, whatever the other settings are.
    pub(crate) fn answers_in_fault(&self, firmware: RobStrideFirmware) -> bool {
        match self {
            Self::Written(drive) => (drive.answers_in_fault)(firmware),
            Self::Described(facts) => !matches!(facts.faults, FaultFacts::Asked { .. }),
        }
    }

    /// Returns the vendor's numbers of over-voltage, under-voltage and over-temperature.
    pub(crate) fn conditions(&self) -> [u32; 3] {
        match self {
            Self::Written(drive) => drive.conditions,
            Self::Described(facts) => facts.conditions,
        }
    }

    /// Returns the fault number of a drive that has the first fault and raises the second.
    pub(crate) fn raise(&self, known: u32, raised: u32) -> u32 {
        match self {
            Self::Written(drive) => (drive.raise)(known, raised),
            Self::Described(DriveFacts { faults: FaultFacts::Asked { .. }, .. }) => bits(known, raised),
            Self::Described(DriveFacts { faults: FaultFacts::Code { healthy, .. }, .. }) => {
                let is_fault = !healthy.iter().any(|code| u32::from(*code) == raised);
                if known == 0 && is_fault { raised } else { known }
            }
            Self::Described(_) if known == 0 => raised,
            Self::Described(_) => known,
        }
    }

    /// Returns whether it has the registers of a Damiao drive.
    pub(crate) fn has_registers(&self, vendor: &str) -> bool {
        match self {
            Self::Written(_) => vendor == "damiao",
            Self::Described(facts) => facts.has_registers,
        }
    }
}
