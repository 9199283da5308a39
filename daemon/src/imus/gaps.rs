//! The samples that a device took and the daemon did not receive, by the device's counter or clock.

use motord_bus::{Duration, Instant};
use motord_protocol::imu::{DeviceTime, Sample};

/// Slack of the gap check. A gap of more samples than fit into the elapsed time and this is a
/// restart of the device's counter or clock.
const SLACK: Duration = Duration::from_secs(1);

/// Counts the samples between two received ones.
#[derive(Debug)]
pub(super) struct Gaps {
    rate_hz: f64,
    last: Option<Mark>,
}

/// The place of a sample among those of its device.
#[derive(Debug, Clone, Copy)]
struct Mark {
    counter: Option<u16>,
    time: Option<DeviceTime>,
    received: Instant,
}

impl Gaps {
    /// Counts samples of `rate_hz`. The rate converts the clock of a device without a counter into
    /// a number of samples, and bounds a gap.
    pub(super) const fn new(rate_hz: f64) -> Self {
        Self { rate_hz, last: None }
    }

    /// Forgets the last sample: the device was disconnected.
    pub(super) const fn restart(&mut self) {
        self.last = None;
    }

    /// Returns the samples that are missing before `sample`; 0 where the device has neither counter
    /// nor clock.
    pub(super) fn before(&mut self, sample: &Sample, received: Instant) -> u32 {
        let mark = Mark { counter: sample.counter, time: sample.time, received };
        let Some(last) = self.last.replace(mark) else { return 0 };
        let missing = self.steps(&last, &mark).saturating_sub(1);
        let possible = self.rate_hz * (received.since(last.received) + SLACK).as_secs_f64();
        if f64::from(missing) <= possible { missing } else { 0 }
    }

    /// Samples from `last` to `mark`, by the counter where both have one.
    fn steps(&self, last: &Mark, mark: &Mark) -> u32 {
        if let (Some(before), Some(now)) = (last.counter, mark.counter) {
            return now.wrapping_sub(before).into();
        }
        let micros = last.time.zip(mark.time).and_then(|(before, now)| now.micros_since(before));
        micros.map_or(1, |micros| (micros as f64 * 1e-6 * self.rate_hz).round() as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(counter: u16) -> Sample {
        Sample { counter: Some(counter), ..Sample::default() }
    }

    fn timed(ticks: u32) -> Sample {
        Sample { time: Some(DeviceTime { ticks, per_second: 1000 }), ..Sample::default() }
    }

    /// The missing samples before each of these, which arrive every 10 ms.
    fn missing(rate_hz: f64, samples: &[Sample]) -> Vec<u32> {
        let mut gaps = Gaps::new(rate_hz);
        let arrivals = (1..).map(|turn| Instant::from_nanos(turn * 10_000_000));
        samples.iter().zip(arrivals).map(|(sample, at)| gaps.before(sample, at)).collect()
    }

    #[test]
    fn counter_finds_missing_samples_across_its_wrap() {
        let samples = [65_534, 65_535, 0, 3, 4].map(counted);
        assert_eq!(missing(100.0, &samples), [0, 0, 0, 2, 0]);
    }

    /// A clock of 1 ms alternates between 2 and 3 ms at 400 Hz.
    #[test]
    fn clock_finds_missing_samples_despite_its_resolution() {
        let samples = [0, 2, 5, 7, 15, u32::MAX].map(timed);
        assert_eq!(missing(400.0, &samples), [0, 0, 0, 0, 2, 0]);
    }

    #[test]
    fn restart_of_device_is_no_gap() {
        assert_eq!(missing(100.0, &[40_000, 5].map(counted)), [0, 0]);
        assert_eq!(missing(100.0, &[1_000_000, 5, 15].map(timed)), [0, 0, 0]);
        assert_eq!(missing(100.0, &[Sample::default(); 2]), [0, 0]);
        let mut gaps = Gaps::new(100.0);
        assert_eq!(gaps.before(&counted(1), Instant::ZERO), 0);
        gaps.restart();
        assert_eq!(gaps.before(&counted(9), Instant::ZERO), 0);
    }
}
