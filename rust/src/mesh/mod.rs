//! Triangles on textures.

pub mod texels;
