// Types of the page itself, beside those of its messages.

import type { Answer, Compare, Document, Edit, Key, Preview, Request, Selected, View } from "./protocol";
export type { Camera } from "./camera.js";
import type { Camera } from "./camera.js";

export type Vec2 = [number, number];
export type Vec3 = [number, number, number];

/** The document of the viewer; `Document` is that of the browser. */
export type SegmentDocument = Document;

export type RequestOf<T extends Request["type"]> = Extract<Request, { type: T }>;
export type AnswerOf<T extends Answer["type"]> = Extract<Answer, { type: T }>;
export type Welcome = AnswerOf<"welcome">;

/** What answers a request; that of `still` comes as a frame. */
export interface Replies {
  pick: AnswerOf<"picked">;
  adjust: AnswerOf<"picked">;
  still: undefined;
  command: AnswerOf<"command">;
  views: AnswerOf<"views">;
  path: AnswerOf<"path">;
  point: AnswerOf<"place">;
  centre: AnswerOf<"place">;
  commit: AnswerOf<"done">;
  change: AnswerOf<"done">;
  job: AnswerOf<"done">;
  track: AnswerOf<"track">;
  pause: AnswerOf<"done">;
  cancel: AnswerOf<"done">;
}

/** A request before it has a number. */
export type Unnumbered<T extends keyof Replies> = { type: T } & Omit<RequestOf<T>, "id">;

/** What comes through the socket, and that it was closed. */
export type Messages = { [T in Answer["type"]]: AnswerOf<T> } & { frame: ArrayBuffer; closed: undefined };

/** Events within the page. */
export interface Events {
  welcome: Welcome;
  document: SegmentDocument;
  /** The picture was drawn. */
  frame: undefined;
  /** The view has not changed for a moment. */
  rested: undefined;
  /** Segments were checked or unchecked. */
  checked: undefined;
  /** A view was restored, with this palette. */
  restored: string | null | undefined;
  /** A file of the picture arrived. */
  still: Blob;
  /** A path was opened. */
  path: OpenedPath;
  /** The picture beside the first arrived; `isImage`: the dataset's image of the view of this number. */
  other: { bitmap: ImageBitmap; number: number; isImage: boolean };
}

/** What the modules of the page share. */
export interface AppState {
  /** The server's description of the run. */
  welcome: Welcome | null;
  /** There from the first welcome on. */
  camera: Camera | null;
  doc: SegmentDocument;
  /** Names of segments hidden in this view. */
  hidden: ReadonlySet<string>;
  /** Names of segments that are checked in the tree. */
  checked: ReadonlySet<string>;
  /** Edits that are shown but not saved. */
  preview: Preview | null;
  /** Names of isolated segments. */
  alone: readonly string[];
  /** What the picture is compared with. */
  compare: Compare | null;
  /** Limits of the colour scale in scene units, if they are held. */
  range: Vec2 | null;
  /** Playback since `from`, in milliseconds, when the time was `at`. */
  playing: { from: number; at: number } | null;
  /** The last answer to a click. */
  picked: Selected | null;
}

/** A camera and what it shows, as restored from a file, an address or a test view. */
export interface RestoredView extends Partial<Omit<View, "eye" | "target" | "up" | "fov" | "look" | "alone" | "hidden" | "range">> {
  eye: Vec3;
  target: Vec3;
  up: Vec3;
  /** That of a picture of `size`; that of a training image if there is none. */
  fov: number;
  look?: string | null;
  alone: readonly string[];
  hidden: Iterable<string>;
  range?: readonly number[] | null;
}

/** A path file: its view without camera and time, and its keyframes. */
export interface OpenedPath {
  view: View & { alone: string[]; hidden: string[] };
  keys: Key[];
}

/** What a frame is, from its header. */
export interface FrameHeader {
  png: boolean;
  kind: number;
  number: number;
  revision: number;
  width: number;
  height: number;
  time: number;
  /** Milliseconds to draw and to encode. */
  ms: Vec2;
}
