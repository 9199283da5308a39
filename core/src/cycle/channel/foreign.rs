//! Frames with the command id of a motor that this program did not send: a bus does not receive its
//! own frames.

use crate::control::ForeignFrames;
use crate::stopper::BusFrames;
use motord_bus::{Frame, FrameId, IdFilter};
use motord_settings::settings::Settings;

/// Counts them by motor, from one read to the next.
pub(crate) struct ForeignCommands {
    /// The ids of the commands to a motor, one of them, the motor, and its counts.
    commands: Vec<(IdFilter, FrameId, usize, ForeignFrames)>,
    /// Frames of the dead man's switch and of `safe-stop` for this configuration. They can arrive
    /// after this process was frozen.
    safe: BusFrames,
    /// The frames of the last batches, the latest first: an adapter may return them. Empty on a
    /// line.
    sent: Vec<Vec<Frame>>,
    is_any: bool,
}

/// Number of batches whose echoes are recognised: those of at least one cycle, which sends commands
/// and at most one batch of questions.
const BATCHES: usize = 4;

impl ForeignCommands {
    /// Counts on the CAN bus with this index. Allocates; nothing after it does.
    pub(super) fn new(settings: &Settings, bus: usize) -> Self {
        let motors = settings.motors.iter().enumerate().filter(|(_, motor)| motor.bus == bus);
        let commands = motors.flat_map(|(motor, settings)| {
            let id = settings.command_id();
            settings.addresses().commands.filters().map(move |ids| (ids, id, motor, ForeignFrames::default()))
        });
        Self {
            commands: commands.collect(),
            safe: BusFrames::of(settings, bus),
            sent: Vec::new(),
            is_any: false,
        }
    }

    /// Counts nothing: no other sender is visible on a line.
    pub(super) fn none() -> Self {
        Self { commands: Vec::new(), safe: BusFrames::default(), sent: Vec::new(), is_any: false }
    }

    /// Prepares for batches in buffers like `frames`. Allocates.
    pub(super) fn expect_batches(&mut self, frames: &[Frame]) {
        let batches = if self.commands.is_empty() { 0 } else { BATCHES };
        self.sent = vec![frames.to_vec(); batches];
    }

    /// Keeps the buffer of a batch that was sent, and replaces it by that of an old one. Constant
    /// time.
    #[inline]
    pub(super) fn keep_batch(&mut self, frames: &mut Vec<Frame>) {
        if let Some(oldest) = self.sent.last_mut() {
            core::mem::swap(oldest, frames);
            self.sent.rotate_right(1);
        }
    }

    /// Counts `frame`, which no motor sends, if it commands one and is no echo. Bounded by the
    /// motors of the bus.
    #[cold]
    pub(super) fn note(&mut self, frame: &Frame) {
        let Self { commands, safe, sent, is_any } = self;
        let Some((.., frames)) = commands.iter_mut().find(|(ids, ..)| ids.matches(frame.id())) else {
            return;
        };
        if sent.iter().any(|batch| batch.contains(frame)) {
            return;
        }
        let count = if safe.contains(frame) { &mut frames.safe } else { &mut frames.commands };
        *count = count.wrapping_add(1);
        *is_any = true;
    }

    /// Returns whether a frame was counted since [`take`](Self::take).
    #[inline]
    pub(crate) const fn is_any(&self) -> bool {
        self.is_any
    }

    /// Passes on id, motor and counts of each motor with a count, and sets the counts to zero.
    /// Bounded by the motors of the bus.
    #[cold]
    pub(crate) fn take(&mut self, mut pass: impl FnMut(FrameId, usize, ForeignFrames)) {
        self.is_any = false;
        for (_, id, motor, frames) in self.commands.iter_mut().filter(|(.., frames)| frames.is_any()) {
            pass(*id, *motor, core::mem::take(frames));
        }
    }
}
