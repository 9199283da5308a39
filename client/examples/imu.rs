//! Publishes the samples of an external IMU: here of a body that slowly rolls to and fro.
//!
//! Replace `measured` by the reading of a device. The robot's configuration needs
//!
//! ```toml
//! [[imu]]
//! name = "base"
//! type = "external"
//! rate-hz = 1000
//! ```

use clap::Parser;
use motord_client::{Client, DEFAULT_INSTANCE, Error, ImuSample};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Publish the samples of an external IMU.
#[derive(Parser)]
struct Options {
    /// Instance of motord.
    #[arg(long, env = "MOTORD_INSTANCE", default_value = DEFAULT_INSTANCE)]
    instance: String,
    /// Name of the IMU.
    #[arg(long, default_value = "base")]
    imu: String,
    /// Samples per second.
    #[arg(long, default_value_t = 1000.0)]
    rate_hz: f64,
    /// End after this many samples.
    #[arg(long)]
    count: Option<u64>,
}

fn main() -> ExitCode {
    match publish(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("imu: {error}");
            ExitCode::from(error.exit_status())
        }
    }
}

fn publish(options: &Options) -> Result<(), Error> {
    let client = Client::connect(&options.instance)?;
    let mut publisher = client.publish_imu(&options.imu)?;
    let period = Duration::from_secs_f64(1.0 / options.rate_hz);
    let (start, mut sent, mut is_used) = (Instant::now(), 0, false);
    while options.count.is_none_or(|count| sent < count) {
        match publisher.send(&measured(start.elapsed())) {
            Ok(()) => {}
            // The daemon starts again, or another process publishes: later samples may be used.
            Err(error) if error.is_transient() => {}
            Err(error) => return Err(error),
        }
        sent += 1;
        if is_used != publisher.is_used() {
            is_used = publisher.is_used();
            println!(
                "{}",
                if is_used { "motord uses the samples" } else { "motord does not use the samples" }
            );
        }
        // The grid of samples has no drift.
        let next = start + period * u32::try_from(sent).unwrap_or(u32::MAX);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    Ok(())
}

/// Returns the sample of this moment: 0.1 rad of roll, once in 4 s.
fn measured(time: Duration) -> ImuSample {
    let turn = std::f64::consts::TAU / 4.0;
    let phase = turn * time.as_secs_f64();
    let (roll, roll_rate) = (0.1 * phase.sin(), 0.1 * turn * phase.cos());
    let (sin, cos) = (roll / 2.0).sin_cos();
    ImuSample {
        orientation: [cos as f32, sin as f32, 0.0, 0.0],
        angular_velocity: [roll_rate as f32, 0.0, 0.0],
        acceleration: [0.0, (9.81 * roll.sin()) as f32, (9.81 * roll.cos()) as f32],
        temperature: None,
        time_ns: 0,
    }
}
