use super::*;
use std::collections::BTreeSet;

/// The faces of a cube, seen from outside.
const CUBE: [&[u64]; 6] =
    [&[0, 3, 2, 1], &[4, 5, 6, 7], &[0, 1, 5, 4], &[1, 2, 6, 5], &[2, 3, 7, 6], &[3, 0, 4, 7]];

fn numbers(faces: &[&[u64]]) -> Vec<u64> {
    faces.iter().flat_map(|face| std::iter::once(face.len() as u64).chain(face.iter().copied())).collect()
}

fn corner(v: u64) -> [f64; 3] {
    let around = if v % 4 > 1 { v ^ 1 } else { v };
    [around & 1, around >> 1 & 1, around >> 2].map(|c| c as f64)
}

#[test]
fn faces_are_turned_one_way() {
    let good = numbers(&CUBE);
    let mut kept = good.clone();
    check(&mut kept).unwrap();
    assert_eq!(kept, good);
    // Any of the others may be listed as it is seen from inside: the first one decides.
    for turned in 1..32u32 {
        let mut faces: Vec<Vec<u64>> = CUBE.map(<[u64]>::to_vec).to_vec();
        (0..5).filter(|i| turned >> i & 1 == 1).for_each(|i| faces[i + 1].reverse());
        let mut found = numbers(&faces.iter().map(|f| &f[..]).collect::<Vec<_>>());
        check(&mut found).unwrap();
        for (face, good) in Faces::new(&found).zip(CUBE) {
            let start = face.iter().position(|v| *v == good[0]).unwrap();
            let rotated: Vec<u64> = (0..4).map(|i| face[(start + i) % 4]).collect();
            assert_eq!(rotated, good, "{turned}");
        }
    }
}

#[test]
fn what_is_no_surface_of_a_body_is_refused() {
    let moved: Vec<Vec<u64>> = CUBE.iter().map(|f| f.iter().map(|v| v + 8).collect()).collect();
    let two: Vec<&[u64]> = CUBE.into_iter().chain(moved.iter().map(|f| &f[..])).collect();
    // Two tetrahedra with a common edge.
    let hinge: [&[u64]; 8] =
        [&[0, 2, 1], &[0, 1, 3], &[1, 2, 3], &[0, 3, 2], &[0, 5, 1], &[0, 1, 6], &[1, 5, 6], &[0, 6, 5]];
    // The real projective plane, of six points.
    let plane: [&[u64]; 10] = [
        &[0, 1, 4],
        &[0, 1, 5],
        &[0, 2, 3],
        &[0, 2, 5],
        &[0, 3, 4],
        &[1, 2, 3],
        &[1, 2, 4],
        &[1, 3, 5],
        &[2, 4, 5],
        &[3, 4, 5],
    ];
    for (faces, expected, got) in [
        (&CUBE[..3], "at least 4 faces of a polyhedron", "3"),
        (&CUBE[..5], "faces that close: each edge in two of them", "the edge of points 0 and 3 in 1"),
        (&two, "faces that hang together", "2 surfaces"),
        (&hinge, "faces that close: each edge in two of them", "the edge of points 0 and 1 in 4"),
        (&plane, "faces that are the surface of a body", "a surface with one side"),
        (&[&[0, 1], &[1, 2], &[0, 1], &[1, 2]], "at least 3 points of a face", "2 of face 0"),
        (
            &[&[0, 2, 1], &[0, 1, 3], &[1, 2, 3, 2], &[0, 3, 2]],
            "faces whose points differ",
            "face 2 with a point twice",
        ),
    ] {
        let wrong = check(&mut numbers(faces)).unwrap_err();
        assert_eq!(wrong, (expected, got.to_string()));
    }
}

#[test]
fn a_cone_covers_its_faces() {
    let mut tets = vec![];
    assert_eq!(cone(9, &[5, 2, 7, 4], Cut::Smallest, &mut tets), 0);
    assert_eq!(tets, [[9, 2, 7, 4], [9, 2, 4, 5]]);
    tets.clear();
    assert_eq!(cone(9, &[5, 2, 7, 4], Cut::From(0), &mut tets), 0);
    assert_eq!(tets, [[9, 5, 2, 7], [9, 5, 7, 4]]);
    tets.clear();
    assert_eq!(cone(9, &[5, 2, 7], Cut::Around(8), &mut tets), 0);
    assert_eq!(tets, [[9, 8, 5, 2], [9, 8, 2, 7], [9, 8, 7, 5]]);
    assert_eq!(cone(9, &[5, 9, 7], Cut::Smallest, &mut tets), 1);
    assert_eq!(tets.len(), 3);
    let faces = numbers(&[&[0, 1, 2], &[0, 1, 2, 3], &[0, 1, 2, 3, 4]]);
    assert_eq!(tetrahedra_of(Faces::new(&faces)), 1 + 2 + 5);
    let mut found = vec![];
    distinct(Faces::new(&faces), &mut found);
    assert_eq!(found, [0, 1, 2, 3, 4]);
}

/// Every order of four numbers, both ways around: the same corner.
#[test]
fn straight_corners_and_those_that_point_inwards_are_found_from_both_sides() {
    let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let needle = [[0.0, 0.0, 0.0], [1.0, -0.001, 0.0], [2.0, 0.0, 0.0], [1.0, 0.001, 0.0]];
    let hanging = [[0.0, 0.0, 0.0], [0.3, 0.3, 0.1], [0.9, 0.9, 0.3], [0.0, 1.0, 0.0]];
    let dart = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.6, 0.5, 0.1], [0.0, 2.0, 0.0]];
    for (corners, bent) in
        [(square, BTreeSet::new()), (needle, [1, 3].into()), (hanging, [1].into()), (dart, [2].into())]
    {
        for order in 0..24u64 {
            let mut left = vec![0, 1, 2, 3];
            let of = |left: &mut Vec<usize>, n: u64| left.remove(n as usize);
            let places =
                [of(&mut left, order / 6), of(&mut left, order % 6 / 2), of(&mut left, order % 2), left[0]];
            // The number of each corner.
            let names: [u64; 4] =
                std::array::from_fn(|c| places.iter().position(|&p| p == c).unwrap() as u64);
            let place = |v: u64| corners[places[v as usize]];
            let mut found = BTreeSet::new();
            for turn in 0..8 {
                let face: Vec<u64> = match turn {
                    0..4 => (0..4).map(|i| names[(i + turn) % 4]).collect(),
                    _ => (0..4).map(|i| names[(8 - i + turn) % 4]).collect(),
                };
                found.insert(bent_corner(&face, place).map(|i| places[face[i] as usize]));
            }
            assert_eq!(found.len(), 1, "{corners:?} {order}: {found:?}");
            let found = found.into_iter().next().flatten();
            // Two straight corners are as good as each other.
            assert!(found.map_or(bent.is_empty(), |c| bent.contains(&c)), "{corners:?} {order}: {found:?}");
        }
    }
}

#[test]
fn folded_polyhedra_are_told_from_good_ones() {
    let good = numbers(&CUBE);
    assert!(!is_folded(Faces::new(&good), corner));
    // A corner that is pushed through the opposite one.
    let pushed = |v: u64| if v == 6 { [-1.0; 3] } else { corner(v) };
    assert!(is_folded(Faces::new(&good), pushed));
    // Seen from inside, all tetrahedra are turned the other way.
    let inside: Vec<Vec<u64>> = CUBE.iter().map(|f| f.iter().rev().copied().collect()).collect();
    let inside = numbers(&inside.iter().map(|f| &f[..]).collect::<Vec<_>>());
    assert!(!is_folded(Faces::new(&inside), corner));
}
