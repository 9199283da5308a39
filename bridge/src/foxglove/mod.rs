//! The WebSocket server for viewers, by Foxglove's SDK: what a recording has, thinned, and the stop.
//!
//! The thread `foxglove-publish` has a client of its own and reads states as far as a viewer
//! subscribes. The threads `foxglove-net` send them. A viewer that does not read loses messages.

mod assets;
mod channels;
mod parameters;
mod publish;
mod server;
mod services;
mod thinning;

use crate::config::Config;
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::threads::spawn;
use channels::Channels;
use motord_client::Client;
use publish::Publisher;
use server::{Newcomers, Server};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread::JoinHandle;

/// Starts the server, if the configuration demands it, and the thread that publishes. It ends with
/// the bridge.
pub(crate) fn start(
    config: &Config,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
) -> Result<Option<JoinHandle<()>>, String> {
    let settings = &config.foxglove;
    if !settings.enabled {
        return Ok(None);
    }
    let urdf = settings.robot_description.as_ref().or(config.ros2.robot_description.as_ref());
    let parameters = parameters::all(&shared.robot, urdf.map(PathBuf::as_path))?;
    let channels = Channels::new(&shared.robot)?;
    let newcomers = Arc::new(Newcomers::default());
    let server = Server::start(settings, &channels, parameters, &newcomers, shared, desk)?;
    let client = Client::connect(&config.robot.instance).map_err(|error| error.to_string())?;
    let publisher = Publisher::new(client, channels, server, newcomers, settings, &shared.robot);
    let shared = Arc::clone(shared);
    spawn("foxglove-publish", move || publisher.run(&shared)).map(Some)
}
