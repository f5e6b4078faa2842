//! Nearest transparent object on each ray.

use super::liquid::Wet;
use crate::render::channels::{Channels, Place};
use crate::render::ray_table::TileRays;
use crate::simd::f32x64::*;

/// `Channels::foreground_label` of a bubble; 0 is none.
pub const FOREGROUND_BUBBLE: u8 = 1;
/// `Channels::foreground_label` of liquid.
pub const FOREGROUND_LIQUID: u8 = 2;

/// Nearest transparent object in front of each surface.
pub struct Foreground {
    label: [u8; LANES],
    instance: [u16; LANES],
    distance: Lane,
}

impl Foreground {
    /// Liquid, at the point where rays enter it or start in it.
    #[inline(always)]
    pub fn of_liquid(wet: Option<&Wet>) -> Self {
        let mut front = Foreground {
            label: [0; LANES],
            instance: [0; LANES],
            distance: [f32::INFINITY; LANES],
        };
        let Some(wet) = wet else { return front };
        for i in (0..LANES).filter(|&i| wet.is_wet[i]) {
            front.label[i] = FOREGROUND_LIQUID;
            front.instance[i] = wet.pool[i];
            front.distance[i] = wet.start[i];
        }
        front
    }

    /// Adds a bubble at the first crossing of its shell.
    #[inline(always)]
    pub fn add_bubble(&mut self, instance: u16, crossings: [&Lane; 2], distance: &Lane) {
        for i in 0..LANES {
            let first = if crossings[0][i] > 0.0 { crossings[0][i] } else { crossings[1][i] };
            let nearer = (first > 0.0) & (first < distance[i]) & (first < self.distance[i]);
            self.distance[i] = if nearer { first } else { self.distance[i] };
            self.label[i] = if nearer { FOREGROUND_BUBBLE } else { self.label[i] };
            self.instance[i] = if nearer { instance } else { self.instance[i] };
        }
    }

    /// Writes the foreground channels.
    #[inline(always)]
    pub fn write(&self, tile: &TileRays, place: Place, out: &mut Channels<'_>) {
        let mut seen = [false; LANES];
        let mut depth = [0.0; LANES];
        for i in 0..LANES {
            seen[i] = tile.used[i] && self.label[i] != 0;
            depth[i] = self.distance[i] * tile.pyramid.directions[2][i];
        }
        place.write(&mut out.foreground_label, &self.label, &seen, 0);
        place.write(&mut out.foreground_instance, &self.instance, &seen, 0);
        place.write(&mut out.foreground_depth, &depth, &seen, f32::NAN);
    }
}
