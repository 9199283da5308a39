//! The effect of every event in every state of a group and of a motor. The diagrams are above
//! `Group` and `Motor` in `core/src/control`.

use motord_bus::Duration;
use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_shared::{AdminRequest, MotorMode, Operation, Phase, Refusal};

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
