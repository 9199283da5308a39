//! Sways each joint of the simulated quadruped by 0.1 rad: the graph of copperconfig.ron runs once in each
//! cycle of motord, until Ctrl-C.

mod motors;

use cu29::prelude::*;
use motors::{Joints, Positions};

// No doc: the macro puts its own words before it.
#[copper_runtime(config = "copperconfig.ron")]
struct Sway {}

/// A controller: from states to positions.
#[derive(Default, Reflect)]
pub struct Controller {
    /// Where the joints were, rad, and the time, ns, both when it began.
    begun: Option<(Vec<f32>, u64)>,
}

impl Freezable for Controller {}

impl CuTask for Controller {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Joints);
    type Output<'m> = output_msg!(Positions);

    fn new(_: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
        Ok(Self::default())
    }

    fn process(
        &mut self,
        _: &CuContext,
        input: &Self::Input<'_>,
        output: &mut Self::Output<'_>,
    ) -> CuResult<()> {
        let Some(joints) = input.payload() else { return Ok(()) };
        let (centre, begun) = self.begun.get_or_insert_with(|| (joints.position.clone(), joints.time_ns));
        let time = (joints.time_ns - *begun) as f32 / 1e9;
        let offset = 0.05 * (1.0 - (3.0 * time).cos());
        output.set_payload(Positions(centre.iter().map(|centre| centre + offset).collect()));
        Ok(())
    }
}

fn main() -> CuResult<()> {
    let log = std::env::temp_dir().join("sway.copper");
    Sway::builder().with_log_path(&log, Some(64 << 20))?.build()?.run_until_shutdown()?;
    Ok(())
}
