//! A sensor that repeats one sample.

use motord_bus::{Duration, Instant};
use motord_settings::sensor::imu::ImuSample;

/// Time for which all samples must be equal.
const TIME: Duration = Duration::from_secs(1);
/// Number of samples that must be equal to the one before: codes of 0.1 °/s and 0.001 G hide the
/// noise of a sensor at rest from some samples in a row.
const SAMPLES: u32 = 100;

/// Finds out whether a sensor is stuck. A live one measures noise, also at rest.
#[derive(Debug, Clone, Default)]
pub struct Repetition {
    /// The bits of angular velocity and acceleration.
    last: Option<[u32; 6]>,
    since: Option<Instant>,
    equal: u32,
}

impl Repetition {
    /// Takes a sample of a device that arrived at `at`. Returns whether it has repeated angular
    /// velocity and acceleration, bit by bit, for 1 s and in 100 samples. Real-time: constant time.
    pub fn is_stuck(&mut self, sample: &ImuSample, at: Instant) -> bool {
        let ([a, b, c], [d, e, f]) = (sample.angular_velocity, sample.acceleration);
        let bits = [a, b, c, d, e, f].map(f32::to_bits);
        if self.last != Some(bits) {
            *self = Self { last: Some(bits), since: Some(at), equal: 0 };
            return false;
        }
        self.equal = self.equal.saturating_add(1);
        self.equal >= SAMPLES && self.since.is_some_and(|since| at.since(since) >= TIME)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number of samples, `period_ms` apart, until one counts as a repetition.
    fn samples(period_ms: u64, sample: impl Fn(u64) -> ImuSample) -> Option<u64> {
        let mut repetition = Repetition::default();
        (0..2000).find(|&number| {
            let at = Instant::from_nanos(number * period_ms * 1_000_000);
            repetition.is_stuck(&sample(number), at)
        })
    }

    #[test]
    fn repetition_needs_a_second_and_many_samples() {
        assert_eq!(samples(2, |_| ImuSample::LEVEL), Some(500));
        assert_eq!(samples(100, |_| ImuSample::LEVEL), Some(100));
        let turned = |number: u64| ImuSample { orientation: [number as f32; 4], ..ImuSample::LEVEL };
        assert_eq!(samples(2, turned), Some(500), "the orientation is computed");
        let code =
            |number: u64| ImuSample { angular_velocity: [(number / 99) as f32; 3], ..ImuSample::LEVEL };
        assert_eq!(samples(100, code), None);
    }
}
