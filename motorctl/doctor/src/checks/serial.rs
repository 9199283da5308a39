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
    let Some(pid) = tree.numbers("proc").into_iter().find(has_it) else {
        return Finding::good(CHECK, "nobody that this user may see").of(device);
    };
    let program = process::program(tree, pid).unwrap_or_else(|| "unknown program".to_owned());
    let measured = format!("{program}, process {pid}");
    let finding = match program.as_str() {
        "motord" => Finding::good(CHECK, measured),
        "ModemManager" => Finding::bad(CHECK, measured, "it sends bytes to every port that it finds")
            .mended_by("sudo systemctl disable --now ModemManager".to_owned()),
        _ => Finding::bad(CHECK, measured, "two programs take each other's bytes")
            .mended_by(format!("kill {pid}")),
    };
    finding.of(device)
}
