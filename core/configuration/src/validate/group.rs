//! `[[group]]`: every joint in exactly one.

use motord_protocol::SupplyReport;
use motord_settings::plan::BusPlan;
use motord_settings::settings::{GroupSettings, MotorSettings, Settings, SupplySettings};
use motord_shared::limits::{GROUPS_MAX, JOINTS_MAX};

use super::motor::Item;
use crate::document::Document;
use crate::entry::{self, At};
use crate::findings::Findings;
use crate::keys::{Group, Safety};
use crate::problem::Wrong;
use crate::value::Listed;

/// The group of all joints, when the file has no group.
const ALL: &str = "all";

/// Least rate of indicators with which a supply is watched, Hz.
const LEAST_HZ: f64 = 0.5;
/// Share of a cycle in which its replies and a question fit, beside the work of the cycle.
const QUESTION_SHARE: f64 = 0.95;

/// Names of an error.
const NAMED_MAX: usize = 8;

/// All groups, in the order of the file; `None` when one cannot be built.
pub(super) fn groups(
    items: &[entry::Item<Group>],
    motors: &[Item],
    safety: &Safety,
    findings: &mut Findings<'_>,
) -> Option<Vec<GroupSettings>> {
    if items.is_empty() {
        let motors = (0..motors.len()).collect();
        let supply = supply(None, safety);
        let safe_stop = safety.safe_stop.value;
        return Some(vec![GroupSettings { name: ALL.to_owned(), motors, safe_stop, supply }]);
    }
    findings.count(items, "group", GROUPS_MAX);
    let names = items.iter().map(|group| &group.keys.name);
    findings.unique(names, |name| Wrong::DuplicateName { name, what: "group" });
    let mut owners = vec![None; motors.len()];
    // Collected twice: the first bad group must not hide the others.
    let groups: Vec<_> =
        items.iter().map(|group| self::group(&group.keys, motors, &mut owners, safety, findings)).collect();
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
    safety: &Safety,
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
    let safe_stop = keys.safe_stop.value.unwrap_or(safety.safe_stop.value);
    Some(GroupSettings { name: name?, motors, safe_stop, supply: supply(Some(keys), safety) })
}

/// The voltages of a group with these keys, or of all joints.
fn supply(keys: Option<&Group>, safety: &Safety) -> SupplySettings {
    let warn = keys.and_then(|keys| keys.supply_warn_v.value).unwrap_or(safety.supply_warn_v.value);
    let stop = keys.and_then(|keys| keys.supply_stop_v.value).unwrap_or(safety.supply_stop_v.value);
    SupplySettings { warn: warn as f32, stop: stop as f32 }
}

/// Refuses voltages that can have no effect, and a stop without a warning before it.
pub(super) fn check_supplies(document: &Document, settings: &Settings, findings: &mut Findings<'_>) {
    let plans = BusPlan::of(settings);
    for (index, group) in settings.groups.iter().enumerate() {
        let keys = document.groups.get(index).map(|item| &item.keys);
        if let Some(wrong) = wrong_supply(group, settings, &plans) {
            findings.error(key_of_supply(keys, &document.safety), wrong);
        }
    }
}

fn wrong_supply(group: &GroupSettings, settings: &Settings, plans: &[BusPlan]) -> Option<Wrong> {
    let SupplySettings { warn, stop } = group.supply;
    let motors = || group.motors.iter().map(|&motor| &settings.motors[motor]);
    let reports = |motor: &MotorSettings| motor.capabilities.supply != SupplyReport::None;
    let is_asked =
        |motor: &MotorSettings| reports(motor) && motor.capabilities.supply != SupplyReport::Unasked;
    let has_time = |motor: &MotorSettings| {
        let plan = &plans[motor.bus];
        !is_asked(motor)
            || settings.buses[motor.bus].is_line()
            || plan.last_reply + plan.question <= settings.cycle.period.mul_f64(QUESTION_SHARE)
    };
    if group.supply == SupplySettings::default() {
        None
    } else if !motors().any(reports) {
        Some(Wrong::SupplyNotReported { group: group.name.clone() })
    } else if settings.cycle.indicator_hz < LEAST_HZ && motors().any(is_asked) {
        Some(Wrong::SupplyNotAsked { least_hz: LEAST_HZ })
    } else if let Some(motor) = motors().find(|motor| !has_time(motor)) {
        let plan = &plans[motor.bus];
        let bus = settings.buses[motor.bus].name.clone();
        let rate_hz_max = (QUESTION_SHARE / (plan.last_reply + plan.question).as_secs_f64()).floor();
        Some(Wrong::NoTimeForSupply { bus, rate_hz_max })
    } else {
        (warn > 0.0 && stop >= warn).then_some(Wrong::SupplyStopBeforeWarning { warn, stop })
    }
}

/// The key that gives a group its voltages.
fn key_of_supply(keys: Option<&Group>, safety: &Safety) -> At {
    let own = keys.and_then(|keys| {
        let mut own = [&keys.supply_stop_v, &keys.supply_warn_v].into_iter();
        own.find(|key| key.value.is_some()).map(|key| key.at)
    });
    let of_all =
        if safety.supply_stop_v.value > 0.0 { safety.supply_stop_v.at } else { safety.supply_warn_v.at };
    own.unwrap_or(of_all)
}
