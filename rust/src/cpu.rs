//! What the core makes of this processor.

use pyo3::prelude::*;

/// Names of the vector extensions that the hot loops use here.
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

/// Threads that the core works with (`RAYON_NUM_THREADS` sets them).
#[pyfunction]
pub fn num_threads() -> usize {
    rayon::current_num_threads()
}

/// Does work on the threads of the core, without Python; the parts that it is cut into start
/// without a change of thread.
pub fn on_pool<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    py.detach(|| rayon::scope(|_| work()))
}
