//! A source of states and a sink of positions, for one group of joints.

use bincode::{Decode, Encode};
use cu29::prelude::*;
use motord_client::{Claim, Client, Error, Phase, Setpoint, Slot};
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;
use std::time::Duration;

/// Longer than a shared machine stalls.
const TIMEOUT: Duration = Duration::from_secs(1);
/// Longer than motors take to start or to stop.
const CHANGE: Duration = Duration::from_secs(5);

/// The measured state of the group, each list in the order of motord's configuration. NaN where a motor has not
/// reported.
#[derive(Debug, Clone, Default, Encode, Decode, Serialize, Deserialize, Reflect)]
pub struct Joints {
    /// When the states were complete, ns on `CLOCK_MONOTONIC`.
    pub time_ns: u64,
    /// rad
    pub position: Vec<f32>,
    /// rad/s
    pub velocity: Vec<f32>,
    /// N·m
    pub torque: Vec<f32>,
}

/// Where the group shall be, rad, in the order of motord's configuration.
#[derive(Debug, Clone, Default, Encode, Decode, Serialize, Deserialize, Reflect)]
pub struct Positions(pub Vec<f32>);

/// The states of a group. Waits for the next cycle of motord, so that the graph runs once per cycle.
#[derive(Reflect)]
#[reflect(from_reflect = false)]
pub struct States {
    #[reflect(ignore)]
    client: &'static Client,
    #[reflect(ignore)]
    joints: Vec<usize>,
}

impl Freezable for States {}

impl CuSrcTask for States {
    type Resources<'r> = ();
    type Output<'m> = output_msg!(Joints);

    fn new(config: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
        let client = client(&text(config, "instance")?)?;
        let group = client.group_named(&text(config, "group")?).map_err(of)?;
        let joints = client.description().groups[group].joints.clone();
        Ok(Self { client, joints })
    }

    fn process(&mut self, _: &CuContext, output: &mut Self::Output<'_>) -> CuResult<()> {
        let state = self.client.wait(TIMEOUT).map_err(of)?;
        let joints = || self.joints.iter().filter_map(|&joint| state.joint(joint));
        output.set_payload(Joints {
            time_ns: state.publish_ns(),
            position: joints().map(|joint| joint.position().unwrap_or(f32::NAN)).collect(),
            velocity: joints().map(|joint| joint.velocity().unwrap_or(f32::NAN)).collect(),
            torque: joints().map(|joint| joint.torque().unwrap_or(f32::NAN)).collect(),
        });
        Ok(())
    }
}

/// The setpoints of a group. Copper's start claims and enables it where its joints are; Copper's stop, and
/// a stop of motord, end the graph with the group disabled.
#[derive(Reflect)]
#[reflect(from_reflect = false)]
pub struct Setpoints {
    #[reflect(ignore)]
    client: &'static Client,
    #[reflect(ignore)]
    claim: Option<(Claim, Vec<Slot>)>,
    group: String,
    kp: f32,
    kd: f32,
}

impl Freezable for Setpoints {}

impl CuSinkTask for Setpoints {
    type Resources<'r> = ();
    type Input<'m> = input_msg!(Positions);

    fn new(config: Option<&ComponentConfig>, (): ()) -> CuResult<Self> {
        let client = client(&text(config, "instance")?)?;
        let [kp, kd] = [number(config, "kp")?, number(config, "kd")?];
        Ok(Self { client, claim: None, group: text(config, "group")?, kp, kd })
    }

    fn start(&mut self, _: &CuContext) -> CuResult<()> {
        let mut claim = self.client.claim(&self.group).map_err(of)?;
        start(self.client, &mut claim, [self.kp, self.kd]).map_err(of)?;
        let names: Vec<String> = claim.names().map(str::to_owned).collect();
        let slots = claim.slots(&names).map_err(of)?;
        self.claim = Some((claim, slots));
        Ok(())
    }

    fn process(&mut self, _: &CuContext, input: &Self::Input<'_>) -> CuResult<()> {
        let (Some((claim, slots)), Some(Positions(positions))) = (&mut self.claim, input.payload()) else {
            return Ok(());
        };
        if positions.len() != slots.len() {
            return Err(format!("{} positions for {} joints", positions.len(), slots.len()).into());
        }
        for (&slot, &position) in slots.iter().zip(positions) {
            claim.set(slot, Setpoint::hold(position, self.kp, self.kd)).map_err(of)?;
        }
        claim.commit().map_err(of)
    }

    fn stop(&mut self, _: &CuContext) -> CuResult<()> {
        let Some((mut claim, _)) = self.claim.take() else { return Ok(()) };
        claim.disable().map_err(of)?;
        claim.wait_for(Phase::Disarmed, CHANGE).map_err(of)
    }
}

/// The connection of this process. Source and sink share it: then a setpoint counts as the answer to the state
/// that the source has read.
fn client(instance: &str) -> CuResult<&'static Client> {
    static CLIENT: OnceLock<Client> = OnceLock::new();
    if let Some(client) = CLIENT.get() {
        return Ok(client);
    }
    let client = Client::connect(instance).map_err(of)?;
    Ok(CLIENT.get_or_init(|| client))
}

/// Enables the group where its joints are.
fn start(client: &Client, claim: &mut Claim, [kp, kd]: [f32; 2]) -> Result<(), Error> {
    claim.hold(&client.wait(TIMEOUT)?, kp, kd)?;
    claim.commit()?;
    claim.enable()?;
    claim.wait_for(Phase::Active, CHANGE)
}

/// The sentence of motord, with its advice.
fn of(error: Error) -> CuError {
    error.to_string().into()
}

fn text(config: Option<&ComponentConfig>, key: &str) -> CuResult<String> {
    let value = config.and_then(|config| config.get::<String>(key).transpose()).transpose()?;
    value.ok_or_else(|| format!("the configuration of the task needs the text {key}").into())
}

fn number(config: Option<&ComponentConfig>, key: &str) -> CuResult<f32> {
    let value = config.and_then(|config| config.get::<f64>(key).transpose()).transpose()?;
    value
        .map(|value| value as f32)
        .ok_or_else(|| format!("the configuration of the task needs the number {key}").into())
}
