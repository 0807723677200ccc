// Keys and mouse habits, on request.
import { $, typing } from "./state.js";

export const helping = () => $("help").open;
const open = () => $("help").showModal();
$("help-open").onclick = open;
$("help-close").onclick = () => $("help").close();

document.addEventListener("keydown", (e) => {
  if (e.key === "?" && !typing() && !helping()) open();
});
