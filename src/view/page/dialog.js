// Questions in a dialog of the page.
import { $ } from "./state.js";

const dialog = $("question");

// gives the question that was asked last its answer
let answer = () => {};
const answered = (value) => {
  const last = answer;
  answer = () => {};
  last(value);
};

// asks; resolves to the name that was given, or to "" where none is asked for, and to null if the answer is no
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
// it is told late: the next question may be open by then
dialog.onclose = () => {
  if (!dialog.open) answered(dialog.returnValue === "yes" ? $("question-name").value.trim() : null);
};
$("question-form").onsubmit = (e) => {
  e.preventDefault();
  dialog.close("yes");
};
$("question-no").onclick = () => dialog.close("no");
