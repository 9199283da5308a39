//! Waiting for all buses at once.

use crate::readiness::MAX_BUSES;
use crate::time::Instant;
use crate::{Readiness, Ready, clock, kernel};

/// Sleeps until a bus has something or `until` is reached. `now` is the present time.
///
/// A signal ends it early with nothing ready: whoever needs `until` reads the clock. A descriptor with an error is
/// ready, because only receiving takes the error away. Does not allocate; one system call (`ppoll`, or
/// `clock_nanosleep` when no bus has a descriptor).
#[must_use]
pub fn wait(readiness: &[Readiness], now: Instant, until: Instant) -> Ready {
    let readiness = &readiness[..readiness.len().min(MAX_BUSES)];
    let wake = readiness.iter().fold(until, |wake, readiness| match *readiness {
        Readiness::At(instant) => wake.min(instant),
        Readiness::Readable(_) | Readiness::Never => wake,
    });
    let mut descriptors = [libc::pollfd { fd: IGNORED, events: libc::POLLIN, revents: 0 }; MAX_BUSES];
    for (descriptor, readiness) in descriptors.iter_mut().zip(readiness) {
        if let Readiness::Readable(fd) = *readiness {
            descriptor.fd = fd;
        }
    }
    let reached = sleep(&mut descriptors[..readiness.len()], now, wake);
    let ready = |index: usize| match readiness[index] {
        Readiness::At(instant) => instant <= reached,
        Readiness::Readable(_) => descriptors[index].revents != 0,
        Readiness::Never => false,
    };
    Ready::of((0..readiness.len()).map(ready))
}

/// `ppoll` passes over a negative descriptor.
const IGNORED: i32 = -1;

/// Sleeps until a descriptor has an event or `wake` is reached, and returns the time that was surely reached.
fn sleep(descriptors: &mut [libc::pollfd], now: Instant, wake: Instant) -> Instant {
    if descriptors.iter().all(|descriptor| descriptor.fd == IGNORED) {
        clock::sleep_until(wake);
        return wake;
    }
    match kernel::poll(descriptors, wake.since(now)) {
        Ok(0) => wake,
        Ok(_) | Err(_) => now,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::Duration;
    use std::os::fd::AsRawFd;
    use std::os::unix::net::UnixDatagram;

    const SOON: Duration = Duration::from_millis(5);

    #[test]
    fn the_bus_that_has_something_is_told_from_the_others() {
        let ((silent, _far), (talking, peer)) =
            (UnixDatagram::pair().unwrap(), UnixDatagram::pair().unwrap());
        peer.send(&[1]).unwrap();
        let readiness = [
            Readiness::Readable(silent.as_raw_fd()),
            Readiness::Never,
            Readiness::Readable(talking.as_raw_fd()),
            Readiness::At(Instant::FAR_FUTURE),
        ];
        let now = clock::monotonic();
        let ready = wait(&readiness, now, now + Duration::from_secs(60));
        assert_eq!([0, 1, 2, 3].map(|index| ready.contains(index)), [false, false, true, false]);
    }

    #[test]
    fn waiting_ends_at_its_deadline_with_or_without_descriptors() {
        let (silent, _far) = UnixDatagram::pair().unwrap();
        for readiness in [&[Readiness::Readable(silent.as_raw_fd())][..], &[Readiness::Never], &[]] {
            let now = clock::monotonic();
            assert!(!wait(readiness, now, now + SOON).any());
            assert!(clock::monotonic() >= now + SOON, "{readiness:?}");
        }
    }

    #[test]
    fn a_bus_that_knows_its_time_is_ready_then_and_not_before() {
        let now = clock::monotonic();
        let readiness = [Readiness::At(now + SOON), Readiness::At(now + 2 * SOON)];
        let ready = wait(&readiness, now, now + Duration::from_secs(60));
        assert!(ready.contains(0) && !ready.contains(1));
        assert!(clock::monotonic() >= now + SOON);
    }

    #[test]
    fn a_bus_whose_other_end_is_gone_is_ready_at_once() {
        let closed = UnixDatagram::unbound().unwrap().as_raw_fd();
        let now = clock::monotonic();
        assert!(wait(&[Readiness::Readable(closed)], now, now + Duration::from_secs(60)).contains(0));
    }
}
