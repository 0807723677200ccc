//! The files of the page in the browser, which are embedded in the program. Its declarations of types, `tsconfig.json`
//! and `package.json` are for checks and tests only.

use super::jobs::task::mask_sources;
use std::borrow::Cow;

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub struct PageFile {
    /// Path under which it is requested.
    pub path: &'static str,
    /// Its media type.
    pub media_type: &'static str,
    /// Its contents.
    pub bytes: &'static [u8],
}

macro_rules! files {
    ($($path:literal $kind:literal $file:literal,)*) => {
        [$(PageFile { path: $path, media_type: $kind, bytes: include_bytes!(concat!("page/", $file)) }),*]
    };
}

macro_rules! modules {
    ($($name:literal,)*) => {
        [$(PageFile {
            path: concat!("/", $name),
            media_type: "text/javascript; charset=utf-8",
            bytes: include_bytes!(concat!("page/", $name)),
        }),*]
    };
}

/// All files but the modules.
pub const FILES: [PageFile; 3] = files![
    "/" "text/html; charset=utf-8" "index.html",
    "/style.css" "text/css; charset=utf-8" "style.css",
    "/icon.svg" "image/svg+xml" "icon.svg",
];

/// Returns the bytes of one of the [`FILES`] as it is sent: the page lists the mask sources that can be chosen.
#[must_use]
pub fn filled(file: &PageFile) -> Cow<'static, [u8]> {
    let text = match std::str::from_utf8(file.bytes) {
        Ok(text) if text.contains(MASK_SOURCES) => text,
        _ => return Cow::Borrowed(file.bytes),
    };
    // the names consist of letters, digits, `-` and `_`
    let option = |name: String| format!("<option value=\"{name}\">{name}</option>");
    let options: String = mask_sources().into_iter().map(option).collect();
    Cow::Owned(text.replace(MASK_SOURCES, &options).into_bytes())
}

/// Where the page lists the mask sources.
const MASK_SOURCES: &str = "<!-- mask sources -->";

/// The modules of the page's script.
pub const MODULES: [PageFile; 33] = modules![
    "address.js",
    "app.js",
    "appearance.js",
    "camera.js",
    "compare.js",
    "dialog.js",
    "dom.js",
    "edits.js",
    "frame.js",
    "gizmo.js",
    "help.js",
    "input.js",
    "jobs.js",
    "listeners.js",
    "operations.js",
    "panels.js",
    "path.js",
    "picture.js",
    "playback.js",
    "plot-scale.js",
    "plot.js",
    "projection.js",
    "segment-row.js",
    "segments.js",
    "selection.js",
    "share.js",
    "socket.js",
    "state.js",
    "time.js",
    "tracks.js",
    "training.js",
    "units.js",
    "view-text.js",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small() {
        let bytes: usize = FILES.iter().chain(&MODULES).map(|f| f.bytes.len()).sum();
        assert!(bytes <= 250_000, "{bytes} bytes");
    }

    #[test]
    fn the_page_lists_the_mask_sources() {
        let page = String::from_utf8(filled(&FILES[0]).into_owned()).unwrap();
        assert!(page.contains("<option value=\"labels\">labels</option>") && !page.contains(MASK_SOURCES));
    }

    #[test]
    fn every_imported_module_is_listed() {
        for file in MODULES {
            let text = std::str::from_utf8(file.bytes).unwrap();
            for line in text.lines().filter(|l| l.starts_with("import ")) {
                let from = line.rsplit("\"./").next().unwrap().trim_end_matches("\";");
                assert!(MODULES.iter().any(|m| m.path[1..] == *from), "{}: {line}", file.path);
            }
        }
    }
}
