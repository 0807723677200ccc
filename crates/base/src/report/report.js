"use strict";
(() => {
  document.documentElement.classList.add("js");
  const each = (selector, act) => document.querySelectorAll(selector).forEach(act);

  // Tracks the pointer from where it is pressed in `area` until it is released.
  const drag = (area, start, move) => {
    area.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      area.setPointerCapture(event.pointerId);
      start(event);
      move(event);
    });
    area.addEventListener("pointermove", (event) => {
      if (area.hasPointerCapture(event.pointerId)) move(event);
    });
  };

  each(".compare", (box) => {
    const slider = box.querySelector("input");
    const show = () => box.style.setProperty("--at", slider.value + "%");
    slider.step = "0.5";
    slider.addEventListener("input", show);
    drag(box, () => slider.focus({ preventScroll: true }), (event) => {
      const area = box.getBoundingClientRect();
      slider.value = ((event.clientX - area.left) / area.width) * 100;
      show();
    });
    show();
  });

  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  each(".turntable", (table) => {
    const stage = table.querySelector(".stage");
    const frames = [...stage.children];
    const button = table.querySelector("button");
    const slider = table.querySelector("input");
    const output = table.querySelector("output");
    if (frames.length < 2) return;
    let now = 0;
    let playing = false;
    let visible = true;
    let timer = 0;
    const show = (wanted) => {
      frames[now].classList.remove("on");
      now = ((wanted % frames.length) + frames.length) % frames.length;
      frames[now].classList.add("on");
      slider.value = now;
      output.textContent = frames[now].dataset.label;
      slider.setAttribute("aria-valuetext", frames[now].dataset.label);
    };
    const run = () => {
      clearInterval(timer);
      if (playing && visible) timer = setInterval(() => show(now + 1), 1000 / table.dataset.fps);
    };
    const play = (on) => {
      playing = on;
      button.textContent = on ? "Pause" : "Play";
      run();
    };
    button.addEventListener("click", () => play(!playing));
    slider.addEventListener("input", () => { play(false); show(Number(slider.value)); });
    table.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
      if (!step || event.altKey || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      play(false);
      show(now + step);
    });
    let from = { x: 0, frame: 0 };
    drag(stage, (event) => {
      from = { x: event.clientX, frame: now };
      play(false);
      slider.focus({ preventScroll: true });
    }, (event) => {
      const turns = (event.clientX - from.x) / stage.clientWidth;
      show(from.frame + Math.round(turns * frames.length));
    });
    // A turntable outside the screen does not play.
    new IntersectionObserver((entries) => {
      visible = entries[entries.length - 1].isIntersecting;
      run();
    }).observe(stage);
    calm.addEventListener("change", () => { if (calm.matches) play(false); });
    play(!calm.matches);
  });

  const status = document.getElementById("status");
  const copyBySelection = (code) => {
    getSelection().selectAllChildren(code);
    return document.execCommand("copy");
  };
  each(".commands button", (button) => {
    const code = button.parentElement.querySelector("code");
    button.addEventListener("click", async () => {
      let done = false;
      try {
        await navigator.clipboard.writeText(code.textContent);
        done = true;
      } catch {
        done = copyBySelection(code);
      }
      button.textContent = done ? "Copied" : "Selected";
      status.textContent = done ? "Command copied" : "Copying is not allowed here; the command is selected";
      setTimeout(() => { button.textContent = "Copy"; status.textContent = ""; }, 1800);
    });
  });

  // Marks the section being read in the table of contents.
  const links = [...document.querySelectorAll("nav a")];
  const sections = links.map((link) => document.getElementById(link.hash.slice(1)));
  const mark = () => {
    let current = 0;
    sections.forEach((section, index) => {
      if (section.getBoundingClientRect().top < innerHeight / 3) current = index;
    });
    links.forEach((link, index) => {
      if (index === current) link.setAttribute("aria-current", "true");
      else link.removeAttribute("aria-current");
    });
  };
  addEventListener("scroll", mark, { passive: true });
  mark();
})();
