//! Between the ipc thread and telemetry: questions and their answers, and the ipc thread's
//! measurements. Answered requests go to the log.

use super::programs::Programs;
use super::recordings::{Recorder, Recordings, recordings};
use motord_bus::{Duration, Instant};
use motord_shared::{AdminReply, AdminRequest, StateMessage};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::mpsc::{Receiver, Sender, channel};
use triple_buffer::TripleBuffer;

/// One for each cycle, of two seconds at 1 kHz.
const DELIVERIES: usize = 2048;
/// A state is kept for the metrics so often.
const STATE_PERIOD: Duration = Duration::from_millis(500);

/// The ipc thread's way to ask for telemetry without waiting for it.
pub struct Questions {
    /// The processes that ask, for the log.
    pub programs: Programs,
    /// Takes the requests that were answered, for the log.
    pub answered: Answered,
    /// Takes what recorders need.
    pub recorder: Recorder,
    questions: Sender<(u32, AdminRequest)>,
    answers: Receiver<(u32, String)>,
    deliveries: Producer<u64>,
    states: triple_buffer::Input<StateMessage>,
    next_state: Instant,
}

impl Questions {
    /// Passes `request` to telemetry; the answer has the same ticket. Without a telemetry thread
    /// there is none. The caller bounds the number of open questions.
    pub fn ask(&self, ticket: u32, request: AdminRequest) {
        let _lost = self.questions.send((ticket, request));
    }

    /// The next answer, if there is one.
    #[must_use]
    pub fn answer(&self) -> Option<(u32, String)> {
        self.answers.try_recv().ok()
    }

    /// All clients that wait for `state` were woken by `now`. Returns whether telemetry could take
    /// the measurement. Neither allocates nor blocks.
    #[must_use]
    pub fn delivered(&mut self, state: &StateMessage, now: Instant) -> bool {
        if now >= self.next_state {
            self.next_state = now + STATE_PERIOD;
            self.states.write(*state);
        }
        self.deliveries.push(now.as_nanos().saturating_sub(state.publish_ns)).is_ok()
    }
}

/// The telemetry thread's end of the questions.
pub struct Answers {
    pub(super) asked: Consumer<Asked>,
    pub(super) programs: Programs,
    pub(super) questions: Receiver<(u32, AdminRequest)>,
    pub(super) answers: Sender<(u32, String)>,
    /// How long each states took from their publication to the clients, ns.
    pub(super) deliveries: Consumer<u64>,
    pub(super) recordings: Recordings,
    /// A recent state.
    pub(super) states: triple_buffer::Output<StateMessage>,
}

/// Both ends of the questions.
#[must_use]
pub fn questions() -> (Questions, Answers) {
    let (question_sender, question_receiver) = channel();
    let (answer_sender, answer_receiver) = channel();
    let (answered, asked) = asked();
    let (delivery_producer, delivery_consumer) = RingBuffer::new(DELIVERIES);
    let (state_input, state_output) = TripleBuffer::new(&StateMessage::default()).split();
    let (recorder, recordings) = recordings();
    let programs = Programs::default();
    let answers = Answers {
        asked,
        programs: programs.clone(),
        questions: question_receiver,
        answers: answer_sender,
        deliveries: delivery_consumer,
        recordings,
        states: state_output,
    };
    let questions = Questions {
        programs,
        answered,
        recorder,
        questions: question_sender,
        answers: answer_receiver,
        deliveries: delivery_producer,
        states: state_input,
        next_state: Instant::ZERO,
    };
    (questions, answers)
}

/// Most requests on their way. Further ones are not logged, so that a process that sends requests
/// without pause fills neither memory nor log.
const ASKED_MAX: usize = 64;

/// A request that was answered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Asked {
    /// The newest cycle when it was answered.
    pub(super) cycle: u64,
    pub(super) request: AdminRequest,
    pub(super) reply: AdminReply,
}

/// The ipc thread's end.
pub struct Answered(Producer<Asked>);

impl Answered {
    /// Keeps a request that was answered in `cycle` for the log. Neither allocates nor blocks.
    pub fn note(&mut self, cycle: u64, request: &AdminRequest, reply: AdminReply) {
        let _not_logged = self.0.push(Asked { cycle, request: *request, reply });
    }
}

/// Both ends.
pub(super) fn asked() -> (Answered, Consumer<Asked>) {
    let (producer, consumer) = RingBuffer::new(ASKED_MAX);
    (Answered(producer), consumer)
}
