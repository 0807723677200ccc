// Values of controls as operations of edits.
/** @import { Operation, SegmentRow } from "./protocol" */
/** @import { Vec3 } from "./types" */

/** A colour in [0, 1] as a colour input has it. @param {readonly number[]} colour */
export const hex = (colour) => {
  const bytes = colour.map((c) => Math.round(255 * Math.min(1, Math.max(0, c))));
  return `#${bytes.map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
};

/** @param {string} text of a colour input @returns {Operation} */
export const recolour = (text) => {
  const rgb = /** @type {Vec3} */ ([1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255));
  return { recolour: { rgb, keep_shading: true } };
};

/**
 * The edit that leads to an opacity, or null if none is needed: 0 hides, more shows again.
 * @param {Pick<SegmentRow, "hidden" | "opacity">} segment
 * @param {number} wanted
 * @returns {Operation | null}
 */
export function fade({ hidden, opacity }, wanted) {
  if (wanted === 0) return hidden ? null : "hide";
  const factor = wanted / Math.max(opacity, 1e-3);
  if (Math.abs(factor - 1) > 1e-3) return { opacity: { factor, show: hidden } };
  return hidden ? "show" : null;
}
