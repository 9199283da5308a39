//! Motors whose shafts an external plant moves.

#![expect(clippy::unwrap_used, reason = "a test that cannot set itself up has failed")]

mod common;

use common::{NEUTRAL, PUSH, START, STOP};
use motord_bus::{Bus, Duration, Frame, FrameId, Inbox, Instant};
use motord_simulator::{BusSettings, MotorSettings, Plant, PlantBus, Shaft, SharedBus, SimulatedBus, couple};
use std::sync::{Arc, Mutex};

/// The torque of [`PUSH`], N·m: code 2148 of 4095 on ±225 A · 0.125 N·m/A · 8 (MIT document 1.1).
const PUSHED: f64 = 2148.0 * 450.0 / 4095.0 - 225.0;
/// Inertia of the whole axle, kg·m².
const INERTIA: f64 = 0.05;
const MILLISECOND: Duration = Duration::from_millis(1);

/// The shafts of two motors on one stiff axle. Stores the torques that it receives.
#[derive(Default)]
struct Axle(Arc<Mutex<Vec<f64>>>);

impl Plant for Axle {
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]) {
        self.0.lock().unwrap().extend(torques);
        let velocity = shafts[0].velocity + torques.iter().sum::<f64>() / INERTIA * seconds;
        for shaft in shafts {
            *shaft = Shaft { velocity, position: shaft.position + velocity * seconds };
        }
    }
}

/// Two buses, each with a motor of id 1 on the axle.
struct Bench {
    buses: Vec<PlantBus>,
    ends: Vec<SharedBus>,
    torques: Arc<Mutex<Vec<f64>>>,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        let torques = Arc::default();
        let ends = Vec::from(["left", "right"].map(|name| {
            let motor =
                MotorSettings { name: name.into(), initial_position: 0.5, ..MotorSettings::default() };
            SharedBus::new(SimulatedBus::new(BusSettings::default(), vec![motor], 7))
        }));
        let buses = couple(&ends, Axle(Arc::clone(&torques)));
        Self { buses, ends, torques, now: Instant::from_nanos(1_000_100_000) }
    }

    fn send(&mut self, bus: usize, bytes: [u8; 8]) {
        let frame = Frame::classic(FrameId::new(1).unwrap(), bytes);
        assert_eq!(self.buses[bus].send(self.now, &[frame]).accepted, 1);
    }

    /// Lets time pass, and reads every bus after each `interval`.
    fn pass(&mut self, time: Duration, interval: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.now = end.min(self.now + interval);
            let mut inbox = Inbox::new();
            self.buses.iter_mut().for_each(|bus| bus.receive(self.now, &mut inbox));
        }
    }

    /// Returns position and velocity of the motors, by bus.
    fn shafts(&self) -> Vec<[f64; 2]> {
        let shaft = |bus: &SharedBus| {
            let bus = bus.lock();
            [bus.motors()[0].position(), bus.motors()[0].velocity()]
        };
        self.ends.iter().map(shaft).collect()
    }

    /// Lets the left motor push for 10 ms.
    fn push(&mut self, interval: Duration) {
        for bytes in [NEUTRAL, START, PUSH] {
            self.send(0, bytes);
            self.pass(MILLISECOND, interval);
        }
        self.pass(9 * MILLISECOND, interval);
        self.send(0, STOP);
        self.pass(MILLISECOND, interval);
    }
}

#[test]
fn shaft_turned_by_another_bus_moves_motor() {
    let mut bench = Bench::new();
    assert_eq!(bench.shafts(), [[0.5, 0.0]; 2]);
    bench.push(MILLISECOND);
    let [left, right] = bench.shafts()[..] else { panic!("two motors") };
    assert_eq!(left, right, "the axle is stiff");
    // The stop is on the wire as long as the push, so the push lasts 10 ms, on the grid of the
    // drive's 50 µs.
    let expected = PUSHED * 0.010 / INERTIA;
    assert!(
        (left[1] - expected).abs() <= PUSHED * 50e-6 / INERTIA + 0.02,
        "{} rad/s, not {expected}",
        left[1]
    );
}

#[test]
fn plant_receives_same_torques_however_polled() {
    let [seldom, often] = [MILLISECOND, Duration::from_micros(37)].map(|interval| {
        let mut bench = Bench::new();
        bench.push(interval);
        let torques = bench.torques.lock().unwrap().clone();
        assert_eq!(torques.len(), 2 * 13 * 4, "two torques every 250 µs of 13 ms");
        (torques, bench.shafts())
    });
    assert_eq!(seldom, often);
}

#[test]
fn a_load_acts_through_the_plant() {
    let mut bench = Bench::new();
    bench.pass(MILLISECOND, MILLISECOND);
    bench.ends[1].lock().inject(bench.now, &"right load 2".parse().unwrap()).unwrap();
    bench.pass(MILLISECOND, MILLISECOND);
    let torques = bench.torques.lock().unwrap().clone();
    let last = torques.last_chunk::<2>().unwrap();
    assert!(last[0] == 0.0 && (last[1] - 2.0).abs() < 1e-9, "{last:?}");
}

#[test]
#[should_panic(expected = "the shaft of joint")]
fn diverging_plant_is_reported_by_motor() {
    struct Diverged;
    impl Plant for Diverged {
        fn step(&mut self, _: &[f64], _: f64, shafts: &mut [Shaft]) {
            shafts[0].position = f64::NAN;
        }
    }
    let motor = MotorSettings { name: "joint".into(), ..MotorSettings::default() };
    let bus = SharedBus::new(SimulatedBus::new(BusSettings::default(), vec![motor], 7));
    let mut buses = couple(&[bus], Diverged);
    let mut inbox = Inbox::new();
    for time in [0, 1_000_000] {
        buses[0].receive(Instant::from_nanos(time), &mut inbox);
    }
}
