// Looks, and the views along the axes.
import { $, app } from "./state.js";
import { look } from "./picture.js";

// another look has another scale
$("look").onchange = () => { app.range = null; look(false); };
$("reset").onclick = () => { app.camera.reset(); look(false); };
for (const button of document.querySelectorAll("[data-axis]")) {
  button.onclick = () => {
    const { centre, radius } = app.camera.home;
    app.camera.look(centre, button.dataset.axis.split(",").map(Number), radius);
    look(false);
  };
}
