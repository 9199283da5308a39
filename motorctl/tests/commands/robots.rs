//! Daemons and outputs of the tests of several commands.

use motord_harness::daemon::Daemon;
use serde_json::Value;

/// A daemon of `config`, whose first motor answers.
pub(crate) fn started(config: &str) -> Daemon {
    let daemon = Daemon::start(config);
    daemon.await_status(|status| status["joints"][0]["mode"] == "idle");
    daemon
}

/// The group is stopped without a cause, and has no owner.
pub(crate) fn assert_free(daemon: &Daemon) {
    let status = daemon.await_status(|status| status["groups"][0]["owner"] == Value::Null);
    assert_eq!(
        (&status["groups"][0]["phase"], &status["groups"][0]["stop"]),
        (&"disarmed".into(), &Value::Null)
    );
}

/// The output of a program.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
