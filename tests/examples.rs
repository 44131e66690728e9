//! The examples of tools/examples answer what they promise.

#[path = "../tools/examples/array_to_mesh.rs"]
mod array_to_mesh;
#[path = "../tools/examples/custom_volume.rs"]
mod custom_volume;
#[path = "../tools/examples/time_series.rs"]
mod time_series;
#[path = "../tools/examples/web_server.rs"]
mod web_server;

use isospan::{Archive, Reduction, TriMesh};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;

/// Expects all vertices within `tolerance` of a sphere.
fn expect_sphere(mesh: &TriMesh, middle: [f64; 3], radius: f64, tolerance: f64) {
    assert!(mesh.triangles.len() > 1_000, "{} triangles", mesh.triangles.len());
    for vertex in &mesh.vertices {
        let place = vertex.world(mesh.origin);
        let distance = (0..3).map(|a| (place[a] - middle[a]).powi(2)).sum::<f64>().sqrt();
        assert!((distance - radius).abs() < tolerance, "{distance}");
    }
}

#[test]
fn an_array_becomes_a_mesh() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = array_to_mesh::run(dir.path()).unwrap();
    expect_sphere(&mesh, [15.75, 11.75, 19.5], 9.0, 0.5);
}

#[test]
fn a_series_answers_at_any_moment() {
    let dir = tempfile::tempdir().unwrap();
    let found = time_series::run(dir.path()).unwrap();
    let times: Vec<f64> = found.iter().map(|(time, _)| *time).collect();
    assert_eq!(times, [0.0, 0.5, 1.0, 0.75]);
    // The ball grows, and is between two steps at the moment between them.
    let triangles: Vec<usize> = found.iter().map(|(_, triangles)| *triangles).collect();
    assert!(triangles[0] > 500 && triangles[0] < triangles[1] && triangles[1] < triangles[3]);
    assert!(triangles[3] < triangles[2], "{triangles:?}");
}

#[test]
fn a_volume_of_the_program_is_read_in_boxes() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = custom_volume::run(dir.path()).unwrap();
    // A sample is the square of twice the distance.
    expect_sphere(&mesh, [31.5; 3], 20.0, 1.0);
}

/// What a server answers to a path: all bytes, head included.
fn get(server: std::net::SocketAddr, path: &str) -> Vec<u8> {
    let mut stream = TcpStream::connect(server).unwrap();
    write!(stream, "GET {path} HTTP/1.0\r\nHost: localhost\r\n\r\n").unwrap();
    let mut answer = vec![];
    stream.read_to_end(&mut answer).unwrap();
    answer
}

#[test]
fn a_web_server_streams_the_file_of_a_surface() {
    let dir = tempfile::tempdir().unwrap();
    let (path, file) = (dir.path().join("protein.isospan"), dir.path().join("protein.glb"));
    Reduction::of("datasets/ironprot.vtk").write(&path).unwrap();
    let archive = Archive::open(&path).unwrap();
    archive.query(128.0).write(&file).unwrap();

    let runtime = tokio::runtime::Runtime::new().unwrap();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let server = listener.local_addr().unwrap();
    runtime.spawn(async { axum::serve(listener, web_server::router(archive)).await });
    let answer = get(server, "/surface.glb?isovalue=128");
    let head = answer.windows(4).position(|end| end == b"\r\n\r\n").unwrap();
    assert!(answer.starts_with(b"HTTP/1.0 200"));
    assert!(answer[head + 4..] == fs::read(&file).unwrap());
    assert!(get(server, "/surface.glb?isovalue=nan").starts_with(b"HTTP/1.0 400"));
    assert!(get(server, "/range").ends_with(b"])\n"));
}
