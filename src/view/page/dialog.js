// Questions in a dialog of the page.
import { $ } from "./state.js";

const dialog = $("question");

// asks; resolves to the name that was given, or to "" where none is asked for, and to null if the answer is no
export function question(text, { button, name = false }) {
  $("question-text").textContent = text;
  $("question-yes").textContent = button;
  $("question-row").hidden = !name;
  Object.assign($("question-name"), { value: "", required: name, disabled: !name });
  dialog.returnValue = "no";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.onclose = () => resolve(dialog.returnValue === "yes" ? $("question-name").value.trim() : null);
  });
}
$("question-form").onsubmit = (e) => {
  e.preventDefault();
  dialog.close("yes");
};
$("question-no").onclick = () => dialog.close("no");
