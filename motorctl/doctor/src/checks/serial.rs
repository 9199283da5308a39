//! A serial port.

use crate::change::Change;
use crate::finding::Finding;
use crate::process;
use crate::tree::Tree;

/// Checks that a serial port exists, delivers bytes immediately, and has no other user.
pub(super) fn device(tree: &Tree, device: &str) -> Vec<Finding> {
    let Some(resolved) = tree.resolved(device) else {
        let why = "plug the adapter in, or correct `device` in the configuration";
        return vec![
            Finding::bad("serial port", "is not there", why)
                .mended_by("ls -l /dev/serial/by-id /dev/tty*".to_owned())
                .of(device),
        ];
    };
    vec![latency_timer(tree, device, &resolved), owner(tree, device, &resolved)]
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
            let why = "the adapter keeps a reply back for so long; counts until it is unplugged";
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
        return Finding::good(CHECK, "nobody that this user may see").of(device);
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
