//! Vendors' MIT drives, from the motor's side of the wire.
//!
//! Each is written from its vendor's sources, without the host's codec or its profiles, so that one
//! error cannot hide in both. Both are tested with the same golden frames. To add a vendor, write a
//! file like [`steadywin`]'s, and add a line to [`DRIVES`]. Without one, [`DriveFacts`] describe the
//! drive.

mod cubemars;
mod damiao;
mod described;
mod drive;
mod myactuator;
mod odrive;
mod robstride;
mod steadywin;

pub(crate) use described::AnyDrive;
pub(crate) use drive::{Answer, Asked, Drive, Status};

use crate::drive_facts::DriveFacts;

/// All supported vendors.
const DRIVES: &[&Drive] =
    &[&steadywin::DRIVE, &damiao::DRIVE, &robstride::DRIVE, &cubemars::DRIVE, &myactuator::DRIVE];

/// Vendors whose drives speak no MIT.
const OTHERS: &[&Drive] = &[&odrive::DRIVE];

impl AnyDrive {
    /// Returns the drive of `vendor`: the one that is written for it, or one by these facts.
    ///
    /// # Panics
    ///
    /// When there is neither. The author of the settings must notice it before a robot is tested
    /// with them.
    pub(crate) fn of(vendor: &str, facts: Option<&DriveFacts>) -> Self {
        let written = DRIVES.iter().chain(OTHERS).find(|drive| drive.name == vendor);
        let drive = written.map(|drive| Self::Written(drive));
        let drive = drive.or_else(|| facts.cloned().map(Self::Described));
        drive.unwrap_or_else(|| panic!("no simulated drive of the vendor {vendor}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::RobStrideFirmware;
    use crate::wire::{MitCommand, State};
    use motord_bus::FrameId;

    const HEADER: &str =
        "direction,kind,model,hex,id,position,velocity,kp,kd,torque,temperatures,faults,source";

    /// Returns the golden frames of the host's profile of this vendor, which were computed by hand.
    fn golden(drive: &Drive) -> Vec<Vec<String>> {
        let directory = concat!(env!("CARGO_MANIFEST_DIR"), "/../protocol/tests/golden");
        let text = std::fs::read_to_string(format!("{directory}/{}.csv", drive.name)).unwrap();
        let (header, rows) = text.split_once('\n').unwrap();
        assert_eq!(header, HEADER);
        rows.lines().map(|row| row.split(',').map(|column| column.trim().to_owned()).collect()).collect()
    }

    fn unhex(digits: &str) -> Vec<u8> {
        let pairs = digits.as_bytes().chunks(2);
        pairs.map(|pair| u8::from_str_radix(core::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
    }

    fn is_kind(command: MitCommand, kind: &str) -> bool {
        matches!(
            (command, kind),
            (MitCommand::Start, "start")
                | (MitCommand::Stop, "stop")
                | (MitCommand::SetZero, "zero")
                | (MitCommand::ClearFault, "clear")
                | (MitCommand::GetFault, "ask")
                | (MitCommand::Control(_), "control")
        )
    }

    #[test]
    fn golden_commands_mean_to_drive_as_sourced() {
        for drive in DRIVES {
            for row in golden(drive).iter().filter(|row| row[0] == "to-motor") {
                let command = (drive.decode)(&unhex(&row[3])).unwrap();
                assert!(is_kind(command, &row[1]), "{row:?}: {command:?}");
            }
        }
    }

    #[test]
    fn every_golden_state_is_sent_as_those_bytes() {
        for drive in DRIVES {
            for row in golden(drive).iter().filter(|row| row[1] == "state" && row[11].is_empty()) {
                let bytes = unhex(&row[3]);
                let code = |high: u8, low: u8| u16::from_be_bytes([high, low]);
                let state = State {
                    position: code(bytes[1], bytes[2]),
                    velocity: code(bytes[3], bytes[4]) >> 4,
                    torque: code(bytes[4] & 0x0F, bytes[5]),
                };
                let mut celsius = row[10].split_whitespace().map(|number| number.parse().unwrap());
                // The temperature of the board is first where both are sent.
                let (first, second) = (celsius.next().unwrap_or(0.0), celsius.next());
                let temperatures = [second.unwrap_or(first), first];
                let id = row[4].parse().unwrap();
                let (status, firmware) = match bytes.get(6).map(|byte| byte >> 4) {
                    Some(0x8) if drive.name == "robstride" => (Status::On, RobStrideFirmware::Manual2026),
                    Some(0x2) if drive.name == "robstride" => (Status::Fault, RobStrideFirmware::Manual2026),
                    _ if bytes[0] == id => (Status::Off, RobStrideFirmware::Manual2025),
                    _ => (Status::On, RobStrideFirmware::Manual2025),
                };
                let answer = Answer {
                    asked: Asked::State,
                    host_id: FrameId::MAX,
                    id,
                    state,
                    status,
                    fault: 0,
                    temperatures,
                    firmware,
                    filler: [0; 8],
                };
                assert_eq!((drive.answer)(&answer).payload(), bytes, "{row:?}");
            }
        }
    }

    #[test]
    fn every_golden_fault_is_sent_as_those_bytes() {
        for drive in DRIVES {
            for row in golden(drive).iter().filter(|row| row[1] == "fault") {
                let bytes = unhex(&row[3]);
                let number = bytes[1..5].iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte));
                let state = State { position: 0, velocity: 0, torque: 0 };
                let (id, status) = (row[4].parse().unwrap(), Status::Fault);
                let answer = Answer {
                    asked: Asked::Fault,
                    host_id: FrameId::MAX,
                    id,
                    state,
                    status,
                    fault: number,
                    temperatures: [0.0; 2],
                    firmware: RobStrideFirmware::Manual2026,
                    filler: [0; 8],
                };
                assert_eq!((drive.answer)(&answer).payload(), bytes, "{row:?}");
            }
        }
    }
}
