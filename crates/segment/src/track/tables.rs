//! Statistics, events and tracks as CSV and JSON strings. The caller writes them to files.

use super::events::{SegmentEvent, TrackPoint};
use super::statistics::SegmentStatistics;
use crate::csv;
use crate::data::Calibration;
use crate::data::calibration::NORMALISED;
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;

/// What a column is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Words, counts, shares and directions.
    None,
    /// Time as a fraction of the series.
    Normalised,
    /// The data's unit of time.
    Time,
    /// The data's unit of length.
    Length,
    /// Its square.
    Area,
    /// Its cube.
    Volume,
    /// Length per time.
    Speed,
    /// Pixels of a picture.
    Pixels,
}

impl Unit {
    /// The unit in words, such as `mm^3`; `normalised` where the data name none.
    pub fn name(self, calibration: &Calibration) -> String {
        let (length, time) = (calibration.length_unit(), calibration.time_unit());
        let part = |unit: &str| if unit.contains(' ') { format!("({unit})") } else { unit.to_owned() };
        match self {
            Self::None => String::new(),
            Self::Normalised => NORMALISED.to_owned(),
            Self::Time => time.to_owned(),
            Self::Length => length.to_owned(),
            Self::Area | Self::Volume if length == NORMALISED => NORMALISED.to_owned(),
            Self::Area => format!("{}^2", part(length)),
            Self::Volume => format!("{}^3", part(length)),
            Self::Speed if length == NORMALISED && time == NORMALISED => NORMALISED.to_owned(),
            Self::Speed => format!("{}/{}", part(length), part(time)),
            Self::Pixels => "pixels".to_owned(),
        }
    }
}

/// A column of [`statistics_csv`].
#[derive(Clone, Copy, Debug)]
pub struct StatisticsColumn {
    /// Its name, also of the entry in `statistics.json`; with `_x`, `_y`, `_z` for the three entries of a position.
    pub name: &'static str,
    /// What it is measured in.
    pub unit: Unit,
    /// What it is, in words.
    pub meaning: &'static str,
    /// Its fields.
    fields: &'static [&'static str],
}

impl StatisticsColumn {
    /// Returns its fields in a row with these entries of `statistics.json`.
    fn cells(&self, entries: &Value) -> Vec<String> {
        let value = match self.name {
            "axis1" => &entries["axes"][0],
            "axis2" => &entries["axes"][1],
            "axis3" => &entries["axes"][2],
            "extent" => &entries["extents"],
            name => &entries[name],
        };
        match self.fields {
            [_] => vec![cell(value)],
            fields => (0..fields.len()).map(|k| cell(&value[k])).collect(),
        }
    }
}

const fn column(name: &'static str, unit: Unit, meaning: &'static str) -> StatisticsColumn {
    StatisticsColumn { name, unit, meaning, fields: &[""] }
}

const fn columns(
    name: &'static str,
    unit: Unit,
    fields: &'static [&'static str],
    meaning: &'static str,
) -> StatisticsColumn {
    StatisticsColumn { name, unit, meaning, fields }
}

const XYZ: &[&str] = &["_x", "_y", "_z"];

/// Columns of [`statistics_csv`], in their order.
pub const COLUMNS: &[StatisticsColumn] = &[
    column("segment", Unit::None, "name of the segment"),
    column("time", Unit::Normalised, "time, 0 at the first step and 1 at the last"),
    column("physical_time", Unit::Time, "the same in the data's unit; empty if unknown"),
    column("status", Unit::None, "tracked; weak: less than half of it supports the row; lost: it is nowhere"),
    column("counted_share", Unit::None, "share of its content whose Gaussians lie in its place"),
    column("consistency", Unit::None, "Dice of its Gaussians and those found in its place, followed back"),
    column("trained_distance", Unit::Time, "distance to the nearest time with training views; empty if unknown"),
    column("gaussians", Unit::None, "its Gaussians"),
    column("visible", Unit::None, "those of an opacity of at least 1/255"),
    column("opacity", Unit::None, "sum of their opacities"),
    column("extinction", Unit::Area, "its content: extinction density summed over space"),
    columns("centroid", Unit::Length, XYZ, "mean of its place weighted by local opacity"),
    columns("velocity", Unit::Speed, XYZ, "slope of a parabola fitted to the centroids around this time"),
    columns("box_min", Unit::Length, XYZ, "lower corner of the box around its place"),
    columns("box_max", Unit::Length, XYZ, "upper corner of that box"),
    columns("axis1", Unit::None, XYZ, "unit vector along the longest principal axis"),
    columns("axis2", Unit::None, XYZ, "unit vector along the second one"),
    columns("axis3", Unit::None, XYZ, "unit vector along the shortest one"),
    columns("extent", Unit::Length, &["_1", "_2", "_3"], "standard deviations of its place along these axes"),
    column("volume", Unit::Volume, "volume of its place"),
    column("hidden_volume", Unit::Volume, "the part of it that no picture shows, inside of opaque surfaces"),
    column("opaque_core_volume", Unit::Volume, "union of the one-sigma ellipsoids of an opacity of at least 0.1"),
    column("cell_size", Unit::Length, "side of the cells that places consist of"),
    columns("colour", Unit::None, &["_r", "_g", "_b"], "mean colour by opacity, 0 to 1"),
    column("projected_area", Unit::Pixels, "pixels that it covers alone in the picture"),
    column("projected_share", Unit::None, "the same as a share of the picture"),
];

/// Columns of [`events_csv`]; lists are separated by spaces within their field.
pub const EVENT_COLUMNS: &str =
    "segment,time_from,time_to,kind,confidence,parents,children,parent_weights,child_weights";

/// Columns of [`tracks_csv`].
pub const TRACK_COLUMNS: &str = "segment,time,component,track,weight,lent";

/// Formats the meaning of the columns of [`statistics_csv`] as CSV: one row each, with its unit in this calibration.
pub fn columns_csv(calibration: &Calibration) -> String {
    let mut out = String::from("column,unit,meaning\n");
    for StatisticsColumn { name, unit, meaning, fields } in COLUMNS {
        for field in *fields {
            let unit = unit.name(calibration);
            let _ = writeln!(out, "{name}{field},{},{}", csv::field(&unit), csv::field(meaning));
        }
    }
    out
}

/// Returns the units of the entries of `statistics.json`, in order, of those that have one.
pub fn units(calibration: &Calibration) -> Vec<(&'static str, String)> {
    let measured = COLUMNS.iter().filter(|c| c.unit != Unit::None);
    measured.map(|c| (c.name, c.unit.name(calibration))).collect()
}

/// Formats statistics as CSV with a header; unknown and non-finite numbers are empty fields. Numbers read back exactly.
pub fn statistics_csv(rows: &[SegmentStatistics]) -> String {
    let names = COLUMNS.iter().flat_map(|c| c.fields.iter().map(move |field| format!("{}{field}", c.name)));
    let mut out = names.collect::<Vec<_>>().join(",") + "\n";
    for row in rows {
        let entries = serde_json::to_value(row).unwrap_or_default();
        let cells: Vec<String> = COLUMNS.iter().flat_map(|column| column.cells(&entries)).collect();
        out += &cells.join(",");
        out.push('\n');
    }
    out
}

/// Formats the events of one segment as CSV with a header.
pub fn events_csv(segment: &str, events: &[SegmentEvent]) -> String {
    rows_csv(EVENT_COLUMNS, segment, events)
}

/// Formats the tracks of one segment as CSV with a header.
pub fn tracks_csv(segment: &str, points: &[TrackPoint]) -> String {
    rows_csv(TRACK_COLUMNS, segment, points)
}

/// Formats what belongs to one segment; the columns after the first are the entries of a row in JSON.
fn rows_csv<T: Serialize>(columns: &str, segment: &str, rows: &[T]) -> String {
    let mut out = format!("{columns}\n");
    for row in rows {
        let entries = serde_json::to_value(row).unwrap_or_default();
        out += &csv::field(segment);
        for name in columns.split(',').skip(1) {
            let _ = write!(out, ",{}", cell(&entries[name]));
        }
        out.push('\n');
    }
    out
}

/// Formats any of the tables as indented JSON that ends in a newline; non-finite numbers become `null`.
///
/// # Errors
/// Errors of the serialiser; the types of this module never cause any.
pub fn to_json<T: Serialize + ?Sized>(value: &T) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(value).map(|text| text + "\n")
}

/// Returns the field of an entry; entries of lists are separated by spaces.
fn cell(entry: &Value) -> String {
    match entry {
        Value::String(text) => csv::field(text).into_owned(),
        Value::Bool(value) => value.to_string(),
        Value::Array(list) => list.iter().map(cell).collect::<Vec<_>>().join(" "),
        number => number.as_f64().map_or_else(String::new, |v| v.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::events::{EventKind, Tracking};
    use super::super::statistics::RowStatus;
    use super::*;
    use crate::data::calibration::{PhysicalSpace, PhysicalTime};

    fn statistics() -> SegmentStatistics {
        SegmentStatistics {
            segment: "light \"blue\", 2".into(),
            time: 0.1,
            status: RowStatus::Lost,
            gaussians: 5,
            opacity: f64::NAN,
            centroid: Some([1.0, -2.5, 1e-9]),
            axes: Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            volume: 0.25,
            cell_size: 0.1,
            projected_area: Some(12),
            ..SegmentStatistics::default()
        }
    }

    /// Splits one CSV line according to RFC 4180.
    fn split(line: &str) -> Vec<String> {
        let (mut fields, mut field, mut quoted) = (Vec::new(), String::new(), false);
        let mut chars = line.chars().peekable();
        while let Some(c) = chars.next() {
            match c {
                '"' if quoted && chars.peek() == Some(&'"') => field.push(chars.next().unwrap()),
                '"' => quoted = !quoted,
                ',' if !quoted => fields.push(std::mem::take(&mut field)),
                c => field.push(c),
            }
        }
        fields.push(field);
        fields
    }

    #[test]
    fn statistics_lines_have_all_columns_and_read_back() {
        let csv = statistics_csv(&[statistics()]);
        let lines: Vec<&str> = csv.lines().collect();
        let (names, values) = (split(lines[0]), split(lines[1]));
        assert_eq!((names.len(), values.len()), (44, 44));
        let get = |name: &str| values[names.iter().position(|n| n == name).unwrap()].as_str();
        assert_eq!(get("segment"), "light \"blue\", 2");
        assert_eq!((get("centroid_z"), get("opacity"), get("velocity_x")), ("0.000000001", "", ""));
        assert_eq!((get("projected_area"), get("projected_share")), ("12", ""));
        assert_eq!((get("axis2_y"), get("volume"), get("cell_size")), ("1", "0.25", "0.1"));
    }

    #[test]
    fn columns_have_the_units_of_the_data_and_are_those_of_the_json() {
        let space = PhysicalSpace { centre: [0.0; 3], scale: 2.0, unit: Some("mm".into()), axes: None };
        let time = PhysicalTime { start: 0.0, end: 5.0, unit: None };
        let calibration = Calibration { space: Some(space), time: Some(time) };
        let csv = columns_csv(&calibration);
        let unit = |csv: &str, name: &str| {
            let line = csv.lines().map(split).find(|fields| fields[0] == name).unwrap();
            line[1].clone()
        };
        let named = ["volume", "centroid_x", "velocity_z", "extinction", "time", "physical_time", "status"];
        let expected = ["mm^3", "mm", "mm/(data time units)", "mm^2", "normalised", "data time units", ""];
        assert_eq!(named.map(|name| unit(&csv, name)), expected.map(String::from));
        let unknown = columns_csv(&Calibration::default());
        assert_eq!(["volume", "velocity_x"].map(|n| unit(&unknown, n)), ["normalised", "normalised"]);
        let header = statistics_csv(&[]);
        let listed: Vec<String> = csv.lines().skip(1).map(|line| split(line)[0].clone()).collect();
        assert_eq!(split(header.trim_end()), listed);
        let json = serde_json::to_value(statistics()).unwrap();
        for (name, _) in units(&calibration) {
            assert!(json.get(name).is_some() || json.get(format!("{name}s")).is_some(), "{name}");
        }
        let reference = include_str!("../../../../docs/reference.md");
        for StatisticsColumn { name, .. } in COLUMNS {
            assert!(reference.contains(&format!("`{name}`")), "docs/reference.md does not explain {name}");
        }
    }

    #[test]
    fn measures_are_in_the_units_of_the_data() {
        let space = PhysicalSpace { centre: [10.0, 0.0, 0.0], scale: 2.0, unit: Some("mm".into()), axes: None };
        let time = PhysicalTime { start: 100.0, end: 105.0, unit: Some("s".into()) };
        let mut row = SegmentStatistics {
            velocity: Some([1.0, 0.0, -1.0]),
            extents: Some([3.0, 2.0, 1.0]),
            extinction: 0.5,
            trained_distance: Some(0.1),
            ..statistics()
        };
        let before = row.clone();
        row.calibrate(&Calibration::default());
        assert_eq!(row.volume, before.volume);
        row.calibrate(&Calibration { space: Some(space), time: Some(time) });
        assert_eq!((row.centroid.unwrap()[0], row.physical_time, row.time), (12.0, Some(100.5), 0.1));
        assert_eq!((row.velocity, row.extents), (Some([0.4, 0.0, -0.4]), Some([6.0, 4.0, 2.0])));
        assert_eq!((row.volume, row.extinction, row.cell_size, row.trained_distance), (2.0, 2.0, 0.2, Some(0.5)));
    }

    #[test]
    fn events_and_tracks_have_their_columns() {
        let event = SegmentEvent {
            time_from: 0.0,
            time_to: 0.5,
            kind: EventKind::SegmentAppear,
            parents: vec![],
            children: vec![2, 3],
            parent_weights: vec![],
            child_weights: vec![1.5, 2.0],
            confidence: 0.75,
        };
        let csv = events_csv("a,b", std::slice::from_ref(&event));
        assert_eq!(csv.lines().nth(1).unwrap(), "\"a,b\",0,0.5,segment_appear,0.75,,2 3,,1.5 2");
        assert_eq!(split(csv.lines().nth(1).unwrap()).len(), split(EVENT_COLUMNS).len());
        let point = TrackPoint { time: 1.0, component: 2, track: 3, weight: 4.5, lent: true };
        assert_eq!(tracks_csv("s", std::slice::from_ref(&point)).lines().nth(1).unwrap(), "s,1,2,3,4.5,true");
        let tracking = Tracking { events: vec![event], points: vec![point] };
        let back: Tracking = serde_json::from_str(&to_json(&tracking).unwrap()).unwrap();
        assert_eq!(back, tracking);
    }

    #[test]
    fn json_has_null_for_what_is_unknown() {
        let json = to_json(&[statistics()]).unwrap();
        assert!(json.contains("\"opacity\": null") && json.contains("\"velocity\": null"));
        assert_eq!((statistics_csv(&[]).lines().count(), tracks_csv("", &[]).lines().count()), (1, 1));
    }
}
