//! The settings of a simulated IMU on a serial line, and the commands that change them. Written
//! from the vendors' documents, without the encoders of the host.

use crate::imu_stream::ImuVendor;

/// Longest command. Longer ones are noise.
const COMMAND_MAX: usize = 300;
/// Xsens: codes of the baud rates (MT low level protocol, SetBaudrate).
const XSENS_BAUDS: [(u8, u32); 11] = [
    (0x00, 460_800),
    (0x01, 230_400),
    (0x02, 115_200),
    (0x04, 57_600),
    (0x05, 38_400),
    (0x07, 19_200),
    (0x09, 9_600),
    (0x0A, 921_600),
    (0x0C, 2_000_000),
    (0x0D, 4_000_000),
    (0x0E, 3_500_000),
];
/// Xsens: the filter has at most this rate, and rates that divide it, Hz.
const XSENS_RATE: u16 = 400;
/// Xsens: the error of a message with wrong data.
const XSENS_PARAMETER_ERROR: u8 = 0x21;

/// The settings of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ImuConfiguration {
    pub(crate) rate_hz: f64,
    pub(crate) baud: u32,
}

/// The part of a device that obeys commands.
#[derive(Debug, Clone)]
pub(crate) struct ImuConsole {
    vendor: ImuVendor,
    /// In effect.
    running: ImuConfiguration,
    /// HiPNUC: set, and not in effect before a restart.
    next_baud: u32,
    /// Kept without power.
    stored: ImuConfiguration,
    /// It sends no samples, and obeys settings.
    is_paused: bool,
    input: Vec<u8>,
}

impl ImuConsole {
    pub(crate) fn new(vendor: ImuVendor, configuration: ImuConfiguration) -> Self {
        let (running, stored) = (configuration, configuration);
        let next_baud = configuration.baud;
        Self { vendor, running, next_baud, stored, is_paused: false, input: Vec::new() }
    }

    /// Returns the settings in effect.
    pub(crate) const fn configuration(&self) -> ImuConfiguration {
        self.running
    }

    /// Returns whether it sends samples.
    pub(crate) const fn is_sending(&self) -> bool {
        !self.is_paused
    }

    /// Loses the power, and gets it again.
    pub(crate) fn restart(&mut self) {
        self.running = self.stored;
        self.next_baud = self.stored.baud;
        self.is_paused = false;
        self.input.clear();
    }

    /// Takes bytes of the host. Returns the answers.
    pub(crate) fn take(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut answers = Vec::new();
        for byte in bytes {
            self.input.push(*byte);
            match self.vendor {
                ImuVendor::Hipnuc => self.hipnuc(&mut answers),
                ImuVendor::Xsens => self.xsens(&mut answers),
            }
            if self.input.len() > COMMAND_MAX {
                self.input.clear();
            }
        }
        answers
    }

    /// HiPNUC: a line of text (command manual). While it sends samples, it obeys only the command
    /// that ends them.
    fn hipnuc(&mut self, answers: &mut Vec<u8>) {
        if self.input.last() != Some(&b'\n') {
            return;
        }
        let line = String::from_utf8_lossy(&core::mem::take(&mut self.input)).trim().to_owned();
        let words: Vec<_> = line.split(' ').collect();
        let done = match words[..] {
            ["LOG", "DISABLE"] => {
                self.is_paused = true;
                true
            }
            _ if !self.is_paused => return,
            ["LOG", "ENABLE"] => {
                self.is_paused = false;
                true
            }
            ["LOG", "HI91", "ONTIME", period] => {
                let periods =
                    ["1", "0.5", "0.2", "0.1", "0.05", "0.02", "0.01", "0.005", "0.004", "0.002", "0.001"];
                let known = periods.contains(&period);
                self.running.rate_hz = match period.parse::<f64>() {
                    Ok(period) if known => 1.0 / period,
                    _ => self.running.rate_hz,
                };
                known
            }
            ["SERIALCONFIG", baud @ ("115200" | "460800" | "921600")] => {
                self.next_baud = baud.parse().unwrap_or(self.next_baud);
                true
            }
            ["SAVECONFIG"] => {
                self.stored = ImuConfiguration { baud: self.next_baud, ..self.running };
                true
            }
            ["REBOOT"] => return self.restart(),
            _ => false,
        };
        answers.extend_from_slice(if done { b"OK\r\n" } else { b"ERR\r\n" });
    }

    /// Xsens: FA FF, message, length, data, checksum (MT low level protocol).
    fn xsens(&mut self, answers: &mut Vec<u8>) {
        let Some(start) = self.input.windows(2).position(|pair| pair == [0xFA, 0xFF]) else { return };
        self.input.drain(..start);
        let &[_, _, message, len, ..] = &self.input[..] else { return };
        let Some(whole) = self.input.get(..usize::from(len) + 5).map(<[u8]>::to_vec) else { return };
        self.input.clear();
        if whole[1..].iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) != 0 {
            return;
        }
        let data = &whole[4..whole.len() - 1];
        match (message, self.is_paused) {
            (0x30, _) => self.is_paused = true,
            (0x10, true) => self.is_paused = false,
            (0x40, _) => self.restart(),
            (0xC0, true) => return self.outputs(data, answers),
            (0x18, true) => match XSENS_BAUDS.iter().find(|row| data == [row.0]) {
                Some(row) => self.stored.baud = row.1,
                None => return answer(answers, 0x42, &[XSENS_PARAMETER_ERROR]),
            },
            _ => return answer(answers, 0x42, &[0x04]),
        }
        answer(answers, message + 1, &[]);
    }

    /// SetOutputConfiguration: takes the nearest rate, and stores it. The simulated device has the
    /// outputs of a complete sample.
    fn outputs(&mut self, data: &[u8], answers: &mut Vec<u8>) {
        let mut taken = data.to_vec();
        for row in taken.chunks_exact_mut(4) {
            let rate = u16::from_be_bytes([row[2], row[3]]);
            let is_measured = [[0x20, 0x10], [0x40, 0x20], [0x80, 0x20]].contains(&[row[0], row[1]]);
            if is_measured && rate > 0 {
                let rates = (1..=XSENS_RATE).filter(|rate| XSENS_RATE.is_multiple_of(*rate));
                let near = rates.min_by_key(|one| one.abs_diff(rate)).unwrap_or(XSENS_RATE);
                row[2..].copy_from_slice(&near.to_be_bytes());
                self.running.rate_hz = near.into();
                self.stored.rate_hz = near.into();
            }
        }
        answer(answers, 0xC1, &taken);
    }
}

/// Appends an Xsens message.
fn answer(answers: &mut Vec<u8>, message: u8, data: &[u8]) {
    let begin = answers.len();
    answers.extend([0xFA, 0xFF, message, data.len() as u8]);
    answers.extend(data);
    let sum = answers[begin + 1..].iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
    answers.push(sum.wrapping_neg());
}

#[cfg(test)]
mod tests {
    use super::*;

    const DELIVERED: ImuConfiguration = ImuConfiguration { rate_hz: 100.0, baud: 115_200 };

    fn console(vendor: ImuVendor) -> ImuConsole {
        ImuConsole::new(vendor, DELIVERED)
    }

    #[test]
    fn hipnuc_keeps_what_was_saved() {
        let mut device = console(ImuVendor::Hipnuc);
        assert_eq!(device.take(b"LOG HI91 ONTIME 0.002\r\n"), b"", "among its own data");
        assert_eq!(device.take(b"LOG DISABLE\r\n"), b"OK\r\n");
        assert!(!device.is_sending());
        assert_eq!(device.take(b"LOG HI91 ONTIME 0.003\r\n"), b"ERR\r\n");
        assert_eq!(device.take(b"LOG HI91 ONTIME 0.002\r\nSERIALCONFIG 921600\r\n"), b"OK\r\nOK\r\n");
        assert_eq!(device.configuration(), ImuConfiguration { rate_hz: 500.0, baud: 115_200 });
        let mut unsaved = device.clone();
        unsaved.restart();
        assert_eq!(unsaved.configuration(), DELIVERED);
        assert_eq!(device.take(b"SAVECONFIG\r\nREBOOT\r\n"), b"OK\r\n");
        assert_eq!(device.configuration(), ImuConfiguration { rate_hz: 500.0, baud: 921_600 });
        assert!(device.is_sending());
    }

    /// By hand: FF+C0+04+20+10+01+90 = 0x284, so the checksum is 0x7C; the answer has 0xC1, so
    /// 0x7B. 350 Hz is nearer to 400 than to 200.
    #[test]
    fn xsens_uses_the_nearest_rate() {
        let mut device = console(ImuVendor::Xsens);
        assert_eq!(device.take(&[0xFA, 0xFF, 0x30, 0, 0xD1]), [0xFA, 0xFF, 0x31, 0, 0xD0]);
        let set = [0xFA, 0xFF, 0xC0, 4, 0x20, 0x10, 0x01, 0x90, 0x7C];
        assert_eq!(device.take(&set), [0xFA, 0xFF, 0xC1, 4, 0x20, 0x10, 0x01, 0x90, 0x7B]);
        // 350 = 0x015E: FF+C0+04+20+10+01+5E = 0x252.
        let near = [0xFA, 0xFF, 0xC0, 4, 0x20, 0x10, 0x01, 0x5E, 0xAE];
        assert_eq!(device.take(&near), [0xFA, 0xFF, 0xC1, 4, 0x20, 0x10, 0x01, 0x90, 0x7B]);
        // 0x0A is 921600: FF+18+01+0A = 0x122.
        assert_eq!(device.take(&[0xFA, 0xFF, 0x18, 1, 0x0A, 0xDE]), [0xFA, 0xFF, 0x19, 0, 0xE8]);
        assert_eq!(device.configuration().baud, 115_200);
        device.take(&[0xFA, 0xFF, 0x40, 0, 0xC1]);
        assert_eq!(device.configuration(), ImuConfiguration { rate_hz: 400.0, baud: 921_600 });
        assert_eq!(device.take(&set)[2], 0x42, "only in the state for settings");
    }
}
