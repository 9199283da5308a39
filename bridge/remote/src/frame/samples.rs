//! Samples of external IMUs, as bytes.

use super::{FrameError, Up};
use motord_shared::message::ImuMessage;
use motord_shared::plain::Plain;

/// Limit on the samples of a frame.
pub(crate) const SAMPLES_MAX: usize = 32;

impl Up {
    /// Returns the bytes of a frame with the first [`SAMPLES_MAX`] samples. Their times are of the
    /// sender's clock, as that of the head.
    pub(crate) fn with_samples(&self, samples: &[ImuMessage]) -> Vec<u8> {
        let mut bytes = self.beat();
        samples.iter().take(SAMPLES_MAX).for_each(|sample| sample.write(&mut bytes));
        bytes
    }

    /// Returns a frame and its samples, at least one.
    pub(crate) fn read_samples(mut bytes: &[u8]) -> Result<(Self, Vec<ImuMessage>), FrameError> {
        let up = Self::read(&mut bytes)?;
        let count = bytes.len() / size_of::<ImuMessage>();
        if !(1..=SAMPLES_MAX).contains(&count) {
            return Err(FrameError::Malformed);
        }
        let samples = (0..count).map(|_| ImuMessage::read(&mut bytes)).collect::<Option<_>>();
        let samples = samples.filter(|_| bytes.is_empty()).ok_or(FrameError::Malformed)?;
        Ok((up, samples))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{UP, damaged};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn samples_survive_the_network() {
        let sample = ImuMessage { publisher: 3, sequence: 4, time_ns: 5, ..ImuMessage::default() };
        for (sent, read) in [(1, 1), (3, 3), (SAMPLES_MAX + 1, SAMPLES_MAX)] {
            let bytes = UP.with_samples(&vec![sample; sent]);
            assert_eq!(Up::read_samples(&bytes), Ok((UP, vec![sample; read])));
        }
    }

    #[test]
    fn frame_of_too_few_or_many_is_refused() {
        let whole = UP.with_samples(&[ImuMessage::default(); SAMPLES_MAX]);
        let longer = [&whole[..], &[0; size_of::<ImuMessage>()]].concat();
        for bytes in [&UP.beat()[..], &whole[..whole.len() - 1], &longer] {
            assert_eq!(Up::read_samples(bytes), Err(FrameError::Malformed));
        }
    }

    proptest! {
        #[test]
        fn damaged_samples_are_refused_or_read(bytes in damaged(0..400)) {
            let _refused_or_read = Up::read_samples(&bytes);
        }
    }
}
