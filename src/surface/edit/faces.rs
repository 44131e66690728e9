//! The faces of a domain, on which caps lie: what changes a surface keeps caps in their planes.

use super::clip::HalfSpace;
use isospan_io::geom::vec3::{dot, minus};

/// Which faces a vertex lies on: a bit for each.
pub(super) type OnFaces = u8;

/// The planes of the faces of a domain, at most 8. Without any, no vertex is held.
#[derive(Clone, Debug, Default)]
pub struct Faces(Vec<HalfSpace>);

impl Faces {
    /// Faces, of the half-spaces whose intersection is the domain.
    ///
    /// # Panics
    /// With more than 8 of them.
    pub fn new(planes: Vec<HalfSpace>) -> Self {
        assert!(planes.len() <= 8, "a bit for each face");
        Self(planes)
    }

    /// The faces that a position lies on, within the precision of `f32`.
    pub(super) fn on(&self, p: [f32; 3]) -> OnFaces {
        let p = p.map(f64::from);
        let bit = |(n, plane): (usize, &HalfSpace)| OnFaces::from(plane.distance(p) == 0.0) << n;
        self.0.iter().enumerate().map(bit).fold(0, |all, bit| all | bit)
    }

    /// Whether a position is on a face, or beyond one, that is none of these.
    pub(super) fn reaches_another(&self, on: OnFaces, p: [f32; 3]) -> bool {
        let p = p.map(f64::from);
        self.0.iter().enumerate().any(|(n, plane)| on >> n & 1 == 0 && plane.distance(p) <= 0.0)
    }

    /// What of a vector lies in all of some faces.
    pub(super) fn along(&self, on: OnFaces, mut v: [f64; 3]) -> [f64; 3] {
        let mut across: Vec<[f64; 3]> = vec![];
        for (_, plane) in self.0.iter().enumerate().filter(|(n, _)| on >> n & 1 == 1) {
            let mut normal = plane.normal();
            for other in &across {
                normal = minus(normal, other.map(|x| x * dot(normal, *other)));
            }
            let length = dot(normal, normal).sqrt();
            // Opposite faces have one direction.
            if length > 1e-9 * dot(plane.normal(), plane.normal()).sqrt() {
                let normal = normal.map(|x| x / length);
                v = minus(v, normal.map(|x| x * dot(v, normal)));
                across.push(normal);
            }
        }
        v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vector_keeps_what_is_along_all_faces() {
        let plane = |normal, offset| HalfSpace::new(normal, offset, [10.0; 3]);
        let faces = Faces::new(vec![
            plane([1.0, 0.0, 0.0], 2.0),
            plane([1.0, 1.0, 0.0], 0.0),
            plane([-1.0, 0.0, 0.0], -2.0),
        ]);
        assert_eq!(faces.on([2.0, 5.0, 1.0]), 0b101);
        assert_eq!(faces.on([2.0, -2.0, 1.0]), 0b111);
        assert_eq!(faces.on([2.001, 5.0, 1.0]), 0);
        assert_eq!(faces.along(0b101, [1.0, 2.0, 3.0]), [0.0, 2.0, 3.0]);
        let in_both = faces.along(0b011, [1.0, 2.0, 3.0]);
        assert!(in_both[0].abs() + in_both[1].abs() < 1e-12 && in_both[2] == 3.0, "{in_both:?}");
        assert!(
            faces.reaches_another(0b101, [2.0, -2.5, 0.0]) && !faces.reaches_another(0b111, [2.0, -2.0, 0.0])
        );
        assert_eq!(Faces::default().along(0, [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    }
}
