//! External IMUs: other processes publish their samples.

use super::writer::Writer;
use motord_bus::{Duration, Instant};
use motord_core::imu::{ImuSample, ImuSettings};
use motord_shared::message::ImuMessage;

/// An external IMU, and the publisher whose samples are used.
///
/// ```text
///           a sound sample
///   free ────────────────────▶ published ──┐ samples of this publisher
///    ▲                            │    ▲   │ that are sound and newer;
///    └────────────────────────────┘    └───┘ all others are rejected
///      no sound sample for `lost_after`
/// ```
pub(super) struct Source {
    /// Its index in the configuration.
    index: usize,
    writer: Writer,
    lost_after: Duration,
    /// The newest sample that was used.
    used: Option<Used>,
}

/// A sample that was used.
#[derive(Clone, Copy)]
struct Used {
    publisher: u64,
    sequence: u64,
    time: Instant,
    /// Time when it was received.
    received: Instant,
}

impl Source {
    pub(super) const fn new(index: usize, imu: &ImuSettings, writer: Writer) -> Self {
        Self { index, writer, lost_after: imu.lost_after, used: None }
    }

    /// Passes a sample that is sound, newer than the one before, and of the publisher that is used. Counts any other. Its time
    /// of receipt is that of the measurement, so that its age contains the way from the publisher. Wait-free.
    fn receive(&mut self, message: &ImuMessage, now: Instant) {
        let time = Instant::from_nanos(message.time_ns);
        let used = self.used.filter(|used| now.since(used.received) <= self.lost_after);
        let is_recent = time <= now && now.since(time) <= self.lost_after;
        let follows = used.is_none_or(|used| {
            used.publisher == message.publisher && used.sequence < message.sequence && used.time < time
        });
        let sound = sample(message).checked().filter(|_| message.publisher != 0 && is_recent && follows);
        let Some(sound) = sound else { return self.writer.rejected() };
        let gap = used.map_or(0, |used| message.sequence - used.sequence - 1);
        self.writer.published(message.publisher, u32::try_from(gap).unwrap_or(u32::MAX));
        let _sound = self.writer.sample(&sound, time);
        let ImuMessage { publisher, sequence, .. } = *message;
        self.used = Some(Used { publisher, sequence, time, received: now });
    }
}

fn sample(message: &ImuMessage) -> ImuSample {
    ImuSample {
        orientation: message.orientation,
        angular_velocity: message.angular_velocity,
        acceleration: message.acceleration,
        temperature: Some(message.temperature).filter(|value| value.is_finite()),
    }
}

/// The external IMUs of a daemon.
pub struct ExternalImus {
    sources: Vec<Source>,
    boot_id: u64,
}

impl ExternalImus {
    pub(super) const fn new(sources: Vec<Source>, boot_id: u64) -> Self {
        Self { sources, boot_id }
    }

    /// Takes a message that arrived at `now`. Returns false when it is for no external IMU of this daemon. Bounded by IMUs.
    pub fn receive(&mut self, message: &ImuMessage, now: Instant) -> bool {
        let index = message.imu as usize;
        let source = self.sources.iter_mut().find(|source| source.index == index);
        match source.filter(|_| message.boot_id == self.boot_id) {
            Some(source) => {
                source.receive(message, now);
                true
            }
            None => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_core::control::ImuReading;
    use motord_core::imu::{ImuSource, Mount, WhenLost};
    use triple_buffer::{Output, TripleBuffer};

    const BOOT: u64 = 7;
    const MILLI: u64 = 1_000_000;

    /// The IMU with index 1, lost after 10 ms.
    fn external() -> (ExternalImus, Output<ImuReading>) {
        let (input, output) = TripleBuffer::new(&ImuReading::default()).split();
        let settings = ImuSettings {
            name: "base".into(),
            source: ImuSource::External,
            rate_hz: 1000.0,
            mount: Mount::ALIGNED,
            lost_after: Duration::from_millis(10),
            when_lost: WhenLost::Report,
        };
        let source = Source::new(1, &settings, Writer::new(input, settings.mount));
        (ExternalImus::new(vec![source], BOOT), output)
    }

    /// A sound sample of `publisher` with this number, of the moment `ms`.
    fn message(publisher: u64, sequence: u64, ms: u64) -> ImuMessage {
        ImuMessage {
            boot_id: BOOT,
            publisher,
            sequence,
            time_ns: ms * MILLI,
            imu: 1,
            orientation: [1.0, 0.0, 0.0, 0.0],
            acceleration: [0.0, 0.0, 9.81],
            temperature: f32::NAN,
            ..ImuMessage::default()
        }
    }

    fn at(ms: u64) -> Instant {
        Instant::from_nanos(ms * MILLI)
    }

    /// Receives the messages, each at the given ms. Returns numbers of samples used, missing and rejected.
    fn counts(messages: &[(ImuMessage, u64)]) -> [u64; 3] {
        let (mut imus, mut output) = external();
        messages.iter().for_each(|(message, ms)| assert!(imus.receive(message, at(*ms))));
        let reading = output.read();
        [reading.sequence, reading.missing.into(), reading.rejected.into()]
    }

    #[test]
    fn only_newer_recent_sound_samples_are_used() {
        let first = (message(5, 1, 100), 100);
        let table: [(&str, ImuMessage, u64, [u64; 3]); 9] = [
            ("the next", message(5, 2, 101), 101, [2, 0, 0]),
            ("after a gap", message(5, 5, 101), 101, [2, 3, 0]),
            ("repeated", message(5, 1, 101), 101, [1, 0, 1]),
            ("of an earlier moment", message(5, 2, 99), 101, [1, 0, 1]),
            ("too old", message(5, 2, 101), 112, [1, 0, 1]),
            ("of the future", message(5, 2, 102), 101, [1, 0, 1]),
            ("of nobody", message(0, 2, 101), 101, [1, 0, 1]),
            ("not finite", ImuMessage { acceleration: [f32::NAN; 3], ..message(5, 2, 101) }, 101, [1, 0, 1]),
            (
                "no unit",
                ImuMessage { orientation: [0.9, 0.0, 0.0, 0.0], ..message(5, 2, 101) },
                101,
                [1, 0, 1],
            ),
        ];
        for (what, message, ms, expected) in table {
            assert_eq!(counts(&[first, (message, ms)]), expected, "{what}");
        }
    }

    /// The second publisher is rejected while samples of the first are used, and takes over when they end.
    #[test]
    fn one_publisher_at_a_time() {
        let (mut imus, mut output) = external();
        let mut publisher = |message: &ImuMessage, ms| {
            assert!(imus.receive(message, at(ms)));
            output.read().publisher
        };
        assert_eq!(publisher(&message(5, 9, 100), 100), 5);
        assert_eq!(publisher(&message(6, 1, 105), 105), 5);
        assert_eq!(publisher(&message(6, 2, 110), 110), 5);
        assert_eq!(publisher(&message(6, 3, 111), 111), 6);
        assert_eq!(publisher(&message(5, 10, 112), 112), 6);
    }

    #[test]
    fn samples_of_others_reach_no_imu() {
        let (mut imus, mut output) = external();
        for message in
            [ImuMessage { imu: 0, ..message(5, 1, 1) }, ImuMessage { boot_id: 8, ..message(5, 1, 1) }]
        {
            assert!(!imus.receive(&message, at(1)));
        }
        let hostile = ImuMessage { sequence: u64::MAX, time_ns: u64::MAX, imu: u32::MAX, ..message(5, 1, 1) };
        assert!(!imus.receive(&hostile, at(1)));
        assert!(imus.receive(&ImuMessage { imu: 1, ..hostile }, at(1)));
        assert_eq!((output.read().sequence, output.read().rejected), (0, 1));
    }
}
