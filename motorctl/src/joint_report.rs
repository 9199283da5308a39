//! A joint as `status` and `watch` print it.

use motord_client::{Joint, JointDescription, Limit, MotorMode};
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
    ([Optional]) => { Option<f32> };
    ([Set Limit]) => { Vec<&'static str> };
    ([Set Fault]) => { Vec<String> };
    ([Code $code:ident]) => { &'static str };
    ([Count]) => { u32 };
    ([Latency]) => { f64 };
}

/// The value of a row's kind in JSON.
macro_rules! json {
    ([Set Limit], $limits:expr) => {
        $limits.iter().map(Limit::name).collect()
    };
    ([Set Fault], $faults:expr) => {
        $faults.names().collect()
    };
    ([Code $code:ident], $code_or_none:expr) => {
        $code_or_none.map_or(UNKNOWN, $code::name)
    };
    ([Latency], $latency:expr) => {
        $latency.as_secs_f64() * 1e6
    };
    ([$kind:ident], $value:expr) => {
        $value
    };
}

macro_rules! define {
    (
        measured { $(#[doc = $measured_doc:literal] $measured:ident, unit $measured_unit:literal, json $measured_json:ident, proto $measured_number:literal;)+ }
        fields { $(
            #[doc = $doc:literal] $name:ident: $type:ident, $kind:tt $(, unit $unit:literal)?
            $(, view $view:ident $(, json $json:ident)?)? $(, proto $proto:ident = $number:literal)?;
        )+ }
        flags { $(#[doc = $flag_doc:literal] $flag:ident: $bits:ident $(, json $flag_json:ident)? $(, proto $flag_number:literal)?;)+ }
    ) => {
        /// A joint: its state and its limits.
        #[derive(Debug, Clone, Default, Serialize)]
        pub(crate) struct JointReport {
            pub(crate) name: String,
            pub(crate) bus: String,
            $(#[doc = $measured_doc] pub(crate) $measured_json: Option<f32>,)+
            $($($(#[doc = $doc] pub(crate) $json: json_type!($kind),)?)?)+
            $($(#[doc = $flag_doc] pub(crate) $flag_json: bool,)?)+
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
                    $($measured_json: joint.$measured(),)+
                    $($($($json: json!($kind, joint.$view),)?)?)+
                    $($($flag_json: joint.$flag,)?)+
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

motord_client::joint_state!(define);

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
