// The websocket: sends messages and passes answers to their listeners.
import { app, say } from "./state.js";

let socket;
let number = 0;
let ended = null; // the last message of a viewer that has ended
const waiting = new Map();
const hearers = {};

// sets the listener for messages of a type; frames have the type "frame"
export const hear = (type, hearer) => { hearers[type] = hearer; };

// why a proxy in front of the viewer keeps the socket from opening, if it does: a page is not told
async function misled() {
  const answer = await fetch("/host", { signal: AbortSignal.timeout(5000) }).catch(() => null);
  if (!answer?.ok) return null;
  const host = await answer.text();
  if (host.toLowerCase() === location.host) {
    return "The viewer's page is served, but its websocket is refused. A proxy in front of the viewer must pass on websockets "
      + "(nginx: proxy_http_version 1.1; proxy_set_header Upgrade $http_upgrade; proxy_set_header Connection upgrade;).";
  }
  return `This page is at ${location.host}, but the proxy in front of the viewer calls it ${host}, so the viewer refuses its `
    + "websocket. Let the proxy pass the name on (nginx: proxy_set_header Host $http_host;), and start the viewer with "
    + `--allow-host ${location.hostname}.`;
}

export function connect() {
  let opened = false;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? listen(JSON.parse(data)) : hearers.frame(data));
  socket.onopen = () => { opened = true; };
  socket.onclose = async () => {
    hearers.closed?.();
    for (const { reject } of waiting.values()) reject("The viewer does not answer.");
    waiting.clear();
    if (ended) return say(ended);
    say((!opened && await misled()) || "The viewer does not answer; trying again …", true);
    setTimeout(connect, 1000);
  };
}

// returns whether the message could be sent
export function send(message) {
  if (socket?.readyState !== 1) return false;
  socket.send(JSON.stringify(message));
  return true;
}

// sends a request; resolves to the answer or rejects with its error message
export function ask(message) {
  const id = ++number;
  return new Promise((resolve, reject) => {
    waiting.set(id, { resolve, reject });
    if (send({ ...message, id })) return;
    waiting.delete(id);
    reject("The viewer does not answer.");
  });
}

// resolves a request whose answer came as a frame
export function answered(id) {
  waiting.get(id)?.resolve();
  waiting.delete(id);
}

// requests a change of the document as this page knows it
export const change = (what) => ask({ type: "change", base: app.doc.revision, change: what }).catch((e) => say(e, true));

// starts long work on the document as this page knows it; task is falsy if something was missing, which was reported
export const start = (task) => task && ask({ type: "job", base: app.doc.revision, task }).catch((e) => say(e, true));

hear("ended", ({ message }) => { ended = message; });

function listen(message) {
  const asked = message.id != null ? waiting.get(message.id) : null;
  waiting.delete(message.id);
  if (message.type === "error") return asked ? asked.reject(message.message) : say(message.message, true);
  hearers[message.type]?.(message);
  asked?.resolve(message);
}
