//! The check of `motorctl doctor` whether the IMUs of a running daemon agree about gravity.

use crate::imu_report::sentences;
use crate::status;
use motord_client::{Imu, ImuContradiction, ImuDescription};
use motord_doctor::Finding;

/// Returns a finding of `doctor` for each IMU of a running daemon; none without a daemon. Waits for
/// a state only where there is an IMU.
pub(crate) fn findings(instance: &str) -> Vec<Finding> {
    let Ok(client) = status::connect(instance) else { return Vec::new() };
    let imus = client.description().imus.clone();
    if imus.is_empty() {
        return Vec::new();
    }
    let Ok(state) = client.wait(status::TIMEOUT) else { return Vec::new() };
    let finding = |(of, imu): (ImuDescription, Imu)| {
        const CHECK: &str = "IMU gravity";
        let names: Vec<_> = imu.contradictions().map(ImuContradiction::name).collect();
        let finding = match names.is_empty() {
            true => Finding::good(CHECK, "no contradiction"),
            false => Finding::warn(CHECK, names.join(", "), sentences(&names))
                .mended_by("motorctl explain imu-contradicts".to_owned()),
        };
        finding.of(&of.name)
    };
    imus.into_iter().zip(state.imus()).map(finding).collect()
}
