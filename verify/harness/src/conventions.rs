//! A body that rests, as drivers of other conventions send it.

use motord_shared::ImuContradiction::{
    self, AccelerationAxes, AccelerationInG, QuaternionInverse, QuaternionNed, QuaternionXyzw,
    WithoutGravity, ZDown,
};

/// The values that a driver sends of a body that rests with roll 0.4, pitch 0.3, yaw 0.5 rad about
/// x, y and z of the world, in this order.
#[derive(Debug, Clone, Copy)]
pub struct Convention {
    /// The contradiction that names it; `None` for the convention of motord.
    pub contradiction: Option<ImuContradiction>,
    /// The four numbers that it sends for the orientation.
    pub orientation: [f32; 4],
    /// The three numbers that it sends for the acceleration.
    pub acceleration: [f32; 3],
}

impl Convention {
    /// Returns the bits of the contradictions that a state must have.
    #[must_use]
    pub fn bits(&self) -> u32 {
        self.contradiction.map_or(0, ImuContradiction::bit)
    }

    /// Returns the names of the contradictions that a state must have.
    #[must_use]
    pub fn names(&self) -> Vec<&'static str> {
        self.contradiction.into_iter().map(ImuContradiction::name).collect()
    }

    /// Returns the acceleration with noise on its first axis, which differs from turn to turn.
    #[must_use]
    pub fn noisy(&self, turn: u32) -> [f32; 3] {
        let [x, y, z] = self.acceleration;
        [x + 0.01 * (turn % 7) as f32, y, z]
    }
}

/// Each convention; that of motord is the last. Computed by hand.
pub const CONVENTIONS: [Convention; 8] = {
    let [w, x, y, z] = [0.946_281, 0.154_097, 0.190_506, 0.210_984];
    let up @ [ux, uy, uz] = [-0.295_520, 0.372_026, 0.879_923];
    let force @ [fx, fy, fz] = [9.81 * ux, 9.81 * uy, 9.81 * uz];
    [
        convention(Some(QuaternionXyzw), [x, y, z, w], force),
        convention(Some(QuaternionInverse), [w, -x, -y, -z], force),
        convention(Some(QuaternionNed), [w, x, -y, -z], force),
        convention(Some(ZDown), [w, x, y, z], [-fx, -fy, -fz]),
        convention(Some(AccelerationAxes), [w, x, y, z], [fy, -fx, fz]),
        convention(Some(AccelerationInG), [w, x, y, z], up),
        convention(Some(WithoutGravity), [w, x, y, z], [0.0; 3]),
        convention(None, [w, x, y, z], force),
    ]
};

const fn convention(
    contradiction: Option<ImuContradiction>,
    orientation: [f32; 4],
    acceleration: [f32; 3],
) -> Convention {
    Convention { contradiction, orientation, acceleration }
}
