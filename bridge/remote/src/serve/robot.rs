//! The values that the threads of the robot's side share.

use super::imus::Imus;
use super::link::Link;
use super::readers::Readers;
use crate::admission::{Admission, Refused};
use crate::config::Serve;
use crate::frame::{Up, nanos};
use crate::measure::Counters;
use motord_ports::clock;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The admission of frames, the daemon, and the counters.
#[derive(Debug)]
pub(super) struct Robot {
    admission: Mutex<Admission>,
    imus: Mutex<Imus>,
    readers: Mutex<Readers>,
    pub(super) link: Link,
    pub(super) counters: Counters,
    age_max: Duration,
}

impl Robot {
    pub(super) fn new(serve: &Serve, run: u64) -> Self {
        Self {
            admission: Mutex::new(Admission::new(run, serve.age_max())),
            imus: Mutex::default(),
            readers: Mutex::default(),
            link: Link::default(),
            counters: Counters::default(),
            age_max: serve.age_max(),
        }
    }

    pub(super) fn admission(&self) -> MutexGuard<'_, Admission> {
        self.admission.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the mirrors that want records.
    pub(super) fn readers(&self) -> MutexGuard<'_, Readers> {
        self.readers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the bytes of a mirror that may claim: passes a setpoint that counts to the daemon, and
    /// counts others. A frame that only measures announces the mirror.
    pub(super) fn take_setpoint(&self, bytes: &[u8]) {
        let now_ns = clock::now_ns();
        let taken = match Up::read_beat(bytes) {
            Ok(up) => self.admission().admit(&up, now_ns).map(drop),
            Err(_) => self.pass_setpoint(bytes, now_ns),
        };
        if let Err(reason) = taken {
            self.counters.refuse(reason);
        }
    }

    /// Takes the bytes of a frame that only measures.
    pub(super) fn take_beat(&self, bytes: &[u8]) {
        let admitted = Up::read_beat(bytes).map_err(Refused::from);
        let admitted = admitted.and_then(|up| self.admission().admit_watcher(&up, clock::now_ns()));
        if let Err(reason) = admitted {
            self.counters.refuse(reason);
        }
    }

    /// Takes the bytes of a mirror that wants records. A late want counts also: it moves nothing.
    pub(super) fn take_want(&self, bytes: &[u8]) {
        let now_ns = clock::now_ns();
        let noted = Up::read_beat(bytes).map_err(Refused::from).and_then(|up| {
            match self.admission().admit_watcher(&up, now_ns) {
                Ok(_) | Err(Refused::Late) => self.readers().want(up.head.from, now_ns),
                Err(reason) => Err(reason),
            }
        });
        if let Err(reason) = noted {
            self.counters.refuse(reason);
        }
    }

    /// Takes the bytes of a mirror with samples of external IMUs: passes those that count to the
    /// daemon, and counts others.
    pub(super) fn take_samples(&self, bytes: &[u8]) {
        if let Err(reason) = self.pass_samples(bytes, clock::now_ns()) {
            self.counters.refuse(reason);
        }
    }

    fn pass_samples(&self, bytes: &[u8], now_ns: u64) -> Result<(), Refused> {
        let (up, samples) = Up::read_samples(bytes)?;
        let transit = self.admission().admit(&up, now_ns)?;
        let mut imus = self.imus.lock().unwrap_or_else(PoisonError::into_inner);
        imus.compare(&up, now_ns);
        for sample in &samples {
            match imus.admit(&up.head, sample, transit, self.age_max, now_ns) {
                Ok(sample) => {
                    self.link.send_sample(&sample);
                    self.counters.change(|counts| counts.samples += 1);
                }
                Err(reason) => self.counters.refuse(reason),
            }
        }
        Ok(())
    }

    /// Holds the admission until the daemon has the setpoint: of two links of one session none passes
    /// an older one later.
    fn pass_setpoint(&self, bytes: &[u8], now_ns: u64) -> Result<(), Refused> {
        let (up, mut setpoint, waited) = Up::read_setpoint(bytes)?;
        let mut admission = self.admission();
        let transit = admission.admit(&up, now_ns)?;
        let lease = admission.check_lease(up.head.from, setpoint.lease)?;
        let age = transit.saturating_add(waited);
        if age > self.age_max {
            return Err(Refused::Late);
        }
        setpoint.time_ns = sent_ns(now_ns, transit, waited);
        self.counters.setpoint_age.record(age);
        self.counters.change(|counts| counts.setpoints += 1);
        self.link.send(lease, &setpoint);
        drop(admission);
        Ok(())
    }
}

/// Returns the time of a setpoint's sending by the own clock, ns. The bound of its transit contains
/// that of the state before it: half of the bound is the best estimate.
fn sent_ns(now_ns: u64, transit: Duration, waited: Duration) -> u64 {
    now_ns.saturating_sub(nanos((transit / 2).saturating_add(waited)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setpoint_is_as_old_as_it_waited() {
        let [now, way, waited] = [1_000_000, 4_000, 300];
        assert_eq!(
            sent_ns(now, Duration::from_nanos(way), Duration::from_nanos(waited)),
            now - way / 2 - waited
        );
        assert_eq!(sent_ns(5, Duration::MAX, Duration::MAX), 0);
    }
}
