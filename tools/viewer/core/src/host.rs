//! What passes between WebAssembly and the page: texts and bytes, by their places in memory.
//!
//! The page asks: it writes a text where [`room`] says, then calls [`open`] or [`answer`], which
//! return a status of HTTP. Meanwhile bytes go to `piece`, and what went wrong to `failed`. All
//! runs on one thread. A panic ends it all: the page starts anew.

// Places in memory cross the border as numbers.
#![allow(unsafe_code)]

use crate::{Viewer, refusal};
use isospan::archive::segment::FORMAT_VERSION;
use isospan::bytes::remote::{Fetched, Ranges, Wanted, add_host};
use isospan::{Error, Result};
use isospan_cli::answers::Sink;
use std::cell::{Cell, RefCell};
use std::io;

/// The newest format of archives that is read: a section of the file, for those who have the file
/// alone.
#[unsafe(link_section = "isospan")]
#[used]
static FORMAT: [u8; 2] = FORMAT_VERSION.to_le_bytes();

mod page {
    #[link(wasm_import_module = "page")]
    unsafe extern "C" {
        /// Writes bytes `from..to` of a file to `out`, the last `-from` ones where it is negative,
        /// and to `place` the length of the file, and the range that came. Returns their number. If
        /// it fails, that is less than 0: by the length of a text in `out`; the first number in
        /// `place` is a status.
        pub(super) fn fetch(
            name: *const u8,
            name_len: usize,
            from: f64,
            to: f64,
            out: *mut u8,
            room: usize,
            place: *mut f64,
        ) -> i32;
        /// Takes bytes of an answer.
        pub(super) fn piece(bytes: *const u8, len: usize);
        /// Takes what went wrong.
        pub(super) fn failed(text: *const u8, len: usize);
        /// Lets the page's wishes in, where the browser can wait here. Returns a number other than
        /// 0 if the answer is no longer wanted.
        pub(super) safe fn stopped() -> u32;
        /// Milliseconds on a clock that never goes back.
        pub(crate) safe fn now() -> f64;
    }
}
/// Milliseconds since the page was opened.
pub(crate) fn now() -> f64 {
    page::now()
}

/// Milliseconds between two questions whether the answer is still wanted.
const PATIENCE: f64 = 30.0;

thread_local! {
    /// When the page was asked last, and what it said.
    static ASKED: Cell<(f64, bool)> = const { Cell::new((0.0, false)) };
}

/// Whether the page no longer wants the answer.
pub(crate) fn is_stopped() -> bool {
    let (last, is_stopped) = ASKED.get();
    if is_stopped || now() - last < PATIENCE {
        return is_stopped;
    }
    let is_stopped = page::stopped() != 0;
    ASKED.set((now(), is_stopped));
    is_stopped
}

/// Bytes of a piece of an answer.
const PIECE: usize = 1 << 20;
/// Room for what a server may say.
const TEXT: usize = 1 << 10;

/// The files beside the page.
struct BesidePage;

impl Ranges for BesidePage {
    fn get(&self, name: &str, wanted: &Wanted) -> io::Result<Fetched> {
        let (from, to, most) = match wanted {
            Wanted::Last(count) => (-(*count as f64), 0.0, *count),
            Wanted::At(range) => (range.start as f64, range.end as f64, range.end - range.start),
        };
        let most = usize::try_from(most).map_err(io::Error::other)?;
        let (mut bytes, mut place) = (vec![0; most.max(TEXT)], [0.0; 3]);
        // SAFETY: the page writes at most `room` bytes to `out` and three numbers to `place`, and
        // reads the name, before it returns.
        let count = unsafe {
            page::fetch(
                name.as_ptr(),
                name.len(),
                from,
                to,
                bytes.as_mut_ptr(),
                bytes.len(),
                place.as_mut_ptr(),
            )
        };
        bytes.truncate(count.unsigned_abs() as usize);
        if count < 0 {
            let kind = if place[0] == 404.0 { io::ErrorKind::NotFound } else { io::ErrorKind::Other };
            return Err(io::Error::new(kind, String::from_utf8_lossy(&bytes).into_owned()));
        }
        let [len, start, end] = place.map(|n| n as u64);
        if end.checked_sub(start) != Some(bytes.len() as u64) || end > len {
            return Err(io::Error::other(format!("got {} bytes of {start}..{end} of {len}", bytes.len())));
        }
        Ok(Fetched { len, range: start..end, bytes })
    }
}

#[derive(Default)]
struct State {
    text: Vec<u8>,
    viewer: Option<Viewer>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

/// Room for the text of the next call, of so many bytes.
#[unsafe(no_mangle)]
pub(crate) extern "C" fn room(len: usize) -> *mut u8 {
    STATE.with_borrow_mut(|state| {
        state.text.clear();
        state.text.resize(len, 0);
        state.text.as_mut_ptr()
    })
}

/// Opens archives beside the page: the text has the name of one in each line.
#[unsafe(no_mangle)]
pub(crate) extern "C" fn open() -> u32 {
    std::panic::set_hook(Box::new(|panic| fail(&panic.to_string())));
    add_host("page", BesidePage);
    STATE.with_borrow_mut(|state| {
        let opened = text_of(&state.text).and_then(|names| {
            let addresses: Vec<_> = names.lines().map(|name| format!("host://page/{name}").into()).collect();
            Viewer::open(&addresses)
        });
        status(opened.map(|viewer| state.viewer = Some(viewer)))
    })
}

/// Bytes that are free when an answer begins. A browser takes half a millisecond for each growth of
/// memory, however small, and the allocator asks for little at a time: a large surface would wait
/// seconds. Memory that is not used costs the reader's machine nothing.
const FREE: usize = 256 << 20;

/// Lets memory grow at once, where it has not so much that is free.
fn grow() {
    let mut room: Vec<u8> = vec![];
    let _ = std::hint::black_box(room.try_reserve_exact(FREE));
    std::hint::black_box(&room);
}

/// Answers the question whose address is the text.
#[unsafe(no_mangle)]
pub(crate) extern "C" fn answer() -> u32 {
    ASKED.set((now(), false));
    grow();
    STATE.with_borrow(|state| {
        let mut pieces = PageSink(Vec::with_capacity(PIECE));
        let viewer = state.viewer.as_ref().ok_or_else(|| Error::usage("no archive is open"));
        let answered = viewer.and_then(|viewer| viewer.answer(text_of(&state.text)?, &mut pieces));
        status(answered.and_then(|()| pieces.flush()))
    })
}

fn text_of(bytes: &[u8]) -> Result<&str> {
    std::str::from_utf8(bytes).map_err(|e| Error::usage(e.to_string()))
}

fn status(result: Result<()>) -> u32 {
    match result {
        Ok(()) => 200,
        Err(e) => {
            let (status, text) = refusal(&e);
            fail(&text);
            status
        }
    }
}

fn fail(text: &str) {
    // SAFETY: the page reads the text, before it returns.
    unsafe { page::failed(text.as_ptr(), text.len()) }
}

/// Bytes on their way to the page.
struct PageSink(Vec<u8>);

impl Sink for PageSink {
    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        bytes.chunks(PIECE).try_for_each(|part| {
            if self.0.len() + part.len() > PIECE {
                self.flush()?;
            }
            self.0.extend_from_slice(part);
            Ok(())
        })
    }

    fn flush(&mut self) -> Result<()> {
        // SAFETY: the page copies the bytes, before it returns.
        unsafe { page::piece(self.0.as_ptr(), self.0.len()) };
        self.0.clear();
        Ok(())
    }
}
