//! Waiting for all buses in one call.

use nix::poll::{PollFd, PollFlags, ppoll};

use crate::readiness::MAX_BUSES;
use crate::time::{Duration, Instant};
use crate::{Clock, Readiness, Ready, clock};

/// Sleeps until a bus is ready, at most until `until`. `now` is the present time.
///
/// A signal ends the sleep early with no bus ready, so a caller that needs `until` reads the clock.
/// A descriptor with an error is ready, because only receiving clears the error. Does not allocate;
/// one system call (`ppoll`, or `clock_nanosleep` when no bus has a descriptor).
#[must_use]
pub fn wait(readiness: &[Readiness<'_>], now: Instant, until: Instant) -> Ready {
    let readiness = &readiness[..readiness.len().min(MAX_BUSES)];
    let wake = readiness.iter().fold(until, |wake, readiness| match *readiness {
        Readiness::At(instant) => wake.min(instant),
        Readiness::Readable(_) | Readiness::Never => wake,
    });
    let mut descriptors = readiness.iter().filter_map(descriptor);
    let Some(first) = descriptors.next() else {
        clock::sleep_until(wake);
        return ready(readiness, wake, &[]);
    };
    // `PollFd` has no value for an empty slot.
    let mut count = 1;
    let mut polled: [PollFd<'_>; MAX_BUSES] = core::array::from_fn(|_| first.clone());
    for (slot, descriptor) in polled[count..].iter_mut().zip(descriptors) {
        *slot = descriptor;
        count += 1;
    }
    let polled = &mut polled[..count];
    let reached = match ppoll(polled, Some(wake.since(now).into()), None) {
        Ok(0) => wake,
        Ok(_) | Err(_) => now,
    };
    ready(readiness, reached, polled)
}

fn descriptor<'a>(readiness: &Readiness<'a>) -> Option<PollFd<'a>> {
    match *readiness {
        Readiness::Readable(descriptor) => Some(PollFd::new(descriptor, PollFlags::POLLIN)),
        Readiness::At(_) | Readiness::Never => None,
    }
}

/// Returns the buses that are ready when `reached` has certainly passed. `polled` are the
/// descriptors among `readiness`, in order.
fn ready(readiness: &[Readiness<'_>], reached: Instant, polled: &[PollFd<'_>]) -> Ready {
    let mut polled = polled.iter();
    Ready::of(readiness.iter().map(|readiness| match *readiness {
        Readiness::At(instant) => instant <= reached,
        // `None` means an event that nix cannot name: the bus counts as ready.
        Readiness::Readable(_) => polled.next().is_some_and(|polled| polled.any() != Some(false)),
        Readiness::Never => false,
    }))
}

/// The clock of this machine, `CLOCK_MONOTONIC`.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    #[inline]
    fn now(&self) -> Instant {
        clock::monotonic()
    }

    fn now_and_suspended(&self) -> (Instant, Duration) {
        clock::monotonic_and_suspended()
    }

    fn sleep_until(&mut self, instant: Instant) {
        clock::sleep_until(instant);
    }

    fn wait(&mut self, readiness: &[Readiness<'_>], until: Instant) -> Ready {
        wait(readiness, clock::monotonic(), until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;
    use std::os::fd::AsFd;
    use std::os::unix::net::{UnixDatagram, UnixStream};

    const SOON: Duration = Duration::from_millis(5);

    #[test]
    fn only_the_bus_that_has_something_is_ready() {
        let ((silent, _far), (talking, peer)) =
            (UnixDatagram::pair().unwrap(), UnixDatagram::pair().unwrap());
        peer.send(&[1]).unwrap();
        let readiness = [
            Readiness::Readable(silent.as_fd()),
            Readiness::Never,
            Readiness::Readable(talking.as_fd()),
            Readiness::At(Instant::FAR_FUTURE),
        ];
        let now = clock::monotonic();
        let ready = wait(&readiness, now, now + Duration::from_secs(60));
        assert_eq!([0, 1, 2, 3].map(|index| ready.contains(index)), [false, false, true, false]);
    }

    #[test]
    fn wait_ends_at_deadline_without_descriptors_too() {
        let (silent, _far) = UnixDatagram::pair().unwrap();
        for readiness in [&[Readiness::Readable(silent.as_fd())][..], &[Readiness::Never], &[]] {
            let now = clock::monotonic();
            assert!(!wait(readiness, now, now + SOON).any());
            assert!(clock::monotonic() >= now + SOON, "{readiness:?}");
        }
    }

    #[test]
    fn bus_with_known_time_is_ready_exactly_then() {
        let now = clock::monotonic();
        let readiness = [Readiness::At(now + SOON), Readiness::At(now + 2 * SOON)];
        let ready = wait(&readiness, now, now + Duration::from_secs(60));
        assert!(ready.contains(0) && !ready.contains(1));
        assert!(clock::monotonic() >= now + SOON);
    }

    /// An unplugged adapter returns `POLLERR`, a closed serial line `POLLHUP`. `poll` reports both
    /// without a request.
    #[test]
    fn disconnected_bus_is_always_ready() {
        let (near, far) = UnixStream::pair().unwrap();
        let (silent, _far) = UnixDatagram::pair().unwrap();
        drop(far);
        for _ in 0..3 {
            let now = clock::monotonic();
            let readiness = [Readiness::Readable(silent.as_fd()), Readiness::Readable(near.as_fd())];
            let ready = wait(&readiness, now, now + Duration::from_secs(60));
            assert!(ready.contains(1) && !ready.contains(0));
        }
    }

    #[test]
    fn buses_beyond_watch_limit_are_ignored() {
        let (silent, _far) = UnixDatagram::pair().unwrap();
        let (talking, peer) = UnixDatagram::pair().unwrap();
        peer.send(&[1]).unwrap();
        let mut readiness = [Readiness::Readable(silent.as_fd()); MAX_BUSES + 1];
        readiness[MAX_BUSES] = Readiness::Readable(talking.as_fd());
        let now = clock::monotonic();
        assert!(!wait(&readiness, now, now + SOON).any());
        readiness[MAX_BUSES - 1] = Readiness::Readable(talking.as_fd());
        assert!(wait(&readiness, now, now + Duration::from_secs(60)).contains(MAX_BUSES - 1));
    }
}
