//! The frames between a robot and another computer, as bytes.
//!
//! ```text
//!  mirror ── Up: session, sequence, time, echo of the newest Down ─▶ robot
//!  mirror ◀── Down: run, sequence, time, echo of each session's Up ── robot
//!  mirror ◀── record of a cycle: run, sequence, time ──────────────── robot
//! ```
//!
//! Each frame repeats the time of the newest frame of the other side, and how long that was held.
//! Therefore its receiver knows an upper bound of its age by its own clock alone: see
//! [`Echo::age`].

mod record;
mod samples;

use motord_shared::message::{AdminReply, AdminRequest, ImuMessage, Message};
use motord_shared::packed::{pack, unpack};
use motord_shared::plain::Plain;
use motord_shared::{CycleRecord, SetpointMessage, StateMessage};
pub(crate) use record::{read_record, record_bytes};
pub(crate) use samples::SAMPLES_MAX;
use std::time::Duration;

/// Version of the frames. The layout of a frame contains it.
const VERSION: u32 = 1;

/// Limit on the mirrors of a robot.
pub(crate) const SESSIONS_MAX: usize = 8;

/// Returns a number that differs where frames or the messages in them have another layout.
pub(crate) fn layout() -> u32 {
    let names = [
        StateMessage::TYPE_NAME,
        SetpointMessage::TYPE_NAME,
        AdminRequest::TYPE_NAME,
        ImuMessage::TYPE_NAME,
        CycleRecord::TYPE_NAME,
    ]
    .join(" ");
    // FNV-1a.
    let hash = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
    names.bytes().chain(VERSION.to_le_bytes()).fold(0x811C_9DC5, hash)
}

/// The newest frame of the other side, as the sender of a frame repeats it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Echo {
    /// The session, or the run, of the other side; 0 before its first frame.
    pub(crate) of: u64,
    /// Its time of sending, by the clock of the other side, ns.
    pub(crate) sent_ns: u64,
    /// Time from its receipt to the frame with this echo, by the clock of the sender, ns.
    pub(crate) held_ns: u64,
}

impl Echo {
    /// Returns an upper bound of the age at `now_ns` of the frame with this echo, for the process
    /// `own`, which sent what is repeated: that frame left after `sent_ns + held_ns`. `None` for an
    /// echo of another process, and for one of the future.
    pub(crate) fn age(&self, own: u64, now_ns: u64) -> Option<Duration> {
        let left = self.sent_ns.checked_add(self.held_ns)?;
        let age = now_ns.checked_sub(left).map(Duration::from_nanos);
        age.filter(|_| self.of == own)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        [self.of, self.sent_ns, self.held_ns].write(bytes);
    }

    fn read(bytes: &mut &[u8]) -> Option<Self> {
        let [of, sent_ns, held_ns] = Plain::read(bytes)?;
        Some(Self { of, sent_ns, held_ns })
    }
}

/// The head of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Head {
    /// Session of a mirror, or run of the robot's side: a random number, not 0.
    pub(crate) from: u64,
    /// Rises with every frame of a session, whatever its kind, and with every state of a run. That
    /// of a record is the number of the record.
    pub(crate) sequence: u64,
    /// Time of sending, by the clock of the sender, ns.
    pub(crate) sent_ns: u64,
}

impl Head {
    fn write(&self, bytes: &mut Vec<u8>) {
        layout().write(bytes);
        [self.from, self.sequence, self.sent_ns].write(bytes);
    }

    fn read(bytes: &mut &[u8]) -> Result<Self, FrameError> {
        if u32::read(bytes).ok_or(FrameError::Malformed)? != layout() {
            return Err(FrameError::Layout);
        }
        let [from, sequence, sent_ns] = Plain::read(bytes).ok_or(FrameError::Malformed)?;
        Ok(Self { from, sequence, sent_ns })
    }
}

/// The reason why bytes are no frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FrameError {
    /// Another version of motord-remote sent it, or it is no frame at all.
    Layout,
    /// It is too short, too long, or contradicts itself.
    Malformed,
}

/// A frame of a mirror.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Up {
    pub(crate) head: Head,
    pub(crate) echo: Echo,
}

impl Up {
    /// Returns the bytes of a frame that only measures: of a watcher, or with the key of setpoints of
    /// a mirror that may claim.
    pub(crate) fn beat(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(64);
        self.head.write(&mut bytes);
        self.echo.write(&mut bytes);
        bytes
    }

    /// Returns the bytes of a frame with a setpoint, which its controller sent `age` before it.
    pub(crate) fn with_setpoint(&self, setpoint: &SetpointMessage, age: Duration) -> Vec<u8> {
        let mut bytes = self.beat();
        nanos(age).write(&mut bytes);
        pack(setpoint, &mut bytes);
        bytes
    }

    /// Returns the bytes of a frame with a request. Each attempt to send it has the same `number`.
    pub(crate) fn with_request(&self, number: u64, request: &AdminRequest) -> Vec<u8> {
        let mut bytes = self.beat();
        number.write(&mut bytes);
        request.write(&mut bytes);
        bytes
    }

    fn read(bytes: &mut &[u8]) -> Result<Self, FrameError> {
        let head = Head::read(bytes)?;
        let echo = Echo::read(bytes).ok_or(FrameError::Malformed)?;
        Ok(Self { head, echo })
    }

    /// Returns a frame that only measures.
    pub(crate) fn read_beat(mut bytes: &[u8]) -> Result<Self, FrameError> {
        let up = Self::read(&mut bytes)?;
        if bytes.is_empty() { Ok(up) } else { Err(FrameError::Malformed) }
    }

    /// Returns a frame, its setpoint, and the setpoint's age when the frame was sent.
    pub(crate) fn read_setpoint(mut bytes: &[u8]) -> Result<(Self, SetpointMessage, Duration), FrameError> {
        let up = Self::read(&mut bytes)?;
        let age = u64::read(&mut bytes).ok_or(FrameError::Malformed)?;
        let setpoint = unpack(bytes).ok_or(FrameError::Malformed)?;
        Ok((up, setpoint, Duration::from_nanos(age)))
    }

    /// Returns a frame, and its request with the number.
    pub(crate) fn read_request(mut bytes: &[u8]) -> Result<(Self, u64, AdminRequest), FrameError> {
        let up = Self::read(&mut bytes)?;
        let number = u64::read(&mut bytes).ok_or(FrameError::Malformed)?;
        let request = AdminRequest::read(&mut bytes).filter(|_| bytes.is_empty());
        Ok((up, number, request.ok_or(FrameError::Malformed)?))
    }
}

/// A frame of the robot's side.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Down {
    pub(crate) head: Head,
    /// One for each session, at most [`SESSIONS_MAX`].
    pub(crate) echoes: Vec<Echo>,
    pub(crate) state: Box<StateMessage>,
}

impl Down {
    /// Returns the bytes of a frame with `state`.
    pub(crate) fn bytes(head: &Head, echoes: &[Echo], state: &StateMessage) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(4096);
        head.write(&mut bytes);
        let echoes = &echoes[..echoes.len().min(SESSIONS_MAX)];
        (echoes.len() as u32).write(&mut bytes);
        echoes.iter().for_each(|echo| echo.write(&mut bytes));
        pack(state, &mut bytes);
        bytes
    }

    pub(crate) fn read(mut bytes: &[u8]) -> Result<Self, FrameError> {
        let head = Head::read(&mut bytes)?;
        let count = u32::read(&mut bytes).ok_or(FrameError::Malformed)? as usize;
        if count > SESSIONS_MAX {
            return Err(FrameError::Malformed);
        }
        let echoes = (0..count).map(|_| Echo::read(&mut bytes)).collect::<Option<_>>();
        let (echoes, state) = echoes.zip(unpack(bytes)).ok_or(FrameError::Malformed)?;
        Ok(Self { head, echoes, state: Box::new(state) })
    }
}

/// The bytes of an answer: its head and its text.
pub(crate) fn reply_bytes(reply: &AdminReply, text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(16 + text.len());
    reply.write(&mut bytes);
    bytes.extend_from_slice(text);
    bytes
}

/// The head and the text of an answer.
pub(crate) fn read_reply(mut bytes: &[u8]) -> Option<(AdminReply, &[u8])> {
    Some((AdminReply::read(&mut bytes)?, bytes))
}

/// Returns a duration in ns, at most `u64::MAX`.
pub(crate) fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use std::ops::Range;

    pub(super) const UP: Up = Up {
        head: Head { from: 7, sequence: 8, sent_ns: 9 },
        echo: Echo { of: 10, sent_ns: 11, held_ns: 12 },
    };

    /// Random bytes behind the layout of this version.
    pub(super) fn damaged(length: Range<usize>) -> impl Strategy<Value = Vec<u8>> {
        vec(any::<u8>(), length).prop_map(|mut bytes| {
            let head = layout().to_le_bytes();
            let known = bytes.len().min(head.len());
            bytes[..known].copy_from_slice(&head[..known]);
            bytes
        })
    }

    #[test]
    fn age_is_known_without_common_clock() {
        let echo = Echo { of: 5, sent_ns: 1000, held_ns: 300 };
        assert_eq!(echo.age(5, 1450), Some(Duration::from_nanos(150)));
        assert_eq!(echo.age(5, 1299), None, "it would have left in the future");
        assert_eq!(echo.age(6, 1450), None, "the echo of another process");
        assert_eq!(Echo { held_ns: u64::MAX, ..echo }.age(5, u64::MAX), None);
    }

    #[test]
    fn frames_survive_the_network() {
        let setpoint = SetpointMessage { lease: 1, joint_count: 12, ..Default::default() };
        let age = Duration::from_micros(50);
        assert_eq!(Up::read_setpoint(&UP.with_setpoint(&setpoint, age)), Ok((UP, setpoint, age)));
        assert_eq!(Up::read_beat(&UP.beat()), Ok(UP));
        let request = AdminRequest { operation: 4, group: 1, ..Default::default() };
        assert_eq!(Up::read_request(&UP.with_request(13, &request)), Ok((UP, 13, request)));
        let state = StateMessage { boot_id: 3, joint_count: 12, ..Default::default() };
        let bytes = Down::bytes(&UP.head, &[UP.echo; 3], &state);
        let down = Down::read(&bytes).unwrap();
        assert!(*down.state == state && down.echoes == [UP.echo; 3] && down.head == UP.head);
    }

    #[test]
    fn frame_of_another_layout_is_refused() {
        let mut bytes = UP.beat();
        bytes[0] ^= 1;
        assert_eq!(Up::read_beat(&bytes), Err(FrameError::Layout));
    }

    proptest! {
        #[test]
        fn damaged_frames_are_refused_or_read(bytes in damaged(0..300)) {
            let _refused_or_read = (Up::read_beat(&bytes), Up::read_setpoint(&bytes), Up::read_request(&bytes), Down::read(&bytes));
        }

        #[test]
        fn shortened_frames_are_refused(length in 0..200_usize) {
            let setpoint = SetpointMessage { joint_count: 12, ..Default::default() };
            let bytes = UP.with_setpoint(&setpoint, Duration::ZERO);
            prop_assert!(Up::read_setpoint(&bytes[..length]).is_err());
            prop_assert_eq!(Up::read_beat(&bytes[..length]).is_ok(), length == UP.beat().len());
        }
    }
}
