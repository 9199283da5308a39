//! Joints that the equation does not describe: their intervals contain the truth, or the joint is
//! named.

use crate::excited::{SHAPE, excited};
use crate::identified;
use crate::plant::{Extra, Hidden, NOMINAL, draw_kind};
use motord_identify::{Identified, Note, Shape, Value, Why, identify};

/// The mechanical values: the truth, and what was identified.
fn values(hidden: &Hidden, found: &Identified) -> [(&'static str, f64, Value); 6] {
    [
        ("inertia", hidden.inertia, found.inertia),
        ("viscous", hidden.viscous, found.viscous),
        ("Coulomb", hidden.coulomb, found.coulomb),
        ("stiction", hidden.stiction, found.stiction),
        ("sine", hidden.sine, found.gravity_sine),
        ("cosine", hidden.cosine, found.gravity_cosine),
    ]
}

fn contains(value: &Value, truth: f64) -> bool {
    (value.lower..=value.upper).contains(&truth)
}

/// Intervals of what is identified, those that contain the truth, and the joints that do not fit.
fn counted(seeds: impl Iterator<Item = u64>) -> [u32; 3] {
    let mut counts = [0; 3];
    for seed in seeds {
        let hidden = draw_kind(seed);
        let found = identified(&hidden, seed);
        let is_misfit = found.notes.iter().any(|note| matches!(note, Note::Misfit(_)));
        println!("joint {seed}, {:?}: {:?}", hidden.extra, found.notes);
        for (name, truth, value) in values(&hidden, &found) {
            let Value { value: estimate, lower, upper, why } = value;
            let is_inside = contains(&value, truth);
            let verdict =
                why.map_or_else(|| if is_inside { "" } else { "OUTSIDE" }.to_owned(), |why| why.to_string());
            println!("  {name:9} {truth:9.6} {estimate:9.6} [{lower:9.6}, {upper:9.6}] {verdict}");
            assert!(!is_misfit || why.is_some(), "a joint that does not fit has no values");
            counts[0] += u32::from(why.is_none());
            counts[1] += u32::from(why.is_none() && is_inside);
        }
        counts[2] += u32::from(is_misfit);
    }
    println!("{} of {} intervals contain the truth; {} joints do not fit", counts[1], counts[0], counts[2]);
    counts
}

/// Goal: of what is called identified, 95 % contain the truth, whatever else the joint has. Method:
/// a joint of each kind: plain, gravity, cogging, Stribeck, backlash, ripple, lag, filtered
/// encoder.
#[test]
fn intervals_cover_or_joint_is_named() {
    let [identified, covered, misfits] = counted(8..16);
    assert!(f64::from(covered) >= 0.95 * f64::from(identified), "{covered} of {identified}");
    assert!(identified >= 24 && misfits >= 1, "{identified} intervals, {misfits} misfits");
}

/// The same for 60 joints.
#[test]
#[ignore = "60 joints take minutes: run it with --ignored"]
fn intervals_of_sixty_joints_cover_truth() {
    let [identified, covered, _] = counted(1..=60);
    assert!(f64::from(covered) >= 0.95 * f64::from(identified), "{covered} of {identified}");
    assert!(identified >= 200, "{identified}");
}

/// Goal: a play of 0.06 rad is named, not printed as a smaller inertia.
/// Method: a pendulum of 1 kg at 0.25 m behind the play.
#[test]
fn play_is_named_and_no_inertia_printed() {
    let play = Extra::Backlash(0.06, 0.1);
    let pendulum =
        Hidden { inertia: 0.067, sine: 2.453, coulomb: 0.1, stiction: 0.1, extra: play, ..NOMINAL };
    let found = identified(&pendulum, 3);
    assert!(found.notes.iter().any(|note| matches!(note, Note::Misfit(_))), "{found:?}");
    for (name, _, value) in values(&pendulum, &found) {
        assert_eq!(value.identified(), None, "{name}: {value:?}");
    }
    assert_eq!(found.inertia.why, Some(Why::Misfit));
}

/// Goal: a spring is named, and is no gravity. Method: a pendulum with a spring of 8 N·m/rad. Over
/// a small motion spring and gravity look alike.
#[test]
fn spring_is_named_and_is_no_gravity() {
    let spring = Extra::Spring(8.0);
    let pendulum =
        Hidden { inertia: 0.067, sine: 2.453, coulomb: 0.1, stiction: 0.1, extra: spring, ..NOMINAL };
    let found = identified(&pendulum, 3);
    let named = found.spring.as_ref().is_some_and(|spring| contains(spring, 8.0));
    assert!(named && found.notes.iter().any(|note| matches!(note, Note::Spring(_))), "{found:?}");
    for amplitude in [None, Some(0.06)] {
        let shape = Shape { amplitude, ..SHAPE };
        let (samples, twin) = excited(&pendulum, 4, shape, f64::INFINITY);
        let found = identify(&samples, pendulum.wire(&twin));
        for (name, truth, value) in values(&pendulum, &found) {
            assert!(
                value.why.is_some() || contains(&value, truth),
                "{amplitude:?}: {name} {truth}: {value:?}"
            );
        }
    }
}

/// Goal: a torque by position is named. Gravity, which is part of it, is not separated; the other
/// values are.
#[test]
fn cogging_is_named_and_hides_only_gravity() {
    let gear = Hidden { extra: Extra::Cogging(0.15, 40.0), ..NOMINAL };
    let found = identified(&gear, 6);
    assert!(found.notes.contains(&Note::Position), "{found:?}");
    for value in [found.gravity_sine, found.gravity_cosine, found.offset] {
        assert_eq!(value.why, Some(Why::Separation), "{value:?}");
    }
    for (name, truth, value) in &values(&gear, &found)[..3] {
        assert!(value.why.is_none() && contains(value, *truth), "{name} {truth}: {value:?}");
    }
}

/// Goal: the friction of a harmonic gear does not change its viscous part.
#[test]
fn stribeck_friction_is_a_term_of_its_own() {
    let stribeck = Extra::Stribeck(0.2, 0.3);
    let gear = Hidden { stiction: 0.5, extra: stribeck, ..NOMINAL };
    let found = identified(&gear, 5);
    let falls = found.stribeck.as_ref().is_some_and(|value| contains(value, 0.2));
    assert!(falls && found.notes.iter().any(|note| matches!(note, Note::Stribeck(_))), "{found:?}");
    for (name, truth, value) in values(&gear, &found) {
        assert!(value.why.is_some() || contains(&value, truth), "{name} {truth}: {value:?}");
    }
    let viscous = found.viscous.identified().unwrap_or(f64::NAN);
    assert!((viscous / gear.viscous - 1.0).abs() < 0.1, "{viscous}");
}
