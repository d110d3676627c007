// SPDX-License-Identifier: Apache-2.0
// The messages between the page and the gateway. Times are microseconds of sensor time, lengths metres, angles
// radians, image positions pixels of the sensor with (0, 0) at the centre of the first pixel.

export type TrackState = "initializing" | "tracking" | "degraded" | "lost" | "ambiguous";
export type Vector3 = [number, number, number];
/** w, x, y, z. */
export type Quaternion = [number, number, number, number];

export interface Alternative {
  p: Vector3;
  q: Quaternion;
  llr: number;
}

export interface Pose {
  t_us: number;
  seq: number;
  state: TrackState;
  /** Of the transform Frame.transform. */
  p: Vector3;
  q: Quaternion;
  /** Standard deviations: translation (m), rotation (rad), about the axes of the frame. */
  sigma?: number[];
  /** Upper triangle of the covariance of the position, m2. */
  cov3?: number[];
  v?: Vector3;
  w?: Vector3;
  explained?: number;
  alternatives?: Alternative[];
}

export interface Camera {
  width: number;
  height: number;
  fx_px: number;
  fy_px: number;
  cx_px: number;
  cy_px: number;
}

export interface SceneObject {
  id: string;
  model: string;
  diameter_m: number;
}

export interface Hello {
  type: "hello";
  mode: "live" | "recording";
  title: string;
  version: string;
  source: string;
  session: string;
}

export interface SessionRow {
  name: string;
  state: string;
  objects: string[];
  create_time: string;
}

export interface Sessions {
  type: "sessions";
  sessions: SessionRow[];
}

/** The frame of the poses. */
export interface Frame {
  /** "camera", "object" or the name of a world frame. */
  name: string;
  /** camera_from_object, object_from_camera, or that of the world such as base_from_object. */
  transform: string;
  /** Whose pose it is: "camera" for object_from_camera. */
  pose_of: "object" | "camera";
  /** The pose of the camera in a world frame. */
  camera: { p: Vector3; q: Quaternion } | null;
}

export interface Scene {
  type: "scene";
  session: string;
  frame: Frame;
  camera: Camera;
  objects: SceneObject[];
  recording: { from_us: number; to_us: number } | null;
  has_truth: boolean;
}

export interface Poses {
  type: "poses";
  object: string;
  poses: Pose[];
  truth?: boolean;
}

export interface StateChange {
  type: "state";
  object: string;
  t_us: number;
  state: TrackState;
  reason: string;
}

export interface ObjectHealth {
  id: string;
  state: string;
  detail: string;
  explained: number;
  losses: number;
}

export interface Health {
  type: "health";
  t_us: number;
  event_rate_hz: number;
  latency_ms: { p50: number; p99: number };
  pose_rate_hz: number;
  /** Processing time divided by sensor time; above 1 the session falls behind. */
  real_time_ratio: number;
  /** Events that were not used. */
  dropped: number;
  skipped: number;
  decode_faults: number;
  link: { images_sent: number; images_skipped: number; unacknowledged: number };
  objects: ObjectHealth[];
}

export interface Position {
  type: "position";
  t_us: number;
  playing: boolean;
  speed: number;
}

/** The events' times as far as the recording has been read. */
export interface ReadRange {
  type: "range";
  from_us: number;
  to_us: number;
  complete: boolean;
  /** Numbers of events in intervals of equal duration; the first one begins at from_us. */
  events?: { from_us: number; step_us: number; counts: number[] };
}

export interface Notice {
  type: "notice";
  level: "info" | "error";
  text: string;
}

export interface End {
  type: "end";
  reason: string;
}

export type TextMessage = Hello | Sessions | Scene | Poses | StateChange | Health | Position | ReadRange | Notice | End;

export type Request =
  | { type: "key"; key: string }
  | { type: "list" }
  | { type: "open"; session: string }
  | { type: "settings"; window_ms: number; cell_px: number; rate_hz: number }
  | { type: "ack"; number: number }
  | { type: "seek"; t_us: number }
  | { type: "play"; speed: number }
  | { type: "pause" }
  | { type: "step"; count: number };

export const KIND_PAINTED = 2;
export const KIND_CONTOUR = 3;

export interface Outline {
  object: string;
  state: TrackState;
  t_us: number;
  truth: boolean;
  /** x1, y1, x2, y2 of each segment. */
  segments: Float32Array;
  kinds: Uint8Array;
}

export interface EventImage {
  type: "image";
  number: number;
  /** The instant of the outlines. */
  t_us: number;
  /** The events' times: the first is included, the last not. */
  fromUs: number;
  toUs: number;
  cellPx: number;
  width: number;
  height: number;
  events: number;
  skipped: number;
  encoding: "packed" | "zlib";
  cells: Uint8Array;
  outlines: Outline[];
}

export interface Geometry {
  type: "geometry";
  object: string;
  diameterM: number;
  vertices: Float32Array;
  faces: Uint32Array;
  edges: Float32Array;
}

const MAX_HEADER_BYTES = 1 << 20;
const MAX_CELLS = 1 << 24;

function fail(what: string): never {
  throw new Error(`a binary message of the gateway is damaged: ${what}`);
}

function number(header: Record<string, unknown>, name: string): number {
  const value = header[name];
  return typeof value === "number" && Number.isFinite(value) ? value : fail(`${name} is no number`);
}

/** The sections of a message, in order; each begins at a multiple of 4 bytes. */
class Sections {
  private index = 0;

  constructor(
    private readonly data: ArrayBuffer,
    private readonly sizes: unknown[],
    private offset: number,
  ) {}

  bytes(): Uint8Array {
    const size = this.sizes[this.index++];
    if (typeof size !== "number" || !Number.isInteger(size) || size < 0) fail(`section ${this.index} has no size`);
    if (this.offset + size > this.data.byteLength) fail(`section ${this.index} ends after the message`);
    const bytes = new Uint8Array(this.data, this.offset, size);
    this.offset += (size + 3) & ~3;
    return bytes;
  }

  floats(): Float32Array {
    const bytes = this.bytes();
    if (bytes.byteLength % 4 !== 0) fail(`section ${this.index} is not made of 4-byte numbers`);
    return new Float32Array(bytes.buffer as ArrayBuffer, bytes.byteOffset, bytes.byteLength / 4);
  }

  integers(): Uint32Array {
    const floats = this.floats();
    return new Uint32Array(floats.buffer as ArrayBuffer, floats.byteOffset, floats.length);
  }
}

function decodeOutline(header: Record<string, unknown>, sections: Sections): Outline {
  const segments = sections.floats();
  const kinds = sections.bytes();
  if (segments.length !== 4 * kinds.length || kinds.length !== header["segments"]) fail("the segments of an outline are incomplete");
  return {
    object: String(header["object"]),
    state: header["state"] as TrackState,
    t_us: number(header, "t_us"),
    truth: header["truth"] === true,
    segments,
    kinds,
  };
}

function decodeImage(header: Record<string, unknown>, sections: Sections): EventImage {
  const width = number(header, "width");
  const height = number(header, "height");
  if (!(width > 0 && height > 0 && width * height <= MAX_CELLS)) fail(`the image has ${width} x ${height} cells`);
  const encoding = header["encoding"];
  if (encoding !== "packed" && encoding !== "zlib") fail(`the encoding of its cells is unknown: ${String(encoding)}`);
  const cells = sections.bytes();
  const outlines = Array.isArray(header["outlines"]) ? (header["outlines"] as Record<string, unknown>[]) : [];
  return {
    type: "image",
    number: number(header, "number"),
    t_us: number(header, "t_us"),
    fromUs: number(header, "from_us"),
    toUs: number(header, "to_us"),
    cellPx: number(header, "cell_px"),
    width,
    height,
    events: number(header, "events"),
    skipped: number(header, "skipped"),
    encoding,
    cells,
    outlines: outlines.map((outline) => decodeOutline(outline, sections)),
  };
}

function decodeGeometry(header: Record<string, unknown>, sections: Sections): Geometry {
  const vertices = sections.floats();
  const faces = sections.integers();
  const edges = sections.floats();
  if (vertices.length % 3 !== 0 || faces.length % 3 !== 0 || edges.length % 6 !== 0) fail("the geometry is incomplete");
  const count = vertices.length / 3;
  if (faces.some((index) => index >= count)) fail("a face names a vertex that does not exist");
  return { type: "geometry", object: String(header["object"]), diameterM: number(header, "diameter_m"), vertices, faces, edges };
}

/** Decodes a binary message. Throws an Error that names the cause if it is damaged; null if its type is unknown. */
export function decodeBinary(data: ArrayBuffer): EventImage | Geometry | null {
  if (data.byteLength < 4) fail("it has no header");
  const headerBytes = new DataView(data).getUint32(0, true);
  if (headerBytes > MAX_HEADER_BYTES || 4 + headerBytes > data.byteLength) fail("its header ends after the message");
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, headerBytes))) as Record<string, unknown>;
  const sizes = Array.isArray(header["sections"]) ? (header["sections"] as unknown[]) : [];
  const sections = new Sections(data, sizes, (4 + headerBytes + 3) & ~3);
  if (header["type"] === "image") return decodeImage(header, sections);
  if (header["type"] === "geometry") return decodeGeometry(header, sections);
  return null;
}

/** The packed cells of an image: inflated if necessary. Throws if their number is not that of the header. */
export async function packedCells(image: EventImage): Promise<Uint8Array> {
  const expected = Math.ceil((image.width * image.height) / 4);
  let cells = image.cells;
  if (image.encoding === "zlib") {
    const inflation = new DecompressionStream("deflate");
    const writer = inflation.writable.getWriter();
    // Damaged data are reported by the reader.
    const written = writer.write(cells as Uint8Array<ArrayBuffer>).then(() => writer.close());
    written.catch(() => undefined);
    cells = await readAtMost(inflation.readable, expected);
  }
  if (cells.length !== expected) fail(`it has ${cells.length} bytes of cells instead of ${expected}`);
  return cells;
}

async function readAtMost(stream: ReadableStream<Uint8Array>, size: number): Promise<Uint8Array> {
  const result = new Uint8Array(size);
  const reader = stream.getReader();
  let length = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return result.subarray(0, length);
    if (length + value.length > size) {
      await reader.cancel();
      fail("it has more cells than its header says");
    }
    result.set(value, length);
    length += value.length;
  }
}
