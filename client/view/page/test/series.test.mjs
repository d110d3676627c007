// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { CellAccumulator } from "../src/cells";
import { selectRows, timeColumn, valueColumn } from "../src/plot_data";
import { Series } from "../src/ring";

test("a series keeps its newest rows", () => {
  const series = new Series(2, 100);
  for (let i = 0; i < 1000; ++i) series.push([i, 10 * i]);
  assert.equal(series.length, 100);
  assert.equal(series.removed, 900);
  assert.deepEqual([series.at(0, 0), series.at(1, 99)], [900, 9990]);
  assert.deepEqual([...series.column(0)], Array.from({ length: 100 }, (_, i) => 900 + i));
});

test("rows are found by time", () => {
  const series = new Series(1, 10);
  for (const time of [10, 20, 30]) series.push([time]);
  assert.deepEqual([5, 10, 15, 30, 99].map((time) => series.lastAt(time)), [-1, 0, 0, 2, 2]);
  assert.deepEqual([5, 10, 15, 30, 99].map((time) => series.lowerBound(time)), [0, 0, 1, 2, 3]);
});

test("a row of an earlier time replaces the rows from there on", () => {
  const series = new Series(2, 10);
  for (const time of [10, 20, 30]) series.push([time, 1]);
  series.push([20, 2]);
  assert.deepEqual([...series.column(0)], [10, 20]);
  assert.deepEqual([...series.column(1)], [1, 2]);
});

test("a gap interrupts the line of a plot", () => {
  const series = new Series(2, 10);
  for (const time of [1e6, 2e6, 6e6, 7e6]) series.push([time, time / 1e6]);
  const rows = selectRows(series, 0, 4, 100, 1.5e6);
  assert.deepEqual(timeColumn(series, rows), [1, 2, 4, 6, 7]);
  assert.deepEqual(valueColumn(series, rows, 1), [1, 2, null, 6, 7]);
});

test("the rows that a plot shows stay the same while older ones are removed", () => {
  const series = new Series(1, 100);
  const shown = (count) => {
    for (let i = 0; i < count; ++i) series.push([series.length === 0 ? 0 : series.at(0, series.length - 1) + 1]);
    return selectRows(series, 0, series.length, 10, Infinity).map((row) => series.at(0, row));
  };
  const first = shown(200);
  const second = shown(5);
  assert.ok(first.length <= 11 && first.length >= 9);
  assert.deepEqual(first.filter((time) => time >= second[0]), second.filter((time) => time <= first.at(-1)));
});

const COLOURS = { background: 0xff000000, on: 0xffffffff, off: 0xffff0000, both: 0xff00ff00 };

function painted(accumulator, windowUs) {
  const pixels = new Uint32Array(accumulator.width * accumulator.height);
  accumulator.paint(pixels, windowUs);
  return [...pixels];
}

test("cells get the colours of their polarity", () => {
  const accumulator = new CellAccumulator();
  accumulator.setColours(COLOURS);
  accumulator.add(new Uint8Array([0b11100100]), 2, 2, 1000, true);
  assert.deepEqual(painted(accumulator, 100), [COLOURS.background, COLOURS.on, COLOURS.off, COLOURS.both]);
});

test("live images are accumulated over the window and fade with age", () => {
  const accumulator = new CellAccumulator();
  accumulator.setColours(COLOURS);
  accumulator.add(new Uint8Array([0b00000001]), 2, 2, 10000, false);
  accumulator.add(new Uint8Array([0b00000100]), 2, 2, 20000, false);
  const [old, fresh] = painted(accumulator, 15000);
  assert.equal(fresh, COLOURS.on);
  assert.ok((old & 255) > 0 && (old & 255) < 255);
  assert.deepEqual(painted(accumulator, 5000).slice(0, 2), [COLOURS.background, COLOURS.on]);
});

test("the newest image is shown even if it is longer than the window", () => {
  const accumulator = new CellAccumulator();
  accumulator.setColours(COLOURS);
  accumulator.add(new Uint8Array([1]), 2, 2, 10000, false);
  assert.equal(painted(accumulator, 0)[0], COLOURS.on);
});

test("images of a recording, of an earlier time and of another size replace what was shown", () => {
  const accumulator = new CellAccumulator();
  accumulator.setColours(COLOURS);
  accumulator.add(new Uint8Array([1]), 2, 2, 10000, false);
  accumulator.add(new Uint8Array([4]), 2, 2, 10001, true);
  assert.deepEqual(painted(accumulator, 1e6).slice(0, 2), [COLOURS.background, COLOURS.on]);
  accumulator.add(new Uint8Array([1]), 2, 2, 500, false);
  assert.deepEqual(painted(accumulator, 1e6).slice(0, 2), [COLOURS.on, COLOURS.background]);
  accumulator.add(new Uint8Array([16]), 3, 1, 600, false);
  assert.deepEqual(painted(accumulator, 1e6), [COLOURS.background, COLOURS.background, COLOURS.on]);
});

test("times beyond 32 bits of microseconds are shown", () => {
  const accumulator = new CellAccumulator();
  accumulator.setColours(COLOURS);
  for (let i = 0; i < 5; ++i) {
    accumulator.add(new Uint8Array([1]), 1, 1, 2e9 * i, false);
    assert.deepEqual(painted(accumulator, 1000), [COLOURS.on]);
  }
});
