//! The real cycle in another program: a leg of three motors on virtual time, whose shafts this
//! program moves.
//!
//! ```text
//! cargo run -p motord-core --example embed
//! ```

use motord_bus::transport::Simulated;
use motord_bus::{Bus, Clock, Instant, VirtualClock};
use motord_core::cycle::{LocalClient, Tick, assemble};
use motord_protocol::MotorProtocol;
use motord_settings::settings::{
    BusSettings, GroupSettings, LimitSettings, MotorSettings, SafeStop, Settings, SupplySettings,
};
use motord_shared::{JointSetpoint, Operation, Phase, Refusal};
use motord_simulator::{self as simulator, Plant, Shaft, SharedBus, SimulatedBus, couple};

const JOINTS: [&str; 3] = ["hip", "thigh", "knee"];

/// Three pendulums. A physics engine would set the joint torques here, make its step, and read the
/// joints.
struct Pendulums;

impl Plant for Pendulums {
    fn step(&mut self, torques: &[f64], seconds: f64, shafts: &mut [Shaft]) {
        // Pendulum and rotor behind its gear, kg·m²; weight, N·m; bearings, N·m·s/rad.
        let (inertia, weight, friction) = (0.01 + 6e-5 * 64.0, 1.0, 0.02);
        for (shaft, torque) in shafts.iter_mut().zip(torques) {
            let all = torque - weight * shaft.position.sin() - friction * shaft.velocity;
            shaft.velocity += all / inertia * seconds;
            shaft.position += shaft.velocity * seconds;
        }
    }
}

/// The simulated drives on their bus.
fn bus() -> SharedBus {
    let motor = |(name, id): (&str, u16)| simulator::MotorSettings {
        name: name.into(),
        id,
        host_id: 0x100 + id,
        ..Default::default()
    };
    let motors = JOINTS.into_iter().zip(1..).map(motor).collect();
    SharedBus::new(SimulatedBus::new(simulator::BusSettings::default(), motors, 7))
}

/// Claims the leg, enables it, and swings it for two seconds. Fails when the leg does not follow.
pub(crate) fn main() -> Result<(), Refusal> {
    let settings = settings();
    let ends = [bus()];
    let buses = couple(&ends, Pendulums).into_iter().map(|bus| Box::new(bus) as Box<dyn Bus>).collect();
    let clock = VirtualClock::new(Instant::from_nanos(1_000_000_000));
    let (mut cycle, ends) = assemble(&settings, buses, clock.clone(), 1);
    let mut client = LocalClient::new(ends);
    let mut tick = Tick { number: 1, at: clock.now() };
    let mut run = || tick = cycle.run(tick);

    (0..10).for_each(|_| run());
    client.ask(Operation::Claim, 0, &mut run)?;
    client.send(0, clock.now(), &swing(0.0))?;
    run();
    client.ask(Operation::Enable, 0, &mut run)?;
    let mut worst: f32 = 0.0;
    for step in -500..2000 {
        let setpoints = swing(step.max(0) as f32 * 1e-3);
        client.send(0, clock.now(), &setpoints)?;
        run();
        let joints = client.state().joints().iter();
        let errors =
            joints.zip(&setpoints).map(|(joint, setpoint)| (joint.position - setpoint.position).abs());
        worst = errors.fold(worst, f32::max);
    }
    assert_eq!(client.state().groups()[0].phase, Phase::Active.code());
    println!("the leg followed within {worst:.3} rad");
    assert!(worst < 0.1);
    client.ask(Operation::Release, 0, &mut run)?;
    Ok(())
}

fn swing(time: f32) -> [JointSetpoint; 3] {
    [0.1, 0.3, -0.6].map(|reach| JointSetpoint {
        position: reach * (1.0 - (6.0 * time).cos()) / 2.0,
        velocity: reach * 3.0 * (6.0 * time).sin(),
        kp: 60.0,
        kd: 1.5,
        ..Default::default()
    })
}

/// The settings, with the defaults of a file. `motord_settings::settings` documents units and
/// meaning of each value.
fn settings() -> Settings {
    Settings {
        instance: "embedded".into(),
        buses: vec![BusSettings::new("leg", Simulated { bitrate: 1_000_000, seed: 7 })],
        motors: JOINTS.into_iter().zip(1..).map(|(name, id)| motor(name, id)).collect(),
        groups: vec![GroupSettings {
            name: "all".into(),
            motors: vec![0, 1, 2],
            safe_stop: SafeStop::Damp,
            supply: SupplySettings::default(),
        }],
        ..Settings::default()
    }
}

fn motor(name: &str, id: u8) -> MotorSettings {
    let motor =
        MotorSettings::of_model(name, id, MotorProtocol::Mit, "GIM8108-8").expect("a model of the table");
    MotorSettings { limits: LimitSettings { position: [-3.0, 3.0], ..motor.limits }, ..motor }
}
