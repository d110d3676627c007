// SPDX-License-Identifier: Apache-2.0
// What the page knows about the session: poses, states and health, in series of bounded length.
import type { Alternative, Health, Hello, ObjectHealth, Pose, Position, Scene, ReadRange, SceneObject, SessionRow, StateChange, TrackState } from "./protocol";
import { Series } from "./ring";
import { ContinuousRotation } from "./rotation";

/** Columns of ObjectTrack.poses. */
export const COLUMN = {
  t: 0, seq: 1, state: 2, p: 3, q: 6, rotation: 10, sigma: 13, speed: 19, turnRate: 20, explained: 21, covariance: 22, count: 28,
} as const;
/** Columns of ObjectTrack.truth. */
export const TRUTH_COLUMN = { t: 0, p: 1, q: 4, count: 8 } as const;

/** "none": no pose and no reason are known, as between the poses of a TUM file. */
export type ShownState = TrackState | "none";
export const STATES: readonly ShownState[] = ["initializing", "tracking", "degraded", "ambiguous", "lost", "none"];

export function knownState(state: string): ShownState {
  return (STATES as readonly string[]).includes(state) ? (state as ShownState) : "none";
}

export interface Change {
  t_us: number;
  state: ShownState;
  reason: string;
}

// 60 poses a second for a minute; the gateway thins a recording to 20,000 poses.
const LIVE_POSES = 4096;
const RECORDED_POSES = 20480;
/** The gateway sends at most this number of states of the objects of a recording (RecordedPoses::kMaxStates). */
const MAX_CHANGES = 4096;
const MAX_HEALTH = 1200;
/** The gateway sends at most this number of intervals. */
const MAX_INTERVALS = 2048;
const MAX_OBJECTS = 64;
const MIN_LIVE_SPAN_US = 5e6;
/** A recording has a gap where poses are further apart than this and than ten times their median distance. */
const MIN_GAP_US = 20000;
/** Live poses come 60 times a second. */
const LIVE_GAP_US = 60000;

/** The states of an object over time: each change, ordered by time. */
export class StateLog {
  readonly changes: Change[] = [];

  /** The last change that is not after `t_us`; -1 if there is none. */
  indexAt(t_us: number): number {
    let low = 0;
    let high = this.changes.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.changes[middle]!.t_us <= t_us) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  add(t_us: number, state: ShownState, reason: string): void {
    const index = this.indexAt(t_us);
    const current = this.changes[index];
    if (current?.state === state) {
      if (reason !== "" && current.reason === "") current.reason = reason;
      return;
    }
    const at = current?.t_us === t_us ? index : index + 1;
    if (at === index) this.changes.splice(index, 1);
    const [before, next] = [this.changes[at - 1], this.changes[at]];
    if (before?.state === state) {
      // Without the replaced change, the spans before and after it have the same state and are joined.
      if (next?.state === state) this.changes.splice(at, 1);
    } else if (next?.state === state) {
      next.t_us = t_us;
      if (reason !== "") next.reason = reason;
    } else {
      this.changes.splice(at, 0, { t_us, state, reason });
    }
    if (this.changes.length > MAX_CHANGES) this.changes.shift();
  }
}

export class ObjectTrack {
  readonly poses: Series;
  readonly truth: Series;
  readonly log = new StateLog();
  health: ObjectHealth | null = null;
  /** Position of the first pose, m. */
  origin: [number, number, number] | null = null;
  /** Poses that are further apart have a gap between them. Of a recording, the first message with several poses decides. */
  gapUs = LIVE_GAP_US;
  private hasGapThreshold = false;
  private readonly rotation = new ContinuousRotation();
  /** Of the ambiguous poses among `poses`, by their times, which increase. */
  private readonly alternatives = new Map<number, readonly Alternative[]>();

  constructor(
    readonly info: SceneObject,
    readonly index: number,
    readonly isRecording: boolean,
  ) {
    const capacity = isRecording ? RECORDED_POSES : LIVE_POSES;
    this.poses = new Series(COLUMN.count, capacity);
    this.truth = new Series(TRUTH_COLUMN.count, isRecording ? capacity : 1);
  }

  addPoses(poses: readonly Pose[]): void {
    if (this.isRecording && !this.hasGapThreshold && poses.length > 1) {
      this.gapUs = gapThreshold(poses);
      this.hasGapThreshold = true;
    }
    for (const pose of poses) {
      const last = this.poses.length > 0 ? this.poses.at(COLUMN.t, this.poses.length - 1) : pose.t_us;
      const current = this.log.changes[this.log.indexAt(pose.t_us)];
      if (this.isRecording && pose.t_us - last > this.gapUs && current && current.t_us <= last) this.log.add(last + 1, "none", "");
      this.origin ??= pose.p;
      const state = knownState(pose.state);
      this.poses.push([
        pose.t_us, pose.seq, STATES.indexOf(state), ...pose.p, ...pose.q, ...this.rotation.next(pose.q), ...six(pose.sigma),
        pose.v ? Math.hypot(...pose.v) : NaN, pose.w ? Math.hypot(...pose.w) : NaN, pose.explained ?? NaN, ...six(pose.cov3),
      ]);
      this.keepAlternatives(pose, last);
      this.log.add(pose.t_us, state, "");
    }
  }

  /** The poses that compete with the pose of a row; empty unless it is ambiguous. */
  alternativesAt(row: number): readonly Alternative[] {
    return this.alternatives.get(this.poses.at(COLUMN.t, row)) ?? [];
  }

  /** `lastUs`: time of the pose before. */
  private keepAlternatives(pose: Pose, lastUs: number): void {
    for (const t of pose.t_us <= lastUs ? [...this.alternatives.keys()] : []) {
      if (t >= pose.t_us) this.alternatives.delete(t); // the pose replaces those from its time on
    }
    if (pose.alternatives && pose.alternatives.length > 0) this.alternatives.set(pose.t_us, pose.alternatives.slice(0, 4));
    const oldest = this.poses.at(COLUMN.t, 0);
    for (const t of this.alternatives.keys()) {
      if (t >= oldest) break;
      this.alternatives.delete(t);
    }
  }

  addTruth(poses: readonly Pose[]): void {
    for (const pose of poses) this.truth.push([pose.t_us, ...pose.p, ...pose.q]);
  }

  /** The row of the pose that is shown at the instant: the last one that is not later, unless the object has been without pose since. */
  rowAt(t_us: number): number {
    const row = this.poses.lastAt(t_us);
    if (row < 0) return -1;
    const change = this.log.changes[this.log.indexAt(t_us)];
    return change?.state === "none" && change.t_us > this.poses.at(COLUMN.t, row) ? -1 : row;
  }

  stateAt(t_us: number): ShownState {
    return this.log.changes[this.log.indexAt(t_us)]?.state ?? "none";
  }
}

/** The last interval ends with the last event; it is left out if it is shorter than half of the others. */
function eventRates({ from_us, step_us, counts }: NonNullable<ReadRange["events"]>, to_us: number): Series {
  const rates = new Series(2, MAX_INTERVALS);
  counts.forEach((count, i) => {
    const begin = from_us + i * step_us;
    const spanUs = Math.min(step_us, to_us + 1 - begin);
    if (spanUs >= step_us / 2 || counts.length === 1) rates.push([begin + spanUs / 2, (1e6 * count) / spanUs]);
  });
  return rates;
}

function six(values: readonly number[] | undefined): readonly number[] {
  return values?.length === 6 ? values : [NaN, NaN, NaN, NaN, NaN, NaN];
}

function gapThreshold(poses: readonly Pose[]): number {
  const distances = poses.slice(1).map((pose, i) => pose.t_us - poses[i]!.t_us);
  distances.sort((a, b) => a - b);
  return Math.max(MIN_GAP_US, 10 * (distances[distances.length >> 1] ?? 0));
}

export class Store {
  hello: Hello | null = null;
  sessions: SessionRow[] = [];
  scene: Scene | null = null;
  objects = new Map<string, ObjectTrack>();
  selected = "";
  /** t, events per second, latency p50 and p99 (ms). */
  healthSeries = new Series(4, MAX_HEALTH);
  health: Health | null = null;
  /** Of a recording: middle of an interval, events per second. */
  eventRates = new Series(2, MAX_INTERVALS);
  position: Position | null = null;
  /** How far the recording has been read; null for live sessions. */
  range: ReadRange | null = null;
  /** Why the session ended; null while it goes on. */
  ended: string | null = null;
  /** Counts changes of what plots and lists show. */
  version = 0;

  get isRecording(): boolean {
    return this.hello?.mode === "recording";
  }

  setScene(scene: Scene): void {
    // After a lost connection to a live session, what was received before it is still right.
    const isSame = !scene.recording && this.scene?.session === scene.session && JSON.stringify(this.scene.objects) === JSON.stringify(scene.objects);
    this.scene = scene;
    this.ended = null;
    ++this.version;
    if (isSame) return;
    this.objects = new Map(scene.objects.slice(0, MAX_OBJECTS).map((info, i) => [info.id, new ObjectTrack(info, i, scene.recording !== null)]));
    if (!this.objects.has(this.selected)) this.selected = scene.objects[0]?.id ?? "";
    this.healthSeries = new Series(4, MAX_HEALTH);
    this.health = null;
    this.eventRates = new Series(2, MAX_INTERVALS);
    this.range = scene.recording ? { type: "range", ...scene.recording, complete: false } : null;
    this.position = scene.recording ? { type: "position", t_us: scene.recording.from_us, playing: false, speed: 1 } : null;
  }

  addPoses(object: string, poses: readonly Pose[], isTruth: boolean): void {
    const track = this.objects.get(object);
    if (isTruth) track?.addTruth(poses);
    else track?.addPoses(poses);
    ++this.version;
  }

  addState(change: StateChange): void {
    this.objects.get(change.object)?.log.add(change.t_us, knownState(change.state), change.reason);
    ++this.version;
  }

  setRange(range: ReadRange): void {
    this.range = range;
    if (range.events) this.eventRates = eventRates(range.events, range.to_us);
    ++this.version;
  }

  /** The times that the scrubber and the plots of a recording show: those of its events and its poses. */
  get recordedRange(): { from_us: number; to_us: number } | null {
    if (!this.range) return null;
    let { from_us, to_us } = this.range;
    if (to_us <= from_us) [from_us, to_us] = [Infinity, -Infinity];
    for (const { poses } of this.objects.values()) {
      if (poses.length === 0) continue;
      from_us = Math.min(from_us, poses.at(COLUMN.t, 0));
      to_us = Math.max(to_us, poses.at(COLUMN.t, poses.length - 1));
    }
    return from_us <= to_us ? { from_us, to_us } : { from_us: this.range.from_us, to_us: this.range.to_us };
  }

  addHealth(health: Health): void {
    this.health = health;
    this.healthSeries.push([health.t_us, health.event_rate_hz, health.latency_ms.p50, health.latency_ms.p99]);
    for (const object of health.objects) {
      const track = this.objects.get(object.id);
      if (track) track.health = object;
    }
    ++this.version;
  }

  /** Begin of the time that live plots show: at most `spanS` before the newest time, and not long before the first pose. */
  liveFromUs(spanS: number): number {
    const newest = this.newestUs;
    let first = newest - MIN_LIVE_SPAN_US;
    for (const { poses } of this.objects.values()) if (poses.length > 0) first = Math.min(first, poses.at(COLUMN.t, 0));
    return Math.max(newest - spanS * 1e6, first);
  }

  /** Sensor time of the newest pose or health report. */
  get newestUs(): number {
    let newest = this.health?.t_us ?? 0;
    for (const { poses } of this.objects.values()) {
      if (poses.length > 0) newest = Math.max(newest, poses.at(COLUMN.t, poses.length - 1));
    }
    return newest;
  }
}
