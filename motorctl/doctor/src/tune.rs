//! The changes of `--tune`.

use crate::change::Change;
use crate::finding::Finding;
use serde::Serialize;
use std::io;

/// A change and its outcome.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Tuned {
    /// The equivalent command.
    pub(crate) command: String,
    /// The error; `None` after success.
    pub(crate) error: Option<String>,
}

/// Makes every change of `findings` by `apply`, in order. A failed one does not stop the others.
pub(crate) fn tune(findings: &[Finding], apply: impl Fn(&Change) -> io::Result<()>) -> Vec<Tuned> {
    let changes = findings.iter().flat_map(|finding| &finding.changes);
    let made = |change: &Change| Tuned {
        command: change.to_string(),
        error: apply(change).err().map(|error| error.to_string()),
    };
    changes.map(made).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn interface_is_set_up_although_change_failed() {
        let changes =
            ["ip link set can0 down", "ethtool -C can0 rx-usecs 0", "ip link set can0 up"].map(Change::run);
        let findings = [
            Finding::good("kernel", "PREEMPT_RT"),
            Finding::warn("coalescing", "rx-usecs 100", "late").tuned_by(changes.to_vec()),
            Finding::warn("isolated cores", "none", "others").mended_by("update-grub".to_owned()),
        ];
        let seen = RefCell::new(Vec::new());
        let tuned = tune(&findings, |change| {
            seen.borrow_mut().push(change.clone());
            if *change == changes[1] { Err(io::Error::other("not supported")) } else { Ok(()) }
        });
        assert_eq!(seen.into_inner(), changes);
        let errors: Vec<_> = tuned.iter().map(|tuned| tuned.error.as_deref()).collect();
        assert_eq!(errors, [None, Some("not supported"), None]);
        assert_eq!(tuned[1].command, "sudo ethtool -C can0 rx-usecs 0");
    }
}
