//! The decisions of one cycle, for an active robot of 12 motors: read a setpoint, create the
//! commands, process the answers, write the states. No buses, no threads.

use criterion::{Criterion, criterion_group, criterion_main};
use motord_bus::{Duration, Instant};
use motord_core::control::{Control, Wake};
use motord_harness::robot;
use motord_protocol::Faults;
use motord_protocol::drive::{Measured, Reported, Status};
use motord_shared::{AdminRequest, JointSetpoint, Operation, Phase, SetpointMessage, StateMessage};
use std::hint::black_box;

/// Limit on the cycles of a start.
const START_CYCLES: u32 = 1000;

/// Twelve motors at rest, and an owner that holds them.
struct Robot {
    control: Control,
    message: SetpointMessage,
    state: StateMessage,
    cycle: u64,
}

impl Robot {
    fn active() -> Self {
        let control = Control::new(&robot::quadruped(), 7);
        let message = SetpointMessage { joint_count: 12, ..Default::default() };
        let mut robot = Self { control, message, state: StateMessage::default(), cycle: 0 };
        robot.step();
        robot.message.lease = robot.operate(Operation::Claim);
        let hold = JointSetpoint { kp: 40.0, kd: 1.0, ..Default::default() };
        robot.message.joints[..12].fill(hold);
        (0..10).for_each(|_| robot.step());
        robot.operate(Operation::Enable);
        (0..START_CYCLES).for_each(|_| robot.step());
        assert_eq!(robot.state.groups[0].phase, Phase::Active.code(), "{:?}", robot.state.groups[0]);
        robot
    }

    /// Returns the lease of a claim.
    fn operate(&mut self, operation: Operation) -> u64 {
        let request =
            AdminRequest { operation: operation.code(), lease: self.message.lease, ..Default::default() };
        let now = self.now();
        self.control.request(1, &request, now).map_or(0, |reply| {
            assert_eq!(reply.refusal, 0, "{operation:?}");
            reply.lease
        })
    }

    fn now(&self) -> Instant {
        Instant::from_nanos(1_000_000_000) + Duration::from_millis(self.cycle)
    }

    fn step(&mut self) {
        self.cycle += 1;
        let (cycle, now) = (self.cycle, self.now());
        (self.message.sequence, self.message.time_ns) = (cycle, now.as_nanos());
        self.control.offer(&self.message, now);
        black_box(self.control.decide(Wake { cycle, scheduled: now, begun: now, ..Wake::default() }));
        let latency = Duration::from_micros(300);
        for motor in 0..12 {
            let still = Measured::new(0.0, 0.0, 0.0, None);
            self.control.receive_state(motor, (still, latency, Status::default()), now + latency);
        }
        self.control.end_cycle();
        self.control.report_joints(&mut self.state.joints);
        let groups = self.state.groups.iter_mut();
        groups.zip(self.control.group_states()).for_each(|(group, state)| *group = state);
        for bus in 0..4 {
            if let Some((motor, _)) = self.control.question(bus) {
                self.control.receive(motor, &Reported::Fault(Faults::NONE), now + 2 * latency);
            }
        }
        self.control.clear_events();
    }
}

fn control(criterion: &mut Criterion) {
    let mut robot = Robot::active();
    criterion.bench_function("control/12 motors", |bencher| bencher.iter(|| robot.step()));
    assert_eq!(robot.state.groups[0].phase, Phase::Active.code(), "{:?}", robot.state.groups[0]);
}

criterion_group!(benches, control);
criterion_main!(benches);
