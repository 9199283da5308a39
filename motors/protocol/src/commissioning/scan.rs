//! Finds motors without moving one.
//!
//! On CAN, the first request to an id is an MIT stop frame: seven times 0xFF, then 0xFD. A motor in
//! MIT mode stops and reports its motion. A motor in native mode refuses an unknown command. No
//! other driver sold under the same names has a command of these bytes. An id without an answer
//! then receives the native read 0x84 of its own id. A motor in MIT mode reads it as a control
//! frame without stiffness, damping and torque. Serial lines are always native.
//!
//! Each id also receives RobStride's question for the device, with an id of 29 bits. Motors whose
//! commands have 11 bits do not receive it. It moves and changes no motor. Ids up to 32 then receive
//! MyActuator's questions for status and angle at 0x140 + id. They move and change no such motor. They
//! are not sent to ids of a CANSimple driver that reports.
//!
//! Another node may send while a scan runs. Answers of MIT and native motors are therefore requested twice, and
//! the scan ends with a time without requests: frames that arrive in it are no answers.
//!
//! A scan never sends the following frames:
//! - 0xB1, which sets the zero position in another driver family;
//! - 0xB2, unless requested, which sets a speed limit there;
//! - an MIT fault request, which other firmware reads as full stiffness;
//! - frames to the ids 0 and 255, which are broadcasts there;
//! - unless requested, frames to ids that a driver of another family obeys. The scan listens first,
//!   and recognises such drivers by their reports. A silent one is not recognised: the frames with
//!   lasting effect on one with a factory id are not sent either ([`LASTING`]).

use crate::cansimple::commissioning::Axis;
use crate::cansimple::{FAMILY, NODE_MAX};
use crate::gim::commissioning::Native;
use crate::gim::{Command, ConfigurationItem, Outcome, Pending, Refusal, Reply, Value, decode_reply};
use crate::link::Error;
use crate::link::Formats;
use crate::link::{LASTING, Unprompted};
use crate::link::{Link, LinkEvent, Wire};
use crate::myactuator::commissioning::Rmd;
use crate::myactuator::{self, MOTORS_MAX};
use crate::profile::STEADYWIN;
use crate::reported::Question;
use crate::robstride::commissioning::Private;
use crate::robstride::{ID_MAX, parameter};
use crate::{Scales, mit};
use motord_bus::{Duration, Frame, FrameId};
use std::ops::RangeInclusive;

/// Longer than the usual periods of heartbeats, at most 1 s.
pub const LISTEN: Duration = Duration::from_millis(1200);

/// A scan ends with this part of the time for which it first listens.
const REST: u32 = 4;
/// Most repetitions of a request whose answer may be a frame of another node.
const REPETITIONS: u32 = 3;

/// Settings of a scan.
#[derive(Debug, Clone)]
pub struct Scan {
    /// Ids to scan, within 1 to 254.
    pub ids: RangeInclusive<u8>,
    /// Time for which the scan of a CAN bus only listens, before it sends the first frame.
    pub listen: Duration,
    /// Time for which the scan collects the answers to each frame, to receive those of two motors
    /// with one id.
    pub window: Duration,
    /// Also requests the fault of ids without an answer (0xB2): a motor with a fault may answer
    /// nothing else. Only for a bus whose drivers are all known to be of this family.
    pub in_fault: bool,
    /// Also requests ids that a driver of another family obeys, or would obey if there is a silent
    /// one.
    pub obeyed: bool,
}

impl Default for Scan {
    fn default() -> Self {
        Self {
            ids: 1..=0xFE,
            listen: LISTEN,
            window: Duration::from_millis(6),
            in_fault: false,
            obeyed: false,
        }
    }
}

/// A motor that answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// The id of the request.
    pub id: u8,
    /// The id of its answers; `None` when a serial motor does not report it.
    pub host_id: Option<FrameId>,
    /// The kind of driver, as far as its answer identifies it.
    pub family: Family,
    /// The motor refuses requests, usually because of a fault.
    pub refusal: Option<Refusal>,
}

/// The kind of driver, as far as an answer identifies it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// The native protocol of the GIM document (SDC101, SDC102, SDC103).
    Native,
    /// MIT with answers of six bytes: SteadyWin's (MIT document 1.2), or a relative.
    Mit,
    /// MIT with longer answers: other vendors, and SteadyWin drivers of other families.
    OtherMit {
        /// Bytes of an answer.
        length: u8,
    },
    /// RobStride's private protocol, which its motors speak from the factory.
    RobStride {
        /// The serial number of the motor's microcontroller.
        serial: [u8; 8],
    },
    /// CANSimple with a node id (SDC104, GDS68, GDZ, ODrive).
    CanSimple,
    /// MyActuator's own protocol.
    MyActuator,
    /// An answer that no supported document lists.
    Unknown {
        /// The answer.
        answer: Frame,
    },
}

impl Family {
    /// Returns whether the id and the form of an answer exclude a frame of another node.
    const fn is_certain(self) -> bool {
        matches!(self, Self::RobStride { .. } | Self::CanSimple | Self::MyActuator)
    }

    /// Returns a sentence with the driver, and the facts that its answer does not contain.
    #[must_use]
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Native => "native protocol, drivers SDC101 to SDC103",
            Self::Mit => {
                "MIT, six bytes: drivers SDC101 to SDC103 or a relative; model, torque constant, gear ratio, bit rate and \
                 faults cannot be read in MIT"
            }
            Self::OtherMit { .. } => {
                "MIT of another vendor or driver family; vendor, ranges and model cannot be read: take them from its label"
            }
            Self::RobStride { .. } => {
                "RobStride's private protocol, set by the factory; the model cannot be read: take it from its label"
            }
            Self::CanSimple => {
                "CANSimple: SteadyWin's drivers SDC104, GDS68 and GDZ, or an ODrive, which motord does not support; the model cannot be \
                 read: take it from its label"
            }
            Self::MyActuator => {
                "MyActuator's protocol; model and largest torque code cannot be read: take them from its label and documents"
            }
            Self::Unknown { .. } => "answers like no supported driver: send it no further frames",
        }
    }
}

/// Progress of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The last requested id.
    pub id: u8,
    /// Number of motors so far.
    pub found: usize,
}

/// The result of a scan.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Report {
    /// The motors, by id. Two entries with one id are two motors with one id.
    pub found: Vec<Found>,
    /// Drivers that send without a request.
    pub unprompted: Vec<Unprompted>,
    /// Ids whose answers destroyed each other: several motors with one id and one host id.
    pub collisions: Vec<u8>,
    /// Frames in formats that motord does not use, and that arrived without a request.
    pub unasked_formats: Formats,
    /// Ids whose requests were followed by such frames, where none arrived without a request.
    pub formats: Vec<(u8, Formats)>,
    /// Ids of frames that arrived after the last request: other nodes send them. An answer of an
    /// MIT or native motor with such an id does not count.
    pub unasked: Vec<FrameId>,
    /// Ids that were skipped, because a detected driver would read the requests as commands.
    pub skipped: Vec<u8>,
    /// Ids that were skipped, because the request would have a lasting effect on a silent driver of
    /// another family.
    pub lasting: Vec<u8>,
}

/// Requests every id that no driver of another family would read as a command, by the requests of all
/// families. Calls `progress` after each requested id, which ends the scan by returning `false`.
///
/// # Errors
///
/// [`Error::InUse`] before anything is sent, when frames other than [`Unprompted`] arrive;
/// [`Error::Bus`]; [`Error::Interrupted`].
pub fn scan(
    link: &mut Link,
    scan: &Scan,
    progress: &mut dyn FnMut(Progress) -> bool,
) -> Result<Report, Error> {
    link.listen(scan.listen)?;
    let unasked_formats = link.formats();
    let unprompted = link.unprompted().to_vec();
    let mut report = Report { unprompted, unasked_formats, ..Report::default() };
    report.found.extend(nodes(&report.unprompted).filter(|found| scan.ids.contains(&found.id)));
    for id in scan.ids.clone().filter(|id| (1..=0xFE).contains(id)) {
        let is_owned = report.unprompted.iter().any(|driver| driver.owns(id));
        let is_lasting = link.wire() == Wire::Can && LASTING.contains(&id);
        if !scan.obeyed && (is_owned || is_lasting) {
            if is_owned { &mut report.skipped } else { &mut report.lasting }.push(id);
        }
        let before = link.formats();
        let (found, collided) = ask_all(link, id, scan, !scan.obeyed && (is_owned || is_lasting))?;
        let formats = link.formats().since(before);
        report.formats.extend((formats.is_any() && !unasked_formats.is_any()).then_some((id, formats)));
        report.found.extend(found);
        report.collisions.extend(collided.then_some(id));
        if !progress(Progress { id, found: report.found.len() }) {
            return Err(Error::Interrupted);
        }
    }
    report.unasked = unasked(link, scan.listen / REST)?;
    let is_unasked = |found: &Found| found.host_id.is_some_and(|id| report.unasked.contains(&id));
    report.found.retain(|found| found.family.is_certain() || !is_unasked(found));
    Ok(report)
}

/// Returns the ids of frames that arrive within `time` without a request, except those of drivers that
/// report.
fn unasked(link: &mut Link, time: Duration) -> Result<Vec<FrameId>, Error> {
    let mut ids = Vec::new();
    if link.wire() == Wire::Serial || time.is_zero() {
        return Ok(ids);
    }
    link.pause(link.timeout());
    let drivers = link.unprompted().to_vec();
    let _end = link.receive(time, |event| {
        if let LinkEvent::Frame(frame) = event
            && !drivers.iter().any(|driver| driver.sends(frame.id()))
            && !ids.contains(&frame.id())
        {
            ids.push(frame.id());
        }
        None::<()>
    })?;
    Ok(ids)
}

/// Returns the CANSimple drivers among `drivers`. They report by themselves, so they receive nothing:
/// an MIT motor would read a request to a driver as a control frame.
fn nodes(drivers: &[Unprompted]) -> impl Iterator<Item = Found> {
    drivers.iter().filter_map(|driver| match *driver {
        Unprompted::CanSimple { node } => Some(node_found(node)),
        Unprompted::CustomFault { .. } => None,
    })
}

fn node_found(node: u8) -> Found {
    let host_id = (FAMILY.default_host_id)(&STEADYWIN, node);
    Found { id: node, host_id: FrameId::new(host_id), family: Family::CanSimple, refusal: None }
}

/// Returns the CANSimple driver with this node id, by its heartbeats or its estimates. Only for a
/// node id whose 32 ids no MIT motor has.
///
/// # Errors
///
/// [`Error::Bus`].
pub fn identify_node(link: &mut Link, node: u8) -> Result<Option<Found>, Error> {
    if node > NODE_MAX || link.wire() != Wire::Can {
        return Ok(None);
    }
    Ok(Axis::new(link, node).is_there()?.then(|| node_found(node)))
}

/// Returns the motor with this id, by the same frames as a scan. `None` when no motor answers.
/// Listens first where an answer may be the report of another driver, for [`LISTEN`].
///
/// # Errors
///
/// [`Error::Bus`]; [`Error::Protocol`] when several motors answer, or when a driver of another
/// family reads the request as a command; [`Error::InUse`].
pub fn identify(link: &mut Link, id: u8) -> Result<Option<Found>, Error> {
    let request = |link: &mut Link| {
        only(link, id, 2, |link, window| ask(link, id, &Scan { window, ..Scan::default() }))
    };
    must_be_free(link, id)?;
    let found = request(link);
    let is_strange = match &found {
        Ok(Some(found)) => !matches!(found.family, Family::Native | Family::Mit),
        Ok(None) => false,
        Err(error) => matches!(error, Error::Protocol { .. }),
    };
    if !is_strange || !link.is_ambiguous() {
        return found;
    }
    link.listen(LISTEN)?;
    must_be_free(link, id)?;
    request(link)
}

/// Refuses an id that a driver on this bus reads as its command.
fn must_be_free(link: &Link, id: u8) -> Result<(), Error> {
    let reason = "a CANSimple driver (ODrive, SDC104) or one with the \"custom\" protocol (GDZ, GDS) on this bus reads requests to \
        this id as its commands: give one of the two another id, with the other one unplugged";
    if link.unprompted().iter().any(|driver| driver.owns(id)) {
        Err(Error::Protocol { id, reason })
    } else {
        Ok(())
    }
}

/// Returns `true` when a motor answers to this id. First waits until late answers of other motors
/// have arrived. Sends more requests than [`identify`]: a wrong `false` would give two motors one
/// id.
///
/// # Errors
///
/// As for [`identify`].
pub fn is_taken(link: &mut Link, id: u8) -> Result<bool, Error> {
    must_be_free(link, id)?;
    link.pause(link.timeout() * 4);
    let found = only(link, id, 3, |link, window| ask(link, id, &Scan { window, ..Scan::default() }));
    found.map(|found| found.is_some())
}

/// Like [`identify`], by RobStride's question for the device alone. It has an id of 29 bits.
///
/// # Errors
///
/// As for [`identify`].
pub fn identify_private(link: &mut Link, id: u8) -> Result<Option<Found>, Error> {
    only(link, id, 2, |link, window| private(link, id, window))
}

/// Returns the motor with this id and MyActuator's protocol, by its status. Only for an id for which
/// no CANSimple driver takes the request.
///
/// # Errors
///
/// As for [`identify`].
fn identify_status(link: &mut Link, id: u8) -> Result<Option<Found>, Error> {
    only(link, id, 2, |link, window| motor_status(link, id, window))
}

/// Returns the motor with this id, by the requests of its family.
///
/// # Errors
///
/// As for [`identify`].
pub fn identify_by(link: &mut Link, id: u8, question: Question) -> Result<Option<Found>, Error> {
    let is_can = link.wire() == Wire::Can;
    match question {
        Question::Node => return identify_node(link, id),
        Question::MotorStatus if is_can => return identify_status(link, id),
        Question::PrivateFirst if is_can => {
            if let Some(found) = identify_private(link, id)? {
                return Ok(Some(found));
            }
        }
        Question::Both | Question::MitOnly | Question::MotorStatus | Question::PrivateFirst => {}
    }
    identify(link, id)
}

/// Like [`identify`], by an MIT stop frame alone.
pub(crate) fn identify_in_mit(link: &mut Link, id: u8) -> Result<Option<Found>, Error> {
    let Some(stop) = stop_frame() else { return Ok(None) };
    only(link, id, 2, |link, window| put(link, id, stop, window))
}

/// All motors that answer, and `true` when answers collided.
type Answers = Result<(Vec<Found>, bool), Error>;

/// Returns the only motor that answers. Repeats the request, each time with twice the time limit: a
/// busy computer may delay an answer. Before each repetition it waits for late answers: two answers
/// to one request would count as two motors.
fn only(
    link: &mut Link,
    id: u8,
    tries: u32,
    mut ask: impl FnMut(&mut Link, Duration) -> Answers,
) -> Result<Option<Found>, Error> {
    for before in 0..tries {
        let window = link.timeout() * (1 << before);
        if before > 0 {
            link.pause(window);
        }
        let (found, collided) = ask(link, window)?;
        match *found {
            [] if !collided => {}
            [found] if !collided => return Ok(Some(found)),
            _ => {
                let reason =
                    "several motors answer to this id: connect them one at a time, and give each its own id";
                return Err(Error::Protocol { id, reason });
            }
        }
    }
    Ok(None)
}

/// Sends the requests of all families to `id`: motors of several may have it. A driver obeys the ids of
/// MIT that `is_skipped`.
fn ask_all(link: &mut Link, id: u8, scan: &Scan, is_skipped: bool) -> Answers {
    let (mut found, mut collided) = if is_skipped { (Vec::new(), false) } else { ask_twice(link, id, scan)? };
    if link.wire() == Wire::Can {
        let window = scan.window.max(window_of(link));
        for (others, collision) in [private(link, id, window)?, motor_status(link, id, window)?] {
            found.extend(others);
            collided |= collision;
        }
    }
    Ok((found, collided))
}

/// Sends the requests of MIT and of the native protocol. On CAN, repeats them until an answer arrives
/// again with the same id: another may be a frame of another node.
fn ask_twice(link: &mut Link, id: u8, scan: &Scan) -> Answers {
    let (mut found, mut collided) = ask_standard(link, id, scan)?;
    if link.wire() == Wire::Serial || found.is_empty() {
        return Ok((found, collided));
    }
    for _ in 0..REPETITIONS {
        let (mut again, collision) = ask_standard(link, id, scan)?;
        collided |= collision;
        let is_repeated = |answer: &Found| found.iter().any(|earlier| earlier.host_id == answer.host_id);
        if again.iter().any(is_repeated) {
            again.retain(is_repeated);
            return Ok((again, collided));
        }
        found = if again.is_empty() { found } else { again };
    }
    Ok((Vec::new(), collided))
}

/// Sends each permitted request to `id`, until one is answered.
fn ask(link: &mut Link, id: u8, scan: &Scan) -> Answers {
    let (found, collided) = ask_standard(link, id, scan)?;
    if link.wire() == Wire::Serial || !found.is_empty() {
        return Ok((found, collided));
    }
    let window = scan.window.max(window_of(link));
    let (found, collision) = private(link, id, window)?;
    if !found.is_empty() {
        return Ok((found, collided | collision));
    }
    let collided = collided | collision;
    let (found, collision) = motor_status(link, id, window)?;
    Ok((found, collided | collision))
}

/// Sends each permitted request of MIT and of the native protocol to `id`, until one is answered.
fn ask_standard(link: &mut Link, id: u8, scan: &Scan) -> Answers {
    let own_id = Native::request(&Command::RetrieveConfiguration(ConfigurationItem::CAN_ID));
    let stop = (link.wire() == Wire::Can).then(stop_frame).flatten();
    let fault = scan.in_fault.then(|| Native::request(&Command::GetFault));
    let window = scan.window.max(window_of(link));
    let mut collided = false;
    for question in [stop, Some(own_id), fault].into_iter().flatten() {
        let (found, collision) = put(link, id, question, window)?;
        collided |= collision;
        if !found.is_empty() {
            return Ok((found, collided));
        }
    }
    Ok((Vec::new(), collided))
}

/// Asks for the status of a MyActuator motor, unless a driver of another family has the id of the
/// request.
fn motor_status(link: &mut Link, id: u8, window: Duration) -> Answers {
    let host_id = FrameId::new((myactuator::FAMILY.default_host_id)(&STEADYWIN, id));
    let mut motor = Rmd::new(link, id);
    if !(1..=MOTORS_MAX).contains(&id) || motor.is_owned() {
        return Ok((Vec::new(), false));
    }
    let (answers, collided) = motor.answers(window)?;
    let found = Found { id, host_id, family: Family::MyActuator, refusal: None };
    Ok((vec![found; answers], collided))
}

/// Asks for a motor in RobStride's private protocol. One that is alone also reports its host id.
fn private(link: &mut Link, id: u8, window: Duration) -> Answers {
    if id > ID_MAX {
        return Ok((Vec::new(), false));
    }
    let mut motor = Private::new(link, id);
    let (serials, collided) = motor.devices(window)?;
    let host = if serials.len() == 1 { motor.read(parameter::HOST)? } else { None };
    let host_id = host.map(|[host, ..]| FrameId::from(host));
    let found = |serial| Found { id, host_id, family: Family::RobStride { serial }, refusal: None };
    Ok((serials.into_iter().map(found).collect(), collided))
}

/// Returns the MIT stop frame, whose bytes are the same for every scale.
fn stop_frame() -> Option<[u8; 8]> {
    mit::Command::Stop.encode(&Scales::WITHOUT_CONSTANTS).ok()
}

/// Sends one frame.
fn put(link: &mut Link, id: u8, question: [u8; 8], window: Duration) -> Answers {
    let (mut answers, mut collided) = (Vec::new(), false);
    let _end = link.ask(id, question, window, |event| {
        match event {
            LinkEvent::Frame(frame) => answers.push(frame),
            LinkEvent::Collision => collided = true,
            LinkEvent::NotRead => {}
        }
        None::<()>
    })?;
    Ok((answers.into_iter().map(|answer| inspect(link, id, answer)).collect(), collided))
}

/// A serial adapter may delay an answer for longer than a scan of CAN waits, and a late answer
/// would count for the next id.
fn window_of(link: &Link) -> Duration {
    match link.wire() {
        Wire::Can => Duration::ZERO,
        Wire::Serial => link.timeout(),
    }
}

fn inspect(link: &mut Link, id: u8, answer: Frame) -> Found {
    let host_id = Some(answer.id());
    let (family, refusal) = classify(id, &answer);
    let found = Found { id, host_id, family, refusal };
    if link.wire() == Wire::Can {
        return found;
    }
    let host_id = match Native::new(link, id, None).configuration(ConfigurationItem::HOST_ID) {
        Ok(Value::Integer(raw)) => u16::try_from(raw).ok().and_then(FrameId::new),
        Ok(_) | Err(_) => None,
    };
    Found { host_id, ..found }
}

/// Returns the kind of driver of this answer, and its refusal.
fn classify(id: u8, answer: &Frame) -> (Family, Option<Refusal>) {
    let payload = answer.payload();
    let native = |outcome: Outcome<()>| (Family::Native, outcome.err());
    match *payload {
        // The answer to the stop frame, which is not a native command: result 0x02, or another one
        // in a fault.
        [0xFF, res, ..] if payload.len() == 8 && res != 0 => {
            native(Refusal::check(res).or_else(|refusal| match refusal {
                Refusal::UnknownCommand => Ok(()),
                refusal => Err(refusal),
            }))
        }
        [0x84 | 0xB2, ..] if payload.len() == 8 => {
            let scales = Scales::WITHOUT_CONSTANTS;
            match decode_reply(payload, Pending::Other, &scales) {
                Ok(Reply::Configuration {
                    key: ConfigurationItem::CAN_ID,
                    outcome: Ok(Value::Integer(own)),
                }) if own & 0xFF != i32::from(id) => (Family::Unknown { answer: *answer }, None),
                Ok(Reply::Configuration { key: ConfigurationItem::CAN_ID, outcome }) => {
                    native(outcome.map(drop))
                }
                Ok(Reply::Fault(outcome)) => native(outcome.map(drop)),
                _ => (Family::Unknown { answer: *answer }, None),
            }
        }
        [first, _, _, _, _, _] if first == id => (Family::Mit, None),
        // Damiao has four bits of the id under a status; the others have the whole id.
        [first, _, _, _, _, _, _, ..] if (first ^ id) & 0x0F == 0 => {
            (Family::OtherMit { length: payload.len() as u8 }, None)
        }
        _ => (Family::Unknown { answer: *answer }, None),
    }
}
