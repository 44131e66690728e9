//! The files of the page, compiled in: `src/cli/page`.

/// A file of the page.
pub(in crate::commands) struct PageFile {
    pub(in crate::commands) name: &'static str,
    pub(super) kind: &'static str,
    pub(in crate::commands) content: &'static [u8],
    /// Compressed by gzip; every browser takes it as it is.
    pub(in crate::commands) is_gzip: bool,
}

macro_rules! file {
    ($name:literal, $kind:literal) => {
        file!($name, $kind, "", false)
    };
    ($name:literal, $kind:literal, $suffix:literal, $is_gzip:literal) => {
        PageFile {
            name: $name,
            kind: concat!($kind, "; charset=utf-8"),
            content: include_bytes!(concat!("../../page/", $name, $suffix)),
            is_gzip: $is_gzip,
        }
    };
}

/// All files; the first is the page itself.
pub(in crate::commands) const FILES: &[PageFile] = &[
    file!("index.html", "text/html"),
    file!("style.css", "text/css"),
    file!("main.js", "text/javascript"),
    file!("scene.js", "text/javascript"),
    file!("spectrum.js", "text/javascript"),
    file!("source.js", "text/javascript"),
    file!("local.js", "text/javascript"),
    file!("three.js", "text/javascript", ".gz", true),
];

/// What runs the queries in a page without a server.
pub(in crate::commands) const WORKER: &[u8] = include_bytes!("../../page/worker.js");

/// The queries of a page without a server.
#[cfg_attr(not(has_wasm), allow(dead_code, reason = "they were not made"))]
pub(in crate::commands) struct Queries {
    /// As WebAssembly, compressed by zstd, for a fifth less of the program; a browser unpacks gzip.
    pub(in crate::commands) wasm_zst: &'static [u8],
    /// The licences of what is compiled in, compressed by gzip.
    pub(in crate::commands) licences_gz: &'static [u8],
}

/// `None` where `tools/viewer/wasm` had not made them when this program was built: see `build.rs`.
#[cfg(has_wasm)]
pub(in crate::commands) const QUERIES: Option<Queries> = Some(Queries {
    wasm_zst: include_bytes!("../../page/isospan.wasm.zst"),
    licences_gz: include_bytes!("../../page/licences.txt.gz"),
});
#[cfg(not(has_wasm))]
pub(in crate::commands) const QUERIES: Option<Queries> = None;

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read as _;

    fn text_of(name: &str) -> String {
        let file = FILES.iter().find(|file| file.name == name).unwrap();
        let mut content = file.content.to_vec();
        if file.is_gzip {
            content.clear();
            flate2::read::GzDecoder::new(file.content).read_to_end(&mut content).unwrap();
        }
        String::from_utf8(content).unwrap()
    }

    #[test]
    fn the_bundle_has_what_the_scene_imports() {
        let (scene, bundle) = (text_of("scene.js"), text_of("three.js"));
        assert!(bundle.contains("Three.js Authors"), "its licence");
        let (names, _) = scene.split_once("} from \"./three.js\";").unwrap();
        let (_, names) = names.rsplit_once("import {").unwrap();
        let (_, exported) = bundle.rsplit_once("export{").unwrap();
        let names: Vec<&str> = names.split(',').map(str::trim).filter(|name| !name.is_empty()).collect();
        assert!(names.len() > 5, "{names:?}");
        for name in names {
            let is_there = exported.split([',', '}']).any(|e| e.rsplit(' ').next() == Some(name));
            assert!(is_there, "{name} is not in the bundle: run tools/viewer/three");
        }
    }
}
