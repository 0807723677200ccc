// The websocket: sends messages and passes answers to their listeners.
import { say } from "./dom.js";
import { Listeners } from "./listeners.js";
import { app } from "./state.js";
/** @import { Answer, Change, Request, Task } from "./protocol" */
/** @import { Messages, Replies, Unnumbered } from "./types" */

/** @type {WebSocket | undefined} */
let socket;
let number = 0;
/** @type {string | null} */
let ended = null; // the last message of a viewer that has ended
/** @type {Map<number, { resolve: (answer: any) => void, reject: (message: string) => void }>} */
const waiting = new Map();
/** @type {Listeners<Messages>} */
const listeners = new Listeners();

/**
 * Calls the listener for every message of this type; frames have the type "frame". Returns a function that ends this.
 * @template {keyof Messages} T
 * @param {T} type
 * @param {(message: Messages[T]) => void} listener
 */
export const hear = (type, listener) => listeners.on(type, listener);

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
  socket.onmessage = ({ data }) => (typeof data === "string" ? receive(JSON.parse(data)) : listeners.emit("frame", data));
  socket.onopen = () => { opened = true; };
  socket.onclose = async () => {
    listeners.emit("closed", undefined);
    for (const { reject } of waiting.values()) reject("The viewer does not answer.");
    waiting.clear();
    if (ended) return say(ended);
    say((!opened && await misled()) || "The viewer does not answer; trying again …", true);
    setTimeout(connect, 1000);
  };
}

/** Sends a message; returns whether it could be sent. @param {Request} message */
export function send(message) {
  if (socket?.readyState !== 1) return false;
  socket.send(JSON.stringify(message));
  return true;
}

/**
 * Sends a request; resolves to the answer or rejects with its error message.
 * @template {keyof Replies} T
 * @param {Unnumbered<T>} message
 * @returns {Promise<Replies[T]>}
 */
export function ask(message) {
  const id = ++number;
  return new Promise((resolve, reject) => {
    waiting.set(id, { resolve, reject });
    if (send(/** @type {any} */ ({ ...message, id }))) return;
    waiting.delete(id);
    reject("The viewer does not answer.");
  });
}

/**
 * Sends a request; resolves to the answer, or shows its error message and resolves to nothing.
 * @template {keyof Replies} T
 * @param {Unnumbered<T>} message
 * @returns {Promise<Replies[T] | void>}
 */
export const attempt = (message) => ask(message).catch((error) => say(error, true));

/** Resolves a request whose answer came as a frame. @param {number} id */
export function answered(id) {
  waiting.get(id)?.resolve(undefined);
  waiting.delete(id);
}

/** Requests a change of the document as this page knows it. @param {Change} change */
export const change = (change) => attempt({ type: "change", base: app.doc.revision, change });

/**
 * Starts long work on the document as this page knows it; without a task, something was missing, which was reported.
 * @param {Task | null} task
 */
export const start = (task) => task && attempt({ type: "job", base: app.doc.revision, task });

hear("ended", ({ message }) => { ended = message; });

/** @param {Answer} message */
function receive(message) {
  const id = "id" in message ? message.id : null;
  const asked = id === null ? undefined : waiting.get(id);
  if (id !== null) waiting.delete(id);
  if (message.type === "error") return asked ? asked.reject(message.message) : say(message.message, true);
  listeners.emit(message.type, /** @type {any} */ (message));
  asked?.resolve(message);
}
