//! A controller on the other computer, whose setpoints a watcher on the robot finds again.

use crate::network::{Network, UNPOISONED};
use crate::watcher::{Seen, Watcher};
use motord_client::{Client, Error, Phase, Refusal};
use motord_ports::clock;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// When the network is cut, from the beginning.
const CUT_AFTER: Duration = Duration::from_secs(1);
/// Longest time for something that takes milliseconds on an idle machine.
const LONGEST: Duration = Duration::from_secs(20);

/// A robot, its mirror, and how often the controller sends.
pub(crate) struct Drive {
    robot: (String, String),
    other: (String, String),
    hz: f64,
    seconds: f64,
}

impl Drive {
    pub(crate) fn new(robot: &str, other: &str, hz: f64, seconds: f64) -> Self {
        let split = |text: &str| {
            let (runtime, instance) = text.rsplit_once('/').expect("RUNTIME/INSTANCE");
            (runtime.to_owned(), instance.to_owned())
        };
        Self { robot: split(robot), other: split(other), hz, seconds }
    }

    /// Drives for some seconds; with `cut`, the network is cut for so long after a second. Returns
    /// JSON.
    pub(crate) fn drive(&self, cut: Option<Duration>, network: &Arc<Network>) -> String {
        let watcher = self.watch();
        let outcome = self.control(cut, network, &watcher.seen);
        // The robot may stop after the controller's end.
        std::thread::sleep(Duration::from_millis(500));
        watcher.end(&outcome)
    }

    /// Watches the robot.
    pub(crate) fn watch(&self) -> Watcher {
        Watcher::start(Client::connect_in(Path::new(&self.robot.0), &self.robot.1).expect("a robot"))
    }

    /// Returns how the controller ended.
    fn control(&self, cut: Option<Duration>, network: &Network, seen: &Seen) -> String {
        match self.try_control(cut, network, seen) {
            Ok(()) => "done".to_owned(),
            Err(error) => error.to_string(),
        }
    }

    fn try_control(&self, cut: Option<Duration>, network: &Network, seen: &Seen) -> Result<(), Error> {
        let client = self.connect()?;
        // It goes on where others would give up: the robot must stop by itself.
        client.set_silence(LONGEST);
        let group = client.description().groups[0].name.clone();
        client.reset(&group)?;
        let mut claim = client.claim(&group)?;
        let period = Duration::from_secs_f64(1.0 / self.hz);
        claim.set_horizon(period.mul_f64(1.25))?;
        claim.hold(&client.wait(LONGEST)?, 20.0, 1.0)?;
        commit(&mut claim, seen)?;
        start(&client, &mut claim, seen, period)?;
        let begun = Instant::now();
        let (mut next, mut is_cut) = (begun, false);
        while begun.elapsed().as_secs_f64() < self.seconds {
            if let Some(cut) = cut.filter(|_| !is_cut && begun.elapsed() >= CUT_AFTER) {
                network.cut(cut);
                is_cut = true;
            }
            commit(&mut claim, seen)?;
            next += period;
            std::thread::sleep(next.saturating_duration_since(Instant::now()));
        }
        claim.disable()
    }

    fn connect(&self) -> Result<Client, Error> {
        let begun = Instant::now();
        loop {
            match Client::connect_in(Path::new(&self.other.0), &self.other.1) {
                Err(error) if error.is_transient() && begun.elapsed() < LONGEST => {
                    std::thread::sleep(Duration::from_millis(50));
                }
                other => return other,
            }
        }
    }
}

/// Sends the setpoints, and notes when.
fn commit(claim: &mut motord_client::Claim, seen: &Seen) -> Result<(), Error> {
    seen.sent.lock().expect(UNPOISONED).push(clock::now_ns());
    claim.commit()
}

/// Enables the group while setpoints go on.
fn start(
    client: &Client,
    claim: &mut motord_client::Claim,
    seen: &Seen,
    period: Duration,
) -> Result<(), Error> {
    let begun = Instant::now();
    let mut is_requested = false;
    loop {
        commit(claim, seen)?;
        std::thread::sleep(period);
        let group = client.newest()?.and_then(|state| state.group(claim.index()));
        if group.is_some_and(|group| group.phase == Some(Phase::Active)) {
            return Ok(());
        }
        if !is_requested && begun.elapsed() > 4 * period {
            is_requested = match client.enable(claim.group()) {
                // It has overtaken the first setpoints.
                Err(Error::Refused { refusal: Refusal::NoSetpoint, .. }) => false,
                other => other.map(|()| true)?,
            };
        }
        if begun.elapsed() > LONGEST {
            return Err(Error::Timeout { waited: LONGEST });
        }
    }
}
