//! Thread pool of this process, also after a fork.
//!
//! A forked process has the memory of its parent but none of its threads, so it would wait forever
//! for the parent's pool. Here it discards that pool and starts a new one on first use. All
//! parallel work must therefore run in this pool, never in the global one of `rayon`:
//! `forbid_global_pool` turns a mistake into a panic in tests, `clippy.toml` lists the functions
//! that start from the global pool.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::ptr::null_mut;
use std::sync::atomic::{AtomicBool, AtomicPtr, Ordering};
use std::time::{Duration, Instant};

/// The pool, or null before its first use in this process.
static POOL: AtomicPtr<ThreadPool> = AtomicPtr::new(null_mut());

/// Prepares the module for forks of its process.
pub fn watch_forks() {
    // SAFETY: the handler stores one atomic pointer, which is safe in a forked process.
    #[cfg(unix)]
    unsafe {
        libc::pthread_atfork(None, None, Some(forget_pool));
    }
}

/// Leaks the pool in a forked process, where its threads do not exist to be joined.
#[cfg(unix)]
extern "C" fn forget_pool() {
    POOL.store(null_mut(), Ordering::Release);
}

/// The pool of this process, with `RAYON_NUM_THREADS` threads or one for each processor.
fn pool() -> &'static ThreadPool {
    let found = POOL.load(Ordering::Acquire);
    if !found.is_null() {
        // SAFETY: pools are never freed once they are stored.
        return unsafe { &*found };
    }
    let name = |number| format!("vrcaps-{number}");
    let made = ThreadPoolBuilder::new().thread_name(name).build();
    let made = made.unwrap_or_else(|error| {
        panic!("The threads of the core cannot start: {error}. Set RAYON_NUM_THREADS to fewer.")
    });
    let made = Box::into_raw(Box::new(made));
    match POOL.compare_exchange(null_mut(), made, Ordering::AcqRel, Ordering::Acquire) {
        // SAFETY: as above.
        Ok(_) => unsafe { &*made },
        // SAFETY: another thread was first; `made` was not stored, so this is its only owner.
        Err(first) => unsafe {
            drop(Box::from_raw(made));
            &*first
        },
    }
}

/// Runs work in the pool; on the calling thread if that belongs to the pool.
pub fn install<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    pool().install(work)
}

/// Runs work in the pool, detached from Python.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    py.detach(|| install(work))
}

/// Results of a function for each item, in order, computed detached from Python in parts of at
/// least `part` items.
///
/// Items of a single part stay on the calling thread: the pool may be busy with an image.
pub fn map<A: Sync, T: Send>(
    py: Python<'_>,
    items: &[A],
    part: usize,
    function: impl Fn(&A) -> T + Send + Sync,
) -> Vec<T> {
    if items.len() < 2 * part {
        return py.detach(|| items.iter().map(function).collect());
    }
    detached(py, || items.par_iter().with_min_len(part).map(function).collect())
}

/// Maximum number of threads kept awake between parts of work; more would disturb others.
const AWAKE: usize = 8;
/// Time for which an idle thread stays awake, waiting for the next part of the work.
const SPIN_TIME: Duration = Duration::from_micros(200);

/// Runs work in the pool, detached from Python; its parts start without a change of thread.
///
/// Between those parts other threads stay awake: falling asleep and waking takes longer than many
/// of them.
pub fn on_pool<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    let is_done = AtomicBool::new(false);
    py.detach(|| {
        let pool = pool();
        pool.scope(|scope| {
            for _ in 1..pool.current_num_threads().min(AWAKE) {
                scope.spawn(|_| stay_awake(&is_done));
            }
            let result = work();
            is_done.store(true, Ordering::Release);
            result
        })
    })
}

/// Takes work from other threads until all is done, or none was offered for `SPIN_TIME`.
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

/// Number of threads of the core (set by `RAYON_NUM_THREADS`).
#[pyfunction]
pub fn num_threads() -> usize {
    pool().current_num_threads()
}

/// Makes parallel work outside the pool panic from now on, for tests.
#[pyfunction]
pub fn forbid_global_pool() -> PyResult<()> {
    let none = |_| Err(std::io::Error::other("forbidden"));
    #[allow(clippy::disallowed_methods)] // it must fail
    match ThreadPoolBuilder::new().spawn_handler(none).build_global() {
        Err(error) if error.to_string().contains("already") => {
            Err(PyRuntimeError::new_err("The global pool was in use before it was forbidden."))
        }
        _ => Ok(()),
    }
}
