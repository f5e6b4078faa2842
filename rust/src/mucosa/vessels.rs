//! Vessel trees grown on the wall: paths, radii and depth of blood vessels.

use super::noise::{Lattice, Vec3, cube_root, exp, floor, mix, smoothstep, uniform};
use crate::simd::f32x64::{cross, dot, sub};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Parameters of the growth of vessel trees. Lengths in millimeters.
#[derive(Clone, Copy)]
pub struct Growth {
    /// Seed of all random numbers.
    pub seed: u32,
    /// Distance between the tips of the finest branches.
    pub spacing: f32,
    /// Distance between trunks.
    pub trunk_spacing: f32,
    /// Radius of the finest branches.
    pub tip_radius: f32,
}

/// Tapered segment of a vessel. Lengths in millimeters.
#[derive(Clone, Copy)]
pub struct Segment {
    /// Upstream and downstream ends.
    pub ends: [Vec3; 2],
    /// Radius at each end.
    pub radii: [f32; 2],
    /// Normal of the wall.
    pub normal: Vec3,
    /// Fraction of the light that meets the vessel rather than the mucosa above it.
    pub visibility: f32,
    /// True if it carries venous blood.
    pub is_vein: bool,
}

#[derive(Clone, Copy)]
struct Site {
    point: Vec3,
    normal: Vec3,
}

const NONE: u32 = u32::MAX;

/// Weight of a long path to the trunk relative to a short new branch: the balancing factor of
/// Cuntz, Forstner, Borst and Häusser, PLoS Comput Biol 6(8):e1000877, 2010.
const BALANCE: f32 = 0.10;

/// Buckets of point indices by hashed cell; different cells may share a bucket.
struct Buckets {
    head: Vec<u32>,
    next: Vec<u32>,
    per_length: f32,
}

impl Buckets {
    fn new(cell: f32, expected: usize) -> Self {
        let size = (2 * expected).next_power_of_two().max(1024);
        Self { head: vec![NONE; size], next: Vec::with_capacity(expected), per_length: 1.0 / cell }
    }

    fn cell(&self, p: Vec3) -> [i32; 3] {
        p.map(|x| floor(x * self.per_length))
    }

    fn slot(&self, c: [i32; 3]) -> usize {
        let h = mix((c[0] as u32).wrapping_mul(0x8da6_b343)
            ^ (c[1] as u32).wrapping_mul(0xd816_3841)
            ^ (c[2] as u32).wrapping_mul(0xcb1a_b31f));
        h as usize & (self.head.len() - 1)
    }

    fn push(&mut self, p: Vec3) {
        let slot = self.slot(self.cell(p));
        self.next.push(self.head[slot]);
        self.head[slot] = self.next.len() as u32 - 1;
    }

    /// Calls `visit` for every point in the cells around `p` (and possibly others), until it
    /// returns false; returns true if it never did.
    fn around(&self, p: Vec3, mut visit: impl FnMut(u32) -> bool) -> bool {
        let c = self.cell(p);
        for index in 0..27 {
            let near = [c[0] + index % 3 - 1, c[1] + index / 3 % 3 - 1, c[2] + index / 9 - 1];
            let mut point = self.head[self.slot(near)];
            while point != NONE {
                if !visit(point) {
                    return false;
                }
                point = self.next[point as usize];
            }
        }
        true
    }
}

/// Random sites on the wall no closer than `spacing`: dart throwing, face by face.
fn scatter(
    vertices: &[Vec3],
    normals: &[Vec3],
    faces: &[[u32; 3]],
    spacing: f32,
    seed: u32,
) -> Vec<Site> {
    const DARTS_PER_SITE: f32 = 3.0;
    let area = |f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| vertices[v as usize]);
        let n = cross(sub(b, a), sub(c, a));
        0.5 * dot(n, n).sqrt()
    };
    let density = DARTS_PER_SITE / (spacing * spacing);
    let expected = faces.iter().map(|f| f64::from(area(f))).sum::<f64>() * f64::from(density) / 3.0;
    let mut buckets = Buckets::new(spacing, expected as usize);
    let mut sites: Vec<Site> = Vec::with_capacity(expected as usize);
    for (number, f) in faces.iter().enumerate() {
        let number = number as u32;
        let darts = (area(f) * density + uniform(seed, number, 0)) as u32;
        for dart in 0..darts {
            let mut s = uniform(seed, number, 2 * dart + 1);
            let mut t = uniform(seed, number, 2 * dart + 2);
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let blend = |values: &[Vec3]| {
                let [a, b, c] = f.map(|v| values[v as usize]);
                [0, 1, 2].map(|k| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k]))
            };
            let site = Site { point: blend(vertices), normal: blend(normals) };
            let is_free = buckets.around(site.point, |other| {
                let other = &sites[other as usize];
                let d = sub(other.point, site.point);
                dot(d, d) >= spacing * spacing || dot(other.normal, site.normal) <= 0.0
            });
            if is_free {
                buckets.push(site.point);
                sites.push(site);
            }
        }
    }
    sites
}

/// Forest over the sites: parent and root of each, and the order in which they were connected.
struct Forest {
    parent: Vec<u32>,
    root: Vec<u32>,
    path_length: Vec<f32>,
    order: Vec<u32>,
}

/// Connects every site to a trunk by the cheapest branch first (Prim's algorithm with a balance).
fn join(sites: &[Site], roots: &[u32], reach: f32, seed: u32) -> Forest {
    let mut buckets = Buckets::new(reach, sites.len());
    sites.iter().for_each(|site| buckets.push(site.point));
    // A smooth random resistance of the tissue makes trunks tortuous.
    let resistance = Lattice::new(seed ^ 0x6561_7365, 7.0);
    let ease: Vec<f32> =
        sites.iter().map(|site| exp(0.7 * resistance.gradient(site.point))).collect();
    let mut forest = Forest {
        parent: vec![NONE; sites.len()],
        root: vec![NONE; sites.len()],
        path_length: vec![0.0; sites.len()],
        order: Vec::with_capacity(sites.len()),
    };
    // Bits of nonnegative floats have the order of the floats.
    let mut heap: BinaryHeap<Reverse<(u32, u32, u32)>> =
        roots.iter().map(|&r| Reverse((0, r, NONE))).collect();
    while let Some(Reverse((_, site, parent))) = heap.pop() {
        let at = site as usize;
        if forest.root[at] != NONE {
            continue;
        }
        forest.parent[at] = parent;
        forest.root[at] = if parent == NONE { site } else { forest.root[parent as usize] };
        forest.order.push(site);
        let here = sites[at];
        if parent != NONE {
            let d = sub(here.point, sites[parent as usize].point);
            forest.path_length[at] = forest.path_length[parent as usize] + dot(d, d).sqrt();
        }
        buckets.around(here.point, |other| {
            let near = sites[other as usize];
            let d = sub(near.point, here.point);
            let length = dot(d, d).sqrt();
            if forest.root[other as usize] == NONE
                && length < reach
                && dot(near.normal, here.normal) > 0.3
            {
                let jitter = 0.5 + uniform(seed, site.min(other), site.max(other));
                let cost = length * jitter * ease[other as usize]
                    + BALANCE * (forest.path_length[at] + length);
                heap.push(Reverse((cost.to_bits(), other, site)));
            }
            true
        });
    }
    forest
}

/// Number of tips that each site's branch feeds, and the downstream neighbor that feeds most.
fn flows(forest: &Forest) -> (Vec<f32>, Vec<u32>) {
    let mut flow = vec![0.0f32; forest.parent.len()];
    let mut main = vec![NONE; forest.parent.len()];
    for &site in forest.order.iter().rev() {
        let at = site as usize;
        flow[at] = flow[at].max(1.0);
        let parent = forest.parent[at] as usize;
        if forest.parent[at] != NONE {
            if main[parent] == NONE || flow[at] > flow[main[parent] as usize] {
                main[parent] = site;
            }
            flow[parent] += flow[at];
        }
    }
    (flow, main)
}

/// Moves each site towards the midpoint of its upstream and main downstream neighbors.
fn straighten(sites: &mut [Site], forest: &Forest, main: &[u32]) {
    for _ in 0..4 {
        let before: Vec<Vec3> = sites.iter().map(|site| site.point).collect();
        for (at, site) in sites.iter_mut().enumerate() {
            let (up, down) = (forest.parent[at], main[at]);
            if up != NONE && down != NONE {
                let (a, b) = (before[up as usize], before[down as usize]);
                site.point = [0, 1, 2].map(|k| 0.5 * site.point[k] + 0.25 * (a[k] + b[k]));
            }
        }
    }
}

/// Grows vessel trees over a wall (vertices in millimeters).
///
/// Trunks enter from below at sites `trunk_spacing` apart; the nearest trunk feeds each site of the
/// wall by a tree. Radii follow Murray's law, r³ = Σ r³ of the branches (PNAS 12:207, 1926).
pub fn grow(
    vertices: &[Vec3],
    normals: &[Vec3],
    faces: &[[u32; 3]],
    growth: Growth,
) -> Vec<Segment> {
    let Growth { seed, spacing, trunk_spacing, tip_radius } = growth;
    let mut sites = scatter(vertices, normals, faces, 0.8 * spacing, seed);
    let trunks = scatter(vertices, normals, faces, trunk_spacing, seed ^ 0x7275_6e6b);
    let roots = nearest(&sites, &trunks, 2.0 * spacing);
    let forest = join(&sites, &roots, 2.0 * spacing, seed);
    let (flow, main) = flows(&forest);
    straighten(&mut sites, &forest, &main);
    // A trunk becomes thinner towards the depth that it comes from.
    let risen = |site: u32| smoothstep(0.0, 5.0, forest.path_length[site as usize]);
    let radius =
        |site: u32| tip_radius * cube_root(flow[site as usize]) * (0.5 + 0.5 * risen(site));
    let mut segments = Vec::with_capacity(sites.len());
    for &site in &forest.order {
        let parent = forest.parent[site as usize];
        if parent == NONE {
            continue;
        }
        let tree = forest.root[site as usize];
        let is_main = main[parent as usize] == site;
        segments.push(Segment {
            ends: [sites[parent as usize].point, sites[site as usize].point],
            radii: [radius(if is_main { parent } else { site }), radius(site)],
            normal: sites[site as usize].normal,
            visibility: (0.3 + 0.7 * risen(site)) * (0.6 + 0.4 * uniform(seed, tree, 1)),
            is_vein: uniform(seed, tree, 2) < 0.5,
        });
    }
    bridge(&sites, &forest, &flow, growth, &mut segments);
    segments
}

/// Connects some tips to the nearest vessel outside their own branch: the mucosal network.
fn bridge(
    sites: &[Site],
    forest: &Forest,
    flow: &[f32],
    growth: Growth,
    segments: &mut Vec<Segment>,
) {
    const TIP_FRACTION: f32 = 0.4;
    let reach = 1.6 * growth.spacing;
    let mut buckets = Buckets::new(reach, sites.len());
    sites.iter().for_each(|site| buckets.push(site.point));
    for &tip in &forest.order {
        let here = sites[tip as usize];
        let parent = forest.parent[tip as usize];
        if flow[tip as usize] > 1.0 || parent == NONE || uniform(growth.seed, tip, 3) > TIP_FRACTION
        {
            continue;
        }
        let mut best = (reach, NONE);
        buckets.around(here.point, |other| {
            let near = sites[other as usize];
            let d = sub(near.point, here.point);
            let key = (dot(d, d).sqrt(), other);
            let is_own = other == tip || other == parent || forest.parent[other as usize] == parent;
            if key < best && !is_own && dot(near.normal, here.normal) > 0.3 {
                best = key;
            }
            true
        });
        if best.1 != NONE {
            let tree = forest.root[tip as usize];
            segments.push(Segment {
                ends: [here.point, sites[best.1 as usize].point],
                radii: [growth.tip_radius; 2],
                normal: here.normal,
                visibility: 0.8,
                is_vein: uniform(growth.seed, tree, 2) < 0.5,
            });
        }
    }
}

/// Index of the site nearest to each trunk, if one is within `reach`.
fn nearest(sites: &[Site], trunks: &[Site], reach: f32) -> Vec<u32> {
    let mut buckets = Buckets::new(reach, sites.len());
    sites.iter().for_each(|site| buckets.push(site.point));
    let mut roots: Vec<u32> = trunks
        .iter()
        .filter_map(|trunk| {
            let mut best = (reach, NONE);
            buckets.around(trunk.point, |other| {
                let d = sub(sites[other as usize].point, trunk.point);
                let key = (dot(d, d).sqrt(), other);
                if key < best {
                    best = key;
                }
                true
            });
            (best.1 != NONE).then_some(best.1)
        })
        .collect();
    roots.sort_unstable();
    roots.dedup();
    roots
}
