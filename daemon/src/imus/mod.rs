//! The IMUs: one thread for each source of samples, outside the real-time thread.
//!
//! ```text
//!   source ──sample──▶ checked, turned into the frame of the body ──wait-free buffer──▶ cycle
//! ```

mod simulated;

pub use simulated::SimulatedImus;

use motord_bus::Instant;
use motord_core::control::ImuReading;
use motord_core::imu::{ImuSample, Mount};
use triple_buffer::Input;

/// The writing end of one IMU.
struct Writer {
    input: Input<ImuReading>,
    mount: Mount,
    reading: ImuReading,
}

impl Writer {
    fn new(input: Input<ImuReading>, mount: Mount) -> Self {
        Self { input, mount, reading: ImuReading::default() }
    }

    /// Passes a sample, in the frame of the sensor, that was received at `received`. One that is not sound is counted
    /// instead. Wait-free.
    fn sample(&mut self, sample: &ImuSample, received: Instant) {
        self.reading.is_connected = true;
        match sample.checked() {
            Some(sound) => {
                self.reading.sample = self.mount.to_body(&sound);
                self.reading.received = received;
                self.reading.sequence += 1;
            }
            None => self.reading.rejected = self.reading.rejected.wrapping_add(1),
        }
        self.input.write(self.reading);
    }

    /// Records that a sample that the device took was not received. Wait-free.
    fn missed(&mut self) {
        self.reading.missing = self.reading.missing.wrapping_add(1);
        self.input.write(self.reading);
    }

    /// Records that the device is disconnected. Wait-free.
    fn disconnected(&mut self) {
        self.reading.is_connected = false;
        self.input.write(self.reading);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use triple_buffer::TripleBuffer;

    #[test]
    fn unsound_sample_is_counted_and_never_passed() {
        let (input, mut output) = TripleBuffer::new(&ImuReading::default()).split();
        let mut writer = Writer::new(input, Mount::ALIGNED);
        let [first, second] = [1, 2].map(Instant::from_nanos);
        writer.sample(&ImuSample::LEVEL, first);
        writer.sample(&ImuSample { acceleration: [f32::NAN; 3], ..ImuSample::LEVEL }, second);
        writer.missed();
        let expected = ImuReading {
            sample: ImuSample::LEVEL,
            received: first,
            sequence: 1,
            missing: 1,
            rejected: 1,
            is_connected: true,
        };
        assert_eq!(*output.read(), expected);
        writer.disconnected();
        assert_eq!(*output.read(), ImuReading { is_connected: false, ..expected });
    }
}
