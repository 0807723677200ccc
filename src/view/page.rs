//! The files of the page in the browser, which are embedded in the program. Its declarations of types, `tsconfig.json`
//! and `package.json` are for checks and tests only.

use super::jobs::task::mask_sources;
use crate::export::exporters::Exporter;
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

/// Where `index.html` lists the mask sources.
const MASK_SOURCES: &str = "<!-- mask sources -->";
/// Where it lists what can be exported.
const FORMATS: &str = "<!-- formats -->";

/// Returns the bytes of a file as it is sent: `index.html` lists the mask sources and the formats that there are.
pub fn filled(file: &PageFile) -> Cow<'static, [u8]> {
    let text = match std::str::from_utf8(file.bytes) {
        Ok(text) if file.path == "/" => text,
        _ => return Cow::Borrowed(file.bytes),
    };
    // names and extensions consist of letters, digits, `-` and `_`
    let option = |value: &str, words: &str| format!("<option value=\"{value}\">{words}</option>");
    let sources: String = mask_sources().iter().map(|name| option(name, name)).collect();
    let format = |exporter: &Exporter| {
        let content = if exporter.holds_gaussians() { "Gaussians" } else { exporter.labels().map(|_| "labels")? };
        let extension = exporter.extension;
        Some(option(extension, &format!("{content} ({})", extension.to_uppercase())))
    };
    let formats: String = Exporter::all().into_iter().filter_map(format).collect();
    Cow::Owned(text.replace(MASK_SOURCES, &sources).replace(FORMATS, &formats).into_bytes())
}

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
    fn the_page_lists_mask_sources_and_formats() {
        let page = String::from_utf8(filled(&FILES[0]).into_owned()).unwrap();
        assert!(page.contains("<option value=\"labels\">labels</option>") && !page.contains(MASK_SOURCES));
        let list = page.split("<select id=\"export-format\">").nth(1).unwrap().split("</select>").next().unwrap();
        assert!(list.starts_with("<option value=\"ply\">Gaussians (PLY)</option>"), "{list}");
        assert!(list.ends_with("<option value=\"vti\">labels (VTI)</option>"), "{list}");
        assert_eq!(list.matches("<option").count(), 4, "{list}");
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
