//! The rules of systemd for the devices of a unit: systemd.resource-control(5), `DevicePolicy=` and
//! `DeviceAllow=`.

use crate::finding::Finding;
use crate::tree::Tree;
use std::collections::BTreeMap;

/// Directories of units, the one that overrides the others first.
const DIRECTORIES: [&str; 6] = [
    "etc/systemd/system.control",
    "run/systemd/system.control",
    "etc/systemd/system",
    "run/systemd/system",
    "usr/local/lib/systemd/system",
    "usr/lib/systemd/system",
];

/// Checks that the units of the configuration may open a serial port. `None` where no such unit is
/// installed, or the device is no serial port of the kernel.
pub(super) fn rules(tree: &Tree, units: &[String], device: &str) -> Option<Finding> {
    const CHECK: &str = "device rules";
    let port = Port::of(tree, device)?;
    let installed: Vec<_> = units.iter().filter_map(|unit| Some((unit, Rules::of(tree, unit)?))).collect();
    let names = |units: Vec<&str>| units.join(" ");
    if installed.is_empty() {
        return None;
    }
    let forbid = installed.iter().filter(|(_, rules)| !rules.allow(&port));
    let forbid = names(forbid.map(|(unit, _)| unit.as_str()).collect());
    let finding = match forbid.is_empty() {
        true => {
            let all = names(installed.iter().map(|(unit, _)| unit.as_str()).collect());
            Finding::good(CHECK, format!("{all}: char-{} is permitted", port.driver))
        }
        false => {
            let driver = &port.driver;
            let why = format!(
                "add the lines `[Service]` and `DeviceAllow=char-{driver} rw`, and restart the units"
            );
            Finding::bad(CHECK, format!("{forbid}: char-{driver} is not permitted"), why)
                .mended_by(format!("sudo systemctl edit {forbid}"))
        }
    };
    Some(finding.of(device))
}

/// A serial port of the kernel.
struct Port {
    /// Its path, below `/`.
    path: String,
    major: u32,
    /// The name of its driver, as in `/proc/devices`.
    driver: String,
    /// All names of that number there.
    names: Vec<String>,
}

impl Port {
    fn of(tree: &Tree, device: &str) -> Option<Self> {
        let path = tree.resolved(device)?;
        let name = path.rsplit('/').next()?;
        let number = tree.text(&format!("sys/class/tty/{name}/dev"))?;
        let major = number.split(':').next()?.parse().ok()?;
        let driver = name.trim_end_matches(|character: char| character.is_ascii_digit()).to_owned();
        let mut names = drivers(&tree.text("proc/devices").unwrap_or_default(), major);
        names.push(driver.clone());
        Some(Self { major, driver, names, path: format!("/{path}") })
    }
}

/// The names of a number among the character devices of `/proc/devices`.
fn drivers(devices: &str, major: u32) -> Vec<String> {
    let characters = devices.split("Block devices:").next().unwrap_or_default();
    let entries = characters.lines().filter_map(|line| line.trim().split_once(' '));
    let same = entries.filter(|(number, _)| number.parse() == Ok(major));
    same.map(|(_, name)| name.trim().to_owned()).collect()
}

/// The rules of a unit.
#[derive(Debug, Default)]
struct Rules {
    policy: String,
    allowed: Vec<String>,
}

impl Rules {
    /// Reads the unit and its drop-ins; `None` if it is not installed.
    fn of(tree: &Tree, unit: &str) -> Option<Self> {
        let template = unit.split_once('@').map(|(name, _)| format!("{name}@.service"));
        let names = || std::iter::once(unit).chain(template.as_deref());
        let mut files = names().flat_map(|name| DIRECTORIES.map(|folder| format!("{folder}/{name}")));
        let mut rules = Self::default();
        rules.add(&files.find_map(|file| tree.text(&file))?);
        let folders = names()
            .chain(["service"])
            .flat_map(|name| DIRECTORIES.map(|folder| format!("{folder}/{name}.d")));
        let mut drop_ins = BTreeMap::new();
        for folder in folders {
            for name in tree.names(&folder).into_iter().filter(|name| name.ends_with(".conf")) {
                let text = tree.text(&format!("{folder}/{name}")).unwrap_or_default();
                drop_ins.entry(name).or_insert(text);
            }
        }
        drop_ins.values().for_each(|text| rules.add(text));
        Some(rules)
    }

    /// Adds the rules of a file, which follow those before. An empty value removes those before.
    fn add(&mut self, text: &str) {
        let mut is_of_service = false;
        for line in text.lines().map(str::trim) {
            if line.starts_with('[') {
                is_of_service = line == "[Service]";
            }
            match line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
                Some(("DevicePolicy", value)) if is_of_service => self.policy = value.to_owned(),
                Some(("DeviceAllow", "")) if is_of_service => self.allowed.clear(),
                Some(("DeviceAllow", value)) if is_of_service => self.allowed.push(value.to_owned()),
                _ => {}
            }
        }
    }

    /// Returns `true` if the unit may read and write the port when its driver is loaded at the
    /// start of the unit.
    fn allow(&self, port: &Port) -> bool {
        let is_open = !["closed", "strict"].contains(&self.policy.as_str()) && self.allowed.is_empty();
        is_open || self.allowed.iter().any(|rule| permits(rule, port))
    }
}

/// Returns `true` if a value of `DeviceAllow=` lets a unit read and write the port.
fn permits(rule: &str, port: &Port) -> bool {
    let (device, access) = rule.split_once(' ').unwrap_or((rule, "rwm"));
    let is_this = match device.strip_prefix("char-") {
        Some(group) => group.parse() == Ok(port.major) || port.names.iter().any(|name| matches(group, name)),
        None => device == port.path,
    };
    is_this && access.contains('r') && access.contains('w')
}

/// Compares a name with a pattern of fnmatch(3): `*`, `?`, and sets such as `[A-Z]`.
fn matches(pattern: &str, name: &str) -> bool {
    let Some(first) = pattern.chars().next() else { return name.is_empty() };
    let rest = &pattern[first.len_utf8()..];
    let mut others = name.chars();
    let next = others.next();
    match (first, next) {
        ('*', None) => matches(rest, name),
        ('*', Some(_)) => matches(rest, name) || matches(pattern, others.as_str()),
        ('?', Some(_)) => matches(rest, others.as_str()),
        ('[', Some(character)) => rest
            .split_once(']')
            .is_some_and(|(set, rest)| contains(set, character) && matches(rest, others.as_str())),
        (_, Some(character)) => first == character && matches(rest, others.as_str()),
        (_, None) => false,
    }
}

/// Returns `true` if a set such as `A-Z_` has the character.
fn contains(set: &str, character: char) -> bool {
    let set: Vec<_> = set.chars().collect();
    let is_in_range =
        set.windows(3).any(|range| range[1] == '-' && (range[0]..=range[2]).contains(&character));
    is_in_range || set.contains(&character)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;
    use std::fs;
    use std::path::Path;
    use tempfile::TempDir;

    /// The units of the package.
    const SHIPPED: [&str; 2] = ["motord.service", "motord-deadman.service"];
    /// Drivers with a number of their own (the kernel's devices.txt), which may be loaded after the
    /// start of a unit.
    const FIXED: [(&str, u32); 7] = [
        ("ttyS", 4),
        ("ttyACM", 166),
        ("ttyUSB", 188),
        ("ttyAMA", 204),
        ("ttySAC", 204),
        ("ttyUL", 204),
        ("ttymxc", 207),
    ];
    /// Drivers that get a number when they are loaded: Tegra, i.MX, OMAP, SC16IS7xx, Qualcomm,
    /// STM32, Zynq, Amlogic, Marvell, SiFive, USB adapters with drivers of their vendors.
    const NUMBERED_WHEN_LOADED: [&str; 14] = [
        "ttyTHS",
        "ttyLP",
        "ttyO",
        "ttySC",
        "ttyHS",
        "ttyMSM",
        "ttySTM",
        "ttyPS",
        "ttyAML",
        "ttyMV",
        "ttySIF",
        "ttyCH341USB",
        "ttyXRUSB",
        "ttyMAX",
    ];

    /// A tree with the shipped units, and one port of this driver, which `/proc/devices` does not
    /// name.
    fn tree(driver: &str, major: u32) -> TempDir {
        let folder = TempDir::new().unwrap();
        let units = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../systemd");
        for unit in SHIPPED {
            let text = fs::read_to_string(units.join(unit)).unwrap();
            write(&folder, &format!("usr/lib/systemd/system/{unit}"), &text);
            write(
                &folder,
                &format!("usr/lib/systemd/system/{}", unit.replace(".service", "@.service")),
                &text,
            );
        }
        write(&folder, &format!("sys/class/tty/{driver}1/dev"), &format!("{major}:65\n"));
        write(&folder, &format!("dev/{driver}1"), "");
        folder
    }

    fn write(folder: &TempDir, path: &str, text: &str) {
        let path = folder.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn check(folder: &TempDir, units: &[&str], driver: &str) -> Option<Finding> {
        let units: Vec<_> = units.iter().map(|&unit| unit.to_owned()).collect();
        rules(&Tree::below(folder.path()), &units, &format!("/dev/{driver}1"))
    }

    #[test]
    fn units_permit_drivers_loaded_after_their_start() {
        for (driver, major) in FIXED {
            let folder = tree(driver, major);
            let port = Port {
                names: Vec::new(),
                ..Port::of(&Tree::below(folder.path()), &format!("/dev/{driver}1")).unwrap()
            };
            for unit in SHIPPED {
                assert!(
                    Rules::of(&Tree::below(folder.path()), unit).unwrap().allow(&port),
                    "{unit}: {driver}"
                );
            }
        }
    }

    #[test]
    fn units_permit_every_driver_of_serial_ports() {
        for (driver, major) in FIXED.into_iter().chain(NUMBERED_WHEN_LOADED.map(|driver| (driver, 240))) {
            let finding = check(&tree(driver, major), &SHIPPED, driver).unwrap();
            assert_eq!(finding.level, Level::Good, "{finding:?}");
        }
    }

    #[test]
    fn units_permit_no_other_device() {
        let others = [
            ("mem", 1),
            ("ttyprintk", 5),
            ("misc", 10),
            ("input", 13),
            ("rfcomm", 216),
            ("hidraw", 241),
            ("i2c", 89),
        ];
        for (driver, major) in others {
            let finding = check(&tree(driver, major), &SHIPPED, driver).unwrap();
            assert_eq!(finding.level, Level::Bad, "{finding:?}");
            assert_eq!(finding.command.unwrap(), "sudo systemctl edit motord.service motord-deadman.service");
            assert!(finding.why.unwrap().contains(&format!("`DeviceAllow=char-{driver} rw`")));
        }
    }

    #[test]
    fn drop_ins_add_and_remove_rules() {
        let folder = tree("rfcomm", 216);
        let units = ["motord@arm.service", "motord-deadman@arm.service"];
        let level = || check(&folder, &units, "rfcomm").unwrap().level;
        assert_eq!(level(), Level::Bad);
        write(
            &folder,
            "etc/systemd/system/motord@arm.service.d/override.conf",
            "[Service]\nDeviceAllow=char-rfcomm rw\n",
        );
        let finding = check(&folder, &units, "rfcomm").unwrap();
        assert_eq!(finding.measured, "motord-deadman@arm.service: char-rfcomm is not permitted");
        write(
            &folder,
            "etc/systemd/system/motord-deadman@.service.d/a.conf",
            "[Service]\nDeviceAllow = /dev/rfcomm1\n",
        );
        assert_eq!(level(), Level::Good);
        write(
            &folder,
            "run/systemd/system/motord@arm.service.d/z.conf",
            "[Unit]\nDeviceAllow=\n[Service]\nDeviceAllow=char-rfcomm r\n",
        );
        assert_eq!(level(), Level::Good);
        write(&folder, "run/systemd/system/motord@arm.service.d/z.conf", "[Service]\nDeviceAllow=\n");
        assert_eq!(level(), Level::Bad);
        write(
            &folder,
            "run/systemd/system/motord@arm.service.d/z.conf",
            "[Service]\nDeviceAllow=\nDevicePolicy=auto\n",
        );
        assert_eq!(level(), Level::Good);
    }

    #[test]
    fn computer_without_unit_has_no_rules() {
        let folder = tree("ttyUSB", 188);
        assert_eq!(check(&folder, &[], "ttyUSB"), None);
        assert_eq!(check(&folder, &["other.service"], "ttyUSB"), None);
        assert_eq!(check(&folder, &SHIPPED, "ttyTHS"), None);
    }

    #[test]
    fn name_of_driver_matches_its_pattern() {
        for (pattern, name, is_match) in [
            ("*", "", true),
            ("tty[A-Z]*", "ttyTHS", true),
            ("tty[A-Z]*", "ttyprintk", false),
            ("tty[A-Z]*", "tty", false),
            ("tty?[!", "ttyS[", false),
            ("*U*B", "ttyUSB", true),
            ("ttyUS", "ttyUSB", false),
            ("é*", "éa", true),
        ] {
            assert_eq!(matches(pattern, name), is_match, "{pattern} {name}");
        }
    }
}
