//! The configuration as it is written: every key optional, every value with its place, nothing judged but its type.

use serde::Deserialize;
use toml::Spanned;

use motord_core::settings::{BeyondRange, FaultPolicy, IpcMode, MotorProtocol, SafeStop};

pub(super) type Number = Option<Spanned<f64>>;
pub(super) type Integer = Option<Spanned<i64>>;
pub(super) type Text = Option<Spanned<String>>;

/// Declares sections: structs of optional keys, in kebab-case, unknown keys refused.
macro_rules! sections {
    ($($(#[$doc:meta])* $section:ident { $($key:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
        pub(super) struct $section { $(pub(super) $key: $type,)* }
    )*};
}

sections! {
    /// The whole file.
    Document {
        daemon: Daemon,
        cycle: Cycle,
        exchange: Exchange,
        safety: Safety,
        bus: Vec<Spanned<Bus>>,
        motor: Vec<Spanned<Motor>>,
        group: Vec<Spanned<Group>>,
    }
    /// `[daemon]`.
    Daemon {
        instance: Text,
    }
    /// `[cycle]`.
    Cycle {
        rate_hz: Number,
        cpu: Integer,
        priority: Integer,
        require_realtime: Option<Spanned<bool>>,
        max_lateness_ms: Number,
        max_skipped_percent: Number,
        reply_deadline_percent: Number,
        busy_poll_us: Number,
    }
    /// `[exchange]`.
    Exchange {
        mode: Option<IpcMode>,
        lead_us: Number,
        cpu: Integer,
        priority: Integer,
    }
    /// `[safety]`.
    Safety {
        setpoint_timeout_ms: Number,
        safe_stop: Option<SafeStop>,
        damp_seconds: Number,
        rest_velocity_rad_s: Number,
        lost_cycles: Integer,
        start_jump_rad: Number,
        start_ramp_ms: Number,
        start_timeout_ms: Number,
        fault_poll_hz: Number,
        deadman_ms: Number,
        error_feedback: Option<bool>,
    }
    /// `[[bus]]`, the keys of every type.
    Bus {
        name: Text,
        r#type: Option<Spanned<BusType>>,
        interface: Text,
        bitrate: Integer,
        device: Text,
        baud: Integer,
        seed: Integer,
    }
    /// `[[motor]]`.
    Motor {
        name: Text,
        bus: Text,
        id: Integer,
        host_id: Integer,
        protocol: Option<Spanned<MotorProtocol>>,
        model: Text,
        torque_constant_nm_per_a: Number,
        gear_ratio: Number,
        rated_torque_nm: Number,
        peak_torque_nm: Number,
        overload_seconds: Number,
        max_velocity_rad_s: Number,
        direction: Integer,
        offset_rad: Number,
        damping_kd: Number,
        beyond_range: Option<BeyondRange>,
        fault_policy: Option<FaultPolicy>,
        limits: Limits,
        simulation: Simulation,
    }
    /// `[motor.limits]`.
    Limits {
        position_rad: Option<Spanned<Vec<f64>>>,
        velocity_rad_s: Number,
        torque_nm: Number,
        kp_max: Number,
        kd_max: Number,
        torque_slew_nm_per_s: Number,
        kp_slew_per_s: Number,
        kd_slew_per_s: Number,
        temperature_derate_celsius: Number,
        temperature_max_celsius: Number,
        following_error_rad: Number,
    }
    /// `[motor.simulation]`.
    Simulation {
        initial_position_rad: Number,
        load_inertia_kg_m2: Number,
        reply_latency_us: Number,
    }
    /// `[[group]]`.
    Group {
        name: Text,
        joints: Option<Spanned<Vec<Spanned<String>>>>,
        safe_stop: Option<SafeStop>,
    }
}

/// `type` of a `[[bus]]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum BusType {
    SocketCan,
    Serial,
    Simulated,
}

impl BusType {
    /// As it is written.
    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::SocketCan => "socketcan",
            Self::Serial => "serial",
            Self::Simulated => "simulated",
        }
    }
}
