//! External IMUs: other processes publish their samples.

use super::log::{ImuLog, Remark};
use super::writer::Writer;
use motord_bus::{Duration, Instant};
use motord_core::control::Repetition;
use motord_ports::clock::other_clock;
use motord_settings::sensor::imu::{ImuSample, ImuSettings};
use motord_shared::message::ImuMessage;

/// This many samples in a row that are too old are of an unfit clock; fewer may be late.
const OLD_MAX: u32 = 10;

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
    repetition: Repetition,
    /// The newest sample that was used.
    used: Option<Used>,
    /// Samples in a row that were too old.
    old: u32,
    log: ImuLog,
    /// The publisher of the last rejected sample.
    rejected_publisher: u64,
}

/// The reason why a sample is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rejected {
    /// A value is invalid, the publisher is another one, or the time is not newer than the last.
    Other,
    /// Its time is after now.
    Future,
    /// It is older than `lost-after-ms`.
    Old,
    /// Its publisher repeats one measurement.
    Stuck,
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
    pub(super) fn new(index: usize, imu: &ImuSettings, writer: Writer) -> Self {
        Self {
            index,
            writer,
            lost_after: imu.lost_after,
            repetition: Repetition::default(),
            used: None,
            old: 0,
            log: ImuLog::new(&imu.name),
            rejected_publisher: 0,
        }
    }

    /// Passes a sample that is sound, newer than the one before, and of the publisher that is used.
    /// Counts any other. Its time of receipt is that of the measurement, so that its age contains
    /// the way from the publisher. Wait-free, and allocates nothing but for a line of the log,
    /// whose number is limited.
    fn receive(&mut self, message: &ImuMessage, now: Instant) {
        let time = Instant::from_nanos(message.time_ns);
        let used = self.used.filter(|used| now.since(used.received) <= self.lost_after);
        let sound = match self.check(message, used, now) {
            Ok(sound) => sound,
            Err(reason) => {
                self.writer.rejected();
                return self.remark(message, reason, now);
            }
        };
        self.old = 0;
        let gap = used.map_or(0, |used| message.sequence - used.sequence - 1);
        self.writer.published(message.publisher, u32::try_from(gap).unwrap_or(u32::MAX));
        let _sound = self.writer.sample(&sound, time);
        let ImuMessage { publisher, sequence, .. } = *message;
        self.used = Some(Used { publisher, sequence, time, received: now });
    }

    fn check(
        &mut self,
        message: &ImuMessage,
        used: Option<Used>,
        now: Instant,
    ) -> Result<ImuSample, Rejected> {
        let time = Instant::from_nanos(message.time_ns);
        let is_owner = used.is_none_or(|used| used.publisher == message.publisher);
        let sound = sample(message).checked().filter(|_| message.publisher != 0 && is_owner);
        let sound = sound.ok_or(Rejected::Other)?;
        if time > now {
            return Err(Rejected::Future);
        }
        if now.since(time) > self.lost_after {
            return Err(Rejected::Old);
        }
        if used.is_some_and(|used| used.sequence >= message.sequence || used.time >= time) {
            return Err(Rejected::Other);
        }
        if self.repetition.is_stuck(&sound, time) { Err(Rejected::Stuck) } else { Ok(sound) }
    }

    /// Logs a reason once, until a sample of another publisher is rejected.
    fn remark(&mut self, message: &ImuMessage, reason: Rejected, now: Instant) {
        if core::mem::replace(&mut self.rejected_publisher, message.publisher) != message.publisher {
            self.log.restart();
            self.old = 0;
        }
        self.old = if reason == Rejected::Old { self.old.saturating_add(1) } else { 0 };
        let remark = match reason {
            Rejected::Other => return,
            Rejected::Old if self.old < OLD_MAX => return,
            Rejected::Future | Rejected::Old => Remark::Clock,
            Rejected::Stuck => Remark::Stuck,
        };
        if self.log.is_first(remark) && self.log.permits(now) {
            self.warn(message, remark, now);
        }
    }

    #[cold]
    fn warn(&self, message: &ImuMessage, remark: Remark, now: Instant) {
        let (offset_s, text) = if remark == Remark::Stuck {
            let text = "its publisher repeats one measurement, which is rejected, since a sensor measures noise also at rest: \
                        check the sensor and its driver";
            (None, text.to_owned())
        } else {
            let offset_ns = i128::from(message.time_ns) - i128::from(now.as_nanos());
            let clock =
                other_clock(message.time_ns).map_or_else(String::new, |clock| format!(", and fit {clock}"));
            let text = format!(
                "the times of its samples are after now, or too old{clock}: they are rejected. The publisher must send ns of \
                 CLOCK_MONOTONIC, not after now and not older than lost-after-ms"
            );
            (Some(offset_ns as f64 * 1e-9), text)
        };
        let process = message.publisher >> 32;
        tracing::warn!(imu = self.log.imu(), process, offset_s, see = "imu-lost", "{text}");
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

    /// Takes a message that arrived at `now`. Returns false when it is for no external IMU of this
    /// daemon. Bounded by IMUs.
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
    use motord_settings::sensor::imu::{ImuSource, Mount, WhenLost};
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

    /// Receives the messages, each at the given ms. Returns numbers of samples used, missing and
    /// rejected.
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

    /// The second publisher is rejected while samples of the first are used, and takes over when
    /// they end.
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

    /// A sensor measures noise at rest. Angular velocity and acceleration of [`message`] are always
    /// equal.
    #[test]
    fn repeated_measurement_is_rejected_after_a_second() {
        let (mut imus, mut output) = external();
        for number in 1..=1200 {
            assert!(imus.receive(&message(5, number, number), at(number)));
        }
        let reading = *output.read();
        // The first, 999 within a second, and none after it.
        assert_eq!((reading.sequence, reading.rejected), (1000, 200));
        assert_eq!(reading.received, at(1000), "the cycle finds it lost");
        assert!(imus.sources[0].log.has(Remark::Stuck));
        let moved = ImuMessage { angular_velocity: [0.1, 0.0, 0.0], ..message(5, 1201, 1201) };
        assert!(imus.receive(&moved, at(1201)));
        assert_eq!(output.read().sequence, 1001, "it measures again");
    }

    #[test]
    fn unfit_clock_is_remarked_once_per_publisher() {
        let remarked = |messages: &[(ImuMessage, u64)]| {
            let (mut imus, _output) = external();
            messages.iter().for_each(|(message, ms)| assert!(imus.receive(message, at(*ms))));
            imus.sources[0].log.has(Remark::Clock)
        };
        assert!(remarked(&[(message(5, 1, 1_000_000), 100)]), "of the future");
        let old: Vec<_> = (0..10).map(|turn| (message(5, 1 + turn, turn), 100 + turn)).collect();
        assert!(remarked(&old) && !remarked(&old[..9]), "a few may be late");
        let late = [&old[..9], &[(message(5, 10, 109), 109)], &old[9..]].concat();
        assert!(!remarked(&late), "not in a row");
        assert!(
            !remarked(&[(message(5, 1, 100), 100), (message(6, 1, 1_000_000), 101)]),
            "of another publisher"
        );
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
