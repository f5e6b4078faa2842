//! Arithmetic over SIMD lanes, in single and double precision.
//!
//! Hot loops run over plain arrays of a fixed length, which the compiler turns into vector code of
//! the machine's width. Nothing is fused, reordered or delegated to a system's mathematics library,
//! so results are bit-identical on every processor.

pub mod f32x64;
pub mod f64x8;
