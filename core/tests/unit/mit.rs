//! The error of the torque code, which is carried on from frame to frame.

use super::*;
use proptest::collection::vec;
use proptest::prelude::*;

/// Of the GIM8108-8, by the MIT document 1.1.
fn scales() -> Scales {
    Scales::by_current(0.125, 8.0).unwrap()
}

#[test]
fn the_mean_of_a_thousand_frames_is_within_a_thousandth_of_a_code() {
    let scales = scales();
    let code = 2.0 * f64::from(scales.full_scale()) / 4095.0;
    for thirds in -30..30 {
        let torque = (f64::from(thirds) * 0.3 * code) as f32;
        let exact = exact(torque, &scales);
        let mut feedback = Feedback::within(20.0, &scales);
        let codes: Vec<f64> = (0..1000).map(|_| f64::from(feedback.quantise(torque, &scales))).collect();
        let mean = codes.iter().sum::<f64>() / 1000.0;
        assert!((mean - exact).abs() <= 0.001, "{exact} became {mean}");
    }
}

proptest! {
    #[test]
    fn the_mean_of_many_frames_is_the_torque_asked_for(
        before in vec(-19.0_f32..19.0, 0..5),
        torque in -19.0_f32..19.0,
        frames in 1_u16..2000,
    ) {
        let scales = scales();
        let exact = exact(torque, &scales);
        let mut feedback = Feedback::within(20.0, &scales);
        for torque in before {
            feedback.quantise(torque, &scales);
        }
        let mut sum = 0.0;
        for _ in 0..frames {
            let code = f64::from(feedback.quantise(torque, &scales));
            prop_assert!((code - exact).abs() < 1.0, "{} is no neighbour of {}", code, exact);
            sum += code;
        }
        let frames = f64::from(frames);
        prop_assert!((sum / frames - exact).abs() <= 1.0 / frames + 1e-9);
    }

    #[test]
    fn no_code_asks_for_more_torque_than_the_joint_may_have(
        limit in 0.06_f32..25.0,
        shares in vec(-1.0_f32..=1.0, 1..50),
    ) {
        let scales = scales();
        let mut feedback = Feedback::within(limit, &scales);
        for share in shares.into_iter().chain([1.0, 1.0, -1.0, -1.0]) {
            let code = feedback.quantise(share * limit, &scales);
            prop_assert!(scales.torque.decode(code).abs() <= f64::from(limit) + 1e-6, "{}", share);
        }
    }
}

#[test]
fn a_position_that_wraps_goes_on() {
    let mut unwrap = Unwrap::new(scales().position);
    let turn = unwrap.period;
    let mut turned = 0.0_f32;
    for _ in 0..1000 {
        turned += 0.11;
        let reported = (turned + turn / 2.0).rem_euclid(turn) - turn / 2.0;
        assert!((unwrap.position(reported) - turned).abs() < 1e-3, "at {turned}");
    }
}
