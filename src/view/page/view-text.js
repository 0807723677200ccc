// Views as texts: in the address, and in files.
/** @import { OpenedPath, RestoredView, Vec2, Vec3 } from "./types" */

const KEYWORD = "volseggs view";
const HEAD = 1 << 20;
const LONGEST = 64 * 1024;

/** @type {(v: unknown) => v is Vec3} */
const isVec3 = (v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite);
/** @type {(v: unknown) => v is Vec2} */
export const isRange = (v) => Array.isArray(v) && v.length === 2 && v.every(Number.isFinite);
/** @param {unknown} v @returns {string[]} */
const names = (v) => (Array.isArray(v) ? v.filter((name) => typeof name === "string") : []);

/**
 * A view in the address, with all digits, so that the picture is bit-identical.
 * @param {Omit<RestoredView, "size">} view
 */
export function toHash({ eye, target, up, fov, time, look, palette, alone, hidden, edits, range }) {
  const text = new URLSearchParams({
    eye: eye.join(","), target: target.join(","), up: up.join(","), fov: String(fov), t: String(time), look: String(look),
  });
  if (alone.length) text.set("alone", alone.join(","));
  if ([...hidden].length) text.set("hidden", [...hidden].join(","));
  if (!edits) text.set("edits", "0");
  if (palette) text.set("palette", palette);
  if (range) text.set("range", range.join(","));
  return `#${text}`;
}

/** The view in an address; null if there is none. @param {string} hash @returns {RestoredView | null} */
export function fromHash(hash) {
  const text = new URLSearchParams(hash.slice(1));
  /** @param {string} name */
  const numbers = (name) => (text.get(name) || "x").split(",").map(Number);
  /** @param {string} name */
  const list = (name) => (text.get(name) ?? "").split(",").filter(Boolean);
  const [eye, target, up, fov] = [numbers("eye"), numbers("target"), numbers("up"), Number(text.get("fov"))];
  if (!isVec3(eye) || !isVec3(target) || !isVec3(up) || !(fov > 0)) return null;
  const t = text.get("t");
  return {
    eye, target, up, fov, time: t === null ? NaN : Number(t), look: text.get("look"), palette: text.get("palette"),
    alone: list("alone"), hidden: list("hidden"), edits: text.get("edits") !== "0", range: numbers("range"),
  };
}

/** The text of a view in a PNG, or the whole text of any other file. @param {Blob} file */
export async function textOf(file) {
  const data = new DataView(await file.slice(0, HEAD).arrayBuffer());
  /** @param {number} from @param {number} to */
  const text = (from, to) => new TextDecoder().decode(new Uint8Array(data.buffer, from, to - from));
  if (data.byteLength < 8 || data.getUint32(0) !== 0x89504e47) return file.size <= LONGEST ? file.text() : "";
  for (let at = 8; at + 8 <= data.byteLength;) {
    const [length, kind] = [data.getUint32(at), text(at + 4, at + 8)];
    const [from, to] = [at + 8, at + 8 + length];
    if (kind === "IDAT" || to > data.byteLength) break;
    const keyword = text(from, Math.min(to, from + KEYWORD.length + 1));
    if (kind === "iTXt" && keyword === `${KEYWORD}\0`) return text(from + KEYWORD.length + 5, to);
    at = to + 4;
  }
  return "";
}

/**
 * A view or path that was read from a file, and the run that it was saved from; null if it is neither.
 * @param {any} read
 * @returns {{ path: OpenedPath } | { view: RestoredView, scene?: string, run?: string } | null}
 */
export function savedView(read) {
  if (Array.isArray(read?.keys) && read.view) {
    return { path: { ...read, view: { ...read.view, alone: names(read.view.alone), hidden: names(read.view.hidden) } } };
  }
  const view = read?.view ?? read;
  if (!view || ![view.eye, view.target, view.up].every(isVec3) || !(view.fov > 0)) return null;
  return { view: { ...view, alone: names(view.alone), hidden: names(view.hidden) }, scene: read.scene, run: read.run };
}
