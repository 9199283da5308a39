//! The table of keys: name, type, unit, default, range and meaning of every key.
//!
//! The parser and the error messages use this table, and `docs/configuration.md` is written from
//! it. A row is: name, field, type, unit = default and range, meaning. The texts are Markdown.
//!
//! The defaults are cautious and meant for a real robot. A shared machine needs longer times.

use motord_protocol::MotorProtocol;
use motord_settings::sensor::imu::WhenLost;
use motord_settings::settings::{BeyondRange, FaultPolicy, IpcMode, SafeStop};

use std::net::SocketAddr;
use std::path::PathBuf;

use super::entry::{Entry, Item, Row, follows, is, required, required_choice};
use super::table::{Section, Sections, Table};
use super::value::{BusType, ImuType, Listed};

/// Advice about a negative constant of a motor.
const REVERSED: &str = "a joint that turns against its motor has direction = -1";

/// Declares sections: a struct per section, one [`Entry`] per key.
macro_rules! sections {
    ($($(#[$doc:meta])* $Section:ident $path:literal {
        $($key:literal $field:ident: $type:ty, $unit:literal = $rule:expr, $meaning:literal;)*
    })*) => {
        $(
            $(#[$doc])*
            pub(super) struct $Section { $(pub(super) $field: Entry<$type>,)* }

            impl Section for $Section {
                const PATH: &'static str = $path;
                const KEYS: &'static [&'static str] = &[$($key),*];
                const UNITS: &'static [&'static str] = &[$($unit),*];

                fn read(table: &mut Table<'_, '_, '_>) -> Self {
                    Self { $($field: table.entry($key, $unit, $rule),)* }
                }
            }
        )*

        /// Path and keys of every section.
        pub(super) const SECTIONS: Sections = &[$(($path, $Section::KEYS)),*];

        /// Returns the row of a key.
        pub(super) fn row(section: &str, key: &str) -> Option<Row> {
            match (section, key) {
                $($(($path, $key) => Some(Row::new::<$type>($key, $unit, $rule, $meaning)),)*)*
                _ => None,
            }
        }

        /// Path and rows of every section.
        pub(super) fn reference() -> Vec<(&'static str, Vec<Row>)> {
            vec![$(($path, vec![$(Row::new::<$type>($key, $unit, $rule, $meaning)),*])),*]
        }
    };
}

sections! {
    /// `[daemon]`.
    Daemon "daemon" {
        "instance" instance: Option<String>, "" = follows("`\"robot\"`").words("a-z, 0-9, `-`"),
            "Name of this daemon for its clients. Two daemons on one computer need two names.";
    }

    /// `[cycle]`.
    Cycle "cycle" {
        "rate-hz" rate_hz: f64, "Hz" = is(1000.0).within(1.0, 10_000.0),
            "Cycles per second. A rate at which the last reply of a bus is expected after `reply-deadline-percent` is refused. `motord check` prints the highest rate of each bus: 2588 Hz for one MIT motor on a CAN bus of 1 Mbit/s, 1085 Hz for three. A warning below 50 Hz, also where `every` of a bus makes its motors slower: a stop reaches a motor with its next command.";
        "cpu" cpu: Option<i64>, "" = follows("none").words("an online processor"),
            "Processor that the cycle is pinned to.";
        // Kernel threads use 99.
        "priority" priority: i64, "" = is(80).within(1.0, 98.0),
            "`SCHED_FIFO` priority of the cycle. 99 belongs to the kernel.";
        "require-realtime" require_realtime: bool, "" = is(false),
            "`true`: motord refuses to run without `SCHED_FIFO` and locked memory. `false`: it reports that and runs.";
        "max-lateness-ms" max_lateness_ms: f64, "ms" = is(5.0).within(0.1, 1000.0),
            "A cycle that begins later than this has lost its time base: safe stop.";
        // A stall of a second, where `max-lateness-ms` allows it, is no overload yet.
        "max-skipped-percent" max_skipped_percent: f64, "%" = is(50.0).within(1.0, 100.0),
            "Largest share of missed ticks, averaged over a second. Above it the computer is too slow: safe stop. 100 never stops.";
        "reply-deadline-percent" reply_deadline_percent: f64, "%" = is(80.0).within(10.0, 95.0),
            "Share of the period. A reply that comes later is missed.";
        "indicator-hz" indicator_hz: f64, "Hz" = is(1.0).within(0.0, 10.0),
            "Rate at which the cycle requests each indicator of a GIM motor (GIM document, table 10), if its bus has time. 0 never asks; a rate between 0 and 0.01 Hz counts as 0.01 Hz. The supply is requested eight times as often, also from a motor with the protocol `robstride`, `cansimple` or `myactuator`. The state has the indicators of the first 16 native motors of the file; MIT motors have none.";
        "busy-poll-us" busy_poll_us: Option<f64>, "µs" = follows("30 with `cpu`, else 0").within(0.0, 1000.0),
            "When the last replies of a cycle usually arrive, the cycle polls the buses for at most this time, to publish them immediately. Shorter than a cycle. 0 never polls. Costs and gains: [decision 49](adr/0049-when-the-cycle-and-the-ipc-thread-wake.md).";
    }

    /// `[ipc]`, in older files `[exchange]`.
    Ipc "ipc" {
        "mode" mode: IpcMode, "" = is(IpcMode::Timed),
            "`timed` wakes when states are ready and before each cycle. `spin` polls, and needs a separate processor.";
        "lead-us" lead_us: f64, "µs" = is(20.0).within(10.0, 10_000.0),
            "Setpoints that are sent until this long before a cycle are used in it. Shorter than a cycle.";
        "busy-poll-us" busy_poll_us: f64, "µs" = is(60.0).within(0.0, 1000.0),
            "`timed`: while a group has an owner, the ipc thread polls for the states of each cycle for at most this time, to publish them immediately. Shorter than a cycle. 0 never polls. Costs and gains: [decision 49](adr/0049-when-the-cycle-and-the-ipc-thread-wake.md).";
        "cpu" cpu: Option<i64>, "" = follows("none").words("an online processor"),
            "Processor that the IPC thread is pinned to. With `spin` not that of the cycle.";
        "priority" priority: Option<i64>, "" = follows("70, or below the cycle; 0 with `spin`").within(0.0, 98.0),
            "`SCHED_FIFO` priority of the IPC thread, where it is permitted. 0 is a normal priority.";
    }

    /// `[telemetry]`.
    Telemetry "telemetry" {
        "prometheus-file" prometheus_file: Option<PathBuf>, "" = follows("none").words("an absolute path that ends with `.prom`"),
            "File with the metrics for the textfile collector of Prometheus' node exporter. Replaced every 5 s.";
        "prometheus-listen" prometheus_listen: Option<SocketAddr>, "" = follows("none").words("a loopback address with its port"),
            "Such as `127.0.0.1:9464`: the metrics by HTTP, at `/metrics`, for a Prometheus on this computer.";
        "prometheus-hosts" prometheus_hosts: Option<Vec<String>>, "" = follows("none").words("host names without a port"),
            "Names in the Host field of a request that are served besides `localhost` and loopback addresses, such as the name of a reverse proxy. A request with another name is refused with status 421, so that no web page reads the metrics under a name of its own.";
    }

    /// `[safety]`.
    Safety "safety" {
        "setpoint-timeout-ms" setpoint_timeout_ms: Option<f64>, "ms" = follows("20, or 2 cycles").within(1.0, 1000.0),
            "A group whose owner sends no valid setpoint for this long is stopped. At least 2 cycles. Three periods of the controller: [slow controllers](slow-controllers.md).";
        "setpoint-horizon-max-ms" setpoint_horizon_max_ms: f64, "ms" = is(40.0).within(0.0, 1000.0),
            "The longest horizon of setpoints: a slow controller may have the cycle move to its setpoints over such a time. The timeout begins at its end, so a controller that hangs is followed for this long more. 0 permits none.";
        "safe-stop" safe_stop: SafeStop, "" = is(SafeStop::Damp),
            "Reaction of a group to a cause. `damp`: kp 0, kd `damping-kd`, torque 0, or of a GIM motor a speed that falls to 0; then stop. `hold`: hold the measured position for `damp-seconds`, then damp and stop. `stop`: limp immediately.";
        "damp-seconds" damp_seconds: f64, "s" = is(2.0).within(0.1, 30.0),
            "The longest time that motors are damped before they are stopped.";
        "rest-velocity-rad-s" rest_velocity_rad_s: f64, "rad/s" = is(0.2).within(0.01, 10.0),
            "A damped joint slower than this is at rest, and is stopped.";
        "lost-cycles" lost_cycles: i64, "" = is(10).within(3.0, 1000.0),
            "A motor that misses this many replies in a row is lost. On a bus with `every = N` these are N times as many cycles.";
        "supply-warn-v" supply_warn_v: f64, "V" = is(0.0).within(0.0, 1000.0),
            "The log warns while most motors of a group report a supply below this for 2 s. Of the motors that report it: protocols `gim`, `robstride`, `cansimple`, `myactuator`, which motord asks eight times as often as `indicator-hz`; `odrive`, as it is set up. 0 does not watch it.";
        "supply-stop-v" supply_stop_v: f64, "V" = is(0.0).within(0.0, 1000.0),
            "As `supply-warn-v`, but the group is stopped (`supply-low`), and cannot be enabled. Above the voltage at which the drives switch off by themselves: then no motor damps the fall. Below `supply-warn-v`. 0 never stops.";
        "start-jump-rad" start_jump_rad: f64, "rad" = is(0.1).within(0.001, 3.2),
            "A group does not start while a position setpoint is farther than this from its joint.";
        "start-ramp-ms" start_ramp_ms: f64, "ms" = is(100.0).within(10.0, 10_000.0),
            "The gains rise from zero over this time after a start.";
        "start-timeout-ms" start_timeout_ms: f64, "ms" = is(1000.0).within(10.0, 10_000.0),
            "A motor that has not started after this time does not start.";
        "fault-poll-hz" fault_poll_hz: f64, "Hz" = is(10.0).within(0.0, 100.0),
            "Rate at which each motor is asked for its faults, if its bus has time. 0 never asks.";
        "deadman-ms" deadman_ms: Option<f64>, "ms" = follows("`max-lateness-ms` and 2 cycles").within(0.5, 10_000.0),
            "The dead man's switch acts when the heartbeat stalls for this time. When the daemon dies it acts immediately. At least 2 cycles. A warning below the default: the switch would act on a daemon that is only late.";
        "require-deadman" require_deadman: bool, "" = is(false),
            "Stop every group while the dead man's switch is missing or hangs (`switch-lost`), and enable none. A robot without a bus of this machine needs no switch.";
        "stop-on-foreign-master" stop_on_foreign_master: bool, "" = is(true),
            "Stop the group of a motor that receives 5 or more frames a second with its command id from another program or device (`foreign-master`). `false`: motord only logs it, and the motor obeys both senders. In both cases it enables no group with such a motor. An excluded motor stops no group. CAN only.";
        "error-feedback" error_feedback: bool, "" = is(true),
            "Carry the rounding errors of torque and velocity from cycle to cycle. This makes the mean torque exact, also with damping.";
    }

    /// `[[bus]]`, the keys of every type.
    Bus "bus" {
        "name" name: Option<String>, "" = required("every [[bus]] needs a name"),
            "Its name.";
        "type" kind: Option<BusType>, "" = required_choice(),
            "`socketcan`: a CAN interface of Linux. `serial`: RS485 or RS232, for GIM motors. `simulated`: simulated motors on a simulated CAN bus inside the daemon.";
        "interface" interface: Option<String>, "" = follows("required for `socketcan`"),
            "Linux name of the interface, such as `can0`.";
        "bitrate" bitrate: i64, "bit/s" = is(1_000_000).within(10_000.0, 1_000_000.0),
            "Of classic CAN; for `socketcan` and `simulated`.";
        "device" device: Option<String>, "" = follows("required for `serial`").words("an absolute path"),
            "Such as `/dev/ttyUSB0`. USB adapters: set their latency timer to 1 ms (`/sys/bus/usb-serial/devices/ttyUSB0/latency_timer`).";
        // GIM document 3.1.1: 921600 8N1.
        "baud" baud: i64, "bit/s" = is(921_600).within(9_600.0, 4_000_000.0),
            "8N1; for `serial`.";
        // A USB adapter delivers bytes at most once in a millisecond.
        "turnaround-us" turnaround_us: f64, "µs" = is(500.0).within(0.0, 100_000.0),
            "The longest time from the end of a request to the beginning of its reply, as the computer sees it; for `serial`. USB adapters: 1500, or what `motorctl ping` measures. A later reply is late, and the next request may be refused.";
        "every" every: i64, "cycles" = is(1).within(1.0, 100.0),
            "The motors of this bus take turns: each receives a command once in this number of cycles; its replies, misses and age count in turns. A serial bus has one request at a time, so it needs some cycles for each motor and one more turn for requests for faults and indicators; `motord check` prints the least value. A stop reaches a motor at its next turn.";
        "seed" seed: Option<i64>, "" = follows("from the name"),
            "Seed of all that is random; for `simulated`.";
    }

    /// `[[motor]]`.
    Motor "motor" {
        "name" name: Option<String>, "" = required("every [[motor]] needs a name"),
            "Its name, and that of its joint.";
        "bus" bus: Option<String>, "" = required("name the [[bus]] the motor is on"),
            "Name of its bus.";
        // A byte names the motor in a reply, and 0xFF begins every special MIT frame.
        "id" id: Option<i64>, "" = required("give the motor's CAN id").within(0.0, 254.0),
            "Its CAN id, at least 1. SteadyWin: ConfID 0x12. Some vendors allow fewer ids. With the protocol `myactuator`: 1 to 32. With `cansimple`: its node id, 0 to 63. The motor then uses the 32 ids from 32 times this number on.";
        // The header of a serial frame has one byte for the receiver (GIM document, table 3).
        "host-id" host_id: Option<i64>, "" = follows("of the [model](#models); serial: 0").within(0.0, 2047.0),
            "Id that its replies bear. SteadyWin: ConfID 0x13. With the protocol `robstride`: the id of the host, 0xFD by default, and the same for all motors. With `cansimple`, `myactuator` and `odrive` it has no effect. On a serial bus 0 to 255; some vendors allow fewer ids.";
        "protocol" protocol: Option<MotorProtocol>, "" = required_choice(),
            "`mit`: impedance control over CAN. `gim`: SteadyWin's GIM protocol, and the only one of a serial bus. `robstride`: RobStride's private protocol, which its motors speak from the factory. `cansimple`: SteadyWin's SDC104, GDS68 and GDZ drivers, whose codes end at 12.5 rad, 65 rad/s and 50 N·m. `myactuator`: MyActuator's RMD series; requires `torque-end-nm`. `odrive`: ODrive Pro, S1 and Micro, without impedances. As the motor is set (SteadyWin: ConfID 0x1C).";
        "model" model: Option<String>, "" = required("give the motor's model, such as GIM8108-8"),
            "Such as `GIM8108-8`, see [models](#models). Gives the defaults of the values below.";
        "torque-constant-nm-per-a" torque_constant_nm_per_a: Option<f64>, "N·m/A" = follows("of the model").within(0.001, 2.0).if_negative(REVERSED),
            "SteadyWin only, not `cansimple`. Of the rotor (ConfID 0x03). Data sheets often give it at the output, larger by the gear ratio.";
        "gear-ratio" gear_ratio: Option<f64>, "" = follows("of the model").within(1.0, 200.0).if_negative(REVERSED),
            "SteadyWin and ODrive only. Rotor turns per turn of the output shaft. With `cansimple` it converts the position of the stopped motor, with `odrive` every value.";
        "rated-torque-nm" rated_torque_nm: Option<f64>, "N·m" = follows("of the model").within(0.01, 1000.0),
            "Torque that the motor can give continuously; at most `peak-torque-nm`. More is given until the winding is warm by a model (I²t); then the torque falls to this.";
        // The windings of this series are small against their housings.
        "overload-seconds" overload_seconds: f64, "s" = is(10.0).within(0.1, 600.0),
            "Time in which twice the rated torque heats a cold winding to its limit. The torque falls before that.";
        "peak-torque-nm" peak_torque_nm: Option<f64>, "N·m" = follows("of the model").within(0.01, 1000.0),
            "Largest torque of the motor. Bounds `torque-nm`. Not beyond the end of the torque codes.";
        "max-velocity-rad-s" max_velocity_rad_s: Option<f64>, "rad/s" = follows("of the model").within(0.1, 1000.0),
            "Velocity without load. Bounds the default of `velocity-rad-s`. Not beyond the end of the velocity codes.";
        "position-end-rad" position_end_rad: Option<f64>, "rad" = follows("of the model").within(0.1, 1000.0),
            "`cansimple`, `myactuator`; or `mit`, not SteadyWin: the position of the largest code (Damiao: PMAX). The cycle reads it from a motor with registers: without this key it uses the motor's value, with it only a motor with this value is enabled. A motor that reports none of its registers is enabled if the three keys of PMAX, VMAX and TMAX are written.";
        "velocity-end-rad-s" velocity_end_rad_s: Option<f64>, "rad/s" = follows("of the model").within(0.1, 10_000.0),
            "The same for the velocity (Damiao: VMAX).";
        "torque-end-nm" torque_end_nm: Option<f64>, "N·m" = follows("of the model").within(0.01, 10_000.0),
            "The same for the torque (Damiao: TMAX). With `cansimple`, one source has the torque at the rotor: 400 for a gear of 8. Measure it before you rely on torques. With `myactuator` it is required, because the sources differ: read it in the vendor's tool or in its document for this motor.";
        "kp-end" kp_end: Option<f64>, "N·m/rad" = follows("of the model").within(1.0, 100_000.0),
            "`mit` only, not SteadyWin: the stiffness of the largest code.";
        "kd-end" kd_end: Option<f64>, "N·m·s/rad" = follows("of the model").within(0.1, 10_000.0),
            "`mit` only, not SteadyWin: the damping of the largest code.";
        "direction" direction: i64, "" = is(1).words("1, -1").instead_of_words("1 or -1 (reversed is -1)"),
            "-1 when the joint turns against its motor.";
        "offset-rad" offset_rad: f64, "rad" = is(0.0).within(-12.5, 12.5).angle(),
            "Joint angle at the motor's zero.";
        "damping-kd" damping_kd: Option<f64>, "N·m·s/rad" = follows("2, at most `kd-max`").within(0.0, 10_000.0),
            "`mit` only: damping of a safe stop. The speed loop of its drive brakes a GIM motor. Not 0 and not above `kd-max`, unless the group's safe stop is `stop`.";
        "control-duration-ms" control_duration_ms: i64, "ms" = is(0).within(0.0, 60_000.0),
            "`gim` only: the execution time that is sent with each torque, speed and position command (GIM document, 3.2.7 to 3.2.9). The document does not define the end of such a time: the motor may go limp, which would make it a watchdog in the drive, or hold its last command. In a position command it may be the time of the travel. Leave it at 0, without an end, until a bench has shown what your motor does. At least 3 turns of the motor.";
        "beyond-range" beyond_range: BeyondRange, "" = is(BeyondRange::Stop),
            "Behaviour of the motor past the end of its position scale; SteadyWin's documents do not state it. `stop`: not known, never go there. `wrap`: the code wraps round, and positions are unwrapped.";
        "fault-policy" fault_policy: FaultPolicy, "" = is(FaultPolicy::StopGroup),
            "The motors that stop when this motor reports a fault.";
        "may-be-excluded" may_be_excluded: bool, "" = is(false),
            "Its group may run without this joint while the joint is excluded (`motorctl exclude`).";
        "excluded" excluded: bool, "" = is(false),
            "The joint is excluded from the start, because it is not there. Its motor gets stop frames only, and its setpoints are ignored.";
    }

    /// `[motor.limits]`. The protocol's scale bounds the first five.
    Limits "motor.limits" {
        "position-rad" position_rad: Option<[f64; 2]>, "rad" = follows("±12 of the motor").words("lowest, highest"),
            "Position limits. A warning without them. Within the scale of the motor, or ±1000 with `beyond-range = \"wrap\"`.";
        "velocity-rad-s" velocity_rad_s: Option<f64>, "rad/s" = follows("of the model, at most 60").at_least(0.01),
            "Of setpoints, and of the position setpoint's motion. A joint at 1.2 times it is stopped. A warning above `max-velocity-rad-s`.";
        "torque-nm" torque_nm: Option<f64>, "N·m" = follows("`rated-torque-nm`").at_least(0.01),
            "Of setpoints, and of the sum that stiffness, damping and torque ask for. At most `peak-torque-nm`.";
        "kp-max" kp_max: f64, "N·m/rad" = is(100.0).at_least(0.0),
            "Largest stiffness.";
        "kd-max" kd_max: f64, "N·m·s/rad" = is(5.0).at_least(0.0),
            "Largest damping.";
        "torque-slew-nm-per-s" torque_slew_nm_per_s: Option<f64>, "N·m/s" = follows("50 · `torque-nm`").within(0.1, 1e6),
            "Fastest change of the torque.";
        "kp-slew-per-s" kp_slew_per_s: Option<f64>, "N·m/rad/s" = follows("20 · `kp-max`").within(0.1, 1e6),
            "Fastest change of the stiffness.";
        "kd-slew-per-s" kd_slew_per_s: Option<f64>, "N·m·s/rad/s" = follows("20 · `kd-max`").within(0.1, 1e6),
            "Fastest change of the damping.";
        "temperature-derate-celsius" temperature_derate_celsius: Option<f64>, "°C" = follows("70, and 10 below the next").within(0.0, 120.0),
            "Above it the torque is reduced. It acts on motors that report a temperature.";
        "temperature-max-celsius" temperature_max_celsius: f64, "°C" = is(90.0).within(10.0, 120.0),
            "At it no torque is left. When it lasts for a second: safe stop.";
        "following-error-rad" following_error_rad: Option<f64>, "rad" = follows("half a turn").within(0.001, 25.0).angle(),
            "Largest distance between joint and position setpoint. When it lasts for 50 ms: safe stop. The default acts only at the torque limit, and not while the joint approaches the setpoint.";
        "torque-response-percent" torque_response_percent: f64, "%" = is(30.0).within(0.0, 90.0),
            "Least share of a commanded torque that the motor must report. A motor that reports less for 50 ms, and less than a tenth of its rated torque, is off: safe stop (`motor-off`). 0 does not check it.";
    }

    /// `[motor.simulation]`.
    Simulation "motor.simulation" {
        "initial-position-rad" initial_position_rad: Option<f64>, "rad" = follows("0, or the nearest limit").within(-1000.0, 1000.0),
            "Position of the joint at the start. Within `position-rad`.";
        "load-inertia-kg-m2" load_inertia_kg_m2: f64, "kg·m²" = is(0.01).within(0.0, 100.0),
            "Inertia of the load on the output shaft.";
        "armature-kg-m2" armature_kg_m2: Option<f64>, "kg·m²" = follows("of the model").within(1e-6, 100.0),
            "Inertia of the rotor behind its gear. By default by the vendor's table, where it has the model, else estimated.";
        "viscous-friction-nm-s-per-rad" viscous_friction_nm_s_per_rad: Option<f64>, "N·m·s/rad" = follows("estimated from the model").within(0.0, 100.0),
            "Friction of the joint that grows with its velocity. `motorctl identify` measures it.";
        "coulomb-friction-nm" coulomb_friction_nm: Option<f64>, "N·m" = follows("estimated from the model").within(0.0, 1000.0),
            "Friction of the moving joint that does not depend on its velocity. `motorctl identify` measures it.";
        "reply-latency-us" reply_latency_us: f64, "µs" = is(50.0).within(0.0, 100_000.0),
            "From the end of a command to the beginning of its reply. Also the answering time by which `motord check` plans a CAN bus.";
    }

    /// `[[group]]`.
    Group "group" {
        "name" name: Option<String>, "" = required("every [[group]] needs a name"),
            "Its name.";
        "joints" joints: Option<Vec<Listed>>, "" = required("list the names of its motors"),
            "Names of its motors.";
        "safe-stop" safe_stop: Option<SafeStop>, "" = follows("of `[safety]`"),
            "As in `[safety]`, for this group.";
        "supply-warn-v" supply_warn_v: Option<f64>, "V" = follows("of `[safety]`").within(0.0, 1000.0),
            "As in `[safety]`, for this group.";
        "supply-stop-v" supply_stop_v: Option<f64>, "V" = follows("of `[safety]`").within(0.0, 1000.0),
            "As in `[safety]`, for this group.";
    }

    /// `[[imu]]`.
    Imu "imu" {
        "name" name: Option<String>, "" = required("every [[imu]] needs a name, such as base"),
            "Its name.";
        "type" kind: Option<ImuType>, "" = required("give hipnuc-serial, xsens, hipnuc-can, damiao, external or simulated"),
            "`hipnuc-serial`: HiPNUC on a serial line, 0x91 frames. `xsens`: Xsens MTi on a serial line, MTData2. `hipnuc-can`: HiPNUC on a CAN bus, CANopen. `damiao`: Damiao DM-IMU-L1 on a CAN bus. `external`: published by another process. `simulated`: simulated inside the daemon. [Wiring and settings](imu.md).";
        "device" device: Option<String>, "" = follows("required for `hipnuc-serial` and `xsens`").words("an absolute path"),
            "Such as `/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0`. No bus and no other IMU may use it.";
        "baud" baud: Option<i64>, "bit/s" = follows("115200").within(9_600.0, 4_000_000.0),
            "8N1, as the device is set; for `hipnuc-serial` (115200, 460800, 921600) and `xsens`.";
        "bus" bus: Option<String>, "" = follows("required for `hipnuc-can` and `damiao`"),
            "Name of the CAN bus that the device is on.";
        "node-id" node_id: Option<i64>, "" = follows("8").within(1.0, 127.0),
            "CANopen node of the device; for `hipnuc-can`. It sends with 0x180, 0x280, 0x380, 0x480 and 0x700 + node.";
        "can-id" can_id: Option<i64>, "" = follows("1").within(1.0, 2046.0),
            "Id of the device, to which the requests go; for `damiao`.";
        "master-id" master_id: Option<i64>, "" = follows("17").within(1.0, 2046.0),
            "Id of its replies; for `damiao`. 17 (0x11) in the vendor's samples, which is also the default reply id of the motor 1 of Damiao.";
        "firmware" firmware: Option<i64>, "" = follows("1024").within(1000.0, 9999.0),
            "Version of the firmware; for `damiao`. Up to 1022, 1023, and from 1024 on differ in the requests and in the range of the acceleration.";
        "rate-hz" rate_hz: Option<f64>, "Hz" = follows("100; `damiao`, `external`, `simulated`: 200").within(1.0, 2000.0),
            "Samples per second, as the device is set. On a serial line refused where the baud rate cannot carry them: at 115200 baud 140 Hz of `hipnuc-serial`, 213 Hz of `xsens` with the fewest outputs. `hipnuc-can`: 10 to 200, with a period of whole ms. `damiao`: the rate of the cycle, or a half, a third and so on: it is asked with the motors.";
        "mount-rpy-deg" mount_rpy_deg: [f64; 3], "°" = is([0.0; 3]).words("roll, pitch, yaw, each -360 to 360"),
            "Mount of the sensor on the body: turns of the sensor about the axes of the body, first x (forward), then y (left), then z (up).";
        "lost-after-ms" lost_after_ms: Option<f64>, "ms" = follows("3 samples, at least 5").within(1.0, 10_000.0),
            "Without a sample for this long it is lost. A device that is unplugged is lost at once.";
        "when-lost" when_lost: WhenLost, "" = is(WhenLost::Report),
            "`report`: the state, the log and the metrics report it. `stop`: every group is stopped (`imu-lost`), and none can be enabled.";
    }

    /// `[imu.simulation]`, also of the devices in place of those on CAN.
    ImuSimulation "imu.simulation" {
        "noise-rad-s" noise_rad_s: f64, "rad/s" = is(0.002).within(0.0, 10.0),
            "Standard deviation of each axis of the angular velocity. That of the acceleration is ten times as much, in m/s².";
        "bias-rad-s" bias_rad_s: f64, "rad/s" = is(0.0).within(-10.0, 10.0),
            "Constant error of each axis of the angular velocity.";
        "delay-us" delay_us: f64, "µs" = is(0.0).within(0.0, 100_000.0),
            "Age of a sample when it is received.";
        "seed" seed: Option<i64>, "" = follows("from the name"),
            "Seed of all that is random.";
    }
}

/// The tables of the sensors, by kind.
pub(super) struct Sensors {
    pub(super) imus: Vec<Item<ImuTables>>,
}

impl Sensors {
    pub(super) fn read(root: &mut Table<'_, '_, '_>) -> Self {
        Self { imus: root.list() }
    }
}

/// An `[[imu]]` with its table.
pub(super) struct ImuTables {
    pub(super) keys: Imu,
    pub(super) simulation: ImuSimulation,
}

impl Section for ImuTables {
    const PATH: &'static str = Imu::PATH;
    const KEYS: &'static [&'static str] = Imu::KEYS;
    const UNITS: &'static [&'static str] = Imu::UNITS;

    fn read(table: &mut Table<'_, '_, '_>) -> Self {
        Self { keys: Imu::read(table), simulation: table.section(ImuSimulation::PATH) }
    }
}
