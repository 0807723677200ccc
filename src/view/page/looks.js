// Looks, the views along the axes, and the picture as a file.
import { $, app, make, say } from "./state.js";
import { look } from "./picture.js";

$("look").onchange = () => look(false);
$("reset").onclick = () => { app.camera.reset(); look(false); };
for (const button of document.querySelectorAll("[data-axis]")) {
  button.onclick = () => {
    const { centre, radius } = app.camera.home;
    app.camera.look(centre, button.dataset.axis.split(",").map(Number), radius);
    look(false);
  };
}
export function save() {
  if (!app.last) return say("The picture is not sharp yet; wait a moment.", true);
  const link = make("a", { href: URL.createObjectURL(app.last), download: "volseggs.png" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
$("save").onclick = save;
