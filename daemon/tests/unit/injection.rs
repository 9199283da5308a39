//! Faults for the simulated buses of a running daemon.

use super::*;
use motord_bus::Refusal;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

fn settings(file: &str) -> Settings {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config").join(file);
    motord_configuration::load(&file).unwrap().settings
}

#[test]
fn configuration_with_real_bus_takes_no_faults() {
    assert!(Injectors::open(&settings("quadruped.toml")).is_none());
    assert!(Injectors::open(&settings("quadruped-simulated.toml")).is_some());
}

/// Runs `test` while another thread reads the first bus over and over. Returns the bus.
fn with_cycle(mut bus: Box<dyn Bus>, test: impl FnOnce()) -> Box<dyn Bus> {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let cycle = scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                bus.receive(clock::monotonic(), &mut Inbox::new());
                std::thread::sleep(TURN);
            }
            bus
        });
        test();
        over.store(true, Ordering::Relaxed);
        cycle.join().unwrap()
    })
}

#[test]
fn fault_reaches_bus_of_motor_and_refusal_returns() {
    let (mut buses, mut injectors) = Injectors::open(&settings("quadruped-simulated.toml")).unwrap();
    with_cycle(buses.swap_remove(0), || {
        assert_eq!(injectors.obey("fl-knee off"), Ok(()));
        assert_eq!(injectors.obey("fl-knee down"), Err(InjectError::NotForMotors.into()));
        assert_eq!(injectors.obey("front-left off"), Err(InjectError::NotForBuses.into()));
    });
    assert!(matches!(injectors.obey("rr-knee off"), Err(FaultLineError::Unanswered(_))));
    assert!(matches!(injectors.obey("rr-knee ok"), Err(FaultLineError::Unanswered(_))), "one waits already");
}

#[test]
fn late_outcome_is_not_taken_for_next_verb() {
    let (mut bus, mut injector) = Injector::of(&settings("quadruped-simulated.toml"), 0, 0);
    std::thread::scope(|scope| {
        let injects = scope.spawn(move || injector.inject("fl-knee off".parse().unwrap()));
        while bus.verbs.is_empty() {
            std::thread::sleep(TURN);
        }
        let earlier = ("fl-knee down".parse().unwrap(), Err(InjectError::NotForMotors));
        assert!(bus.outcomes.push(earlier).is_ok());
        while !injects.is_finished() {
            bus.receive(clock::monotonic(), &mut Inbox::new());
            std::thread::sleep(TURN);
        }
        assert_eq!(injects.join().unwrap(), Ok(()));
    });
}

#[test]
fn an_adapter_that_is_plugged_in_again_reports() {
    let (mut buses, mut injectors) = Injectors::open(&settings("quadruped-simulated.toml")).unwrap();
    let mut bus = with_cycle(buses.swap_remove(0), || injectors.obey("front-left gone").unwrap());
    assert_eq!(bus.send(clock::monotonic(), &[]).refusal, Some(Refusal::Gone));
    injectors.injectors[0].verbs.push("front-left ok".parse().unwrap()).unwrap();
    let mut inbox = Inbox::new();
    bus.receive(clock::monotonic(), &mut inbox);
    assert!(matches!(inbox.arrivals()[0].content, Content::Error(error) if error.state().is_some()));
    assert_eq!(bus.send(clock::monotonic(), &[]).refusal, None);
}
