//! The other computer's side: the robot as an instance of motord, for all programs there.
//!
//! ```text
//!  controller ─ shared memory ─▶ mirror ── setpoint, imu, request ─▶ zenoh
//!             ◀─ shared memory ─        ◀── state, record ───────── zenoh
//!             ── stop socket ──▶ thread `stop` ── stop ───────────▶ zenoh
//! ```
//!
//! Clients see the ports of a daemon. Times of the robot become times of this computer's
//! `CLOCK_MONOTONIC`; their error is at most half of the shortest round trip.

mod imus;
mod instance;
mod records;
mod requests;
mod silence;
mod stop_socket;
mod wire;

use crate::config::{Mirror, Network};
use crate::network::{self, Keys, NetworkError};
use instance::{Mirrored, MirroredError};
use motord_shared::StateMessage;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use wire::{BEAT, Wire};

/// The reason why a mirror ends.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MirrorError {
    #[error(transparent)]
    Network(#[from] NetworkError),
    #[error(transparent)]
    Instance(#[from] MirroredError),
}

/// Mirrors the robot until `ends`.
pub(crate) fn run(mirror: &Mirror, network: &Network, ends: &Arc<AtomicBool>) -> Result<(), MirrorError> {
    let is_over = || ends.load(Ordering::Relaxed);
    let wire = Arc::new(Wire::new(Keys::of(&mirror.robot))?);
    let Some(session) = network::open(network, None, is_over)? else { return Ok(()) };
    wire.link(session)?;
    tracing::info!(robot = mirror.robot, "waits for the robot");
    std::thread::scope(|scope| {
        let _end = EndAll(ends);
        // One that others connect to has no link of its own to open again.
        if network.listen.is_empty() {
            scope.spawn(|| silence::watch(&wire, network, ends));
        }
        mirror_runs(&wire, mirror, ends)
    })
}

/// Ends all threads of the mirror when it is dropped, also by a panic.
struct EndAll<'a>(&'a AtomicBool);

impl Drop for EndAll<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Mirrors one run of the robot's daemon after the other until `ends`.
fn mirror_runs(wire: &Arc<Wire>, mirror: &Mirror, ends: &AtomicBool) -> Result<(), MirrorError> {
    while !ends.load(Ordering::Relaxed) {
        let Some(first) = await_robot(wire, ends)? else { continue };
        let Some(description) = requests::describe(wire, &first) else { continue };
        let mut served = Mirrored::open(&mirror.instance, wire, description)?;
        tracing::info!(robot = mirror.robot, instance = mirror.instance, "mirrors");
        served.run(&first, ends)?;
    }
    Ok(())
}

/// Sends frames until a state of the robot has arrived. `None` at the end.
fn await_robot(wire: &Wire, ends: &AtomicBool) -> Result<Option<Box<StateMessage>>, NetworkError> {
    // The second key reaches the robot from a mirror that may claim: it finds a slot also beside
    // many watchers.
    let senders = [wire.sender(wire.keys.beat())?, wire.sender(wire.keys.setpoint())?];
    while !ends.load(Ordering::Relaxed) {
        if let Some(state) = wire.newest() {
            return Ok(Some(state));
        }
        senders.iter().for_each(|sender| sender.put(wire.up().beat()));
        std::thread::park_timeout(BEAT);
    }
    Ok(None)
}
