//! The rules for devices of the systemd unit in which this process runs:
//! systemd.resource-control(5), `DeviceAllow=`.

use std::fs;
use std::path::Path;

/// Returns what permits the device to this process's unit. The kernel answers `EPERM` to the open
/// of a device that the control group has no rule for, and `EACCES` to a missing permission of the
/// file. Allocates, and reads two files.
pub(super) fn remedy(device: &str) -> String {
    let group = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let resolved = fs::canonicalize(device).unwrap_or_else(|_| device.into());
    remedy_in(&group, &driver(&resolved))
}

/// The name of a tty's driver in `/proc/devices`: the name of the device without its number.
fn driver(device: &Path) -> String {
    let name = device.file_name().unwrap_or_default().to_string_lossy().into_owned();
    name.trim_end_matches(|character: char| character.is_ascii_digit()).to_owned()
}

fn remedy_in(group: &str, driver: &str) -> String {
    let Some(unit) = unit(group) else {
        return "the control group of this process does not permit it, such as that of a container"
            .to_owned();
    };
    let units = both(&unit).unwrap_or(unit);
    format!(
        "the rules of the systemd unit do not permit it; `sudo systemctl edit {units}`, add the lines `[Service]` and \
         `DeviceAllow=char-{driver} rw`, then `sudo systemctl restart {units}`, which suffices if the driver was loaded \
         after their start"
    )
}

/// The unit of a control group: the last part of the path in a line `number:controllers:path` that
/// is a service.
fn unit(group: &str) -> Option<String> {
    let paths = group.lines().filter_map(|line| line.splitn(3, ':').nth(2));
    let mut parts = paths.flat_map(|path| path.rsplit('/'));
    parts.find_map(|part| part.strip_suffix(".service")).map(str::to_owned)
}

/// The units of the switch and of the daemon, of which one is `unit`: both open each serial bus.
fn both(unit: &str) -> Option<String> {
    let instance = unit.strip_prefix("motord-deadman").or_else(|| unit.strip_prefix("motord"))?;
    let is_one = instance.is_empty() || instance.starts_with('@');
    is_one.then(|| format!("motord-deadman{instance} motord{instance}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedy_names_units_and_driver() {
        let cases = [
            ("0::/system.slice/motord.service", "motord-deadman motord"),
            ("0::/system.slice/motord-deadman.service\n", "motord-deadman motord"),
            ("0::/system.slice/system-motord.slice/motord@arm.service", "motord-deadman@arm motord@arm"),
            ("4:devices:/system.slice/motord-flight.service\n0::/x", "motord-flight"),
            ("0::/system.slice/walker.service/payload", "walker"),
        ];
        for (group, units) in cases {
            let remedy = remedy_in(group, &driver(Path::new("/dev/ttyTHS1")));
            assert!(remedy.contains(&format!("`sudo systemctl edit {units}`")), "{remedy}");
            assert!(remedy.contains("`DeviceAllow=char-ttyTHS rw`"), "{remedy}");
        }
    }

    #[test]
    fn process_outside_of_units_edits_none() {
        for group in ["", "0::/", "0::/user.slice/user-1000.slice/session-2.scope", "\u{0}:::", "service"] {
            assert!(!remedy_in(group, "ttyUSB").contains("systemctl"), "{group}");
        }
    }
}
