//! Listening on a port or socket file, and serving the viewer there.

use super::auth::{AccessToken, Guard};
use super::hub::Hub;
#[cfg(unix)]
use super::local;
use super::others::ComparedRun;
use super::render::Renderer;
use super::server::{ServerState, router};
use super::workspace::Workspace;
use crate::memory::Bytes;
use crate::user_error::UserError;
use axum::Router;
use clap::Args;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::Semaphore;

/// Maximum time for the last messages to windows when the viewer ends.
const FAREWELL: Duration = Duration::from_secs(3);

/// Maximum time in which a client must send the headers of a request; a browser sends them at once.
const HEADERS: Duration = Duration::from_secs(10);

/// Maximum number of connections at once: a browser opens up to six for a page, and there are up to eight windows.
const MAX_CONNECTIONS: usize = 64;

/// How the viewer is served.
#[derive(Clone, Debug, Args)]
#[group(id = "serving")]
pub struct ServingOptions {
    /// Port to listen on; any free one if not given.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    pub port: u16,
    /// Address to listen on. Any other than the default makes the viewer reachable from other machines, without
    /// encryption.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub bind: IpAddr,
    /// Listen on this socket file, accessible only to you, instead of a port; for `ssh -L 8137:FILE`. --port is then
    /// the port on your own machine. Unix only.
    #[arg(long, value_name = "FILE", conflicts_with = "bind")]
    pub socket: Option<PathBuf>,
    /// A name under which browsers reach the viewer, besides localhost; may be repeated.
    #[arg(long = "allow-host", value_name = "NAME")]
    pub hosts: Vec<String>,
    /// Allow no changes: no segments or edits, and no pausing of a training.
    #[arg(long)]
    pub read_only: bool,
    /// Memory for cached times, over all runs: 100 times of 150,000 Gaussians without edits take 660M.
    #[arg(long, value_name = "SIZE", default_value = "1G", allow_hyphen_values = true)]
    pub cache: Bytes,
}

/// Where a viewer can be reached.
#[derive(Clone, Debug)]
pub struct ViewerAddress {
    /// Address and port; with a socket file, the port is that of the user's own machine in `url`.
    pub address: SocketAddr,
    /// The socket file.
    pub socket: Option<PathBuf>,
    /// Address for a browser; contains the secret.
    pub url: String,
}

/// Why the viewer cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The run cannot be used.
    #[error(transparent)]
    Run(#[from] crate::run::RunError),
    /// The address cannot be used.
    #[error("{address}: {source}; choose another --port, or leave it out")]
    Address {
        /// The address.
        address: SocketAddr,
        /// The system's error.
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
    /// The system failed, such as to give random numbers or threads.
    #[error("the viewer cannot start: {0}")]
    System(std::io::Error),
}

impl UserError for ViewError {
    fn is_input(&self) -> bool {
        match self {
            Self::Run(error) => error.is_input(),
            Self::Address { .. } | Self::Socket { .. } => true,
            Self::System(_) => false,
        }
    }
}

/// Port of the user's own machine that is forwarded to a socket file, if no other is requested.
const FORWARDED_PORT: u16 = 8137;

/// What the viewer listens on.
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
        Err(std::io::Error::new(std::io::ErrorKind::Unsupported, "socket files are supported on Unix only"))
    }

    /// Serves until it is dropped.
    async fn serve(self, router: Router) {
        match self {
            Self::Port(listener) => connections(listener, router).await,
            #[cfg(unix)]
            Self::File(_file, listener) => connections(listener, router).await,
        }
    }
}

/// Serves clients as they come, for ever. At the limit, further ones wait in the system's queue until others end, which
/// those that send nothing do after [`HEADERS`]. An open websocket no longer counts: their number has its own limit.
async fn connections(mut listener: impl axum::serve::Listener, router: Router) {
    let places = Arc::new(Semaphore::new(max_connections()));
    while let Ok(place) = places.clone().acquire_owned().await {
        let (stream, _) = listener.accept().await;
        let mut server = http1::Builder::new();
        server.timer(TokioTimer::new()).header_read_timeout(HEADERS);
        let service = TowerToHyperService::new(router.clone());
        let connection = server.serve_connection(TokioIo::new(stream), service).with_upgrades();
        tokio::spawn(async move {
            // a client that has left or is too slow; nobody else is affected
            drop(connection.await);
            drop(place);
        });
    }
}

/// Maximum number of connections: at most half of the files that the process may open, as its work needs some too.
#[cfg(any(target_os = "linux", target_os = "macos"))]
fn max_connections() -> usize {
    let files = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    files.map_or(MAX_CONNECTIONS, |files| usize::try_from(files / 2).unwrap_or(usize::MAX).clamp(1, MAX_CONNECTIONS))
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn max_connections() -> usize {
    MAX_CONNECTIONS
}

/// A viewer that listens; clients that connect wait until it serves.
pub struct ViewerListener {
    runtime: Runtime,
    listener: Listener,
    guard: Guard,
    serving: ViewerAddress,
    options: ServingOptions,
}

impl ViewerListener {
    /// Starts to listen, with a new secret.
    ///
    /// # Errors
    /// If the address or the socket file cannot be used.
    pub fn open(options: &ServingOptions) -> Result<Self, ViewError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
        let runtime = runtime.map_err(ViewError::System)?;
        let wanted = SocketAddr::new(options.bind, options.port);
        let failed = |source| ViewError::Address { address: wanted, source };
        let (listener, address) = match &options.socket {
            Some(path) => {
                let wrong = |source| ViewError::Socket { path: path.clone(), source };
                let port = if options.port == 0 { FORWARDED_PORT } else { options.port };
                let listener = runtime.block_on(async { Listener::file(path) }).map_err(wrong)?;
                (listener, SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
            }
            None => {
                let listener = runtime.block_on(TcpListener::bind(wanted)).map_err(failed)?;
                let address = listener.local_addr().map_err(failed)?;
                (Listener::Port(listener), address)
            }
        };
        let token = AccessToken::new().map_err(ViewError::System)?;
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
        let guard = Guard::new(token, hosts);
        let serving = ViewerAddress { address, socket: options.socket.clone(), url };
        Ok(Self { runtime, listener, guard, serving, options: options.clone() })
    }

    /// Returns where it can be reached.
    pub fn serving(&self) -> &ViewerAddress {
        &self.serving
    }

    /// Returns how the viewer is served.
    pub fn options(&self) -> &ServingOptions {
        &self.options
    }

    /// Serves `space`, and the `others` that it can be compared with, until `stop` is raised. `ready` is called first.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn serve(
        self,
        space: Workspace,
        others: Vec<ComparedRun>,
        hub: Arc<Hub>,
        stop: &AtomicBool,
        ready: impl FnOnce(),
    ) -> Result<(), ViewError> {
        let Self { runtime, listener, guard, options, .. } = self;
        let cache = usize::try_from(options.cache.0).unwrap_or(usize::MAX);
        let shared = ServerState::new(guard, hub.clone());
        let router = router(shared.clone());
        std::thread::scope(|scope| {
            let drawing = std::thread::Builder::new().name("drawing".into()).spawn_scoped(scope, || {
                Renderer::new(space, others, cache, hub.clone()).run();
            });
            drawing.map_err(ViewError::System)?;
            ready();
            let asked = async {
                while !stop.load(Ordering::Relaxed) {
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
                hub.stop();
                let asked = Instant::now();
                while shared.has_windows() && asked.elapsed() < FAREWELL {
                    tokio::time::sleep(Duration::from_millis(10)).await;
                }
            };
            runtime.block_on(async {
                tokio::select! {
                    () = listener.serve(router) => {}
                    () = asked => {}
                }
            });
            hub.stop();
            Ok(())
        })
    }
}
