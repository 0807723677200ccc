// The page: sends the requested view, shows the frames that arrive, and requests changes.
import { $, app, say, tell } from "./state.js";
import { Camera } from "./camera.js";
import { connect, hear } from "./socket.js";
import { again } from "./picture.js";
import { fromAddress } from "./address.js";
import "./input.js";
import "./compare.js";
import "./looks.js";
import "./path.js";
import "./parts.js";
import "./segments.js";
import "./edits.js";
import "./gizmo.js";
import "./help.js";
import "./jobs.js";
import "./tracks.js";
import { describe } from "./training.js";

hear("welcome", (message) => {
  app.welcome = message;
  say(message.note ?? "");
  $("run").textContent = message.run;
  describe(message.gaussians, message.step);
  document.title = `${message.run} – volseggs`;
  if (!app.camera) {
    app.camera = new Camera(message.centre, message.radius, message.fov);
    fromAddress();
  }
  tell("welcome", message);
  again();
});

connect();
