//! Writes a file.

use crate::SCHEMA;
use crate::clock::{ClockStep, Origin};
use crate::encode;
use crate::events::{Event, Events, Level};
use crate::topic::Topic;
use mcap::records::MessageHeader;
use mcap::write::{Metadata, NoSeek};
use mcap::{McapError, McapResult, WriteOptions};
use motord_shared::CycleRecord;
use motord_shared::description::RobotDescription;
use motord_shared::limits::INDICATORS_MAX;
use motord_shared::message::IMU_FRESH;
use prost::Message;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// Uncompressed size of a part of the file that is compressed as a unit, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// The cycles of a recording, by outcome.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Cycles in the file.
    pub recorded: u64,
    /// Ticks that the daemon missed meanwhile: they have no cycle.
    pub missed_ticks: u64,
    /// Cycles that the daemon's ipc thread was too slow to publish.
    pub unpublished: u64,
    /// Cycles that the recorder was too slow to take out of shared memory.
    pub lost: u64,
    /// Cycles that the disk was too slow for.
    pub dropped: u64,
}

/// Flags, sequence number and counters of an IMU.
type Written = (u32, u64, u32, u32);

/// The channels of a file, in the order of the robot's description.
#[derive(Debug, Default)]
struct Channels {
    joints: Vec<u16>,
    groups: Vec<u16>,
    buses: Vec<u16>,
    indicators: Vec<u16>,
    imus: Vec<u16>,
    cycle: u16,
    events: u16,
}

/// A file that is being written. It is readable up to the last [`flush`](Self::flush), and has its
/// index after [`finish`](Self::finish).
pub struct Writer<W: Write> {
    out: mcap::Writer<NoSeek<W>>,
    robot: RobotDescription,
    origin: Origin,
    channels: Channels,
    events: Events,
    /// The last written values, by joint.
    indicators: Vec<[f32; INDICATORS_MAX]>,
    /// The last written flags and counters, by IMU.
    imus: Vec<Option<Written>>,
    buffer: Vec<u8>,
}

impl<W: Write> Writer<W> {
    /// Starts a file of `robot` at `from_ns`, ns of `CLOCK_MONOTONIC`. `out` receives one large
    /// write for each part of the file and small ones: use a buffer.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn new(out: W, robot: &RobotDescription, origin: Origin, from_ns: u64) -> io::Result<Self> {
        let options = WriteOptions::new()
            .library(concat!("motord ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(CHUNK_BYTES))
            .compression_threads(0)
            .disable_seeking(true);
        let mut out = options.create(NoSeek::new(out)).map_err(of_mcap)?;
        let channels = Channels::add(&mut out, robot).map_err(of_mcap)?;
        let mut writer = Self {
            out,
            robot: robot.clone(),
            origin,
            channels,
            events: Events::default(),
            indicators: vec![[f32::NAN; INDICATORS_MAX]; robot.joints.len()],
            imus: vec![None; robot.imus.len()],
            buffer: Vec::new(),
        };
        writer.write_robot(from_ns).map_err(of_mcap)?;
        Ok(writer)
    }

    fn write_robot(&mut self, from_ns: u64) -> McapResult<()> {
        let channel = self.out.add_channel(0, "/robot", "json", &BTreeMap::new())?;
        let text = serde_json::to_vec(&self.robot).map_err(|error| McapError::Io(error.into()))?;
        let time = self.origin.unix(from_ns);
        let header = MessageHeader { channel_id: channel, sequence: 0, log_time: time, publish_time: time };
        self.out.write_to_known_channel(&header, &text)
    }

    /// Writes a cycle. The file contains it after the next [`flush`](Self::flush), or earlier.
    ///
    /// # Errors
    /// The file cannot be written: it ends before this part.
    pub fn write(&mut self, record: &CycleRecord) -> io::Result<()> {
        self.write_record(record).map_err(of_mcap)
    }

    fn write_record(&mut self, record: &CycleRecord) -> McapResult<()> {
        let state = &record.state;
        let header = MessageHeader {
            channel_id: 0,
            sequence: state.cycle as u32,
            log_time: self.origin.unix(state.tick_ns),
            publish_time: self.origin.unix(state.publish_ns),
        };
        let Self { out, robot, channels, buffer, .. } = self;
        let mut put = |channel_id: u16, message: &dyn Encode| {
            buffer.clear();
            message.encode_into(buffer);
            out.write_to_known_channel(&MessageHeader { channel_id, ..header }, buffer)
        };
        for (index, (joint, channel)) in state.joints().iter().zip(&channels.joints).enumerate() {
            put(*channel, &encode::joint(state.cycle, joint, record.setpoint(index)))?;
        }
        for (group, channel) in state.groups().iter().zip(&channels.groups) {
            put(*channel, &encode::group(state.cycle, group, robot))?;
        }
        for (bus, channel) in state.buses().iter().zip(&channels.buses) {
            put(*channel, &encode::bus(state.cycle, bus))?;
        }
        for indicators in state.indicators() {
            let joint = indicators.joint as usize;
            let (Some(known), Some(channel)) =
                (self.indicators.get_mut(joint), channels.indicators.get(joint))
            else {
                continue;
            };
            if known.map(f32::to_bits) != indicators.values.map(f32::to_bits) {
                *known = indicators.values;
                put(*channel, &encode::indicators(indicators))?;
            }
        }
        for ((imu, channel), written) in state.imus().iter().zip(&channels.imus).zip(&mut self.imus) {
            // The next message ends the freshness of this one.
            let now = (imu.flags & !IMU_FRESH, imu.sequence, imu.missing, imu.rejected);
            if written.replace(now) != Some(now) {
                put(*channel, &encode::imu(state.cycle, imu))?;
            }
        }
        for event in self.events.of(state, robot) {
            put(channels.events, &encode::log(&event, header.log_time))?;
        }
        put(channels.cycle, &encode::cycle(state, record.sequence))
    }

    /// Writes that the computer's clock was set, as an event. The times of the file keep their
    /// origin.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_step(&mut self, step: ClockStep) -> io::Result<()> {
        let time = self.origin.unix(step.at_ns);
        let event = Event { level: Level::Warning, subject: String::new(), text: step.text() };
        self.buffer.clear();
        encode::log(&event, time).encode_into(&mut self.buffer);
        let channel_id = self.channels.events;
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        self.out.write_to_known_channel(&header, &self.buffer).map_err(of_mcap)
    }

    /// Ends the current part of the file, so that it can be read without further parts.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush().map_err(of_mcap)
    }

    /// Ends the file, with these counts in its metadata.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self, counts: &Counts) -> io::Result<W> {
        let RobotDescription { instance, version, rate_hz, boot_id, .. } = &self.robot;
        let metadata = [
            ("instance", instance.clone()),
            ("version", version.clone()),
            ("rate_hz", rate_hz.to_string()),
            ("boot_id", boot_id.to_string()),
            ("monotonic_zero_unix_ns", self.origin.unix_ns.to_string()),
            ("recorded", counts.recorded.to_string()),
            ("missed_ticks", counts.missed_ticks.to_string()),
            ("unpublished", counts.unpublished.to_string()),
            ("lost", counts.lost.to_string()),
            ("dropped", counts.dropped.to_string()),
        ];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        let metadata = Metadata { name: "motord.recording".to_owned(), metadata };
        let written = self.out.write_metadata(&metadata);
        written.and_then(|()| self.out.finish()).map_err(of_mcap)?;
        Ok(self.out.into_inner().into_inner())
    }
}

impl Channels {
    fn add<W: Write>(out: &mut mcap::Writer<NoSeek<W>>, robot: &RobotDescription) -> McapResult<Self> {
        let (mut channels, none) = (Self::default(), BTreeMap::new());
        for topic in Topic::all(robot) {
            // The same schema again has the same number.
            let schema = out.add_schema(topic.schema(), "protobuf", SCHEMA)?;
            let name = topic.name(robot).unwrap_or_default();
            let channel = out.add_channel(schema, &name, "protobuf", &none)?;
            match topic {
                Topic::Joint(_) => channels.joints.push(channel),
                Topic::Group(_) => channels.groups.push(channel),
                Topic::Bus(_) => channels.buses.push(channel),
                Topic::Indicators(_) => channels.indicators.push(channel),
                Topic::Imu(_) => channels.imus.push(channel),
                Topic::Cycle => channels.cycle = channel,
                Topic::Events => channels.events = channel,
            }
        }
        Ok(channels)
    }
}

/// Any of the messages.
trait Encode {
    fn encode_into(&self, buffer: &mut Vec<u8>);
}

impl<T: Message> Encode for T {
    fn encode_into(&self, buffer: &mut Vec<u8>) {
        self.encode_raw(buffer);
    }
}

/// Converts an error of writing, the only possible one.
fn of_mcap(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}
