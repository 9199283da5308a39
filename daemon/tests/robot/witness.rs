//! Judges every cycle by what reached the wire and what was published: the invariants that hold whatever anybody does.
//!
//! | | |
//! |---|---|
//! | I1 | no start, zero or clear command that nobody asked for; never the all-zero frame |
//! | I2 | position, velocity, gains, torque and their slews are within the limits after decoding the bytes |
//! | I3 | no frame but a safe one, when the owner's newest good setpoint is older than its timeout and two cycles |
//! | I4 | a disarmed motor hears stop and questions only |
//! | I5 | at most one frame per motor, and one question for faults per bus, in a cycle |
//! | I6 | a published state is fresh, or says how old it is |
//! | I7 | only messages of the owner's lease move motors |
//! | I8 | counters never fall, and as many frames are on the wire as were counted |
//! | I9 | a latched cause is left by a reset only |
//! | I10 | no frame but a safe one from the second cycle after a cause on |

use super::{Meaning, Robot, Sent};
use motord::config::settings::MotorSettings;
use motord_bus::{Duration, Instant};
use motord_shared::{Cause, Limit, MotorMode, Phase, StateMessage, message};

/// The stiffness that only messages without the owner's lease ask for (I7).
pub const FOREIGN_KP: f32 = 177.0;

/// A frame may leave up to this long after the setpoint it follows has grown too old.
const GRACE: Duration = Duration::from_millis(2);

/// The last control frame of a motor.
#[derive(Debug, Clone, Copy)]
struct Control {
    at: Instant,
    position: f64,
    kp: f64,
    kd: f64,
    torque: f64,
}

/// What was seen so far.
#[derive(Debug)]
pub struct Witness {
    before: Option<StateMessage>,
    controls: Vec<Option<Control>>,
    /// When the owner last sent a message that is good in every respect.
    pub good_setpoint: Option<Instant>,
    /// Groups whose reset was asked for since the last cycle.
    pub reset: bool,
    /// An enable was accepted since the last stop.
    pub enabled: bool,
    /// Motors that may hear set zero or clear fault.
    pub errand: bool,
    caused: Option<u32>,
    sent: [u32; 16],
    lost_on_the_way: bool,
}

impl Witness {
    pub fn new(robot: &Robot) -> Self {
        Self {
            before: None,
            controls: vec![None; robot.settings.motors.len()],
            good_setpoint: None,
            reset: false,
            enabled: false,
            errand: false,
            caused: None,
            sent: [0; 16],
            lost_on_the_way: false,
        }
    }

    /// Buses lose frames from now on, so that counters and the wire cannot be compared any more.
    pub fn allow_loss(&mut self) {
        self.lost_on_the_way = true;
    }

    /// Judges the cycle that `robot` has just run.
    pub fn judge(&mut self, robot: &mut Robot) {
        let state = robot.state();
        let sent = robot.take_sent();
        self.judge_counts(robot, &state, &sent);
        for frame in &sent {
            let index = robot
                .settings
                .motors
                .iter()
                .position(|motor| motor.bus == frame.bus && u16::from(motor.id) == frame.id);
            let index = index.expect("frames go to motors");
            self.judge_frame(
                &robot.settings.motors[index],
                robot.settings.safety.setpoint_timeout,
                &state,
                index,
                frame,
            );
        }
        self.judge_state(&state);
        self.reset = false;
        self.before = Some(state);
    }

    fn judge_counts(&mut self, robot: &Robot, state: &StateMessage, sent: &[Sent]) {
        for bus in 0..robot.buses.len() {
            let motors = robot.settings.motors.iter().filter(|motor| motor.bus == bus).count();
            let frames = sent.iter().filter(|frame| frame.bus == bus).count();
            assert!(frames <= motors + 1, "I5: {frames} frames for {motors} motors");
            self.sent[bus] += frames as u32;
            if !self.lost_on_the_way {
                // A question for faults is sent after the states were published.
                let unpublished = self.sent[bus].wrapping_sub(state.buses[bus].sent);
                assert!(unpublished <= 1, "I8: {unpublished} frames more on the wire than counted");
            }
        }
    }

    fn judge_frame(
        &mut self,
        motor: &MotorSettings,
        timeout: Duration,
        state: &StateMessage,
        index: usize,
        frame: &Sent,
    ) {
        let mode = MotorMode::try_from(state.joints[index].mode).expect("a mode");
        let phase = Phase::try_from(state.groups[0].phase).expect("a phase");
        assert_ne!(frame.bytes, [0; 8], "I1: the all-zero frame");
        match frame.meaning {
            Meaning::Start => assert!(self.enabled && phase == Phase::Starting, "I1: start in {phase}"),
            Meaning::SetZero | Meaning::ClearFault => assert!(self.errand, "I1: {:?}", frame.meaning),
            Meaning::Stop | Meaning::GetFault => {}
            Meaning::Control { .. } => {
                let fell = self.before.is_some_and(|before| before.groups[0].phase != Phase::Disarmed.code());
                assert!(phase != Phase::Disarmed || fell, "I4: control of a disarmed {mode} motor");
                self.judge_control(motor, state, index, frame);
            }
        }
        if frame.meaning.is_safe() || frame.meaning == Meaning::Start {
            return;
        }
        if frame.meaning == Meaning::SetZero {
            return;
        }
        let good = self.good_setpoint.expect("I3: motion without any setpoint");
        let age = frame.at.since(good);
        assert!(age <= timeout + GRACE, "I3: motion on a setpoint that is {age:?} old");
        assert!(self.caused.is_none_or(|cycles| cycles < 2), "I10: motion after a stop");
    }

    fn judge_control(&mut self, motor: &MotorSettings, state: &StateMessage, index: usize, frame: &Sent) {
        let Meaning::Control { position, velocity, kp, kd, torque } = frame.meaning else { return };
        let limits = &motor.limits;
        let code = 2.0 * motor.torque_scale.field().max() / 4095.0;
        let joint = f64::from(motor.direction) * position + f64::from(motor.offset);
        assert!((kp - f64::from(FOREIGN_KP)).abs() > 1.0, "I7: a foreign setpoint was followed");
        assert!(kp <= f64::from(limits.kp) + 0.07, "I2: kp {kp}");
        assert!(kd <= f64::from(limits.kd).max(f64::from(motor.damping_kd)) + 0.001, "I2: kd {kd}");
        assert!(velocity.abs() <= f64::from(limits.velocity) + 0.02, "I2: velocity {velocity}");
        assert!(torque.abs() <= f64::from(limits.torque) + code, "I2: torque {torque}");
        let told = Control { at: frame.at, position: joint, kp, kd, torque };
        if kp > 0.0 {
            let [low, high] = limits.position.map(f64::from);
            let entering = state.joints[index].limits & Limit::PositionSlew.bit() != 0;
            assert!(entering || (low - 4e-4..=high + 4e-4).contains(&joint), "I2: position {joint}");
        }
        let active = state.joints[index].mode == MotorMode::Active.code();
        if let (Some(before), true) =
            (self.controls[index].filter(|before| before.kp > 0.0 && kp > 0.0), active)
        {
            let time = frame.at.since(before.at).as_secs_f64().min(0.002) + 1e-4;
            let within = |name: &str, change: f64, slew: f32, code: f64| {
                assert!(
                    change <= f64::from(slew) * time + 2.0 * code,
                    "I2: {name} changed by {change} in {time} s"
                );
            };
            within("position", (told.position - before.position).abs(), limits.velocity, 4e-4);
            within("kp", told.kp - before.kp, limits.kp_slew, 0.13);
            within("kd", told.kd - before.kd, limits.kd_slew, 0.0013);
        }
        self.controls[index] = Some(told);
    }

    fn judge_state(&mut self, state: &StateMessage) {
        let group = &state.groups[0];
        for joint in state.joints() {
            let fresh = joint.flags & message::JOINT_FRESH != 0;
            assert_eq!(fresh, joint.age_cycles == 0 && joint.receive_ns > 0, "I6: {joint:?}");
            let valid = joint.flags & message::JOINT_VALID != 0;
            assert_eq!(valid, joint.position.is_finite(), "I6: {joint:?}");
        }
        if let Some(before) = &self.before {
            assert!(state.cycle > before.cycle && state.overruns >= before.overruns, "I8");
            for (now, before) in state.buses().iter().zip(before.buses()) {
                assert!(now.sent >= before.sent && now.received >= before.received, "I8");
            }
            let (was, is) = (before.groups[0].cause, group.cause);
            assert!(
                is == was || was == 0 || self.reset || is == Cause::EmergencyStop.code(),
                "I9: {was} became {is}"
            );
        }
        self.caused = (group.cause != 0).then(|| self.caused.map_or(0, |cycles| cycles + 1));
        if group.cause != 0 || group.phase == Phase::Disarmed.code() {
            self.enabled = self.enabled && group.phase == Phase::Starting.code();
        }
    }
}
