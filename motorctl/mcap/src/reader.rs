//! Reads a file. It may be another program's, damaged, or cut off where its recorder was killed.

use crate::{decode, motord};
use mcap::McapError;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use motord_shared::description::RobotDescription;
use motord_shared::limits::{BUSES_MAX, GROUPS_MAX, INDICATOR_JOINTS_MAX, JOINTS_MAX};
use motord_shared::{CycleRecord, JointIndicators};
use prost::Message;
use std::collections::HashMap;
use std::io::Read;

/// The longest message of a file, bytes. Ours have a kilobyte, the description of the robot some more.
const MESSAGE_BYTES_MAX: usize = 16 << 20;

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// It is no MCAP file, or is damaged at its beginning.
    #[error("it is no MCAP file that can be read: {0}")]
    Mcap(#[from] McapError),
    /// It is an MCAP file of something else.
    #[error("it does not begin with the description of a robot: `motorctl record` has not written it")]
    NoRobot,
}

/// The part of the robot that a topic is of.
#[derive(Debug, Clone, Copy)]
enum Topic {
    Joint(usize),
    Group(usize),
    Bus(usize),
    Indicators(usize),
    Cycle,
}

/// A file that is being read, cycle by cycle.
pub struct Reader<R: Read> {
    messages: MessageReader<R>,
    robot: RobotDescription,
    topics: HashMap<String, Topic>,
    record: Box<CycleRecord>,
    damage: Option<String>,
}

impl<R: Read> Reader<R> {
    /// Begins to read.
    ///
    /// # Errors
    /// When it is no recording.
    pub fn new(file: R) -> Result<Self, ReadError> {
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MESSAGE_BYTES_MAX);
        let mut messages = MessageReader::new_with_options(file, options);
        let first = messages.next().ok_or(ReadError::NoRobot)??;
        let described = (first.channel.topic == "/robot").then(|| serde_json::from_slice(&first.data).ok());
        let robot: RobotDescription = described.flatten().ok_or(ReadError::NoRobot)?;
        let fits = robot.joints.len() <= JOINTS_MAX
            && robot.groups.len() <= GROUPS_MAX
            && robot.buses.len() <= BUSES_MAX
            && robot.groups.iter().flat_map(|group| &group.joints).all(|joint| *joint < robot.joints.len());
        if !fits {
            return Err(ReadError::NoRobot);
        }
        let mut record = Box::<CycleRecord>::default();
        record.state.joint_count = robot.joints.len() as u32;
        record.state.group_count = robot.groups.len() as u32;
        record.state.bus_count = robot.buses.len() as u32;
        Ok(Self { messages, topics: topics(&robot), robot, record, damage: None })
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDescription {
        &self.robot
    }

    /// The next cycle; `None` at the end of the file, or where it is damaged. A cycle that is not whole is left out.
    pub fn next_cycle(&mut self) -> Option<&CycleRecord> {
        self.record.known = 0;
        while self.damage.is_none() {
            let message = match self.messages.next()? {
                Ok(message) => message,
                Err(error) => {
                    self.damage = Some(error.to_string());
                    break;
                }
            };
            let Some(topic) = self.topics.get(&message.channel.topic) else { continue };
            match self.take(*topic, &message.data) {
                Ok(true) => return Some(&self.record),
                Ok(false) => {}
                Err(error) => self.damage = Some(error.to_string()),
            }
        }
        None
    }

    /// Why the file ended before its end; `None` when it did not, or was not read to its end yet. A recorder that was killed
    /// leaves such a file.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    /// Takes in a message. Returns whether its cycle is whole.
    fn take(&mut self, topic: Topic, data: &[u8]) -> Result<bool, prost::DecodeError> {
        let CycleRecord { state, sequence, .. } = &mut *self.record;
        match topic {
            Topic::Joint(index) => {
                let (joint, setpoint) = decode::joint(&motord::Joint::decode(data)?);
                state.joints[index] = joint;
                if let Some(setpoint) = setpoint {
                    self.record.set_setpoint(index, setpoint);
                }
            }
            Topic::Group(index) => {
                state.groups[index] = decode::group(&motord::Group::decode(data)?, &self.robot);
            }
            Topic::Bus(index) => state.buses[index] = decode::bus(&motord::Bus::decode(data)?),
            Topic::Indicators(joint) => {
                let values = decode::indicators(&motord::Indicators::decode(data)?);
                let count = state.indicator_count as usize;
                let known = state.indicators().iter().position(|known| known.joint as usize == joint);
                let place = known.unwrap_or(count);
                if place < INDICATOR_JOINTS_MAX {
                    state.indicators[place] = JointIndicators { joint: joint as u32, values };
                    state.indicator_count = count.max(place + 1) as u32;
                }
            }
            Topic::Cycle => {
                let cycle = motord::Cycle::decode(data)?;
                *sequence = cycle.sequence;
                decode::cycle(&cycle, state);
                return Ok(true);
            }
        }
        Ok(false)
    }
}

fn topics(robot: &RobotDescription) -> HashMap<String, Topic> {
    let joints = robot.joints.iter().enumerate();
    let joints = joints.flat_map(|(index, joint)| {
        let name = &joint.name;
        [
            (format!("/joints/{name}"), Topic::Joint(index)),
            (format!("/indicators/{name}"), Topic::Indicators(index)),
        ]
    });
    let groups = robot.groups.iter().enumerate();
    let groups = groups.map(|(index, group)| (format!("/groups/{}", group.name), Topic::Group(index)));
    let buses = robot.buses.iter().enumerate();
    let buses = buses.map(|(index, bus)| (format!("/buses/{bus}"), Topic::Bus(index)));
    joints.chain(groups).chain(buses).chain([("/cycle".to_owned(), Topic::Cycle)]).collect()
}
