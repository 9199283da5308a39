//! The state of a line: the open request, and which of the bytes that arrive reply to it. Pure: no
//! port, no clock.
//!
//! A line carries one request at a time. A reply names only its receiver, so the request determines
//! its sender.
//!
//! - *Echo*: an adapter may return the bytes that it sends. They are dropped when they are the
//!   first bytes after sending. A frame for the motor itself is a damaged echo, unless the motor's
//!   host id is its own id. Where the host id is unknown, it may be a reply until the line has
//!   returned a whole request.
//! - *Late replies*: where motors share a host id, a late reply to an abandoned request looks like
//!   the reply of the next motor. The line drops the first such frame and skips one turn. A second
//!   frame proves that the first was late, and is the reply. Without a second one, the motor of the
//!   abandoned request counts as silent. It then costs its neighbours nothing until it replies
//!   again.
//! - The line skips at most one turn per round, so that a motor that is always late does not keep
//!   delaying another's turn. A reply that is two turns late is not detected: only a host id for
//!   each motor helps.
//! - *ACK frames* refuse the request, unless a reply follows in the same read. Noise contains four
//!   valid bytes more often than twelve.

use super::framing::{Decoder, FRAME_LEN_MAX, FrameType, PAYLOAD_LEN, SerialFrame};
use super::{Address, Answers, Settings};
use crate::Readiness;
use crate::frame::{Content, Frame, FrameId, Unsupported};
use crate::time::{Duration, Instant};
use core::cell::Cell;
use nix::errno::Errno;

/// A reply that is later than this never arrives.
const LATEST_REPLY: Duration = Duration::from_millis(50);

/// A request as it is on the line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Request {
    address: Address,
    frame: SerialFrame,
    bytes: [u8; FRAME_LEN_MAX],
}

impl Request {
    /// `None` when `frame` is not a classic one of eight bytes.
    pub(super) fn new(address: Address, frame: &Frame) -> Option<Self> {
        let payload = frame.is_classic().then(|| frame.payload())?;
        let frame = SerialFrame::normal(address.id, payload.try_into().ok()?);
        let mut bytes = [0; FRAME_LEN_MAX];
        frame.write(&mut bytes);
        Some(Self { address, frame, bytes })
    }

    /// Returns the bytes to send.
    pub(super) const fn bytes(&self) -> &[u8; FRAME_LEN_MAX] {
        &self.bytes
    }

    /// Returns `true` when a frame for `receiver` may be a reply. `has_echo`: the line has returned
    /// a request.
    fn may_go_to(&self, receiver: u8, has_echo: bool) -> bool {
        let Address { id, host_id } = self.address;
        match host_id {
            Some(host_id) => receiver == host_id,
            None => receiver != id || !has_echo,
        }
    }
}

/// The reply to a request.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reply {
    /// The motor that received the request.
    id: u8,
    payload: [u8; PAYLOAD_LEN],
}

impl Reply {
    /// Writes the reply as a frame with the id of the motor that received the request.
    pub(super) fn write(self, frame: &mut Frame) {
        frame.set(FrameId::from(self.id), self.payload);
    }
}

/// A request on the line.
#[derive(Debug, Clone, Copy)]
struct Open {
    request: Request,
    sent_at: Instant,
    /// Number of bytes of its echo that have arrived; `None` once other bytes arrived, or the whole
    /// echo.
    echo: Option<usize>,
    /// An ACK frame arrived.
    refused: bool,
}

/// State of the suspicion that the next matching frame is the late reply of the motor with this id,
/// whose request came before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum LateReply {
    None,
    /// The next frame may be late.
    Expected(u8),
    /// Such a frame was dropped, and no turn was skipped since.
    Dropped(u8),
    /// Such a frame was dropped, and a turn was skipped.
    Waited(u8),
}

/// One line.
pub(super) struct Line {
    /// Sorted by id.
    addresses: Vec<Address>,
    reply_timeout: Duration,
    answers: Answers,
    decoder: Decoder,
    /// The last request, until the motor replies to it or refuses it.
    open: Option<Open>,
    late_reply: LateReply,
    /// Number of requests since a turn was skipped.
    since_left_out: usize,
    /// By id: the last abandoned request to the motor had no late reply, and the motor has not
    /// replied since.
    silent: [bool; 256],
    /// An adapter has returned a whole request.
    has_echo: bool,
    /// Bytes that are part of no reply have arrived since the last read.
    unmatched: bool,
}

impl Line {
    /// Returns a line without requests. Allocates.
    pub(super) fn new(settings: &Settings) -> Self {
        let mut addresses = settings.addresses.clone();
        addresses.sort_by_key(|address| address.id);
        Self {
            addresses,
            reply_timeout: settings.reply_timeout,
            answers: settings.answers,
            decoder: Decoder::new(),
            open: None,
            late_reply: LateReply::None,
            since_left_out: usize::MAX,
            silent: [false; 256],
            has_echo: false,
            unmatched: false,
        }
    }

    /// Returns `true` while a request is open and its reply is not overdue.
    pub(super) fn is_busy(&self, now: Instant) -> bool {
        self.open.is_some_and(|open| now.since(open.sent_at) < self.reply_timeout)
    }

    /// Returns `true` when a turn must be skipped, to find out whose frame was dropped. At most
    /// once per such frame, and once per round.
    pub(super) fn leaves_out_a_turn(&mut self) -> bool {
        let LateReply::Dropped(earlier) = self.late_reply else { return false };
        if self.since_left_out < self.addresses.len() {
            return false;
        }
        self.since_left_out = 0;
        self.late_reply = LateReply::Waited(earlier);
        true
    }

    /// Returns `true` when the last request has no reply yet. Even its bytes may not have left.
    pub(super) const fn is_unanswered(&self) -> bool {
        self.open.is_some()
    }

    /// Returns the request for `frame`; `None` when it is not a classic one of eight bytes, or its
    /// id does not fit into one byte.
    pub(super) fn request(&self, frame: &Frame) -> Option<Request> {
        let id = frame.id().byte()?;
        let listed = self.addresses.binary_search_by_key(&id, |address| address.id);
        let address = listed.map_or(Address { id, host_id: None }, |index| self.addresses[index]);
        Request::new(address, frame)
    }

    /// Records that `request` was sent at `now`. A request that is still open is abandoned.
    pub(super) fn sent(&mut self, request: Request, now: Instant) {
        self.late_reply = self.give_up(&request, now);
        self.since_left_out = self.since_left_out.saturating_add(1);
        self.unmatched |= self.decoder.reset() > 0;
        self.open = Some(Open { request, sent_at: now, echo: Some(0), refused: false });
    }

    fn give_up(&mut self, next: &Request, now: Instant) -> LateReply {
        let Some(Open { request, sent_at, .. }) = self.open.take() else { return LateReply::None };
        let id = request.address.id;
        if let LateReply::Expected(earlier) | LateReply::Waited(earlier) = self.late_reply {
            self.silent[usize::from(earlier)] = true;
        }
        // A turn was skipped and no second frame arrived: the dropped frame was the reply to this
        // request.
        let has_replied = matches!(self.late_reply, LateReply::Waited(_));
        let is_alike = next.address.host_id.is_none_or(|host| request.may_go_to(host, self.has_echo));
        let may_arrive = now.since(sent_at) < LATEST_REPLY && !self.silent[usize::from(id)];
        if !has_replied && id != next.address.id && is_alike && may_arrive {
            LateReply::Expected(id)
        } else {
            LateReply::None
        }
    }

    /// Takes the next byte. Returns the reply that it completes.
    ///
    /// Real-time: does not allocate or block; tries at most 12 positions for each of at most 12
    /// bytes.
    pub(super) fn push(&mut self, byte: u8) -> Option<Reply> {
        let Some(open) = &mut self.open else {
            self.unmatched = true;
            return None;
        };
        let Some(matched) = open.echo else { return self.decode(byte) };
        let bytes = open.request.bytes;
        if bytes[matched] == byte {
            open.echo = Some(matched + 1).filter(|matched| *matched < bytes.len());
            self.has_echo |= open.echo.is_none();
            return None;
        }
        open.echo = None;
        // The beginning of the request alone completes no reply.
        for &byte in &bytes[..matched] {
            let _none = self.decode(byte);
        }
        self.decode(byte)
    }

    fn decode(&mut self, byte: u8) -> Option<Reply> {
        let open = self.open.as_mut()?;
        let Open { request, refused, .. } = open;
        let (answers, echoed) = (self.answers, Cell::new(self.has_echo));
        let skipped = self.decoder.skipped();
        let frame = self.decoder.push(byte, |frame| {
            let is_echo = *frame == request.frame;
            echoed.set(echoed.get() | is_echo);
            let fits =
                frame.frame_type() == FrameType::Ack || answers(request.frame.payload(), frame.payload());
            !is_echo && fits && request.may_go_to(frame.receiver(), echoed.get())
        });
        self.has_echo = echoed.get();
        self.unmatched |= self.decoder.skipped() != skipped;
        let (frame, id) = (frame?, request.address.id);
        if let LateReply::Expected(earlier) = self.late_reply {
            self.late_reply = LateReply::Dropped(earlier);
            self.unmatched = true;
            return None;
        }
        if frame.frame_type() == FrameType::Ack {
            *refused = true;
            return None;
        }
        self.replied(id);
        Some(Reply { id, payload: frame.payload().try_into().ok()? })
    }

    /// Closes the open request: the motor with this id has replied.
    fn replied(&mut self, id: u8) {
        if let LateReply::Dropped(earlier) | LateReply::Waited(earlier) = self.late_reply {
            self.silent[usize::from(earlier)] = false;
        }
        self.late_reply = LateReply::None;
        self.silent[usize::from(id)] = false;
        self.open = None;
    }

    /// Ends a read. Returns the id of the motor that refused its request.
    pub(super) fn refusal(&mut self) -> Option<Content> {
        let id = self.open.filter(|open| open.refused)?.request.address.id;
        self.replied(id);
        Some(Content::Refused(FrameId::from(id)))
    }

    /// Returns a report when bytes that are part of no reply have arrived since the last call.
    pub(super) fn unmatched(&mut self) -> Option<Content> {
        core::mem::take(&mut self.unmatched).then_some(Content::Unsupported(Unsupported::Unmatched))
    }
}

/// The bytes of a line, in both directions. [`SerialBus::open`](super::SerialBus::open) uses those
/// of a serial port.
pub trait ByteStream: Send {
    /// Writes `bytes`, and returns how many were accepted. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when none was accepted.
    fn write(&self, bytes: &[u8]) -> Result<usize, Errno>;

    /// Reads bytes that have arrived, and returns their number; 0 when the other end is closed.
    /// Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's: `EAGAIN` when nothing has arrived.
    fn read(&self, buffer: &mut [u8]) -> Result<usize, Errno>;

    /// Returns the number of bytes that have not left. Never blocks; at most one system call.
    ///
    /// # Errors
    ///
    /// The kernel's.
    fn unsent(&self) -> Result<usize, Errno>;

    /// Returns the event at which the next [`read`](Self::read) returns something.
    fn readiness(&self) -> Readiness<'_>;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Format;

    const TIMEOUT: Duration = Duration::from_millis(2);
    const START: Instant = Instant::from_nanos(1_000_000_000);
    /// A command to stop, and the reply that confirms it.
    const STOP: [u8; 8] = [0x92, 0x00, 0x80, 0, 0, 0, 0x08, 0];
    const STOPPED: [u8; 8] = [0x92, 0, 0, 0, 0, 0, 0, 0];
    const VERSION: [u8; 8] = [0xB1, 0, 0, 0, 3, 2, 1, 0];
    const HOST: u8 = 0x40;

    fn same_command(request: &[u8], reply: &[u8]) -> bool {
        request[0] == reply[0]
    }

    /// Motors 1 and 2 share a host id, motor 3 has a separate one.
    fn line() -> Line {
        line_of(&[(3, 0x43), (1, HOST), (2, HOST)])
    }

    /// A line of motors with these ids and host ids.
    fn line_of(motors: &[(u8, u8)]) -> Line {
        let address = |&(id, host_id)| Address { id, host_id: Some(host_id) };
        Line::new(&Settings {
            device: String::new(),
            baud: 921_600,
            addresses: motors.iter().map(address).collect(),
            reply_timeout: TIMEOUT,
            answers: same_command,
        })
    }

    fn ask(line: &mut Line, id: u8, millis: u64) -> Vec<u8> {
        let request = line.request(&Frame::classic(FrameId::from(id), STOP)).unwrap();
        line.sent(request, START + Duration::from_millis(millis));
        request.bytes().to_vec()
    }

    fn bytes(frame: &SerialFrame) -> Vec<u8> {
        frame.write(&mut [0; FRAME_LEN_MAX]).to_vec()
    }

    fn reply(receiver: u8) -> Vec<u8> {
        bytes(&SerialFrame::normal(receiver, STOPPED))
    }

    fn ack(receiver: u8) -> Vec<u8> {
        bytes(&SerialFrame::ack(receiver, &[]).unwrap())
    }

    /// Returns the arrivals of one read.
    fn read(line: &mut Line, bytes: &[u8]) -> Vec<Content> {
        let reply = bytes.iter().filter_map(|byte| line.push(*byte)).last().map(|reply| {
            let mut frame = Frame::EMPTY;
            reply.write(&mut frame);
            Content::Frame(frame)
        });
        reply.or_else(|| line.refusal()).into_iter().chain(line.unmatched()).collect()
    }

    fn from(id: u8) -> Content {
        Content::Frame(Frame::classic(FrameId::from(id), STOPPED))
    }

    const UNMATCHED: Content = Content::Unsupported(Unsupported::Unmatched);

    #[test]
    fn a_request_has_the_header_of_the_document() {
        assert_eq!(ask(&mut line(), 1, 0), [&[0x01, 0x00, 0x08, 0x09][..], &STOP].concat());
        let line = line();
        assert!(line.request(&Frame::classic(FrameId::new(0x101).unwrap(), STOP)).is_none());
        assert!(line.request(&Frame::new(FrameId::from(1), &STOP[..6]).unwrap()).is_none());
        assert!(line.request(&Frame::classic(FrameId::extended(1).unwrap(), STOP)).is_none());
        assert!(line.request(&Frame::with_format(FrameId::from(1), Format::FD, &STOP).unwrap()).is_none());
    }

    #[test]
    fn reply_has_id_of_asked_motor() {
        let mut line = line();
        for id in [1, 2] {
            ask(&mut line, id, 0);
            assert!(line.is_unanswered());
            assert_eq!(read(&mut line, &reply(HOST)), [from(id)]);
            assert!(!line.is_unanswered());
        }
        ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &reply(1)), [UNMATCHED], "its host id is another");
        assert_eq!(read(&mut line, &reply(HOST))[0], from(1));
        ask(&mut line, 9, 0);
        assert_eq!(
            read(&mut line, &reply(0x77)),
            [from(9)],
            "replies of an unlisted motor may have any receiver"
        );
    }

    /// Goal: a motor that is always one turn late never keeps a neighbour from receiving commands.
    #[test]
    fn always_late_motor_answers_alternate_turns_only() {
        let mut line = line_of(&[1, 2, 3].map(|id| (id, HOST)));
        let mut replies = 0;
        for round in 0..20 {
            ask(&mut line, 1, 5 * round);
            ask(&mut line, 2, 5 * round + 1);
            assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "motor 1, or motor 2");
            if !line.leaves_out_a_turn() {
                ask(&mut line, 3, 5 * round + 2);
                replies += 1;
                assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "motor 2, or motor 3");
            }
            read(&mut line, &reply(HOST));
        }
        assert_eq!(replies, 10);
    }

    #[test]
    fn unrequested_frames_and_bytes_are_no_replies() {
        let mut line = line();
        assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "no request is open");
        ask(&mut line, 3, 0);
        assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "the host of the other motors");
        assert_eq!(read(&mut line, &bytes(&SerialFrame::normal(0x43, VERSION))), [UNMATCHED]);
        assert_eq!(read(&mut line, &reply(0x43))[0], from(3));
        assert_eq!(read(&mut line, &reply(0x43)), [UNMATCHED], "it was answered before");
    }

    #[test]
    fn line_is_busy_until_reply_or_timeout() {
        let mut line = line();
        assert!(!line.is_busy(START));
        ask(&mut line, 1, 0);
        assert!(line.is_busy(START + Duration::from_micros(1999)));
        assert!(!line.is_busy(START + TIMEOUT));
        assert_eq!(read(&mut line, &reply(HOST)), [from(1)], "late, but no other request was sent");
        assert!(!line.is_busy(START));
    }

    #[test]
    fn echo_is_dropped_whole_split_or_noisy() {
        for noise in [&[][..], &[0x00, 0x01], &[0x01]] {
            let mut line = line();
            for round in 0..3 {
                let echo = ask(&mut line, 1, round);
                let (first, second) = echo.split_at(5);
                assert!(!read(&mut line, &[noise, first].concat()).contains(&from(1)));
                let arrivals = read(&mut line, &[second, &reply(HOST)].concat());
                assert_eq!(arrivals[0], from(1), "{noise:02X?}");
            }
        }
    }

    #[test]
    fn damaged_echo_is_no_reply() {
        let mut line = line();
        let echo = ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &[echo.clone(), reply(HOST)].concat()), [from(1)]);
        for at in 4..FRAME_LEN_MAX {
            let mut damaged = ask(&mut line, 1, 0);
            damaged[at] ^= 0x10;
            assert_eq!(read(&mut line, &damaged), [UNMATCHED], "byte {at}");
            assert_eq!(read(&mut line, &reply(HOST))[0], from(1));
        }
    }

    /// An adapter that begins to return requests may lose a byte of the first one.
    #[test]
    fn first_echo_with_lost_byte_is_no_reply() {
        for lost in 4..FRAME_LEN_MAX {
            let mut line = line();
            let mut damaged = ask(&mut line, 1, 0);
            damaged.remove(lost);
            let read = read(&mut line, &[damaged, reply(HOST)].concat());
            assert_eq!(read, [from(1), UNMATCHED], "byte {lost}");
        }
    }

    #[test]
    fn reply_beginning_like_request_is_no_echo() {
        let mut line = line_of(&[(1, 1)]);
        ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &reply(1)), [from(1)], "the header and the command are the same");
    }

    #[test]
    fn ack_refuses_request_unless_reply_follows() {
        let mut line = line();
        ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &ack(HOST)), [Content::Refused(FrameId::from(1))]);
        assert!(!line.is_busy(START));
        assert_eq!(read(&mut line, &ack(HOST)), [UNMATCHED], "nothing is open");
        ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &[ack(HOST), reply(HOST)].concat()), [from(1)]);
        ask(&mut line, 1, 0);
        assert_eq!(read(&mut line, &ack(0x43)), [UNMATCHED], "for another host");
    }

    #[test]
    fn late_reply_is_not_taken_for_next_motor() {
        let mut line = line();
        for round in 0..5 {
            ask(&mut line, 1, 10 * round);
            ask(&mut line, 2, 10 * round + 2);
            assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "sent by motor 1 or by motor 2");
            assert_eq!(read(&mut line, &reply(HOST)), [from(2)], "the other was late");
        }
    }

    /// Each reply arrives a turn late, as with an adapter that is slower than its configured
    /// turnaround.
    #[test]
    fn uniformly_late_replies_are_never_confused() {
        let mut line = line();
        let (mut asked, mut distinct) = (None, 0);
        for turn in 0..100 {
            let late = asked.take();
            if !line.leaves_out_a_turn() {
                let id = 1 + (turn % 2) as u8;
                ask(&mut line, id, 2 * turn);
                asked = Some(id);
            }
            let arrivals = late.map_or(vec![], |_| read(&mut line, &reply(HOST)));
            for content in arrivals.into_iter().filter(|content| *content != UNMATCHED) {
                assert_eq!(Some(content), late.map(from), "turn {turn}");
                distinct += 1;
            }
        }
        assert!(distinct > 20, "{distinct}");
    }

    #[test]
    fn silent_motor_costs_neighbour_one_reply() {
        let mut line = line();
        let mut lost = 0;
        for round in 0..20 {
            ask(&mut line, 1, 10 * round);
            ask(&mut line, 2, 10 * round + 2);
            lost += usize::from(read(&mut line, &reply(HOST)) != [from(2)]);
            let _left_out = line.leaves_out_a_turn();
        }
        assert_eq!(lost, 1);
        ask(&mut line, 1, 300);
        assert_eq!(read(&mut line, &reply(HOST)), [from(1)], "it replies again");
        ask(&mut line, 1, 310);
        ask(&mut line, 2, 312);
        assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED], "and may be late again");
    }

    #[test]
    fn motors_with_distinct_host_ids_are_never_confused() {
        let mut line = line();
        for round in 0..5 {
            ask(&mut line, 1, 10 * round);
            ask(&mut line, 3, 10 * round + 2);
            assert_eq!(read(&mut line, &reply(HOST)), [UNMATCHED]);
            assert_eq!(read(&mut line, &reply(0x43))[0], from(3));
        }
    }

    #[test]
    fn lost_byte_costs_one_reply_only() {
        for lost in 0..FRAME_LEN_MAX {
            let mut line = line();
            ask(&mut line, 1, 0);
            let mut damaged = reply(HOST);
            damaged.remove(lost);
            assert!(!read(&mut line, &damaged).contains(&from(1)));
            ask(&mut line, 1, 2);
            assert!(read(&mut line, &reply(HOST)).contains(&from(1)), "byte {lost}");
        }
    }
}
