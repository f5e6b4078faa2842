//! Images of a wall and the lumen contents: ray tracing, shading, indirect light, image channels.

pub mod batch;
pub mod channels;
mod cloud_noise;
mod diffusion;
pub mod forward_scatter;
pub mod frame;
pub mod led;
mod led_visibility;
pub mod lumen;
mod lumen_tile;
pub mod material;
pub mod medium;
mod near_disc;
pub mod path;
pub mod radiosity;
pub mod ray_table;
pub mod scene;
pub mod shading;
pub mod texture;
pub mod tile;
pub mod view;
pub mod villi;
