//! A round trip controller -> daemon -> controller: a setpoint through the client crate, shared memory and the ipc
//! thread to the cycle's side, and the state that answers it all the way back.
//!
//! A real cycle answers on its grid, once a millisecond, and would hide what the way costs. So the cycle's side answers
//! every setpoint at once here, within the ipc thread, which spins. The controller sleeps on the cycle event
//! (`event`) or keeps looking (`spin`). Both threads need a core of their own.

mod echo;

use criterion::{Criterion, criterion_group, criterion_main};
use echo::{Daemon, INSTANCE, JOINTS, PATIENCE};
use motord_client::{Claim, Client, Setpoint, State};
use std::time::Duration;

/// Sends a setpoint, and takes the state that answers it.
fn round_trip(
    client: &Client,
    claim: &mut Claim,
    take: fn(&Client, Duration) -> Result<State, motord_client::Error>,
) -> u64 {
    claim.send(&[Setpoint::damping(1.0); JOINTS]).expect("the daemon runs");
    let state = take(client, PATIENCE).expect("the daemon answers");
    state.group(0).map_or(0, |group| group.sequence)
}

fn ipc(criterion: &mut Criterion) {
    let runtime = tempfile::tempdir().expect("the temporary directory is writable");
    let _daemon = Daemon::start(runtime.path(), Duration::ZERO);
    let client = Client::connect_in(runtime.path(), INSTANCE).expect("the daemon runs");
    client.set_silence(PATIENCE);
    let mut claim = client.claim("all").expect("nobody owns the group");
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

criterion_group!(benches, ipc);
criterion_main!(benches);
