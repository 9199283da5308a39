//! Samples of external IMUs that mirrors send: which count, and when they were measured by the
//! robot's clock.

use crate::admission::Refused;
use crate::clocks::{Clocks, RoundTrip};
use crate::frame::{Head, SESSIONS_MAX, Up};
use motord_shared::limits::{IMU_PUBLISHERS_MAX, IMUS_MAX};
use motord_shared::message::ImuMessage;
use std::collections::VecDeque;
use std::time::Duration;

/// The newest sample of a publisher for an IMU.
#[derive(Debug)]
struct Source {
    session: u64,
    publisher: u64,
    imu: u32,
    sequence: u64,
    /// Time of the measurement by the clock of its computer, ns.
    measured_ns: u64,
    /// The same by the own clock, ns.
    time_ns: u64,
}

/// The clocks of the mirrors that send samples, and the newest sample of each publisher.
#[derive(Debug, Default)]
pub(super) struct Imus {
    /// By session, the newest first.
    clocks: VecDeque<(u64, Clocks)>,
    sources: VecDeque<Source>,
}

impl Imus {
    /// Compares the clocks by a frame that counts and arrived at `now_ns`.
    pub(super) fn compare(&mut self, up: &Up, now_ns: u64) {
        let Head { from: session, sent_ns, .. } = up.head;
        let index = self.clocks.iter().position(|(of, _)| *of == session);
        let known = index.and_then(|index| self.clocks.remove(index));
        let (_, mut clocks) = known.unwrap_or((session, Clocks::default()));
        let [left_ns, held_ns] = [up.echo.sent_ns, up.echo.held_ns];
        clocks.take(&RoundTrip { left_ns, other_ns: sent_ns, held_ns, arrived_ns: now_ns });
        self.clocks.push_front((session, clocks));
        self.clocks.truncate(SESSIONS_MAX);
    }

    /// Returns a sample of a frame with its time by the own clock, which rises for each publisher.
    /// `transit` is an upper bound of the age of the frame.
    ///
    /// # Errors
    /// The reason why it does not count: it may be older than `age_max`, or is not newer than one
    /// before.
    pub(super) fn admit(
        &mut self,
        head: &Head,
        sample: &ImuMessage,
        transit: Duration,
        age_max: Duration,
        now_ns: u64,
    ) -> Result<ImuMessage, Refused> {
        let waited = head.sent_ns.checked_sub(sample.time_ns).map(Duration::from_nanos);
        let waited = waited.filter(|_| (sample.imu as usize) < IMUS_MAX).ok_or(Refused::Malformed)?;
        if transit.saturating_add(waited) > age_max {
            return Err(Refused::Late);
        }
        let clocks = self.clocks.iter().find(|(of, _)| *of == head.from);
        let offset = clocks.and_then(|(_, clocks)| clocks.offset()).ok_or(Refused::Unechoed)?;
        let source = self.source(head.from, sample);
        if sample.sequence <= source.sequence || sample.time_ns <= source.measured_ns {
            return Err(Refused::Old);
        }
        // A better comparison of the clocks may move a time before that of an earlier sample.
        let time_ns = offset.own(sample.time_ns, now_ns).max(source.time_ns + 1);
        (source.sequence, source.measured_ns, source.time_ns) = (sample.sequence, sample.time_ns, time_ns);
        Ok(ImuMessage { time_ns, ..*sample })
    }

    fn source(&mut self, session: u64, sample: &ImuMessage) -> &mut Source {
        let ImuMessage { publisher, imu, .. } = *sample;
        let is_of =
            |source: &Source| (source.session, source.publisher, source.imu) == (session, publisher, imu);
        let index = self.sources.iter().position(is_of).unwrap_or_else(|| {
            self.sources.truncate(IMU_PUBLISHERS_MAX - 1);
            self.sources.push_front(Source {
                session,
                publisher,
                imu,
                sequence: 0,
                measured_ns: 0,
                time_ns: 0,
            });
            0
        });
        &mut self.sources[index]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Echo;

    const MS: u64 = 1_000_000;
    const AGE_MAX: Duration = Duration::from_millis(50);
    /// The clock of the mirror is ahead by this time, ns.
    const AHEAD: u64 = 3_600_000_000_000;
    const SESSION: u64 = 7;

    /// A frame that left the mirror at `left_ns` of the robot's clock, with the echo of a state that
    /// was `way_ns` on its way, as the frame is.
    fn up(left_ns: u64, way_ns: u64) -> Up {
        let head = Head { from: SESSION, sequence: 1, sent_ns: left_ns + AHEAD };
        Up { head, echo: Echo { of: 1, sent_ns: left_ns - way_ns, held_ns: 0 } }
    }

    /// A sample that was measured at `ns` of the robot's clock.
    fn sample(sequence: u64, ns: u64) -> ImuMessage {
        ImuMessage { publisher: 3, sequence, time_ns: ns + AHEAD, ..ImuMessage::default() }
    }

    fn take(imus: &mut Imus, frame: &Up, sample: &ImuMessage, way_ns: u64) -> Result<u64, Refused> {
        let now_ns = frame.head.sent_ns - AHEAD + way_ns;
        imus.compare(frame, now_ns);
        let transit = Duration::from_nanos(2 * way_ns);
        imus.admit(&frame.head, sample, transit, AGE_MAX, now_ns).map(|sample| sample.time_ns)
    }

    #[test]
    fn time_of_sample_is_of_own_clock() {
        let mut imus = Imus::default();
        assert_eq!(take(&mut imus, &up(100 * MS, MS), &sample(1, 98 * MS), MS), Ok(98 * MS));
        // A slow way: the shorter round trip still compares the clocks.
        let slow = up(110 * MS, 8 * MS);
        assert_eq!(take(&mut imus, &slow, &sample(2, 109 * MS), 8 * MS), Ok(109 * MS));
    }

    #[test]
    fn repeated_and_reordered_samples_are_old() {
        let mut imus = Imus::default();
        let frame = up(100 * MS, MS);
        assert!(take(&mut imus, &frame, &sample(5, 98 * MS), MS).is_ok());
        for (sequence, ns) in [(5, 98 * MS), (5, 99 * MS), (4, 99 * MS), (6, 98 * MS), (6, 97 * MS)] {
            assert_eq!(take(&mut imus, &frame, &sample(sequence, ns), MS), Err(Refused::Old), "{sequence}");
        }
        assert!(take(&mut imus, &frame, &sample(6, 99 * MS), MS).is_ok());
        let other = ImuMessage { publisher: 4, ..sample(1, 90 * MS) };
        assert!(take(&mut imus, &frame, &other, MS).is_ok(), "numbers belong to a publisher");
    }

    #[test]
    fn sample_that_may_be_late_is_refused() {
        let mut imus = Imus::default();
        let frame = up(100 * MS, MS);
        assert_eq!(take(&mut imus, &frame, &sample(1, 52 * MS - 1), MS), Err(Refused::Late));
        assert!(take(&mut imus, &frame, &sample(2, 52 * MS), MS).is_ok());
    }

    #[test]
    fn contradictory_samples_are_malformed() {
        let mut imus = Imus::default();
        let frame = up(100 * MS, MS);
        let later = sample(1, 100 * MS + 1);
        assert_eq!(take(&mut imus, &frame, &later, MS), Err(Refused::Malformed), "after its frame");
        let foreign = ImuMessage { imu: IMUS_MAX as u32, ..sample(1, 99 * MS) };
        assert_eq!(take(&mut imus, &frame, &foreign, MS), Err(Refused::Malformed));
        let mut extreme = sample(u64::MAX, 99 * MS);
        assert!(take(&mut imus, &frame, &extreme, MS).is_ok());
        extreme.time_ns += 1;
        assert_eq!(take(&mut imus, &frame, &extreme, MS), Err(Refused::Old));
    }

    #[test]
    fn times_rise_while_clock_comparison_improves() {
        let mut imus = Imus::default();
        // The state took no time, the frame 8 ms: the middle is wrong by 4 ms.
        let uneven = up(100 * MS, 0);
        imus.compare(&uneven, 108 * MS);
        let late = imus.admit(&uneven.head, &sample(1, 100 * MS), AGE_MAX / 2, AGE_MAX, 108 * MS).unwrap();
        assert_eq!(late.time_ns, 104 * MS);
        let better = take(&mut imus, &up(102 * MS, MS), &sample(2, 102 * MS), MS);
        assert_eq!(better, Ok(104 * MS + 1));
    }

    #[test]
    fn memory_is_bounded() {
        let mut imus = Imus::default();
        for number in 1..100 {
            let frame = Up { head: Head { from: number, ..up(100 * MS, MS).head }, ..up(100 * MS, MS) };
            let sample = ImuMessage { publisher: number, ..sample(1, 99 * MS) };
            take(&mut imus, &frame, &sample, MS).unwrap();
        }
        assert_eq!((imus.clocks.len(), imus.sources.len()), (SESSIONS_MAX, IMU_PUBLISHERS_MAX));
    }
}
