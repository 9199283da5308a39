//! The thread that publishes. It waits for the daemon only, never for a viewer.

use crate::clock::wall_ns;
use crate::config::Foxglove;
use crate::foxglove::channels::Channels;
use crate::foxglove::server::{Newcomers, Server};
use crate::foxglove::thinning::Thinning;
use crate::rate_limit::RateLimit;
use crate::shared::Shared;
use motord_client::{Client, Error, RobotDescription, State};
use motord_mcap::{Event, Events, Level, Origin};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest wait for a state.
const WAIT: Duration = Duration::from_millis(200);
/// Interval at which the thread checks whether a viewer has connected.
const IDLE: Duration = Duration::from_millis(100);
/// Limit on events per second. Further ones are dropped, and counted.
const EVENTS_MAX: u32 = 200;
/// Interval at which the thread reads the computer's clock anew.
const CLOCK: Duration = Duration::from_secs(1);

/// The thread's values.
pub(crate) struct Publisher {
    client: Client,
    channels: Channels,
    server: Server,
    newcomers: Arc<Newcomers>,
    thinning: Thinning,
    events: Events,
    permits: RateLimit,
    downtimes: RateLimit,
    origin: Option<(Instant, Origin)>,
    /// Period of the latencies, and when the next are due.
    latencies: Option<(Duration, Instant)>,
}

impl Publisher {
    pub(crate) fn new(
        client: Client,
        channels: Channels,
        server: Server,
        newcomers: Arc<Newcomers>,
        settings: &Foxglove,
        robot: &RobotDescription,
    ) -> Self {
        let hz = settings.latencies_hz;
        Self {
            client,
            channels,
            server,
            newcomers,
            thinning: Thinning::new(settings, robot.rate_hz),
            events: Events::default(),
            permits: RateLimit::new(EVENTS_MAX, Duration::from_secs(1)),
            downtimes: RateLimit::new(1, Duration::from_secs(5)),
            origin: None,
            latencies: (hz > 0.0).then(|| (Duration::from_secs_f64(1.0 / hz), Instant::now())),
        }
    }

    /// Publishes until the bridge ends. Reads no state while no viewer is connected.
    pub(crate) fn run(mut self, shared: &Shared) {
        let cycles = self.thinning.cycles_between_states();
        while !shared.ends() {
            self.server.restart_if_closed();
            if self.server.viewers() == 0 {
                // The next viewer's first state has nothing before it.
                self.events = Events::default();
                std::thread::sleep(IDLE);
                continue;
            }
            for viewer in self.newcomers.take() {
                self.channels.send_description(viewer);
            }
            match self.client.wait_cycles(cycles, WAIT) {
                Ok(state) => self.publish(&state, &shared.robot),
                Err(error) => self.report(&error),
            }
            self.publish_latencies(&shared.robot);
        }
        self.server.stop();
    }

    fn publish(&mut self, state: &State, robot: &RobotDescription) {
        let unix_ns = self.origin(state).unix(state.tick_ns());
        let due = self.thinning.due(state.message());
        self.channels.send(|topic| due.contains(topic), state, robot, unix_ns);
        if due.joints {
            self.channels.send_joint_states(state, robot, unix_ns);
        }
        for event in self.events.of(state.message(), robot) {
            self.send_event(&event, unix_ns);
        }
    }

    fn send_event(&mut self, event: &Event, unix_ns: u64) {
        let Some(suppressed) = self.permits.permit(Instant::now()) else { return };
        if suppressed > 0 {
            let text = format!("{suppressed} events were not sent");
            self.channels
                .send_event(&Event { level: Level::Warning, subject: "bridge".to_owned(), text }, unix_ns);
        }
        self.channels.send_event(event, unix_ns);
    }

    fn report(&mut self, error: &Error) {
        self.events = Events::default();
        if self.downtimes.permit(Instant::now()).is_some() {
            let event = Event {
                level: Level::Error,
                subject: "motord".to_owned(),
                text: format!("is down: {error}"),
            };
            self.channels.send_event(&event, wall_ns());
        }
        // Some errors return immediately.
        std::thread::sleep(IDLE);
    }

    fn publish_latencies(&mut self, robot: &RobotDescription) {
        let Some((period, next)) = &mut self.latencies else { return };
        if Instant::now() < *next || !self.channels.wants_latencies() {
            return;
        }
        *next = Instant::now() + *period;
        if let Ok(telemetry) = self.client.telemetry() {
            self.channels.send_latencies(robot, &telemetry);
        }
    }

    /// Returns the Unix time of the zero of `CLOCK_MONOTONIC`, at most a second old.
    fn origin(&mut self, state: &State) -> Origin {
        match self.origin {
            Some((read, origin)) if read.elapsed() < CLOCK => origin,
            _ => {
                let age_ns = u64::try_from(state.age().as_nanos()).unwrap_or(u64::MAX);
                let monotonic_ns = state.publish_ns().saturating_add(age_ns);
                let origin = Origin { unix_ns: wall_ns().saturating_sub(monotonic_ns) };
                self.origin = Some((Instant::now(), origin));
                origin
            }
        }
    }
}
