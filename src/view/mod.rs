//! The viewer in a browser (`volseggs view`): frames are drawn here and sent over a websocket, so that it works through
//! `ssh -L`, on any machine that runs the program, and shows what `volseggs render` draws.
//!
//! [`server`] lets clients in ([`auth`]) and passes what they say ([`protocol`]) on; [`render`] is the one thread that owns the
//! run ([`workspace`]) and those that it is compared with ([`others`]), answers, and draws, at the [`pace`] of each [`client`]; the [`cache`] holds what was deformed
//! lately. What is done to a run is done by [`crate::run`], as the commands do it; what takes long by [`jobs`] and
//! [`tracks`], on other threads.

pub mod auth;
pub mod cache;
pub mod clicks;
pub mod client;
pub mod compare;
pub mod gizmo;
pub mod hub;
pub mod jobs;
#[cfg(unix)]
pub mod local;
pub mod order;
pub mod others;
pub mod pace;
pub mod page;
pub mod protocol;
pub mod reading;
pub mod render;
pub mod server;
pub mod tracks;
pub mod training;
pub mod workspace;

use auth::{Guard, Token};
use burn::tensor::Device;
use hub::Hub;
use others::Other;
use render::Renderer;
use server::{Shared, router};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::TcpListener;
use workspace::Workspace;

/// How the viewer is served.
#[derive(Clone, Debug)]
pub struct ViewOptions {
    /// Folder of the run.
    pub run: PathBuf,
    /// Runs, or checkpoints of runs, that it can be compared with.
    pub with: Vec<PathBuf>,
    /// Where all of them are drawn.
    pub device: Device,
    /// Address to listen on.
    pub bind: IpAddr,
    /// Port; any that is free if 0.
    pub port: u16,
    /// Socket file in the place of address and port, on Unix.
    pub socket: Option<PathBuf>,
    /// Names under which it may be reached, beside those of the machine itself.
    pub hosts: Vec<String>,
    /// Whether nothing may be changed.
    pub read_only: bool,
    /// Bytes of deformed Gaussians that are kept, of all runs together.
    pub cache: usize,
}

/// Where a viewer can be reached.
#[derive(Clone, Debug)]
pub struct Serving {
    /// Address and port; the port of one's own machine that the address in `url` takes, where it is a socket file.
    pub address: SocketAddr,
    /// The socket file.
    pub socket: Option<PathBuf>,
    /// What a browser opens; holds the secret.
    pub url: String,
}

/// Why there is no viewer.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The run.
    #[error(transparent)]
    Run(#[from] crate::run::RunError),
    /// The address cannot be used.
    #[error("{address}: {source}; choose another --port, or leave it out")]
    Address {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The socket file cannot be used.
    #[error("--socket {}: {source}", path.display())]
    Socket {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: std::io::Error,
    },
    /// The system gives no random numbers or threads.
    #[error("the viewer cannot start: {0}")]
    System(std::io::Error),
}

/// Port of one's own machine from which a socket file is forwarded, if no other is asked for.
const FORWARDED: u16 = 8137;

/// What is listened at.
enum Listener {
    Port(TcpListener),
    #[cfg(unix)]
    File(local::SocketFile, tokio::net::UnixListener),
}

impl Listener {
    #[cfg(unix)]
    fn file(path: &Path) -> std::io::Result<Self> {
        local::SocketFile::listen(path).map(|(file, listener)| Self::File(file, listener))
    }

    #[cfg(not(unix))]
    fn file(_: &Path) -> std::io::Result<Self> {
        Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "there are socket files on Unix alone"))
    }

    async fn serve(self, router: axum::Router) -> std::io::Result<()> {
        match self {
            Self::Port(listener) => axum::serve(listener, router).await,
            #[cfg(unix)]
            Self::File(_file, listener) => axum::serve(listener, router).await,
        }
    }
}

/// Serves the viewer until `stop` is raised; `ready` hears where it can be reached.
///
/// # Errors
/// If the run cannot be opened, or the address cannot be used.
pub fn serve(options: &ViewOptions, stop: &AtomicBool, ready: impl FnOnce(&Serving)) -> Result<(), ViewError> {
    let space = Workspace::open(&options.run, &options.device, options.read_only)?;
    let others = Other::open(&options.with, &options.device)?;
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build().map_err(ViewError::System)?;
    let wanted = SocketAddr::new(options.bind, options.port);
    let failed = |source| ViewError::Address { address: wanted, source };
    let (listener, address) = match &options.socket {
        Some(path) => {
            let wrong = |source| ViewError::Socket { path: path.clone(), source };
            let port = if options.port == 0 { FORWARDED } else { options.port };
            let listener = runtime.block_on(async { Listener::file(path) }).map_err(wrong)?;
            (listener, SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
        }
        None => {
            let listener = runtime.block_on(TcpListener::bind(wanted)).map_err(failed)?;
            let address = listener.local_addr().map_err(failed)?;
            (Listener::Port(listener), address)
        }
    };
    let token = Token::new().map_err(ViewError::System)?;
    let host = match address.ip() {
        ip if ip.is_unspecified() || ip.is_loopback() => "localhost".to_owned(),
        IpAddr::V6(ip) => format!("[{ip}]"),
        IpAddr::V4(ip) => ip.to_string(),
    };
    let url = format!("http://{host}:{}/?token={}", address.port(), token.text());
    let mut hosts = options.hosts.clone();
    if !address.ip().is_unspecified() {
        hosts.push(address.ip().to_string());
    }
    let hub = Arc::new(Hub::default());
    let router = router(Shared::new(Guard::new(token, address.port(), hosts), hub.clone()));
    std::thread::scope(|scope| {
        let drawing = std::thread::Builder::new().name("drawing".into()).spawn_scoped(scope, || {
            Renderer::new(space, others, options.cache, hub.clone()).run();
        });
        drawing.map_err(ViewError::System)?;
        ready(&Serving { address, socket: options.socket.clone(), url });
        let asked = async {
            while !stop.load(Ordering::Relaxed) {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        let served = runtime.block_on(async {
            tokio::select! {
                served = listener.serve(router) => served,
                () = asked => Ok(()),
            }
        });
        hub.stop();
        served.map_err(ViewError::System)
    })
}
