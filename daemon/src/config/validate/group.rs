//! `[[group]]`: every joint in exactly one.

use motord_shared::limits::GROUPS_MAX;
use toml::Spanned;

use crate::config::problem::Wrong;
use crate::config::{Findings, written};
use motord_core::settings::{GroupSettings, MotorSettings, SafeStop};

type Written = Spanned<written::Group>;

/// The group of all joints, when the file names none.
const ALL: &str = "all";

/// All groups, in the order of the file; `None` when one is not understood.
pub(super) fn groups(
    written: &[Written],
    motors: &[MotorSettings],
    safe_stop: SafeStop,
    findings: &mut Findings<'_>,
) -> Option<Vec<GroupSettings>> {
    if written.is_empty() {
        let motors = (0..motors.len()).collect();
        return Some(vec![GroupSettings { name: ALL.to_owned(), motors, safe_stop }]);
    }
    if !findings.counted(written, "group", GROUPS_MAX) {
        return None;
    }
    let names = written.iter().map(|group| group.get_ref().name.as_ref());
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "group" });
    // The group that each motor is in.
    let mut owners: Vec<Option<&str>> = vec![None; motors.len()];
    // Collected twice: the first bad group must not hide the others.
    let groups: Vec<_> =
        written.iter().map(|group| self::group(group, motors, &mut owners, safe_stop, findings)).collect();
    let groups = groups.into_iter().collect::<Option<Vec<_>>>()?;
    for (motor, _) in motors.iter().zip(&owners).filter(|(_, owner)| owner.is_none()) {
        findings.error(written[0].span(), Wrong::JointInNoGroup(motor.name.clone()));
    }
    Some(groups)
}

fn group<'w>(
    written: &'w Written,
    motors: &[MotorSettings],
    owners: &mut [Option<&'w str>],
    safe_stop: SafeStop,
    findings: &mut Findings<'_>,
) -> Option<GroupSettings> {
    let (table, keys) = (written.span(), written.get_ref());
    let name = findings.required(&keys.name, &table, "name", "every [[group]] needs a name");
    let name = name.and_then(|name| findings.name(name));
    let joints = findings.required(&keys.joints, &table, "joints", "list the names of its motors")?;
    if joints.get_ref().is_empty() {
        findings.error(joints.span(), Wrong::EmptyGroup);
        return None;
    }
    let label = keys.name.as_ref().map_or("", |name| name.get_ref());
    let members: Vec<_> =
        joints.get_ref().iter().map(|joint| member(joint, label, motors, owners, findings)).collect();
    let mut motors = members.into_iter().collect::<Option<Vec<_>>>()?;
    motors.sort_unstable();
    Some(GroupSettings { name: name?, motors, safe_stop: keys.safe_stop.unwrap_or(safe_stop) })
}

/// The index of the motor that `joint` names, which `group` owns from now on.
fn member<'w>(
    joint: &Spanned<String>,
    group: &'w str,
    motors: &[MotorSettings],
    owners: &mut [Option<&'w str>],
    findings: &mut Findings<'_>,
) -> Option<usize> {
    let name = joint.get_ref();
    let Some(index) = motors.iter().position(|motor| motor.name == *name) else {
        findings.error(joint.span(), Wrong::UnknownJoint(name.clone()));
        return None;
    };
    if let Some(owner) = owners[index].replace(group) {
        let wrong = Wrong::JointInTwoGroups { joint: name.clone(), group: owner.to_owned() };
        findings.error(joint.span(), wrong);
        return None;
    }
    Some(index)
}
