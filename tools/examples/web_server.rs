//! A web server that answers surfaces: `cargo run --example web_server -- ARCHIVE`, then open
//! `http://127.0.0.1:8080/surface.glb?isovalue=600`.
//!
//! The archive stays open, so blocks that one question decoded are there for the next. A surface is
//! streamed: no more of it is in memory than its budget.
#![allow(clippy::print_stdout)]

use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::{Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use isospan::formats::surface::SurfaceFormat;
use isospan::{Archive, Resources};
use std::io::{self, Write};
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

#[derive(serde::Deserialize)]
struct Question {
    isovalue: f64,
}

/// The answers of an archive.
pub(crate) fn router(archive: Archive) -> Router {
    let routes = Router::new().route("/range", get(range)).route("/surface.glb", get(surface));
    routes.with_state(Arc::new(archive))
}

/// Least and largest value.
async fn range(State(archive): State<Arc<Archive>>) -> String {
    format!("{:?}\n", archive.value_range())
}

/// Sends what is written as pieces of an answer.
struct Pieces(mpsc::Sender<io::Result<Bytes>>);

impl Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = Ok(Bytes::copy_from_slice(bytes));
        self.0.blocking_send(piece).map_err(|_| io::ErrorKind::BrokenPipe)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Who goes away ends the extraction: the channel is closed then, and `send` says so.
async fn surface(State(archive): State<Arc<Archive>>, Query(asked): Query<Question>) -> Response {
    // What is wrong with the question is known before the first byte.
    if let Err(error) = archive.count(asked.isovalue) {
        return (StatusCode::BAD_REQUEST, error.to_string()).into_response();
    }
    let (send, receive) = mpsc::channel::<io::Result<Bytes>>(4);
    // Extraction computes: it has a thread that may block.
    tokio::task::spawn_blocking(move || {
        let resources = Resources::default().with_memory(256 << 20);
        let query = archive.query(asked.isovalue).resources(resources);
        let done = query.write_to(&mut Pieces(send.clone()), SurfaceFormat::Glb);
        if let Err(error) = done {
            // The connection breaks off, so that nobody takes a part for the whole.
            let _ = send.blocking_send(Err(io::Error::other(error.to_string())));
        }
    });
    let kind = [(header::CONTENT_TYPE, "model/gltf-binary")];
    (kind, Body::from_stream(ReceiverStream::new(receive))).into_response()
}

#[allow(dead_code, reason = "the test calls router")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("usage: web_server ARCHIVE")?;
    let app = router(Archive::open(path)?);
    tokio::runtime::Runtime::new()?.block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:8080").await?;
        println!("http://{}/surface.glb?isovalue=…", listener.local_addr()?);
        Ok(axum::serve(listener, app).await?)
    })
}
