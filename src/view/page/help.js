// The list of keys and mouse actions.
import { $, typing } from "./dom.js";

/** Whether a dialog is open, which then receives all keys. */
export const asking = () => Boolean(document.querySelector("dialog[open]"));
const open = () => $("help").showModal();
$("help-open").onclick = open;
$("help-close").onclick = () => $("help").close();

document.addEventListener("keydown", (e) => {
  if (e.key === "?" && !typing() && !asking()) open();
});
