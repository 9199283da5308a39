//! Whether a report can be true.

use super::*;

#[test]
fn a_speed_at_the_end_of_its_code_is_overspeed_and_one_at_the_highest_limit_is_not() {
    // RS00: the code ends at 33 rad/s, and so high a limit is the default.
    let (end, limit) = (33.0, 0.995 * 33.0);
    let threshold = overspeed(limit, Some(end));
    assert!(limit < threshold && threshold < end, "{threshold}");
    assert!((overspeed(20.0, Some(end)) - 24.0).abs() < 1e-4);
    assert!((overspeed(limit, None) - 1.2 * limit).abs() < 1e-4);
}

#[test]
fn a_temperature_that_no_motor_can_have_is_never_believed() {
    // Five degrees of frost, read without a sign: Damiao's 0xFB, RobStride's 0xFFCE.
    for celsius in [251.0, 6548.6] {
        let reported = Measured::new(0.0, 0.0, 0.0, Some(celsius));
        let warm = Measured::new(0.0, 0.0, 0.0, Some(1.0));
        let mut plausibility = Plausibility::default();
        for _ in 0..100 {
            assert_eq!(plausibility.believable_temperature(&reported, None), None);
            let before = Some((&warm, Instant::ZERO));
            assert_eq!(plausibility.believable_temperature(&reported, before), Some(1.0));
        }
    }
}
