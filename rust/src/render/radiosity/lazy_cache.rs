//! Lazy cache of light at gather points and vertices, in memory reused between frames.

use std::cell::UnsafeCell;
use std::ops::Deref;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

/// Irradiance of red, green, blue, and their sum; the change of the sum as the normal tilts along
/// x, y and z, the tangential part of the light vector [W/m²]. The last value is 0.
pub type Light = [f32; 8];

/// Light at one point; known if its stage is that of the frame.
///
/// Threads that need it at the same time all compute it; their results are identical, and one of
/// them is stored.
struct Slot<T> {
    /// Twice the index of the frame while it is written, and one more afterwards.
    stage: AtomicU32,
    light: UnsafeCell<T>,
}

// SAFETY: `light` is written only by the one thread whose exchange of `stage` succeeds in a frame,
// before it publishes that with release order, and read only after the publication is observed with
// acquire order. Between frames nobody borrows the slots. A lock for each gather point and vertex
// would cost more than the computation itself.
unsafe impl<T: Copy + Send + Sync> Sync for Slot<T> {}

impl<T: Copy + Default> Slot<T> {
    fn new() -> Self {
        Slot { stage: AtomicU32::new(0), light: UnsafeCell::new(T::default()) }
    }

    #[inline(always)]
    fn known(&self, frame: u32) -> Option<T> {
        let is_known = self.stage.load(Ordering::Acquire) == 2 * frame + 1;
        // SAFETY: see above.
        is_known.then(|| unsafe { *self.light.get() })
    }

    #[inline(always)]
    fn keep(&self, frame: u32, found: &T) {
        let (writing, known) = (2 * frame, 2 * frame + 1);
        let stage = self.stage.load(Ordering::Acquire);
        let is_first = stage < writing
            && self
                .stage
                .compare_exchange(stage, writing, Ordering::Acquire, Ordering::Relaxed)
                .is_ok();
        if is_first {
            // SAFETY: see above.
            unsafe { *self.light.get() = *found };
            self.stage.store(known, Ordering::Release);
        }
    }
}

/// Slots for the light of one frame.
pub struct Slots<T> {
    frame: u32,
    gather_points: Box<[Slot<T>]>,
    vertices: Box<[Slot<T>]>,
}

/// Slots that no frame uses now.
///
/// No thread waits for the lock: a forked process may inherit a copy that is locked forever.
pub struct CachePool<T = Light> {
    /// Numbers of gather points and vertices.
    counts: (usize, usize),
    free: Mutex<Vec<Slots<T>>>,
}

impl<T: Copy + Default> CachePool<T> {
    /// Empty pool for the given numbers of gather points and vertices.
    pub fn new(counts: (usize, usize)) -> Self {
        CachePool { counts, free: Mutex::new(Vec::new()) }
    }

    /// Returns slots in which no light is known.
    pub fn lend(&self) -> FrameCache<'_, T> {
        let kept = self.free.try_lock().ok().and_then(|mut free| free.pop());
        let slots = |count: usize| (0..count).map(|_| Slot::new()).collect();
        let fresh = || Slots {
            frame: 0,
            gather_points: slots(self.counts.0),
            vertices: slots(self.counts.1),
        };
        let most = u32::MAX / 2 - 1;
        let mut slots = kept.filter(|slots| slots.frame < most).unwrap_or_else(fresh);
        slots.frame += 1;
        FrameCache { pool: self, slots: Some(slots) }
    }
}

/// Light of one frame; returns its slots to the pool when dropped.
pub struct FrameCache<'a, T = Light> {
    pool: &'a CachePool<T>,
    slots: Option<Slots<T>>,
}

impl<T> Deref for FrameCache<'_, T> {
    type Target = Slots<T>;

    #[inline(always)]
    fn deref(&self) -> &Slots<T> {
        self.slots.as_ref().expect("kept until dropped")
    }
}

impl<T> Drop for FrameCache<'_, T> {
    fn drop(&mut self) {
        if let (Ok(mut free), Some(slots)) = (self.pool.free.try_lock(), self.slots.take()) {
            free.push(slots);
        }
    }
}

impl<T: Copy + Default> Slots<T> {
    /// Light at a gather point, if it has been computed.
    #[inline(always)]
    pub fn gather_point(&self, gather_point: usize) -> Option<T> {
        self.gather_points[gather_point].known(self.frame)
    }

    /// Stores the light at a gather point.
    #[inline(always)]
    pub fn keep_gather_point(&self, gather_point: usize, light: &T) {
        self.gather_points[gather_point].keep(self.frame, light);
    }

    /// Light at a vertex, if it has been computed.
    #[inline(always)]
    pub fn vertex(&self, vertex: usize) -> Option<T> {
        self.vertices[vertex].known(self.frame)
    }

    /// Stores the light at a vertex.
    #[inline(always)]
    pub fn keep_vertex(&self, vertex: usize, light: &T) {
        self.vertices[vertex].keep(self.frame, light);
    }
}
