//! A simulated slow, distant connection: a proxy that delays the bytes it forwards.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Maximum number of bytes forwarded at a time, as in one network packet.
const PACKET: usize = 1400;

/// Forwards one connection to `port` in both directions, at `rate` bytes per second each way, with every byte delayed
/// by `delay`; returns the port it listens on.
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

/// Forwards bytes from one stream to the other. Little is buffered in between, so a sender that is too fast has to
/// wait, as on a real line with a short queue.
fn pass(mut from: TcpStream, mut to: TcpStream, rate: f64, delay: Duration) {
    let (sender, packets) = channel();
    thread::spawn(move || {
        let mut free = Instant::now();
        let mut part = [0; PACKET];
        while let Ok(n @ 1..) = from.read(&mut part) {
            // the line carries one packet at a time
            free = free.max(Instant::now()) + Duration::from_secs_f64(n as f64 / rate);
            thread::sleep(free.saturating_duration_since(Instant::now()));
            if sender.send((free + delay, part[..n].to_vec())).is_err() {
                break;
            }
        }
    });
    thread::spawn(move || {
        deliver(&packets, &mut to);
        drop(to.shutdown(Shutdown::Both));
    });
}

fn deliver(packets: &Receiver<(Instant, Vec<u8>)>, to: &mut TcpStream) {
    for (at, bytes) in packets {
        thread::sleep(at.saturating_duration_since(Instant::now()));
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
}

/// Pending views, identified by their time, from which the delay of each frame is computed.
#[derive(Default)]
pub struct Lags(VecDeque<(f32, Instant)>);

impl Lags {
    /// Records the request for a view, identified by its time.
    pub fn requested(&mut self, time: f32) {
        self.0.push_back((time, Instant::now()));
    }

    /// Records the arrival of a frame of that time; returns the milliseconds since its request.
    pub fn received(&mut self, time: f32) -> Option<f64> {
        let at = self.0.iter().position(|(t, _)| (t - time).abs() < 1e-6)?;
        let (_, asked) = self.0.drain(..=at).next_back()?;
        Some(1e3 * asked.elapsed().as_secs_f64())
    }
}
