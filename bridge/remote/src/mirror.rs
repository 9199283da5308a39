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
mod stop_socket;
mod wire;

use crate::config::{Mirror, Network};
use crate::network::{self, Keys, NetworkError};
use instance::{Mirrored, MirroredError};
use motord_shared::StateMessage;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;
use wire::{BEAT, Wire};
use zenoh::Wait;

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
    let Some(session) = network::open(network, None, is_over)? else { return Ok(()) };
    let wire = Arc::new(Wire::new(session, Keys::of(&mirror.robot))?);
    let (of_states, main): (_, Thread) = (Arc::clone(&wire), std::thread::current());
    let _states = wire
        .session
        .declare_subscriber(wire.keys.state())
        .callback(move |sample| {
            of_states.take_state(&sample.payload().to_bytes());
            main.unpark();
        })
        .wait()
        .map_err(NetworkError::of)?;
    tracing::info!(robot = mirror.robot, "waits for the robot");
    while !ends.load(Ordering::Relaxed) {
        let Some(first) = await_robot(&wire, ends)? else { continue };
        let Some(description) = requests::describe(&wire, &first) else { continue };
        let mut served = Mirrored::open(&mirror.instance, &wire, description)?;
        tracing::info!(robot = mirror.robot, instance = mirror.instance, "mirrors");
        served.run(&first, ends)?;
    }
    Ok(())
}

/// Sends frames until a state of the robot has arrived. `None` at the end.
fn await_robot(wire: &Wire, ends: &AtomicBool) -> Result<Option<Box<StateMessage>>, NetworkError> {
    let beats = wire.publisher(wire.keys.beat())?;
    while !ends.load(Ordering::Relaxed) {
        if let Some(state) = wire.newest() {
            return Ok(Some(state));
        }
        let _dropped = beats.put(wire.up().beat()).wait();
        std::thread::park_timeout(BEAT);
    }
    Ok(None)
}
