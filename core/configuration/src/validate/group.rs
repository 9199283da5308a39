//! `[[group]]`: every joint in exactly one.

use motord_settings::settings::{GroupSettings, SafeStop};
use motord_shared::limits::{GROUPS_MAX, JOINTS_MAX};

use super::motor::Item;
use crate::entry::{self, At};
use crate::findings::Findings;
use crate::keys::Group;
use crate::problem::Wrong;
use crate::value::Listed;

/// The group of all joints, when the file has no group.
const ALL: &str = "all";

/// Names of an error.
const NAMED_MAX: usize = 8;

/// All groups, in the order of the file; `None` when one cannot be built.
pub(super) fn groups(
    items: &[entry::Item<Group>],
    motors: &[Item],
    safe_stop: SafeStop,
    findings: &mut Findings<'_>,
) -> Option<Vec<GroupSettings>> {
    if items.is_empty() {
        let motors = (0..motors.len()).collect();
        return Some(vec![GroupSettings { name: ALL.to_owned(), motors, safe_stop }]);
    }
    findings.count(items, "group", GROUPS_MAX);
    let names = items.iter().map(|group| &group.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "group" });
    let mut owners = vec![None; motors.len()];
    // Collected twice: the first bad group must not hide the others.
    let groups: Vec<_> = items
        .iter()
        .map(|group| self::group(&group.keys, motors, &mut owners, safe_stop, findings))
        .collect();
    let groups = groups.into_iter().collect::<Option<Vec<_>>>()?;
    let alone = motors.iter().zip(&owners).filter(|(_, owner)| owner.is_none());
    let alone: Vec<_> = alone.filter_map(|(motor, _)| motor.keys.keys.name.value.as_deref()).collect();
    match &alone[..] {
        [] => {}
        [name] => findings.error(items[0].at, Wrong::JointInNoGroup((*name).to_owned())),
        names => {
            let more = if names.len() > NAMED_MAX { ", …" } else { "" };
            let listed: Vec<_> = names.iter().take(NAMED_MAX).map(|name| format!("{name:?}")).collect();
            let names = format!("{}{more}", listed.join(", "));
            findings.error(items[0].at, Wrong::JointsInNoGroup { count: alone.len(), names });
        }
    }
    Some(groups)
}

fn group<'k>(
    keys: &'k Group,
    all: &[Item],
    owners: &mut [Option<&'k str>],
    safe_stop: SafeStop,
    findings: &mut Findings<'_>,
) -> Option<GroupSettings> {
    let name = findings.name(&keys.name);
    let joints = keys.joints.value.as_ref()?;
    if joints.is_empty() {
        findings.error(keys.joints.at, Wrong::EmptyGroup);
        return None;
    }
    if joints.len() > JOINTS_MAX {
        findings.error(keys.joints.at, Wrong::TooMany { max: JOINTS_MAX });
        return None;
    }
    let label = keys.name.value.as_deref().unwrap_or_default();
    let member = |joint: &Listed| {
        let at = At { offset: joint.offset, ..keys.joints.at };
        let names = all.iter().map(|motor| &motor.keys.keys.name);
        let index = findings.find(at, (&joint.text, "motor"), names, Wrong::UnknownJoint)?;
        if let Some(owner) = owners[index].replace(label) {
            let wrong = Wrong::JointInTwoGroups { joint: joint.text.clone(), group: owner.to_owned() };
            findings.error(at, wrong);
            return None;
        }
        Some(index)
    };
    let members: Vec<_> = joints.iter().map(member).collect();
    let mut motors = members.into_iter().collect::<Option<Vec<_>>>()?;
    motors.sort_unstable();
    let same = all.iter().position(|motor| motor.keys.keys.name.value.as_deref() == Some(label));
    let same = same.filter(|same| motors != [*same]);
    if same.is_some() {
        findings.error(keys.name.at, Wrong::GroupNamedAsJoint { name: label.to_owned() });
    }
    Some(GroupSettings { name: name?, motors, safe_stop: keys.safe_stop.value.unwrap_or(safe_stop) })
}
