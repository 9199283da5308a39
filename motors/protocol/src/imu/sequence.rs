//! One sample from several frames, with one quantity in each.
//!
//! The frames of HiPNUC's CANopen and of the DM-IMU-L1 have neither a number nor a time. The order
//! and the time of their arrival decide which of them belong together:
//! - A sample begins with its first quantity. The order is acceleration, angular velocity,
//!   orientation: that of rising identifiers on the bus, and that of the requests.
//! - It is complete when its last quantity arrived, at most `within` after the first.
//! - Any other frame in between means that one was lost. The sample is dropped, and reported once.
//!
//! Two samples would combine only if frames of both arrived within `within`. Half a period is less
//! than the time between two samples, and more than the frames of one sample need.

use super::error::{SampleError, SampleField};
use super::sample::{Quaternion, Sample};

/// The quantities in the order in which their frames arrive.
const ORDER: [SampleField; 3] =
    [SampleField::Acceleration, SampleField::AngularVelocity, SampleField::Orientation];

/// The quantities of which a sample consists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parts {
    /// The sample has an acceleration.
    pub acceleration: bool,
    /// The sample has an angular velocity.
    pub angular_velocity: bool,
    /// The sample has an orientation.
    pub orientation: bool,
}

impl Parts {
    /// Acceleration, angular velocity and orientation: three frames.
    pub const ALL: Self = Self { acceleration: true, angular_velocity: true, orientation: true };

    /// Returns the quantities in the order of their frames.
    pub fn in_order(self) -> impl Iterator<Item = SampleField> {
        ORDER.into_iter().filter(move |field| self.contains(*field))
    }

    fn contains(self, field: SampleField) -> bool {
        match field {
            SampleField::Acceleration => self.acceleration,
            SampleField::AngularVelocity => self.angular_velocity,
            SampleField::Orientation => self.orientation,
            SampleField::Angles | SampleField::Temperature => false,
        }
    }

    /// Returns the quantity after `field`, or the first one.
    fn after(self, field: Option<SampleField>) -> Option<SampleField> {
        let mut fields = self.in_order();
        match field {
            Some(before) => fields.skip_while(|field| *field != before).nth(1),
            None => fields.next(),
        }
    }
}

/// State of the sample that is being received.
#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    /// Nothing since the last sample.
    Closed,
    /// Nothing since a sample was dropped. Its other frames are not reported again.
    Dropped,
    /// The quantities up to `last`, since the first arrived at `since_us`.
    Open { last: SampleField, since_us: u64 },
}

/// Combines frames into samples.
#[derive(Debug, Clone)]
pub(super) struct Sequence {
    parts: Parts,
    within_us: u64,
    state: State,
    sample: Sample,
}

impl Sequence {
    /// Returns a sequence of these parts, which arrive within this time, µs.
    pub(super) fn new(parts: Parts, within_us: u64) -> Self {
        // The first frames of a running device can be the end of a sample: no loss.
        Self { parts, within_us, state: State::Dropped, sample: Sample::default() }
    }

    /// Drops the sample that is being received.
    pub(super) const fn drop_sample(&mut self) {
        self.state = State::Dropped;
    }

    /// Takes a quantity that arrived at `at_us`. Returns the sample that it completes.
    pub(super) fn push(&mut self, measured: Measured, at_us: u64) -> Result<Option<Sample>, SampleError> {
        let field = measured.field();
        if !self.parts.contains(field) {
            return Ok(None);
        }
        let lost = self.lost(field, at_us);
        if lost.is_some() {
            self.state = State::Dropped;
        }
        let is_first = self.parts.after(None) == Some(field);
        let since_us = match self.state {
            State::Open { since_us, .. } => since_us,
            _ if is_first => at_us,
            _ => {
                self.state = State::Dropped;
                return lost.map_or(Ok(None), Err);
            }
        };
        if is_first {
            self.sample = Sample::default();
        }
        measured.store(&mut self.sample);
        let is_last = self.parts.after(Some(field)).is_none();
        self.state = if is_last { State::Closed } else { State::Open { last: field, since_us } };
        lost.map_or(Ok(is_last.then_some(self.sample)), Err)
    }

    /// Returns the loss that the arrival of `field` shows.
    fn lost(&self, field: SampleField, at_us: u64) -> Option<SampleError> {
        let (expected, is_late) = match self.state {
            State::Dropped => return None,
            State::Closed => (self.parts.after(None)?, false),
            State::Open { last, since_us } => {
                (self.parts.after(Some(last))?, at_us.wrapping_sub(since_us) > self.within_us)
            }
        };
        (is_late || field != expected).then_some(SampleError::Incomplete { missing: expected })
    }
}

/// The content of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measured {
    /// Specific force along x, y, z, m/s².
    Acceleration([f32; 3]),
    /// Angular velocity about x, y, z, rad/s.
    AngularVelocity([f32; 3]),
    /// Angles of roll, pitch and yaw, rad, in the vendor's convention. No sample contains them.
    Angles([f32; 3]),
    /// Rotation from the sensor to the world.
    Orientation(Quaternion),
}

impl Measured {
    /// Returns the quantity.
    #[must_use]
    pub const fn field(&self) -> SampleField {
        match self {
            Self::Acceleration(_) => SampleField::Acceleration,
            Self::AngularVelocity(_) => SampleField::AngularVelocity,
            Self::Angles(_) => SampleField::Angles,
            Self::Orientation(_) => SampleField::Orientation,
        }
    }

    /// Stores the value in `sample`.
    pub(super) fn store(self, sample: &mut Sample) {
        match self {
            Self::Acceleration(value) => sample.acceleration = Some(value),
            Self::AngularVelocity(value) => sample.angular_velocity = Some(value),
            Self::Orientation(value) => sample.orientation = Some(value),
            Self::Angles(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imu::sample::Quaternion;
    use proptest::prelude::*;
    use std::vec::Vec;

    extern crate std;

    const PERIOD: u64 = 5000;

    /// The frame `part` of sample `number`, whose first value is the number.
    fn frame(part: usize, number: u16) -> Measured {
        let value = [f32::from(number), 0.0, 0.0];
        match part {
            0 => Measured::Acceleration(value),
            1 => Measured::AngularVelocity(value),
            _ => Measured::Orientation(Quaternion { w: f32::from(number), x: 0.0, y: 0.0, z: 0.0 }),
        }
    }

    /// The numbers in a sample.
    fn numbers(sample: &Sample) -> [f32; 3] {
        let (acceleration, velocity) = (sample.acceleration.unwrap(), sample.angular_velocity.unwrap());
        [acceleration[0], velocity[0], sample.orientation.unwrap().w]
    }

    fn missing(missing: SampleField) -> Result<Option<Sample>, SampleError> {
        Err(SampleError::Incomplete { missing })
    }

    #[test]
    fn every_lost_frame_drops_its_sample_once() {
        for (lost, missing) in ORDER.into_iter().enumerate() {
            let mut sequence = Sequence::new(Parts::ALL, PERIOD / 2);
            let mut errors = 0;
            let mut samples = Vec::new();
            for number in 0..4_u16 {
                for part in (0..3).filter(|part| (number, *part) != (1, lost)) {
                    let at = u64::from(number) * PERIOD + part as u64 * 200;
                    match sequence.push(frame(part, number), at) {
                        Ok(sample) => samples.extend(sample),
                        Err(error) => {
                            errors += 1;
                            assert_eq!(error, SampleError::Incomplete { missing });
                        }
                    }
                }
            }
            assert_eq!(samples.iter().map(numbers).collect::<Vec<_>>(), [[0.0; 3], [2.0; 3], [3.0; 3]]);
            assert_eq!(errors, 1, "frame {lost} lost");
        }
    }

    #[test]
    fn end_of_next_sample_never_completes_this_one() {
        let mut sequence = Sequence::new(Parts::ALL, PERIOD / 2);
        assert_eq!(sequence.push(frame(0, 1), 0), Ok(None));
        // Two frames of this sample and the first of the next are lost.
        assert_eq!(sequence.push(frame(1, 2), PERIOD + 200), missing(SampleField::AngularVelocity));
        assert_eq!(sequence.push(frame(2, 2), PERIOD + 400), Ok(None));
        // A clock that goes back counts as too late.
        assert_eq!(sequence.push(frame(0, 3), 2 * PERIOD), Ok(None));
        assert_eq!(sequence.push(frame(1, 3), PERIOD), missing(SampleField::AngularVelocity));
    }

    #[test]
    fn two_parts_make_a_sample_without_third() {
        let parts = Parts { acceleration: false, ..Parts::ALL };
        let mut sequence = Sequence::new(parts, PERIOD / 2);
        assert_eq!(sequence.push(frame(0, 7), 0), Ok(None));
        assert_eq!(sequence.push(frame(1, 7), 1), Ok(None));
        assert_eq!(sequence.push(Measured::Angles([0.0; 3]), 2), Ok(None));
        let sample = sequence.push(frame(2, 7), 3).unwrap().unwrap();
        assert_eq!((sample.acceleration, sample.angular_velocity), (None, Some([7.0, 0.0, 0.0])));
        let none = Parts { acceleration: false, angular_velocity: false, orientation: false };
        assert_eq!(Sequence::new(none, PERIOD).push(frame(0, 1), 0), Ok(None));
        let one = Parts { acceleration: true, ..none };
        assert!(Sequence::new(one, PERIOD).push(frame(0, 1), 0).unwrap().is_some());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2048))]

        #[test]
        fn lost_frames_never_combine_two_samples(
            kept in prop::collection::vec(prop::array::uniform3((any::<bool>(), 0..300_u64)), 0..40),
        ) {
            let mut sequence = Sequence::new(Parts::ALL, PERIOD / 2);
            let mut found = Vec::new();
            for (number, parts) in (0_u16..).zip(&kept) {
                for (part, (is_kept, delay)) in parts.iter().enumerate() {
                    let at = u64::from(number) * PERIOD + part as u64 * 400 + delay;
                    if *is_kept && let Ok(Some(sample)) = sequence.push(frame(part, number), at) {
                        found.push(numbers(&sample));
                    }
                }
            }
            let is_whole = |(_, parts): &(u16, &[(bool, u64); 3])| parts.iter().all(|(is_kept, _)| *is_kept);
            let whole = (0_u16..).zip(&kept).filter(is_whole);
            let expected: Vec<_> = whole.map(|(number, _)| [f32::from(number); 3]).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
