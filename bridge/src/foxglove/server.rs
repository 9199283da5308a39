//! The server of the SDK, with its threads.

use crate::config::Foxglove;
use crate::foxglove::assets::Assets;
use crate::foxglove::channels::{Channels, ROBOT};
use crate::foxglove::parameters::ReadOnly;
use crate::foxglove::services;
use crate::shared::Shared;
use crate::stop::StopDesk;
use foxglove::websocket::{Capability, ChannelView, Client, ParameterHandler, ServerListener, TlsIdentity};
use foxglove::{Context, SinkId, WebSocketServer, WebSocketServerHandle};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::{Builder, Runtime};

/// Interval of checks whether the server still listens.
const CHECK: Duration = Duration::from_secs(2);
/// Longest time in which connections close at the end.
const CLOSE: Duration = Duration::from_secs(1);
/// Limit on viewers that wait for the description of the robot.
const NEWCOMERS_MAX: usize = 64;

/// The viewers that subscribed to `/robot` and have not received it.
#[derive(Debug, Default)]
pub(crate) struct Newcomers(Mutex<Vec<SinkId>>);

impl Newcomers {
    /// Takes them.
    pub(crate) fn take(&self) -> Vec<SinkId> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn add(&self, viewer: SinkId) {
        let mut newcomers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if newcomers.len() < NEWCOMERS_MAX && !newcomers.contains(&viewer) {
            newcomers.push(viewer);
        }
    }
}

impl ServerListener for Newcomers {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        if channel.topic() == ROBOT
            && let Some(viewer) = client.sink_id()
        {
            self.add(viewer);
        }
    }
}

/// The inputs of a server.
struct Parts {
    settings: Foxglove,
    tls: Option<TlsIdentity>,
    context: Arc<Context>,
    parameters: Arc<ReadOnly>,
    assets: Option<Arc<Assets>>,
    newcomers: Arc<Newcomers>,
    shared: Arc<Shared>,
    desk: Arc<StopDesk>,
}

/// A server that listens.
pub(crate) struct Server {
    parts: Parts,
    runtime: Runtime,
    handle: WebSocketServerHandle,
    /// The servers that no longer listen, each with a viewer that is still connected.
    retired: Vec<WebSocketServerHandle>,
    next_check: Instant,
}

impl Server {
    /// Starts the server, and prints its address.
    pub(crate) fn start(
        settings: &Foxglove,
        channels: &Channels,
        parameters: ReadOnly,
        newcomers: &Arc<Newcomers>,
        shared: &Arc<Shared>,
        desk: &Arc<StopDesk>,
    ) -> Result<Self, String> {
        let parts = Parts {
            tls: identity(settings)?,
            context: Arc::clone(channels.context()),
            parameters: Arc::new(parameters),
            assets: settings.assets.as_deref().map(Assets::new).transpose()?.map(Arc::new),
            newcomers: Arc::clone(newcomers),
            shared: Arc::clone(shared),
            desk: Arc::clone(desk),
            settings: settings.clone(),
        };
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .max_blocking_threads(1)
            .thread_name("foxglove-net")
            .enable_all()
            .build()
            .map_err(|error| format!("cannot start the threads of Foxglove's server: {error}"))?;
        let handle = parts.listen(&runtime)?;
        log::info!("Foxglove: {}", handle.app_url());
        if !settings.is_local() {
            log::warn!(
                "Foxglove's server listens on {}: everyone who reaches it may watch the robot and stop it, without a password",
                settings.address
            );
        }
        Ok(Self { parts, runtime, handle, retired: Vec::new(), next_check: Instant::now() + CHECK })
    }

    /// Returns the number of viewers.
    pub(crate) fn viewers(&self) -> usize {
        self.retired.iter().chain([&self.handle]).map(WebSocketServerHandle::client_count).sum()
    }

    /// Listens again if the server no longer does: the SDK stops listening when it cannot accept a
    /// connection, such as without a free file descriptor. Viewers stay connected, for one may have
    /// sent a stop that is not read yet.
    pub(crate) fn restart_if_closed(&mut self) {
        if Instant::now() < self.next_check {
            return;
        }
        self.next_check = Instant::now() + CHECK;
        let left = self.retired.extract_if(.., |server| server.client_count() == 0);
        left.for_each(|server| drop(server.stop()));
        let address = SocketAddr::new(self.parts.settings.address, self.handle.port());
        // The address of a socket that listens cannot be bound.
        if TcpListener::bind(address).is_err() {
            return;
        }
        self.parts.settings.port = address.port();
        match self.parts.listen(&self.runtime) {
            Ok(handle) => {
                log::warn!("Foxglove's server had stopped listening: it listens again");
                self.retired.push(std::mem::replace(&mut self.handle, handle));
            }
            Err(error) => log::warn!("Foxglove's server has stopped listening: {error}"),
        }
    }

    /// Closes the connections.
    pub(crate) fn stop(self) {
        self.retired.into_iter().chain([self.handle]).for_each(|server| drop(server.stop()));
        self.runtime.shutdown_timeout(CLOSE);
    }
}

impl Parts {
    fn listen(&self, runtime: &Runtime) -> Result<WebSocketServerHandle, String> {
        let settings = &self.settings;
        let host = match settings.address {
            IpAddr::V4(address) => address.to_string(),
            IpAddr::V6(address) => format!("[{address}]"),
        };
        let mut capabilities = vec![Capability::Parameters, Capability::Services];
        capabilities.extend(self.assets.as_ref().map(|_| Capability::Assets));
        let mut server = WebSocketServer::new()
            .name(format!("motord {}", self.shared.robot.instance))
            .bind(host, settings.port)
            .context(&self.context)
            .capabilities(capabilities)
            .supported_encodings(["json"])
            .message_backlog_size(settings.backlog.into())
            .listener(Arc::clone(&self.newcomers) as Arc<dyn ServerListener>)
            .parameter_handler(Arc::clone(&self.parameters) as Arc<dyn ParameterHandler>)
            .services(services::all(&self.shared, &self.desk));
        if let Some(assets) = &self.assets {
            let assets = Arc::clone(assets);
            server = server.fetch_asset_handler_blocking_fn(move |_, uri| assets.read(&uri));
        }
        if let Some(TlsIdentity { cert, key }) = &self.tls {
            server = server.tls(TlsIdentity { cert: cert.clone(), key: key.clone() });
        }
        let address = (settings.address, settings.port);
        let started = runtime.block_on(server.start());
        started.map_err(|error| format!("[foxglove]: cannot listen on {address:?}: {error}"))
    }
}

fn identity(settings: &Foxglove) -> Result<Option<TlsIdentity>, String> {
    let read = |path: &Path| {
        std::fs::read(path).map_err(|error| format!("[foxglove]: cannot read {}: {error}", path.display()))
    };
    let (Some(certificate), Some(key)) = (&settings.tls_certificate, &settings.tls_key) else {
        return Ok(None);
    };
    Ok(Some(TlsIdentity { cert: read(certificate)?, key: read(key)? }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newcomers_are_bounded_and_served_once() {
        let newcomers = Newcomers::default();
        for _ in 0..2 {
            (0..NEWCOMERS_MAX).for_each(|_| newcomers.add(SinkId::next()));
        }
        assert_eq!(newcomers.take().len(), NEWCOMERS_MAX);
        assert!(newcomers.take().is_empty());
    }
}
