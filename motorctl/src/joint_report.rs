//! A joint as `status` and `watch` print it.

use motord_client::{Joint, JointDescription, Limit, MotorMode};
use motord_terminal::{Cell, Colour, Table};
use serde::Serialize;
use std::collections::BTreeMap;

/// A word that this version does not know: the daemon is newer.
pub(crate) const UNKNOWN: &str = "unknown";

/// An indicator of a motor, motor side.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct IndicatorReport {
    pub(crate) value: f32,
    pub(crate) unit: &'static str,
}

/// The type of a row's kind in JSON.
macro_rules! json_type {
    ([Measured]) => { Option<f32> };
    ([Optional]) => { Option<f32> };
    ([Set Limit]) => { Vec<&'static str> };
    ([Set Fault]) => { Vec<String> };
    ([Code $code:ident]) => { &'static str };
    ([Count]) => { u32 };
    ([Latency]) => { f64 };
    ([Flag $bits:ident]) => { bool };
}

/// The value of a row's kind in JSON.
macro_rules! json {
    ([Measured] $joint:ident $view:ident) => {
        $joint.$view()
    };
    ([Set Limit] $joint:ident $view:ident) => {
        $joint.$view.iter().map(Limit::name).collect()
    };
    ([Set Fault] $joint:ident $view:ident) => {
        $joint.$view.names().collect()
    };
    ([Code $code:ident] $joint:ident $view:ident) => {
        $joint.$view.map_or(UNKNOWN, $code::name)
    };
    ([Latency] $joint:ident $view:ident) => {
        $joint.$view.as_secs_f64() * 1e6
    };
    ($kind:tt $joint:ident $view:ident) => {
        $joint.$view
    };
}

macro_rules! define {
    ($({ $doc:literal $kind:tt $view:ident $key:ident })+) => {
        /// A joint: its state and its limits.
        #[derive(Debug, Clone, Default, Serialize)]
        pub(crate) struct JointReport {
            pub(crate) name: String,
            pub(crate) bus: String,
            $(#[doc = $doc] pub(crate) $key: json_type!($kind),)+
            /// Lowest and highest position that its limits allow.
            pub(crate) position_range_rad: [f32; 2],
            /// Largest torque that its limits allow.
            pub(crate) torque_max_nm: f32,
            /// Its position is outside the positions that its setpoints may have: its group cannot
            /// be enabled.
            pub(crate) outside_limits: bool,
            /// The obstacle to its motion, and what helps; `null` when there is none.
            pub(crate) advice: Option<String>,
            /// By name, those that are known. Only native motors have some.
            #[serde(skip_serializing_if = "BTreeMap::is_empty")]
            pub(crate) indicators: BTreeMap<&'static str, IndicatorReport>,
        }

        impl From<(&JointDescription, Joint)> for JointReport {
            fn from((description, joint): (&JointDescription, Joint)) -> Self {
                let outside = |position| !description.limits.allow(position);
                Self {
                    name: description.name.clone(),
                    bus: description.bus.clone(),
                    $($key: json!($kind joint $view),)+
                    position_range_rad: description.limits.position,
                    torque_max_nm: description.limits.torque,
                    outside_limits: joint.position().is_some_and(outside),
                    advice: None,
                    indicators: BTreeMap::new(),
                }
            }
        }
    };
}

motord_client::joint_state!(json define);

impl JointReport {
    pub(crate) fn trouble(&self) -> Option<String> {
        let name = &self.name;
        if self.mode == MotorMode::Offline.name() {
            Some(format!("{name} does not answer."))
        } else if !self.faults.is_empty() {
            Some(format!("{name} reports {}.", self.faults.join(", ")))
        } else if self.mismatch {
            Some(format!(
                "{name} differs from its configuration, or has not reported its registers, and is not enabled."
            ))
        } else {
            (self.mode == MotorMode::Fault.name()).then(|| format!("{name} reports a fault."))
        }
    }
}

/// The heading of a column that is left out where no motor reports its supply.
const SUPPLY: &str = "V";

pub(crate) fn joint_table(joints: &[JointReport]) -> Table {
    let mut table = Table::new(&[
        "joint",
        "mode",
        "rad",
        "rad/s",
        "N·m",
        "°C",
        SUPPLY,
        "age",
        "missed",
        "late",
        "implausible",
        "foreign",
        "clamped",
        "faults",
        "limits",
    ]);
    for joint in joints {
        let known = |value: Option<f32>, digits| Cell::number(value.map(f64::from), digits);
        table.row(vec![
            Cell::plain(&joint.name),
            Cell::new(joint.mode, mode_colour(joint.mode)),
            position(joint),
            known(joint.velocity_rad_s, 2),
            known(joint.torque_nm, 2),
            known(joint.temperature_celsius, 0),
            known(joint.supply_voltage_v, 1),
            Cell::counter(joint.age_cycles),
            Cell::counter(joint.missed),
            Cell::counter(joint.late),
            Cell::counter(joint.implausible),
            Cell::counter(joint.foreign_commands),
            Cell::counter(joint.clamped),
            Cell::new(joint.faults.join(","), Colour::Red),
            Cell::new(joint.limits.join(","), Colour::Magenta),
        ]);
    }
    if joints.iter().all(|joint| joint.supply_voltage_v.is_none()) {
        table.remove(SUPPLY);
    }
    table
}

/// Formats the position, with a mark if it is outside its limits.
fn position(joint: &JointReport) -> Cell {
    match joint.position_rad.filter(|_| joint.outside_limits) {
        Some(position) => Cell::new(format!("{position:.3}!"), Colour::Red),
        None => Cell::number(joint.position_rad.map(f64::from), 3),
    }
}

fn mode_colour(mode: &str) -> Colour {
    if mode == MotorMode::Fault.name() || mode == MotorMode::Offline.name() {
        Colour::Red
    } else {
        Colour::Plain
    }
}
