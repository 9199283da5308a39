//! Goal: whatever a controller does, the invariants of `robot/witness.rs` hold on the bytes that reach the motors.
//! Method: seeded lives of a rough controller on virtual time: absurd values, NaN, stutter, silence, old and foreign
//! messages, requests at the wrong time, and death. A seed that fails is printed; `MOTORD_SEED=n` runs it alone, and
//! `MOTORD_SEEDS=n` runs more than the thousand.

mod robot;

use motord_shared::Phase;
use robot::Robot;
use robot::random::Random;
use robot::rough::Rough;
use robot::witness::Witness;

#[test]
fn whatever_a_controller_does_no_motor_hears_what_it_must_not() {
    robot::for_each_seed("lives", 1000, live);
}

/// One controller, from its claim to well after its death.
fn live(seed: u64) {
    let mut random = Random::new(seed);
    let mut robot = Robot::new(robot::three_motors(), seed);
    let mut witness = Witness::new(&robot);
    let mut controller = Rough::new(0);
    for _ in 0..10 {
        robot.step();
        witness.judge(&mut robot);
    }
    controller.claim(&mut robot);
    let death = 100 + random.below(400);
    for cycle in 0..death + 2500 {
        if cycle > 0 && cycle < death {
            if random.once_in(50) {
                controller.request(&mut random, &mut robot, &mut witness);
            }
            controller.misbehave(&mut random, &mut robot, &mut witness);
        }
        robot.step();
        witness.judge(&mut robot);
        while let Some((ticket, reply)) = robot.take_answer() {
            controller.hear(&mut robot, ticket, &reply);
        }
    }
    assert_eq!(robot.phase(), Phase::Disarmed, "a dead controller's group is stopped");
}
