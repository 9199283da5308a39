//! The effect of every event in every state of a group and of a motor. The diagrams are above
//! `Group` and `Motor` in `core/src/control`.

use motord_bus::Duration;
use motord_harness::robot::checker::Checker;
use motord_harness::robot::fuzz_client::FuzzClient;
use motord_harness::robot::random::Random;
use motord_harness::robot::{self, Meaning, Robot};
use motord_shared::{AdminRequest, JointSetpoint, MotorMode, Operation, Phase, Refusal};

/// Returns three motors with frequent fault requests, so that every event is detected while a group
/// is damped.
fn robot() -> Robot {
    let mut settings = robot::three_motors();
    settings.safety.fault_poll_hz = 100.0;
    Robot::new(settings, 1)
}

/// Returns a robot whose group is in this phase, and has an owner.
fn in_phase(phase: Phase) -> Robot {
    let mut robot = robot();
    let joints = robot.activate();
    if phase != Phase::Active {
        robot.operate(Operation::Disable).expect("it has an owner");
    }
    if matches!(phase, Phase::Disarmed | Phase::Starting) {
        robot.follow_until(&joints, 200, |robot| robot.phase() == Phase::Disarmed);
    }
    if phase == Phase::Starting {
        robot.operate(Operation::Enable).expect("it is ready");
    }
    assert_eq!(robot.phase(), phase);
    robot
}

/// Triggers an event. Returns the refusal, if there is one.
type Event = fn(&mut Robot) -> Option<Refusal>;

fn ask(robot: &mut Robot, operation: Operation) -> Option<Refusal> {
    let request = AdminRequest { operation: operation.code(), lease: robot.lease(), ..Default::default() };
    robot.ask(request).err()
}

fn happens(event: impl FnOnce()) -> Option<Refusal> {
    event();
    None
}

/// Returns the outcome of `event` as a text: `refusal: state after state; cause`.
fn outcome<T: PartialEq + std::fmt::Debug>(
    robot: &mut Robot,
    event: Event,
    observe: fn(&mut Robot) -> T,
) -> String {
    let joints = robot.hold(40.0, 1.0);
    robot.send(&joints);
    let refusal = event(robot).map_or_else(String::new, |refusal| format!("{refusal:?}: "));
    let mut states = Vec::new();
    for _ in 0..300 {
        robot.follow(&joints);
        let state = observe(robot);
        if states.last() != Some(&state) {
            states.push(state);
        }
    }
    let cause = robot.cause().map_or_else(String::new, |cause| format!("; {cause:?}"));
    let states: Vec<_> = states.iter().map(|state| format!("{state:?}")).collect();
    format!("{refusal}{}{cause}", states.join(" "))
}

fn check<S: PartialEq + std::fmt::Debug, const STATES: usize>(
    table: &[(&str, Event, [&str; STATES])],
    begin: impl Fn(usize) -> Robot,
    observe: fn(&mut Robot) -> S,
) {
    for (name, event, expected) in table {
        let received: [String; STATES] =
            std::array::from_fn(|state| outcome(&mut begin(state), *event, observe));
        assert_eq!(received, *expected, "{name}");
    }
}

#[test]
fn group_transitions_match_the_table() {
    const PHASES: [Phase; 4] = [Phase::Disarmed, Phase::Starting, Phase::Active, Phase::Damping];
    #[rustfmt::skip]
    const TABLE: [(&str, Event, [&str; 4]); 11] = [
        ("claim", |robot| ask(robot, Operation::Claim),
            ["Owned: Disarmed", "Owned: Starting Active", "Owned: Active", "Owned: Damping Disarmed"]),
        ("enable", |robot| ask(robot, Operation::Enable),
            ["Starting Active", "NotDisarmed: Starting Active", "NotDisarmed: Active", "NotDisarmed: Damping Disarmed"]),
        ("disable", |robot| ask(robot, Operation::Disable),
            ["Disarmed", "Damping Disarmed", "Damping Disarmed", "Damping Disarmed"]),
        ("release", |robot| ask(robot, Operation::Release),
            ["Disarmed", "Damping Disarmed", "Damping Disarmed", "Damping Disarmed"]),
        ("reset", |robot| ask(robot, Operation::Reset),
            ["Disarmed", "NotNeutral: Starting Active", "NotNeutral: Active", "NotNeutral: Damping Disarmed"]),
        ("emergency stop", |robot| ask(robot, Operation::EmergencyStop),
            ["Disarmed; EmergencyStop", "Damping Disarmed; EmergencyStop", "Damping Disarmed; EmergencyStop",
                "Damping Disarmed; EmergencyStop"]),
        ("the owner falls silent", |robot| happens(|| robot.steps(25)),
            ["Disarmed", "Damping Disarmed; SetpointTimeout", "Damping Disarmed; SetpointTimeout", "Damping Disarmed"]),
        ("a motor is off", |robot| happens(|| robot.disturb("hip off")),
            ["Disarmed", "Starting Damping Disarmed; MotorLost", "Active Damping Disarmed; MotorLost",
                "Damping Disarmed; MotorLost"]),
        ("a motor has a fault", |robot| happens(|| robot.disturb("hip fault 0x40")),
            ["Disarmed", "Starting Damping Disarmed; MotorFault", "Active Damping Disarmed; MotorFault",
                "Damping Disarmed; MotorFault"]),
        ("the bus is off", |robot| happens(|| robot.disturb("can bus-off")),
            ["Disarmed", "Starting Damping Disarmed; BusOff", "Active Damping Disarmed; BusOff",
                "Damping Disarmed; BusOff"]),
        ("a cycle is late", |robot| happens(|| robot.oversleep(Duration::from_millis(10))),
            ["Disarmed", "Damping Disarmed; TimeBase", "Damping Disarmed; TimeBase", "Damping Disarmed; TimeBase"]),
    ];
    check(&TABLE, |phase| in_phase(PHASES[phase]), Robot::phase);
}

/// Returns a robot whose hip is in this mode.
fn in_mode(mode: MotorMode) -> Robot {
    let mut robot = match mode {
        MotorMode::Starting => in_phase(Phase::Starting),
        MotorMode::Active => in_phase(Phase::Active),
        MotorMode::Damping => in_phase(Phase::Damping),
        MotorMode::Offline | MotorMode::Idle | MotorMode::Fault | MotorMode::Excluded => {
            in_phase(Phase::Disarmed)
        }
    };
    match mode {
        MotorMode::Offline => robot.disturb("hip off"),
        MotorMode::Fault => robot.disturb("hip fault 0x40"),
        MotorMode::Excluded => drop(robot.operate(Operation::Exclude).expect("the group is disarmed")),
        _ => return robot,
    }
    robot.steps(300);
    assert_eq!(robot.mode(0), mode);
    robot
}

#[test]
fn motor_transitions_match_the_table() {
    use MotorMode::{Active, Damping, Excluded, Fault, Idle, Offline, Starting};
    #[rustfmt::skip]
    const TABLE: [(&str, Event, [&str; 7]); 10] = [
        ("it is off", |robot| happens(|| robot.disturb("hip off")),
            ["Offline", "Idle Offline", "Starting Offline; MotorLost", "Active Offline; MotorLost",
                "Damping Offline; MotorLost", "Fault Offline", "Excluded"]),
        ("nothing is wrong with it any more", |robot| happens(|| robot.disturb("hip ok")),
            ["Offline Idle", "Idle", "Starting Active", "Active", "Damping Idle", "Fault", "Excluded"]),
        ("it has a fault", |robot| happens(|| robot.disturb("hip fault 0x40")),
            ["Offline", "Idle Fault", "Starting Fault; MotorFault", "Active Fault; MotorFault",
                "Damping Fault; MotorFault", "Fault", "Excluded"]),
        ("its fault is cleared", |robot| ask(robot, Operation::ClearFault),
            ["MotorOffline: Offline", "Idle", "NotDisarmed: Starting Active", "NotDisarmed: Active",
                "NotDisarmed: Damping Idle", "Idle", "Excluded: Excluded"]),
        ("its zero is set", |robot| ask(robot, Operation::SetZero),
            ["MotorOffline: Offline", "Idle", "NotDisarmed: Starting Active", "NotDisarmed: Active",
                "NotDisarmed: Damping Idle", "MotorFault: Fault", "Excluded: Excluded"]),
        ("its group is enabled", |robot| ask(robot, Operation::Enable),
            ["MotorOffline: Offline", "Starting Active", "NotDisarmed: Starting Active", "NotDisarmed: Active",
                "NotDisarmed: Damping Idle", "MotorFault: Fault", "Excluded: Excluded"]),
        ("its group is disabled", |robot| ask(robot, Operation::Disable),
            ["Offline", "Idle", "Damping Idle", "Damping Idle", "Damping Idle", "Fault", "Excluded"]),
        ("another motor is off", |robot| happens(|| robot.disturb("knee off")),
            ["Offline", "Idle", "Starting Damping Idle; MotorLost", "Active Damping Idle; MotorLost",
                "Damping Idle; MotorLost", "Fault", "Excluded"]),
        ("it is excluded", |robot| ask(robot, Operation::Exclude),
            ["Excluded", "Excluded", "NotDisarmed: Starting Active", "NotDisarmed: Active",
                "NotDisarmed: Damping Idle", "Excluded", "Excluded"]),
        ("it is included", |robot| ask(robot, Operation::Include),
            ["Offline", "Idle", "NotDisarmed: Starting Active", "NotDisarmed: Active",
                "NotDisarmed: Damping Idle", "Fault", "Idle"]),
    ];
    let modes = [Offline, Idle, Starting, Active, Damping, Fault, Excluded];
    check(&TABLE, |mode| in_mode(modes[mode]), |robot| robot.mode(0));
}

// Joints that an operator excludes from their group.

fn of_joint(robot: &mut Robot, operation: Operation, joint: u32) -> Result<(), Refusal> {
    robot.operate_joint(operation, joint as usize).map(|_| ())
}

/// Returns three motors, of which the second may be excluded.
fn with_excludable_thigh() -> Robot {
    let mut settings = robot::three_motors();
    settings.motors[1].may_be_excluded = true;
    Robot::new(settings, 1)
}

#[test]
fn excluded_joint_receives_stops_only() {
    let mut robot = with_excludable_thigh();
    robot.disturb("thigh off");
    robot.steps(50);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    assert_eq!(robot.mode(1), MotorMode::Excluded);
    robot.claim().expect("the group is free");
    let mut joints = robot.hold(20.0, 1.0);
    // A controller that does not use the joint sends invalid values.
    joints[1] = JointSetpoint { position: f32::NAN, ..Default::default() };
    robot.follow(&joints);
    robot.operate(Operation::Enable).expect("it may be excluded");
    robot.follow_until(&joints, 200, |robot| robot.phase() == Phase::Active);
    robot.take_sent();
    for _ in 0..500 {
        robot.follow(&joints);
    }
    let sent = robot.take_sent();
    let to = |id| sent.iter().filter(move |sent| sent.id == id);
    assert!(to(2).all(|sent| sent.meaning == Meaning::Stop) && (4..=6).contains(&to(2).count()));
    assert!(
        to(1).chain(to(3)).all(|sent| matches!(sent.meaning, Meaning::Control { .. } | Meaning::GetFault))
    );
    assert_eq!((robot.phase(), robot.cause()), (Phase::Active, None));
}

#[test]
fn returning_excluded_joint_stays_stopped() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    let joints = robot.activate();
    for verb in ["thigh off", "thigh ok", "thigh fault 0x40", "thigh duplicate", "thigh garbage", "thigh ok"]
    {
        robot.disturb(verb);
        for _ in 0..300 {
            robot.follow(&joints);
        }
        assert_eq!((robot.phase(), robot.mode(1)), (Phase::Active, MotorMode::Excluded), "{verb}");
    }
    robot.operate(Operation::Disable).expect("anybody may");
    robot.steps(2500);
    of_joint(&mut robot, Operation::Include, 1).expect("the group is disarmed");
    robot.disturb("thigh power-cycle");
    robot.steps(1000);
    assert_eq!(robot.mode(1), MotorMode::Idle);
}

#[test]
fn only_spared_joints_may_be_missing_on_enable() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 0).expect("the group is disarmed");
    robot.claim().expect("the group is free");
    let joints = robot.hold(20.0, 1.0);
    robot.follow(&joints);
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::Excluded));
    assert_eq!(of_joint(&mut robot, Operation::SetZero, 0), Err(Refusal::Excluded));
    of_joint(&mut robot, Operation::Include, 0).expect("the group is disarmed");
    assert_eq!(of_joint(&mut robot, Operation::Exclude, 9), Err(Refusal::UnknownJoint));
}

#[test]
fn joint_of_moving_group_cannot_be_excluded() {
    let mut robot = with_excludable_thigh();
    let joints = robot.activate();
    for operation in [Operation::Exclude, Operation::Include] {
        robot.send(&joints);
        assert_eq!(of_joint(&mut robot, operation, 1), Err(Refusal::NotDisarmed));
    }
}

/// A setpoint for an excluded joint is not checked, so it is not used after the joint is included
/// again.
#[test]
fn ignored_setpoint_is_not_used_after_inclusion() {
    let mut robot = with_excludable_thigh();
    robot.steps(20);
    of_joint(&mut robot, Operation::Exclude, 1).expect("the group is disarmed");
    robot.claim().expect("the group is free");
    let mut joints = robot.hold(20.0, 1.0);
    joints[1].position = f32::NAN;
    robot.follow(&joints);
    of_joint(&mut robot, Operation::Include, 1).expect("the group is disarmed");
    robot.steps(5);
    assert_eq!(robot.operate(Operation::Enable), Err(Refusal::NoSetpoint));
}

// Goal: for any behaviour of a controller, the invariants of `verify/checker/src/run.rs` hold on
// the bytes that reach the motors.
// Method: seeded runs of a fuzzing client on virtual time: absurd values, NaN, stutter, silence,
// old messages and those of other owners, requests at the wrong time, and exit. A seed that fails
// is printed. `MOTORD_SEED=n` runs it alone, and `MOTORD_SEEDS=n` sets the number of seeds, a
// thousand by default.

#[test]
fn client_fuzz_never_sends_forbidden_frames() {
    robot::for_each_seed("robot client_fuzz", 1000, run);
}

/// Runs one controller, from its claim to some time after its exit.
fn run(seed: u64) {
    let mut random = Random::new(seed);
    let mut robot = Robot::new(robot::three_motors(), seed);
    let mut checker = Checker::new(&robot);
    let mut controller = FuzzClient::new(0);
    for _ in 0..10 {
        robot.step();
        checker.check(&mut robot);
    }
    controller.claim(&mut robot);
    let death = 100 + random.below(400);
    for cycle in 0..death + 2500 {
        if cycle > 0 && cycle < death {
            if random.once_in(50) {
                controller.request(&mut random, &mut robot, &mut checker);
            }
            controller.misbehave(&mut random, &mut robot, &mut checker);
        }
        robot.step();
        checker.check(&mut robot);
        while let Some((ticket, reply)) = robot.take_answer() {
            controller.receive_reply(&mut robot, ticket, &reply);
        }
    }
    assert_eq!(robot.phase(), Phase::Disarmed, "a dead controller's group is stopped");
}
