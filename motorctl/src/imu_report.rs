//! An IMU as `status` and `watch` print it.

use motord_client::{Imu, ImuContradiction, ImuDescription};
use motord_terminal::{Cell, Colour, Table};
use serde::Serialize;

/// An IMU after a cycle. Values are `null` before its first sample.
#[derive(Debug, Clone, Default, Serialize)]
pub(crate) struct ImuReport {
    pub(crate) name: String,
    /// Unit quaternion w, x, y, z from the body to the world.
    pub(crate) orientation: Option<[f32; 4]>,
    #[serde(skip)]
    pub(crate) roll_pitch_yaw: Option<[f32; 3]>,
    /// rad/s, in the frame of the body.
    pub(crate) angular_velocity: Option<[f32; 3]>,
    /// Specific force, m/s², in the frame of the body.
    pub(crate) acceleration: Option<[f32; 3]>,
    pub(crate) temperature_celsius: Option<f32>,
    /// Age of the sample when the states were published.
    pub(crate) age_us: Option<f64>,
    pub(crate) fresh: bool,
    pub(crate) valid: bool,
    pub(crate) lost: bool,
    pub(crate) sequence: u64,
    pub(crate) missing: u32,
    pub(crate) rejected: u32,
    /// Conventions in which orientation and acceleration would agree about gravity.
    pub(crate) contradictions: Vec<&'static str>,
}

impl ImuReport {
    /// The IMU in the states that were published at `publish_ns`.
    pub(crate) fn new(description: &ImuDescription, imu: &Imu, publish_ns: u64) -> Self {
        Self {
            name: description.name.clone(),
            orientation: imu.orientation(),
            roll_pitch_yaw: imu.roll_pitch_yaw(),
            angular_velocity: imu.angular_velocity(),
            acceleration: imu.acceleration(),
            temperature_celsius: imu.temperature,
            age_us: imu.age_at(publish_ns).map(|age| age.as_secs_f64() * 1e6),
            fresh: imu.fresh,
            valid: imu.valid,
            lost: imu.lost,
            sequence: imu.sequence,
            missing: imu.missing,
            rejected: imu.rejected,
            contradictions: imu.contradictions().map(ImuContradiction::name).collect(),
        }
    }

    /// Amount of the angular velocity, rad/s.
    pub(crate) fn turning(&self) -> Option<f64> {
        self.angular_velocity.map(length)
    }

    pub(crate) fn trouble(&self) -> Option<String> {
        let Self { name, contradictions, lost, .. } = self;
        let lost = lost.then(|| format!("IMU {name} delivers no samples: `motorctl explain imu-lost`."));
        let contradiction = (!contradictions.is_empty()).then(|| {
            format!(
                "IMU {name} contradicts gravity at rest ({}): `motorctl explain imu-contradicts`. {}",
                contradictions.join(", "),
                sentences(contradictions)
            )
        });
        let troubles: Vec<String> = lost.into_iter().chain(contradiction).collect();
        (!troubles.is_empty()).then(|| troubles.join(" "))
    }
}

/// Angles in degrees, as people read them.
pub(crate) fn imu_table(imus: &[ImuReport]) -> Table {
    let mut table = Table::new(&[
        "IMU", "state", "roll °", "pitch °", "yaw °", "rad/s", "m/s²", "°C", "age ms", "samples", "missing",
        "rejected",
    ]);
    for imu in imus {
        let angle = |axis: usize| {
            Cell::number(imu.roll_pitch_yaw.map(|angles| f64::from(angles[axis]).to_degrees()), 1)
        };
        table.row(vec![
            Cell::plain(&imu.name),
            state(imu),
            angle(0),
            angle(1),
            angle(2),
            Cell::number(imu.turning(), 2),
            Cell::number(imu.acceleration.map(length), 2),
            Cell::number(imu.temperature_celsius.map(f64::from), 0),
            Cell::number(imu.age_us.map(|age| age / 1e3), 1),
            Cell::plain(imu.sequence),
            Cell::counter(imu.missing),
            Cell::counter(imu.rejected),
        ]);
    }
    table
}

fn state(imu: &ImuReport) -> Cell {
    match (imu.lost, imu.contradictions.is_empty()) {
        (true, _) => Cell::new("lost", Colour::Red),
        (false, false) => Cell::new("contradicts", Colour::Red),
        (false, true) => Cell::plain("present"),
    }
}

/// Returns the sentences of conventions, by name.
pub(crate) fn sentences(names: &[&str]) -> String {
    let known = ImuContradiction::ALL.iter().filter(|known| names.contains(&known.name()));
    known.map(|known| known.sentence()).collect::<Vec<_>>().join(" ")
}

fn length(vector: [f32; 3]) -> f64 {
    vector.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt()
}
