//! A simulated serial line as the cycle sees a real one: one request at a time, and arrivals with the id of the motor that
//! was asked.

use motord_bus::{Bus, Content, Duration, Frame, FrameId, Inbox, Instant, Readiness, Refusal, Sent};
use motord_core::settings::{BusKind, Settings};
use motord_simulator::SharedBus;

/// A request that is older than this has no answer.
const PATIENCE: Duration = Duration::from_millis(2);

/// Makes the simulated bus with this index a serial line of the configuration.
pub fn make_line(settings: &mut Settings, bus: usize, every: u32) {
    let turnaround = Duration::from_micros(500);
    settings.buses[bus].kind = BusKind::Serial { device: "/dev/null".into(), baud: 921_600, turnaround };
    settings.buses[bus].every = every;
}

/// One line.
pub struct Line {
    bus: SharedBus,
    open: Option<(FrameId, Instant)>,
}

impl Line {
    pub fn new(bus: SharedBus) -> Self {
        Self { bus, open: None }
    }
}

impl Bus for Line {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        let Some(first) = frames.first() else { return Sent::all(0) };
        if self.open.is_some_and(|(_, sent)| now.since(sent) <= PATIENCE) {
            return Sent { accepted: 0, refusal: Some(Refusal::Full) };
        }
        let sent = self.bus.send(now, &frames[..1]);
        if sent.accepted == 1 {
            self.open = Some((first.id(), now));
        }
        let refusal = sent.refusal.or((frames.len() > 1).then_some(Refusal::Full));
        Sent { accepted: sent.accepted, refusal }
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        let mut arrived = Inbox::new();
        self.bus.receive(now, &mut arrived);
        inbox.lost += arrived.lost;
        for arrival in arrived.arrivals() {
            let content = match arrival.content {
                Content::Frame(frame) => match self.open.take() {
                    Some((motor, _)) => Frame::new(motor, frame.payload()).map(Content::Frame),
                    None => None,
                },
                other => Some(other),
            };
            if let Some(content) = content {
                inbox.push(motord_bus::Arrival { content, ..*arrival }).expect("the inbox is as large");
            }
        }
    }

    fn readiness(&self) -> Readiness<'_> {
        Readiness::Never
    }
}
