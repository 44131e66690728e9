//! An insertion in plain code: the reference for the vector path, and the path of machines without
//! vectors.

use super::arena::{Arena, DEAD, FACE_FROM_BEYOND, FIRST_TAG, LAST_TAG};

/// With more vertices than this on a cavity, edges are joined by sorting: the table would not fit
/// in cache, nor its codes in 16 bits.
pub(super) const MOST_TABLE_VERTICES: usize = 1024;

impl Arena {
    /// Inserts a vertex; `next` is the one after it, for which conflicts with the new tetrahedra
    /// are noted.
    pub(super) fn insert_plain(&mut self, vertex: u32, next: Option<u32>) {
        if self.cavity.is_empty() {
            let tet = self.locate(vertex);
            self.cavity.push(tet);
        }
        self.grow_cavity_plain(vertex);
        self.allocate();
        self.number_plain(vertex);
        self.join_edges();
        self.write_plain(vertex, next);
    }

    /// Completes the cavity from the tetrahedra already in it, and lists its boundary.
    fn grow_cavity_plain(&mut self, vertex: u32) {
        let p = self.points[vertex as usize].f64s();
        self.boundary.clear();
        for &tet in &self.cavity {
            self.tets[tet as usize].v[0] |= DEAD;
        }
        let mut done = 0;
        while done < self.cavity.len() {
            let tet = self.cavity[done];
            done += 1;
            for i in 0..4 {
                let code = self.tets[tet as usize].n[i];
                let there = code >> 2;
                if self.tets[there as usize].is_dead() {
                    continue;
                }
                if self.conflicts(there, vertex, p) {
                    self.tets[there as usize].v[0] |= DEAD;
                    self.cavity.push(there);
                } else {
                    self.boundary.push(code);
                }
            }
        }
    }

    /// Numbers the vertices of the boundary, and copies what the new tetrahedra need before records
    /// are overwritten.
    fn number_plain(&mut self, vertex: u32) {
        if self.tag > LAST_TAG {
            self.points.iter_mut().for_each(|p| p.tag = 0);
            self.tag = FIRST_TAG;
        }
        let p = self.points[vertex as usize].f64s();
        let star = &mut self.star;
        star.facet.clear();
        star.local.clear();
        self.local.clear();
        for &code in &self.boundary {
            let beyond = &self.tets[(code >> 2) as usize];
            let corners = FACE_FROM_BEYOND[(code & 3) as usize].map(|k| beyond.v[k]);
            let numbers = corners.map(|v| {
                let q = &mut self.points[v as usize];
                let known = q.tag.wrapping_sub(self.tag);
                if (known as usize) < self.local.len() {
                    return known;
                }
                let number = self.local.len() as u32;
                q.tag = self.tag + number;
                let d: [f64; 3] = std::array::from_fn(|k| f64::from(q.at[k]) - p[k]);
                self.local.push([d[0], d[1], d[2], d[0] * d[0] + d[1] * d[1] + d[2] * d[2]]);
                number
            });
            star.facet.push([corners[0], corners[1], corners[2], code]);
            star.local.push([numbers[0], numbers[1], numbers[2], 0]);
        }
        self.tag += self.local.len() as u32;
    }

    /// The directed edges of entry `k`, each with the face of the new tetrahedron that holds it.
    #[inline]
    fn edges_of([a, b, c, _]: [u32; 4]) -> [(u32, u32); 3] {
        [(b, c), (c, a), (a, b)]
    }

    /// Writes the neighbours of the new tetrahedra among themselves. The boundary of a cavity is a
    /// closed surface, oriented all one way: each edge occurs once in each direction.
    pub(super) fn join_edges(&mut self) {
        let log2 = self.local.len().next_power_of_two().trailing_zeros().max(6);
        if self.local.len() > MOST_TABLE_VERTICES {
            return self.join_edges_by_sorting();
        }
        let Self { star, tets, .. } = self;
        if star.edges.len() < 1 << (2 * log2) {
            star.edges.resize(1 << (2 * log2), 0);
        }
        for (k, &local) in star.local.iter().take(star.id.len()).enumerate() {
            for (face, (from, to)) in Self::edges_of(local).into_iter().enumerate() {
                star.edges[(from << log2 | to) as usize] = (4 * k + face) as u16;
            }
        }
        for (&local, &id) in star.local.iter().zip(&star.id) {
            for (face, (from, to)) in Self::edges_of(local).into_iter().enumerate() {
                let code = star.edges[(to << log2 | from) as usize];
                tets[id as usize].n[face] = star.id[usize::from(code >> 2)] << 2 | u32::from(code & 3);
            }
        }
    }

    fn join_edges_by_sorting(&mut self) {
        let Self { star, tets, .. } = self;
        star.edge_list.clear();
        for (&local, &id) in star.local.iter().zip(&star.id) {
            for (face, (from, to)) in Self::edges_of(local).into_iter().enumerate() {
                let edge = u64::from(from.min(to)) << 32 | u64::from(from.max(to));
                star.edge_list.push((edge, id << 2 | face as u32));
            }
        }
        star.edge_list.sort_unstable();
        for pair in star.edge_list.chunks_exact(2) {
            let [(edge, one), (same, other)] = [pair[0], pair[1]];
            assert_eq!(edge, same, "the boundary of a cavity is a closed surface");
            tets[(one >> 2) as usize].n[(one & 3) as usize] = other;
            tets[(other >> 2) as usize].n[(other & 3) as usize] = one;
        }
    }

    /// Writes the new tetrahedra, (facet, vertex) each; those in conflict with the next point
    /// become the next cavity's seeds.
    fn write_plain(&mut self, vertex: u32, next: Option<u32>) {
        let p = self.points[vertex as usize].f64s();
        let q = next.map_or([f64::NAN; 3], |next| self.points[next as usize].f64s());
        self.hint = self.star.id[0];
        let mut least = f64::INFINITY;
        for ((&id, facet), local) in self.star.id.iter().zip(&self.star.facet).zip(&self.star.local) {
            let record = &mut self.tets[id as usize];
            let legs = [local[0], local[1], local[2]].map(|l| self.local[l as usize]);
            record.v = [facet[0], facet[1], facet[2], vertex];
            record.n[3] = facet[3];
            record.sphere = self.margin.sphere(p, legs);
            let power = record.power(q);
            if power < -self.margin.e {
                self.cavity.push(id);
            }
            if power < least {
                (least, self.hint) = (power, id);
            }
            self.tets[(facet[3] >> 2) as usize].n[(facet[3] & 3) as usize] = id << 2 | 3;
        }
    }
}
