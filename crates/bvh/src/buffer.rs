//! Large arrays of plain data on huge pages.
//!
//! A ray touches a few nodes far apart. On pages of 4 KiB each touch also misses the translation buffers, so that the trees,
//! and what the builder streams through, live on 2 MiB pages where the system gives them. So does whatever else is read or written at
//! random.
//!
//! What is larger than memory can live in a file instead ([`Buffer::in_folder`]): the same array, but its owner says now and then that it may
//! leave memory ([`Buffer::release`]). The wrong tool for random access: every touch then waits for the disk.

use bytemuck::Zeroable;
use std::fs::File;
use std::io;
use std::ops::{Deref, DerefMut};
use std::path::Path;
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

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
    /// The same of a file without a name, shared with it.
    #[cfg(unix)]
    OnDisk(*mut libc::c_void, usize),
}

/// A new file in `folder` that has no name any more: it is gone when it is closed, however the process ends.
///
/// # Errors
/// The folder cannot be written to; [`io::ErrorKind::Unsupported`] where open files cannot lose their names.
pub fn nameless_file(folder: &Path) -> io::Result<File> {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    if !cfg!(unix) {
        return Err(io::ErrorKind::Unsupported.into());
    }
    loop {
        let number = NUMBER.fetch_add(1, Relaxed);
        let path = folder.join(format!(".occlude-{}-{number}", std::process::id()));
        let file = File::options()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&path);
        match file {
            // Left by a process of that number that was killed in between.
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => continue,
            Err(error) => return Err(error),
            Ok(file) => {
                std::fs::remove_file(&path)?;
                return Ok(file);
            }
        }
    }
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

    /// So many zeros in a nameless file in `folder`, all of whose room is taken at once. Elements come to memory as they are touched, and stay until
    /// [`Buffer::release`].
    ///
    /// # Errors
    /// As [`nameless_file`]; the disk is full. (A disk that fails later ends the process: the system has no other way to tell.)
    pub fn in_folder(folder: &Path, len: usize) -> io::Result<Self> {
        let file = nameless_file(folder)?;
        Self::on(&file, len)
    }

    #[cfg(not(unix))]
    fn on(_: &File, _: usize) -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    #[cfg(unix)]
    fn on(file: &File, len: usize) -> io::Result<Self> {
        use std::os::fd::AsRawFd;
        let too_large = || io::Error::from(io::ErrorKind::FileTooLarge);
        let bytes = len.checked_mul(size_of::<T>()).ok_or_else(too_large)?;
        if bytes == 0 {
            return Ok(Self::zeroed(len));
        }
        file.set_len(bytes as u64)?;
        #[cfg(target_os = "linux")]
        {
            let length = libc::off_t::try_from(bytes).map_err(|_| too_large())?;
            // SAFETY: the descriptor is open as long as `file` is borrowed.
            let failed = unsafe { libc::posix_fallocate(file.as_raw_fd(), 0, length) };
            if failed != 0 {
                return Err(io::Error::from_raw_os_error(failed));
            }
        }
        // SAFETY: a new mapping; it touches nothing that exists. The file has no name, so that nobody else maps or cuts it.
        let base = unsafe {
            libc::mmap(
                std::ptr::null_mut(),
                bytes,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                file.as_raw_fd(),
                0,
            )
        };
        if base == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Self {
            start: NonNull::new(base.cast()).ok_or_else(too_large)?,
            len,
            owner: Owner::OnDisk(base, bytes),
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

    /// Lets elements in a file leave memory until they are touched again; they keep their values. Others stay.
    pub fn release(&self) {
        #[cfg(unix)]
        if let Owner::OnDisk(base, bytes) = self.owner {
            // SAFETY: of a mapping shared with a file this only forgets which pages are in memory: whoever touches them, even meanwhile, finds
            // what was written.
            unsafe {
                libc::madvise(base, bytes, libc::MADV_DONTNEED);
            }
        }
    }
}

impl<T: Zeroable + Copy> Default for Buffer<T> {
    /// Nothing.
    fn default() -> Self {
        Self::zeroed(0)
    }
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        match self.owner {
            Owner::Heap(_) => {}
            #[cfg(unix)]
            // SAFETY: the mapping that this made, once; elements are `Copy` and need no drop.
            Owner::Mapped(base, bytes) | Owner::OnDisk(base, bytes) => unsafe {
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

    #[cfg(unix)]
    #[test]
    fn buffers_in_files_keep_what_is_written_and_leave_no_file() {
        let folder = std::env::temp_dir().join(format!("occlude-buffer-{}", std::process::id()));
        std::fs::create_dir(&folder).unwrap();
        for len in [0usize, 1, 1000, 300_000] {
            let mut buffer = Buffer::<u32>::in_folder(&folder, len).unwrap();
            assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
            assert_eq!(buffer.len(), len);
            for (k, x) in buffer.iter_mut().enumerate() {
                assert_eq!(*x, 0);
                *x = k as u32;
            }
            buffer.release();
            assert!(buffer.iter().enumerate().all(|(k, &x)| x == k as u32));
        }
        std::fs::remove_dir(&folder).unwrap();
        assert!(Buffer::<u32>::in_folder(&folder, 5).is_err());
    }
}
