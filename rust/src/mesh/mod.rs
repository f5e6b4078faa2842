//! Triangle meshes and their textures.

pub mod self_intersection;
pub mod texels;
pub mod turned;
