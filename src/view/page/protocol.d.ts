// Messages of the page and of the viewer. Generated from their types in Rust:
// VOLSEGGS_VIEW_WRITE=1 cargo test -p volseggs --lib declarations

/** A message of the server. */
export type Answer = 
  /** The first message, sent again when the scene changes or an affinity field appears or disappears. */
  | {
    /** Physical space and time of the scene, by which the page converts what it shows. */
    calibration: Calibration;
    /** Whether that training can be paused here. */
    can_pause: boolean;
    /** Point that cameras look at. */
    centre: [number, number, number];
    /** Whether clicks can become segments: there is an affinity field. */
    clicks: boolean;
    /** Their field of view, in radians. */
    fov: number;
    /** Number of Gaussians. */
    gaussians: number;
    /** Whether this viewer's own process trains the run. */
    in_training: boolean;
    /** A note for the user. */
    note: string | null;
    /** Runs that it can be compared with. */
    others: OtherRun[];
    /** Distance of the dataset's cameras from it. */
    radius: number;
    /** Whether segments and edits cannot be changed. */
    read_only: boolean;
    /** Name of the run. */
    run: string;
    /** Fingerprint of its scene. */
    scene: string;
    /** Width and height of their pictures. */
    size: [number, number];
    /** Steps that it was trained for. */
    step: number | null;
    type: "welcome";
    /** Names of its units. */
    units: Units;
    /** Version of the program. */
    version: string;
  }
  /** Segments and edits as they are now. */
  | Document & {
    type: "document";
  }
  /** What a click selected. */
  | Selected & {
    type: "picked";
  }
  /** The command that was requested. */
  | {
    /** The command, for a shell. */
    command: string;
    /** Number of the request. */
    id: number;
    type: "command";
  }
  /** The dataset's test views. */
  | {
    /** Number of the request. */
    id: number;
    type: "views";
    /** The views, in order. */
    views: Placed[];
  }
  /** A path through keyframes. */
  | {
    /** What its file holds. */
    file: SavedPath;
    /** Its cameras at equal steps. */
    frames: Key[];
    /** Number of the request. */
    id: number;
    type: "path";
  }
  /** Why there is no second picture, if one was requested; without a reason once there is. */
  | {
    /** Why, and what to do. */
    fault: string | null;
    type: "beside";
  }
  /** A request was carried out. */
  | {
    /** Its number. */
    id: number;
    type: "done";
  }
  /** A position. */
  | {
    /** In scene units. */
    at: [number, number, number];
    /** Number of the request. */
    id: number;
    type: "place";
  }
  /** Progress of long work. */
  | JobState & {
    type: "job";
  }
  /** How segments change over time. */
  | Track & {
    type: "track";
  }
  /** Progress of the run's training. */
  | TrainingStatus & {
    type: "training";
  }
  /** The legend of the colours. */
  | {
    /** The legend; `None` where objects have their own colours. */
    legend: Legend | null;
    type: "legend";
  }
  /** The viewer ends; its last message. */
  | {
    /** Why, and what to do. */
    message: string;
    type: "ended";
  }
  /** Something cannot be done. */
  | {
    /** Number of the request, if it has one. */
    id: number | null;
    /** Why, and what to do. */
    message: string;
    type: "error";
  };

/** Which way the axes x, y, z of physical space point; all are right-handed. */
export type AxisConvention = 
  /** Towards a patient's left, back and head (DICOM, ITK, 3D Slicer's files). */
  | "left-posterior-superior"
  /** Towards a patient's right, front and head (NIfTI). */
  | "right-anterior-superior";

/** Physical space and time of a scene. Written by `prepare` into `prepare.json`, kept by training in `run.json`. */
export type Calibration = {
  /** Physical space; `None` where it is unknown, so that lengths are normalised. */
  space?: PhysicalSpace | null;
  /** Physical time; `None` where it is unknown (steps without time values, a single step), so that times are
   * normalised. */
  time?: PhysicalTime | null;
};

/** A change of the document. */
export type Change = 
  /** Replace all segments by segments by colour. */
  | {
    /** Number of colours; suggested from the data if not given. */
    clusters?: number | null;
    kind: "coarse";
    /** Time at which to segment, in [0, 1]. */
    time: number;
  }
  /** Group several segments as one. */
  | {
    kind: "group";
    /** Name of the group. */
    name: string;
    /** Its segments. */
    segments: string[];
  }
  /** Rename a segment. */
  | {
    kind: "rename";
    /** Its new name. */
    name: string;
    /** Its current name. */
    segment: string;
  }
  /** Remove segments with their parts. */
  | {
    kind: "remove";
    /** Which segments. */
    segments: string[];
  }
  /** Undo or redo a change of the segments. */
  | {
    kind: "segments";
    /** Whether to undo; to redo if not. */
    undo: boolean;
  }
  /** An edit. */
  | {
    kind: "edit";
    /** What is done to them. */
    operation: Operation;
    /** Its segments. */
    segments: string[];
  }
  /** Undo or redo an edit. */
  | {
    kind: "edits";
    /** Whether to undo; to redo if not. */
    undo: boolean;
  }
  /** Undo or redo what was changed last, segments or edits. */
  | {
    kind: "last";
    /** Whether to undo; to redo if not. */
    undo: boolean;
  };

/** What happens to the earlier selection when something is clicked. */
export type Combine = 
  /** It is replaced. */
  | "replace"
  /** The new selection is added to it. */
  | "add"
  /** The new selection is removed from it. */
  | "remove";

/** What a picture is compared with. */
export type Compare = 
  /** The dataset's image of this test view, from 0. */
  | {
    /** Its number. */
    view: number;
    with: "image";
  }
  /** The same without edits. */
  | {
    with: "plain";
  }
  /** The same at another time. */
  | {
    /** In [0, 1]. */
    time: number;
    with: "time";
  }
  /** Another run at the same time. */
  | {
    /** Its number among those that the viewer was started with, from 0. */
    run: number;
    with: "run";
  };

/** Segments and edits. */
export type Document = {
  /** Whether there is an edit to undo, and to redo. */
  edit_steps: [boolean, boolean];
  /** The edits that apply, in words. */
  edits: string[];
  /** Old and new names of segments that the last change renamed, whoever made it. */
  renamed: [string, string][];
  /** Grows with every change. */
  revision: number;
  /** Next change of the segments to undo, and to redo. */
  segment_steps: [string | null, string | null];
  /** Wholes, each followed by its parts. */
  segments: SegmentRow[];
};

/** One operation on named segments, undone as one step.
 * 
 * A Gaussian in several of the named segments is edited once, as part of the first that contains it. */
export type Edit = {
  /** What is done to them. */
  operation: Operation;
  /** Names of segments, at least one. */
  segments: string[];
};

/** What happened. */
export type EventKind = 
  /** A component appears (1 child). */
  | "appear"
  /** A component vanishes (1 parent). */
  | "vanish"
  /** A component becomes several. */
  | "split"
  /** Several components become one. */
  | "merge"
  /** A track continues from `time_from` to `time_to` without an event. */
  | "continue"
  /** The whole segment becomes visible; its tracks may also appear one by one. */
  | "segment_appear"
  /** The whole segment fades; its tracks may also vanish one by one. */
  | "segment_vanish";

/** How a job ended. */
export type JobEnd = 
  /** Everything is done; says what was made, and where it is. */
  | {
    done: string;
  }
  /** It was stopped; everything is as before. */
  | "stopped"
  /** It failed; says why. */
  | {
    failed: string;
  };

/** The state of a job, as sent to clients. */
export type JobState = {
  /** Seconds since then. */
  ago: number | null;
  /** How many there are; 0 if that is not known. */
  all: number;
  /** How many of them are done. */
  done: number;
  /** How it ended, if it has. */
  end: JobEnd | null;
  /** Seconds until all of the unit are done, at the pace so far. */
  left: number | null;
  /** Step and smoothed loss of a training, evenly spaced. */
  losses: [number, number][];
  /** Its number, by which it is cancelled. */
  number: number;
  /** Seconds since it began. */
  seconds: number;
  /** Whether it was asked to stop. */
  stopping: boolean;
  /** What it does, in words. */
  title: string;
  /** What is counted, such as `pictures`. */
  unit: string;
};

/** A camera and the scene time it shows, at a moment of the path. */
export type Key = {
  /** Position of the camera, scene units. */
  eye: [number, number, number];
  /** Full horizontal field of view, radians. */
  fov: number;
  /** Moment on the path, seconds. */
  seconds: number;
  /** Point it looks at. */
  target: [number, number, number];
  /** Time of the scene in [0, 1]. */
  time: number;
  /** Up direction. */
  up: [number, number, number];
};

/** Legend for the colours of a picture. */
export type Legend = {
  /** Description in words. */
  legend: string;
  /** Values at the ends of the scale, in `unit`. */
  range?: [number, number] | null;
  /** Colours of the scale at even steps from its low to its high end, 8 bits per channel. */
  scale?: [number, number, number][];
  /** The same values in scene units, as saved views hold them. */
  scene_range?: [number, number] | null;
  /** Unit of these values; `normalised` where the data have none. */
  unit?: string | null;
};

/** What makes Gaussians one level. */
export type LevelKind = 
  /** Their affinity with the clicked one. */
  | "similar"
  /** They are the clicked part of the connected piece, where that has several. */
  | "part"
  /** They are the connected piece of the searched segment at the click. */
  | "piece"
  /** They are the searched segment. */
  | "segment"
  /** They are one object with the clicked part, whatever segments they are in, see [`ClickCandidates::object`]. */
  | "object";

/** A level that a click can mean. */
export type LevelOffer = {
  /** What makes its Gaussians one. */
  kind: LevelKind;
  /** Its share of what the scene shows. */
  share: number;
};

/** What is done to the named segments.
 * 
 * In JSON a variant is written as `{"opacity": {"factor": 0.5}}`, one without values as `"hide"`. */
export type Operation = 
  /** Gives each segment a colour. */
  | {
    recolour: {
      /** True: the constant terms of a segment are all shifted by the same amount, which makes the opacity-weighted
       * mean of its colours `rgb`; the differences among its Gaussians and everything view-dependent stay. False:
       * every Gaussian gets the colour `rgb` from every direction; in a scene with a headlight, as the colour that
       * it shades. */
      keep_shading: boolean;
      /** Red, green, blue in `[0, 1]`. */
      rgb: [number, number, number];
    };
  }
  /** Multiplies the linear opacity. The result is at most 0.99, as in drawing. 0 is the same as `Hide`. */
  | {
    opacity: {
      /** At least 0. */
      factor: number;
      /** Whether hidden segments are shown again. */
      show?: boolean;
    };
  }
  /** Makes the segments invisible until a later `Show`. */
  | "hide"
  /** Makes the segments visible again, with the opacity they would have had. */
  | "show"
  /** Hides every Gaussian that is in none of the named segments; the others stay as they are, visible or hidden. */
  | "isolate"
  /** Moves the segments. */
  | {
    translate: {
      /** Along x, y, z, scene units. */
      by: [number, number, number];
    };
  }
  /** Rotates the segments, including the orientation and the view-dependent colour of their Gaussians. */
  | {
    rotate: {
      /** A fixed point, scene units; without one, each segment rotates about its own opacity-weighted centre at the
       * time being drawn, so that a moving segment rotates about itself at every time. */
      about?: [number, number, number] | null;
      /** Axis, of any length but 0. */
      axis: [number, number, number];
      /** Angle, right-handed about the axis. */
      degrees: number;
    };
  }
  /** Scales the segments, including their Gaussians. */
  | {
    scale: {
      /** As in `Rotate`. */
      about?: [number, number, number] | null;
      /** From 1e-6 to 1e6. */
      factor: number;
    };
  };

/** A run with which the viewed one can be compared. */
export type OtherRun = {
  /** Number of its Gaussians. */
  gaussians: number;
  /** Its short name. */
  name: string;
  /** What to know before the two are compared. */
  note: string | null;
  /** Steps that it was trained for. */
  step: number | null;
};

/** The physical space of a scene. */
export type PhysicalSpace = {
  /** What the axes mean; `None` where the data do not say. */
  axes?: AxisConvention | null;
  /** The physical position of the scene's origin, in `unit`. */
  centre: [number, number, number];
  /** Length of one scene unit, in `unit`; finite and positive. */
  scale: number;
  /** Unit of length as the data name it, such as `mm`; `None` where they do not. */
  unit?: string | null;
};

/** The physical time of a scene. */
export type PhysicalTime = {
  /** Time of the last step, in `unit`; above `start`. */
  end: number;
  /** Time of the first step, in `unit`. */
  start: number;
  /** Unit of time as the data name it, such as `s`; `None` where they do not. */
  unit?: string | null;
};

/** Camera pose and time of a view of the dataset. */
export type Placed = {
  /** Position of the camera, scene units. */
  eye: [number, number, number];
  /** Full horizontal field of view, radians. */
  fov: number;
  /** Point it looks at: on its axis, as far away as the scene's centre. */
  target: [number, number, number];
  /** Time in [0, 1]. */
  time: number;
  /** Up direction. */
  up: [number, number, number];
};

/** Unsaved edits that are shown after those of the run. */
export type Preview = {
  /** Revision of the document that they belong to. They are not shown on any other, so that they are not applied
   * twice once they are saved. */
  base: number;
  /** The edits, first to last. */
  edits: Edit[];
};

/** Progress of the training. */
export type Progress = {
  /** Number of Gaussians that are shown. */
  gaussians: number;
  /** Seconds until the end at that pace. */
  left: number | null;
  /** Loss of the last step. */
  loss: number | null;
  /** Recent steps per second. */
  pace: number | null;
  /** Whether it is paused. */
  paused: boolean;
  /** Whether it has been asked to pause. */
  pausing: boolean;
  /** Step that is shown. */
  shown: number;
  /** Steps taken. */
  steps: number;
};

/** A message of a client. */
export type Request = 
  /** What it wants to see. */
  | {
    /** Segments shown alone; the whole scene if empty. */
    alone?: string[];
    /** What it is compared with. */
    compare?: Compare | null;
    /** Whether the edits apply. */
    edits: boolean;
    /** Position of the camera, scene units. */
    eye: [number, number, number];
    /** Full horizontal field of view, radians. */
    fov: number;
    /** Segments that are hidden. */
    hidden?: string[];
    /** What the colours stand for, by the name that [`Show`] parses. */
    look: string;
    /** Whether more changes are to come at once. */
    moving: boolean;
    /** Palette for numbers, by the name that [`Palette`] parses; the one that `render` uses if not given. */
    palette?: string | null;
    /** Unsaved edits that are shown after those of the run. */
    preview?: Preview | null;
    /** Values at the ends of the colour scale; those that suit the first picture if not given. */
    range?: [number, number] | null;
    /** Width and height in pixels. */
    size: [number, number];
    /** Point it looks at. */
    target: [number, number, number];
    /** Time in [0, 1]. */
    time: number;
    type: "view";
    /** Up direction. */
    up: [number, number, number];
  }
  /** It has drawn a frame and all before it. */
  | {
    /** Number of the frame. */
    frame: number;
    type: "ack";
  }
  /** A click on the view that it saw last. */
  | {
    /** What happens to the earlier selection. */
    combine?: Combine;
    /** Number by which the answer is identified. */
    id: number;
    /** How much to select; the likeliest level if not given. */
    meaning?: RequestedGranularity | null;
    /** Column and row, in pixels of the full size. */
    pixel: [number, number];
    type: "pick";
    /** Segment to look in; the clicked one if not given. */
    within?: string | null;
  }
  /** The same click once more, with another meaning. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** How much to select. */
    meaning?: RequestedGranularity | null;
    type: "adjust";
  }
  /** The picture as a file that can be drawn again, without the selection. */
  | {
    /** Number by which the frame is identified. */
    id: number;
    type: "still";
  }
  /** The command that draws the picture. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    type: "command";
  }
  /** Where the dataset's test views are. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    type: "views";
  }
  /** Cameras of a path through keyframes, and the path as a file. */
  | {
    /** Number of cameras. */
    frames: number;
    /** Number by which the answer is identified. */
    id: number;
    /** The keyframes. */
    keys: Key[];
    type: "path";
  }
  /** Clear the selection. */
  | {
    type: "clear";
  }
  /** The position of what a pixel shows in the view that the client requested last. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** Column and row, in pixels of the full size. */
    pixel: [number, number];
    type: "point";
  }
  /** The position of segments: their opacity-weighted centre. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** Which segments. */
    segments: string[];
    /** Time in [0, 1]. */
    time: number;
    type: "centre";
  }
  /** Make a segment of the selection. */
  | {
    /** Revision of the document that the client knows. */
    base: number;
    /** Number by which the answer is identified. */
    id: number;
    /** Its name. */
    name: string;
    type: "commit";
  }
  /** Change the document. */
  | {
    /** Revision of the document that the client knows. */
    base: number;
    /** The change. */
    change: Change;
    /** Number by which the answer is identified. */
    id: number;
    type: "change";
  }
  /** Start long work. */
  | {
    /** Revision of the document that the client knows. */
    base: number;
    /** Number by which the answer is identified. */
    id: number;
    /** The work. */
    task: Task;
    type: "job";
  }
  /** How segments, several as one, change over time. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** Their names. */
    segments: string[];
    /** Number of times, evenly spaced over [0, 1]. */
    times: number;
    type: "track";
  }
  /** Pause or continue the training in the viewer's process. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** Whether to pause. */
    pause: boolean;
    type: "pause";
  }
  /** Stop long work. */
  | {
    /** Number by which the answer is identified. */
    id: number;
    /** Number of the job. */
    job: number;
    type: "cancel";
  };

/** How much a click selects. */
export type RequestedGranularity = 
  /** A level, from 1, the smallest. */
  | {
    level: number;
  }
  /** A mask scale in [0, 1] and the minimum cosine of members. */
  | {
    by: {
      /** The scale. */
      scale: number;
      /** The cosine. */
      threshold: number;
    };
  };

/** A camera path as stored in a file. */
export type SavedPath = {
  /** The command that draws it again. */
  command: string;
  /** Version of the format, [`FORMAT`]. */
  format: number;
  /** The keyframes. */
  keys: Key[];
  /** Folder of the run. */
  run: string;
  /** Fingerprint of its scene. */
  scene: string;
  /** Version of the program that wrote it. */
  version: string;
  /** What it shows. */
  view: View;
};

/** A segment in the document. */
export type SegmentRow = {
  /** sRGB in [0, 1]. */
  colour: [number, number, number];
  /** Depth below a whole. */
  depth: number;
  /** Number of its Gaussians. */
  gaussians: number;
  /** Whether an edit hides it. */
  hidden: boolean;
  /** Its name. */
  name: string;
  /** Factor by which edits multiply its opacity. */
  opacity: number;
  /** The last colour that an edit gave it, sRGB in [0, 1]. */
  rgb: [number, number, number] | null;
  /** Time at which it was found. */
  time: number;
};

/** What is selected. */
export type Selected = {
  /** Number of selected Gaussians, including those of earlier clicks. */
  gaussians: number;
  /** Number of the request. */
  id: number;
  /** Number of the level that was used, from 1. */
  level: number | null;
  /** The existing levels, from small to large. */
  levels: LevelOffer[];
  /** Position of the clicked Gaussian, in scene units. */
  mean: [number, number, number];
  /** Milliseconds that it took. */
  ms: number;
  /** Mask scale that was used. */
  scale: number;
  /** Segments that contain it. */
  segments: string[];
  /** Cosine that was used. */
  threshold: number;
};

/** Long work. */
export type Task = 
  /** Masks of segments, as `segment masks`. */
  | {
    kind: "masks";
    /** Whether existing masks are replaced. */
    replace: boolean;
    /** Which segments; all that are not part of another if empty. */
    segments: string[];
    /** Width of the pictures in pixels; that of the training images if not given. */
    size?: number | null;
    /** Name of the source of masks: one that needs no other program or download. */
    source: string;
    /** Number of views; the command's default if not given. */
    views?: number | null;
  }
  /** The affinity field, as `segment fine`. */
  | {
    kind: "fine";
    /** Number of steps. */
    steps: number;
  }
  /** Parts of a segment, as `segment split`. */
  | {
    /** Number of parts; as many as are found if not given. */
    clusters?: number | null;
    kind: "split";
    /** Whether segments picked in the parts of an earlier split may be removed. */
    replace: boolean;
    /** Mask scale in [0, 1]. */
    scale: number;
    /** The segment. */
    segment: string;
  }
  /** Segments through time, as `track`. */
  | {
    /** Number of times, evenly spaced over [0, 1]. */
    frames: number;
    /** Name under which they are tracked as one. */
    group?: string | null;
    kind: "track";
    /** Which segments. */
    segments: string[];
  }
  /** Files for other programs, as `export`, in the run folder. */
  | {
    /** Whether the edits apply. */
    edited: boolean;
    /** Their format, by the extension of the files. */
    format: string;
    /** Number of times, evenly spaced over [0, 1], instead of the one. */
    frames?: number | null;
    kind: "export";
    /** Segments to write; all if empty. */
    segments: string[];
    /** Time in [0, 1]. */
    time: number;
  };

/** Measurements of a segment, or several as one, over time. */
export type Track = {
  /** Centroid at each, in units of the data; `None` where it is nowhere. */
  centroid: ([number, number, number] | null)[];
  /** Events of its parts. */
  events: TrackEvent[];
  /** Number of the request. */
  id: number;
  /** The segments. */
  segments: string[];
  /** Speed of the centroid at each, in units of the data; `None` where it is lost. */
  speed: (number | null)[];
  /** Times in [0, 1]. */
  times: number[];
  /** Volume of its place at each, in cubic units of the data. */
  volume: number[];
};

/** An event of the parts. */
export type TrackEvent = {
  /** Last time before it. */
  from: number;
  /** Its kind. */
  kind: EventKind;
  /** Numbers of parts before and after. */
  parts: [number, number];
  /** First time after it. */
  to: number;
};

/** The training of a run. */
export type TrainingStatus = {
  /** Total steps of the run. */
  all: number;
  /** Further progress of a training that goes on in this process. */
  live?: Progress | null;
  /** (step, loss), smoothed. */
  loss: [number, number][];
  /** `running`, `interrupted`, `complete` or `broken off`, see [`status`]. */
  status: string;
  /** Steps taken so far. */
  steps: number;
  /** (step, PSNR on a few test views, in decibels). */
  test: [number, number][];
  /** (step, PSNR on the views trained on, in decibels), smoothed. */
  train: [number, number][];
};

/** Names of the units in which the page shows numbers; `normalised` where the data have none. */
export type Units = {
  /** Of lengths. */
  length: string;
  /** Of speeds. */
  speed: string;
  /** Of times. */
  time: string;
};

/** What a picture shows. */
export type View = {
  /** Segments shown alone; the whole scene if empty. */
  alone?: string[];
  /** Whether the edits apply. */
  edits: boolean;
  /** Position of the camera, scene units. */
  eye: [number, number, number];
  /** Full horizontal field of view, radians. */
  fov: number;
  /** Segments that are hidden. */
  hidden?: string[];
  /** What the colours stand for, by the name that [`Show`] parses. */
  look: string;
  /** Palette for numbers, by the name that [`Palette`] parses; the one that `render` uses if not given. */
  palette?: string | null;
  /** Values at the ends of the colour scale; those that suit the first picture if not given. */
  range?: [number, number] | null;
  /** Width and height in pixels. */
  size: [number, number];
  /** Point it looks at. */
  target: [number, number, number];
  /** Time in [0, 1]. */
  time: number;
  /** Up direction. */
  up: [number, number, number];
};
