//! A connection as slow as that of somebody far away: a proxy that holds what it passes back.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes that are passed on at a time: a packet's.
const PACKET: usize = 1400;

/// Listens for one connection and passes it on to `port` and back, at `rate` bytes a second either way, each byte `delay`
/// later than it came; gives the port that it listens on.
pub fn proxy(port: u16, rate: f64, delay: Duration) -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let own = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        let (here, _) = listener.accept().unwrap();
        let there = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
        for stream in [&here, &there] {
            stream.set_nodelay(true).unwrap();
        }
        pass(here.try_clone().unwrap(), there.try_clone().unwrap(), rate, delay);
        pass(there, here, rate, delay);
    });
    own
}

/// Passes on what comes from one to the other. So little waits in between that whoever sends too much must wait itself, as on
/// a real line with a short queue.
fn pass(mut from: TcpStream, mut to: TcpStream, rate: f64, delay: Duration) {
    let (tell, told) = channel();
    thread::spawn(move || {
        let mut free = Instant::now();
        let mut part = [0; PACKET];
        while let Ok(n @ 1..) = from.read(&mut part) {
            // the line takes one packet after the other
            free = free.max(Instant::now()) + Duration::from_secs_f64(n as f64 / rate);
            thread::sleep(free.saturating_duration_since(Instant::now()));
            if tell.send((free + delay, part[..n].to_vec())).is_err() {
                break;
            }
        }
    });
    thread::spawn(move || {
        deliver(&told, &mut to);
        drop(to.shutdown(Shutdown::Both));
    });
}

fn deliver(told: &Receiver<(Instant, Vec<u8>)>, to: &mut TcpStream) {
    for (at, bytes) in told {
        thread::sleep(at.saturating_duration_since(Instant::now()));
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
}

/// How much later each frame was than the view that it shows, by the turn of the view.
#[derive(Default)]
pub struct Lags(VecDeque<(f32, Instant)>);

impl Lags {
    /// A view was asked for, known by its time.
    pub fn asked(&mut self, time: f32) {
        self.0.push_back((time, Instant::now()));
    }

    /// A frame of that time came: milliseconds since it was asked for.
    pub fn came(&mut self, time: f32) -> Option<f64> {
        let at = self.0.iter().position(|(t, _)| (t - time).abs() < 1e-6)?;
        let (_, asked) = self.0.drain(..=at).next_back()?;
        Some(1e3 * asked.elapsed().as_secs_f64())
    }
}
