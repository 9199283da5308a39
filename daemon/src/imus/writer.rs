//! The writing end of an IMU.

use motord_bus::Instant;
use motord_core::control::ImuReading;
use motord_settings::sensor::imu::{ImuSample, Mount};
use triple_buffer::Input;

/// The writing end of one IMU.
pub(super) struct Writer {
    input: Input<ImuReading>,
    mount: Mount,
    reading: ImuReading,
}

impl Writer {
    pub(super) fn new(input: Input<ImuReading>, mount: Mount) -> Self {
        Self { input, mount, reading: ImuReading::default() }
    }

    /// Passes a sample, in the frame of the sensor, that was received at `received`. One that is
    /// not sound is counted instead, and this returns false. Wait-free.
    pub(super) fn sample(&mut self, sample: &ImuSample, received: Instant) -> bool {
        self.reading.is_connected = true;
        let sound = sample.checked();
        match &sound {
            Some(sound) => {
                self.reading.sample = self.mount.to_body(sound);
                self.reading.received = received;
                self.reading.sequence += 1;
            }
            None => self.reading.rejected = self.reading.rejected.wrapping_add(1),
        }
        self.input.write(self.reading);
        sound.is_some()
    }

    /// Records that this number of samples that the device took was not received. Wait-free.
    pub(super) fn missed(&mut self, samples: u32) {
        self.reading.missing = self.reading.missing.wrapping_add(samples);
        self.input.write(self.reading);
    }

    /// Records a sample that is not passed. Wait-free.
    pub(super) fn rejected(&mut self) {
        self.reading.rejected = self.reading.rejected.wrapping_add(1);
        self.input.write(self.reading);
    }

    /// Passes with the next sample the publisher that it is from, and the number of its samples
    /// that were missing before.
    pub(super) const fn published(&mut self, publisher: u64, missing: u32) {
        self.reading.publisher = publisher;
        self.reading.missing = self.reading.missing.wrapping_add(missing);
    }

    /// Records that the device is disconnected. Wait-free.
    pub(super) fn disconnected(&mut self) {
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
        writer.missed(1);
        let expected = ImuReading {
            sample: ImuSample::LEVEL,
            received: first,
            sequence: 1,
            missing: 1,
            rejected: 1,
            is_connected: true,
            publisher: 0,
        };
        assert_eq!(*output.read(), expected);
        writer.disconnected();
        assert_eq!(*output.read(), ImuReading { is_connected: false, ..expected });
    }
}
