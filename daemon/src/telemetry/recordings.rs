//! Between the ipc thread and telemetry: what recorders need in memory. It exists only while a
//! recorder is connected: the telemetry thread makes and frees it.

use motord_core::cycle::{Histories, History};
use motord_ports::{RecordSender, Recorders, ServiceError};
use motord_shared::StateMessage;
use std::sync::mpsc::{Receiver, Sender, channel};

/// The queue of the states, and the port of their records.
struct Recording {
    history: History,
    port: RecordSender,
}

/// The end of the ipc thread.
pub struct Recorder {
    begun: Receiver<Recording>,
    ended: Sender<Recording>,
    recording: Option<Recording>,
}

/// The end of the telemetry thread.
pub(super) struct Recordings {
    begun: Sender<Recording>,
    ended: Receiver<Recording>,
}

/// Both ends.
pub(super) fn recordings() -> (Recorder, Recordings) {
    let (begin, begun) = channel();
    let (end, ended) = channel();
    (Recorder { begun, ended: end, recording: None }, Recordings { begun: begin, ended })
}

impl Recorder {
    /// Passes every state since the last call, and the port for its record, to `send`. Ends the
    /// recording when none `is_recorded`.
    pub fn relay(&mut self, is_recorded: bool, mut send: impl FnMut(&RecordSender, &StateMessage)) {
        let Self { begun, ended, recording } = self;
        if recording.is_none() {
            *recording = begun.try_recv().ok();
        }
        if let Some(last) = recording.take_if(|_| !is_recorded) {
            let _telemetry_has_ended = ended.send(last);
        }
        if let Some(Recording { history, port }) = recording {
            history.take_all(|state| send(port, state));
        }
    }
}

impl Recordings {
    /// Begins a recording when a recorder has connected, and frees one that has ended.
    ///
    /// # Errors
    /// The reason why there is no port for records.
    pub(super) fn turn(
        &mut self,
        histories: &mut Histories,
        recorders: &Recorders,
    ) -> Result<(), ServiceError> {
        while self.ended.try_recv().is_ok() {}
        if !histories.is_free() || !recorders.are_connected() {
            return Ok(());
        }
        let port = recorders.open()?;
        if let Some(history) = histories.begin() {
            let _ipc_has_ended = self.begun.send(Recording { history, port });
        }
        Ok(())
    }
}
