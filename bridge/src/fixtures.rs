//! A group, rules and a robot for tests.

use crate::config::Commands;
use crate::group::{Group, GroupJoint};
use crate::rules::{Rules, Stamp, Stamped};
use crate::shared::Shared;
use motord_client::{JointDescription, JointLimits, RobotDescription};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
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

/// Values of a robot `dog` whose only joint has a name that a page must escape.
pub(crate) fn shared() -> Arc<Shared> {
    let joint = JointDescription { name: "fl-\"hip\"</script>".to_owned(), ..Default::default() };
    let robot = RobotDescription { instance: "dog".into(), joints: vec![joint], ..Default::default() };
    Arc::new(Shared::new(Arc::new(robot), Vec::new(), Arc::new(AtomicBool::new(false))))
}
