//! What the core makes of this processor.

use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

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

/// Most threads that are kept awake between parts of work; more would be in the way of others.
const AWAKE: usize = 8;
/// How long a thread that finds nothing to do stays awake for the next part of the work.
const SPIN_TIME: Duration = Duration::from_micros(200);

/// Does work on the threads of the core, without Python; the parts that it is cut into start
/// without a change of thread.
///
/// Between those parts other threads stay awake: to fall asleep and be woken takes longer than many
/// of them.
pub fn on_pool<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    let is_done = AtomicBool::new(false);
    py.detach(|| {
        rayon::scope(|scope| {
            for _ in 1..rayon::current_num_threads().min(AWAKE) {
                scope.spawn(|_| stay_awake(&is_done));
            }
            let result = work();
            is_done.store(true, Ordering::Release);
            result
        })
    })
}

/// Does what other threads offer until all is done, or nothing was offered for long.
fn stay_awake(is_done: &AtomicBool) {
    let mut last = Instant::now();
    while !is_done.load(Ordering::Acquire) {
        if rayon::yield_now() == Some(rayon::Yield::Executed) {
            last = Instant::now();
        } else if last.elapsed() > SPIN_TIME {
            return;
        } else {
            std::hint::spin_loop();
        }
    }
}
