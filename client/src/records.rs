//! Every cycle, for recorders.

use crate::Error;
use crate::link::Connection;
use motord_ports::{ForkGuard, RecordPort};
use motord_shared::CycleRecord;
use motord_shared::description::{RobotDescription, Telemetry};
use serde::Serialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time without a record after which the daemon counts as silent or ended.
const TIMEOUT: Duration = Duration::from_millis(500);

/// Every cycle of one run of the daemon, with the setpoints used. The queue holds 512 cycles, half
/// a second at 1 kHz: take them more often than that. A record causes no wake-up, and costs the
/// daemon about a microsecond per cycle.
#[derive(Debug)]
pub struct Records {
    // Declared before the link: the attachment must be dropped last.
    port: ForkGuard<RecordPort>,
    link: Arc<Connection>,
    last_received: Instant,
    /// The sequence number and boot id of the previous record.
    before: Option<(u64, u64)>,
    lost: u64,
}

impl Records {
    pub(crate) fn new(link: Arc<Connection>) -> Result<Self, Error> {
        Ok(Self { port: link.record_port()?, link, last_received: Instant::now(), before: None, lost: 0 })
    }

    /// Copies the oldest cycle that was not taken yet into `record`. Returns `true` if there was
    /// one. Does not wait.
    ///
    /// # Errors
    /// [`Error::NotRunning`] or [`Error::Silent`] after half a second without a record;
    /// [`Error::Restarted`] with each call after another daemon has started; otherwise the error of
    /// a damaged connection.
    pub fn take(&mut self, record: &mut CycleRecord) -> Result<bool, Error> {
        let taken = self.port.get()?.take(record);
        let taken = taken.map_err(|error| Error::of_service(error, self.link.instance()))?;
        if !taken {
            let silent_for = self.last_received.elapsed();
            return if silent_for < TIMEOUT {
                Ok(false)
            } else {
                Err(self.link.silence_error_after(silent_for))
            };
        }
        self.last_received = Instant::now();
        let (sequence, boot_id) = (record.sequence, record.state.boot_id);
        if let Some((before, known_id)) = self.before {
            if known_id != boot_id {
                return Err(Error::Restarted);
            }
            self.lost += sequence.saturating_sub(before).saturating_sub(1);
        }
        self.before = Some((sequence, boot_id));
        Ok(true)
    }

    /// Returns the number of cycles lost because they were not taken in time.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

/// Returns the object that `motorctl latency --json` prints: [`Telemetry`] with the names of the
/// joints, IMUs and groups, without their owners and stops.
#[must_use]
pub fn named_telemetry(robot: &RobotDescription, telemetry: &Telemetry) -> impl Serialize + use<> {
    let mut object = json!(telemetry);
    // `status` shows owners and stops.
    object.as_object_mut().and_then(|object| object.remove("groups"));
    object["instance"] = json!(robot.instance);
    let joints = robot.joints.iter().zip(&telemetry.joints);
    object["joints"] =
        joints.map(|(joint, latency)| json!({ "name": joint.name, "reply_latency_us": latency })).collect();
    let imus = robot.imus.iter().zip(&telemetry.imus);
    object["imus"] = imus.map(|(imu, age)| json!({ "name": imu.name, "age_us": age })).collect();
    let groups = robot.groups.iter().zip(&telemetry.control);
    let control = groups.map(|(group, latency)| {
        json!({ "name": group.name, "control_latency_us": latency.control_latency_us, "cycles": latency.cycles })
    });
    object["control"] = control.collect::<Value>();
    object
}
