//! A line of a GPIO chip, at the kernel's character device (uAPI v2).

use crate::config::{Gpio, RunLevel};
use gpiocdev_uapi::v2::{
    LineConfig, LineFlags, LineRequest, LineValues, Name, Offsets, get_line, get_line_values,
};
use std::fs::File;
use std::io;

/// The name under which `gpioinfo` lists the owner of the line.
const CONSUMER: &[u8] = b"motord-bridge";

/// A requested line. Dropping it gives it back.
#[derive(Debug)]
pub(crate) struct Line {
    file: File,
    run_level: RunLevel,
}

/// Returns the flags of an input whose open circuit has the other level than the closed one.
fn flags(run_level: RunLevel) -> LineFlags {
    let bias = match run_level {
        RunLevel::Low => LineFlags::BIAS_PULL_UP,
        RunLevel::High => LineFlags::BIAS_PULL_DOWN,
    };
    LineFlags::INPUT | bias
}

fn of_uapi(error: gpiocdev_uapi::Error) -> io::Error {
    match error {
        gpiocdev_uapi::Error::Os(errno) => io::Error::from_raw_os_error(errno.0),
        error => io::Error::other(error),
    }
}

impl Line {
    /// Requests the line as an input. The error is a sentence that says what to do.
    pub(crate) fn request(gpio: &Gpio) -> Result<Self, String> {
        let (chip, number) = (gpio.chip.display(), gpio.line.unwrap_or_default());
        let file = File::open(&gpio.chip).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => {
                format!(
                    "there is no {chip}: connect the chip, or correct gpio.chip; `gpiodetect` lists the chips"
                )
            }
            io::ErrorKind::PermissionDenied => {
                format!("no permission for {chip}: docs/gpio.md has the rule and the drop-in of the unit")
            }
            _ => format!("cannot open {chip}: {error}"),
        })?;
        let request = LineRequest {
            offsets: Offsets::from_slice(&[number]),
            num_lines: 1,
            consumer: Name::from_bytes(CONSUMER),
            config: LineConfig { flags: flags(gpio.run_level), ..LineConfig::default() },
            ..LineRequest::default()
        };
        let file = get_line(&file, request).map_err(of_uapi).map_err(|error| match error.kind() {
            io::ErrorKind::InvalidInput => {
                format!("{chip} has no line {number}: correct gpio.line; `gpioinfo` lists the lines")
            }
            io::ErrorKind::ResourceBusy => {
                format!("line {number} of {chip} is in use: `gpioinfo` names the program; end it, or set another gpio.line")
            }
            _ => format!("cannot use line {number} of {chip}: {error}"),
        })?;
        Ok(Self { file, run_level: gpio.run_level })
    }

    /// Returns `true` if the line has the level of the closed circuit. May block as long as the driver does.
    pub(crate) fn is_closed(&self) -> io::Result<bool> {
        let mut values = LineValues { bits: 0, mask: 1 };
        get_line_values(&self.file, &mut values).map_err(of_uapi)?;
        Ok((values.bits & 1 == 1) == (self.run_level == RunLevel::High))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_circuit_is_pulled_to_stop() {
        assert_eq!(flags(RunLevel::Low), LineFlags::INPUT | LineFlags::BIAS_PULL_UP);
        assert_eq!(flags(RunLevel::High), LineFlags::INPUT | LineFlags::BIAS_PULL_DOWN);
    }

    #[test]
    fn chip_that_is_none_is_a_sentence() {
        let error = |chip: &str| {
            Line::request(&Gpio { chip: chip.into(), line: Some(3), ..Gpio::default() }).unwrap_err()
        };
        assert!(error("/dev/gpiochip99").contains("gpio.chip"));
        assert!(error("/dev/null").contains("line 3 of /dev/null"));
    }
}
