// Questions to the user, in a dialog.
import { $ } from "./dom.js";

const dialog = $("question");

/** Resolves the last question. @type {(answer: string | null) => void} */
let answer = () => {};
/** @param {string | null} text */
const answered = (text) => {
  const last = answer;
  answer = () => {};
  last(text);
};

/**
 * Asks; resolves to the entered name, to "" if no name is requested, or to null if the user declines.
 * @param {string} text
 * @param {{ button: string, name?: boolean }} options
 * @returns {Promise<string | null>}
 */
export function question(text, { button, name = false }) {
  answered(null);
  $("question-text").textContent = text;
  $("question-yes").textContent = button;
  $("question-row").hidden = !name;
  Object.assign($("question-name"), { value: "", required: name, disabled: !name });
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((resolve) => { answer = resolve; });
}
// this event comes late: the next question may be open by then
dialog.onclose = () => {
  if (!dialog.open) answered(dialog.returnValue === "yes" ? $("question-name").value.trim() : null);
};
$("question-form").onsubmit = (e) => {
  e.preventDefault();
  dialog.close("yes");
};
$("question-no").onclick = () => dialog.close("no");
