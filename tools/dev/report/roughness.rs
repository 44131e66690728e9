//! How smooth does a surface look? The angles between neighbouring triangles.

use isospan::surface::TriMesh;

type Vec3 = [f64; 3];

fn sub(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Twice the area times the unit normal.
fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    let (u, v) = (sub(b, a), sub(c, a));
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// RMS angle between triangles that share an edge, weighted by its length, in degrees: how smooth a
/// surface looks.
pub(crate) fn roughness(mesh: &TriMesh) -> f64 {
    let at = |v: u32| mesh.vertices[v as usize].position.map(f64::from);
    let normals: Vec<Vec3> = mesh.triangles.iter().map(|t| normal(t.map(at))).collect();
    let mut sides: Vec<([u32; 2], usize)> = vec![];
    for (n, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        sides.extend([[a, b], [b, c], [c, a]].map(|[a, b]| ([a.min(b), a.max(b)], n)));
    }
    sides.sort_unstable();
    let (mut squares, mut lengths) = (0.0, 0.0);
    for pair in sides.windows(2).filter(|p| p[0].0 == p[1].0) {
        let [m, n] = [0, 1].map(|i| normals[pair[i].1]);
        let along = sub(at(pair[0].0[0]), at(pair[0].0[1]));
        let length = dot(along, along).sqrt();
        let cosine = (dot(m, n) / (dot(m, m) * dot(n, n)).sqrt()).clamp(-1.0, 1.0);
        if !cosine.is_nan() {
            let angle = libm::acos(cosine).to_degrees();
            squares += angle * angle * length;
            lengths += length;
        }
    }
    if lengths > 0.0 { (squares / lengths).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isospan::surface::Vertex;

    #[test]
    fn a_fold_has_its_angle() {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 1.0]];
        let vertices = vertices.map(|position| Vertex { position, normal: [0.0; 3] }).to_vec();
        let fold = TriMesh {
            vertices: vertices.clone(),
            triangles: vec![[0, 1, 2], [1, 0, 3]],
            ..TriMesh::default()
        };
        assert!((roughness(&fold) - 45.0).abs() < 1e-9, "{}", roughness(&fold));
        assert_eq!(roughness(&TriMesh { vertices, triangles: vec![[0, 1, 2]], ..TriMesh::default() }), 0.0);
    }
}
