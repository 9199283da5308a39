//! What is left to do when the cycle itself failed: a panic in it must not leave the motors with their last command.

use super::channel::BusChannel;
use crate::clock::Clock;
use crate::drive::last_frames;
use crate::settings::Settings;
use motord_bus::{Duration, Frame, Inbox};

/// Time from one round of frames to the next.
const ROUND: Duration = Duration::from_millis(10);
/// Rounds of stop commands at the end.
const STOPS: u32 = 3;

/// Ready-made frames, by bus.
pub(super) struct Will {
    damp: Duration,
    frames: Vec<BusFrames>,
}

#[derive(Default)]
struct BusFrames {
    damp: Vec<Frame>,
    stop: Vec<Frame>,
}

impl Will {
    pub(super) fn new(settings: &Settings) -> Self {
        let mut frames: Vec<BusFrames> = settings.buses.iter().map(|_| BusFrames::default()).collect();
        for motor in &settings.motors {
            if let Some((damp, stop)) = last_frames(motor) {
                frames[motor.bus].damp.push(damp);
                frames[motor.bus].stop.push(stop);
            }
        }
        Self { damp: settings.safety.damp, frames }
    }

    /// Damps every motor for as long as a stop may last, then stops it. Trusts nothing of the cycle but its buses.
    pub(super) fn carry_out(&self, channels: &mut [BusChannel], clock: &mut impl Clock) {
        let mut at = clock.now();
        let end = at + self.damp;
        let mut stops = STOPS;
        let mut unread = Inbox::new();
        while stops > 0 {
            let damping = at < end;
            stops -= u32::from(!damping);
            for (channel, frames) in channels.iter_mut().zip(&self.frames) {
                channel.send_unattended(at, if damping { &frames.damp } else { &frames.stop }, &mut unread);
            }
            at = at + ROUND;
            clock.sleep_until(at);
        }
    }
}
