//! A serial port.

use crate::change::Change;
use crate::finding::Finding;
use crate::process::{self, RunningDaemon};
use crate::robot::ImuLine;
use crate::tree::{Permissions, Tree};

/// Above this part of the line a sample can wait for the one before.
const SOUND_UTILISATION: f64 = 0.9;

/// Checks that a serial port exists, delivers bytes immediately, has no other user, and may be
/// opened by the daemon, or else by this user.
pub(super) fn device(tree: &Tree, device: &str, daemon: Option<RunningDaemon>) -> Vec<Finding> {
    let Some(resolved) = tree.resolved(device) else {
        let why = "plug the adapter in, or correct `device` in the configuration";
        return vec![
            Finding::bad("serial port", "is not there", why)
                .mended_by("ls -l /dev/serial/by-id /dev/tty*".to_owned())
                .of(device),
        ];
    };
    vec![
        latency_timer(tree, device, &resolved),
        owner(tree, device, &resolved),
        permission(tree, device, &resolved, daemon),
    ]
}

/// Checks that the samples of an IMU fit into its line.
pub(super) fn imu(line: &ImuLine) -> Finding {
    const CHECK: &str = "IMU line";
    let ImuLine { device, baud, utilisation } = line;
    let measured = format!("{:.0} % of {baud} baud", 100.0 * utilisation);
    let finding = match *utilisation > SOUND_UTILISATION {
        false => Finding::good(CHECK, measured),
        true => {
            let why = "a further output of the device does not fit; raise the baud rate in the device and the configuration";
            Finding::warn(CHECK, measured, why)
        }
    };
    finding.of(device)
}

/// Checks that the daemon may read and write the port; without a daemon, that this user may.
fn permission(tree: &Tree, device: &str, resolved: &str, daemon: Option<RunningDaemon>) -> Finding {
    const CHECK: &str = "permission";
    const OF_USER: u32 = 0o600;
    const OF_GROUP: u32 = 0o060;
    const OF_OTHERS: u32 = 0o006;
    let process = daemon.map_or_else(|| "self".to_owned(), |daemon| daemon.pid.to_string());
    let user = process::user(tree, &process);
    let Some(Permissions { user: owner, group, mode }) = tree.permissions(resolved) else {
        return Finding::good(CHECK, "unknown").of(device);
    };
    let has = |bits: u32| mode & bits == bits;
    let may = user == Some(0)
        || user == Some(owner) && has(OF_USER)
        || process::groups(tree, &process).contains(&group) && has(OF_GROUP)
        || has(OF_OTHERS);
    let finding = match (may, daemon) {
        (true, _) => Finding::good(CHECK, "may be read and written"),
        (false, Some(_)) => {
            let why = "motord cannot open it; add the user of motord to the group of the device, and start motord again";
            Finding::bad(CHECK, "motord may not open it", why)
                .mended_by("sudo usermod -aG dialout motord".to_owned())
        }
        (false, None) => {
            let why = "the service may, whose user is in the group dialout; to run motord as this user, join it and log in again";
            Finding::warn(CHECK, "this user may not open it", why)
                .mended_by("sudo usermod -aG dialout $USER".to_owned())
        }
    };
    finding.of(device)
}

/// Checks the time for which a USB adapter holds bytes back.
fn latency_timer(tree: &Tree, device: &str, resolved: &str) -> Finding {
    const CHECK: &str = "latency timer";
    let name = resolved.rsplit('/').next().unwrap_or_default();
    let path = format!("sys/bus/usb-serial/devices/{name}/latency_timer");
    let finding = match tree.number(&path) {
        None => Finding::good(CHECK, "none"),
        Some(millis) if millis <= 1 => Finding::good(CHECK, format!("{millis} ms")),
        Some(millis) => {
            let why = "the adapter delays replies by up to this time; a change lasts until it is unplugged";
            Finding::warn(CHECK, format!("{millis} ms"), why).tuned_by(vec![Change::write(path, "1")])
        }
    };
    finding.of(device)
}

/// Checks for processes that have the port open, as far as this user may see them.
fn owner(tree: &Tree, device: &str, resolved: &str) -> Finding {
    const CHECK: &str = "owner";
    let opened = format!("/{resolved}");
    let has_it = |pid: &u32| {
        let directory = format!("proc/{pid}/fd");
        let mut files = tree.names(&directory).into_iter();
        files.any(|file| tree.link(&format!("{directory}/{file}")).as_ref() == Some(&opened))
    };
    let users: Vec<_> =
        tree.numbers("proc").into_iter().filter(has_it).map(|pid| User::of(tree, pid)).collect();
    if users.is_empty() {
        return Finding::good(CHECK, "no process that this user can see").of(device);
    }
    let names: Vec<_> = users.iter().map(|user| format!("{}, process {}", user.program, user.pid)).collect();
    let measured = names.join("; ");
    let commands: Vec<_> = users.iter().filter_map(User::remedy).collect();
    let finding = match users.iter().find(|user| user.remedy().is_some()) {
        None => Finding::good(CHECK, measured),
        Some(user) => Finding::bad(CHECK, measured, user.harm()).mended_by(commands.join("; ")),
    };
    finding.of(device)
}

/// A process that has the port open.
struct User {
    program: String,
    pid: u32,
}

impl User {
    fn of(tree: &Tree, pid: u32) -> Self {
        let program = process::program(tree, pid).unwrap_or_else(|| "unknown program".to_owned());
        Self { program, pid }
    }

    /// Returns the command that ends it; `None` for motord.
    fn remedy(&self) -> Option<String> {
        match self.program.as_str() {
            "motord" => None,
            "ModemManager" => Some("sudo systemctl disable --now ModemManager".to_owned()),
            _ => Some(format!("kill {}", self.pid)),
        }
    }

    fn harm(&self) -> &'static str {
        match self.program.as_str() {
            "ModemManager" => "it sends bytes to every port that it finds",
            _ => "two programs take each other's bytes",
        }
    }
}
