// The foldable parts of the panel; a window keeps their state when it is reloaded.
const KEY = "parts";
const parts = [...document.querySelectorAll("details.part")];
const kept = JSON.parse(sessionStorage.getItem(KEY) ?? "{}");

for (const part of parts) {
  if (part.id in kept) part.open = kept[part.id];
  part.addEventListener("toggle", () => sessionStorage.setItem(KEY, JSON.stringify(Object.fromEntries(parts.map((p) => [p.id, p.open])))));
}

// whether the state of a part was kept from before
export const wasLeft = (id) => id in kept;

// shows an element, and opens the part that contains it
export function reveal(element) {
  element.hidden = false;
  element.closest("details").open = true;
}
