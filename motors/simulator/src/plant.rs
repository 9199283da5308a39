//! Motors whose shafts an external program moves: a physics engine, or a rigid body in a test.
//!
//! ```text
//!   cycle ──frames──▶ drives ──torques──▶ Plant ──positions, velocities──▶ drives ──frames──▶ cycle
//! ```
//!
//! Protocol, control law, torque limit, heat and faults remain those of the simulator's drives.
//! Only the mechanics after the output shaft are the plant's.

use crate::body::Shaft;
use crate::{SharedBus, body};
use motord_bus::{Bus, Frame, Inbox, Instant, Readiness, Sent};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Time from one step of a plant to the next, ns. Steps end on multiples of it.
const STEP_NS: u64 = 250_000;
const _: () =
    assert!(STEP_NS.is_multiple_of(body::STEP_NS), "a step of the plant is whole steps of the drives");

/// The mechanics after the output shafts of all motors, which may couple them, as a rigid body
/// does.
pub trait Plant: Send {
    /// Moves every shaft by `seconds`, which is 0.00025 in every call.
    ///
    /// `torques` are means over the step, N·m, of the sum of drive and load. `shafts` hold the
    /// state at the beginning of the step; the plant replaces it by the state at the end. Both are
    /// in the order of the buses, and of the motors of each bus.
    ///
    /// The plant contains all mechanics: the inertias and the friction in a motor's settings do not
    /// act on the shaft. The plant must add the rotor's inertia times the square of the gear ratio.
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]);
}

/// Lets `plant` move the motors of `buses`. Returns the buses that the cycle must use from now on,
/// in the same order. The clones of `buses` remain usable to inject faults and to read the true
/// state.
///
/// A send or a receive first brings all buses and the plant to the time of the call, in steps of
/// 250 µs. The same sequence of calls therefore gives the same run, whichever clock they follow.
/// All time between two calls is simulated. Between two steps a shaft turns at the velocity of the
/// last step. The first shafts are the motors' initial positions, at rest.
///
/// # Panics
///
/// A call to a bus panics when the plant has computed a position or a velocity that is not finite.
#[must_use]
pub fn couple(buses: &[SharedBus], plant: impl Plant + 'static) -> Vec<PlantBus> {
    let mut shafts = Vec::new();
    buses.iter().for_each(|bus| bus.lock().couple(&mut shafts));
    let coupling = Coupling {
        buses: buses.to_vec(),
        plant: Box::new(plant),
        time: None,
        torques: vec![0.0; shafts.len()],
        shafts,
    };
    let coupling = Arc::new(Mutex::new(coupling));
    buses.iter().map(|bus| PlantBus { bus: bus.clone(), coupling: Arc::clone(&coupling) }).collect()
}

/// A bus whose motors a [`Plant`] moves. A call waits while another bus of the same plant is in
/// use: for tests and simulations. Clones refer to the same bus.
#[derive(Clone)]
pub struct PlantBus {
    bus: SharedBus,
    coupling: Arc<Mutex<Coupling>>,
}

struct Coupling {
    buses: Vec<SharedBus>,
    plant: Box<dyn Plant>,
    /// End of the last step; none before the first call.
    time: Option<u64>,
    torques: Vec<f64>,
    shafts: Vec<Shaft>,
}

impl Coupling {
    /// Computes every step that ends by `now`.
    fn advance(&mut self, now: Instant) {
        let now = now.as_nanos() / STEP_NS * STEP_NS;
        let mut time = *self.time.get_or_insert(now);
        while time < now {
            time += STEP_NS;
            self.step(Instant::from_nanos(time));
        }
        self.time = Some(time);
    }

    fn step(&mut self, end: Instant) {
        const SECONDS: f64 = STEP_NS as f64 * 1e-9;
        let Self { buses, plant, torques, shafts, .. } = self;
        let mut impulses = torques.iter_mut();
        buses.iter().for_each(|bus| bus.lock().impulses_until(end, &mut impulses));
        torques.iter_mut().for_each(|torque| *torque /= SECONDS);
        plant.step(torques, SECONDS, shafts);
        let mut shafts = shafts.iter();
        buses.iter().for_each(|bus| bus.lock().set_shafts(&mut shafts));
    }
}

impl PlantBus {
    /// Brings all buses of the plant to `now`, so that what the caller knows of its plant is of
    /// this time.
    pub fn advance(&self, now: Instant) {
        drop(self.at(now));
    }

    /// Brings all buses of the plant to `now`, and locks this one.
    fn at(&self, now: Instant) -> MutexGuard<'_, crate::SimulatedBus> {
        self.coupling.lock().unwrap_or_else(PoisonError::into_inner).advance(now);
        self.bus.lock()
    }
}

impl Bus for PlantBus {
    fn send(&mut self, now: Instant, frames: &[Frame]) -> Sent {
        self.at(now).send(now, frames)
    }

    fn receive(&mut self, now: Instant, inbox: &mut Inbox) {
        self.at(now).receive(now, inbox);
    }

    fn discard_queue(&mut self) -> bool {
        self.bus.lock().discard_queue()
    }

    fn readiness(&self) -> Readiness<'_> {
        self.bus.readiness()
    }
}
