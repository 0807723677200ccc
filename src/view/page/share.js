// Saving and sharing: the picture as a file that records its view, a link, a command; and opening such files again.
import { $, make, say } from "./dom.js";
import { restore } from "./address.js";
import { requestView } from "./picture.js";
import { attempt, hear } from "./socket.js";
import { app, emit, on } from "./state.js";
import { savedView, textOf } from "./view-text.js";

/** @param {Blob} bytes @param {string} name */
export function download(bytes, name) {
  const link = make("a", { href: URL.createObjectURL(bytes), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

export function save() {
  requestView(false);
  attempt({ type: "still" });
}
on("still", (bytes) => download(bytes, "volseggs.png"));

/**
 * Copied text stays visible, as some browsers do not let pages write to the clipboard.
 * @param {string} text
 * @param {string} what
 */
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
  emit("rested", undefined);
  copy(location.href, "Link");
};
$("copy-command").onclick = () => {
  requestView(false);
  attempt({ type: "command" });
};

/** @param {File} file */
async function open(file) {
  const found = savedView(await textOf(file).then(JSON.parse).catch(() => null));
  if (!found) return say(`${file.name}: there is no view in it.`, true);
  if ("path" in found) return emit("path", found.path);
  restore(found.view);
  if (found.scene && found.scene !== app.welcome?.scene) say(`${file.name} was saved from another scene, ${found.run}.`);
  else say(`View restored from ${file.name}.`);
}

$("open").onchange = () => {
  const file = $("open").files?.[0];
  if (file) open(file);
  $("open").value = "";
};
addEventListener("dragover", (e) => e.preventDefault());
addEventListener("drop", (e) => {
  e.preventDefault();
  const file = e.dataTransfer?.files[0];
  if (file) open(file);
});
