//! Every cycle, for recorders.

use crate::Error;
use crate::link::Connection;
use motord_ports::RecordPort;
use motord_shared::CycleRecord;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A daemon that gives nothing for so long is silent or gone.
const PATIENCE: Duration = Duration::from_millis(500);

/// Every cycle of one run of the daemon, with the setpoints that it used. At most 512 cycles wait to be taken, half a second at
/// 1 kHz: take them more often than that. A record wakes nobody, and costs the daemon a microsecond or so per cycle.
#[derive(Debug)]
pub struct Records {
    // Before the link: the attachment goes last.
    port: RecordPort,
    link: Arc<Connection>,
    heard: Instant,
    /// The sequence number and boot id of the record before.
    before: Option<(u64, u64)>,
    lost: u64,
}

impl Records {
    pub(crate) fn new(link: Arc<Connection>) -> Result<Self, Error> {
        Ok(Self { port: link.record_port()?, link, heard: Instant::now(), before: None, lost: 0 })
    }

    /// Copies the oldest cycle that was not taken yet into `record`. Returns whether there was one. Does not wait.
    ///
    /// # Errors
    /// [`Error::NotRunning`] or [`Error::Silent`] when nothing came for half a second, [`Error::Restarted`] from then on when
    /// another daemon is there; else that the connection is damaged.
    pub fn take(&mut self, record: &mut CycleRecord) -> Result<bool, Error> {
        let taken = self.port.take(record).map_err(|error| Error::of_service(error, self.link.instance()))?;
        if !taken {
            let silent_for = self.heard.elapsed();
            return if silent_for < PATIENCE { Ok(false) } else { Err(self.link.gone_for(silent_for)) };
        }
        self.heard = Instant::now();
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

    /// Cycles that were lost because they were not taken in time.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }
}
