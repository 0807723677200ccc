//! The files of the page in the browser, which are embedded in the program. Its declarations of types, `tsconfig.json`
//! and `package.json` are for checks and tests only.

use crate::export::exporters::Exporter;

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

/// Where `index.html` lists what can be exported.
const FORMATS: &str = "<select id=\"export-format\">";

/// Returns `index.html` as it is served: with the formats that there are.
#[must_use]
pub fn with_formats(index: &str) -> String {
    let option = |exporter: &Exporter| {
        let content = if exporter.holds_gaussians() { "Gaussians" } else { exporter.labels().map(|_| "labels")? };
        let extension = exporter.extension;
        Some(format!("<option value=\"{extension}\">{content} ({})</option>", extension.to_uppercase()))
    };
    let options: String = Exporter::all().into_iter().filter_map(option).collect();
    index.replacen(FORMATS, &[FORMATS, &options].concat(), 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small() {
        let bytes: usize = FILES.iter().chain(&MODULES).map(|f| f.bytes.len()).sum();
        assert!(bytes <= 250_000, "{bytes} bytes");
    }

    #[test]
    fn the_page_lists_what_can_be_exported() {
        let page = with_formats(std::str::from_utf8(FILES[0].bytes).unwrap());
        let list = page.split(FORMATS).nth(1).unwrap().split("</select>").next().unwrap();
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
