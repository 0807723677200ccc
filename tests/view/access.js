// Looks for what keeps people from using the page: a list of faults in words, empty if there are none.
(() => {
  const faults = [];
  const seen = (e) => e.checkVisibility({ visibilityProperty: true, contentVisibilityAuto: true }) && e.getClientRects().length > 0;
  const describe = (e) => `<${e.tagName.toLowerCase()}${e.id ? ` id=${e.id}` : ""}> ${(e.textContent || e.ariaLabel || "").trim().slice(0, 30)}`;

  // a name for everything that can be operated; a placeholder or a title alone is none
  const name = (e) => {
    const by = (e.getAttribute("aria-labelledby") ?? "").split(/\s+/).map((id) => document.getElementById(id)?.textContent ?? "").join(" ");
    const own = e.matches("button, a, summary, [role=button]") ? e.textContent : "";
    return [e.getAttribute("aria-label"), by, ...[...(e.labels ?? [])].map((l) => l.textContent), own].join("").replace(/[^\p{L}\p{N}]/gu, "");
  };
  const operable = [...document.querySelectorAll("button, input, select, textarea, a[href], summary, [tabindex], [role=button], [role=slider]")];
  for (const e of operable) if (!name(e)) faults.push(`no name: ${describe(e)}`);
  for (const e of operable) if (e.tabIndex > 0) faults.push(`positive tabindex: ${describe(e)}`);
  for (const e of operable) if (seen(e) && !e.disabled && e.tabIndex < 0) faults.push(`not reached by Tab: ${describe(e)}`);
  for (const e of document.querySelectorAll("[role=slider]")) if (seen(e) && !e.hasAttribute("aria-valuenow")) faults.push(`no value: ${describe(e)}`);
  const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
  for (const id of new Set(ids.filter((id, k) => ids.indexOf(id) !== k))) faults.push(`duplicate id: ${id}`);
  for (const of of ["for", "aria-labelledby", "aria-describedby", "aria-controls"]) {
    for (const e of document.querySelectorAll(`[${of}]`)) {
      for (const id of e.getAttribute(of).split(/\s+/)) if (!document.getElementById(id)) faults.push(`${of} refers to nothing: ${describe(e)}`);
    }
  }

  // the page as a whole
  if (document.documentElement.lang !== "en") faults.push("no language");
  if (!document.title) faults.push("no title");
  if (document.querySelectorAll("main").length !== 1) faults.push("not exactly one main landmark");
  if (document.querySelectorAll("h1").length !== 1) faults.push("not exactly one h1");
  for (const e of document.querySelectorAll("aside, section, fieldset, [role=group], dialog")) {
    if (seen(e) && !name(e) && !e.querySelector(":scope > legend")?.textContent) faults.push(`a part without a name: ${describe(e)}`);
  }
  for (const e of document.body.querySelectorAll(":scope > :not(main, aside, header, footer, nav, dialog, script)")) faults.push(`outside every landmark: ${describe(e)}`);
  if (!document.querySelector("[role=status][aria-live=polite], [aria-live=polite]")) faults.push("no live region");

  // text that can be read: a contrast of 4.5, whatever the picture behind it
  const context = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d", { willReadFrequently: true });
  const rgba = (text) => {
    context.clearRect(0, 0, 1, 1);
    context.fillStyle = text;
    context.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = context.getImageData(0, 0, 1, 1).data;
    return [r, g, b, a / 255];
  };
  const over = ([r, g, b, a], below) => [r, g, b].map((v, k) => a * v + (1 - a) * below[k]);
  const light = (c) => c.map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)).reduce((s, v, k) => s + v * [0.2126, 0.7152, 0.0722][k], 0);
  const contrast = (a, b) => { const [x, y] = [light(a), light(b)]; return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05); };
  const probe = document.body.appendChild(document.createElement("i"));
  probe.style.background = "Canvas";
  const paper = rgba(getComputedStyle(probe).backgroundColor).slice(0, 3);
  probe.remove();
  const behind = (e, end) => {
    if (!e) return paper;
    if (e.id === "stage") return end;
    return over(rgba(getComputedStyle(e).backgroundColor), behind(e.parentElement, end));
  };
  for (const e of document.body.querySelectorAll("*")) {
    const words = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    if (!(words || e.matches("input:not([type=range], [type=checkbox], [type=color]), select")) || e.matches("script, option, title") || e.closest("svg, :disabled") || !seen(e)) continue;
    for (const end of [[0, 0, 0], [255, 255, 255]]) {
      const back = behind(e, end), at = contrast(over(rgba(getComputedStyle(e).color), back), back);
      if (at < 4.5) { faults.push(`contrast ${at.toFixed(2)}: ${describe(e)}`); break; }
    }
  }
  return faults;
})()
