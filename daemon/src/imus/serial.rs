//! An IMU on a serial line: one thread reads its port, and opens it again after it was unplugged.

use super::gaps::Gaps;
use super::log::{ImuLog, Remark};
use super::reader::{Reader, TURN};
use super::writer::Writer;
use motord_bus::serial::{ByteStream as _, OpenError, Port};
use motord_bus::{Duration, Instant, clock, wait};
use motord_core::control::Repetition;
use motord_protocol::imu::{BITS_PER_BYTE, Sample, SampleError, SerialDecoder};
use motord_settings::sensor::imu::{ImuSample, ImuSerial, ImuSettings};
use nix::errno::Errno;

/// Wait before a device that is not there is tried again.
const REOPEN: Duration = Duration::from_millis(250);
/// Bytes of one read: more than a line carries while the thread waits for a processor. Only a
/// stream that is faster than the line can be fills it again and again.
const READ_BYTES: usize = 1024;
/// A stream that fills every read is read this many times as fast as its line can be.
const FLOOD_FACTOR: u32 = 4;
/// While no sample arrives, the thread pauses for this many times the time that it decoded: a
/// hostile stream takes at most a fifth of a processor.
const REST_FACTOR: u32 = 4;
/// Bytes without a sample after which the baud rate or the type is wrong.
const NO_SAMPLE_BYTES: usize = 2000;

/// Time over which the rate of a device is compared with the configured one, and the tolerance.
const RATE_WINDOW: Duration = Duration::from_secs(2);
const RATE_TOLERANCE: f64 = 0.1;

/// An IMU on a serial line.
pub(super) struct SerialImu {
    line: ImuSerial,
    writer: Writer,
    gaps: Gaps,
    log: ImuLog,
    port: Option<Port>,
    decoder: SerialDecoder,
    repetition: Repetition,
    /// Samples rejected since the last one that was passed.
    rejected: u32,
    /// Bytes received since the last sample.
    without_sample: usize,
    rate_hz: f64,
    /// Time of the first sample of this connection, and the number of samples after it.
    begun: Option<(Instant, u32)>,
    /// The last reason for which the port was not opened, which is logged once.
    failure: Option<OpenError>,
}

impl SerialImu {
    pub(super) fn new(settings: &ImuSettings, line: &ImuSerial, writer: Writer) -> Self {
        Self {
            line: line.clone(),
            writer,
            gaps: Gaps::new(settings.rate_hz),
            log: ImuLog::new(&settings.name),
            port: None,
            decoder: SerialDecoder::new(line.protocol),
            repetition: Repetition::default(),
            rejected: 0,
            without_sample: 0,
            rate_hz: settings.rate_hz,
            begun: None,
            failure: None,
        }
    }

    /// Opens the port, or waits for a while after a failure.
    fn connect(&mut self) {
        match Port::exclusive(&self.line.device, self.line.baud) {
            Ok(port) => {
                self.port = Some(port);
                self.failure = None;
                self.decoder = SerialDecoder::new(self.line.protocol);
                self.gaps.restart();
                self.rejected = 0;
                self.without_sample = 0;
                self.begun = None;
                self.log.restart();
                if self.log.permits(clock::monotonic()) {
                    let ImuSerial { device, baud, .. } = &self.line;
                    tracing::info!(imu = self.log.imu(), device, baud, "opened its serial port");
                }
            }
            Err(failure) => {
                if self.failure.as_ref() != Some(&failure) && self.log.permits(clock::monotonic()) {
                    self.log.warn(format_args!("{failure}; trying again every {} ms", REOPEN.as_millis()));
                }
                self.failure = Some(failure);
                std::thread::sleep(REOPEN);
            }
        }
    }

    /// Handles the outcome of a read.
    fn take(&mut self, read: Result<&[u8], Errno>, received: Instant) {
        match read {
            Ok([]) => self.disconnect(Errno::ENODEV),
            Ok(bytes) => {
                let begun = clock::monotonic();
                self.decode(bytes, received);
                if self.without_sample >= NO_SAMPLE_BYTES {
                    std::thread::sleep(clock::monotonic().since(begun) * REST_FACTOR);
                }
                if bytes.len() == READ_BYTES {
                    let bits = BITS_PER_BYTE * READ_BYTES as u32;
                    std::thread::sleep(Duration::from_secs(1) * bits / self.line.baud / FLOOD_FACTOR);
                }
            }
            Err(Errno::EAGAIN | Errno::EINTR) => {}
            Err(errno) => self.disconnect(errno),
        }
    }

    /// Closes the port, and reports the IMU as disconnected.
    fn disconnect(&mut self, errno: Errno) {
        self.writer.disconnected();
        self.port = None;
        if self.log.permits(clock::monotonic()) {
            tracing::warn!(
                imu = self.log.imu(),
                device = self.line.device,
                see = "imu-lost",
                "its serial port is disconnected ({}); trying to open it again",
                errno.desc()
            );
        }
    }

    /// Passes the samples among `bytes`. Bounded by the bytes; does not allocate, but for a remark.
    fn decode(&mut self, bytes: &[u8], received: Instant) {
        for byte in bytes {
            match self.decoder.push(*byte) {
                None => self.without_sample += 1,
                Some(decoded) => self.handle(decoded, received),
            }
        }
        if self.without_sample >= NO_SAMPLE_BYTES {
            let ImuSerial { protocol, device, baud } = &self.line;
            self.log.remark(Remark::NoSamples, || {
                format!(
                    "{device} delivers bytes that are no samples of type {} at {baud} bit/s; `motorctl imu find --device {device}` \
                     finds type and baud rate",
                    protocol.name()
                )
            });
        }
    }

    fn handle(&mut self, decoded: Result<Sample, SampleError>, received: Instant) {
        match decoded.map(|sample| (sample, ImuSample::of(&sample))) {
            Ok((_, Some(complete))) if self.repetition.is_stuck(&complete, received) => {
                self.reject();
                self.without_sample = 0;
                self.log.remark(Remark::Stuck, || {
                    "repeats one sample, which is rejected, since a sensor measures noise also at rest: switch its power off and on"
                        .to_owned()
                });
            }
            Ok((sample, Some(complete))) => {
                let missing = self.gaps.before(&sample, received).saturating_sub(self.rejected);
                if missing > 0 {
                    self.writer.missed(missing);
                }
                let _counted = self.writer.sample(&complete, received);
                self.without_sample = 0;
                self.rejected = 0;
                self.compare_rate(received);
            }
            Ok((sample, None)) => {
                self.reject();
                self.without_sample = 0;
                let line = &self.line;
                self.log.remark(Remark::Incomplete, || incomplete(&sample, line));
            }
            Err(error) if error.is_other_content() => {
                // No sample is missing because of it.
                self.writer.rejected();
                self.without_sample = 0;
                self.log.remark(Remark::OtherContent, || {
                    format!("sends what is no sample, and is rejected: {error}")
                });
            }
            Err(_) => self.reject(),
        }
    }

    /// Warns once of a device with another rate than the configured one: too low, its samples count
    /// as missing.
    fn compare_rate(&mut self, received: Instant) {
        let (since, count) = self.begun.map_or((received, 0), |(since, count)| (since, count + 1));
        self.begun = Some((since, count));
        let passed = received.since(since);
        if passed < RATE_WINDOW || !self.log.is_first(Remark::Rate) {
            return;
        }
        let measured = f64::from(count) / passed.as_secs_f64();
        if (measured / self.rate_hz - 1.0).abs() > RATE_TOLERANCE {
            self.log.warn(format_args!(
                "delivers {measured:.0} samples per second, and rate-hz is {}: set the rate of the device, or rate-hz",
                self.rate_hz
            ));
        }
    }

    fn reject(&mut self) {
        self.writer.rejected();
        self.rejected = self.rejected.saturating_add(1);
    }
}

/// Returns the remark about a sample that lacks a quantity.
fn incomplete(sample: &Sample, line: &ImuSerial) -> String {
    let quantities = [
        ("orientation", sample.orientation.is_none()),
        ("angular velocity", sample.angular_velocity.is_none()),
        ("acceleration", sample.acceleration.is_none()),
    ];
    let lacking = quantities.iter().filter(|(_, is_lacking)| *is_lacking).map(|(name, _)| *name);
    format!(
        "its samples have no {}, and are rejected; set in the device: {}",
        lacking.collect::<Vec<_>>().join(" and no "),
        line.protocol.complete_samples()
    )
}

impl Reader for SerialImu {
    fn thread(&self) -> &'static str {
        "imu-line"
    }

    /// Opens the port if it is closed.
    fn turn(&mut self) {
        let Some(port) = &self.port else { return self.connect() };
        let now = clock::monotonic();
        if wait(&[port.readiness()], now, now + TURN).any() {
            let mut buffer = [0; READ_BYTES];
            let read = port.read(&mut buffer);
            let received = clock::monotonic();
            self.take(read.map(|count| &buffer[..count]), received);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_core::control::ImuReading;
    use motord_protocol::imu::{DeviceTime, Quaternion, SerialProtocol};
    use motord_settings::sensor::imu::{ImuSource, Mount, WhenLost};
    use triple_buffer::{Output, TripleBuffer};

    fn imu(protocol: SerialProtocol) -> (SerialImu, Output<ImuReading>) {
        let (input, output) = TripleBuffer::new(&ImuReading::default()).split();
        let line = ImuSerial { protocol, device: "/dev/null".to_owned(), baud: 4_000_000 };
        let settings = ImuSettings {
            name: "base".to_owned(),
            source: ImuSource::Serial(line.clone()),
            rate_hz: 100.0,
            mount: Mount::ALIGNED,
            lost_after: Duration::from_millis(30),
            when_lost: WhenLost::Report,
        };
        (SerialImu::new(&settings, &line, Writer::new(input, Mount::ALIGNED)), output)
    }

    fn sample(number: u16) -> Sample {
        Sample {
            orientation: Some(Quaternion::from([1.0, 0.0, 0.0, 0.0])),
            angular_velocity: Some([f32::from(number), 0.0, 0.0]),
            acceleration: Some([0.0, 0.0, 9.8]),
            counter: Some(number),
            time: Some(DeviceTime { ticks: 10 * u32::from(number), per_second: 1000 }),
            ..Sample::default()
        }
    }

    fn encoded(protocol: SerialProtocol, sample: &Sample) -> Vec<u8> {
        use motord_protocol::imu::{hipnuc, xsens};
        match protocol {
            SerialProtocol::Hipnuc => hipnuc::serial::encode(sample).to_vec(),
            SerialProtocol::Xsens => xsens::encode(sample, &mut [0; xsens::MESSAGE_LEN_MAX]).to_vec(),
        }
    }

    fn at(millis: u64) -> Instant {
        Instant::from_nanos(millis * 1_000_000)
    }

    /// Of five samples the third has a wrong bit, and the fourth does not arrive.
    #[test]
    fn damaged_sample_is_rejected_and_missing_one_counted() {
        for protocol in SerialProtocol::ALL {
            let (mut imu, mut output) = imu(protocol);
            let mut frames: Vec<_> = (0..5).map(|number| encoded(protocol, &sample(number))).collect();
            frames[2][30] ^= 1;
            frames.remove(3);
            for (frame, millis) in frames.iter().zip([0, 10, 20, 40]) {
                imu.take(Ok(frame), at(millis));
            }
            let reading = *output.read();
            let counts = (reading.sequence, reading.rejected, reading.missing, reading.is_connected);
            assert_eq!(counts, (3, 1, 1, true), "{protocol:?}");
            assert!((reading.sample.angular_velocity[0] - 4.0).abs() < 1e-5);
            assert_eq!(reading.received, at(40));
        }
    }

    #[test]
    fn sample_without_orientation_is_never_passed() {
        let (mut imu, mut output) = imu(SerialProtocol::Xsens);
        let lacking = Sample { orientation: None, ..sample(1) };
        imu.take(Ok(&encoded(SerialProtocol::Xsens, &lacking)), at(0));
        let reading = *output.read();
        assert_eq!((reading.sequence, reading.rejected), (0, 1));
        assert!(imu.log.has(Remark::Incomplete));
    }

    /// A payload of one byte, 0x83. Its CRC-16 is that of `binascii.crc_hqx` of Python.
    #[test]
    fn frame_of_other_packets_is_counted_and_named() {
        let (mut imu, mut output) = imu(SerialProtocol::Hipnuc);
        for millis in 0..3 {
            imu.take(Ok(&[0x5A, 0xA5, 1, 0, 0x74, 0x93, 0x83]), at(millis));
        }
        let reading = *output.read();
        assert_eq!((reading.sequence, reading.rejected), (0, 3));
        assert!(imu.log.has(Remark::OtherContent));
    }

    #[test]
    fn hang_up_disconnects_at_once() {
        for end in [Ok(&[][..]), Err(Errno::EIO), Err(Errno::ENODEV), Err(Errno::ENXIO)] {
            let (mut imu, mut output) = imu(SerialProtocol::Hipnuc);
            imu.take(Ok(&encoded(SerialProtocol::Hipnuc, &sample(1))), at(0));
            imu.take(Err(Errno::EAGAIN), at(1));
            assert!(output.read().is_connected);
            imu.take(end, at(2));
            let reading = *output.read();
            assert_eq!((reading.sequence, reading.is_connected), (1, false), "{end:?}");
        }
    }

    /// 100 Hz are configured, and 50 Hz arrive.
    #[test]
    fn rate_is_compared_once_for_each_connection() {
        let (mut imu, _output) = imu(SerialProtocol::Xsens);
        for number in 0..=100 {
            assert!(!imu.log.has(Remark::Rate));
            imu.take(Ok(&encoded(SerialProtocol::Xsens, &sample(number))), at(20 * u64::from(number)));
        }
        assert!(imu.log.has(Remark::Rate));
        assert_eq!(imu.begun, Some((at(0), 100)));
    }

    #[test]
    fn wrong_baud_rate_is_remarked_once() {
        let (mut imu, mut output) = imu(SerialProtocol::Hipnuc);
        (0..10).for_each(|_| imu.take(Ok(&[0x55; 500]), at(0)));
        assert!(imu.log.has(Remark::NoSamples));
        assert_eq!(*output.read(), ImuReading::default());
    }

    /// A sensor whose measurement hangs sends on: its counter and clock advance.
    #[test]
    fn repeated_sample_is_rejected_after_a_second() {
        for protocol in SerialProtocol::ALL {
            let (mut imu, mut output) = imu(protocol);
            let stuck = |number| Sample { angular_velocity: Some([0.25, 0.0, 0.0]), ..sample(number) };
            for number in 0..300 {
                imu.decode(&encoded(protocol, &stuck(number)), at(10 * u64::from(number)));
            }
            let reading = *output.read();
            assert_eq!((reading.sequence, reading.rejected, reading.missing), (100, 200, 0), "{protocol:?}");
            assert!(imu.log.has(Remark::Stuck));
            imu.decode(&encoded(protocol, &sample(300)), at(3000));
            assert_eq!(output.read().sequence, 101, "it measures again");
        }
    }
}
