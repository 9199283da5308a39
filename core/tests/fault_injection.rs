//! Goal: for any behaviour of buses, motors, controllers and the clock, the invariants of
//! `verify/checker/src/run.rs` hold in every cycle. When the faults end, the robot can be armed
//! again within a second.
//! Method: seeded fault-injection runs on virtual time over two buses, six motors and two groups.
//! Of three seeds, one has only MIT motors. One runs the robot of three vendors' motors, with four
//! buses and twelve motors; in half of these seeds RobStride's knees speak their private protocol, and
//! in a quarter SteadyWin's hips have a CANSimple driver, in another quarter MyActuator's motors,
//! which need no enable, replace some knees, and in every eighth an ODrive replaces a knee.
//! One has native motors among them; half of these seeds put three on a serial line at a fifth of
//! the rate. In every fourth seed the cycle polls for the last replies.
//! `MOTORD_SEEDS` sets the number of seeds, and `MOTORD_ROBOT_SECONDS` the length of each.
//! `MOTORD_SEED` runs one alone, as the message of a failure describes.

use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::checker::{Checker, of_vendor};
use motord_harness::robot::fuzz_client::FuzzClient;
use motord_harness::robot::random::Random;
use motord_settings::settings::{BusSettings, Settings};
use motord_shared::{AdminRequest, BusCondition, JointSetpoint, MotorMode, Operation, Phase, Refusal};
use motord_simulator::Mode;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Number of runs of a plain `cargo test`.
const SEEDS: u64 = 300;
/// Length of each run, s of robot time.
const SECONDS: u64 = 2;
/// Most cycles that an operator and a well-behaved controller need after the end of the faults.
/// A zero of the time of the faults delays the next one by ten seconds.
const ARMABLE_CYCLES: u32 = 1000 + 10_000;

/// Interval at which buses that the cycle has given up are opened again.
const REOPEN_CYCLES: u64 = 100;

/// Times as strict as on a robot.
const SAFETY: &str = "[safety]\nsetpoint-timeout-ms = 20\ndamp-seconds = 0.3\n";

/// Returns `true` when this seed runs the robot of three vendors' motors.
const fn is_mixed(seed: u64) -> bool {
    seed % 3 == 2
}

/// Returns `true` when the cycle polls for the last replies.
const fn polls(seed: u64) -> bool {
    seed % 4 == 1
}

/// Returns `true` when half of this seed's motors speak the native protocol.
const fn has_native(seed: u64) -> bool {
    seed % 3 == 1
}

/// Returns `true` when one of this seed's buses of native motors is a serial line.
const fn has_line(seed: u64) -> bool {
    matches!(seed % 12, 1 | 4)
}

/// Returns `true` when the motors of the line share a host id. Then only the order of requests
/// identifies a reply's sender.
const fn shares_host_id(seed: u64) -> bool {
    seed % 24 < 12
}

/// Distance from its zero, rad, beyond which a native joint at rest is switched off and on, which
/// resets its count of turns. The cycle does not control its zero.
const NATIVE_FAR: f32 = 5.0;

/// Returns two groups that share both buses, with every policy once. With native motors each group
/// has two of three, with room for a turn.
fn settings(seed: u64) -> Settings {
    let native = has_native(seed);
    let mut text =
        format!("{SAFETY}[[bus]]\nname = \"left\"\ntype = \"simulated\"\n[[bus]]\nname = \"right\"\n");
    text += match has_line(seed) {
        true => "type = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nevery = 5\n",
        false => "type = \"simulated\"\n",
    };
    let host_id = |id: u8, bus: &str| match has_line(seed) && bus == "right" {
        true => format!("host-id = {}\n", if shares_host_id(seed) { 0x40 } else { 0x40 + id }),
        false => String::new(),
    };
    let motor = |id: u8, joint: &str, bus: &str, more: &str| {
        let more = host_id(id, bus) + more;
        let motor = robot::motor(id, &format!("{bus}-{joint}"), bus, &more);
        let speaks_native = native && (joint == "thigh" || bus == "right");
        if speaks_native {
            motor.replace("\"mit\"", "\"gim\"").replace("[-3.0, 3.0]", "[-7.0, 7.0]")
        } else {
            motor
        }
    };
    for (bus, policy) in [("left", "stop-joint"), ("right", "stop-all")] {
        text += &motor(1, "hip", bus, "");
        text += &motor(2, "thigh", bus, "direction = -1\noffset-rad = 0.3");
        text += &motor(3, "knee", bus, &format!("fault-policy = \"{policy}\""));
    }
    text += "[[group]]\nname = \"legs\"\njoints = [\"left-hip\", \"left-thigh\", \"right-hip\"]\n";
    text += "[[group]]\nname = \"arms\"\njoints = [\"left-knee\", \"right-thigh\", \"right-knee\"]\nsafe-stop = \"hold\"\n";
    robot::settings(&text)
}

/// The frames of a private knee, and the answers of a stopped CANSimple driver, are longer.
const LATER_REPLIES: &str = "[cycle]\nreply-deadline-percent = 90\n";

/// A knee that needs no enable.
const NO_ENABLE: &str = "id = 3\nprotocol = \"myactuator\"\nmodel = \"X8-20\"\ntorque-end-nm = 24";

/// A knee that no frame asks for its state.
const UNASKED: &str =
    "id = 3\nprotocol = \"odrive\"\nmodel = \"ODrive-S1\"\ngear-ratio = 8\npeak-torque-nm = 12";

/// Returns the buses and motors of the shipped mixed robot. Two groups share all its buses and
/// vendors. A motor that restarts or is zeroed at any position is within its limits, so that it can
/// be armed again.
fn mixed_settings(seed: u64) -> Settings {
    let file = include_str!("../../config/mixed-simulated.toml");
    let from = file.find("[[bus]]").expect("the robot has buses");
    let to = file.find("[[group]]").expect("the robot has a group");
    let legs = ["fl", "fr", "rl", "rr"];
    let joints =
        |names: &[&str]| legs.map(|leg| names.iter().map(|name| format!("{leg}-{name}")).collect::<Vec<_>>());
    let text = format!(
        "{SAFETY}{}[[group]]\nname = \"legs\"\njoints = {:?}\n[[group]]\nname = \"knees\"\njoints = {:?}\nsafe-stop = \"hold\"\n",
        &file[from..to],
        joints(&["hip", "thigh"]).concat(),
        joints(&["knee"]).concat(),
    );
    let knee = |protocol: &str| format!("id = 3\nprotocol = \"{protocol}\"\nmodel = \"RS");
    let unasked = usize::from(seed % 8 == 3);
    let text = text.replacen(&(knee("mit") + "00\""), UNASKED, unasked);
    let hip = |protocol: &str| format!("id = 1\nprotocol = \"{protocol}\"\nmodel = \"GIM8108-8\"");
    let text = match seed % 4 {
        // SteadyWin's hips have a CANSimple driver.
        0 => LATER_REPLIES.to_owned() + &text.replace(&hip("mit"), &hip("cansimple")),
        1 | 3 => LATER_REPLIES.to_owned() + &text.replace(&knee("mit"), &knee("robstride")),
        _ => text.replace(&(knee("mit") + "00\""), NO_ENABLE),
    };
    let mut settings = robot::settings(&text);
    settings.motors.iter_mut().for_each(|motor| motor.limits.position = [-3.0, 3.0]);
    settings
}

const BUS_FAULTS: [&str; 14] = [
    "gone",
    "power-off",
    "bus-off",
    "tx-full",
    "tx-full 1",
    "no-ack",
    "down",
    "flood 3000",
    "warning",
    "passive",
    "extended",
    "remote",
    "fd",
    "overflow 5",
];
/// Faults of a serial line.
const LINE_FAULTS: [&str; 7] = ["gone", "blocked", "silent", "echo", "loss 5%", "glue 16ms", "corrupt 1%"];
const MOTOR_FAULTS: [&str; 15] = [
    "off",
    "stuck",
    "garbage",
    "wrong",
    "slow 10ms",
    "delayed 300us",
    "delayed 2ms",
    "intermittent 30%",
    "duplicate",
    "reorder",
    "short",
    "fault over-voltage",
    "fault over-current",
    "power-cycle",
    "restart",
];

#[test]
fn no_fault_sends_forbidden_frames_or_prevents_arming() {
    let seconds = robot::number("MOTORD_ROBOT_SECONDS").unwrap_or(SECONDS);
    let [mixed, native, lines, damaged] = [const { AtomicU64::new(0) }; 4];
    robot::for_each_seed("fault_injection", SEEDS, |seed| {
        mixed.fetch_add(u64::from(is_mixed(seed)), Relaxed);
        let mut run = Run::new(seed);
        for _ in 0..seconds * 1000 {
            run.step_with_faults();
            native.fetch_add(run.active_native(|_| true), Relaxed);
            lines.fetch_add(run.active_native(BusSettings::is_line), Relaxed);
        }
        run.lift_all();
        run.must_be_armable();
        damaged.fetch_add(run.damaged, Relaxed);
    });
    let [mixed, native, lines, damaged] = [mixed, native, lines, damaged].map(AtomicU64::into_inner);
    println!("fault_injection: {mixed} of the seeds had motors of three vendors");
    println!(
        "fault_injection: {native} cycles of native motors that followed setpoints, {lines} on a serial line"
    );
    println!(
        "fault_injection: {damaged} times a damaged command had changed what a motor remembers, or its mode"
    );
}

/// Goal: a robot with healthy controllers is never stopped without a reason. Method: an hour of
/// twelve joints in smooth random motion, with the jitter and the rare losses of sound hardware.
#[test]
#[ignore = "an hour of robot time takes a minute: run it with --release and --ignored"]
fn an_hour_of_sane_control_is_never_stopped() {
    sane::walk(robot::number("MOTORD_ROBOT_SECONDS").unwrap_or(3600));
}

/// A robot with random faults.
struct Run {
    random: Random,
    robot: Robot,
    checker: Checker,
    controllers: [FuzzClient; 2],
    /// Mean number of cycles between two faults.
    interval: usize,
    /// Requests without an answer yet. All except service requests to motors are answered
    /// immediately.
    pending: Vec<u32>,
    /// By motor: its memory as it was configured.
    memories: Vec<String>,
    /// By bus: its motors have power.
    has_power: Vec<bool>,
    /// Its buses have no time for second replies: the frames of the host would wait, and then be
    /// refused, on a bus that the checker takes for healthy.
    is_full: bool,
    /// The line damages or loses bytes.
    damages: bool,
    /// Number of times that a motor had to be configured again.
    damaged: u64,
}

impl Run {
    fn new(seed: u64) -> Self {
        // A limp joint comes to rest in a fraction of a second, as one with a leg on it does.
        let mut settings = if is_mixed(seed) { mixed_settings(seed) } else { settings(seed) };
        if polls(seed) {
            settings.cycle.busy_poll = Duration::from_micros(30);
        }
        let robot = Robot::built(settings, seed, |_, motors| {
            motors.iter_mut().for_each(|motor| motor.coulomb_friction = 1.0);
        });
        if polls(seed) {
            // A cycle that polls waits for its clock to move.
            robot.clock.reading.set(Duration::from_micros(1));
        }
        let mut checker = Checker::new(&robot);
        checker.allow_loss();
        let controllers = [0, 1].map(FuzzClient::new);
        let mut random = Random::new(seed);
        let interval = *random.pick(&[50, 200, 1000]);
        let memories = (0..robot.settings.motors.len()).map(|motor| robot.truth(motor).memory()).collect();
        let has_power = vec![true; robot.buses.len()];
        Self {
            random,
            robot,
            checker,
            controllers,
            interval,
            pending: Vec::new(),
            memories,
            has_power,
            is_full: is_mixed(seed) && seed % 2 == 1,
            damages: false,
            damaged: 0,
        }
    }

    /// Runs one cycle in which any fault may occur.
    fn step_with_faults(&mut self) {
        if self.random.once_in(self.interval) {
            self.disturb();
        }
        if self.random.once_in(30) {
            self.lift();
        }
        if self.random.once_in(4 * self.interval) {
            let longest = *self.random.pick(&[1e-3, 3e-3, 12e-3]);
            let late = self.random.between(0.1e-3, longest);
            self.robot.oversleep(Duration::from_secs_f32(late));
        }
        if self.random.once_in(4 * self.interval) {
            let back = Duration::from_nanos(self.random.draw() % 1_000_000);
            self.robot.turn_clock_back(back);
        }
        if self.random.once_in(16 * self.interval) {
            self.robot.suspend(Duration::from_secs(1));
        }
        for group in 0..self.controllers.len() {
            if !self.is_active(group) {
                self.hold_still(group);
                if self.random.once_in(20) {
                    self.arm(group);
                }
            } else if self.random.once_in(500) {
                let Self { random, robot, checker, controllers, pending, .. } = self;
                pending.push(controllers[group].request(random, robot, checker));
            } else {
                let Self { random, robot, checker, controllers, .. } = self;
                controllers[group].misbehave(random, robot, checker);
            }
        }
        self.step();
    }

    fn is_active(&mut self, group: usize) -> bool {
        self.robot.state().groups[group].phase == Phase::Active.code()
    }

    fn step(&mut self) {
        let Self { robot, checker, controllers, pending, .. } = self;
        robot.step();
        checker.check(robot);
        if robot.state().cycle % REOPEN_CYCLES == 0 {
            reopen(robot);
        }
        let mut lost_turn = Vec::new();
        while let Some((ticket, reply)) = robot.take_answer() {
            pending.retain(|pending| *pending != ticket);
            controllers.iter_mut().for_each(|controller| controller.receive_reply(robot, ticket, &reply));
            lost_turn.extend((reply.refusal == Refusal::TurnLost.code()).then_some(reply.detail as usize));
        }
        // The operator has looked at the joint.
        lost_turn.into_iter().for_each(|joint| self.ask(Operation::ClearFault, 0, joint));
    }

    fn disturb(&mut self) {
        if self.random.once_in(4) {
            let bus = self.random.below(self.robot.buses.len());
            let is_line = self.robot.settings.buses[bus].is_line();
            let fault = *self.random.pick(if is_line { &LINE_FAULTS[..] } else { &BUS_FAULTS });
            self.disturb_bus(bus, fault);
        } else {
            let motor = self.random.below(self.robot.settings.motors.len());
            let vendor = self.robot.settings.motors[motor].profile.name;
            let fault = match *self.random.pick(&MOTOR_FAULTS) {
                "duplicate" if self.is_full => "reorder",
                fault => of_vendor(fault, vendor),
            };
            self.disturb_motor(motor, fault);
        }
    }

    fn disturb_bus(&mut self, bus: usize, fault: &str) {
        let name = self.robot.settings.buses[bus].name.clone();
        self.checker.disturbed_bus(bus, fault);
        self.robot.disturb(&format!("{name} {fault}"));
        let is_line = self.robot.settings.buses[bus].is_line();
        let on_bus = |motor: &usize| self.robot.settings.motors[*motor].bus == bus;
        let motors: Vec<_> = (0..self.memories.len()).filter(on_bus).collect();
        let is_over = fault == "ok";
        let had_power = self.has_power[bus];
        self.has_power[bus] = is_over || had_power && fault != "power-off";
        for motor in motors {
            match fault {
                "silent" | "power-off" => self.checker.disturbed_motor(motor, "off"),
                "ok" if is_line || !had_power => self.checker.disturbed_motor(motor, "ok"),
                _ => {}
            }
            if is_line && is_over && self.damages {
                self.recommission(motor);
            }
        }
        if !is_line {
            return;
        }
        self.damages = !is_over && (self.damages || ["corrupt 1%", "loss 5%"].contains(&fault));
    }

    /// Restores the memory of a motor. No checksum covers the payload of a frame on a line. A
    /// damaged or lost byte can turn a command into a reset of the configuration, or into an update
    /// of the firmware. A technician writes the memory again, and switches the motor off and on:
    /// its volatile state may also have changed.
    fn recommission(&mut self, motor: usize) {
        let truth = self.robot.truth(motor);
        let memory = &self.memories[motor];
        let is_as_configured = written(&truth.memory()).eq(written(memory));
        self.damaged += u64::from(!is_as_configured || truth.mode() == Mode::Firmware);
        let bus = &self.robot.buses[self.robot.settings.motors[motor].bus];
        bus.with(|bus| bus.remember(truth.name(), memory)).expect("it is its own memory");
        self.disturb_motor(motor, "power-cycle");
    }

    fn disturb_motor(&mut self, motor: usize, fault: &str) {
        let name = self.robot.settings.motors[motor].name.clone();
        self.checker.disturbed_motor(motor, fault);
        self.robot.disturb(&format!("{name} {fault}"));
    }

    /// Ends the fault of a bus or a motor.
    fn lift(&mut self) {
        let (buses, motors) = (self.robot.buses.len(), self.robot.settings.motors.len());
        match self.random.below(buses + motors) {
            bus if bus < buses => self.disturb_bus(bus, "ok"),
            motor => self.disturb_motor(motor - buses, "ok"),
        }
    }

    /// Ends every fault.
    fn lift_all(&mut self) {
        (0..self.robot.buses.len()).for_each(|bus| self.disturb_bus(bus, "ok"));
        (0..self.robot.settings.motors.len()).for_each(|motor| self.disturb_motor(motor, "ok"));
    }

    /// Checks that an operator who clears, resets and enables, and controllers that hold still,
    /// make the robot `Active`. Requests to motors from the time of the faults may take their time
    /// limit.
    fn must_be_armable(&mut self) {
        while !self.pending.is_empty() {
            self.hold_all();
            self.step();
        }
        for cycle in 0..ARMABLE_CYCLES {
            if (0..self.controllers.len()).all(|group| self.is_active(group)) {
                return;
            }
            self.hold_all();
            if cycle % 20 == 0 {
                (0..self.controllers.len()).for_each(|group| self.arm(group));
            }
            self.step();
        }
        panic!("not armable: {:?} {:?}", self.robot.state().groups(), self.robot.state().joints());
    }

    fn hold_all(&mut self) {
        (0..self.controllers.len()).for_each(|group| self.hold_still(group));
    }

    /// Sends setpoints of the owner that hold the joints at their positions, or at those of the
    /// active time.
    fn hold_still(&mut self, group: usize) {
        let active = self.is_active(group);
        let Self { robot, checker, controllers, .. } = self;
        let controller = &mut controllers[group];
        if !controller.owns(robot) {
            return;
        }
        if !active {
            controller.setpoints = robot.hold_group(group, 20.0, 1.0);
            controller.setpoints.iter_mut().for_each(|setpoint| *setpoint = finite(*setpoint));
        }
        controller.follow(robot, checker);
    }

    /// Makes one attempt of an operator to activate the group: clears faults, sets zeros, resets,
    /// enables. The operator repeats it until the group is active.
    fn arm(&mut self, group: usize) {
        let state = self.robot.state();
        if state.groups[group].lease == 0 {
            self.controllers[group].claim(&mut self.robot);
        }
        for motor in self.robot.settings.groups[group].motors.clone() {
            let joint = &state.joints[motor];
            if joint.mode == MotorMode::Fault.code() {
                self.ask(Operation::ClearFault, group, motor);
            } else if self.is_native(motor) {
                // Each check of the operator may fall on a cycle in which a fault request replaced
                // the request for a state.
                if joint.age_cycles <= 1 && joint.position.abs() > NATIVE_FAR && !self.is_active(group) {
                    self.disturb_motor(motor, "power-cycle");
                }
            } else if joint.age_cycles <= self.age_max(motor) && joint.position.abs() > 2.0 {
                self.ask(Operation::SetZero, group, motor);
            }
        }
        self.ask(Operation::Reset, group, 0);
        self.ask(Operation::Enable, group, 0);
    }

    /// Returns the largest age of a state by which the operator sets a zero, cycles. Some stopped motors
    /// report one in every second cycle, or by themselves every 10 ms.
    fn age_max(&self, motor: usize) -> u32 {
        let abilities = self.robot.settings.motors[motor].capabilities;
        if abilities.reports_stopped_state { 12 } else { u32::from(abilities.runs_without_enable) }
    }

    /// Returns the number of native motors on such buses that follow setpoints.
    fn active_native(&mut self, on: fn(&BusSettings) -> bool) -> u64 {
        let state = self.robot.state();
        let Settings { buses, motors, .. } = &self.robot.settings;
        let follows = |&motor: &usize| {
            self.is_native(motor)
                && on(&buses[motors[motor].bus])
                && state.joints[motor].mode == MotorMode::Active.code()
        };
        (0..motors.len()).filter(follows).count() as u64
    }

    fn is_native(&self, motor: usize) -> bool {
        self.robot.settings.motors[motor].protocol.name() == "gim"
    }

    fn ask(&mut self, operation: Operation, group: usize, joint: usize) {
        let (group, joint) = (group as u32, joint as u32);
        let request = AdminRequest { operation: operation.code(), group, joint, ..Default::default() };
        self.checker.asked(&request);
        self.pending.push(self.robot.post(request));
    }
}

/// Returns the lines of a memory except the position at power-off (GIM document, table 7, ConfID
/// 0x15), which the motor writes itself.
fn written(memory: &str) -> impl Iterator<Item = &str> {
    memory.lines().filter(|line| !line.starts_with("int 0x15 "))
}

/// Reopens the buses that the cycle has given up.
fn reopen(robot: &mut Robot) {
    let given_up = [BusCondition::Off.code(), BusCondition::Gone.code()];
    for bus in
        (0..robot.buses.len()).filter(|&bus| given_up.contains(&robot.bus(bus).condition)).collect::<Vec<_>>()
    {
        robot.reopen(bus);
    }
}

/// Returns the setpoint with zeros where a joint's state is not known yet.
fn finite(setpoint: JointSetpoint) -> JointSetpoint {
    if setpoint.position.is_finite() { setpoint } else { JointSetpoint::default() }
}

/// Controllers without faults.
mod sane {
    use super::robot::random::Random;
    use super::robot::{self, Robot};
    use motord_bus::Duration;
    use motord_shared::{JointSetpoint, Phase};

    /// A smooth motion of one joint.
    struct Wave {
        amplitude: f64,
        frequency: f64,
    }

    impl Wave {
        fn new(random: &mut Random) -> Self {
            let between = |random: &mut Random, low, high| f64::from(random.between(low, high));
            Self { amplitude: between(random, 0.05, 0.3), frequency: between(random, 0.2, 2.0) }
        }

        /// Returns position and velocity, rad and rad/s.
        fn at(&self, time: f64) -> (f32, f32) {
            let omega = std::f64::consts::TAU * self.frequency;
            let (sine, cosine) = (omega * time).sin_cos();
            ((self.amplitude * sine) as f32, (self.amplitude * omega * cosine) as f32)
        }
    }

    pub(super) fn walk(seconds: u64) {
        let mut random = Random::new(6);
        let mut robot = Robot::built(robot::quadruped(), 6, |_, motors| {
            motors.iter_mut().for_each(|motor| motor.reply_jitter = Duration::from_micros(20));
        });
        let still = robot.activate();
        let waves: Vec<_> = still.iter().map(|_| Wave::new(&mut random)).collect();
        let mut pause = 0;
        for cycle in 0..seconds * 1000 {
            disturb(&mut random, &mut robot);
            if pause == 0 && random.once_in(500) {
                pause = 1 + random.below(15);
            }
            pause = pause.saturating_sub(1);
            if pause == 0 {
                robot.send(&setpoints(&still, &waves, cycle));
            }
            robot.step();
            robot.take_sent();
            robot.take_replies();
            robot.take_events();
            assert_eq!(robot.phase(), Phase::Active, "stopped after {cycle} cycles: {:?}", robot.cause());
        }
    }

    /// Occasionally makes a cycle begin late, or a reply get lost.
    fn disturb(random: &mut Random, robot: &mut Robot) {
        if random.once_in(1000) {
            robot.oversleep(Duration::from_nanos(random.draw() % 1_500_000));
        }
        if random.once_in(1000) {
            let joint = random.below(robot.settings.motors.len());
            let name = robot.settings.motors[joint].name.clone();
            robot.disturb(&format!("{name} {}", random.pick(&["intermittent 1%", "ok", "ok"])));
        }
    }

    fn setpoints(still: &[JointSetpoint], waves: &[Wave], cycle: u64) -> Vec<JointSetpoint> {
        let time = cycle as f64 / 1000.0;
        let setpoint = |(still, wave): (&JointSetpoint, &Wave)| {
            let (position, velocity) = wave.at(time);
            JointSetpoint { position: still.position + position, velocity, kp: 30.0, ..*still }
        };
        still.iter().zip(waves).map(setpoint).collect()
    }
}
