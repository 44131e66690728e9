//! The files of the page, compiled in: `tools/viewer/page`.

/// A file of the page.
pub(super) struct File {
    pub(super) name: &'static str,
    pub(super) kind: &'static str,
    pub(super) text: &'static str,
}

macro_rules! file {
    ($name:literal, $kind:literal) => {
        File {
            name: $name,
            kind: concat!($kind, "; charset=utf-8"),
            text: include_str!(concat!("../../../tools/viewer/page/", $name)),
        }
    };
}

/// All files; the first is the page itself.
pub(super) const FILES: &[File] = &[
    file!("index.html", "text/html"),
    file!("style.css", "text/css"),
    file!("main.js", "text/javascript"),
    file!("scene.js", "text/javascript"),
    file!("spectrum.js", "text/javascript"),
    file!("source.js", "text/javascript"),
    file!("three.js", "text/javascript"),
];
