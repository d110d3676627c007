// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { duration, seconds, withPrefix } from "../src/format";
import { selectRows } from "../src/plot_data";
import { COLUMN, ObjectTrack, StateLog, Store } from "../src/store";

const pose = (t_us, state = "tracking", p = [0, 0, 1]) => ({ t_us, seq: t_us / 1000, state, p, q: [1, 0, 0, 0] });
const INFO = { id: "cube", model: "models/cube", diameter_m: 0.3 };

test("changes of state are kept in the order of their times", () => {
  const log = new StateLog();
  log.add(100, "tracking", "");
  log.add(300, "lost", "contradicted");
  log.add(200, "degraded", "");
  log.add(250, "degraded", "few edges");
  log.add(400, "lost", "");
  assert.deepEqual(log.changes.map(({ t_us, state, reason }) => [t_us, state, reason]), [
    [100, "tracking", ""], [200, "degraded", "few edges"], [300, "lost", "contradicted"],
  ]);
  assert.deepEqual([50, 100, 299, 300].map((t) => log.indexAt(t)), [-1, 0, 1, 2]);
});

test("a state that is reported twice begins at the earlier time, and is one change", () => {
  const log = new StateLog();
  log.add(300, "tracking", "");
  log.add(200, "tracking", "found");
  log.add(250, "tracking", "");
  assert.deepEqual(log.changes, [{ t_us: 200, state: "tracking", reason: "found" }]);
  log.add(400, "lost", "");
  log.add(500, "tracking", "");
  log.add(400, "tracking", "");
  assert.deepEqual(log.changes, [{ t_us: 200, state: "tracking", reason: "found" }]);
  log.add(600, "lost", "");
  log.add(600, "degraded", "few edges");
  assert.deepEqual(log.changes.map(({ t_us, state }) => [t_us, state]), [[200, "tracking"], [600, "degraded"]]);
});

test("the number of changes is bounded", () => {
  const log = new StateLog();
  for (let i = 0; i < 10000; ++i) log.add(i, i % 2 === 0 ? "lost" : "tracking", "");
  assert.equal(log.changes.length, 4096);
  assert.equal(log.changes.at(-1).t_us, 9999);
});

test("a gap between the poses of a recording has no pose", () => {
  const track = new ObjectTrack(INFO, 0, true);
  const times = [0, 10, 20, 30, 40, 500, 510].map((ms) => ms * 1000);
  track.addPoses(times.map((t) => pose(t)));
  assert.deepEqual(track.log.changes.map(({ t_us, state }) => [t_us, state]), [[0, "tracking"], [40001, "none"], [500000, "tracking"]]);
  assert.equal(track.rowAt(40000), 4);
  assert.equal(track.rowAt(200000), -1);
  assert.equal(track.rowAt(505000), 5);
});

test("the gaps of a recording do not depend on the last message, which may have few poses", () => {
  for (const last of [[256], [256, 280]]) {
    const track = new ObjectTrack(INFO, 0, true);
    track.addPoses(Array.from({ length: 256 }, (_, i) => pose(33_000 * i)));
    track.addPoses(last.map((i) => pose(33_000 * i)));
    const { poses, log, gapUs } = track;
    const rows = selectRows(poses, 0, poses.length, 1000, gapUs);
    assert.equal(rows.filter((row) => row < 0).length, last.length - 1, "only the true gap");
    assert.deepEqual(log.changes.map(({ state }) => state), last.length === 1 ? ["tracking"] : ["tracking", "none", "tracking"]);
  }
});

test("a loss that the gateway reported is not replaced by a gap", () => {
  const track = new ObjectTrack(INFO, 0, true);
  track.log.add(41000, "lost", "contradicted");
  track.addPoses([0, 10, 20, 30, 40, 500, 510].map((ms) => pose(ms * 1000)));
  assert.deepEqual(track.log.changes.map(({ state }) => state), ["tracking", "lost", "tracking"]);
});

test("each ambiguous pose keeps its alternatives as long as the pose itself", () => {
  const alternative = (llr) => ({ p: [0, 0, 2], q: [1, 0, 0, 0], llr });
  const ambiguous = (t_us, ...ratios) => ({ ...pose(t_us, "ambiguous"), alternatives: ratios.map(alternative) });
  const ratiosAt = (track, t_us) => track.alternativesAt(track.rowAt(t_us)).map(({ llr }) => llr);
  const track = new ObjectTrack(INFO, 0, false);
  track.addPoses([ambiguous(1000, -1), pose(2000), ambiguous(3000, -2, -3, -4, -5, -6), pose(4000)]);
  assert.deepEqual([1000, 2000, 3000, 4000].map((t) => ratiosAt(track, t)), [[-1], [], [-2, -3, -4, -5], []]);
  // A session that continues earlier replaces the poses from there on.
  track.addPoses([pose(2500), pose(3000)]);
  assert.deepEqual([1000, 3000].map((t) => ratiosAt(track, t)), [[-1], []]);
  for (let i = 4; i <= 5000; ++i) track.addPoses([ambiguous(1000 * i, -i)]);
  assert.equal(track.alternatives.size, track.poses.length);
  assert.deepEqual(ratiosAt(track, 5_000_000), [-5000]);
});

test("a pose of an unknown state is shown as without state", () => {
  const track = new ObjectTrack(INFO, 0, false);
  track.addPoses([pose(1000, "dreaming")]);
  assert.equal(track.stateAt(1000), "none");
});

test("the poses of a live session are bounded, and the first one stays the origin", () => {
  const store = new Store();
  const camera = { width: 640, height: 480, fx_px: 500, fy_px: 500, cx_px: 320, cy_px: 240 };
  store.setScene({ type: "scene", session: "s", camera, objects: [INFO], recording: null, has_truth: false });
  for (let i = 1; i <= 10000; ++i) store.addPoses("cube", [pose(1000 * i, "tracking", [i, 0, 1])], false);
  const track = store.objects.get("cube");
  assert.equal(track.poses.length, 4096);
  assert.equal(track.poses.at(COLUMN.p, 4095), 10000);
  assert.deepEqual(track.origin, [1, 0, 1]);
  assert.equal(store.newestUs, 10_000_000);
  store.addPoses("unknown", [pose(1)], false);
});

test("the rates of a recording are those of its intervals, without a short last one", () => {
  const store = new Store();
  const rates = (to_us, counts) => {
    store.setRange({ type: "range", from_us: 1000, to_us, complete: true, events: { from_us: 1000, step_us: 100, counts } });
    return [...store.eventRates.column(0)].map((t_us, i) => [t_us, store.eventRates.at(1, i)]);
  };
  assert.deepEqual(rates(1299, [2, 0, 4]), [[1050, 20000], [1150, 0], [1250, 40000]]);
  assert.deepEqual(rates(1249, [2, 0, 4]), [[1050, 20000], [1150, 0], [1225, 80000]]);
  assert.deepEqual(rates(1248, [2, 0, 4]), [[1050, 20000], [1150, 0]]);
  assert.deepEqual(rates(1000, [1]), [[1000.5, 1e6]]);
  assert.deepEqual(rates(0, []), []);
});

test("numbers are written with their units", () => {
  assert.deepEqual([8.523e6, 12300, 7, 2.5e9, 999999, 999.6, NaN].map(withPrefix), ["8.52 M", "12.3 k", "7 ", "2.50 G", "1.00 M", "1.00 k", "–"]);
  assert.deepEqual([1500, 25000, 2.5e6, 190e6, 179.7e6].map(duration), ["1.5 ms", "25 ms", "2.50 s", "3 min 10 s", "3 min 0 s"]);
  assert.equal(seconds(16000018, 6), "16.000018");
});
