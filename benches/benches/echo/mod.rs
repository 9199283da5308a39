//! A daemon without motors: its ipc thread spins, and an echo instead of the cycle answers every
//! setpoint after a given time.

use motord::ipc::{CycleEnd, IpcThread, Records, Schedule};
use motord::telemetry;
use motord_core::cycle::{self, Ends, REQUESTS_MAX};
use motord_ports::{DaemonPorts, Instance, InstanceLock, clock};
use motord_settings::settings::IpcMode;
use motord_shared::description::{GroupDescription, JointDescription, RobotDescription};
use motord_shared::{AdminReply, AdminRequest, Lease, SetpointMessage, StateMessage};
use rtrb::{Consumer, Producer, RingBuffer};
use std::cell::RefCell;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use triple_buffer::TripleBuffer;

pub(crate) const INSTANCE: &str = "bench";
pub(crate) const JOINTS: usize = 12;
const BOOT_ID: u64 = 7;
/// The first lease of the first group.
const LEASE: Lease = Lease::new(0, 1, 0).unwrap();
/// Longer than any stall, and than the pauses without states between two measurements.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(3600);

/// Replaces the cycle, and answers every setpoint with a state that contains its sequence.
struct Echo {
    /// Time from a setpoint to its answer.
    pause: Duration,
    /// The sequence of the newest setpoint, and the time of its answer.
    due: Option<(u64, Instant)>,
    setpoints: triple_buffer::Output<SetpointMessage>,
    states: triple_buffer::Input<StateMessage>,
    requests: Consumer<(u32, AdminRequest)>,
    answers: Producer<(u32, AdminReply)>,
}

impl Echo {
    fn new(pause: Duration) -> (Self, Ends) {
        let (setpoint_input, setpoints) = TripleBuffer::new(&SetpointMessage::default()).split();
        let (states, state_output) = TripleBuffer::new(&StateMessage::default()).split();
        let (request_producer, requests) = RingBuffer::new(REQUESTS_MAX);
        let (answers, answer_consumer) = RingBuffer::new(REQUESTS_MAX);
        let (_, unused) = cycle::link(1, 0);
        let ends = Ends {
            setpoints: vec![setpoint_input],
            states: state_output,
            requests: request_producer,
            answers: answer_consumer,
            ..unused
        };
        (Self { pause, due: None, setpoints, states, requests, answers }, ends)
    }

    fn turn(&mut self) {
        while let Ok((ticket, _)) = self.requests.pop() {
            let granted = AdminReply { lease: LEASE.raw(), ..Default::default() };
            self.answers.push((ticket, granted)).expect("there are as many answers as requests");
        }
        if self.setpoints.update() {
            self.due = Some((self.setpoints.output_buffer().sequence, Instant::now() + self.pause));
        }
        if let Some((sequence, _)) = self.due.take_if(|(_, at)| Instant::now() >= *at) {
            let state = self.states.input_buffer_mut();
            (state.boot_id, state.cycle, state.publish_ns) = (BOOT_ID, sequence, clock::now_ns());
            (state.joint_count, state.group_count) = (JOINTS as u32, 1);
            (state.groups[0].lease, state.groups[0].sequence) = (LEASE.raw(), sequence);
            self.states.publish();
        }
    }
}

/// The ipc thread of a daemon without motors, until it is dropped.
pub(crate) struct Daemon {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Daemon {
    /// Starts a daemon that answers each setpoint after `pause`.
    pub(crate) fn start(runtime: &Path, pause: Duration) -> Self {
        let lock = Instance::below(runtime, INSTANCE)
            .and_then(|instance| instance.lock())
            .expect("the directory is ours");
        let stop = Arc::new(AtomicBool::new(false));
        let (open, opened) = std::sync::mpsc::channel();
        let thread = std::thread::spawn({
            let stop = Arc::clone(&stop);
            move || {
                let (mut ipc, echo) = ipc_thread(&lock, pause);
                let echo = RefCell::new(echo);
                open.send(()).expect("the starting thread waits");
                ipc.run(|| {
                    echo.borrow_mut().turn();
                    stop.load(Ordering::Relaxed)
                });
            }
        });
        opened.recv().expect("the ipc thread starts");
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(matches!(ended, Some(Ok(()))), "the ipc thread panicked");
    }
}

fn ipc_thread(lock: &InstanceLock, pause: Duration) -> (IpcThread, Echo) {
    let ports = DaemonPorts::open(lock).expect("no other process uses the directory");
    let (echo, ends) = Echo::new(pause);
    let (end, _telemetry, _supply) = CycleEnd::split(ends);
    let (questions, _answers) = telemetry::questions();
    let robot = RobotDescription {
        pid: std::process::id(),
        boot_id: BOOT_ID,
        rate_hz: 1000.0,
        joints: vec![JointDescription::default(); JOINTS],
        groups: vec![GroupDescription { name: "all".into(), joints: (0..JOINTS).collect() }],
        ..Default::default()
    };
    let description = serde_json::to_string(&robot).expect("names and numbers are JSON");
    let schedule = Schedule::new(Duration::from_millis(1), Duration::ZERO, Duration::ZERO);
    let records = Records::new(Vec::new());
    (IpcThread::new(ports, (end, None), questions, description, IpcMode::Spin, schedule, records), echo)
}
