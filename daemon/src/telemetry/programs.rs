//! The programs of the processes that sent requests.
//!
//! A process may have exited when the log reports its request, so its name is read while it waits
//! for its answer.

use motord_bus::{Duration, Instant, clock};
use motord_ports::instance::pid_namespace;
use motord_ports::stop_source::StopSource;
use motord_realtime::process;
use motord_shared::{AdminRequest, Cause, Operation};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};

/// Most processes that are remembered.
const PROGRAMS_MAX: usize = 64;
/// Least time between two reads of a process's name: a process may send requests without pause.
const FRESH: Duration = Duration::from_secs(1);

/// The last requesters and their programs. Clones share them. No call waits for another one: if the
/// lock is taken, it skips.
#[derive(Debug, Clone, Default)]
pub struct Programs {
    requesters: Arc<Mutex<VecDeque<Requester>>>,
    /// The first process since the last reset that requested an emergency stop through its socket,
    /// and its source: later ones latch nothing.
    stop: Arc<Mutex<Option<(u32, StopSource)>>>,
}

#[derive(Debug)]
struct Requester {
    pid: u32,
    /// `None` for a process of another namespace: here its id means another process.
    program: Option<String>,
    read_at: Instant,
}

impl Programs {
    /// Remembers the program of process `pid` of this namespace, which waits for an answer. Reads a
    /// file of the kernel, and allocates.
    pub fn note(&self, pid: u32) {
        self.note_as(pid, true);
    }

    /// Remembers the source of the emergency stop that process `pid` requests, if it is the first one
    /// since a reset. Does not allocate.
    pub fn note_source(&self, pid: u32, source: StopSource) {
        if let Some(mut stop) = unless_taken(&self.stop) {
            stop.get_or_insert((pid, source));
        }
    }

    /// Works like [`note`](Self::note), for the process that sent `request`, in whatever namespace
    /// of processes it is.
    pub fn note_request(&self, request: &AdminRequest) {
        match request.operation() {
            Ok(Operation::EmergencyStop) => self.note_source(request.pid, StopSource::NONE),
            Ok(Operation::Reset) => self.forget_source(),
            _ => {}
        }
        self.note_as(request.pid, [0, pid_namespace()].contains(&request.pid_namespace));
    }

    fn forget_source(&self) {
        if let Some(mut stop) = unless_taken(&self.stop) {
            *stop = None;
        }
    }

    fn note_as(&self, pid: u32, is_here: bool) {
        let now = clock::monotonic();
        let Some(mut programs) = unless_taken(&self.requesters) else { return };
        let is_fresh = |requester: &Requester| {
            requester.program.is_some() == is_here && now.since(requester.read_at) < FRESH
        };
        if programs.iter().any(|requester| requester.pid == pid && is_fresh(requester)) {
            return;
        }
        let program = if is_here { process::program(pid) } else { None };
        if is_here && program.is_none() {
            return;
        }
        programs.retain(|requester| requester.pid != pid);
        programs.push_front(Requester { pid, program, read_at: now });
        if programs.len() > PROGRAMS_MAX {
            // The program of a process of this namespace can be read again.
            let oldest = programs.iter().rposition(|requester| requester.program.is_some());
            programs.remove(oldest.unwrap_or(PROGRAMS_MAX));
        }
    }

    /// The program of process `pid`; `None` when the kernel does not tell it, as of a process that
    /// has ended, or one in another namespace of processes.
    #[must_use]
    pub fn program(&self, pid: u32) -> Option<String> {
        let programs = unless_taken(&self.requesters)?;
        match programs.iter().find(|requester| requester.pid == pid) {
            Some(requester) => requester.program.clone(),
            None => process::program(pid),
        }
    }

    /// Works like [`program`](Self::program), for the process that caused a stop: that of an
    /// emergency stop is followed by the source that it named.
    #[must_use]
    pub fn of_stop(&self, cause: Cause, pid: u32) -> Option<String> {
        let program = self.program(pid);
        if cause != Cause::EmergencyStop {
            return program;
        }
        let stop = unless_taken(&self.stop).and_then(|stop| *stop);
        let source = stop.filter(|(stopped_by, _)| *stopped_by == pid).map(|(_, source)| source);
        // The socket names processes of this namespace only, so the kernel may be asked while another
        // thread has the list.
        let program = program.or_else(|| source.and_then(|_| process::program(pid)));
        match (program, source.as_ref().and_then(StopSource::text)) {
            (Some(program), Some(source)) => Some(format!("{program}: {source}")),
            (None, Some(source)) => Some(format!("a program that has ended: {source}")),
            (program, None) => program,
        }
    }
}

fn unless_taken<T>(values: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    match values.try_lock() {
        Ok(values) => Some(values),
        Err(TryLockError::Poisoned(values)) => Some(values.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requester_program_is_known_after_its_exit() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let (pid, programs) = (child.id(), Programs::default());
        while programs.program(pid).as_deref() != Some("sleep") {
            std::thread::yield_now();
        }
        programs.note(pid);
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(programs.clone().program(pid).as_deref(), Some("sleep"));
        assert_eq!(Programs::default().program(pid), None);
    }

    #[test]
    fn source_follows_the_program_that_named_it() {
        let (programs, own) = (Programs::default(), std::process::id());
        let program = programs.program(own).unwrap();
        programs.note_source(own, StopSource::new("button B"));
        assert_eq!(programs.of_stop(Cause::EmergencyStop, own), Some(format!("{program}: button B")));
        assert_eq!(programs.program(own), Some(program.clone()), "an owner has no source");
        assert_eq!(programs.of_stop(Cause::Disabled, own), Some(program.clone()));
        programs.note_source(1, StopSource::new("another"));
        programs.note_source(own, StopSource::new("button A"));
        let first = Some(format!("{program}: button B"));
        assert_eq!(programs.of_stop(Cause::EmergencyStop, own), first, "a later stop latches nothing");
        let reset = AdminRequest { operation: Operation::Reset.code(), pid: own, ..AdminRequest::default() };
        programs.note_request(&reset);
        programs.note_source(1, StopSource::new("another"));
        assert_eq!(programs.of_stop(Cause::EmergencyStop, own), Some(program));
    }

    #[test]
    fn program_of_stop_needs_no_list() {
        let (programs, own) = (Programs::default(), std::process::id());
        programs.note_source(own, StopSource::NONE);
        let held = programs.requesters.lock().unwrap();
        assert!(programs.of_stop(Cause::EmergencyStop, own).is_some());
        drop(held);
    }

    #[test]
    fn source_of_ended_program_is_still_named() {
        let programs = Programs::default();
        programs.note_source(0, StopSource::new("button B"));
        let named = programs.of_stop(Cause::EmergencyStop, 0).unwrap();
        assert_eq!(named, "a program that has ended: button B");
    }

    /// Process 1 of a container is not process 1 of this computer.
    #[test]
    fn requester_in_container_has_no_program() {
        let programs = Programs::default();
        let of = |pid, pid_namespace| AdminRequest { pid, pid_namespace, ..AdminRequest::default() };
        programs.note_request(&of(1, pid_namespace() + 1));
        assert_eq!(programs.program(1), None);
        (2..200).for_each(|pid| programs.note_request(&of(pid, pid_namespace())));
        assert_eq!(programs.program(1), None, "whatever number of requests follows");
        programs.note_request(&of(1, pid_namespace()));
        assert!(programs.program(1).is_some());
    }
}
