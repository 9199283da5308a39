//! The thread that owns the client and the claims. It touches no network.

use crate::held::Held;
use crate::link::GroupLink;
use crate::rate_limit::RateLimit;
use crate::request::{Answer, Operation, Request};
use crate::shared::{Report, Shared, Snapshot};
use motord_client::{Client, Error, RobotDescription, State};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

/// Longest wait for a state: requests are answered at least this often.
const WAIT: Duration = Duration::from_millis(100);

/// The thread's values.
pub(crate) struct Motor {
    client: Client,
    shared: Arc<Shared>,
    /// By group.
    held: Vec<Option<Held>>,
    requests: Receiver<Request>,
    timeout: Duration,
    /// Cycles between two states while no group is claimed.
    idle_cycles: u32,
    failures: RateLimit,
}

impl Motor {
    /// `timeout` is that of commands.
    pub(crate) fn new(
        client: Client,
        shared: Arc<Shared>,
        requests: Receiver<Request>,
        timeout: Duration,
        idle_cycles: u32,
    ) -> Self {
        let held = shared.groups.iter().map(|_| None).collect();
        let failures = RateLimit::new(1, Duration::from_secs(10));
        Self { client, shared, held, requests, timeout, idle_cycles, failures }
    }

    /// Runs until the bridge ends. Then it releases the groups, which stops active ones.
    pub(crate) fn run(mut self) {
        while !self.shared.ends() {
            let is_idle = self.held.iter().all(Option::is_none);
            let cycles = if is_idle { self.idle_cycles } else { 1 };
            let begun = Instant::now();
            match self.client.wait_cycles(cycles, WAIT) {
                Ok(state) => self.serve(state),
                Err(Error::Restarted) => self.restarted(),
                Err(error) => {
                    self.unreachable(&error);
                    // Some errors return immediately.
                    std::thread::sleep(WAIT.saturating_sub(begun.elapsed()).min(WAIT / 10));
                }
            }
            // One between two states: a flood of requests delays no setpoint.
            if let Ok(request) = self.requests.try_recv() {
                let answer = self.perform(request.group, request.operation);
                // A caller that has gone needs no answer.
                let _closed = request.answer.try_send(answer);
            }
        }
        for index in 0..self.held.len() {
            self.drop_claim(index);
        }
    }

    fn serve(&mut self, state: State) {
        for index in 0..self.held.len() {
            let Some(held) = &mut self.held[index] else { continue };
            let link = &self.shared.groups[index];
            if let Err(error) = held.serve(&state, link, self.timeout) {
                log::warn!("group {}: the claim has ended: {error}", link.group.name);
                self.drop_claim(index);
            }
        }
        self.shared.latest.offer(state.clone());
        let robot = Arc::clone(&self.shared.robot);
        self.report(Report::State(Snapshot { state, robot }));
    }

    fn restarted(&mut self) {
        log::warn!("motord was restarted: every claim has ended");
        for index in 0..self.held.len() {
            self.drop_claim(index);
        }
        if !is_same(&self.shared.robot, &self.client.description()) {
            self.shared
                .fail("motord was restarted with another configuration: start the bridge again".to_owned());
        }
    }

    fn unreachable(&mut self, error: &Error) {
        if let Some(_suppressed) = self.failures.permit(Instant::now()) {
            log::warn!("{error}");
        }
        self.report(Report::Down(error.to_string()));
    }

    fn report(&self, report: Report) {
        self.shared.page.offer(report.clone());
        self.shared.report.offer(report);
    }

    /// Closes the gate before the claim is released: no command outlives it.
    fn drop_claim(&mut self, index: usize) {
        self.shared.groups[index].gate.close();
        self.held[index] = None;
    }

    fn perform(&mut self, index: usize, operation: Operation) -> Answer {
        let link = Arc::clone(&self.shared.groups[index]);
        let name = &link.group.name;
        let answer = match operation {
            Operation::Claim => self.claim(index, &link),
            Operation::Release => self.release(index, name),
            Operation::Enable => match &mut self.held[index] {
                Some(held) => held.enable(&link, self.timeout),
                None => Err(format!("the bridge does not hold group {name}: call claim first")),
            },
            Operation::Disable => {
                let disabled = match &mut self.held[index] {
                    Some(held) => held.disable(&link),
                    None => self.client.disable(name),
                };
                disabled
                    .map(|()| format!("group {name} is damped, then stopped"))
                    .map_err(|error| error.to_string())
            }
            Operation::Reset => {
                let reset = match &mut self.held[index] {
                    Some(held) => held.reset(&link),
                    None => self.client.reset(name),
                };
                reset
                    .map(|()| format!("group {name} has no latched cause"))
                    .map_err(|error| error.to_string())
            }
        };
        match &answer {
            Ok(done) => log::info!("{operation:?}: {done}"),
            Err(error) => log::warn!("{operation:?} of group {name} refused: {error}"),
        }
        answer
    }

    fn claim(&mut self, index: usize, link: &GroupLink) -> Answer {
        let name = &link.group.name;
        if self.held[index].is_some() {
            return Err(format!("the bridge holds group {name} already: release it first"));
        }
        let claim = self.client.claim(name).map_err(|error| error.to_string())?;
        // A command that arrived under an earlier claim has its number.
        self.held[index] = Some(Held::new(claim, link.gate.open()));
        Ok(format!("the bridge holds group {name}; the first writer with a valid command controls it"))
    }

    fn release(&mut self, index: usize, name: &str) -> Answer {
        self.shared.groups[index].gate.close();
        let held = self.held[index].take();
        let held = held.ok_or_else(|| format!("the bridge does not hold group {name}"))?;
        held.release().map_err(|error| error.to_string())?;
        Ok(format!("group {name} is released"))
    }
}

/// Returns `true` if both are the same robot, of two runs of the daemon.
fn is_same(before: &RobotDescription, after: &RobotDescription) -> bool {
    let of_run = RobotDescription { pid: before.pid, boot_id: before.boot_id, ..after.clone() };
    of_run == *before
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn restart_with_other_limits_is_another_robot() {
        let before = RobotDescription { boot_id: 1, pid: 1, ..RobotDescription::default() };
        let again = RobotDescription { boot_id: 2, pid: 2, ..before.clone() };
        assert!(is_same(&before, &again));
        let slower = RobotDescription { rate_hz: 500.0, ..again };
        assert!(!is_same(&before, &slower));
    }
}
