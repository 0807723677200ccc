// The parts of the panel, which can be folded; a window keeps them as they were left when it is loaded again.
const KEY = "parts";
const parts = [...document.querySelectorAll("details.part")];
const kept = JSON.parse(sessionStorage.getItem(KEY) ?? "{}");

for (const part of parts) {
  if (part.id in kept) part.open = kept[part.id];
  part.addEventListener("toggle", () => sessionStorage.setItem(KEY, JSON.stringify(Object.fromEntries(parts.map((p) => [p.id, p.open])))));
}

// whether a part was opened or folded before
export const wasLeft = (id) => id in kept;

// shows an element that may be hidden, or in a part that is folded
export function reveal(element) {
  element.hidden = false;
  element.closest("details").open = true;
}
