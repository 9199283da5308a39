//! The options of `motorctl tune`.

use crate::tune::failure::TuneFailure;
use motord_direct::Confirm;
use motord_identify::{DAMPING_RATIO_MIN, Gains, Limits, Steps, Wanted};
use motord_terminal::within;
use std::path::PathBuf;

/// The options of `motorctl tune`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Name of the joint.
    #[arg(value_name = "JOINT")]
    pub(super) joint: String,
    /// Wanted bandwidth: the natural frequency of the joint on its stiffness, Hz, 0.5 to 100.
    #[arg(long, value_name = "HZ", default_value_t = 10.0, value_parser = |text: &str| within(text, 0.5, 100.0))]
    pub(super) bandwidth: f64,
    /// Wanted damping ratio, 0.5 to 2; 1 is critical: no overshoot.
    #[arg(long, value_name = "RATIO", default_value_t = 1.0, value_parser = |text: &str| within(text, DAMPING_RATIO_MIN, 2.0))]
    pub(super) damping_ratio: f64,
    /// Height of a step, rad, 0.005 to 0.5.
    #[arg(long, value_name = "RAD", default_value_t = 0.05, value_parser = |text: &str| within(text, 0.005, 0.5))]
    pub(super) step_rad: f64,
    /// Stiffness of the first steps, N·m/rad, 0.1 to 500. The default is that of half the possible bandwidth.
    #[arg(long, value_name = "KP", requires = "kd", value_parser = |text: &str| within(text, 0.1, 500.0))]
    pub(super) kp: Option<f64>,
    /// Damping of the first steps, N·m·s/rad, 0 to 100.
    #[arg(long, value_name = "KD", requires = "kp", value_parser = |text: &str| within(text, 0.0, 100.0))]
    pub(super) kd: Option<f64>,
    /// Time between two steps, s, 0.2 to 5. A soft or heavy joint needs longer.
    #[arg(long, value_name = "S", default_value_t = 0.8, value_parser = |text: &str| within(text, 0.2, 5.0))]
    pub(super) seconds: f64,
    /// Repetitions of four steps: up, back, down, back.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=20))]
    pub(super) repetitions: u32,
    /// Output of `motorctl identify --json` for this joint, while its motor has the MIT protocol. Without it the joint is identified first, for 14 s.
    #[arg(long, value_name = "FILE")]
    pub(super) identified: Option<PathBuf>,
    /// Repeat the steps with the gains of half the proposed bandwidth, then with the proposed ones.
    #[arg(long = "try")]
    pub(super) is_tried: bool,
    /// Draw the responses as an SVG into this file; `-` is the standard output.
    #[arg(long, value_name = "FILE", conflicts_with = "png")]
    pub(super) svg: Option<PathBuf>,
    /// Draw the responses as a PNG into this file; `-` is the standard output.
    #[arg(long, value_name = "FILE")]
    pub(super) png: Option<PathBuf>,
    /// Print the result as one JSON object. Not with a picture on the standard output.
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) confirm: Confirm,
}

impl Arguments {
    /// The given gains within the limits.
    pub(super) fn given(&self, limits: &Limits) -> Option<Gains> {
        let (kp, kd) = self.kp.zip(self.kd)?;
        Some(Gains { kp: kp.min(limits.kp), kd: kd.min(limits.kd) })
    }

    /// The wanted response.
    pub(super) fn wanted(&self) -> Wanted {
        Wanted { bandwidth: self.bandwidth, damping_ratio: self.damping_ratio }
    }

    /// The steps around `centre`, rad, after a motion with the gains `from`.
    pub(super) fn steps(&self, centre: f64, from: Gains, gains: Gains) -> Steps {
        let (height, seconds, repetitions) = (self.step_rad, self.seconds, self.repetitions);
        Steps { centre, height, seconds, repetitions, from, gains }
    }

    /// Refuses two results on the standard output.
    pub(super) fn check(&self) -> Result<(), TuneFailure> {
        if self.json && self.draws_on_stdout() { Err(TuneFailure::Outputs) } else { Ok(()) }
    }

    /// Returns whether standard output is the picture.
    pub(super) fn draws_on_stdout(&self) -> bool {
        [&self.svg, &self.png].into_iter().flatten().any(|path| path.as_os_str() == "-")
    }
}
