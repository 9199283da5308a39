//! Emergency stops, which reach the cycle without waiting in a queue.
//!
//! Wait-free: one atomic word in each direction. No process can fill or hold it.

use core::sync::atomic::{AtomicU64, Ordering};
use std::sync::Arc;

/// A request: its number in the upper half, the process id of the requester in the lower half. 0 is
/// none.
pub type StopRequest = u64;

/// The newest requested emergency stop, and the newest completed one.
#[derive(Debug, Default)]
pub struct EmergencyStops {
    asked: AtomicU64,
    done: AtomicU64,
}

impl EmergencyStops {
    /// Requests an emergency stop for process `pid`. The next cycle stops every group, also when it
    /// is late. Only one thread may call this.
    pub fn ask(&self, pid: u32) -> StopRequest {
        let before = self.asked.load(Ordering::Relaxed);
        let number = ((before >> 32) as u32).wrapping_add(1).max(1);
        let request = u64::from(number) << 32 | u64::from(pid);
        self.asked.store(request, Ordering::Release);
        request
    }

    /// Returns whether a cycle has stopped every group for `request`, the last one, and has sent
    /// the commands.
    #[must_use]
    pub fn is_done(&self, request: StopRequest) -> bool {
        self.done.load(Ordering::Acquire) == request
    }
}

/// The cycle's end.
#[derive(Debug)]
pub(super) struct AskedStops {
    stops: Arc<EmergencyStops>,
    taken: StopRequest,
}

impl AskedStops {
    pub(super) const fn new(stops: Arc<EmergencyStops>) -> Self {
        Self { stops, taken: 0 }
    }

    /// Takes the requester of a new request. Does not allocate or block.
    pub(super) fn take(&mut self) -> Option<u32> {
        let asked = self.stops.asked.load(Ordering::Acquire);
        let is_new = asked != core::mem::replace(&mut self.taken, asked);
        is_new.then_some(asked as u32)
    }

    /// Marks the last request as completed. Does not allocate or block.
    pub(super) fn confirm(&self) {
        self.stops.done.store(self.taken, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_is_taken_once_and_completed_with_cycle() {
        let stops = Arc::new(EmergencyStops::default());
        let mut asked = AskedStops::new(Arc::clone(&stops));
        assert_eq!(asked.take(), None);
        let request = stops.ask(7);
        assert_eq!((asked.take(), asked.take()), (Some(7), None));
        assert!(!stops.is_done(request), "its cycle is not over");
        asked.confirm();
        assert!(stops.is_done(request));
        let again = stops.ask(7);
        assert!(!stops.is_done(again) && asked.take() == Some(7));
    }

    #[test]
    fn request_number_is_never_that_of_none() {
        let stops = EmergencyStops { asked: AtomicU64::new(u64::MAX), done: AtomicU64::new(0) };
        assert!(!stops.is_done(stops.ask(0)));
    }
}
