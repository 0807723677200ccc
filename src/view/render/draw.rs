//! Drawing what clients want to see.

use super::Renderer;
use crate::export::images::to_rgb8;
use crate::model::ToKernel;
use crate::run::RunError;
use crate::run::look::Look;
use crate::view::client::Client;
use crate::view::compare::{Compare, Side};
use crate::view::encode::OutgoingPicture;
use crate::view::hub::{ClientId, Outgoing};
use crate::view::pace::NextDrawing;
use crate::view::protocol::{Answer, Codec, FrameInfo, FrameKind, View};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// JPEG quality of frames of a moving view, and of one at rest, in percent.
const QUALITY: [u8; 2] = [60, 85];

impl Renderer {
    /// Draws for the next client for which there is something to draw; returns until when there is nothing else to do.
    pub(super) fn draw_next(&mut self) -> Option<Instant> {
        let now = Instant::now();
        let mut until: Option<Instant> = None;
        let after: Vec<ClientId> = self.clients.range(self.last + 1..).map(|(id, _)| *id).collect();
        let before: Vec<ClientId> = self.clients.range(..=self.last).map(|(id, _)| *id).collect();
        for id in after.into_iter().chain(before) {
            let Some(client) = self.clients.get(&id) else { continue };
            let Some(view) = client.view.clone().filter(|_| !client.failed) else { continue };
            match client.pace.next(now, (view.size[0] * view.size[1]) as usize) {
                NextDrawing::Wait => {}
                NextDrawing::WaitUntil(moment) => until = Some(until.map_or(moment, |u| u.min(moment))),
                next => {
                    self.last = id;
                    self.draw(id, &view, next);
                    return Some(now);
                }
            }
        }
        until
    }

    pub(super) fn draw(&mut self, id: ClientId, view: &View, next: NextDrawing) {
        let drawn = catch_unwind(AssertUnwindSafe(|| {
            let drawn = self.frame(id, view, next, Side::Picture)?;
            // sent first, so that a client that acknowledges the picture has received it too
            Ok((drawn, self.beside(id, view, next)))
        }));
        let drawn = drawn.unwrap_or_else(|_| Err(RunError::failure("this view cannot be drawn")));
        let Some(client) = self.clients.get_mut(&id) else { return };
        match drawn {
            Ok((picture, beside)) => {
                let info = picture.info();
                client.frame = info.number;
                let (number, pixels) = (info.number, (info.size[0] * info.size[1]) as usize);
                let ms = f64::from(info.render_ms + beside.as_ref().unwrap_or(&0.0));
                client.pace.sent(Instant::now(), next, number, pixels, ms);
                client.tell_beside(beside.err().map(|e| e.to_string()));
                send(client, picture, self.share.is_some());
                client.tell_legend();
            }
            Err(error) => {
                // not drawn again before it, or what it shows, changes
                client.failed = true;
                client.answer(Answer::Error { id: None, message: error.to_string() });
            }
        }
    }

    /// Sends what the picture is compared with; returns the milliseconds that it took to draw.
    fn beside(&mut self, id: ClientId, view: &View, next: NextDrawing) -> Result<f32, RunError> {
        let Some(client) = self.clients.get_mut(&id) else { return Ok(0.0) };
        let Some(compare) = client.compare else { return Ok(0.0) };
        let sent = match (compare, compare.other(view, client.range())) {
            (_, Some(other)) => self.frame(id, &other, next, compare.side())?,
            (Compare::Image { view: number }, None) if client.image != Some(number) => {
                let image = self.space.shown.run.test_image(number)?;
                client.image = Some(number);
                let info = self.info(FrameKind::Image, number as u32, view.time, 0.0);
                OutgoingPicture::new(info, image, None)
            }
            _ => return Ok(0.0),
        };
        let ms = sent.info().render_ms;
        if let Some(client) = self.clients.get_mut(&id) {
            send(client, sent, self.share.is_some());
        }
        Ok(ms)
    }

    fn frame(&mut self, id: ClientId, view: &View, next: NextDrawing, side: Side) -> Result<OutgoingPicture, RunError> {
        let space = match side.run() {
            Some(run) => &self.others.get(run).ok_or_else(|| RunError::failure("no such run"))?.space,
            None => &self.space,
        };
        let client = self.clients.get_mut(&id).ok_or_else(|| RunError::failure("the client left"))?;
        let (part, quality) = match next {
            NextDrawing::Moving(part) => (part, Some(QUALITY[0])),
            NextDrawing::Full => (1.0, Some(QUALITY[1])),
            _ => (1.0, None),
        };
        let started = Instant::now();
        let camera = view.camera(part);
        let number = client.frame.wrapping_add(1);
        let kind = if side == Side::Picture { FrameKind::Picture } else { FrameKind::Other };
        let dragged = client.preview.is_some() && side == Side::Picture;
        let (look, key) = client.look_of(space, view, side)?;
        let scene = &space.shown.run.scene;
        // colours depend on the scale too, which a look's first frame sets
        let whole = |look: &Look| look.settled().map(|scale| format!("{} {key} {scale}", view.time));
        let known = whole(look).and_then(|key| self.cache.get(&key));
        let prepared = match known {
            Some(prepared) => prepared,
            None => {
                let prepared = look.prepare(scene, view.time as f32)?;
                // the steps of a drag are not shown again
                if let Some(key) = whole(look).filter(|_| !dragged) {
                    self.cache.put(key, prepared.clone());
                }
                prepared
            }
        };
        let key = whole(look).unwrap_or_else(|| format!("{} {key}", view.time));
        let prepared = client.highlighted(&key, prepared, side);
        let (look, _) = client.look_of(space, view, side)?;
        let image = look.draw(scene, &prepared, camera.to_kernel());
        let rgb = to_rgb8(&image, camera.width as usize, camera.height as usize);
        let render_ms = 1e3 * started.elapsed().as_secs_f32();
        Ok(OutgoingPicture::new(self.info(kind, number, view.time, render_ms), rgb, quality))
    }

    fn info(&self, kind: FrameKind, number: u32, time: f64, render_ms: f32) -> FrameInfo {
        // the picture sets codec, size and encoding time
        let (codec, size, encode_ms, revision) = (Codec::Png, [0; 2], 0.0, self.space.revision());
        FrameInfo { kind, codec, number, revision, size, time, render_ms, encode_ms }
    }
}

/// Sends a picture, to be encoded on the way; or encodes it `here`, so that this counts as drawing, which is limited
/// during training.
fn send(client: &mut Client, picture: OutgoingPicture, here: bool) {
    if !here {
        return client.send(Outgoing::Picture(Box::new(picture)));
    }
    match picture.encode() {
        Ok((info, bytes)) => client.send(Outgoing::Frame(info, bytes)),
        Err(error) => client.answer(Answer::Error { id: None, message: error.to_string() }),
    }
}
