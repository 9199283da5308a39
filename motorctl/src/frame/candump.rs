//! A line of a `candump -L` log.

use crate::frame::hex;
use crate::frame::refused::Refused;

/// A data frame in a log, such as `(1436509052.249713) vcan0 044#2A366C2BBA`.
#[derive(Debug, PartialEq)]
pub(super) struct LogLine<'a> {
    /// When it was on the bus, s.
    pub(super) time: f64,
    /// Where.
    pub(super) interface: &'a str,
    /// Its 11-bit id.
    pub(super) id: u16,
    pub(super) payload: Vec<u8>,
}

impl<'a> LogLine<'a> {
    pub(super) fn parse(line: &'a str) -> Result<Self, Refused> {
        let mut words = line.split_whitespace();
        let mut word = || words.next().ok_or(Refused::LogLine);
        let time = word()?.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
        let time = time.and_then(|time| time.parse().ok()).ok_or(Refused::LogLine)?;
        let interface = word()?;
        let (id, data) = word()?.split_once('#').ok_or(Refused::LogLine)?;
        // Extended and error frames have eight digits, remote frames an R, and CAN FD a second #.
        if id.len() != 3 || data.starts_with(['R', '#']) {
            return Err(Refused::Foreign);
        }
        let id = u16::from_str_radix(id, 16).ok().filter(|id| *id <= 0x7FF).ok_or(Refused::LogLine)?;
        Ok(Self { time, interface, id, payload: hex::bytes(data)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_line_is_read_with_and_without_a_direction_mark() {
        let expected =
            LogLine { time: 1436509052.249713, interface: "vcan0", id: 0x044, payload: vec![0x2A, 0x36] };
        assert_eq!(LogLine::parse("(1436509052.249713) vcan0 044#2A36").unwrap(), expected);
        assert_eq!(LogLine::parse("(1436509052.249713)  vcan0  044#2A36 R").unwrap(), expected);
    }

    #[test]
    fn frames_that_no_motor_sends_are_told_from_lines_that_are_no_log() {
        for foreign in ["20000040#0000000000000000", "12345678#00", "044#R", "044##100"] {
            assert!(matches!(LogLine::parse(&format!("(0.0) can0 {foreign}")), Err(Refused::Foreign)));
        }
        for nonsense in ["", "can0 044#", "(0.0) can0", "(x) can0 044#", "(0.0) can0 04G#", "(0.0) can0 800#"]
        {
            assert!(matches!(LogLine::parse(nonsense), Err(Refused::LogLine)), "{nonsense}");
        }
        assert!(matches!(LogLine::parse("(0.0) can0 044#2"), Err(Refused::Hex { .. })));
    }
}
