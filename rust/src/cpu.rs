//! Features of this processor that the core uses.

use pyo3::prelude::*;

/// Names of the vector extensions used by the hot loops.
#[pyfunction]
pub fn cpu_features() -> Vec<&'static str> {
    let mut features = Vec::new();
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512cd")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512vbmi2")
        {
            features.push("avx512");
        } else if is_x86_feature_detected!("avx2") {
            features.push("avx2");
        } else {
            features.push("sse2");
        }
    }
    #[cfg(target_arch = "aarch64")]
    features.push("neon");
    features
}
