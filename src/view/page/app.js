// The page: sends the requested view, shows the frames that arrive, and requests changes.
import { $, say } from "./dom.js";
import { fromAddress } from "./address.js";
import { Camera } from "./camera.js";
import { requestViewAgain } from "./picture.js";
import { connect, hear } from "./socket.js";
import { app, emit, setCamera, setWelcome } from "./state.js";
import { describe } from "./training.js";
import "./appearance.js";
import "./compare.js";
import "./edits.js";
import "./gizmo.js";
import "./help.js";
import "./input.js";
import "./jobs.js";
import "./panels.js";
import "./path.js";
import "./segments.js";
import "./tracks.js";

hear("welcome", (message) => {
  setWelcome(message);
  say(message.note ?? "");
  $("run").textContent = message.run;
  describe(message.gaussians, message.step);
  document.title = `${message.run} – volseggs`;
  if (!app.camera) {
    setCamera(new Camera(message.centre, message.radius, message.fov));
    fromAddress();
  }
  emit("welcome", message);
  requestViewAgain();
});

connect();
