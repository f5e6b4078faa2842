//! Wavefront path tracing of indirect light (Kajiya 1986).
//!
//! The first reflection is the direct image by points of the LEDs, one for each sample. From each
//! surface that a tile's rays hit, paths continue along the wall; at each of their hits, light from
//! a point of one LED is added (next event estimation). Paths do not hit LEDs, so no light is
//! counted twice. Light paths from the LEDs create virtual lights on the wall, to which the first
//! surfaces are connected (bidirectional path tracing: Veach 1997, chapter 10).
//!
//! Paths advance in wavefronts instead of one by one: all of a band of tiles together, so that
//! shading runs over lanes and shadow rays to an LED are traced as packets.

pub mod bsdf;
pub mod light_paths;
pub mod lumen_contents;
mod next_event;
mod resampling;
mod shadow_rays;
pub mod sobol;
pub mod subsurface;
mod subsurface_paths;
pub mod tracer;
pub mod virtual_lights;
pub mod wavefront;

use crate::render::material::Surface;
use crate::simd::f32x64::*;

/// Settings of path tracing.
#[derive(Clone, Copy)]
pub struct Settings {
    /// Samples per pixel: paths of each camera ray.
    pub spp: u32,
    /// Maximum number of reflections of a path; 1 is direct light.
    pub max_bounces: u32,
    /// Random seed of the paths.
    pub seed: u64,
}

/// Primary hits of a tile's rays, where paths start.
pub struct PrimaryHit {
    /// Surfaces hit.
    pub surface: Surface,
    /// Lanes with a hit.
    pub hit: [bool; LANES],
    /// Triangle hit, in leaf order; `MISS` for anything but the wall.
    pub triangle: [u32; LANES],
    /// Indices of the pixels in the image.
    pub pixel: [u32; LANES],
}
