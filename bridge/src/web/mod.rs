//! The page for a phone: a server of HTTP in a thread of its own. It shows the robot and stops it.
//! No code for anything else is here.

mod admission;
mod answer;
mod guard;
mod policy;
mod report;
mod server;
mod timed;
mod tls;
mod token;

use crate::config::Web;
use crate::shared::Shared;
use crate::stop::StopDesk;
use crate::threads::spawn;
use guard::Guard;
use server::Server;
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::Arc;
use std::thread::JoinHandle;
use tls::TlsAcceptor;
use token::Tokens;
use tokio::net::{TcpListener, TcpSocket};
use tokio::runtime::Builder;
use tokio::task::LocalSet;

/// States of the daemon per second that the page needs: twice its own rate.
const STATES_HZ: f64 = 20.0;
/// Connections that wait to be accepted.
const BACKLOG: u32 = 128;
/// Bytes of a connection that the kernel keeps for a reader. A slow one is noticed within a second.
const SEND_BUFFER: u32 = 32 * 1024;

/// An enabled page whose files are read and valid.
pub(crate) struct Page {
    address: SocketAddr,
    guard: Guard,
    tls: Option<TlsAcceptor>,
}

/// Reads the files of an enabled page; `None` for a disabled one. The error is a sentence.
pub(crate) fn prepare(web: &Web) -> Result<Option<Page>, String> {
    if !web.enabled {
        return Ok(None);
    }
    let tokens = web.token_file.as_deref().map(Tokens::read).transpose()?;
    let tls = web.tls_certificate.as_deref().zip(web.tls_key.as_deref());
    let tls = tls.map(|(certificate, key)| tls::acceptor(certificate, key)).transpose()?;
    let address = SocketAddr::new(web.address, web.port);
    Ok(Some(Page { address, guard: Guard::new(web, tokens), tls }))
}

/// Returns the number of cycles after which the page needs a state.
pub(crate) fn cycles_between_states(cycle_hz: f64) -> u32 {
    (cycle_hz / STATES_HZ).clamp(1.0, 1000.0) as u32
}

impl Page {
    /// Returns what a person opens.
    pub(crate) fn link(&self) -> String {
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        format!("{scheme}://{}/", self.address)
    }
}

/// Listens, and starts the thread.
pub(crate) fn start(
    page: Page,
    shared: &Arc<Shared>,
    desk: &Arc<StopDesk>,
) -> Result<JoinHandle<()>, String> {
    let runtime = Builder::new_current_thread().enable_io().enable_time().build();
    let runtime = runtime.map_err(|error| format!("cannot start the page: {error}"))?;
    let listener = {
        let _context = runtime.enter();
        listen(page.address).map_err(|error| {
            format!("cannot serve the page on {}: {error}; set another web.address or web.port", page.address)
        })?
    };
    log::info!("page: {}", page.link());
    let (shared, desk) = (Arc::clone(shared), Arc::clone(desk));
    let run = move || {
        let server = Rc::new(Server::new(page.guard, desk));
        LocalSet::new().block_on(&runtime, server::run(&server, &listener, page.tls.as_ref(), &shared));
    };
    spawn("web", run)
}

fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4()? } else { TcpSocket::new_v6()? };
    // A restarted bridge finds connections of before.
    socket.set_reuseaddr(true)?;
    // Accepted connections inherit it.
    socket.set_send_buffer_size(SEND_BUFFER)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disabled_page_reads_no_file() {
        let web = Web { token_file: Some("/nonexistent".into()), ..Web::default() };
        assert!(prepare(&web).unwrap().is_none());
        let error = prepare(&Web { enabled: true, ..web }).err().unwrap();
        assert!(error.contains("/nonexistent"), "{error}");
    }

    #[test]
    fn slow_robot_still_has_a_cycle() {
        assert_eq!([1000.0, 50.0, 1.0, f64::NAN].map(cycles_between_states), [50, 2, 1, 0]);
    }
}
