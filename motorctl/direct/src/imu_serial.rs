//! `motorctl imu set --device`: the commands of HiPNUC and Xsens on a serial line.

use crate::failure::DirectFailure;
use crate::imu::{PROBE, SAMPLES, SampleStream, bauds, listen};
use crate::imu_values::{Set, Values};
use motord_bus::serial::{ByteStream as _, OpenError, Port};
use motord_bus::{BusLock, Duration, clock, wait};
use motord_protocol::commissioning::Error;
use motord_protocol::imu::xsens::command::{Answer, Answers};
use motord_protocol::imu::{BITS_PER_BYTE, SerialProtocol, hipnuc, xsens};
use motord_terminal::Interrupt;

/// Longest wait for the answer to a command.
const ANSWER: Duration = Duration::from_millis(500);
/// A command that the device did not see among its own samples is sent again this many times.
const TRIES: usize = 4;
/// Time that a device needs to start again, at most.
const RESTART: Duration = Duration::from_secs(5);
/// Time for which the rate is measured. A slow device is measured for [`MEASURE_SAMPLES`].
const MEASURE: Duration = Duration::from_secs(1);
const MEASURE_SAMPLES: f64 = 5.0;

/// A device that sends samples.
struct Device<'a> {
    name: &'a str,
    interrupt: &'a Interrupt,
    port: Port,
    baud: u32,
    protocol: SerialProtocol,
}

/// Finds the device on a port, sets it, and measures its samples.
///
/// # Errors
///
/// The device or its line cannot have the value, the port or bus is in use, or the device does not
/// do as asked.
pub(crate) fn set(
    name: &str,
    baud: Option<u32>,
    values: Values,
    interrupt: &Interrupt,
    consent: impl FnOnce(String) -> Result<(), DirectFailure>,
) -> Result<Set, DirectFailure> {
    let _lock = BusLock::device(name)?;
    let mut device = Device::find(name, baud, interrupt)?;
    let present = device.measure(MEASURE)?;
    let rate_hz = values.rate_hz.map_or(present, f64::from);
    device.check(values, rate_hz)?;
    let others = match device.protocol {
        SerialProtocol::Hipnuc => "",
        SerialProtocol::Xsens => " Its outputs become those that motord needs, and no others.",
    };
    consent(format!(
        "This changes and stores the settings of the IMU on {name} ({} at {} baud).{others}",
        device.protocol.name(),
        device.baud
    ))?;
    match device.protocol {
        SerialProtocol::Hipnuc => device.set_hipnuc(values)?,
        SerialProtocol::Xsens => device.set_xsens(values)?,
    }
    if let Some(baud) = values.baud {
        device = device.reopen(baud)?;
    }
    let time = MEASURE.max(Duration::from_secs_f64(MEASURE_SAMPLES / rate_hz));
    let measured_hz = device.measure(time)?;
    Ok(Set {
        kind: device.protocol.name(),
        device: Some(name.to_owned()),
        bus: None,
        node_id: None,
        asked: values,
        measured_hz,
        needs_power_cycle: false,
    })
}

impl<'a> Device<'a> {
    /// Finds type and baud rate of the device, by its samples.
    fn find(name: &'a str, baud: Option<u32>, interrupt: &'a Interrupt) -> Result<Self, DirectFailure> {
        for baud in baud.map_or_else(bauds, |baud| vec![baud]) {
            let port = match Port::exclusive(name, baud) {
                Ok(port) => port,
                Err(OpenError::Baud { .. }) => continue,
                Err(error) => return Err(error.into()),
            };
            let mut streams = SerialProtocol::ALL.map(SampleStream::new);
            let is_found = |streams: &[SampleStream]| streams.iter().any(|one| one.count >= SAMPLES);
            listen(&port, &mut streams, PROBE, |streams| is_found(streams) || interrupt.is_raised());
            if interrupt.is_raised() {
                return Err(Error::Interrupted.into());
            }
            if let Some(known) = streams.into_iter().find(|one| one.count >= SAMPLES) {
                return Ok(Self { name, interrupt, port, baud, protocol: known.protocol });
            }
        }
        let reason = "no sample of a HiPNUC or Xsens arrives, so nothing was written: `motorctl imu find` says what arrives; a device \
                      that was silenced needs the vendor's tool";
        Err(DirectFailure::Imu { address: name.to_owned(), reason: reason.to_owned() })
    }

    fn failed(&self, reason: String) -> DirectFailure {
        DirectFailure::Imu { address: self.name.to_owned(), reason }
    }

    /// Returns the samples per second that arrive.
    fn measure(&self, time: Duration) -> Result<f64, DirectFailure> {
        let mut streams = [SampleStream::new(self.protocol)];
        listen(&self.port, &mut streams, time, |_| self.interrupt.is_raised());
        if self.interrupt.is_raised() {
            return Err(Error::Interrupted.into());
        }
        Ok(streams[0].rate_hz().unwrap_or(0.0))
    }

    /// Refuses values that the device does not have, or that its line cannot carry.
    fn check(&self, values: Values, rate_hz: f64) -> Result<(), DirectFailure> {
        let usage = |reason| Err(DirectFailure::Usage(format!("{}: {reason}", self.name)));
        if let Some(baud) = values.baud.filter(|baud| !self.protocol.bauds().contains(baud)) {
            let known: Vec<_> = self.protocol.bauds().iter().map(u32::to_string).collect();
            return usage(format!("{baud} baud: the device has {}", known.join(", ")));
        }
        match (self.protocol, values.rate_hz) {
            (SerialProtocol::Hipnuc, Some(rate)) if hipnuc::command::serial_rate(rate).is_none() => {
                let known: Vec<_> = hipnuc::command::serial_rates().map(|rate| rate.to_string()).collect();
                return usage(format!("{rate} Hz: the device has {}", known.join(", ")));
            }
            (SerialProtocol::Xsens, Some(rate)) if xsens::command::outputs(rate).is_none() => {
                return usage(format!("{rate} Hz: the filter of the device has 1 to 400"));
            }
            _ => {}
        }
        let baud = values.baud.unwrap_or(self.baud);
        let bytes = match self.protocol {
            SerialProtocol::Hipnuc => self.protocol.sample_len(),
            SerialProtocol::Xsens => xsens::command::SAMPLE_LEN,
        };
        let most = f64::from(baud) / f64::from(BITS_PER_BYTE * bytes as u32);
        if rate_hz > most {
            return usage(format!(
                "{rate_hz:.0} Hz of {bytes} bytes do not fit into {baud} baud, which carry {most:.0} Hz: use --new-baud, or a lower --rate-hz"
            ));
        }
        Ok(())
    }

    /// Sends bytes, and passes what arrives to `found` until it returns something, or [`ANSWER`] is
    /// over.
    fn ask<T>(
        &self,
        bytes: &[u8],
        mut found: impl FnMut(u8) -> Option<T>,
    ) -> Result<Option<T>, DirectFailure> {
        let sent = self.port.write(bytes);
        if sent != Ok(bytes.len()) {
            return Err(
                self.failed("the port does not take a command: is the adapter plugged in?".to_owned())
            );
        }
        let end = clock::monotonic() + ANSWER;
        let mut buffer = [0; 1024];
        loop {
            let now = clock::monotonic();
            if now >= end || !wait(&[self.port.readiness()], now, end).any() {
                return Ok(None);
            }
            let count = self.port.read(&mut buffer).unwrap_or(0);
            if let Some(answer) = buffer[..count].iter().find_map(|byte| found(*byte)) {
                return Ok(Some(answer));
            }
        }
    }

    /// Writes the values, stores them, and lets the device send again, also after an error.
    fn set_hipnuc(&self, values: Values) -> Result<(), DirectFailure> {
        let settings = [
            values.rate_hz.and_then(hipnuc::command::serial_rate),
            values.baud.and_then(hipnuc::command::serial_baud),
            Some(hipnuc::command::SAVE),
        ];
        self.silence_hipnuc()?;
        let written = settings.into_iter().flatten().try_for_each(|line| self.hipnuc_line(line));
        let last = match (&written, values.baud) {
            (Ok(()), Some(_)) => hipnuc::command::RESTART,
            _ => hipnuc::command::RESUME,
        };
        self.ask(last.as_bytes(), |_| None::<()>).and(written)
    }

    /// Ends the samples: the device does not see commands among them.
    fn silence_hipnuc(&self) -> Result<(), DirectFailure> {
        for _ in 0..TRIES {
            let mut confirmed = Confirmed::default();
            if self.ask(hipnuc::command::PAUSE.as_bytes(), |byte| confirmed.push(byte))?.is_some() {
                return Ok(());
            }
        }
        Err(self.failed(
            "the device does not confirm `LOG DISABLE`, so nothing was changed: check the wire from the adapter's TX to the device's RX; \
             older firmware has other commands (`AT+ODR`): use the vendor's tool"
                .to_owned(),
        ))
    }

    fn hipnuc_line(&self, line: &str) -> Result<(), DirectFailure> {
        let mut confirmed = Confirmed::default();
        match self.ask(line.as_bytes(), |byte| confirmed.push(byte))? {
            Some(()) => Ok(()),
            None => Err(self.failed(format!(
                "the device does not confirm `{}`; it may have kept its settings",
                line.trim()
            ))),
        }
    }

    /// Writes the values, which the device stores, and lets it send again, also after an error.
    fn set_xsens(&self, values: Values) -> Result<(), DirectFailure> {
        self.xsens_message("GoToConfig", &xsens::command::GO_TO_CONFIG)?;
        let written = self.configure_xsens(values);
        match (&written, values.baud) {
            // Its answer may already have the new baud rate; the samples confirm it.
            (Ok(()), Some(_)) => self.ask(&xsens::command::RESET, |_| None::<()>).map(|_| ()),
            _ => self.xsens_message("GoToMeasurement", &xsens::command::GO_TO_MEASUREMENT).and(written),
        }
    }

    fn configure_xsens(&self, values: Values) -> Result<(), DirectFailure> {
        if let Some(outputs) = values.rate_hz.and_then(xsens::command::outputs) {
            self.xsens_message("SetOutputConfiguration", &outputs)?;
        }
        if let Some(message) = values.baud.and_then(xsens::command::set_baud) {
            self.xsens_message("SetBaudrate", &message)?;
        }
        Ok(())
    }

    /// Sends a message until the device answers.
    fn xsens_message(&self, name: &str, message: &[u8]) -> Result<(), DirectFailure> {
        for _ in 0..TRIES {
            let mut answers = Answers::to(message);
            match self.ask(message, |byte| answers.push(byte))? {
                Some(Answer::Done) => return Ok(()),
                Some(Answer::Refused(code)) => {
                    return Err(self.failed(format!("the device refuses {name} with the error {code:#04X}")));
                }
                None => {}
            }
        }
        Err(self.failed(format!(
            "the device does not confirm {name}: check the wire from the adapter's TX to the device's RX"
        )))
    }

    /// Opens the port with another baud rate, and waits for samples.
    fn reopen(self, baud: u32) -> Result<Self, DirectFailure> {
        let Self { name, interrupt, port, protocol, .. } = self;
        // It holds the lock.
        drop(port);
        let device = Self { name, interrupt, port: Port::exclusive(name, baud)?, baud, protocol };
        let mut streams = [SampleStream::new(protocol)];
        listen(&device.port, &mut streams, RESTART, |streams| {
            streams[0].count >= SAMPLES || interrupt.is_raised()
        });
        if streams[0].count < SAMPLES {
            return Err(device.failed(format!(
                "no samples arrive at {baud} baud after the restart of the device: `motorctl imu find --device {name}`"
            )));
        }
        Ok(device)
    }
}

/// Finds the line `OK` among other bytes.
#[derive(Debug, Default)]
struct Confirmed([u8; 3]);

impl Confirmed {
    fn push(&mut self, byte: u8) -> Option<()> {
        self.0 = [self.0[1], self.0[2], byte];
        (self.0 == *b"OK\r").then_some(())
    }
}
