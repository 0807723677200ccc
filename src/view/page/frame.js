// The header of a frame, as src/view/protocol/frame.rs writes it.
/** @import { FrameHeader } from "./types" */

const HEADER = 32;
/** Kinds of frames: the picture, the one beside it, a requested file, the dataset's image. */
export const KINDS = { picture: 0, other: 1, still: 2, image: 3 };

/** @param {ArrayBuffer} data @returns {FrameHeader} */
export function header(data) {
  const head = new DataView(data);
  return {
    png: head.getUint8(1) === 1,
    kind: head.getUint8(2),
    number: head.getUint32(4, true),
    // exact up to 2^53
    revision: Number(head.getBigUint64(8, true)),
    width: head.getUint16(16, true),
    height: head.getUint16(18, true),
    time: head.getFloat32(20, true),
    ms: [head.getFloat32(24, true), head.getFloat32(28, true)],
  };
}

/** The picture of a frame. @param {ArrayBuffer} data @param {boolean} png */
export const picture = (data, png) => new Blob([new Uint8Array(data, HEADER)], { type: png ? "image/png" : "image/jpeg" });
