//! Large arrays of plain data on huge pages.
//!
//! A ray touches a few nodes far apart. On pages of 4 KiB each touch also misses the translation buffers, so that the trees,
//! and what the builder streams through, live on 2 MiB pages where the system gives them. So does whatever else is read or written at
//! random.

use bytemuck::Zeroable;
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;

const HUGE_PAGE: usize = 2 << 20;

/// A fixed number of elements, zero at first.
pub struct Buffer<T> {
    start: NonNull<T>,
    len: usize,
    owner: Owner<T>,
}

enum Owner<T> {
    /// Small, or no such system: the heap.
    Heap(#[expect(dead_code, reason = "kept for its drop")] Vec<T>),
    /// A mapping of its own, from the first address over so many bytes.
    #[cfg(unix)]
    Mapped(*mut libc::c_void, usize),
}

// SAFETY: a buffer owns its elements as a vector does.
unsafe impl<T: Send> Send for Buffer<T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for Buffer<T> {}

impl<T: Zeroable + Copy> Buffer<T> {
    /// So many zeros.
    pub fn zeroed(len: usize) -> Self {
        #[cfg(unix)]
        if len.saturating_mul(size_of::<T>()) >= HUGE_PAGE
            && let Some(buffer) = Self::mapped(len)
        {
            return buffer;
        }
        let mut heap = vec![T::zeroed(); len];
        let start = NonNull::new(heap.as_mut_ptr()).unwrap_or(NonNull::dangling());
        Self {
            start,
            len,
            owner: Owner::Heap(heap),
        }
    }

    #[cfg(unix)]
    fn mapped(len: usize) -> Option<Self> {
        const { assert!(align_of::<T>() <= HUGE_PAGE) };
        let bytes = len.checked_mul(size_of::<T>())?.checked_add(HUGE_PAGE)?;
        // SAFETY: a new private mapping of zeros; it touches nothing that exists.
        let base = unsafe {
            libc::mmap(
                std::ptr::null_mut(),
                bytes,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_NORESERVE,
                -1,
                0,
            )
        };
        if base == libc::MAP_FAILED {
            return None;
        }
        let start = base.wrapping_byte_add(base.addr().wrapping_neg() % HUGE_PAGE);
        #[cfg(target_os = "linux")]
        // SAFETY: advice about part of the new mapping: there are `HUGE_PAGE` bytes more than used. It may be refused.
        unsafe {
            libc::madvise(start, bytes - HUGE_PAGE, libc::MADV_HUGEPAGE);
        }
        Some(Self {
            start: NonNull::new(start.cast())?,
            len,
            owner: Owner::Mapped(base, bytes),
        })
    }

    /// A copy.
    pub fn from_slice(slice: &[T]) -> Self {
        let mut buffer = Self::zeroed(slice.len());
        buffer.copy_from_slice(slice);
        buffer
    }
}

impl<T> Buffer<T> {
    /// The first element, for those who share the elements among threads by rules of their own.
    pub fn as_ptr(&self) -> *mut T {
        self.start.as_ptr()
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        match self.owner {
            Owner::Heap(_) => {}
            #[cfg(unix)]
            // SAFETY: the mapping that `mapped` made, once; elements are `Copy` and need no drop.
            Owner::Mapped(base, bytes) => unsafe {
                libc::munmap(base, bytes);
            },
        }
    }
}

impl<T> Deref for Buffer<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        // SAFETY: `start` is aligned (to a page, or by the vector) and begins `len` elements that this owns; zeros are valid.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
    }
}

impl<T> DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above, and `self` is borrowed alone.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.len) }
    }
}

impl<T: Zeroable + Copy> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self::from_slice(self)
    }
}

impl<T> std::fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Buffer of {}", self.len)
    }
}

#[cfg(test)]
mod tests {
    use super::Buffer;

    #[test]
    fn small_and_large_buffers_are_zero_and_hold_what_is_written() {
        for len in [0usize, 1, 1000, 3 << 20] {
            let mut buffer = Buffer::<u32>::zeroed(len);
            assert_eq!(buffer.len(), len);
            assert!(buffer.iter().all(|&x| x == 0));
            for (k, x) in buffer.iter_mut().enumerate() {
                *x = k as u32;
            }
            let copy = buffer.clone();
            drop(buffer);
            assert!(copy.iter().enumerate().all(|(k, &x)| x == k as u32));
        }
    }
}
