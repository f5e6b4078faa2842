//! Test of triangles against the sides of a pyramid or shaft, outside which no ray can hit them.
//!
//! Many triangles in the boxes of leaves that cross a pyramid lie outside it. This test costs far
//! less than that against 64 rays.

use crate::simd::f32x64::max;
use crate::wall::bvh::Triangle;
use crate::wall::packet::Plane;

/// Number of sides.
const SIDES: usize = 4;

/// Four planes, by component.
pub struct Sides {
    normal: [[f32; SIDES]; 3],
    offset: [f32; SIDES],
}

impl Sides {
    /// The same planes.
    #[inline(always)]
    pub fn of(planes: &[Plane; SIDES]) -> Self {
        let component = |k: usize| std::array::from_fn(|side| planes[side].normal[k]);
        Sides {
            normal: [component(0), component(1), component(2)],
            offset: std::array::from_fn(|side| planes[side].offset),
        }
    }

    /// True if all corners of a triangle are outside the same plane.
    #[inline(always)]
    pub fn exclude(&self, triangle: &Triangle) -> bool {
        let [x, y, z] = &self.normal;
        let mut highest = [f32::MIN; SIDES];
        for corner in &triangle.corners {
            for k in 0..SIDES {
                let height =
                    x[k] * corner[0] + y[k] * corner[1] + z[k] * corner[2] - self.offset[k];
                highest[k] = max(highest[k], height);
            }
        }
        let mut outside = false;
        for height in highest {
            outside |= height < 0.0;
        }
        outside
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::f32x64::{LANES, normalize};
    use crate::wall::packet::Pyramid;

    #[test]
    fn a_triangle_is_excluded_outside_the_rays() {
        let mut directions = [[0.0; LANES]; 3];
        for i in 0..LANES {
            let (x, y) = (0.02 * (i % 8) as f32 - 0.07, 0.02 * (i / 8) as f32 - 0.07);
            let way = normalize([x, y, 1.0]);
            (directions[0][i], directions[1][i], directions[2][i]) = (way[0], way[1], way[2]);
        }
        let origin = [1.0, 2.0, 3.0];
        let sides = Pyramid::around(directions, &[true; LANES]).sides;
        let sides = Sides::of(&sides.map(|normal| Plane::new(normal, origin, 1e-6, true)));
        let excluded = |x: f32, y: f32, size: f32| {
            let corners = [[x, y, 1.0], [x + size, y, 1.0], [x, y + size, 1.2]];
            let corners = corners.map(|[x, y, z]| [x + origin[0], y + origin[1], z + origin[2]]);
            sides.exclude(&Triangle { corners, face: 0 })
        };
        assert!(!excluded(0.0, 0.0, 0.01) && !excluded(-5.0, -5.0, 20.0));
        assert!(!excluded(0.069, 0.0, 0.01));
        assert!(excluded(0.1, 0.0, 0.01) && excluded(-0.2, 0.0, 0.05) && excluded(0.0, 0.3, 1.0));
        // A triangle at a corner of the pyramid can miss it and not be excluded.
        assert!(!excluded(0.06, 0.06, 0.05));
    }
}
