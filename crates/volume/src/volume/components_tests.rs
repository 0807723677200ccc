//! Parts of small volumes drawn here as text: which voxels join, and which part keeps which id.

use super::*;
use proptest::prelude::*;

/// A volume of one slice; `#` is 1, `o` is 0.5, `?` is NaN, anything else 0.
fn slice(rows: &[&str]) -> Volume {
    let grid = Grid::unit([rows[0].len(), rows.len(), 1]);
    let value = |c: char| match c {
        '#' => 1.0,
        'o' => 0.5,
        '?' => f32::NAN,
        _ => 0.0,
    };
    Volume { grid, values: rows.iter().flat_map(|r| r.chars()).map(value).collect() }
}

const ANY: PartOptions = PartOptions { value: 0.5, smallest: 1 };

/// The labels of every step as text, row by row, `.` for none.
fn followed(steps: &[&[&str]], options: PartOptions) -> Vec<String> {
    let volumes: Vec<Volume> = steps.iter().map(|rows| slice(rows)).collect();
    let mut asked = Vec::new();
    let parts = SeriesParts::follow(&volumes[0].grid, volumes.len(), options, |step| {
        asked.push(step);
        Ok(volumes[step].clone())
    })
    .unwrap();
    assert!(asked.into_iter().eq(0..volumes.len()), "each step once, in order");
    // steps can be labelled in any order
    let text = |(step, volume): (usize, &Volume)| -> String {
        let ids = parts.labels(step, volume).ids;
        ids.iter().map(|id| if *id == 0 { '.' } else { char::from_digit(u32::from(*id), 36).unwrap() }).collect()
    };
    let mut out: Vec<String> = volumes.iter().enumerate().rev().map(text).collect();
    out.reverse();
    out
}

#[test]
fn faces_join_and_edges_do_not() {
    let found = followed(&[&["##..", "..##", "#..#"]], ANY);
    // larger ones first, equals by their first voxel
    assert_eq!(found, ["22....113..1"]);
    let mut values = vec![0.0; 27];
    [0, 9, 13, 18, 26].iter().for_each(|i| values[*i] = 1.0);
    // 0, 9 and 18 lie above each other; 13 and 26 touch nothing by a face
    let (numbers, sizes) = parts_of(&values, [3, 3, 3], ANY);
    assert_eq!((sizes, numbers[0], numbers[9], numbers[18], numbers[13], numbers[26]), (vec![3, 1, 1], 1, 1, 1, 2, 3));
    // the end of a row and the start of the next are not neighbours
    assert_eq!(parts_of(&[0.0, 1.0, 1.0, 0.0], [2, 2, 1], ANY).1, [1, 1]);
}

/// Step, id, `>` where it ends and `<` where it begins, and the other's id, 0 for none.
fn changes(steps: &[&[&str]]) -> Vec<String> {
    let volumes: Vec<Volume> = steps.iter().map(|rows| slice(rows)).collect();
    let parts = SeriesParts::follow(&volumes[0].grid, volumes.len(), ANY, |step| Ok(volumes[step].clone())).unwrap();
    let sign = |c: &PartChange| if c.ends { '>' } else { '<' };
    parts.changes().iter().map(|c| format!("{}: {}{}{}", c.step, c.id, sign(c), c.other.unwrap_or(0))).collect()
}

#[test]
fn ends_and_beginnings_name_the_part_merged_into_or_split_from() {
    assert_eq!(changes(&[&["###.##.#"], &["######.#"], &["######.#"], &["###.##.#"]]), ["1: 2>1", "3: 4<1"]);
    // three into one at once; one into two, and one of those into two again
    assert_eq!(changes(&[&["####.##.#"], &["#########"]]), ["1: 2>1", "1: 3>1"]);
    assert_eq!(changes(&[&["#######"], &["##.####"], &["##.#.##"]]), ["1: 2<1", "2: 3<1"]);
    // the second vanishes, the third appears where nothing was
    assert_eq!(changes(&[&["##....#"], &[".##...."], &["..##..#"]]), ["1: 2>0", "2: 3<0"]);
    // of two that a part could have merged into, the one it shares most voxels with
    assert_eq!(changes(&[&["#####.##"], &["###..###"], &["########"]]), ["2: 2>1"]);
}

#[test]
fn a_merge_keeps_the_id_of_the_larger() {
    let found = followed(&[&["###.##.#"], &["######.#"], &["######.#"], &["###.##.#"]], ANY);
    // the second ends with the merge, and what splits from the first later is new
    assert_eq!(found, ["111.22.3", "111111.3", "111111.3", "111.44.3"]);
}

#[test]
fn a_split_gives_the_larger_part_the_old_id() {
    let found = followed(&[&["#######"], &["##.####"], &["##.#.##"]], ANY);
    assert_eq!(found, ["1111111", "22.1111", "22.3.11"]);
}

#[test]
fn parts_that_move_keep_their_id_and_parts_that_jump_do_not() {
    let found = followed(&[&["##....#"], &[".##...."], &["..##..#"]], ANY);
    assert_eq!(found, ["11....2", ".11....", "..11..3"]);
}

#[test]
fn ids_exchange_only_by_overlap() {
    // the small one grows larger than the other: sizes change, ids stay
    let found = followed(&[&["###..#."], &["##..###"], &["#..####"]], ANY);
    assert_eq!(found, ["111..2.", "11..222", "1..2222"]);
    // of two that overlap the same part, the one that shares most voxels keeps its id
    let found = followed(&[&["####.##"], &[".###.##"], &["##.####"]], ANY);
    assert_eq!(found[2], "11.2222");
}

#[test]
fn small_parts_and_non_finite_values_are_skipped() {
    let small = PartOptions { smallest: 3, ..ANY };
    assert_eq!(followed(&[&["##.###.oo#"]], small), ["...111.222"]);
    // NaN is not above any value, and separates its neighbours
    assert_eq!(followed(&[&["##?###"]], ANY), ["22.111"]);
    let all = vec![f32::NAN; 8];
    assert_eq!(parts_of(&all, [2, 2, 2], ANY), (vec![0; 8], Vec::new()));
    let infinite = [f32::INFINITY, f32::NEG_INFINITY];
    assert_eq!(parts_of(&infinite, [2, 1, 1], ANY).0, [1, 0]);
    assert_eq!(parts_of(&[], [0, 3, 2], ANY), (Vec::new(), Vec::new()));
}

#[test]
fn an_empty_step_ends_all_parts_and_a_series_without_parts_is_an_error() {
    assert_eq!(followed(&[&["##"], &[".."], &["##"]], ANY), ["11", "..", "22"]);
    let volume = slice(&["#o."]);
    let follow = |options| SeriesParts::follow(&volume.grid, 2, options, |_| Ok(volume.clone()));
    let error = follow(PartOptions { value: 1.5, smallest: 1 }).unwrap_err().to_string();
    assert!(error.contains("1.5") && error.contains("largest value is 1"), "{error}");
    assert!(matches!(follow(PartOptions { value: f32::NAN, smallest: 1 }), Err(PartsError::None { .. })));
    assert_eq!(follow(ANY).unwrap().count(), 1);
    assert_eq!(follow(ANY).unwrap().labels(9, &volume).ids, [0; 3]);
}

#[test]
fn running_out_of_ids_is_an_error() {
    let dims = [512, 300, 1];
    let grid = Grid::unit(dims);
    let dots = |i: usize| if i % 2 == (i / 512) % 2 { 1.0 } else { 0.0 };
    let load = |_| Ok(Volume { grid, values: (0..grid.len()).map(dots).collect() });
    let error = SeriesParts::follow(&grid, 1, ANY, load).unwrap_err();
    assert!(matches!(error, PartsError::TooMany { step: 0, .. }), "{error}");
}

/// Parts by flood fill, one after another: the slow way.
fn flooded(values: &[f32], dims: [usize; 3], value: f32) -> Vec<Vec<usize>> {
    let mut open: Vec<bool> = values.iter().map(|v| *v >= value).collect();
    let mut out = Vec::new();
    for start in 0..open.len() {
        let (mut part, mut todo) = (Vec::new(), vec![start]);
        while let Some(i) = todo.pop() {
            if !std::mem::take(&mut open[i]) {
                continue;
            }
            part.push(i);
            let at = [i % dims[0], i / dims[0] % dims[1], i / (dims[0] * dims[1])];
            for (a, stride) in [1, dims[0], dims[0] * dims[1]].into_iter().enumerate() {
                todo.extend((at[a] > 0).then(|| i - stride));
                todo.extend((at[a] + 1 < dims[a]).then(|| i + stride));
            }
        }
        part.sort_unstable();
        out.extend((!part.is_empty()).then_some(part));
    }
    out.sort_by_key(|p| (Reverse(p.len()), p[0]));
    out
}

proptest! {
    #[test]
    fn the_same_parts_as_by_flooding(
        dims in prop::array::uniform3(1..7_usize),
        seed in prop::collection::vec(0.0..1.0_f32, 216),
        value in 0.2..0.8_f32,
        smallest in 1..4_usize,
    ) {
        let values = &seed[..dims.iter().product()];
        let (numbers, sizes) = parts_of(values, dims, PartOptions { value, smallest });
        let expected: Vec<Vec<usize>> = flooded(values, dims, value).into_iter().filter(|p| p.len() >= smallest).collect();
        let found: Vec<Vec<usize>> = (1..=sizes.len() as u32)
            .map(|n| (0..numbers.len()).filter(|i| numbers[*i] == n).collect())
            .collect();
        prop_assert_eq!(found, expected);
    }
}

#[test]
fn threads_do_not_matter() {
    let values: Vec<f32> =
        (0..40 * 30 * 20_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 16) as f32 / 65_536.0).collect();
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| parts_of(&values, [40, 30, 20], PartOptions { value: 0.6, smallest: 2 }))
    };
    assert_eq!(with(1), with(3));
}
