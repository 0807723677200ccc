//! Tests of what is written, read back with small readers of the two formats, and of what is refused.

use super::*;
use crate::volume::directions::Directions;
use crate::volume::series::Series;
use flate2::read::{GzDecoder, ZlibDecoder};
use std::io::Read;

const GRID: Grid = Grid::aligned([70, 80, 60], [0.5, 0.25, 1e-7], [-1.5, 0.0, 2e3]);
const LPS: Option<AxisConvention> = Some(AxisConvention::LeftPosteriorSuperior);

/// Boxes of labels 1 and `high`; label 3 does not occur.
fn example(high: u16) -> (Vec<u16>, Vec<NamedLabel>) {
    let ids = (0..70 * 80 * 60).map(|i| match (i % 70, i / 70 % 80, i / 5600) {
        (10..20, 30..40, 5..9) => 1,
        (0..70, 79, 59) => high,
        _ => 0,
    });
    let label = |value, name: &str| NamedLabel { value, name: name.to_owned(), colour: [1.0, 0.5, 0.0] };
    (ids.collect(), vec![label(1, r"ring \1"), label(3, "a:=b <é>"), label(high, "jet")])
}

fn written(high: u16, name: &str) -> Vec<u8> {
    let (ids, names) = example(high);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    let volume = LabelVolume { grid: GRID, axes: LPS, unit: None, ids: &ids, names: &names, edited: false };
    if name.ends_with("nrrd") {
        write_nrrd(&path, &volume).unwrap();
    } else {
        write_vti(&path, &volume).unwrap();
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    std::fs::read(&path).unwrap()
}

fn split<'a>(bytes: &'a [u8], mark: &[u8]) -> (&'a str, &'a [u8]) {
    let at = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
    (std::str::from_utf8(&bytes[..at]).unwrap(), &bytes[at..])
}

fn numbers(bytes: &[u8], wide: bool) -> Vec<u16> {
    if wide {
        bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    } else {
        bytes.iter().map(|b| u16::from(*b)).collect()
    }
}

#[test]
fn nrrd_holds_the_labels_and_what_slicer_needs() {
    for (high, kind) in [(7, "uint8"), (255, "uint8"), (256, "uint16"), (65_535, "uint16")] {
        let file = written(high, "labels.seg.nrrd");
        let (header, data) = split(&file, b"\n\n");
        let mut bytes = Vec::new();
        GzDecoder::new(data).read_to_end(&mut bytes).unwrap();
        assert_eq!(numbers(&bytes, kind == "uint16"), example(high).0);
        for line in [
            &format!("type: {kind}"),
            "space: left-posterior-superior",
            "sizes: 70 80 60",
            "space directions: (0.5,0,0) (0,0.25,0) (0,0,0.0000001)",
            "space origin: (-1.5,0,2000)",
            "kinds: domain domain domain",
            r"Segment0_Name:=ring \\1",
            "Segment0_LabelValue:=1",
            "Segment0_Extent:=10 19 30 39 5 8",
            "Segment0_Color:=1 0.5 0",
            "Segment1_Name:=a:=b <é>",
            "Segment1_Extent:=0 -1 0 -1 0 -1",
            &format!("Segment2_ID:=Segment_{high}"),
            "Segment2_Extent:=0 69 79 79 59 59",
            &format!("label_{high}:=jet"),
        ] {
            assert!(header.lines().any(|l| l == line), "{line} is not in\n{header}");
        }
        assert!(header.starts_with("NRRD0004\n"));
    }
}

#[test]
fn spaces_directions_and_units_are_stated_where_they_are_known() {
    let (ids, names) = example(2);
    let folder = tempfile::tempdir().unwrap();
    let directions = Directions::of_steps([[0.0, 0.0, -1.0], [0.8, 0.6, 0.0], [-0.6, 0.8, 0.0]]).unwrap().0;
    let grid = Grid { directions, spacing: [2.0, 0.5, 1.0], ..GRID };
    let ras = Some(AxisConvention::RightAnteriorSuperior);
    for (axes, unit, lines) in [
        (ras, Some("mm"), ["space: right-anterior-superior", "space units: \"mm\" \"mm\" \"mm\""]),
        (LPS, Some("a\"b"), ["space: left-posterior-superior", "space units: \"ab\" \"ab\" \"ab\""]),
        (None, None, ["space dimension: 3", "space directions: (0,0,-2) (0.4,0.3,0) (-0.6,0.8,0)"]),
    ] {
        let volume = LabelVolume { grid, axes, unit, ids: &ids, names: &names, edited: false };
        let [nrrd, vti] = ["x.nrrd", "x.vti"].map(|name| folder.path().join(name));
        write_nrrd(&nrrd, &volume).unwrap();
        let bytes = std::fs::read(&nrrd).unwrap();
        let header = split(&bytes, b"\n\n").0;
        assert!(lines.iter().all(|line| header.lines().any(|l| l == *line)), "{header}");
        assert_eq!(header.contains("space units"), unit.is_some());
        write_vti(&vti, &volume).unwrap();
        let bytes = std::fs::read(&vti).unwrap();
        let markup = split(&bytes, b"<AppendedData").0;
        assert!(markup.contains(r#"Direction="0 0.8 -0.6 0 0.6 0.8 -1 0 0""#), "{markup}");
        for path in [nrrd, vti] {
            let series = Series::open(&[path.display().to_string()], &Default::default()).unwrap();
            assert_eq!(series.grid().dims, grid.dims);
            let off = series.grid().steps() - grid.steps();
            assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-12), "{off}");
            if path.extension().is_some_and(|e| e == "nrrd") && unit != Some("a\"b") {
                let physical = series.physical();
                assert_eq!((physical.axes, physical.length_unit.as_deref()), (axes, unit));
            }
        }
    }
}

#[test]
fn vti_holds_the_labels_and_names() {
    for (high, kind) in [(7, "UInt8"), (300, "UInt16")] {
        let file = written(high, "labels.vti");
        let (markup, data) = split(&file, b"<AppendedData encoding=\"raw\">\n   _");
        for part in [
            r#"WholeExtent="0 69 0 79 0 59" Origin="-1.5 0 2000" Spacing="0.5 0.25 0.0000001""#,
            &format!(r#"<DataArray type="{kind}" Name="labels" format="appended" offset="0"/>"#),
            &format!(r#"NumberOfTuples="3" format="ascii">1 3 {high}</DataArray>"#),
            "114 105 110 103 32 92 49 0 97 58 61 98 32 60 195 169 62 0 106 101 116 0<",
        ] {
            assert!(markup.contains(part), "{part} is not in\n{markup}");
        }
        let number = |i: usize| u64::from_le_bytes(data[8 * i..8 * i + 8].try_into().unwrap()) as usize;
        let (blocks, size, last) = (number(0), number(1), number(2));
        let total = 70 * 80 * 60 * if high > 255 { 2 } else { 1 };
        assert_eq!((blocks - 1) * size + if last == 0 { size } else { last }, total);
        let (mut at, mut bytes) = (8 * (3 + blocks), Vec::new());
        for block in 0..blocks {
            ZlibDecoder::new(&data[at..at + number(3 + block)]).read_to_end(&mut bytes).unwrap();
            at += number(3 + block);
        }
        assert_eq!(numbers(&bytes, high > 255), example(high).0);
        assert_eq!(&data[at..], b"\n  </AppendedData>\n</VTKFile>\n");
    }
}

#[test]
fn the_same_volume_is_the_same_file() {
    assert_eq!(written(9, "a.nrrd"), written(9, "b.nrrd"));
    assert_eq!(written(9, "a.vti"), written(9, "b.vti"));
}

#[test]
fn invalid_and_ambiguous_labels_are_refused() {
    let (ids, names) = example(7);
    let folder = tempfile::tempdir().unwrap();
    let refused = |grid: Grid, ids: &[u16], names: &[NamedLabel]| {
        let volume = LabelVolume { grid, axes: LPS, unit: None, ids, names, edited: false };
        let error = write_vti(&folder.path().join("x.vti"), &volume).unwrap_err();
        let other = write_nrrd(&folder.path().join("x.vti"), &volume).unwrap_err();
        assert_eq!(error.to_string(), other.to_string());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        error
    };
    let changed = |change: &dyn Fn(&mut NamedLabel)| {
        let mut names = names.clone();
        change(&mut names[1]);
        refused(GRID, &ids, &names).to_string()
    };
    assert!(matches!(refused(GRID, &ids, &names[..2]), LabelsError::Unnamed { value: 7, .. }));
    assert!(matches!(refused(GRID, &ids[1..], &names), LabelsError::Shape { dims: [70, 80, 60], .. }));
    let empty = Grid { dims: [0, 1, 1], ..GRID };
    assert!(matches!(refused(empty, &[], &names), LabelsError::Shape { .. }));
    let flat = Grid { spacing: [1.0, 0.0, 1.0], ..GRID };
    assert!(matches!(refused(flat, &ids, &names), LabelsError::Field { field, .. } if field == "grid"));
    assert!(changed(&|n| n.value = 0).contains("names[1].value: 0 is not a label"));
    assert!(changed(&|n| n.value = 1).contains("names[1].value: is given twice"));
    assert!(changed(&|n| n.name = "a\nb".into()).contains("names[1].name"));
    assert!(changed(&|n| n.name = "  ".into()).contains("names[1].name"));
    assert!(changed(&|n| n.colour[2] = f32::NAN).contains("names[1].colour"));
    let nowhere = folder.path().join("none").join("x.vti");
    let error = write_vti(
        &nowhere,
        &LabelVolume { grid: GRID, axes: LPS, unit: None, ids: &ids, names: &names, edited: false },
    )
    .unwrap_err();
    assert!(matches!(error, LabelsError::Replace(ReplaceError::NoFolder { .. })));
    let thesis = folder.path().join("thesis.nrrd");
    std::fs::write(&thesis, "a thesis").unwrap();
    let volume = LabelVolume { grid: GRID, axes: LPS, unit: None, ids: &ids, names: &names, edited: false };
    let error = write_nrrd(&thesis, &volume).unwrap_err();
    assert!(matches!(error, LabelsError::Replace(ReplaceError::Foreign { .. })));
    assert_eq!(std::fs::read(&thesis).unwrap(), b"a thesis");
}

#[test]
fn a_file_says_whether_it_holds_edits_and_gives_way_to_the_next() {
    let (ids, names) = example(7);
    let folder = tempfile::tempdir().unwrap();
    let [nrrd, vti] = ["l.seg.nrrd", "l.vti"].map(|name| folder.path().join(name));
    for (edited, key, value) in [(false, "edited:=no", "0"), (true, "edited:=yes", "1")] {
        let volume = LabelVolume { grid: GRID, axes: LPS, unit: None, ids: &ids, names: &names, edited };
        write_nrrd(&nrrd, &volume).unwrap();
        write_vti(&vti, &volume).unwrap();
        let bytes = std::fs::read(&nrrd).unwrap();
        let header = split(&bytes, b"\n\n").0;
        let state = if edited { "with the edits" } else { "as trained" };
        assert!(header.contains("# volseggs") && header.contains(state) && header.contains(key), "{header}");
        let bytes = std::fs::read(&vti).unwrap();
        let markup = split(&bytes, b"<AppendedData").0;
        assert!(markup.contains("<!-- volseggs") && markup.contains(state), "{markup}");
        assert!(markup.contains(&format!(r#"Name="edited" NumberOfTuples="1" format="ascii">{value}<"#)), "{markup}");
        for path in [&nrrd, &vti] {
            let series = [path.display().to_string()];
            let series = Series::open(&series, &Default::default()).unwrap();
            assert_eq!(series.load_labels(0).unwrap().ids, ids, "our own readers skip the comment");
        }
    }
}
