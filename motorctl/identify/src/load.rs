//! The scale of the torque, from a load that is known.

use crate::interval::Value;

/// The load that was added to the joint between two identifications.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLoad {
    /// Its inertia about the axis of the joint, kg·m².
    pub inertia: f64,
}

/// Returns the true torque by the torque that the motor reports. A motor that gives less than it
/// reports needs more of it for the same load: the difference of the identified inertias is too
/// large by the same factor.
#[must_use]
pub fn torque_scale(without: &Value, with: &Value, load: KnownLoad) -> Value {
    let (Some(before), Some(after)) = (without.identified(), with.identified()) else {
        return without.why.or(with.why).map_or(Value::around(f64::NAN, 0.0), Value::none);
    };
    let difference = after - before;
    let half = without.half().hypot(with.half());
    let scale = load.inertia / difference;
    if difference.abs() <= half {
        return Value::within(scale, f64::NEG_INFINITY, f64::INFINITY);
    }
    let ends = [load.inertia / (difference + half), load.inertia / (difference - half)];
    Value::within(scale, ends[0].min(ends[1]), ends[0].max(ends[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scale_is_load_by_difference() {
        let [without, with] = [0.02, 0.045].map(|value| Value::around(value, 0.0003));
        let scale = torque_scale(&without, &with, KnownLoad { inertia: 0.02 });
        assert!((scale.value - 0.8).abs() < 1e-12 && scale.why.is_none(), "{scale:?}");
        assert!(scale.lower < 0.79 && scale.upper > 0.81 && scale.half() < 0.02, "{scale:?}");
        let same = torque_scale(&with, &with, KnownLoad { inertia: 0.02 });
        assert!(same.identified().is_none(), "{same:?}");
    }
}
