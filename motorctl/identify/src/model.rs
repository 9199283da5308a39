//! The terms of a joint: those of every joint, and further ones where they predict its motion
//! better.
//!
//! Each second of the motion is predicted from the others. A term is taken if it makes the
//! predictions better; a term that merely fits the noise makes them worse.

use crate::interval::{Value, Why};
use crate::regression::Fit;
use crate::terms::{By, CONSTANT, COSINE, INERTIA, KNOTS, Motion, PROPERTIES, SINE, Term, VISCOUS, basic};
use crate::windows::{Row, UNKNOWNS};

/// Basic terms that every fit has: inertia, viscous and Coulomb friction, and the constant.
const LEAST: usize = 4;
/// Further terms at most.
const FURTHER_MAX: usize = 4;
/// A term is taken if the squares of the errors of the predictions fall below this share.
const TAKEN: f64 = 0.97;
/// Models whose predictions are worse by up to this factor are not told apart.
const ALIKE: f64 = 1.1;
/// Speeds, rad/s, and powers of the friction at low speed.
const STRIBECK_SPEEDS: [f64; 9] = [0.05, 0.08, 0.12, 0.18, 0.25, 0.35, 0.5, 0.8, 1.2];
const STRIBECK_POWERS: [i32; 2] = [1, 2];
/// First factor between two speeds, and how often one is sought between those that were tried.
const STEP: f64 = 1.2;
const REFINEMENTS: u32 = 8;
/// Speeds beside the best one, by it.
const NEAR: [f64; 6] = [0.8, 0.9, 0.95, 1.05, 1.1, 1.25];

/// Change of the squares of the errors, as a share, by which a value differs between two halves of
/// the windows.
const DIFFERS: f64 = 0.97;
/// Largest [`Model::share`] of a joint that the equation describes.
const MISFIT: f64 = 0.025;
/// Root mean square of the residuals that every joint has, as a share of the torque that moves it.
const INHERENT: f64 = 0.005;
/// Part of the further residuals that may imitate a value.
const IMITATES: f64 = 0.3;
/// Time by which the stamps are off besides the answer of the motor, s, where the torque acts late
/// and where it acts early. A position is measured after the torque has changed.
const STAMPS: f64 = 0.1e-3;
const STAMPS_EARLY: f64 = 1e-3;
/// Delay of the control loop in a drive, s, and the share of a lag that remains when it is taken
/// for a delay.
const LOOP: f64 = 50e-6;
const LAG_SHARE: f64 = 0.02;

/// The fit of a joint, and others that predict it as well.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    pub(crate) best: Fit,
    alike: Vec<Fit>,
    /// Basic terms that differ between two halves, by property, with the difference.
    pub(crate) splits: Vec<(Term, By, f64)>,
    /// The part of the intervals of the basic terms by the residuals.
    open: [f64; SPLIT],
    /// Root mean square of the residuals beyond those of every joint, by that of the torque that
    /// moves the joint.
    pub(crate) share: f64,
    /// The spring that the motion does not exclude explains the whole sine.
    pub(crate) may_be_spring: bool,
    /// The torque acts up to this time later than the stamps say, s.
    late: f64,
}

/// Basic terms that are tested by halves: inertia, viscous and Coulomb friction.
const SPLIT: usize = 3;

impl Model {
    /// Chooses the terms. `noise` is the standard error of a position, rad. `None` where the motion
    /// separates nothing. `coarse` is the error of a torque by its codes, N·m: above 0 they hide
    /// further terms, and none is sought. The torque acts up to `late` later than the stamps say,
    /// s: where that explains the delay of the fit, one without a delay counts besides.
    pub(crate) fn of(motion: &Motion<'_>, rows: &[Row], noise: f64, coarse: f64, late: f64) -> Option<Self> {
        let even = vec![1.0; rows.len()];
        let first = (LEAST..=UNKNOWNS).rev().find_map(|count| Fit::of(motion, rows, &even, basic(count)))?;
        let mut weights = weights(rows, &first, noise);
        let mut best = Fit::of(motion, rows, &weights, first.terms)?;
        let further = if coarse > 0.0 { 0 } else { FURTHER_MAX };
        for _ in 0..further {
            let others = candidates(&best.terms).into_iter();
            let fits = others.filter_map(|terms| Fit::of(motion, rows, &weights, terms));
            let fits = fits.filter(Fit::is_physical);
            let next = fits.min_by(|a, b| a.unpredicted.total_cmp(&b.unpredicted));
            let Some(next) = next.filter(|next| next.unpredicted < TAKEN * best.unpredicted) else { break };
            // With these weights the motion may no longer separate the terms.
            let next_weights = self::weights(rows, &next, noise);
            let Some(next) = Fit::of(motion, rows, &next_weights, next.terms) else { break };
            (best, weights) = (next, next_weights);
        }
        let fit = |terms: Vec<Term>| Fit::of(motion, rows, &weights, terms);
        let best = refined(best, fit);
        let alike = variants(&best.terms).into_iter().filter_map(fit);
        let alike = alike.filter(|fit| fit.unpredicted < ALIKE * best.unpredicted).collect();
        let splits = if coarse > 0.0 { Vec::new() } else { splits(&best, fit) };
        let may_be_spring = may_be_spring(&best, fit);
        let (open, share) = residue(&best, rows, noise, coarse);
        let mut model = Self { best, alike, splits, open, share, may_be_spring, late };
        if model.best.has(Term::Late) && model.lag().is_none() {
            let terms = model.best.terms.iter().copied().filter(|term| *term != Term::Late).collect();
            model.alike.extend(Fit::of(motion, rows, &weights, terms));
        }
        Some(model)
    }

    /// The time by which the torque acts later than the stamps explain, s; negative: earlier.
    pub(crate) fn lag(&self) -> Option<f64> {
        let lag = self.best.found(Term::Late);
        (lag > self.late + STAMPS || -lag > self.late + STAMPS_EARLY).then_some(lag)
    }

    /// Returns whether the equation is not that of the joint. A torque that acts before its command
    /// is a sign of an elastic part or a play.
    pub(crate) fn is_misfit(&self) -> bool {
        self.share > MISFIT || self.lag().is_some_and(|lag| lag < 0.0)
    }

    /// The value of a combination of unknowns, over all models that predict as well.
    pub(crate) fn value(&self, of: impl Fn(&Fit, &[f64]) -> f64, open: f64) -> Value {
        let best = self.best.value(&of, self.late, open);
        let others: Vec<Value> = self.alike.iter().map(|fit| fit.value(&of, self.late, open)).collect();
        let lower = others.iter().fold(best.lower, |lower, other| lower.min(other.lower));
        let upper = others.iter().fold(best.upper, |upper, other| upper.max(other.upper));
        Value::within(best.value, lower, upper)
    }

    /// The value of inertia, viscous or Coulomb friction: also those of halves of the windows that
    /// differ. `open` is what the interval contains besides.
    pub(crate) fn basic(&self, term: Term, kp: f64, open: f64) -> Value {
        let Term::Basic(index) = term else { return Value::none(Why::Separation) };
        let lag = self.lag().unwrap_or(0.0);
        // A spring and a damper that act later are a damper and an inertia.
        let later = match term {
            VISCOUS if self.best.has(Term::Late) => kp * (LOOP + LAG_SHARE * lag.abs()),
            INERTIA => kp * lag.powi(2),
            _ => 0.0,
        };
        let open = open.hypot(self.open.get(index).copied().unwrap_or(0.0)).hypot(later);
        let value = self.value(|fit, solution| fit.unknown(solution, term), open);
        let of_term = self.splits.iter().filter(|(split, ..)| *split == term);
        let [lower, upper] =
            of_term.fold([value.lower, value.upper], |[lower, upper], (_, _, difference)| {
                [lower.min(value.value - difference.abs()), upper.max(value.value + difference.abs())]
            });
        Value::within(value.value, lower, upper)
    }
}

/// The values that differ between halves of the windows.
fn splits(best: &Fit, fit: impl Fn(Vec<Term>) -> Option<Fit>) -> Vec<(Term, By, f64)> {
    let split = |(index, by): (usize, By)| {
        let term = Term::Split(index, by);
        let split = fit([&best.terms[..], &[term]].concat())?;
        let differs = split.unpredicted < DIFFERS * best.unpredicted;
        differs.then(|| (Term::Basic(index), by, split.found(term)))
    };
    let all = PROPERTIES.into_iter().flat_map(|by| (0..SPLIT).map(move |index| (index, by)));
    all.filter_map(split).collect()
}

/// Returns whether the sine may be that of a spring, as far as the motion shows.
fn may_be_spring(best: &Fit, fit: impl Fn(Vec<Term>) -> Option<Fit>) -> bool {
    if !best.has(SINE) || best.has(Term::Spring) {
        return false;
    }
    let with = fit([&best.terms[..], &[Term::Spring]].concat());
    with.is_none_or(|with| {
        let gravity =
            |fit: &Fit, solution: &[f64]| fit.unknown(solution, SINE) - fit.unknown(solution, Term::Spring);
        let gravity = with.value(gravity, 0.0, 0.0);
        gravity.lower <= 0.0 && 0.0 <= gravity.upper
    })
}

/// The part of the intervals by residuals beyond those of every joint, and the share of these.
fn residue(best: &Fit, rows: &[Row], noise: f64, coarse: f64) -> ([f64; SPLIT], f64) {
    let rms = |of: &dyn Fn(usize) -> f64| {
        ((0..rows.len()).map(|line| of(line).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
    };
    let columns = [0, 1, 2].map(|index| rms(&|line| rows[line].factors[index]));
    let parts = [0, 1, 2].map(|index| (best.found(Term::Basic(index)) * columns[index]).powi(2));
    let moved = parts.iter().sum::<f64>().sqrt();
    let residual = rms(&|line| best.residuals[line]);
    let inherent =
        rms(&|line| 2.0 * best.found(INERTIA) * noise * rows[line].roughness).hypot(INHERENT * moved);
    let inherent = inherent.hypot(coarse);
    let further = (residual.powi(2) - inherent.powi(2)).max(0.0).sqrt();
    (columns.map(|column| IMITATES * further / column), further / moved)
}

/// The models with one more term.
fn candidates(terms: &[Term]) -> Vec<Vec<Term>> {
    let with = |term: Term| [terms, &[term]].concat();
    let has_stribeck = terms.iter().any(Term::is_stribeck);
    let has_knots = terms.contains(&Term::Knot(0));
    let mut found = Vec::new();
    if !terms.contains(&Term::Late) {
        found.push(with(Term::Late));
    }
    if !has_stribeck {
        found.extend(stribeck().map(with));
    }
    if !has_knots && !terms.contains(&Term::Spring) && terms.contains(&SINE) {
        found.push(with(Term::Spring));
    }
    if !has_knots {
        let kept = terms.iter().copied().filter(|term| !is_of_position(*term));
        found.push(kept.chain((0..KNOTS).map(Term::Knot)).collect());
    }
    found
}

fn stribeck() -> impl Iterator<Item = Term> {
    STRIBECK_POWERS.into_iter().flat_map(|power| STRIBECK_SPEEDS.map(|at| Term::Stribeck { at, power }))
}

/// The same terms with another friction at low speed.
fn with_stribeck(terms: &[Term], other: Term) -> Vec<Term> {
    terms.iter().map(|term| if term.is_stribeck() { other } else { *term }).collect()
}

/// The same models with another speed of the friction, if they have one.
fn variants(terms: &[Term]) -> Vec<Vec<Term>> {
    let Some(Term::Stribeck { at, power }) = terms.iter().find(|term| term.is_stribeck()).copied() else {
        return Vec::new();
    };
    let near = NEAR.map(|factor| Term::Stribeck { at: factor * at, power });
    stribeck().chain(near).map(|term| with_stribeck(terms, term)).collect()
}

/// The fit with the speed of the friction that predicts best, between those that were tried.
fn refined(mut best: Fit, fit: impl Fn(Vec<Term>) -> Option<Fit>) -> Fit {
    let mut factor = STEP;
    for _ in 0..REFINEMENTS {
        let Some(Term::Stribeck { at, power }) = best.terms.iter().find(|term| term.is_stribeck()).copied()
        else {
            return best;
        };
        let next = [at / factor, at * factor]
            .map(|at| fit(with_stribeck(&best.terms, Term::Stribeck { at, power })));
        let next = next.into_iter().flatten().min_by(|a, b| a.unpredicted.total_cmp(&b.unpredicted));
        match next.filter(|next| next.unpredicted < best.unpredicted) {
            Some(next) => best = next,
            None => factor = factor.sqrt(),
        }
    }
    best
}

/// Returns whether a term is a torque that depends on the position.
fn is_of_position(term: Term) -> bool {
    matches!(term, CONSTANT | SINE | COSINE | Term::Spring | Term::Knot(_))
}

/// Weights by the errors of short windows, in which positions hardly show an acceleration, and of
/// all.
fn weights(rows: &[Row], fit: &Fit, noise: f64) -> Vec<f64> {
    let inertia = fit.found(INERTIA);
    let coarse = |row: &Row| (inertia * noise * row.roughness).powi(2);
    let mut squares: Vec<f64> = fit.residuals.iter().map(|residual| residual.powi(2)).collect();
    squares.sort_by(f64::total_cmp);
    // The median square of a normal distribution is 0.455 of its mean.
    let floor = squares[squares.len() / 2] / 0.455;
    rows.iter().map(|row| 1.0 / (coarse(row) + floor).max(f64::MIN_POSITIVE)).collect()
}
