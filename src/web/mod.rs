//! Server of the operator's page: it sends snapshots to browsers and takes their inputs.
//!
//! The server has a thread and a runtime of its own. A slow page misses snapshots, and no run waits
//! for it. The server belongs to the program, above the runs: it serves a desk (the channels
//! between user interfaces and runs, [`crate::desk`]), and shows the runs at that desk one after
//! the other.
//!
//! - in: a [`UiEnd`] of the desk
//! - out: the page (only assets of this folder); `GET /camera/{index}`, a picture; `GET /ws`, a
//!   WebSocket that carries stage, snapshots and messages to the page and commands from it;
//!   `GET /foxglove`, a WebSocket that carries the messages of a recording to other programs
//! - access: see [`guard`]; one page commands (see `seats`), the others watch, and each may press
//!   the emergency stop
//! - connections: see `line`; they are limited in number, so that the operator always finds a place

mod foxglove;
pub mod guard;
mod line;
mod pictures;
mod seats;
mod shared;
mod socket;

use crate::desk::UiEnd;
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use guard::{Guard, HostName};
use line::{Door, Line};
use seats::Seats;
use shared::Shared;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::sync::oneshot;

/// Files of the page: path, type, content.
const ASSETS: &[(&str, &str, &str)] = &[
    ("/", "text/html; charset=utf-8", include_str!("assets/index.html")),
    ("/style.css", "text/css; charset=utf-8", include_str!("assets/style.css")),
    ("/main.js", JAVASCRIPT, include_str!("assets/main.js")),
    ("/link.js", JAVASCRIPT, include_str!("assets/link.js")),
    ("/commands.js", JAVASCRIPT, include_str!("assets/commands.js")),
    ("/scene.js", JAVASCRIPT, include_str!("assets/scene.js")),
    ("/render.js", JAVASCRIPT, include_str!("assets/render.js")),
    ("/attention.js", JAVASCRIPT, include_str!("assets/attention.js")),
    ("/settings.js", JAVASCRIPT, include_str!("assets/settings.js")),
    ("/curves.js", JAVASCRIPT, include_str!("assets/curves.js")),
    ("/timeline.js", JAVASCRIPT, include_str!("assets/timeline.js")),
    ("/net.js", JAVASCRIPT, include_str!("assets/net.js")),
    ("/panels.js", JAVASCRIPT, include_str!("assets/panels.js")),
    ("/questions.js", JAVASCRIPT, include_str!("assets/questions.js")),
    ("/manual.js", JAVASCRIPT, include_str!("assets/manual.js")),
    ("/parameters.js", JAVASCRIPT, include_str!("assets/parameters.js")),
    ("/icon.svg", "image/svg+xml", include_str!("assets/icon.svg")),
];
/// Media type of a script.
const JAVASCRIPT: &str = "text/javascript; charset=utf-8";

/// A running server. Dropping it stops the server.
#[derive(Debug)]
pub struct Server {
    /// Address at which the server listens.
    pub address: SocketAddr,
    /// URL for a browser, including the token.
    pub url: String,
    /// Address of the feed for other programs, including the token.
    pub feed_url: String,
    /// URLs for browsers that reach the server through a proxy for TLS, including the token.
    pub proxy_urls: Vec<String>,
    /// Sender whose drop stops the server.
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    /// Starts a server of a desk's page at an address. Pictures and sockets need the token that
    /// [`Self::url`] includes.
    ///
    /// # Errors
    /// The operating system refuses the address, or gives no thread or no random numbers.
    pub fn start(desk: UiEnd, address: SocketAddr) -> std::io::Result<Self> {
        Self::start_behind(desk, address, Vec::new())
    }

    /// Starts a server as [`Self::start`] does. Browsers also reach it by the `names` of proxies.
    ///
    /// # Errors
    /// As for [`Self::start`].
    pub fn start_behind(
        desk: UiEnd,
        address: SocketAddr,
        names: Vec<HostName>,
    ) -> std::io::Result<Self> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let listener = runtime.block_on(tokio::net::TcpListener::bind(address))?;
        // Port 0 is replaced by the one that the system has chosen.
        let address = listener.local_addr()?;
        let guard = Arc::new(Guard::of(address, names)?);
        let (url, feed_url, proxy_urls) = (guard.url(), guard.feed_url(), guard.proxy_urls());
        let shared = Shared { desk, guard, seats: Arc::default(), pictures: Arc::default() };
        let (stop, stopped) = oneshot::channel::<()>();
        let work = move || {
            let service = routes(shared).into_make_service_with_connect_info::<Line>();
            let served = axum::serve(Door::new(listener), service);
            // The shutdown does not wait for connections: a page's WebSocket never ends by itself.
            runtime.block_on(async {
                tokio::select! {
                    biased;
                    _ = stopped => {}
                    ended = served => if let Err(error) = ended {
                        tracing::error!("the page's server has ended: {error}");
                    },
                }
            });
            // Open connections are cut.
            runtime.shutdown_background();
        };
        let thread = std::thread::Builder::new().name("web".into()).spawn(work)?;
        Ok(Self { address, url, feed_url, proxy_urls, stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has printed its message already.
            let _ = thread.join();
        }
    }
}

/// Returns the routes of the server: WebSocket, cameras, files of the page.
fn routes(shared: Shared) -> Router {
    let mut router = Router::new()
        .route("/ws", get(socket::upgrade))
        .route("/camera/{index}", get(camera))
        .route(guard::FEED, get(foxglove::upgrade));
    for &(path, kind, text) in ASSETS {
        router =
            router.route(path, get(move || async move { ([(header::CONTENT_TYPE, kind)], text) }));
    }
    // The check of requests is added last, so that it covers all routes.
    router.layer(middleware::from_fn_with_state(shared.clone(), check)).with_state(shared)
}

/// Obeys a message from a page as if no other page were open. Tests use it without a server.
/// Returns the reason if the message is refused.
#[must_use]
pub fn obey(text: &str, desk: &UiEnd) -> Option<String> {
    socket::obey(text, &Arc::<Seats>::default().newcomer(0, None), desk)
}

/// Checks a request before it is answered, and adds security headers to the answer.
async fn check(State(shared): State<Shared>, request: Request, next: Next) -> Response {
    let mut response = match shared.guard.refuses(request.headers(), request.uri()) {
        Some(reason) => (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response(),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    let mut set = |name: HeaderName, value: &'static str| {
        headers.insert(name, HeaderValue::from_static(value));
    };
    // Browsers keep no copies of pictures, guess no media types, load the page in no frame, and
    // tell no server the address of the page.
    set(header::CACHE_CONTROL, "no-store");
    set(header::X_CONTENT_TYPE_OPTIONS, "nosniff");
    set(header::X_FRAME_OPTIONS, "DENY");
    set(header::REFERRER_POLICY, "no-referrer");
    // No page of another server may include an answer, or keep a handle to a page that it opened.
    set(HeaderName::from_static("cross-origin-resource-policy"), "same-origin");
    set(HeaderName::from_static("cross-origin-opener-policy"), "same-origin");
    // The page loads nothing from anywhere else, and no other page may frame it.
    set(
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; \
         connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    );
    response
}

/// Answers `GET /camera/{index}` with the latest picture of a camera and the number of its frame.
async fn camera(
    State(shared): State<Shared>,
    Path(index): Path<usize>,
    headers: HeaderMap,
) -> Response {
    if let Some(reason) = shared.guard.refuses_token_of(&headers) {
        return (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response();
    }
    let picture = shared.desk.pictures.borrow().get(index).cloned().flatten();
    let Some(picture) = picture else {
        return (StatusCode::NOT_FOUND, "no picture yet\n").into_response();
    };
    let frame = picture.frame;
    let Some(file) = shared.pictures.file_of(index, picture).await else {
        return (StatusCode::INTERNAL_SERVER_ERROR, "the picture cannot be encoded\n")
            .into_response();
    };
    let kind = if file.starts_with(b"\x89PNG") { "image/png" } else { "image/jpeg" };
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind));
    // The latest picture may be later than the one that the page asked for.
    headers.insert("x-frame", HeaderValue::from(frame));
    (headers, file).into_response()
}
