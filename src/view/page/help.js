// Keys and mouse habits, on request.
import { $ } from "./state.js";

export const helping = () => $("help").open;
const open = () => $("help").showModal();
$("help-open").onclick = open;
$("help-close").onclick = () => $("help").close();

document.addEventListener("keydown", (e) => {
  const typing = /INPUT|SELECT|TEXTAREA/.test(document.activeElement?.tagName) && !/range|checkbox|color/.test(document.activeElement.type);
  if (e.key === "?" && !typing && !helping()) open();
});
