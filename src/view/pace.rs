//! How often and how large frames are drawn for a client: with few frames on their way, smaller ones while the view
//! moves, and the full picture once it is at rest.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Maximum number of frames that a client has not acknowledged yet.
const MAX_AHEAD: usize = 2;
/// Time after the last change of the view from which it counts as at rest.
pub const REST: Duration = Duration::from_millis(150);
/// Approximate maximum time to draw a frame of a moving view, in milliseconds.
const BUDGET_MS: f64 = 33.0;
/// Approximate maximum time for which it keeps the connection busy, in milliseconds, so that a slow connection still
/// carries several frames per second.
const LINE_MS: f64 = 100.0;
/// Number of recent measurements of the connection that count.
const SAMPLES: usize = 4;
/// Sides of a picture of a moving view, as fractions of the full ones.
const LADDER: [f64; 4] = [1.0, 0.75, 0.5, 1.0 / 3.0];
/// Weight of a new measurement.
const NEW_WEIGHT: f64 = 0.3;

/// What is drawn next for a client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NextDrawing {
    /// Nothing, until something happens.
    Wait,
    /// Nothing before this moment.
    WaitUntil(Instant),
    /// A frame of the moving view, its sides this fraction of the full ones.
    Moving(f64),
    /// The full frame, compressed.
    Full,
    /// The full frame, lossless.
    Lossless,
}

/// What has been drawn since the last change of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum DrawnQuality {
    Nothing,
    Reduced,
    Full,
    Lossless,
}

/// The pace of one client.
#[derive(Clone, Debug)]
pub struct Pace {
    /// Number, pixels and time of sending of the frames that were sent and not acknowledged; 0 pixels if a frame is not
    /// used for measurements.
    on_their_way: Vec<(u32, usize, Instant)>,
    /// When the last acknowledgement came.
    heard: Option<Instant>,
    /// Upper bounds of the milliseconds per pixel for which the connection was busy with the last frames.
    line: VecDeque<f64>,
    /// When the view changed last, and whether the client says that more changes follow.
    changed: Instant,
    moving: bool,
    drawn: DrawnQuality,
    /// Smoothed milliseconds per pixel to draw a frame.
    ms_per_pixel: Option<f64>,
}

impl Pace {
    /// Makes the pace of a client that has seen nothing.
    pub fn new(now: Instant) -> Self {
        let (on_their_way, line) = (Vec::new(), VecDeque::new());
        Self {
            on_their_way,
            heard: None,
            line,
            changed: now,
            moving: false,
            drawn: DrawnQuality::Nothing,
            ms_per_pixel: None,
        }
    }

    /// Records that the view changed; `moving` if more changes are to come.
    pub fn changes(&mut self, now: Instant, moving: bool) {
        (self.changed, self.moving, self.drawn) = (now, moving, DrawnQuality::Nothing);
    }

    /// Records that the client drew frame `number` and all before it.
    pub fn acknowledges(&mut self, now: Instant, number: u32) {
        let (arrived, left): (Vec<_>, Vec<_>) = self.on_their_way.iter().partition(|(n, ..)| *n <= number);
        self.on_their_way = left;
        // of two frames on their way together, the second arrives after the first by at least as long as the connection
        // takes for it
        if let ([(_, pixels @ 1.., sent)], Some(heard)) = (&arrived[..], self.heard)
            && heard > *sent
        {
            self.line.push_back(1e3 * (now - heard).as_secs_f64() / *pixels as f64);
            self.line.drain(..self.line.len().saturating_sub(SAMPLES));
        }
        if !arrived.is_empty() {
            self.heard = Some(now);
        }
    }

    /// Records that frame `number` of `pixels` was sent as `next` requested, and took `ms` milliseconds to draw.
    pub fn sent(&mut self, now: Instant, next: NextDrawing, number: u32, pixels: usize, ms: f64) {
        let measures = if next == NextDrawing::Lossless { 0 } else { pixels };
        self.on_their_way.push((number, measures, now));
        self.drawn = match next {
            NextDrawing::Moving(part) if part < 1.0 => DrawnQuality::Reduced,
            NextDrawing::Moving(_) | NextDrawing::Full => DrawnQuality::Full,
            NextDrawing::Lossless => DrawnQuality::Lossless,
            NextDrawing::Wait | NextDrawing::WaitUntil(_) => self.drawn,
        };
        if next != NextDrawing::Lossless {
            let new = ms / pixels.max(1) as f64;
            self.ms_per_pixel = Some(self.ms_per_pixel.map_or(new, |old| (1.0 - NEW_WEIGHT) * old + NEW_WEIGHT * new));
        }
    }

    /// Whether the client has drawn all frames that were sent.
    pub fn keeps_up(&self) -> bool {
        self.on_their_way.is_empty()
    }

    /// Whether the client shows the view at rest, lossless.
    pub fn is_done(&self) -> bool {
        self.keeps_up() && self.drawn == DrawnQuality::Lossless
    }

    /// Returns what to draw now, for a picture of `pixels` at full size.
    pub fn next(&self, now: Instant, pixels: usize) -> NextDrawing {
        if self.on_their_way.len() >= MAX_AHEAD {
            return NextDrawing::Wait;
        }
        let rests_at = self.changed + REST;
        let moves = self.moving && now < rests_at;
        match self.drawn {
            DrawnQuality::Nothing if self.moving => NextDrawing::Moving(self.part(pixels)),
            DrawnQuality::Nothing => NextDrawing::Full,
            DrawnQuality::Reduced | DrawnQuality::Full if moves => NextDrawing::WaitUntil(rests_at),
            DrawnQuality::Reduced => NextDrawing::Full,
            // a client that is behind is not sent the largest kind of frame
            DrawnQuality::Full if !self.on_their_way.is_empty() => NextDrawing::Wait,
            DrawnQuality::Full => NextDrawing::Lossless,
            DrawnQuality::Lossless => NextDrawing::Wait,
        }
    }

    /// The largest fraction of the sides at which a frame keeps to the budgets; full size until something was measured.
    fn part(&self, pixels: usize) -> f64 {
        let Some(ms) = self.ms_per_pixel else { return 1.0 };
        // the median: lower ones are of acknowledgements that were late together, higher ones of an idle connection
        let mut line: Vec<f64> = self.line.iter().copied().collect();
        line.sort_by(f64::total_cmp);
        let line = line.get(line.len().saturating_sub(1) / 2).copied().unwrap_or_default();
        let fits = |part: &f64| {
            let pixels = pixels as f64 * part * part;
            ms * pixels <= BUDGET_MS && line * pixels <= LINE_MS
        };
        LADDER.into_iter().find(fits).unwrap_or(LADDER[LADDER.len() - 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 640_000;

    #[test]
    fn a_client_that_acknowledges_nothing_is_sent_two_frames() {
        let start = Instant::now();
        let mut pace = Pace::new(start);
        let mut sent = 0;
        for number in 0..1000 {
            pace.changes(start, true);
            let next = pace.next(start, PIXELS);
            if next != NextDrawing::Wait {
                pace.sent(start, next, number, PIXELS, 10.0);
                sent += 1;
            }
        }
        assert_eq!((sent, pace.next(start, PIXELS)), (2, NextDrawing::Wait));
        pace.acknowledges(start, 0);
        assert!(matches!(pace.next(start, PIXELS), NextDrawing::Moving(_)), "one more");
    }

    #[test]
    fn a_view_becomes_full_and_lossless_when_it_rests() {
        let start = Instant::now();
        let mut pace = Pace::new(start);
        pace.changes(start, true);
        // a slow machine: the first frame shows that the next must be small
        pace.sent(start, pace.next(start, PIXELS), 0, PIXELS, 200.0);
        pace.acknowledges(start, 0);
        pace.changes(start, true);
        let next = pace.next(start, PIXELS);
        assert_eq!(next, NextDrawing::Moving(1.0 / 3.0));
        pace.sent(start, next, 1, PIXELS / 9, 22.0);
        pace.acknowledges(start, 1);
        assert_eq!(pace.next(start, PIXELS), NextDrawing::WaitUntil(start + REST));
        let later = start + REST;
        assert_eq!(pace.next(later, PIXELS), NextDrawing::Full);
        pace.sent(start, NextDrawing::Full, 2, PIXELS, 200.0);
        assert_eq!(pace.next(later, PIXELS), NextDrawing::Wait, "until the full one has arrived");
        pace.acknowledges(start, 2);
        assert_eq!(pace.next(later, PIXELS), NextDrawing::Lossless);
        pace.sent(start, NextDrawing::Lossless, 3, PIXELS, 260.0);
        assert!(!pace.keeps_up() && !pace.is_done());
        pace.acknowledges(start, 3);
        assert_eq!(pace.next(later, PIXELS), NextDrawing::Wait, "everything is shown");
        assert!(pace.is_done());
    }

    #[test]
    fn a_fast_machine_keeps_the_full_size_and_one_change_is_drawn_in_full_at_once() {
        let start = Instant::now();
        let mut pace = Pace::new(start);
        pace.changes(start, false);
        assert_eq!(pace.next(start, PIXELS), NextDrawing::Full);
        pace.sent(start, NextDrawing::Full, 0, PIXELS, 20.0);
        pace.acknowledges(start, 0);
        pace.changes(start, true);
        assert_eq!(pace.next(start, PIXELS), NextDrawing::Moving(1.0));
    }

    /// Frames per second of a moving view, and the fraction of the sides that they settle at, over a connection with
    /// 100 ms of delay each way that is busy for `ms` with a full frame.
    fn far_away(ms: f64) -> (f64, f64) {
        let start = Instant::now();
        let at = |ms: f64| start + Duration::from_secs_f64(1e-3 * ms);
        let (mut pace, mut now, mut free, mut part) = (Pace::new(start), 0.0_f64, 0.0_f64, 1.0);
        let mut acknowledgements = VecDeque::new();
        for number in 0..200 {
            pace.changes(at(now), true);
            while pace.next(at(now), PIXELS) == NextDrawing::Wait {
                let (when, number) = acknowledgements.pop_front().unwrap();
                now = now.max(when);
                pace.acknowledges(at(now), number);
            }
            let next = pace.next(at(now), PIXELS);
            let NextDrawing::Moving(of) = next else { panic!("{next:?}") };
            part = of;
            now += 10.0;
            free = free.max(now) + ms * part * part;
            acknowledgements.push_back((free + 200.0, number));
            pace.sent(at(now), next, number, (PIXELS as f64 * part * part) as usize, 10.0 * part * part);
        }
        (200.0 / (1e-3 * now), part)
    }

    #[test]
    fn a_slow_connection_gets_smaller_frames_and_enough_of_them() {
        // 10, 40 and 95 kB over 2 Mbit/s
        for (ms, min_part) in [(40.0, 1.0), (160.0, 0.75), (380.0, 0.5)] {
            let (rate, part) = far_away(ms);
            assert!(rate >= 5.0 && part == min_part, "{ms} ms per full frame: {rate} frames/s, {part}");
        }
        let (rate, part) = far_away(1.0);
        assert!(rate > 8.0 && part == 1.0, "the delay alone must not make frames smaller: {rate} {part}");
    }
}
