//! Statistics, events and tracks as CSV and JSON strings. The caller writes them to files.

use super::events::{Event, TrackPoint};
use super::statistics::SegmentStatistics;
use crate::csv;
use serde::Serialize;
use std::fmt::Write;

/// Columns of [`statistics_csv`].
pub const STATISTICS_COLUMNS: &str = "segment,time,gaussians,visible,opacity,centroid_x,centroid_y,centroid_z,\
velocity_x,velocity_y,velocity_z,box_min_x,box_min_y,box_min_z,box_max_x,box_max_y,box_max_z,\
axis1_x,axis1_y,axis1_z,axis2_x,axis2_y,axis2_z,axis3_x,axis3_y,axis3_z,extent_1,extent_2,extent_3,\
volume,volume_cell,colour_r,colour_g,colour_b,projected_area,projected_share";

/// Columns of [`events_csv`]; lists are separated by spaces within their field.
pub const EVENT_COLUMNS: &str = "segment,time_from,time_to,kind,parents,children,parent_weights,child_weights";

/// Columns of [`tracks_csv`].
pub const TRACK_COLUMNS: &str = "segment,time,component,track,weight,lent";

/// Formats statistics as CSV with a header; unknown and non-finite numbers are empty fields. Numbers read back exactly.
pub fn statistics_csv(rows: &[SegmentStatistics]) -> String {
    let mut out = format!("{STATISTICS_COLUMNS}\n");
    for row in rows {
        out.push_str(&csv::field(&row.segment));
        number(&mut out, Some(row.time));
        let _ = write!(out, ",{},{}", row.gaussians, row.visible);
        number(&mut out, Some(row.opacity));
        for place in [row.centroid, row.velocity, row.box_min, row.box_max] {
            triple(&mut out, place);
        }
        for axis in 0..3 {
            triple(&mut out, row.axes.map(|axes| axes[axis]));
        }
        triple(&mut out, row.extents);
        number(&mut out, Some(row.volume));
        number(&mut out, Some(row.volume_cell));
        triple(&mut out, row.colour);
        out.push(',');
        if let Some(area) = row.projected_area {
            let _ = write!(out, "{area}");
        }
        number(&mut out, row.projected_share);
        out.push('\n');
    }
    out
}

/// Formats the events of one segment as CSV with a header.
pub fn events_csv(segment: &str, events: &[Event]) -> String {
    let mut out = format!("{EVENT_COLUMNS}\n");
    for event in events {
        out.push_str(&csv::field(segment));
        number(&mut out, Some(event.time_from));
        number(&mut out, Some(event.time_to));
        let kind = serde_json::to_string(&event.kind).unwrap_or_default();
        let _ = write!(out, ",{}", kind.trim_matches('"'));
        let _ = write!(out, ",{},{}", list(&event.parents), list(&event.children));
        let _ = writeln!(out, ",{},{}", list(&event.parent_weights), list(&event.child_weights));
    }
    out
}

/// Formats the tracks of one segment as CSV with a header.
pub fn tracks_csv(segment: &str, points: &[TrackPoint]) -> String {
    let mut out = format!("{TRACK_COLUMNS}\n");
    for point in points {
        out.push_str(&csv::field(segment));
        number(&mut out, Some(point.time));
        let _ = write!(out, ",{},{}", point.component, point.track);
        number(&mut out, Some(point.weight));
        let _ = writeln!(out, ",{}", point.lent);
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

fn number(out: &mut String, value: Option<f64>) {
    out.push(',');
    if let Some(v) = value.filter(|v| v.is_finite()) {
        let _ = write!(out, "{v}");
    }
}

fn triple(out: &mut String, value: Option<[f64; 3]>) {
    for a in 0..3 {
        number(out, value.map(|v| v[a]));
    }
}

fn list<T: ToString>(values: &[T]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<String>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::events::{EventKind, Tracking};
    use super::*;

    fn statistics() -> SegmentStatistics {
        SegmentStatistics {
            segment: "light \"blue\", 2".into(),
            time: 0.1,
            gaussians: 5,
            visible: 0,
            opacity: f64::NAN,
            centroid: Some([1.0, -2.5, 1e-9]),
            velocity: None,
            box_min: None,
            box_max: None,
            axes: Some([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            extents: None,
            volume: 0.25,
            volume_cell: 0.1,
            colour: None,
            projected_area: Some(12),
            projected_share: None,
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
        assert_eq!((names.len(), values.len()), (36, 36));
        let get = |name: &str| values[names.iter().position(|n| n == name).unwrap()].as_str();
        assert_eq!(get("segment"), "light \"blue\", 2");
        assert_eq!((get("centroid_z"), get("opacity"), get("velocity_x")), ("0.000000001", "", ""));
        assert_eq!((get("projected_area"), get("projected_share")), ("12", ""));
        assert_eq!((get("axis2_y"), get("volume"), get("volume_cell")), ("1", "0.25", "0.1"));
    }

    #[test]
    fn events_and_tracks_have_their_columns() {
        let event = Event {
            time_from: 0.0,
            time_to: 0.5,
            kind: EventKind::SegmentAppear,
            parents: vec![],
            children: vec![2, 3],
            parent_weights: vec![],
            child_weights: vec![1.5, 2.0],
        };
        let csv = events_csv("a,b", std::slice::from_ref(&event));
        assert_eq!(csv.lines().nth(1).unwrap(), "\"a,b\",0,0.5,segment_appear,,2 3,,1.5 2");
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
