//! The real cycle in another program: a leg of three motors on virtual time, whose shafts this program moves.
//!
//! ```text
//! cargo run -p motord-core --example embed
//! ```

use core::num::NonZero;
use motord_bus::transport::Simulated;
use motord_bus::{Bus, Clock, Duration, FrameId, Instant, VirtualClock};
use motord_core::cycle::{LocalClient, Tick, assemble};
use motord_protocol::drive::Transmission;
use motord_protocol::gim::ExecutionTime;
use motord_protocol::{Profile, mit};
use motord_settings::settings::{
    BeyondRange, BusSettings, CycleSettings, FaultPolicy, GroupSettings, IpcMode, IpcSettings, LimitSettings,
    MotorSettings, REGISTERS_MAX, RegisterRange, SafeStop, SafetySettings, Settings, WindingSettings,
};
use motord_shared::{JointSetpoint, Operation, Phase, Refusal};
use motord_simulator::{self as simulator, Plant, Shaft, SharedBus, SimulatedBus, couple};

const JOINTS: [&str; 3] = ["hip", "thigh", "knee"];

/// Three pendulums. A physics engine would set the joint torques here, make its step, and read the joints.
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

/// The settings that the daemon reads from its file. `motord_settings::settings` documents units and meaning of each value.
fn settings() -> Settings {
    let milliseconds = Duration::from_millis;
    Settings {
        instance: "embedded".into(),
        cycle: CycleSettings {
            rate_hz: 1000.0,
            period: milliseconds(1),
            cpu: None,
            priority: 80,
            require_realtime: false,
            max_lateness: milliseconds(5),
            max_missed_ticks: 0.5,
            reply_deadline: Duration::from_micros(800),
            busy_poll: Duration::ZERO,
            indicator_hz: 1.0,
        },
        ipc: IpcSettings {
            mode: IpcMode::Timed,
            lead: Duration::from_micros(150),
            busy_poll: Duration::ZERO,
            cpu: None,
            priority: None,
        },
        safety: SafetySettings {
            setpoint_timeout: milliseconds(20),
            setpoint_horizon_max: milliseconds(40),
            safe_stop: SafeStop::Damp,
            damp: Duration::from_secs(2),
            rest_velocity: 0.2,
            lost_cycles: 10,
            start_jump: 0.1,
            start_ramp: milliseconds(100),
            start_timeout: milliseconds(1000),
            fault_poll_hz: 10.0,
            deadman: milliseconds(7),
            require_deadman: false,
            stop_on_foreign_master: true,
            error_feedback: true,
        },
        buses: vec![BusSettings {
            name: "leg".into(),
            kind: Simulated { bitrate: 1_000_000, seed: 7 }.into(),
            every: NonZero::<u32>::MIN,
        }],
        motors: JOINTS.into_iter().zip(1..).map(|(name, id)| motor(name, id)).collect(),
        simulation: Vec::new(),
        groups: vec![GroupSettings { name: "all".into(), motors: vec![0, 1, 2], safe_stop: SafeStop::Damp }],
        imus: Vec::new(),
    }
}

fn motor(name: &str, id: u8) -> MotorSettings {
    let (profile, model) = Profile::of_model("GIM8108-8").expect("a model of the table");
    let scales = model.scales().expect("the model's own constants");
    MotorSettings {
        name: name.into(),
        bus: 0,
        id,
        host_id: FrameId::new(0x100 + u16::from(id)).expect("eleven bits"),
        protocol: Default::default(),
        model: model.name.into(),
        profile,
        scales,
        constants: None,
        winding: WindingSettings {
            rated_torque: model.rated_torque,
            peak_torque: model.peak_torque,
            overload: Duration::from_secs(10),
        },
        max_velocity: model.max_velocity,
        transmission: Transmission::new(1.0, 0.0),
        capabilities: (mit::FAMILY.capabilities)(profile, &scales),
        registers: [RegisterRange::ANY; REGISTERS_MAX],
        duration: ExecutionTime::default(),
        may_be_excluded: false,
        excluded: false,
        damping_kd: 2.0,
        beyond_range: BeyondRange::Stop,
        fault_policy: FaultPolicy::StopGroup,
        limits: LimitSettings {
            position: [-3.0, 3.0],
            velocity: 20.0,
            torque: model.rated_torque,
            kp: 100.0,
            kd: 5.0,
            torque_slew: 50.0 * model.rated_torque,
            kp_slew: 2000.0,
            kd_slew: 100.0,
            temperature_derate: 70.0,
            temperature: 90.0,
            following_error: None,
            torque_response: 0.3,
        },
    }
}
