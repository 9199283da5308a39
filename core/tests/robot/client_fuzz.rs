//! Goal: for any behaviour of a controller, the invariants of `verify/checker/src/run.rs` hold on
//! the bytes that reach the motors.
//! Method: seeded runs of a fuzzing client on virtual time: absurd values, NaN, stutter, silence,
//! old messages and those of other owners, requests at the wrong time, and exit. A seed that fails
//! is printed. `MOTORD_SEED=n` runs it alone, and `MOTORD_SEEDS=n` sets the number of seeds, a
//! thousand by default.

use motord_harness::robot;
use motord_harness::robot::Robot;
use motord_harness::robot::checker::Checker;
use motord_harness::robot::fuzz_client::FuzzClient;
use motord_harness::robot::random::Random;
use motord_shared::Phase;

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
