// The websocket: what is said, and who hears the answers.
import { app, say } from "./state.js";

let socket;
let number = 0;
let ended = null; // what the viewer said before it ended
const waiting = new Map();
const hearers = {};

// who hears texts of a type; frames are of the type "frame"
export const hear = (type, hearer) => { hearers[type] = hearer; };

export function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => (typeof data === "string" ? listen(JSON.parse(data)) : hearers.frame(data));
  socket.onclose = () => {
    hearers.closed?.();
    for (const { reject } of waiting.values()) reject("The viewer does not answer.");
    waiting.clear();
    if (ended) return say(ended);
    say("The viewer does not answer; trying again …", true);
    setTimeout(connect, 1000);
  };
}

// whether it could be sent
export function send(message) {
  if (socket?.readyState !== 1) return false;
  socket.send(JSON.stringify(message));
  return true;
}

// a request that is answered; resolves to the answer or rejects with its message
export function ask(message) {
  const id = ++number;
  return new Promise((resolve, reject) => {
    waiting.set(id, { resolve, reject });
    if (send({ ...message, id })) return;
    waiting.delete(id);
    reject("The viewer does not answer.");
  });
}

// the answer to a request came as a frame
export function answered(id) {
  waiting.get(id)?.resolve();
  waiting.delete(id);
}

// a change of the document as this page knows it
export const change = (what) => ask({ type: "change", base: app.doc.revision, change: what }).catch((e) => say(e, true));

// long work on the document as this page knows it; it may be null if something was missing, which was said
export const start = (task) => task && ask({ type: "job", base: app.doc.revision, task }).catch((e) => say(e, true));

hear("ended", ({ message }) => { ended = message; });

function listen(message) {
  const asked = message.id != null ? waiting.get(message.id) : null;
  waiting.delete(message.id);
  if (message.type === "error") return asked ? asked.reject(message.message) : say(message.message, true);
  hearers[message.type]?.(message);
  asked?.resolve(message);
}
