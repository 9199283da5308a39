//! The joints of a twin: mechanics in the terms of the configuration.

use crate::error::{NUMBER_MAX, TwinError};
use crate::physics::physics;
use motord_protocol::drive::Transmission;
use motord_settings::settings::{MotorSettings, Settings};
use motord_simulator::{Plant, Shaft};
use serde::Serialize;

/// The mechanics of a robot: a physics engine. Values are those of the joints, in the order of the
/// configuration.
pub trait Mechanics: Send {
    /// Sets where the joints begin, rad. They begin where the configuration has them if this
    /// changes nothing.
    fn begin(&mut self, positions: &mut [f64]) {
        let _as_configured = positions;
    }

    /// Moves every joint by `seconds`, which is 0.00025 in every call: `torques` are means over
    /// this time, N·m. `positions`, rad, and `velocities`, rad/s, are those at the begin of the
    /// step, and become those at its end.
    ///
    /// The mechanics contain all inertia and friction, also that of the motors: [`JointPhysics`].
    fn step(&mut self, torques: &[f64], seconds: f64, positions: &mut [f64], velocities: &mut [f64]);
}

/// The part of a motor in the mechanics of its joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointPhysics {
    /// The joint.
    pub name: String,
    /// Inertia of the rotor behind its gear, kg·m².
    pub armature: f64,
    /// Viscous friction, N·m·s/rad.
    pub damping: f64,
    /// Dry friction, N·m.
    pub friction: f64,
    /// Where the configuration has the joint at the beginning, rad.
    pub begin: f64,
}

impl JointPhysics {
    /// Returns those of a configuration, in its order.
    #[must_use]
    pub fn of(settings: &Settings) -> Vec<Self> {
        let motors: Vec<_> = (0..settings.buses.len()).flat_map(|bus| physics(settings, bus).1).collect();
        let of_joint = |name: &str| motors.iter().find(|motor| motor.name == name);
        let begins = positions(settings);
        let joint = |(motor, begin): (&MotorSettings, f64)| {
            let motor = of_joint(&motor.name)?;
            Some(Self {
                name: motor.name.clone(),
                armature: motor.rotor_inertia * motor.gear_ratio.powi(2),
                damping: motor.viscous_friction,
                friction: motor.coulomb_friction,
                begin,
            })
        };
        settings.motors.iter().zip(begins).filter_map(joint).collect()
    }
}

/// The mechanics of the joints, as the plant that moves the shafts.
pub(crate) struct JointPlant {
    mechanics: Box<dyn Mechanics>,
    /// By shaft: its joint, and how it is mounted.
    joints: Vec<(usize, Transmission)>,
    torques: Vec<f64>,
    positions: Vec<f64>,
    velocities: Vec<f64>,
}

impl JointPlant {
    /// Sets where the motors of `settings` begin.
    ///
    /// # Errors
    /// [`TwinError::Begin`].
    pub(crate) fn new(mut mechanics: Box<dyn Mechanics>, settings: &mut Settings) -> Result<Self, TwinError> {
        let mut positions = positions(settings);
        mechanics.begin(&mut positions);
        let mut begins = settings.motors.iter().zip(&positions);
        let is_possible = |position: f64| position.abs() <= NUMBER_MAX; // False for NaN.
        if let Some((motor, &position)) = begins.find(|(_, position)| !is_possible(**position)) {
            return Err(TwinError::Begin { joint: motor.name.clone(), position });
        }
        for ((simulation, motor), position) in
            settings.simulation.iter_mut().zip(&settings.motors).zip(&positions)
        {
            simulation.initial_position = motor.transmission.position_to_motor(*position as f32).into();
        }
        let of_bus = |bus: usize| {
            let motors = settings.motors.iter().enumerate().filter(move |(_, motor)| motor.bus == bus);
            motors.map(|(joint, motor)| (joint, motor.transmission))
        };
        let joints = (0..settings.buses.len()).flat_map(of_bus).collect();
        let zeros = vec![0.0; positions.len()];
        Ok(Self { mechanics, joints, torques: zeros.clone(), velocities: zeros, positions })
    }
}

/// Where the joints of a configuration begin, rad.
fn positions(settings: &Settings) -> Vec<f64> {
    let motors = settings.motors.iter().zip(&settings.simulation);
    motors
        .map(|(motor, simulation)| {
            motor.transmission.position_to_joint(simulation.initial_position as f32).into()
        })
        .collect()
}

impl Plant for JointPlant {
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]) {
        let Self { mechanics, joints, torques: of_joints, positions, velocities } = self;
        for ((joint, transmission), torque) in joints.iter().zip(torques) {
            of_joints[*joint] = torque * f64::from(transmission.direction());
        }
        mechanics.step(of_joints, seconds, positions, velocities);
        for ((joint, transmission), shaft) in joints.iter().zip(shafts) {
            let (direction, offset) = (f64::from(transmission.direction()), f64::from(transmission.offset()));
            shaft.position = direction * (positions[*joint] - offset);
            shaft.velocity = direction * velocities[*joint];
        }
    }
}
