//! Refit of a wall after a part of it has moved, with the same result as a full refit.
//!
//! A capsule in a long organ moves a few centimeters of several meters of wall.

use super::{Wall, area_normal, distinct, normal_sum};
use crate::simd::f32x64::normalize;
use rayon::prelude::*;

/// Inverse of the fraction of moved vertices above which the whole wall is refitted.
const FEW: usize = 4;
/// Number of vertices that one thread compares at a time.
const PART: usize = 8192;

impl Wall {
    /// Updates the derived data of the vertices that have moved, or of all if that is faster.
    pub(super) fn refit_changed(&mut self) {
        match self.moved() {
            Some(moved) if self.has_normals => self.refit_around(&moved),
            _ => self.refit_all(),
        }
    }

    /// Vertices that differ from those before `set_vertices`, in order; None if there are many.
    fn moved(&self) -> Option<Vec<u32>> {
        let (now, before) = (self.vertices.par_chunks(PART), self.spare.par_chunks(PART));
        let parts: Vec<Vec<u32>> = now
            .zip(before)
            .enumerate()
            .map(|(part, (now, before))| {
                let differs = |&v: &usize| now[v].map(f32::to_bits) != before[v].map(f32::to_bits);
                let moved = (0..now.len()).filter(differs);
                moved.map(|v| (part * PART + v) as u32).collect()
            })
            .collect();
        let moved = parts.concat();
        (FEW * moved.len() < self.vertices.len()).then_some(moved)
    }

    /// Refits hierarchy and vertex normals around the moved vertices.
    fn refit_around(&mut self, moved: &[u32]) {
        let around = |&v: &u32| self.faces_around(v as usize).iter().copied();
        let faces = distinct(self.faces.len(), moved.iter().flat_map(around));
        let corners = faces.iter().flat_map(|&f| self.faces[f as usize]);
        let turned = distinct(self.vertices.len(), corners);
        let Wall { vertices, faces: all, area_normals, normals, bvh, start, around, .. } = self;
        for &f in &faces {
            area_normals[f as usize] = area_normal(vertices, &all[f as usize]);
        }
        let renew = || {
            for &v in &turned {
                let v = v as usize;
                let around = &around[start[v] as usize..start[v + 1] as usize];
                normals[v] = normalize(normal_sum(around, area_normals));
            }
        };
        rayon::join(|| bvh.refit_some(vertices, faces.iter().copied()), renew);
    }
}
