// The foldable parts of the panel; a window keeps their state when it is reloaded.
const KEY = "parts";
const parts = [.../** @type {NodeListOf<HTMLDetailsElement>} */ (document.querySelectorAll("details.part"))];
/** @type {Record<string, boolean>} */
const kept = JSON.parse(sessionStorage.getItem(KEY) ?? "{}");

for (const part of parts) {
  if (part.id in kept) part.open = kept[part.id];
  part.addEventListener("toggle", () => sessionStorage.setItem(KEY, JSON.stringify(Object.fromEntries(parts.map((p) => [p.id, p.open])))));
}

/** Whether the state of a part was kept from before. @param {string} id */
export const wasKept = (id) => id in kept;

/** Shows an element, and opens the part that contains it. @param {HTMLElement} element */
export function reveal(element) {
  element.hidden = false;
  const part = element.closest("details");
  if (part) part.open = true;
}
