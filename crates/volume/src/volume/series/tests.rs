//! Series: order, gaps, grids, times, bad voxels, labels, statistics.

use super::*;
use std::fs::write;
use tempfile::TempDir;

pub fn one(folder: &TempDir, name: &str, values: &[f32; 2]) -> String {
    with(folder, name, "2 1 1", "1 1 1", values)
}

fn with(folder: &TempDir, name: &str, sizes: &str, spacings: &str, values: &[f32]) -> String {
    let path = folder.path().join(name);
    let head = format!(
        "NRRD0004\ntype: float\ndimension: {}\nsizes: {sizes}\nspacings: {spacings}\nendian: little\nencoding: raw\n\n",
        sizes.split(' ').count()
    );
    let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    write(&path, [head.as_bytes(), &data].concat()).unwrap();
    path.to_string_lossy().into_owned()
}

pub fn dir() -> TempDir {
    tempfile::tempdir().unwrap()
}

pub fn open(inputs: &[String]) -> Result<Series, VolumeError> {
    Series::open(inputs, &SeriesOptions::default())
}

pub fn refused(inputs: &[String]) -> String {
    open(inputs).map(|s| s.len()).unwrap_err().to_string()
}

pub fn here(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).to_string_lossy().into_owned()
}

#[test]
fn folder_and_pattern_in_natural_order() {
    let d = dir();
    for k in [10, 9, 8, 11] {
        one(&d, &format!("t{k}.nrrd"), &[k as f32, 0.0]);
    }
    write(d.path().join("notes.txt"), "not a volume").unwrap();
    write(d.path().join("._t8.nrrd"), "hidden").unwrap();
    for input in [here(&d, ""), here(&d, "t*.nrrd")] {
        let s = open(&[input]).unwrap();
        assert_eq!((0..4).map(|k| s.name(k)).collect::<Vec<_>>(), ["t8.nrrd", "t9.nrrd", "t10.nrrd", "t11.nrrd"]);
        assert_eq!((0..4).map(|k| s.load(k).unwrap().values[0]).collect::<Vec<_>>(), [8.0, 9.0, 10.0, 11.0]);
        assert_eq!((s.len(), s.time(0), s.time(3), s.time(1)), (4, 0.0, 1.0, 1.0 / 3.0));
        assert_eq!((s.scalar(), s.grid().dims), (ScalarType::F32, [2, 1, 1]));
        assert!(s.load(4).is_err());
        assert!(s.name(4).is_empty() && s.time(4).is_nan());
    }
}

#[test]
fn inputs_that_name_nothing() {
    let d = dir();
    assert!(refused(&[]).contains("no volume file is named"));
    assert!(refused(&[here(&d, "")]).contains("holds no volume file"));
    assert!(refused(&[here(&d, "t*.nrrd")]).contains("matches no file"));
    assert!(refused(&[here(&d, "[.nrrd")]).contains("pattern"));
    assert!(refused(&[here(&d, "t1.nrrd")]).contains("cannot open"));
    let a = one(&d, "a.nrrd", &[1.0, 2.0]);
    assert!(refused(&[a.clone(), here(&d, "./a.nrrd")]).contains("same file"));
}

#[test]
fn a_file_whose_name_is_a_pattern_is_a_file() {
    let d = dir();
    let p = one(&d, "a[1].nrrd", &[1.0, 2.0]);
    assert_eq!(open(&[p]).unwrap().name(0), "a[1].nrrd");
}

#[test]
fn unsorted_lists_are_refused() {
    let d = dir();
    let t = [1, 2, 10].map(|k| one(&d, &format!("run7_t{k}.nrrd"), &[0.0, 1.0]));
    let message = refused(&[t[0].clone(), t[2].clone(), t[1].clone()]);
    assert!(message.contains("unsorted: its number 2 follows 10"), "{message}");
    let other = one(&d, "b_1.nrrd", &[0.0, 1.0]);
    assert!(refused(&[t[0].clone(), other]).contains("unsorted"));
    let plain = ["b.nrrd", "a.nrrd"].map(|n| one(&d, n, &[0.0, 1.0]));
    assert_eq!(open(&plain).unwrap().name(0), "b.nrrd", "names without numbers keep the order given");
}

#[test]
fn unpadded_steps_after_a_constant_number_are_in_order() {
    let d = dir();
    for k in [12, 15, 18, 3, 6, 9] {
        one(&d, &format!("f128.{k}.nrrd"), &[k as f32, 0.0]);
    }
    for input in [here(&d, ""), here(&d, "f*.nrrd")] {
        let s = open(&[input]).unwrap();
        let values: Vec<f32> = (0..s.len()).map(|k| s.load(k).unwrap().values[0]).collect();
        assert_eq!(values, [3.0, 6.0, 9.0, 12.0, 15.0, 18.0]);
    }
}

#[test]
fn names_of_unclear_order_are_refused_unless_listed_with_times() {
    let d = dir();
    let files = [1, 2, 3, 11, 12].map(|k| one(&d, &format!("sim1.{k}.nrrd"), &[k as f32, 0.0]));
    let times = SeriesOptions { times: Some(vec![1.0, 2.0, 3.0, 11.0, 12.0]), ..Default::default() };
    let gaps = SeriesOptions { allow_gaps: true, ..Default::default() };
    for (inputs, options) in
        [(&[here(&d, "")][..], &SeriesOptions::default()), (&[here(&d, "")], &times), (&[here(&d, "sim*")], &gaps)]
    {
        let message = Series::open(inputs, options).map(|s| s.len()).unwrap_err().to_string();
        assert!(message.contains("the order is unclear") && message.contains("--time-values"), "{message}");
        assert!(message.contains("sim1.3.nrrd comes after") && message.contains("sim1.11.nrrd"), "{message}");
    }
    // a list tells which they are
    assert!(refused(&files).contains("sim1.4.nrrd: inputs: this step is missing"), "{}", refused(&files));
    let decimal = [0, 3, 4, 1, 2].map(|i| files[i].clone());
    for list in [&files, &decimal] {
        let s = Series::open(list, &gaps).unwrap();
        assert!((0..5).all(|k| list[k].ends_with(&s.name(k))));
    }
    let neither = [0, 4, 3, 1, 2].map(|i| files[i].clone());
    assert!(refused(&neither).contains("the order is unclear"));
    let s = Series::open(&files, &times).unwrap();
    assert_eq!((s.name(2), s.name(3), s.time(3)), ("sim1.3.nrrd".into(), "sim1.11.nrrd".into(), 10.0 / 11.0));
}

#[test]
fn files_listed_with_times_keep_the_order_given() {
    let d = dir();
    let files = ["t3", "t1", "t2"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    assert!(refused(&files).contains("unsorted"));
    let times = SeriesOptions { times: Some(vec![0.0, 1.0, 2.0]), ..Default::default() };
    let s = Series::open(&files, &times).unwrap();
    assert_eq!([0, 1, 2].map(|k| s.name(k)), ["t3.nrrd", "t1.nrrd", "t2.nrrd"]);
    // a folder among the inputs is sorted by its names, which must then go on from those before
    std::fs::create_dir(d.path().join("more")).unwrap();
    for name in ["more/t1.nrrd", "more/t2.nrrd"] {
        one(&d, name, &[0.0, 1.0]);
    }
    let mixed = [files[0].clone(), here(&d, "more")];
    assert!(Series::open(&mixed, &times).unwrap_err().to_string().contains("unsorted"));
}

#[test]
fn missing_steps_are_named() {
    let d = dir();
    let files = ["t008", "t009", "t011", "t012"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    let message = refused(&files);
    assert!(message.contains("t010.nrrd"), "{message}");
    let gaps = SeriesOptions { allow_gaps: true, ..Default::default() };
    let s = Series::open(&files, &gaps).unwrap();
    assert!(s.notes().iter().any(|n| n.contains("evenly spaced")), "{:?}", s.notes());
    let times = SeriesOptions { times: Some(vec![8.0, 9.0, 11.0, 12.0]), ..Default::default() };
    assert_eq!(Series::open(&files, &times).unwrap().time(2), 0.75);
    let strided = ["s9", "s12", "s15"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    assert_eq!(open(&strided).unwrap().len(), 3);
    assert!(refused(&[strided[0].clone(), strided[1].clone(), one(&d, "s18.nrrd", &[0.0; 2])]).contains("s15.nrrd"));
}

#[test]
fn one_folder_for_each_step() {
    let d = dir();
    let files = [2, 3, 5].map(|k| {
        std::fs::create_dir(d.path().join(format!("t{k}"))).unwrap();
        one(&d, &format!("t{k}/density_01.nrrd"), &[0.0, 1.0])
    });
    assert!(refused(&files).contains("t4/density_01.nrrd"), "{}", refused(&files));
    assert_eq!(open(&files[..2]).unwrap().len(), 2);
}

#[test]
fn grids_must_agree() {
    let d = dir();
    let a = one(&d, "a.nrrd", &[0.0, 1.0]);
    let b = with(&d, "b.nrrd", "1 2 1", "1 1 1", &[0.0, 1.0]);
    let message = refused(&[a.clone(), b]);
    assert!(message.contains("a.nrrd") && message.contains("b.nrrd") && message.contains("[1, 2, 1]"), "{message}");
    let c = with(&d, "c.nrrd", "2 1 1", "1 1 1.00001", &[0.0, 1.0]);
    assert!(refused(&[a.clone(), c]).contains("spacing"));
    let near = with(&d, "d.nrrd", "2 1 1", "1 1 1.0000001", &[0.0, 1.0]);
    assert!(open(&[a.clone(), near]).is_ok());
    let four = with(&d, "e.nrrd", "2 1 1 2", "1 1 1 1", &[0.0; 4]);
    assert!(refused(&[a.clone(), four.clone()]).contains("one 4D file alone"));
    assert!(refused(&[four, a]).contains("one 4D file alone"));
}

#[test]
fn one_file_of_many_steps() {
    let d = dir();
    let p = with(&d, "v.nrrd", "2 1 1 3", "1 1 1 1", &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    let s = open(&[p]).unwrap();
    assert_eq!((s.len(), s.name(2)), (3, "v.nrrd[2]".to_owned()));
    assert_eq!(s.load(2).unwrap().values, [4.0, 5.0]);
    assert_eq!(s.range().unwrap(), [0.0, 5.0]);
    assert_eq!(s.notes().len(), 1, "{:?}", s.notes());
}

#[test]
fn files_of_other_types_on_the_same_grid() {
    let d = dir();
    let a = one(&d, "t1.nrrd", &[0.5, 1.0]);
    write(d.path().join("t2.raw"), [7, 8]).unwrap();
    write(d.path().join("t2.toml"), "dims=[2,1,1]\ntype='u8'\norigin=[1,0,0]").unwrap();
    let files = [a, here(&d, "t2.raw")];
    let message = refused(&files);
    for words in ["t1.nrrd", "t2.raw", "[1.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "--ignore-origin"] {
        assert!(message.contains(words), "{words}: {message}");
    }
    let s = Series::open(&files, &SeriesOptions { ignore_origin: true, ..Default::default() }).unwrap();
    assert_eq!(s.load(1).unwrap().values, [7.0, 8.0]);
    assert_eq!(s.load(1).unwrap().grid.origin, [0.0; 3]);
    assert!(s.notes().iter().any(|n| n.contains("scalar type")) && s.notes().iter().any(|n| n.contains("origin")));
}

/// A file of one step with these header lines.
fn lines(folder: &TempDir, name: &str, more: &str) -> String {
    let path = folder.path().join(name);
    let head = format!("NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 1 1\nencoding: raw\n{more}\n\n");
    write(&path, [head.as_bytes(), &[7, 8]].concat()).unwrap();
    path.to_string_lossy().into_owned()
}

#[test]
fn files_of_a_series_agree_in_directions_space_and_unit() {
    let d = dir();
    let place = "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace units: \"mm\" \"mm\" \"mm\"";
    let a = lines(&d, "a.nrrd", place);
    for (name, from, to, words) in [
        ("b.nrrd", "(1,0,0)", "(-1,0,0)", ["directions", "[-1.0, 0.0, 0.0]", "a.nrrd"]),
        ("c.nrrd", "LPS", "RAS", ["space", "right-anterior-superior", "left-posterior-superior"]),
        ("d.nrrd", "\"mm\" \"mm\" \"mm\"", "\"um\" \"um\" \"um\"", ["unit of length", "um", "mm"]),
    ] {
        let message = refused(&[a.clone(), lines(&d, name, &place.replace(from, to))]);
        assert!(words.iter().all(|w| message.contains(w)), "{message}");
    }
    assert!(open(&[a, lines(&d, "e.nrrd", "spacings: 1 1 1")]).is_ok(), "what is not said agrees");
}

#[test]
fn labels_lie_on_a_volume_or_elsewhere() {
    let d = dir();
    let of = |name: &str, more: &str| open(&[lines(&d, name, more)]).unwrap();
    let volume = of("v.nrrd", "space: LPS\nspace directions: (2,0,0) (0,2,0) (0,0,2)\nspace origin: (10,20,30)");
    let on = |labels: &Series| labels.lies_on(volume.grid(), volume.physical().axes);
    // the same in the other convention, or without a word of space
    let same = "space: RAS\nspace directions: (-2,0,0) (0,-2,0) (0,0,2)\nspace origin: (-10,-20,30)";
    for (more, problem) in [
        (same.to_owned(), None),
        ("content: nothing".into(), None),
        (same.replace("(-2,0,0)", "(2,0,0)"), Some("axes that lead to RPS, not to LPS")),
        (same.replace("30", "33"), Some("the first voxel")),
        (same.replace("-10", "-10.5"), None),
        (same.replace("(0,0,2)", "(0,0,3)"), Some("spacing")),
    ] {
        match (on(&of("l.nrrd", &more)), problem) {
            (Ok(()), None) => {}
            (Err(said), Some(problem)) if said.contains(problem) => {}
            (said, problem) => panic!("{more}: {said:?}, {problem:?}"),
        }
    }
}

#[test]
fn times_and_units_are_those_of_the_file_or_the_options() {
    let d = dir();
    let path = d.path().join("t.nrrd");
    let head = "NRRD0004\ntype: uchar\ndimension: 4\nsizes: 2 1 1 3\nencoding: raw\nspacings: 1 1 1 0.5\n\
                axis mins: 0 0 0 2\nunits: \"mm\" \"mm\" \"mm\" \"s\"\n\n";
    write(&path, [head.as_bytes(), &[0; 6]].concat()).unwrap();
    let file = [path.to_string_lossy().into_owned()];
    let known = |s: &Series| (s.time_values().map(<[f64]>::to_vec), s.time_unit().map(str::to_owned));
    let s = open(&file).unwrap();
    assert_eq!(known(&s), (Some(vec![2.0, 2.5, 3.0]), Some("s".into())));
    assert_eq!((s.time(1), s.physical().length_unit.as_deref()), (0.5, Some("mm")));
    let given = SeriesOptions { times: Some(vec![0.0, 1.0, 9.0]), ..Default::default() };
    let s = Series::open(&file, &given).unwrap();
    assert_eq!(known(&s), (given.times.clone(), None), "of no unit");
    let units = SeriesOptions { time_unit: Some("ms".into()), length_unit: Some("um".into()), ..given };
    let s = Series::open(&file, &units).unwrap();
    assert_eq!((known(&s).1.as_deref(), s.physical().length_unit.as_deref()), (Some("ms"), Some("um")));
    assert!(s.notes().iter().any(|n| n.contains("--length-unit um") && n.contains("mm")), "{:?}", s.notes());
    let plain = one(&d, "p.nrrd", &[0.0, 1.0]);
    let units = SeriesOptions { times: None, ..units };
    let message = Series::open(&[plain], &units).map(|s| s.len()).unwrap_err().to_string();
    assert!(message.contains("--time-unit") && message.contains("--time-values"), "{message}");
}

#[test]
fn raw_data_beside_a_detached_header_is_no_volume() {
    let d = dir();
    write(d.path().join("t1.raw"), [7, 8]).unwrap();
    let head = "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 2 1 1\nencoding: raw\ndata file: t1.raw\n";
    write(d.path().join("t1.nhdr"), head).unwrap();
    let s = open(&[here(&d, "")]).unwrap();
    assert_eq!((s.len(), s.load(0).unwrap().values), (1, vec![7.0, 8.0]));
}

#[test]
fn bad_voxels() {
    let d = dir();
    let values = [0.0, 1.0, 2.0, 3.0, f32::NAN, 5.0, f32::INFINITY, f32::NEG_INFINITY];
    let p = [with(&d, "a.nrrd", "2 2 2", "1 1 1", &values)];
    let s = open(&p).unwrap();
    let message = s.load(0).unwrap_err().to_string();
    assert!(message.contains("3 voxels") && message.contains("x=0 y=0 z=1") && message.contains("--nan"), "{message}");
    assert!(s.range().is_err() && s.histogram(0, 4, [0.0, 1.0]).is_err() && s.load_labels(0).is_err());
    let replaced = Series::open(&p, &SeriesOptions { nan_as: Some(-1.0), ..Default::default() }).unwrap();
    assert_eq!(replaced.load(0).unwrap().values, [0.0, 1.0, 2.0, 3.0, -1.0, 5.0, -1.0, -1.0]);
    assert_eq!(replaced.range().unwrap(), [0.0, 5.0]);
    assert!(Series::open(&p, &SeriesOptions { nan_as: Some(f32::NAN), ..Default::default() }).is_err());
}

#[test]
fn replaced_voxels_count_neither_in_the_range_nor_in_the_histogram() {
    let d = dir();
    let options = SeriesOptions { nan_as: Some(-9999.0), ..Default::default() };
    let (nan, infinite) = (f32::NAN, f32::INFINITY);
    let one = with(&d, "one.nrrd", "2 2 1", "1 1 1", &[10.0, nan, 21.5, infinite]);
    let many = with(&d, "many.nrrd", "2 1 1 3", "1 1 1 1", &[nan, 10.0, 21.5, nan, 12.0, -infinite]);
    for (file, not_finite) in [(one, 2), (many, 3)] {
        let s = Series::open(&[file], &options).unwrap();
        assert_eq!(s.range().unwrap(), [10.0, 21.5]);
        assert_eq!(s.scan().unwrap(), SeriesScan { range: Some([10.0, 21.5]), not_finite });
        assert_eq!(s.histogram(0, 1, [-9999.0, f32::INFINITY]).unwrap()[0], if not_finite == 2 { 2 } else { 1 });
        assert!(s.load(0).unwrap().values.contains(&-9999.0));
    }
    let none = Series::open(&[with(&d, "none.nrrd", "2 1 1", "1 1 1", &[nan, infinite])], &options).unwrap();
    assert_eq!(none.scan().unwrap(), SeriesScan { range: None, not_finite: 2 });
    let message = none.range().unwrap_err().to_string();
    assert!(message.contains("none.nrrd") && message.contains("no voxel of any step is finite"), "{message}");
}

#[test]
fn labels_are_whole_numbers() {
    let d = dir();
    assert_eq!(open(&[one(&d, "a.nrrd", &[65535.0, 0.0])]).unwrap().load_labels(0).unwrap().ids, [65535, 0]);
    for bad in [0.5, -1.0, 65536.0, f32::NAN] {
        let message = open(&[one(&d, "b.nrrd", &[3.0, bad])]).unwrap().load_labels(0).unwrap_err().to_string();
        assert!(message.contains("x=1 y=0 z=0"), "{message}");
    }
}

#[test]
fn times_must_fit_and_increase() {
    let d = dir();
    let files = ["t1", "t2", "t3"].map(|n| one(&d, &format!("{n}.nrrd"), &[0.0, 1.0]));
    let with = |t: &[f64]| Series::open(&files, &SeriesOptions { times: Some(t.to_vec()), ..Default::default() });
    for bad in [vec![1.0, 2.0], vec![1.0, 1.0, 2.0], vec![1.0, f64::NAN, 2.0], vec![0.0, 1.0, f64::INFINITY]] {
        assert!(with(&bad).unwrap_err().to_string().contains("time"), "{bad:?}");
    }
    for (good, middle) in [([-2.0, 0.0, 6.0], 0.25), ([-f64::MAX, 0.0, f64::MAX], 0.5)] {
        let s = with(&good).unwrap();
        assert_eq!((s.time(0), s.time(1), s.time(2)), (0.0, middle, 1.0));
    }
    assert_eq!(open(&files[..1]).unwrap().time(0), 0.0);
}

#[test]
fn histogram_counts() {
    let d = dir();
    let s = open(&[with(&d, "a.nrrd", "6 1 1", "1 1 1", &[-1.0, 0.0, 0.4, 0.5, 1.0, 1.5])]).unwrap();
    assert_eq!(s.histogram(0, 2, [0.0, 1.0]).unwrap(), [2, 2]);
    assert_eq!(s.histogram(0, 3, [0.5, 0.5]).unwrap(), [1, 0, 0]);
    assert_eq!(s.histogram(0, 1, [1.0, 0.0]).unwrap(), [0]);
    assert!(s.histogram(0, 0, [0.0, 1.0]).unwrap().is_empty());
}

#[test]
fn range_is_read_once_and_a_changed_file_is_noticed() {
    let d = dir();
    let files = ["t1", "t2"].map(|n| one(&d, &format!("{n}.nrrd"), &[-0.0, 1.0]));
    let s = open(&files).unwrap();
    assert_eq!(s.range().unwrap()[0].to_bits(), 0);
    with(&d, "t2.nrrd", "1 2 1", "1 1 1", &[5.0, 6.0]);
    s.load(0).unwrap();
    assert!(s.load(1).unwrap_err().to_string().contains("changed since"));
    assert_eq!(s.range().unwrap(), [0.0, 1.0], "cached");
}

#[test]
fn a_thousand_files_need_few_handles() {
    let d = dir();
    for k in 0..1500 {
        one(&d, &format!("t{k}.nrrd"), &[k as f32, 0.0]);
    }
    let s = open(&[here(&d, "")]).unwrap();
    assert_eq!(s.range().unwrap(), [0.0, 1499.0]);
}

#[test]
fn values_beyond_single_precision_are_reported() {
    let d = dir();
    let path = d.path().join("wide.nrrd");
    let head = "NRRD0004\ntype: double\ndimension: 3\nsizes: 2 1 1\nendian: little\nencoding: raw\n\n";
    for (value, words) in
        [(1e300f64, "too large for single precision (at most 3.4e38)"), (f64::NAN, "the first is NaN")]
    {
        let data: Vec<u8> = [1.0, value].iter().flat_map(|v: &f64| v.to_le_bytes()).collect();
        write(&path, [head.as_bytes(), &data].concat()).unwrap();
        let message = open(&[here(&d, "wide.nrrd")]).unwrap().load(0).unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("x=1 y=0 z=0"), "{message}");
    }
}

#[test]
fn spacings_out_of_range_are_refused() {
    let d = dir();
    for spacings in ["1e-320 1 1", "1 1e300 1", "1 1 0"] {
        let message = refused(&[with(&d, "s.nrrd", "2 2 1", spacings, &[0.0; 4])]);
        assert!(message.contains("spacings") && message.contains("not a valid spacing"), "{message}");
    }
}
