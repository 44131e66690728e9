//! Codes arrays for `EXT_meshopt_compression`, front to back (appendix A of the extension; the
//! codec is that of meshoptimizer by Arseny Kapoulkine).
//!
//! ```text
//! attributes  0xa0 | blocks of up to 256 elements | first element, at the end of 32 bytes
//!   block     for each byte of an element: 2 bits a group of 16 | the groups
//!   group     differences to the elements before, zigzag, in 0, 2, 4 or 8 bits
//! triangles   0xe1 | a byte for each triangle | what these bytes do not say | a table of 16 bytes
//! ```
//!
//! A triangle is coded by an edge and a vertex that were there shortly before. So it may begin at
//! another of its corners afterwards; its side stays.

/// Elements of a group.
pub(super) const GROUP: usize = 16;
/// Elements of a block, and bytes of it, at most.
const MOST_ELEMENTS: usize = 256;
const MOST_BYTES: usize = 8192;
/// Bytes at the end of attributes, at least.
const TAIL: usize = 32;
/// The first byte of attributes, and of triangles.
pub(super) const ATTRIBUTES: u8 = 0xa0;
pub(super) const TRIANGLES: u8 = 0xe1;
/// What two corners are, in the codes below 14 of a triangle without an edge.
pub(super) const PAIRS: [u8; 16] =
    [0x00, 0x76, 0x87, 0x56, 0x67, 0x78, 0xa9, 0x86, 0x65, 0x89, 0x68, 0x98, 0x01, 0x69, 0, 0];
/// Vertices from here on are told by the last one that was written out.
pub(super) const TOLD: usize = 13;
/// A corner that is written out, and an edge that is none.
pub(super) const OTHER: usize = 15;

/// Elements of a block, of so many bytes each.
pub(super) fn block_elements(stride: usize) -> usize {
    ((MOST_BYTES / stride) / GROUP * GROUP).min(MOST_ELEMENTS)
}

/// Bytes of the tail of attributes.
pub(super) fn tail_bytes(stride: usize) -> usize {
    stride.max(TAIL)
}

/// Codes elements of a number of bytes that is a multiple of 4.
pub(super) struct AttributeCoder {
    stride: usize,
    /// Elements that do not fill a block.
    waiting: Vec<u8>,
    first: Vec<u8>,
    last: Vec<u8>,
}

impl AttributeCoder {
    pub(super) fn new(stride: usize) -> Self {
        Self { stride, waiting: vec![], first: vec![], last: vec![] }
    }

    /// Codes whole elements.
    pub(super) fn put(&mut self, elements: &[u8], out: &mut Vec<u8>) {
        if self.first.is_empty() && !elements.is_empty() {
            self.first = elements[..self.stride].to_vec();
            self.last = self.first.clone();
            out.push(ATTRIBUTES);
        }
        self.waiting.extend_from_slice(elements);
        let block = self.stride * block_elements(self.stride);
        let waiting = std::mem::take(&mut self.waiting);
        let blocks = waiting.chunks_exact(block);
        self.waiting = blocks.remainder().to_vec();
        blocks.for_each(|block| self.block(block, out));
    }

    /// Ends an array of at least one element.
    pub(super) fn finish(mut self, out: &mut Vec<u8>) {
        let rest = std::mem::take(&mut self.waiting);
        if !rest.is_empty() {
            self.block(&rest, out);
        }
        out.resize(out.len() + tail_bytes(self.stride) - self.stride, 0);
        out.extend_from_slice(&self.first);
    }

    fn block(&mut self, elements: &[u8], out: &mut Vec<u8>) {
        let count = elements.len() / self.stride;
        for (k, last) in self.last.iter_mut().enumerate() {
            let mut steps = [0; MOST_ELEMENTS];
            for (step, element) in steps.iter_mut().zip(elements.chunks_exact(self.stride)) {
                *step = zigzag(element[k].wrapping_sub(*last));
                *last = element[k];
            }
            put_steps(&steps[..count.next_multiple_of(GROUP)], out);
        }
    }
}

fn zigzag(step: u8) -> u8 {
    (step << 1) ^ ((step as i8) >> 7) as u8
}

/// Appends the steps of one byte of the elements of a block.
fn put_steps(steps: &[u8], out: &mut Vec<u8>) {
    let groups = steps.chunks_exact(GROUP);
    let head = out.len();
    out.resize(head + groups.len().div_ceil(4), 0);
    for (n, group) in groups.enumerate() {
        let beyond = |most: u8| group.iter().filter(|&&step| step >= most).count();
        let kind = match (group.iter().all(|&step| step == 0), 4 + beyond(3), 8 + beyond(15)) {
            (true, ..) => 0,
            (_, two, four) if two < GROUP && two <= four => 1,
            (_, _, four) if four < GROUP => 2,
            _ => 3,
        };
        out[head + n / 4] |= kind << (n % 4 * 2);
        match kind {
            0 => {}
            1 => put_group::<2>(group, out),
            2 => put_group::<4>(group, out),
            _ => out.extend_from_slice(group),
        }
    }
}

/// Appends a group in a few bits a step; steps that do not fit follow in full.
fn put_group<const BITS: usize>(group: &[u8], out: &mut Vec<u8>) {
    let most = (1 << BITS) - 1;
    for some in group.chunks_exact(8 / BITS) {
        out.push(some.iter().fold(0, |byte, &step| byte << BITS | step.min(most)));
    }
    out.extend(group.iter().filter(|&&step| step >= most));
}

/// What was there shortly before: both sides of the codec keep the same.
pub(super) struct Recent {
    edges: [[u32; 2]; 16],
    vertices: [u32; 16],
    edge: usize,
    vertex: usize,
    /// The vertex that comes next where they come in order.
    pub(super) next: u32,
    /// The last one that was written out.
    pub(super) last: u32,
}

impl Recent {
    pub(super) fn new() -> Self {
        let none = u32::MAX;
        Self { edges: [[none; 2]; 16], vertices: [none; 16], edge: 0, vertex: 0, next: 0, last: 0 }
    }

    /// The edge that was added so many edges ago.
    pub(super) fn edge(&self, ago: usize) -> [u32; 2] {
        self.edges[self.edge.wrapping_sub(1 + ago) % 16]
    }

    /// The vertex that was added so many vertices ago.
    pub(super) fn vertex(&self, ago: usize) -> u32 {
        self.vertices[self.vertex.wrapping_sub(1 + ago) % 16]
    }

    pub(super) fn add_edge(&mut self, from: u32, to: u32) {
        self.edges[self.edge % 16] = [from, to];
        self.edge = self.edge.wrapping_add(1) % 16;
    }

    pub(super) fn add_vertex(&mut self, vertex: u32) {
        self.vertices[self.vertex % 16] = vertex;
        self.vertex = self.vertex.wrapping_add(1) % 16;
    }

    /// Adds the edges of a triangle, as its neighbours have them.
    pub(super) fn add_edges_of(&mut self, [a, b, c]: [u32; 3]) {
        self.add_edge(b, a);
        self.add_edge(c, b);
        self.add_edge(a, c);
    }

    fn find_vertex(&self, vertex: u32) -> Option<usize> {
        (0..16).find(|&ago| self.vertex(ago) == vertex)
    }

    /// How long ago an edge of a triangle was added, and the triangle from this edge on.
    fn find_edge(&self, [a, b, c]: [u32; 3]) -> Option<(usize, [u32; 3])> {
        let turned = [[a, b, c], [b, c, a], [c, a, b]];
        (0..15).find_map(|ago| {
            let edge = self.edge(ago);
            turned.iter().find(|t| t[..2] == edge).map(|t| (ago, *t))
        })
    }

    /// Whether a vertex is the next one, which it then no longer is.
    fn is_next(&mut self, vertex: u32) -> bool {
        let is_next = vertex == self.next;
        self.next = self.next.wrapping_add(u32::from(is_next));
        is_next
    }
}

/// Codes triangles: bytes for each of them, and bytes that follow those of all.
pub(super) struct TriangleCoder {
    recent: Recent,
}

impl TriangleCoder {
    pub(super) fn new() -> Self {
        Self { recent: Recent::new() }
    }

    /// Codes a triangle; `codes` gets a byte, `data` some.
    pub(super) fn put(&mut self, triangle: [u32; 3], codes: &mut Vec<u8>, data: &mut Vec<u8>) {
        match self.recent.find_edge(triangle) {
            Some((ago, turned)) => self.put_neighbour(ago, turned, codes, data),
            None => self.put_other(triangle, codes, data),
        }
    }

    /// A triangle at an edge that was there before.
    fn put_neighbour(&mut self, ago: usize, [a, b, c]: [u32; 3], codes: &mut Vec<u8>, data: &mut Vec<u8>) {
        let known = self.recent.find_vertex(c).filter(|ago| (1..TOLD).contains(ago));
        let third = match known {
            Some(ago) => ago,
            None if self.recent.is_next(c) => 0,
            None if c.wrapping_add(1) == self.recent.last => TOLD,
            None if c == self.recent.last.wrapping_add(1) => TOLD + 1,
            None => OTHER,
        };
        codes.push((ago << 4 | third) as u8);
        if third == OTHER {
            self.write_out(c, data);
        }
        if third >= TOLD {
            self.recent.last = c;
        }
        if known.is_none() {
            self.recent.add_vertex(c);
        }
        self.recent.add_edge(c, b);
        self.recent.add_edge(a, c);
    }

    /// A triangle of which no edge was there.
    fn put_other(&mut self, [a, b, c]: [u32; 3], codes: &mut Vec<u8>, data: &mut Vec<u8>) {
        let turned = match self.recent.next {
            next if b == next => [b, c, a],
            next if c == next => [c, a, b],
            _ => [a, b, c],
        };
        // The first triangle of a part, whose vertices are numbered anew.
        let is_anew = turned == [0, 1, 2] && self.recent.next > 0;
        if is_anew {
            self.recent.next = 0;
            self.recent.vertices = [u32::MAX; 16];
        }
        let [a, b, c] = turned;
        let known = [b, c].map(|v| self.recent.find_vertex(v).filter(|&ago| ago < 14));
        let first = if self.recent.is_next(a) { 0 } else { OTHER };
        let [second, third] = [(b, known[0]), (c, known[1])].map(|(v, known)| match known {
            Some(ago) => ago + 1,
            None if self.recent.is_next(v) => 0,
            None => OTHER,
        });
        let pair = (second << 4 | third) as u8;
        match PAIRS[..14].iter().position(|&known| known == pair) {
            Some(place) if first == 0 && !is_anew => codes.push(0xf0 | place as u8),
            _ => {
                codes.push(0xfe | u8::from(first != 0));
                data.push(pair);
            }
        }
        for (vertex, _) in [(a, first), (b, second), (c, third)].iter().filter(|(_, code)| *code == OTHER) {
            self.write_out(*vertex, data);
        }
        for (vertex, _) in [(a, first), (b, second), (c, third)].iter().filter(|(_, c)| matches!(c, 0 | 15)) {
            self.recent.add_vertex(*vertex);
        }
        self.recent.add_edges_of(turned);
    }

    /// Appends a vertex: its step from the last one that was, 7 bits a byte.
    fn write_out(&mut self, vertex: u32, data: &mut Vec<u8>) {
        let step = vertex.wrapping_sub(self.recent.last);
        let mut rest = (step << 1) ^ ((step as i32) >> 31) as u32;
        while rest > 127 {
            data.push(rest as u8 | 128);
            rest >>= 7;
        }
        data.push(rest as u8);
        self.recent.last = vertex;
    }
}
