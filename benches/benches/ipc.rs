//! A round trip controller -> daemon -> controller. A setpoint passes the client crate, shared
//! memory and the ipc thread to the cycle's side, and the answering state returns.
//!
//! A real cycle answers on its grid, once a millisecond, which would hide the cost of the path.
//! Therefore the cycle's side answers every setpoint within the ipc thread, which spins. The
//! controller sleeps on the cycle event (`event`) or polls (`spin`). Both threads need a dedicated
//! core.
//!
//! A second measurement is the time of the ipc thread for a state with observers: it publishes the
//! state and wakes each observer.

mod echo;

use criterion::{Bencher, BenchmarkId, Criterion, criterion_group, criterion_main};
use echo::{Daemon, INSTANCE, JOINTS, TIMEOUT};
use motord_client::{Claim, Client, Setpoint, State};
use motord_ports::{ClientPorts, DaemonPorts, Instance};
use motord_shared::StateMessage;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Time between states: observers have read the last one, and sleep.
const PERIOD: Duration = Duration::from_millis(1);

/// Sends a setpoint, and reads the state that answers it.
fn round_trip(
    client: &Client,
    claim: &mut Claim,
    take: fn(&Client, Duration) -> Result<State, motord_client::Error>,
) -> u64 {
    claim.send(&[Setpoint::damping(1.0); JOINTS]).expect("the daemon runs");
    let state = take(client, TIMEOUT).expect("the daemon answers");
    state.group(0).map_or(0, |group| group.sequence)
}

fn ipc(criterion: &mut Criterion) {
    let runtime = tempfile::tempdir().expect("the temporary directory is writable");
    let _daemon = Daemon::start(runtime.path(), Duration::ZERO);
    let client = Client::connect_in(runtime.path(), INSTANCE).expect("the daemon runs");
    client.set_silence(TIMEOUT);
    let mut claim = client.claim("all").expect("the group has no owner");
    let mut answered = 0;
    let mut group = criterion.benchmark_group("ipc round trip");
    for (name, take) in [("event", Client::wait as fn(&Client, _) -> _), ("spin", Client::spin)] {
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                answered += 1;
                assert_eq!(round_trip(&client, &mut claim, take), answered);
            });
        });
    }
    group.finish();
}

/// Reads every state until `stop`.
fn observe(instance: &Instance, stop: &AtomicBool) {
    let attachment = instance.attach().expect("the directory is ours").expect("the daemon is there");
    let ports = ClientPorts::open(attachment).expect("slots are free");
    while !stop.load(Ordering::Relaxed) {
        let seen = ports.published();
        ports.take_states(|_| ControlFlow::Continue(())).expect("slots are free");
        ports.sleep(seen, 10 * PERIOD).expect("the daemon's file is there");
    }
}

fn publish(bencher: &mut Bencher<'_>, ports: &DaemonPorts) {
    let state = StateMessage::default();
    bencher.iter_custom(|states| {
        let mut busy = Duration::ZERO;
        for _ in 0..states {
            thread::sleep(PERIOD);
            let begun = Instant::now();
            ports.publish(&state).expect("every connection is whole");
            ports.notify().expect("every connection is whole");
            ports.prepare();
            busy += begun.elapsed();
        }
        busy
    });
}

fn observers(criterion: &mut Criterion) {
    let runtime = tempfile::tempdir().expect("the temporary directory is writable");
    let instance = Instance::below(runtime.path(), INSTANCE).expect("the directory is ours");
    let lock = instance.lock().expect("no other process uses the directory");
    let ports = DaemonPorts::open(&lock).expect("no other process uses the directory");
    let mut group = criterion.benchmark_group("a state to observers");
    // Units are time of the daemon's thread: a state takes microseconds of each millisecond.
    group.sample_size(10).warm_up_time(10 * PERIOD).measurement_time(50 * PERIOD);
    for count in [0, 1, 7, 14, 28] {
        let stop = AtomicBool::new(false);
        thread::scope(|scope| {
            for _ in 0..count {
                scope.spawn(|| observe(&instance, &stop));
            }
            // The observers take their slots, one after the other.
            thread::sleep(Duration::from_millis(500));
            group.bench_function(BenchmarkId::from_parameter(count), |bencher| publish(bencher, &ports));
            stop.store(true, Ordering::Relaxed);
        });
    }
    group.finish();
}

criterion_group!(benches, ipc, observers);
criterion_main!(benches);
