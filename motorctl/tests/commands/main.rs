//! Every command of `motorctl`, beside daemons with a low rate, and on simulated lines.

#![expect(clippy::unwrap_used, reason = "a test that cannot run has failed")]

#[path = "../line/mod.rs"]
mod line;

mod command_line;
mod completions;
mod configurations;
mod estop;
mod frame;
mod frame_logs;
mod guide;
mod health;
mod help;
mod hold;
mod identify;
mod imu;
mod models;
mod monitor;
mod operate;
mod pages;
mod programs;
mod protocol_table;
mod readme;
mod recording;
mod schemas;
mod setup;
mod tune;
mod wire;

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
