//! Reads a file. It may come from another program, be damaged, or end where its recorder was
//! killed.

use crate::messages::{Messages, ReadError};
use crate::{decode, motord};
use motord_shared::description::RobotDescription;
use motord_shared::limits::{BUSES_MAX, GROUPS_MAX, IMUS_MAX, INDICATOR_JOINTS_MAX, JOINTS_MAX};
use motord_shared::message::IMU_FRESH;
use motord_shared::{CycleRecord, ImuState, JointIndicators};
use prost::Message;
use std::collections::HashMap;
use std::io::Read;

/// The part of the robot that a topic describes.
#[derive(Debug, Clone, Copy)]
enum Topic {
    Joint(usize),
    Group(usize),
    Bus(usize),
    Indicators(usize),
    Imu(usize),
    Cycle,
}

/// An open file, read cycle by cycle.
pub struct Reader<R: Read> {
    messages: Messages<R>,
    robot: RobotDescription,
    topics: HashMap<String, Topic>,
    record: Box<CycleRecord>,
    damage: Option<String>,
}

impl<R: Read> Reader<R> {
    /// Opens a recording.
    ///
    /// # Errors
    /// The file is no recording.
    pub fn new(file: R) -> Result<Self, ReadError> {
        let mut messages = Messages::new(file);
        let (topic, data) = messages.next()?.ok_or(ReadError::NoRobot)?;
        let described = (topic == "/robot").then(|| serde_json::from_slice(data).ok());
        let robot: RobotDescription = described.flatten().ok_or(ReadError::NoRobot)?;
        let fits = robot.joints.len() <= JOINTS_MAX
            && robot.groups.len() <= GROUPS_MAX
            && robot.buses.len() <= BUSES_MAX
            && robot.imus.len() <= IMUS_MAX
            && robot.groups.iter().flat_map(|group| &group.joints).all(|joint| *joint < robot.joints.len());
        if !fits {
            return Err(ReadError::NoRobot);
        }
        let mut record = Box::<CycleRecord>::default();
        record.state.joint_count = robot.joints.len() as u32;
        record.state.group_count = robot.groups.len() as u32;
        record.state.bus_count = robot.buses.len() as u32;
        record.state.imu_count = robot.imus.len() as u32;
        record.state.imus.fill(ImuState::UNKNOWN);
        Ok(Self { messages, topics: topics(&robot), robot, record, damage: None })
    }

    /// Returns the robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDescription {
        &self.robot
    }

    /// Returns the next cycle; `None` at the end of the file, or where it is damaged. Skips
    /// incomplete cycles.
    pub fn next_cycle(&mut self) -> Option<&CycleRecord> {
        self.record.known = 0;
        self.record.state.imus.iter_mut().for_each(|imu| imu.flags &= !IMU_FRESH);
        while self.damage.is_none() {
            match self.advance() {
                Ok(Some(true)) => return Some(&self.record),
                Ok(Some(false)) => {}
                Ok(None) => break,
                Err(error) => self.damage = Some(error),
            }
        }
        None
    }

    /// Stores the next message. Returns `true` if its cycle is complete; `None` at the end of the
    /// file.
    fn advance(&mut self) -> Result<Option<bool>, String> {
        let Self { messages, topics, robot, record, .. } = self;
        let Some((topic, data)) = messages.next().map_err(|error| error.to_string())? else {
            return Ok(None);
        };
        let Some(topic) = topics.get(topic) else { return Ok(Some(false)) };
        take(record, robot, *topic, data).map(Some).map_err(|error| error.to_string())
    }

    /// Returns the reason why the file ended early. `None` for a complete file, or before its end
    /// was read. A killed recorder leaves such a file.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }
}

/// Stores a message in `record`. Returns `true` if its cycle is complete.
fn take(
    record: &mut CycleRecord,
    robot: &RobotDescription,
    topic: Topic,
    data: &[u8],
) -> Result<bool, prost::DecodeError> {
    let CycleRecord { state, .. } = &mut *record;
    match topic {
        Topic::Joint(index) => {
            let (joint, setpoint) = decode::joint(&motord::Joint::decode(data)?);
            state.joints[index] = joint;
            if let Some(setpoint) = setpoint {
                record.set_setpoint(index, setpoint);
            }
        }
        Topic::Group(index) => {
            state.groups[index] = decode::group(&motord::Group::decode(data)?, robot);
        }
        Topic::Bus(index) => state.buses[index] = decode::bus(&motord::Bus::decode(data)?),
        Topic::Indicators(joint) => {
            let values = decode::indicators(&motord::Indicators::decode(data)?);
            let count = state.indicator_count as usize;
            let known = state.indicators().iter().position(|known| known.joint as usize == joint);
            let slot = known.unwrap_or(count);
            if slot < INDICATOR_JOINTS_MAX {
                state.indicators[slot] = JointIndicators { joint: joint as u32, values };
                state.indicator_count = count.max(slot + 1) as u32;
            }
        }
        Topic::Imu(index) => state.imus[index] = decode::imu(&motord::Imu::decode(data)?),
        Topic::Cycle => {
            let cycle = motord::Cycle::decode(data)?;
            record.sequence = cycle.sequence;
            decode::cycle(&cycle, &mut record.state);
            return Ok(true);
        }
    }
    Ok(false)
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
    let imus = robot.imus.iter().enumerate();
    let imus = imus.map(|(index, imu)| (format!("/imus/{}", imu.name), Topic::Imu(index)));
    joints.chain(groups).chain(buses).chain(imus).chain([("/cycle".to_owned(), Topic::Cycle)]).collect()
}
