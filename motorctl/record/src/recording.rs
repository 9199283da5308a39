//! A recording on the disk, and the events of one that pictures and the monitor mark.

use crate::failure::RecorderFailure;
use motord_client::{CycleRecord, RobotDescription};
use motord_mcap::{Event, Level, Reader};
use motord_terminal::{FileError, InputFile};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// An open file.
pub struct Recording {
    path: PathBuf,
    reader: Reader<BufReader<File>>,
}

impl Recording {
    /// Opens the file at `path`.
    ///
    /// # Errors
    ///
    /// The file cannot be opened, or is no recording.
    pub fn open(path: &Path) -> Result<Self, RecorderFailure> {
        let file = InputFile::open(path).map_err(FileError::unreadable(path))?;
        let reader = Reader::new(BufReader::new(file.into_file()))
            .map_err(|error| RecorderFailure::Malformed { path: path.to_owned(), error })?;
        Ok(Self { path: path.to_owned(), reader })
    }

    /// Returns the path of the file.
    #[must_use]
    pub fn name(&self) -> String {
        self.path.display().to_string()
    }

    /// Returns the robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDescription {
        self.reader.robot()
    }

    /// Returns the next cycle; `None` at the end of the file, or where it is damaged.
    pub fn next_cycle(&mut self) -> Option<&CycleRecord> {
        self.reader.next_cycle()
    }

    /// Returns the reason why the file ended early. `None` for a complete file, or before its end
    /// was read.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.reader.damage()
    }
}

/// Returns whether an event is a stop or a fault of a joint or a group.
#[must_use]
pub fn is_mark(event: &Event) -> bool {
    // The emergency stop of the robot is an event of each group also.
    event.level == Level::Error && !event.subject.is_empty()
}

/// Returns whether an event is a stop or a fault of one of `joints` or of its group.
#[must_use]
pub fn concerns(event: &Event, robot: &RobotDescription, joints: &[usize]) -> bool {
    let name = |joint: &usize| robot.joints.get(*joint).map(|joint| &joint.name);
    let is_joint = || joints.iter().any(|joint| name(joint) == Some(&event.subject));
    let holds = |members: &[usize]| joints.iter().any(|joint| members.contains(joint));
    let is_group = || robot.groups.iter().any(|group| group.name == event.subject && holds(&group.joints));
    is_mark(event) && (is_joint() || is_group())
}

#[cfg(test)]
mod tests {
    use super::*;
    use motord_client::{GroupDescription, JointDescription};

    #[test]
    fn stops_and_faults_of_drawn_joints_are_marked() {
        let joint = |name: &str| JointDescription { name: name.to_owned(), ..JointDescription::default() };
        let group = |name: &str, joints| GroupDescription { name: name.to_owned(), joints };
        let robot = RobotDescription {
            joints: vec![joint("knee"), joint("elbow")],
            groups: vec![group("legs", vec![0]), group("arm", vec![1])],
            ..RobotDescription::default()
        };
        let event = |level, subject: &str| Event { level, subject: subject.to_owned(), text: String::new() };
        for (subject, is_drawn) in
            [("", false), ("knee", true), ("legs", true), ("elbow", false), ("arm", false)]
        {
            assert_eq!(concerns(&event(Level::Error, subject), &robot, &[0]), is_drawn, "{subject}");
        }
        assert!(!concerns(&event(Level::Info, "knee"), &robot, &[0]));
    }
}
