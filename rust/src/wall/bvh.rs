//! Bounding-volume hierarchy: eight children per node, built once, refitted when the wall moves.

use crate::simd::f32x64::Vec3;
use glam::{Vec3A, Vec4};
use obvhs::{
    BvhBuildParams,
    bvh2::{Bvh2, builder::build_bvh2_from_tris},
    triangle::Triangle as BuildTriangle,
};
use rayon::prelude::*;
use std::ops::Range;
use std::time::Duration;

/// Number of children of a node.
pub const WIDTH: usize = 8;
/// Marks a child that is a leaf; the other bits are `first triangle · 4 + count`.
const LEAF: u32 = 1 << 31;
/// Maximum number of levels: a traversal keeps the other seven children of each on its stack.
pub const DEEPEST: usize = 32;
/// Size of that stack.
pub const STACK: usize = (WIDTH - 1) * DEEPEST + WIDTH;
/// Maximum number of primitives in a leaf.
pub const MAX_PER_LEAF: usize = 3;
/// Larger than any coordinate [m]: bounds of an empty child exclude everything.
const FAR: f32 = 1e30;
/// Factor that widens a box by the rounding of its distances.
pub const WIDER: f32 = 1.0 + 4.0 * f32::EPSILON;
/// Levels above the branches that are refitted in parallel: up to 64 branches.
const BRANCH_DEPTH: usize = 2;
const MAX_TRIANGLES_PER_LEAF: u32 = 2;

/// A node: the boxes of its eight children, by component, so that all are tested at once.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct Node {
    /// Lower bounds x, y, z, then upper bounds x, y, z [m].
    pub bounds: [[f32; WIDTH]; 6],
    /// Encoded children, see `Child`.
    pub children: [u32; WIDTH],
}

/// Reciprocal of a component of a ray's direction, finite.
#[inline(always)]
pub fn inverse(component: f32) -> f32 {
    1.0 / if component.abs() > 1e-20 { component } else { 1e-20f32.copysign(component) }
}

/// A child of a node.
pub enum Child {
    /// Another node, by index.
    Node(usize),
    /// A range of triangles in leaf order.
    Leaf(Range<usize>),
}

impl Child {
    /// The entry of `Node::children` for a leaf of up to `MAX_PER_LEAF` primitives.
    pub fn leaf(first: usize, count: usize) -> u32 {
        LEAF | ((first as u32) << 2) | count as u32
    }

    /// Decodes an entry of `Node::children`.
    #[inline(always)]
    pub fn of(code: u32) -> Self {
        if code & LEAF == 0 {
            return Child::Node(code as usize);
        }
        let first = ((code & !LEAF) >> 2) as usize;
        Child::Leaf(first..first + (code & 3) as usize)
    }
}

/// A triangle in the layout of the tracer, with its index in the mesh.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Triangle {
    /// Corners [m].
    pub corners: [Vec3; 3],
    /// Index of the face in the mesh.
    pub face: u32,
}

/// Eight-wide hierarchy over a triangle mesh.
#[derive(Clone)]
pub struct Bvh {
    /// Nodes, parents before children; node 0 is the root.
    pub nodes: Vec<Node>,
    /// Triangles in leaf order.
    pub triangles: Vec<Triangle>,
    /// Vertex indices of the triangles, in the same order.
    pub corners: Vec<[u32; 3]>,
    /// Large disjoint branches, refitted in parallel, in node order.
    branches: Vec<Branch>,
    /// Parent of each node; the root's is itself.
    above: Vec<u32>,
    /// The node whose leaf holds each face.
    holder: Vec<u32>,
}

/// A node and its descendants: consecutive nodes, and the consecutive triangles of their leaves.
#[derive(Clone)]
struct Branch {
    nodes: Range<usize>,
    triangles: Range<usize>,
}

impl Bvh {
    /// A hierarchy without primitives.
    pub fn empty() -> Self {
        Bvh {
            nodes: Vec::new(),
            triangles: Vec::new(),
            corners: Vec::new(),
            branches: Vec::new(),
            above: Vec::new(),
            holder: Vec::new(),
        }
    }

    /// Builds the hierarchy (PLOC with reinsertion, then collapsed to eight children per node).
    pub fn build(vertices: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let input: Vec<BuildTriangle> = faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|v| vertices[v as usize].into());
                BuildTriangle { v0: a, v1: b, v2: c }
            })
            .collect();
        let params = BvhBuildParams {
            max_prims_per_leaf: MAX_TRIANGLES_PER_LEAF,
            ..BvhBuildParams::medium_build()
        };
        let binary = build_bvh2_from_tris(&input, params, &mut Duration::default());
        let mut bvh = Collapse::run(&binary);
        bvh.corners = bvh.triangles.iter().map(|t| faces[t.face as usize]).collect();
        bvh.refit(vertices);
        bvh.find_holders();
        bvh
    }

    /// Records the parent of each node and the node of each face.
    fn find_holders(&mut self) {
        self.above = vec![0; self.nodes.len()];
        self.holder = vec![0; self.triangles.len()];
        for (n, node) in self.nodes.iter().enumerate() {
            for &code in &node.children {
                match Child::of(code) {
                    Child::Node(child) => self.above[child] = n as u32,
                    Child::Leaf(range) => {
                        let held = &self.triangles[range];
                        held.iter().for_each(|t| self.holder[t.face as usize] = n as u32);
                    }
                }
            }
        }
    }

    /// Refits like `refit` if only these faces have moved.
    pub fn refit_some(&mut self, vertices: &[Vec3], faces: impl Iterator<Item = u32>) {
        let mut due = vec![0u64; self.nodes.len().div_ceil(64)];
        faces.for_each(|face| mark(&mut due, self.holder[face as usize]));
        let mut whole = Part::whole(&mut self.nodes, &mut self.triangles, &self.corners, vertices);
        // Children come after their parents.
        for word in (0..due.len()).rev() {
            while due[word] != 0 {
                let bit = 63 - due[word].leading_zeros();
                due[word] &= !(1 << bit);
                let n = 64 * word + bit as usize;
                whole.refit_node(n);
                if n > 0 {
                    mark(&mut due, self.above[n]);
                }
            }
        }
    }

    /// Number of levels of the tree.
    pub fn depth(&self) -> usize {
        let mut levels = vec![1; self.nodes.len()];
        for (n, node) in self.nodes.iter().enumerate() {
            for &code in &node.children {
                if let Child::Node(child) = Child::of(code) {
                    levels[child] = levels[n] + 1;
                }
            }
        }
        levels.into_iter().max().unwrap_or(0)
    }

    /// Updates triangles and boxes to new vertex positions; the tree's topology stays.
    pub fn refit(&mut self, vertices: &[Vec3]) {
        let mut parts = Vec::with_capacity(self.branches.len());
        let mut rest = Part::whole(&mut self.nodes, &mut self.triangles, &self.corners, vertices);
        for branch in &self.branches {
            let (before, after) = rest.split(branch.nodes.start, branch.triangles.start);
            let (part, after) = after.split(branch.nodes.end, branch.triangles.end);
            parts.extend([(false, before), (true, part)]);
            rest = after;
        }
        parts.push((false, rest));
        parts.into_par_iter().filter(|(is_branch, _)| *is_branch).for_each(|(_, mut part)| {
            for n in (0..part.nodes.len()).rev() {
                part.refit_node(n);
            }
        });
        self.refit_trunk(vertices);
    }

    /// Refits the few nodes above the branches.
    fn refit_trunk(&mut self, vertices: &[Vec3]) {
        let mut whole = Part::whole(&mut self.nodes, &mut self.triangles, &self.corners, vertices);
        let mut end = whole.nodes.len();
        for branch in self.branches.iter().rev() {
            (branch.nodes.end..end).rev().for_each(|n| whole.refit_node(n));
            end = branch.nodes.start;
        }
        (0..end).rev().for_each(|n| whole.refit_node(n));
    }
}

/// Consecutive nodes and the triangles of their leaves.
struct Part<'a> {
    nodes: &'a mut [Node],
    first_node: usize,
    triangles: &'a mut [Triangle],
    first_triangle: usize,
    corners: &'a [[u32; 3]],
    /// Coordinates of all vertices, flattened [m].
    vertices: &'a [f32],
}

impl<'a> Part<'a> {
    fn whole(
        nodes: &'a mut [Node],
        triangles: &'a mut [Triangle],
        corners: &'a [[u32; 3]],
        vertices: &'a [Vec3],
    ) -> Self {
        let vertices = vertices.as_flattened();
        Part { nodes, first_node: 0, triangles, first_triangle: 0, corners, vertices }
    }

    /// Splits before a node and a triangle, given by their indices in the whole tree.
    fn split(self, node: usize, triangle: usize) -> (Part<'a>, Part<'a>) {
        let (nodes, more_nodes) = self.nodes.split_at_mut(node - self.first_node);
        let (triangles, more) = self.triangles.split_at_mut(triangle - self.first_triangle);
        let head = Part { nodes, triangles, ..self };
        let tail = Part {
            nodes: more_nodes,
            first_node: node,
            triangles: more,
            first_triangle: triangle,
            ..head
        };
        (head, tail)
    }

    /// Updates the boxes of a node's children and the triangles of its leaves; children first.
    #[inline(always)]
    fn refit_node(&mut self, n: usize) {
        for k in 0..WIDTH {
            let bounds = match Child::of(self.nodes[n].children[k]) {
                Child::Node(child) => self.nodes[child - self.first_node].union(),
                Child::Leaf(range) if range.is_empty() => continue,
                Child::Leaf(range) => self.refit_leaf(range),
            };
            self.nodes[n].set(k, bounds);
        }
    }

    /// Updates the triangles of a leaf; returns their bounds.
    #[inline(always)]
    fn refit_leaf(&mut self, range: Range<usize>) -> [f32; 6] {
        let (mut low, mut high) = (Vec4::splat(FAR), Vec4::splat(-FAR));
        for number in range {
            let [a, b, c] = self.corners[number].map(|v| vertex(self.vertices, v));
            low = low.min(a.min(b).min(c));
            high = high.max(a.max(b).max(c));
            let corners = [a, b, c].map(|corner| corner.truncate().to_array());
            self.triangles[number - self.first_triangle].corners = corners;
        }
        [low.x, low.y, low.z, high.x, high.y, high.z]
    }
}

/// Sets a bit of a bit set.
fn mark(bits: &mut [u64], number: u32) {
    bits[number as usize / 64] |= 1 << (number % 64);
}

/// A vertex of flattened coordinates, and the value after it: one load.
#[inline(always)]
pub fn vertex(coordinates: &[f32], v: u32) -> Vec4 {
    let first = 3 * v as usize;
    match coordinates.get(first..first + 4) {
        Some(four) => Vec4::from_slice(four),
        None => Vec3A::from_slice(&coordinates[first..]).extend(0.0),
    }
}

impl Node {
    /// A node without children.
    pub fn empty() -> Self {
        let (low, high) = ([FAR; WIDTH], [-FAR; WIDTH]);
        Node { bounds: [low, low, low, high, high, high], children: [LEAF; WIDTH] }
    }

    /// Sets the bounds of child `k`: lower x, y, z, then upper x, y, z [m].
    #[inline(always)]
    pub fn set(&mut self, k: usize, bounds: [f32; 6]) {
        for (row, value) in self.bounds.iter_mut().zip(bounds) {
            row[k] = value;
        }
    }

    /// Bounds of all children.
    #[inline(always)]
    pub fn union(&self) -> [f32; 6] {
        let halves = |row: &[f32; WIDTH]| (Vec4::from_slice(row), Vec4::from_slice(&row[4..]));
        let lowest = |row| {
            let (a, b) = halves(row);
            a.min(b).min_element()
        };
        let highest = |row| {
            let (a, b) = halves(row);
            a.max(b).max_element()
        };
        let [x0, y0, z0, x1, y1, z1] = &self.bounds;
        [lowest(x0), lowest(y0), lowest(z0), highest(x1), highest(y1), highest(z1)]
    }
}

/// Conversion of a binary hierarchy into an eight-wide one.
struct Collapse<'a> {
    binary: &'a Bvh2,
    out: Bvh,
}

impl<'a> Collapse<'a> {
    fn run(binary: &'a Bvh2) -> Bvh {
        let mut this = Collapse { binary, out: Bvh::empty() };
        this.node(0, 0);
        this.out
    }

    /// Adds the node that represents binary node `root`; returns its index.
    ///
    /// A node's own leaves come before those of its descendants, so that consecutive nodes have
    /// consecutive triangles.
    fn node(&mut self, root: u32, depth: usize) -> u32 {
        let (number, first_triangle) = (self.out.nodes.len(), self.out.triangles.len());
        self.out.nodes.push(Node::empty());
        let chosen = self.choose(root);
        for (k, &child) in chosen.iter().enumerate() {
            let node = self.binary.nodes[child as usize];
            if node.is_leaf() {
                let code = self.leaf(node.first_index, node.prim_count);
                self.out.nodes[number].children[k] = code;
            }
        }
        for (k, &child) in chosen.iter().enumerate() {
            if !self.binary.nodes[child as usize].is_leaf() {
                let code = self.node(child, depth + 1);
                self.out.nodes[number].children[k] = code;
            }
        }
        if depth == BRANCH_DEPTH {
            self.out.branches.push(Branch {
                nodes: number..self.out.nodes.len(),
                triangles: first_triangle..self.out.triangles.len(),
            });
        }
        number as u32
    }

    /// Up to eight descendants that cover `root`: the largest is opened first.
    fn choose(&self, root: u32) -> Vec<u32> {
        let nodes = &self.binary.nodes;
        let mut open = vec![root];
        while open.len() < WIDTH {
            let largest =
                (0..open.len()).filter(|&k| !nodes[open[k] as usize].is_leaf()).max_by(|&a, &b| {
                    let area = |k: usize| nodes[open[k] as usize].aabb().half_area();
                    area(a).total_cmp(&area(b))
                });
            let Some(k) = largest else { break };
            let first = nodes[open[k] as usize].first_index;
            open[k] = first;
            open.insert(k + 1, first + 1);
        }
        open
    }

    fn leaf(&mut self, first: u32, count: u32) -> u32 {
        let start = self.out.triangles.len() as u32;
        for k in first..first + count {
            let face = self.binary.primitive_indices[k as usize];
            self.out.triangles.push(Triangle { corners: [[0.0; 3]; 3], face });
        }
        Child::leaf(start as usize, count as usize)
    }
}
