// Saving and sharing: the picture as a file that records its view, a link, a command; and opening such files again.
import { $, app, make, on, say, tell } from "./state.js";
import { ask, hear } from "./socket.js";
import { look } from "./picture.js";
import { restore } from "./address.js";

const KEYWORD = "volseggs view";
const HEAD = 1 << 20;
const LONGEST = 64 * 1024;

export function download(bytes, name) {
  const link = make("a", { href: URL.createObjectURL(bytes), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

export function save() {
  look(false);
  ask({ type: "still" }).catch((message) => say(message, true));
}
on("still", (bytes) => download(bytes, "volseggs.png"));

// copied text stays visible, as some browsers do not let pages write to the clipboard
async function copy(text, what) {
  $("copied").hidden = false;
  $("copied").value = text;
  try {
    await navigator.clipboard.writeText(text);
    say(`${what}: copied.`);
  } catch {
    $("copied").select();
    say(`${what}: copy it from the field below the buttons.`);
  }
}
hear("command", ({ command }) => copy(command, "Command"));
$("save").onclick = save;
$("copy-link").onclick = () => {
  tell("rested");
  copy(location.href, "Link");
};
$("copy-command").onclick = () => {
  look(false);
  ask({ type: "command" }).catch((message) => say(message, true));
};

// the view text of a PNG, or the whole text of any other file
async function text(file) {
  const data = new DataView(await file.slice(0, HEAD).arrayBuffer());
  const of = (from, to) => new TextDecoder().decode(new Uint8Array(data.buffer, from, to - from));
  if (data.byteLength < 8 || data.getUint32(0) !== 0x89504e47) return file.size <= LONGEST ? file.text() : "";
  for (let at = 8; at + 8 <= data.byteLength;) {
    const [length, kind] = [data.getUint32(at), of(at + 4, at + 8)];
    const [from, to] = [at + 8, at + 8 + length];
    if (kind === "IDAT" || to > data.byteLength) break;
    if (kind === "iTXt" && of(from, Math.min(to, from + KEYWORD.length + 1)) === `${KEYWORD}\0`) return of(from + KEYWORD.length + 5, to);
    at = to + 4;
  }
  return "";
}

const three = (v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite);
const names = (v) => (Array.isArray(v) ? v.filter((name) => typeof name === "string") : []);

export async function open(file) {
  const found = await text(file).then(JSON.parse).catch(() => null);
  if (Array.isArray(found?.keys) && found.view) return tell("path", { ...found, view: { ...found.view, alone: names(found.view.alone), hidden: names(found.view.hidden) } });
  const seen = found?.view ?? found;
  if (!seen || ![seen.eye, seen.target, seen.up].every(three) || !(seen.fov > 0)) return say(`${file.name}: there is no view in it.`, true);
  restore({ ...seen, alone: names(seen.alone), hidden: names(seen.hidden) }, true);
  if (found.scene && found.scene !== app.welcome.scene) say(`${file.name} was saved from another scene, ${found.run}.`);
  else say(`View restored from ${file.name}.`);
}

$("open").onchange = () => {
  if ($("open").files.length) open($("open").files[0]);
  $("open").value = "";
};
addEventListener("dragover", (e) => e.preventDefault());
addEventListener("drop", (e) => {
  e.preventDefault();
  if (e.dataTransfer.files.length) open(e.dataTransfer.files[0]);
});
