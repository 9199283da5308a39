//! The emergency stop: from its socket, [`motord_stop`], to the cycle.

use crate::telemetry::programs::Programs;
use motord_bus::{Duration, clock};
use motord_core::cycle::EmergencyStops;
use motord_ports::stop_socket::StopError;
use motord_ports::stop_source::StopSource;
use motord_stop::Robot;
use std::sync::Arc;

/// Longest time for a cycle to execute a stop.
const CYCLE_TIMEOUT: Duration = Duration::from_millis(500);
/// Period of the checks whether the cycle has executed it.
const POLL: Duration = Duration::from_micros(200);

/// The cycle that executes the stops.
pub struct CycleStop {
    /// Requests to the cycle, one word each.
    pub stops: Arc<EmergencyStops>,
    /// The programs of requesters.
    pub programs: Programs,
}

impl Robot for CycleStop {
    /// Allocates nothing before the cycle has the request.
    fn stop(&self, pid: u32, source: StopSource) -> Result<(), StopError> {
        // Before the request: the thread that reports the stop needs it.
        self.programs.note_source(pid, source);
        let request = self.stops.ask(pid);
        // The program's name is there as long as the process waits for its answer; nothing depends
        // on it.
        self.programs.note(pid);
        let end = clock::monotonic() + CYCLE_TIMEOUT;
        while !self.stops.is_done(request) {
            if clock::monotonic() >= end {
                return Err(StopError::NoCycle);
            }
            std::thread::sleep(POLL);
        }
        Ok(())
    }

    fn program(&self, pid: u32) -> Option<String> {
        self.programs.program(pid)
    }
}
