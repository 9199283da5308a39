//! A simulated IMU on a pseudo terminal, for a host in another process.

use crate::imu::{Imu, ImuOutput};
use crate::imu_console::{ImuConfiguration, ImuConsole};
use crate::imu_stream::{ImuStream, ImuVendor};
use crate::port::Terminal;
use crate::random::Random;
use crate::{Fault, FaultVerb, InjectError};
use motord_bus::{Duration, Instant, Readiness};
use std::path::{Path, PathBuf};

/// Bits on the line for each byte: 8N1.
const BYTE_BITS: f64 = 10.0;
/// After a longer stall the samples in between are not sent.
const STALL: Duration = Duration::from_secs(1);

/// An [`Imu`] that sends its samples on a pseudo terminal, and obeys the commands that set its rate
/// and baud rate. A host may open and close it repeatedly. While the host has another baud rate
/// than the device, both receive random bytes.
///
/// Faults of the line, in addition to those of the IMU: [`Fault::Gone`] unplugs it, so that the
/// host's descriptor hangs up. [`Fault::Garbage`] fills the line with random bytes, among them
/// beginnings of samples. [`Fault::Corruption`] changes a fraction of the bytes.
/// [`Fault::PowerCycle`] restarts the device with its stored settings. [`Fault::Ok`] ends all; the
/// pseudo terminal may then have another name.
#[derive(Debug)]
pub struct ImuPort {
    name: String,
    imu: Imu,
    stream: ImuStream,
    console: ImuConsole,
    start: Instant,
    due: Instant,
    random: Random,
    is_garbage: bool,
    corruption: f64,
    terminal: Option<Terminal>,
    /// A symbolic link that always refers to the pseudo terminal.
    link: Option<PathBuf>,
}

impl ImuPort {
    /// Opens a pseudo terminal for `imu`, which fault verbs call `name`. It sends `rate_hz` samples
    /// per second from `start` on, on a line of `baud` bit/s. `link` becomes a symbolic link to the
    /// terminal. It may replace an older symbolic link, but no other file.
    ///
    /// # Errors
    ///
    /// The kernel provides no pseudo terminal, or the link cannot be created.
    pub fn open(
        name: String,
        (imu, vendor): (Imu, ImuVendor),
        (rate_hz, baud): (f64, u32),
        start: Instant,
        link: Option<PathBuf>,
    ) -> Result<Self, std::io::Error> {
        let terminal = Some(Terminal::open(link.as_deref(), baud)?);
        Ok(Self {
            name,
            imu,
            stream: ImuStream::new(vendor),
            console: ImuConsole::new(vendor, ImuConfiguration { rate_hz, baud }),
            start,
            due: start,
            random: Random::new(0),
            is_garbage: false,
            corruption: 0.0,
            terminal,
            link,
        })
    }

    /// Returns the device that the host opens; `None` while it is unplugged.
    #[must_use]
    pub fn path(&self) -> Option<&Path> {
        self.terminal.as_ref().map(Terminal::path)
    }

    /// Returns the name that fault verbs use for it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the time of the next sample.
    #[must_use]
    pub const fn due(&self) -> Instant {
        self.due
    }

    /// Returns the descriptor that becomes readable when a command arrives.
    #[must_use]
    pub fn readiness(&self) -> Readiness<'_> {
        let readable = |terminal| Readiness::Readable(Terminal::device_end(terminal));
        self.terminal.as_ref().map_or(Readiness::Never, readable)
    }

    /// Obeys the host, and sends the samples that are due at `now`.
    pub fn serve(&mut self, now: Instant) {
        if now.since(self.due) > STALL {
            self.due = now;
        }
        self.obey();
        while self.due <= now {
            let bytes = self.bytes();
            self.send(bytes);
            let period = Duration::from_secs_f64(1.0 / self.console.configuration().rate_hz);
            self.due = self.due + period;
        }
    }

    /// Handles the commands that have arrived.
    fn obey(&mut self) {
        let mut buffer = [0; 256];
        let count = self.terminal.as_ref().map_or(0, |terminal| terminal.read(&mut buffer));
        if count > 0 && !self.is_garbled() {
            let answers = self.console.take(&buffer[..count]);
            self.send(answers);
        }
    }

    /// Returns whether host and device have different baud rates.
    fn is_garbled(&self) -> bool {
        let host = self.terminal.as_ref().and_then(Terminal::speed);
        host.is_some_and(|host| host != self.console.configuration().baud)
    }

    fn send(&mut self, mut bytes: Vec<u8>) {
        if !bytes.is_empty() && self.is_garbled() {
            bytes.iter_mut().for_each(|byte| *byte = self.random.next() as u8);
        }
        if let Some(terminal) = &self.terminal {
            terminal.write(&bytes);
        }
    }

    /// Applies `verb`.
    ///
    /// # Errors
    ///
    /// Another target, a fault that an IMU cannot have, or the kernel provides no new pseudo
    /// terminal.
    pub fn inject(&mut self, verb: &FaultVerb) -> Result<(), InjectError> {
        if verb.target != self.name {
            return Err(InjectError::NoSuchTarget);
        }
        match verb.fault {
            Fault::Gone => self.unplug(),
            Fault::PowerCycle => self.console.restart(),
            Fault::Garbage => self.is_garbage = true,
            Fault::Corruption(fraction) => self.corruption = fraction,
            Fault::Ok => {
                (self.is_garbage, self.corruption) = (false, 0.0);
                self.imu.inject(Fault::Ok)?;
                if self.terminal.is_none() {
                    let terminal = Terminal::open(self.link.as_deref(), self.console.configuration().baud);
                    let failed =
                        |error: std::io::Error| InjectError::Unplugged(error.raw_os_error().unwrap_or(0));
                    self.terminal = Some(terminal.map_err(failed)?);
                }
            }
            fault => self.imu.inject(fault)?,
        }
        Ok(())
    }

    /// Removes the terminal and the link: the kernel may give the terminal's name to another one.
    fn unplug(&mut self) {
        self.terminal = None;
        let _already_removed = self.link.as_ref().map(std::fs::remove_file);
    }

    /// Returns the bytes of the sample that is due.
    fn bytes(&mut self) -> Vec<u8> {
        let time = self.due.since(self.start);
        let mut bytes = match self.imu.sample(time) {
            ImuOutput::Sample(values) if self.console.is_sending() => self.stream.frame(&values, time),
            ImuOutput::Sample(_) | ImuOutput::Nothing | ImuOutput::Gone => {
                self.stream.skip();
                Vec::new()
            }
        };
        if self.is_garbage {
            return self.garbage();
        }
        for byte in &mut bytes {
            if self.random.fraction() < self.corruption {
                *byte ^= 1 << (self.random.next() % 8);
            }
        }
        bytes
    }

    /// Returns a period of random bytes. Every other 64 bytes are beginnings of samples, the others
    /// have one.
    fn garbage(&mut self) -> Vec<u8> {
        let ImuConfiguration { rate_hz, baud } = self.console.configuration();
        let line_bytes = (f64::from(baud) / BYTE_BITS / rate_hz) as usize;
        let mut bytes: Vec<_> = (0..line_bytes).map(|_| self.random.next() as u8).collect();
        let header = self.stream.header();
        for (index, block) in bytes.chunks_exact_mut(64).enumerate() {
            let headers = if index % 2 == 0 { 1 } else { block.len() / header.len() };
            block.chunks_exact_mut(header.len()).take(headers).for_each(|slot| slot.copy_from_slice(&header));
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::Read;

    fn port(link: &Path) -> ImuPort {
        let imu = Imu::new(0.0, 0.0, Duration::ZERO, 1);
        let link = Some(link.to_owned());
        ImuPort::open("base".to_owned(), (imu, ImuVendor::Hipnuc), (100.0, 115_200), Instant::ZERO, link)
            .unwrap()
    }

    /// Sends one period, and returns what the host reads.
    fn received(port: &mut ImuPort, host: &mut File) -> Vec<u8> {
        port.serve(port.due());
        let mut bytes = vec![0; 256];
        let count = host.read(&mut bytes).unwrap();
        bytes.truncate(count);
        bytes
    }

    #[test]
    fn faults_of_the_line_act_until_ok() {
        let directory = tempfile::tempdir().unwrap();
        let link = directory.path().join("ttyUSB0");
        let mut port = port(&link);
        let mut host = File::options().read(true).write(true).open(&link).unwrap();
        let inject = |port: &mut ImuPort, verb: &str| port.inject(&verb.parse().unwrap());
        assert_eq!(received(&mut port, &mut host).len(), 82);
        inject(&mut port, "base garbage").unwrap();
        // 115200 baud carry 115 bytes in 10 ms.
        assert_eq!(received(&mut port, &mut host).len(), 115);
        inject(&mut port, "base gone").unwrap();
        assert!(!link.exists());
        assert!(matches!(host.read(&mut [0]), Ok(0) | Err(_)), "the kernel hung up");
        inject(&mut port, "base ok").unwrap();
        let mut host = File::options().read(true).write(true).open(&link).unwrap();
        assert_eq!(received(&mut port, &mut host).len(), 82);
        inject(&mut port, "base corrupt 100%").unwrap();
        assert_ne!(received(&mut port, &mut host)[..2], [0x5A, 0xA5]);
        assert_eq!(inject(&mut port, "base bus-off"), Err(InjectError::NotForImus));
        assert_eq!(inject(&mut port, "knee off"), Err(InjectError::NoSuchTarget));
    }
}
