//! The loop of `client/c/tests/allocations.cpp` in Rust, for comparison in the same run: holds a
//! group, and prints the median time of a send and the share of late setpoints.
//!
//!   rate [INSTANCE [GROUP [SECONDS]]]

use motord_client::{Client, Error, Phase};
use std::time::{Duration, Instant};

const TIMEOUT: Duration = Duration::from_secs(1);
/// Cycles that are not measured.
const FIRST: usize = 100;

fn main() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1);
    let instance = arguments.next().unwrap_or_else(|| "demo".into());
    let group = arguments.next().unwrap_or_else(|| "legs".into());
    let seconds: f64 = arguments.next().and_then(|seconds| seconds.parse().ok()).unwrap_or(10.0);
    let client = Client::connect(&instance)?;
    let mut claim = client.claim(&group)?;
    claim.wait_for(Phase::Disarmed, 5 * TIMEOUT)?;
    claim.hold(&client.wait(TIMEOUT)?, 20.0, 0.5)?;
    claim.commit()?;
    claim.enable()?;
    claim.wait_for(Phase::Active, 5 * TIMEOUT)?;
    let cycles = (seconds * 1000.0) as usize;
    let mut times = Vec::with_capacity(cycles);
    let (mut first, mut last) = ((0, 0), (0, 0));
    for cycle in 0..cycles + FIRST {
        let state = client.wait(TIMEOUT)?;
        let view = state.of(&claim)?;
        view.must_be_active()?;
        if let Some(group) = state.group(claim.index()) {
            last = (group.accepted, group.late);
        }
        let begun = Instant::now();
        claim.commit()?;
        match cycle {
            0..FIRST => first = last,
            _ => times.push(begun.elapsed().as_secs_f64() * 1e6),
        }
    }
    times.sort_by(f64::total_cmp);
    let [accepted, late] = [last.0.wrapping_sub(first.0), last.1.wrapping_sub(first.1)].map(f64::from);
    println!(
        "Rust: {} cycles, send p50 {:.2} us, p99 {:.2} us, late {:.2} %",
        times.len(),
        times.get(times.len() / 2).unwrap_or(&f64::NAN),
        times.get(times.len() * 99 / 100).unwrap_or(&f64::NAN),
        100.0 * late / accepted.max(1.0)
    );
    Ok(())
}
