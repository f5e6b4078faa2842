//! Spheres of many sizes and their hierarchy, through which bubbles and particles are traced.

use crate::lumen::clump::phases;
use crate::simd::f32x64::*;
use crate::wall::Wall;
use crate::wall::bvh::{Child, MAX_PER_LEAF, Node, WIDTH};
use crate::wall::packet::{LeafVisitor, Pyramid, leaves};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::{exceptions::PyValueError, prelude::*};
use std::ops::Range;

/// Kinds of spheres, as encoded in Python.
pub const BUBBLE: u8 = 0;

/// Fixed properties and positions of spheres.
#[derive(FromPyObject)]
pub struct SphereArrays<'py> {
    /// Centers [n 3] in the wall's outside world [m].
    centers: PyReadonlyArray2<'py, f64>,
    radius: PyReadonlyArray1<'py, f64>,
    /// `BUBBLE` or a particle.
    pub kind: PyReadonlyArray1<'py, u8>,
    instance: PyReadonlyArray1<'py, u16>,
    color: PyReadonlyArray2<'py, f64>,
    arc_length: PyReadonlyArray1<'py, f64>,
}

/// One sphere.
#[derive(Clone, Copy)]
pub struct Sphere {
    /// Center, relative to the wall's center [m].
    pub center: Vec3,
    /// Radius [m].
    pub radius: f32,
    /// Linear color: the base color of a particle, or that of a bubble's surroundings.
    pub color: Vec3,
    /// Gut coordinate [m].
    pub arc_length: f32,
    /// Index in the original arrays.
    pub number: u32,
    /// Instance to which it belongs.
    pub instance: u16,
    /// Distance beyond which the sphere has no effect [m]: in a clump larger than its radius.
    pub reach: f32,
    /// Phases of the bumps of a particle or of the ripple of a bubble.
    pub phases: Vec3,
}

impl SphereArrays<'_> {
    /// Spheres, relative to the wall's center.
    ///
    /// # Errors
    /// If arrays differ in length, a center is not finite or a radius not above 0.
    pub fn read(&self, wall: &Wall) -> PyResult<Vec<Sphere>> {
        let (centers, color) = (self.centers.as_array(), self.color.as_array());
        let count = centers.nrows();
        let lengths =
            [self.radius.len()?, self.kind.len()?, self.instance.len()?, self.arc_length.len()?];
        if centers.ncols() != 3 || color.dim() != (count, 3) || lengths != [count; 4] {
            return Err(PyValueError::new_err("Spheres need a row of each property per sphere."));
        }
        let (radius, instance) = (self.radius.as_array(), self.instance.as_array());
        let arc_length = self.arc_length.as_array();
        let all: Vec<Sphere> = (0..count)
            .map(|k| Sphere {
                center: wall.localize([0, 1, 2].map(|axis| centers[[k, axis]])),
                radius: radius[k] as f32,
                color: [0, 1, 2].map(|axis| color[[k, axis]] as f32),
                arc_length: arc_length[k] as f32,
                number: k as u32,
                instance: instance[k],
                reach: radius[k] as f32,
                phases: phases(k as u32),
            })
            .collect();
        let valid = |s: &Sphere| s.center.iter().all(|x| x.is_finite()) && s.radius > 0.0;
        if !all.iter().all(valid) {
            return Err(PyValueError::new_err("Spheres need finite centers and radii above 0."));
        }
        Ok(all)
    }
}

/// Spheres in an eight-wide hierarchy.
#[derive(Default)]
pub struct Spheres {
    nodes: Vec<Node>,
    /// In leaf order.
    pub all: Vec<Sphere>,
}

/// A sphere that some rays of a tile may hit.
#[derive(Clone, Copy)]
pub struct Near {
    /// Squared length of the tangent from the origin to the sphere [m²]: spheres that do not
    /// overlap are sorted by it along every ray.
    pub power: f32,
    /// Index in `Spheres::all`.
    pub index: u32,
}

/// Search for the spheres near the rays of a tile.
struct Gathering<'a> {
    all: &'a [Sphere],
    origin: Vec3,
    rays: &'a Pyramid,
    found: &'a mut Vec<Near>,
}

impl LeafVisitor for Gathering<'_> {
    #[inline(always)]
    fn visit(&mut self, leaf: Range<usize>, farthest: f32) -> Option<f32> {
        for index in leaf {
            let sphere = &self.all[index];
            let offset = sub(sphere.center, self.origin);
            let reach = -1.0001 * sphere.reach;
            if self.rays.closed && self.rays.sides.iter().any(|side| dot(*side, offset) < reach) {
                continue;
            }
            let square = dot(offset, offset);
            if square.sqrt() - 1.0001 * sphere.reach > farthest {
                continue;
            }
            let power = square - sphere.reach * sphere.reach;
            self.found.push(Near { power, index: index as u32 });
        }
        Some(farthest)
    }
}

impl Spheres {
    /// Builds the hierarchy by median splits along the longest axis.
    pub fn build(mut all: Vec<Sphere>) -> Self {
        let mut nodes = Vec::new();
        if !all.is_empty() {
            let count = all.len();
            build_node(&mut nodes, &mut all, 0, count);
        }
        Spheres { nodes, all }
    }

    /// Moves the spheres to new centers, by index; the tree's topology stays.
    pub fn move_to(&mut self, center: impl Fn(usize) -> Vec3) {
        for sphere in &mut self.all {
            sphere.center = center(sphere.number as usize);
        }
        for n in (0..self.nodes.len()).rev() {
            for k in 0..WIDTH {
                let bounds = match Child::of(self.nodes[n].children[k]) {
                    Child::Node(child) => self.nodes[child].union(),
                    Child::Leaf(range) if range.is_empty() => continue,
                    Child::Leaf(range) => bounds(&self.all[range]),
                };
                self.nodes[n].set(k, bounds);
            }
        }
    }

    /// Spheres that rays may hit nearer than `farthest`, unordered.
    #[inline(always)]
    pub fn gather(
        &self,
        origin: Vec3,
        rays: &Pyramid,
        extent: f32,
        farthest: f32,
        found: &mut Vec<Near>,
    ) {
        found.clear();
        let mut gathering = Gathering { all: &self.all, origin, rays, found };
        leaves(&self.nodes, origin, rays, extent, farthest, &mut gathering);
    }

    /// Visits spheres within whose reach a ray with a unit `heading` comes nearer than `reach`:
    /// index, both crossings, and squared distance of the ray from the center over the squared
    /// reach.
    #[inline(always)]
    pub fn along(
        &self,
        start: Vec3,
        heading: Vec3,
        reach: f32,
        mut visit: impl FnMut(usize, [f32; 2], f32),
    ) {
        let inverse = heading.map(|h| 1.0 / if h.abs() > 1e-20 { h } else { 1e-20 });
        let mut waiting = [0u32; 7 * 32 + 8];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let node = match Child::of(waiting[top]) {
                Child::Node(number) => &self.nodes[number],
                Child::Leaf(range) => {
                    for index in range {
                        let Sphere { center, reach: radius, .. } = self.all[index];
                        let offset = sub(center, start);
                        let middle = dot(offset, heading);
                        let foot = sub(offset, scale(heading, middle));
                        let (apart, square) = (dot(foot, foot), radius * radius);
                        let half = max(square - apart, 0.0).sqrt();
                        if apart < square && middle + half > 0.0 && middle - half < reach {
                            visit(index, [middle - half, middle + half], apart / square);
                        }
                    }
                    continue;
                }
            };
            for k in 0..WIDTH {
                let (mut enter, mut leave) = (0.0, reach);
                for axis in 0..3 {
                    let low = (node.bounds[axis][k] - start[axis]) * inverse[axis];
                    let high = (node.bounds[axis + 3][k] - start[axis]) * inverse[axis];
                    enter = max(enter, min(low, high));
                    leave = min(leave, max(low, high));
                }
                if enter <= leave {
                    waiting[top] = node.children[k];
                    top += 1;
                }
            }
        }
    }

    /// Spheres whose bounds overlap the box from `low` to `high`; `power` is about `origin`.
    pub fn within(&self, (low, high): Corners, origin: Vec3, found: &mut Vec<Near>) {
        found.clear();
        let mut waiting = if self.nodes.is_empty() { Vec::new() } else { vec![0] };
        while let Some(number) = waiting.pop() {
            let node: &Node = &self.nodes[number];
            for k in 0..WIDTH {
                let apart =
                    (0..3).any(|x| node.bounds[x][k] > high[x] || node.bounds[x + 3][k] < low[x]);
                match Child::of(node.children[k]) {
                    _ if apart => {}
                    Child::Node(child) => waiting.push(child),
                    Child::Leaf(range) => found.extend(range.map(|index| {
                        let sphere = &self.all[index];
                        let offset = sub(sphere.center, origin);
                        let power = dot(offset, offset) - sphere.reach * sphere.reach;
                        Near { power, index: index as u32 }
                    })),
                }
            }
        }
    }
}

impl Sphere {
    /// True if it shares its surface with no other sphere.
    #[inline(always)]
    pub fn is_alone(&self) -> bool {
        self.reach == self.radius
    }
}

/// Adds the node over `all[start..end]`; returns its code and bounds.
fn build_node(nodes: &mut Vec<Node>, all: &mut [Sphere], start: usize, end: usize) -> u32 {
    let number = nodes.len();
    nodes.push(Node::empty());
    let mut parts = vec![(start, end)];
    while parts.len() < WIDTH {
        let largest = (0..parts.len()).max_by_key(|&k| (parts[k].1 - parts[k].0, WIDTH - k));
        let Some(k) = largest.filter(|&k| parts[k].1 - parts[k].0 > 1) else { break };
        let (low, high) = parts[k];
        let middle = low.midpoint(high);
        let axis = longest_axis(&all[low..high]);
        let by_place = |a: &Sphere, b: &Sphere| {
            a.center[axis].total_cmp(&b.center[axis]).then(a.number.cmp(&b.number))
        };
        all[low..high].select_nth_unstable_by(middle - low, by_place);
        parts[k] = (low, middle);
        parts.insert(k + 1, (middle, high));
    }
    for (k, (low, high)) in parts.into_iter().enumerate() {
        if high - low <= MAX_PER_LEAF {
            nodes[number].children[k] = Child::leaf(low, high - low);
            let bounds = bounds(&all[low..high]);
            nodes[number].set(k, bounds);
        } else {
            let child = build_node(nodes, all, low, high);
            nodes[number].children[k] = child;
            let bounds = nodes[child as usize].union();
            nodes[number].set(k, bounds);
        }
    }
    number as u32
}

fn longest_axis(spheres: &[Sphere]) -> usize {
    let [x0, y0, z0, x1, y1, z1] = bounds(spheres);
    let size = [x1 - x0, y1 - y0, z1 - z0];
    (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0)
}

fn bounds(spheres: &[Sphere]) -> [f32; 6] {
    let mut out = [f32::MAX, f32::MAX, f32::MAX, f32::MIN, f32::MIN, f32::MIN];
    for sphere in spheres {
        for axis in 0..3 {
            out[axis] = min(out[axis], sphere.center[axis] - sphere.reach);
            out[axis + 3] = max(out[axis + 3], sphere.center[axis] + sphere.reach);
        }
    }
    out
}
