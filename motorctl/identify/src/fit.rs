//! The fit: weighted least squares over the windows, with intervals from leaving out blocks of
//! time.

use crate::interval::{Value, Why};
use crate::law::Torque;
use crate::model::Model;
use crate::regression::{Fit, blocks};
use crate::sample::{BusTiming, Delay, Sample, velocities};
use crate::stiction::{code_of, stiction};
use crate::terms::{By, CONSTANT, COSINE, COULOMB, INERTIA, Motion, SINE, Term, VISCOUS};
use crate::windows::rows;

/// Fewest blocks, and fewest windows.
const BLOCKS_MIN: usize = 6;
const ROWS_MIN: usize = 40;
/// Time by which the velocity in a drive may be older than its position, s: a period of its control
/// loop, or a filter.
const VELOCITY_LAG: f64 = 0.2e-3;
/// The result for one joint. Torques are in the N·m of the motor's reports.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Inertia of everything that turns, kg·m².
    pub inertia: Value,
    /// Viscous friction, N·m·s/rad.
    pub viscous: Value,
    /// Coulomb friction, N·m.
    pub coulomb: Value,
    /// Static friction, at which a joint at rest begins to move, N·m.
    pub stiction: Value,
    /// Torque by the sine of the position, N·m.
    pub gravity_sine: Value,
    /// Torque by the cosine of the position, N·m.
    pub gravity_cosine: Value,
    /// Constant torque, N·m: also the offset of the motor's reports.
    pub offset: Value,
    /// Friction at rest beyond the Coulomb friction, which falls with the speed (Stribeck), N·m;
    /// `None` where nothing shows it.
    pub stribeck: Option<Value>,
    /// Stiffness of a spring, N·m/rad; `None` where nothing shows it.
    pub spring: Option<Value>,
    /// Bounds of the delays; `None` without samples.
    pub delay: Option<Delay>,
    /// Distance from the lowest to the highest position, rad.
    pub range: f64,
    /// Largest speed, rad/s.
    pub fastest: f64,
    /// Windows that were used.
    pub windows: usize,
    /// Notes about the values.
    pub notes: Vec<Note>,
}

/// A property of the recording or of the joint that limits what the values mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Note {
    /// The reported torque differs from stiffness and damping times errors; it was used as it is.
    TorqueContradicts,
    /// The equation is not that of the joint: the share of the torque that it leaves, root mean
    /// square.
    Misfit(f64),
    /// The friction falls with the speed; 1/e of the difference is left at this one, rad/s.
    Stribeck(f64),
    /// The joint has a spring of this stiffness, N·m/rad.
    Spring(f64),
    /// The torque by the position is another than that of gravity.
    Position,
    /// The torque acts later than the stamps explain, or the position is reported later, s.
    Late(f64),
    /// A value differs between two halves of the motion, by as much.
    Differs(&'static str, By, f64),
}

impl core::fmt::Display for Note {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TorqueContradicts => f.write_str(
                "the torque that the motor reports differs from stiffness and damping times the errors; the values follow the report",
            ),
            Self::Misfit(share) => write!(
                f,
                "the joint does not fit the equation, which leaves {:.0} % of the torque that moves it: look for play, an elastic \
                 part, a loose screw or a collision; no value is identified",
                (100.0 * share).max(1.0)
            ),
            Self::Stribeck(speed) => {
                write!(f, "the friction falls with the speed, most of it below {speed:.2} rad/s; the Coulomb friction is that of high speed")
            }
            Self::Spring(stiffness) => {
                write!(f, "a spring of about {stiffness:.2} N·m/rad acts on the joint; it is not part of the gravity")
            }
            Self::Position => f.write_str(
                "the torque changes with the position in another way than that of gravity, such as by cogging; it is taken out of the other values",
            ),
            Self::Late(seconds) => write!(
                f,
                "the torque acts, or the position is reported, {:.1} ms later than the stamps explain: a lag or a filter in the drive",
                1e3 * seconds
            ),
            Self::Differs(value, by, difference) => {
                write!(f, "the {value} differs {by}, by {difference:.4}; its interval contains both")
            }
        }
    }
}

/// Identifies a joint by what was recorded, in the order of time. Allocates; the time is
/// proportional to the number of samples.
#[must_use]
pub fn identify(samples: &[Sample], wire: BusTiming) -> Identified {
    let delay = Delay::of(samples, wire);
    let positions = || samples.iter().map(|sample| sample.position);
    let [low, high] =
        [positions().fold(f64::INFINITY, f64::min), positions().fold(f64::NEG_INFINITY, f64::max)];
    let speeds = velocities(samples);
    let unmoved = Identified {
        delay,
        range: (high - low).max(0.0),
        fastest: speeds.iter().fold(0.0, |fastest, speed| f64::max(fastest, speed.abs())),
        ..nothing(Why::Motion)
    };
    if samples.len() < 100 {
        return unmoved;
    }
    let torque = Torque::of(samples, &speeds);
    let centre = positions().sum::<f64>() / samples.len() as f64;
    let lines = rows(samples, &speeds, &torque, centre);
    let blocks = blocks(&lines);
    if lines.len() < ROWS_MIN || blocks.len() < BLOCKS_MIN {
        return unmoved;
    }
    let notes = torque.is_reported.then_some(Note::TorqueContradicts).into_iter().collect();
    let found = Identified { windows: lines.len(), notes, ..unmoved };
    let noise = code_of(samples) / 12.0_f64.sqrt();
    let motion = Motion::new(samples, &speeds, centre, &lines);
    let late = delay.map_or(0.0, |delay| delay.motor.upper);
    let Some(model) = Model::of(&motion, &lines, noise, torque.coarse, late) else {
        return found.but(nothing(Why::Separation));
    };
    let values = values(&model, &motion, &torque, found);
    if model.is_misfit() { values.refused(Note::Misfit(model.share)) } else { values.noted(&model) }
}

/// No value, for a reason.
fn nothing(why: Why) -> Identified {
    let none = Value::none(why);
    Identified {
        inertia: none,
        viscous: none,
        coulomb: none,
        stiction: none,
        gravity_sine: none,
        gravity_cosine: none,
        offset: none,
        stribeck: None,
        spring: None,
        delay: None,
        range: 0.0,
        fastest: 0.0,
        windows: 0,
        notes: Vec::new(),
    }
}

impl Identified {
    /// Returns the time by which the torque acts, or the position is reported, later than the stamps
    /// explain, s.
    #[must_use]
    pub fn lag(&self) -> Option<f64> {
        self.notes.iter().find_map(|note| match note {
            Note::Late(seconds) => Some(*seconds),
            _ => None,
        })
    }

    /// With what the model has beyond the equation of every joint.
    fn noted(mut self, model: &Model) -> Self {
        let best = &model.best;
        for term in &best.terms {
            self.notes.extend(match term {
                Term::Stribeck { at, .. } => Some(Note::Stribeck(*at)),
                Term::Spring => Some(Note::Spring(best.found(Term::Spring))),
                Term::Knot(0) => Some(Note::Position),
                Term::Late => model.lag().map(Note::Late),
                _ => None,
            });
        }
        let names = [(INERTIA, "inertia"), (VISCOUS, "viscous friction"), (COULOMB, "Coulomb friction")];
        for (term, by, difference) in &model.splits {
            let name = names.iter().find(|(named, _)| named == term);
            self.notes.extend(name.map(|(_, name)| Note::Differs(name, *by, difference.abs())));
        }
        self
    }

    /// Without a mechanical value: the estimates remain, and must not be used.
    fn refused(mut self, note: Note) -> Self {
        for value in [
            &mut self.inertia,
            &mut self.viscous,
            &mut self.coulomb,
            &mut self.stiction,
            &mut self.gravity_sine,
            &mut self.gravity_cosine,
            &mut self.offset,
        ] {
            value.why = Some(Why::Misfit);
        }
        (self.stribeck, self.spring) = (None, None);
        self.notes.push(note);
        self
    }

    /// With the values of another.
    fn but(self, values: Self) -> Self {
        Self {
            delay: self.delay,
            range: self.range,
            fastest: self.fastest,
            windows: self.windows,
            notes: self.notes,
            ..values
        }
    }
}

/// The values of a model.
fn values(model: &Model, motion: &Motion<'_>, torque: &Torque, found: Identified) -> Identified {
    let (sin, cos) = motion.centre.sin_cos();
    let best = &model.best;
    let gravity = |by_sine: f64, by_cosine: f64| {
        if !best.has(COSINE) {
            return Value::none(Why::Separation);
        }
        // A spring is part of the sine.
        let of = |fit: &Fit, solution: &[f64]| {
            let sine = fit.unknown(solution, SINE) - fit.unknown(solution, Term::Spring);
            by_sine * sine + by_cosine * fit.unknown(solution, COSINE)
        };
        let open = if model.may_be_spring { by_sine * best.found(SINE) } else { 0.0 };
        model.value(of, open)
    };
    let torque_at = |fit: &Fit, of: &dyn Fn(Term) -> f64, position: f64| -> f64 {
        fit.terms.iter().map(|term| motion.at(*term, position) * of(*term)).sum()
    };
    let at_centre =
        model.value(|fit, solution| torque_at(fit, &|term| fit.unknown(solution, term), motion.centre), 0.0);
    let held = |position: f64| torque_at(best, &|term| best.found(term), position);
    let kp = motion.samples.iter().map(|sample| sample.applied.kp).fold(0.0, f64::max);
    let basic = |term, open| physical(model.basic(term, kp, open));
    let offset =
        |fit: &Fit, solution: &[f64]| fit.unknown(solution, CONSTANT) + fit.unknown(solution, COSINE);
    Identified {
        inertia: basic(INERTIA, damping_lag(motion.samples)),
        viscous: basic(VISCOUS, 0.0),
        coulomb: basic(COULOMB, 0.0),
        stiction: stiction(motion.samples, torque, best.found(INERTIA), held, at_centre.half()),
        gravity_sine: gravity(cos, -sin),
        gravity_cosine: gravity(-sin, -cos),
        offset: if best.has(COSINE) { model.value(offset, 0.0) } else { gravity(0.0, 0.0) },
        stribeck: best.terms.iter().any(Term::is_stribeck).then(|| model.value(stribeck, 0.0)),
        spring: best
            .has(Term::Spring)
            .then(|| model.value(|fit, solution| fit.unknown(solution, Term::Spring), 0.0)),
        ..found
    }
}

/// The friction at rest beyond the Coulomb friction, whatever its speed.
fn stribeck(fit: &Fit, solution: &[f64]) -> f64 {
    fit.terms.iter().find(|term| term.is_stribeck()).map_or(0.0, |term| fit.unknown(solution, *term))
}

/// Inertia that a damping imitates whose velocity lags, kg·m².
fn damping_lag(samples: &[Sample]) -> f64 {
    samples.iter().map(|sample| sample.applied.kd).fold(0.0, f64::max) * VELOCITY_LAG
}

/// An inertia and a friction are above zero: a negative one says that the equation is not that of
/// the joint.
fn physical(value: Value) -> Value {
    if value.value < 0.0 && value.why.is_none() {
        Value { why: Some(Why::Separation), ..value }
    } else {
        value
    }
}
