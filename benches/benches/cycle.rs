//! A whole cycle of an active robot, on virtual time: the cost of a cycle on the host, without the
//! wait for the wire.
//!
//! The simulated motors take most of the time, and a real robot has none. Therefore the time inside
//! the buses is measured separately: `host` excludes it, `with simulator` includes it. Each call
//! into a bus costs one reading of the clock, some 30 ns, which `host` includes.

mod robots;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use motord_bus::{Bus, Frame, Inbox, Instant, Readiness, Sent};
use motord_core::cycle::{LocalClient, Tick, assemble};
use motord_harness::robot::Robot;
use motord_shared::{JointSetpoint, Phase};
use motord_simulator::SharedBus;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A bus, and the time spent in it, ns.
struct Metered {
    bus: SharedBus,
    spent_ns: Arc<AtomicU64>,
}

impl Metered {
    fn meter<T>(spent_ns: &AtomicU64, call: impl FnOnce() -> T) -> T {
        let begun = std::time::Instant::now();
        let result = call();
        spent_ns.fetch_add(begun.elapsed().as_nanos() as u64, Ordering::Relaxed);
        result
    }
}

impl Bus for Metered {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        Self::meter(&self.spent_ns, || self.bus.send(now, frames))
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        Self::meter(&self.spent_ns, || self.bus.receive(now, inbox));
    }

    fn readiness(&self) -> Readiness<'_> {
        Self::meter(&self.spent_ns, || self.bus.readiness())
    }
}

/// The duration of a cycle.
struct Cost {
    all: Duration,
    in_buses: Duration,
}

/// An active robot whose owner sends a setpoint in every cycle.
struct Running {
    robot: Robot,
    tick: Tick,
    joints: Vec<JointSetpoint>,
    spent_ns: Arc<AtomicU64>,
}

impl Running {
    fn new(motors: usize) -> Self {
        let mut robot = Robot::new(robots::settings(motors), 1);
        let spent_ns = Arc::default();
        let metered = |bus: &SharedBus| Metered { bus: bus.clone(), spent_ns: Arc::clone(&spent_ns) };
        let buses = robot.buses.iter().map(|bus| Box::new(metered(bus.bus())) as Box<dyn Bus>).collect();
        let (cycle, ends) = assemble(&robot.settings, buses, robot.clock.clone(), 7);
        (robot.cycle, robot.client) = (cycle, LocalClient::new(ends));
        let joints = robot.activate();
        let state = robot.state();
        let at = Instant::from_nanos(state.tick_ns) + robot.settings.cycle.period;
        Self { tick: Tick { number: state.cycle + 1, at }, robot, joints, spent_ns }
    }

    fn cycle(&mut self) -> Cost {
        self.robot.send(&self.joints);
        self.spent_ns.store(0, Ordering::Relaxed);
        let begun = std::time::Instant::now();
        self.tick = self.robot.cycle.run(self.tick);
        let all = begun.elapsed();
        let in_buses = Duration::from_nanos(self.spent_ns.load(Ordering::Relaxed));
        while self.robot.client.record().is_some() {}
        while self.robot.client.event().is_some() {}
        Cost { all, in_buses }
    }

    fn cycles(&mut self, count: u64, share: impl Fn(Cost) -> Duration) -> Duration {
        let spent = (0..count).map(|_| share(self.cycle())).sum();
        assert_eq!(self.robot.phase(), Phase::Active, "{:?}", self.robot.cause());
        spent
    }
}

fn cycle_of_an_active_robot(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("cycle");
    group.sample_size(20).warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(2));
    for motors in [1, 4, 12, 32, 64] {
        let mut running = Running::new(motors);
        group.bench_function(BenchmarkId::new("host", motors), |bencher| {
            bencher.iter_custom(|count| running.cycles(count, |cost| cost.all - cost.in_buses));
        });
        group.bench_function(BenchmarkId::new("with simulator", motors), |bencher| {
            bencher.iter_custom(|count| running.cycles(count, |cost| cost.all));
        });
    }
    group.finish();
}

criterion_group!(benches, cycle_of_an_active_robot);
criterion_main!(benches);
