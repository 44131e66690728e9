//! Read-only mappings, and what happens when a mapped file gets shorter.
//!
//! Touching a page of a mapping whose file no longer reaches it raises SIGBUS, which ends a process
//! that does not expect it. Checking the length before each access does not help: the file can
//! shrink between check and access. So the signal is handled, as the Wayland library does for
//! buffers that it shares with programs it cannot trust:
//!
//! ```text
//!  access ──▶ SIGBUS ──▶ handler: is the address in one of our mappings?
//!                          yes: maps zeros over the rest of that mapping, marks it broken, the access goes on
//!                          no:  as if there were no handler of ours (the one before, or the default, decides)
//!  after the access: a mapping marked broken, or a file shorter than its mapping, is an error naming the file
//! ```
//!
//! The zeros are never taken for data, because [`Mapping::check`] comes after the last access and
//! before a result is used. The length is checked too: if a file was cut inside a page, the rest of
//! that page reads as zeros without a signal. Cost: one `fstat` for each check, nothing for an
//! access.
//!
//! The handler is installed when the first file is mapped and stays. Its list of mappings only
//! grows (entries are used again), so that it can be walked in a signal handler, without a lock.
//!
//! Not promised: a file whose bytes are *changed* while it is read gives some of the old and some
//! of the new ones.

#![allow(unsafe_code)]

use memmap2::{Mmap, MmapOptions};
use std::fs::File;
use std::io;
use std::ops::Range;

/// A whole file, mapped read-only.
#[derive(Debug)]
pub(super) struct Mapping {
    map: Mmap,
    #[cfg(unix)]
    guard: guard::KnownMapping,
}

impl Mapping {
    pub(super) fn new(file: &File) -> io::Result<Self> {
        // SAFETY: the mapping is private and read-only, and lives as long as `Mmap`. A file that
        // shrinks meanwhile raises SIGBUS, which the entry made below turns into zeros and a mark.
        let map = unsafe { MmapOptions::new().map(file)? };
        #[cfg(unix)]
        let guard = guard::KnownMapping::new(&map)?;
        Ok(Self {
            map,
            #[cfg(unix)]
            guard,
        })
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Whether a page of the mapping could not be loaded and reads as zeros.
    pub(super) fn is_broken(&self) -> bool {
        #[cfg(unix)]
        return self.guard.is_broken();
        // Other systems do not let a mapped file be cut.
        #[cfg(not(unix))]
        false
    }

    /// A hint; refused hints are of no consequence.
    pub(super) fn advise_will_need(&self, range: Range<u64>) {
        #[cfg(unix)]
        if range.start < range.end {
            let (start, len) = (range.start as usize, (range.end - range.start) as usize);
            let _ = self.map.advise_range(memmap2::Advice::WillNeed, start, len);
        }
        #[cfg(not(unix))]
        let _ = range;
    }

    /// Takes a range of whole pages out of this process's page tables: only then can the system
    /// drop them.
    pub(super) fn let_go(&self, range: Range<u64>) {
        #[cfg(target_os = "linux")]
        if range.start < range.end {
            let (start, len) = (range.start as usize, (range.end - range.start) as usize);
            // SAFETY: a private read-only mapping of a file has no bytes of its own to lose: the
            // next access reads the same bytes from the file again.
            let _ =
                unsafe { self.map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, start, len) };
        }
        #[cfg(not(target_os = "linux"))]
        let _ = range;
    }
}

/// The SIGBUS handler and its list of mappings.
#[cfg(unix)]
mod guard {
    use std::io;
    use std::mem::MaybeUninit;
    use std::ptr;
    use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
    use std::sync::{Mutex, OnceLock, PoisonError};

    /// A mapping that the handler knows. Entries are leaked: the handler may be walking the list at
    /// any time.
    #[derive(Debug)]
    struct Node {
        /// First byte, and past the last page; both 0 when the node is free.
        start: AtomicUsize,
        end: AtomicUsize,
        broken: AtomicBool,
        next: Option<&'static Node>,
    }

    static NEWEST: AtomicPtr<Node> = AtomicPtr::new(ptr::null_mut());
    static FREE: Mutex<Vec<&'static Node>> = Mutex::new(vec![]);
    /// The handler that was there before.
    static BEFORE: OnceLock<libc::sigaction> = OnceLock::new();
    static PAGE: AtomicUsize = AtomicUsize::new(0);

    /// Keeps a mapping known to the handler; to be dropped before the mapping is.
    #[derive(Debug)]
    pub(super) struct KnownMapping(&'static Node);

    impl KnownMapping {
        pub(super) fn new(map: &memmap2::Mmap) -> io::Result<Self> {
            install()?;
            let page = PAGE.load(Ordering::Relaxed);
            let start = map.as_ptr() as usize;
            let end = (start + map.len()).next_multiple_of(page);
            let mut free = FREE.lock().unwrap_or_else(PoisonError::into_inner);
            let node = free.pop().unwrap_or_else(push_node);
            node.broken.store(false, Ordering::Relaxed);
            node.end.store(end, Ordering::Relaxed);
            node.start.store(start, Ordering::Release);
            Ok(Self(node))
        }

        pub(super) fn is_broken(&self) -> bool {
            self.0.broken.load(Ordering::Acquire)
        }
    }

    impl Drop for KnownMapping {
        fn drop(&mut self) {
            self.0.start.store(0, Ordering::Relaxed);
            self.0.end.store(0, Ordering::Release);
            FREE.lock().unwrap_or_else(PoisonError::into_inner).push(self.0);
        }
    }

    /// Puts a node at the front of the list. Called with `FREE` locked: no other thread pushes
    /// meanwhile.
    fn push_node() -> &'static Node {
        let first = NEWEST.load(Ordering::Acquire);
        // SAFETY: only leaked nodes get into the list, and they are never written but through their
        // atomics.
        let next = unsafe { first.as_ref() };
        let node: &'static Node = Box::leak(Box::new(Node {
            start: AtomicUsize::new(0),
            end: AtomicUsize::new(0),
            broken: AtomicBool::new(false),
            next,
        }));
        NEWEST.store(ptr::from_ref(node).cast_mut(), Ordering::Release);
        node
    }

    fn install() -> io::Result<()> {
        static INSTALLED: Mutex<bool> = Mutex::new(false);
        let mut installed = INSTALLED.lock().unwrap_or_else(PoisonError::into_inner);
        if *installed {
            return Ok(());
        }
        PAGE.store(rustix::param::page_size(), Ordering::Relaxed);
        // SAFETY: `sigaction` is plain data, for which zeros are a valid value.
        let mut ours: libc::sigaction = unsafe { MaybeUninit::zeroed().assume_init() };
        let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) = on_sigbus;
        ours.sa_sigaction = handler as usize;
        ours.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
        let mut before = MaybeUninit::<libc::sigaction>::zeroed();
        // SAFETY: both point to `sigaction`s; the handler calls only what may be called in a signal
        // handler. The one before is kept before ours can be needed: nothing is in the list yet.
        let result = unsafe { libc::sigaction(libc::SIGBUS, &raw const ours, before.as_mut_ptr()) };
        if result != 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: filled by the call above, which succeeded.
        let _ = BEFORE.set(unsafe { before.assume_init() });
        *installed = true;
        Ok(())
    }

    extern "C" fn on_sigbus(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        // SAFETY: with SA_SIGINFO the system passes a valid `siginfo_t`; SIGBUS has an address.
        let address = unsafe { (*info).si_addr() } as usize;
        // SAFETY: see `push_node`.
        let mut next = unsafe { NEWEST.load(Ordering::Acquire).as_ref() };
        while let Some(node) = next {
            let (start, end) = (node.start.load(Ordering::Acquire), node.end.load(Ordering::Acquire));
            if start != 0 && (start..end).contains(&address) && zeros_over(address, end) {
                node.broken.store(true, Ordering::Release);
                return;
            }
            next = node.next;
        }
        pass_on(signal, info, context);
    }

    /// Replaces the pages from the one of `address` to `end` by zeros.
    fn zeros_over(address: usize, end: usize) -> bool {
        let at = address & !(PAGE.load(Ordering::Relaxed) - 1);
        // The interrupted code may be about to look at it.
        let error = io::Error::last_os_error().raw_os_error();
        // SAFETY: the pages belong to a mapping of ours that is alive, for the access that faulted
        // borrows from it. What is mapped over it is as readable, and is unmapped with it.
        let mapped = unsafe {
            libc::mmap(
                at as *mut libc::c_void,
                end - at,
                libc::PROT_READ,
                libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED,
                -1,
                0,
            )
        };
        if let Some(error) = error {
            set_errno(error);
        }
        mapped != libc::MAP_FAILED
    }

    /// Sets `errno` back.
    fn set_errno(error: i32) {
        #[cfg(target_os = "linux")]
        // SAFETY: the address of this thread's `errno` is always valid.
        unsafe {
            *libc::__errno_location() = error;
        }
        #[cfg(target_vendor = "apple")]
        // SAFETY: as above.
        unsafe {
            *libc::__error() = error;
        }
        #[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
        let _ = error;
    }

    /// Does what would have happened without our handler.
    fn pass_on(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        let before = BEFORE.get().filter(|b| ![libc::SIG_DFL, libc::SIG_IGN].contains(&b.sa_sigaction));
        let Some(before) = before else {
            // SAFETY: the default action, taken when the faulting instruction runs again: the
            // process ends, as it would have.
            unsafe { libc::signal(signal, libc::SIG_DFL) };
            return;
        };
        if before.sa_flags & libc::SA_SIGINFO != 0 {
            type Full = extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void);
            // SAFETY: with SA_SIGINFO that is the type of a handler.
            let handler = unsafe { std::mem::transmute::<usize, Full>(before.sa_sigaction) };
            handler(signal, info, context);
        } else {
            // SAFETY: without SA_SIGINFO that is the type of a handler.
            let handler =
                unsafe { std::mem::transmute::<usize, extern "C" fn(libc::c_int)>(before.sa_sigaction) };
            handler(signal);
        }
    }
}
