//! A group and rules for the tests of commands.

use crate::config::Commands;
use crate::group::{Group, GroupJoint};
use crate::rules::{Rules, Stamp, Stamped};
use motord_client::JointLimits;
use std::time::Duration;

pub(crate) const NOW_NS: u64 = 1_000_000_000_000;
pub(crate) const NOW: Stamped = Stamped::Header(Stamp { sec: 1000, nanosec: 0 });

/// A group whose joints may move from -1 to 1 rad at 10 rad/s.
pub(crate) fn group(names: &[&str]) -> Group {
    let limits = JointLimits { position: [-1.0, 1.0], velocity: 10.0, ..JointLimits::default() };
    let joint = |(index, name): (usize, &&str)| GroupJoint { name: (*name).to_owned(), index, limits };
    Group { name: "legs".to_owned(), index: 0, joints: names.iter().enumerate().map(joint).collect() }
}

pub(crate) fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

pub(crate) fn rules<'a>(group: &'a Group, commands: &'a Commands) -> Rules<'a> {
    Rules { group, gains: None, commands, horizon_max: Duration::from_millis(50), now_ns: NOW_NS }
}
