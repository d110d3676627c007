// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { conjugate, ContinuousRotation, eigenSymmetric3, multiply, rotationVector } from "../src/rotation";

const about = (axis, angle) => [Math.cos(angle / 2), ...axis.map((x) => x * Math.sin(angle / 2))];
const assertNear = (actual, expected, tolerance) => {
  assert.equal(actual.length, expected.length);
  actual.forEach((x, i) => assert.ok(Math.abs(x - expected[i]) <= tolerance, `${actual} is not ${expected}`));
};

test("a rotation vector is axis times angle, for both signs of the quaternion", () => {
  const axis = [0.6, 0, 0.8];
  for (const angle of [0, 1e-14, 1e-5, 1, 3.1]) {
    const q = about(axis, angle);
    assertNear(rotationVector(q), axis.map((x) => x * angle), 1e-12);
    assertNear(rotationVector(q.map((x) => -x)), axis.map((x) => x * angle), 1e-12);
  }
});

test("turns of more than half a circle, in both directions, give no jump", () => {
  for (const direction of [1, -1]) {
    const rotation = new ContinuousRotation();
    const start = about([0, 0.6, 0.8], 1.1);
    let previous = [0, 0, 0];
    for (let angle = 0; angle < 20; angle += 0.05) {
      const vector = rotation.next(multiply(about([0, 1, 0], direction * angle), start));
      assertNear(vector, [0, direction * angle, 0], 1e-9);
      assert.ok(Math.hypot(...vector.map((x, i) => x - previous[i])) < 0.06);
      previous = vector;
    }
  }
});

test("the vector, as a rotation, leads from the first orientation to the present one", () => {
  const rotation = new ContinuousRotation();
  const first = about([0, 0, 1], 0.3);
  rotation.next(first);
  for (let i = 1; i < 200; ++i) {
    const q = multiply(about([Math.sin(i), Math.cos(i), 0], 0.04 * i), first);
    const vector = rotation.next(q);
    const angle = Math.hypot(...vector);
    const back = multiply(conjugate(multiply(about(vector.map((x) => x / angle), angle), first)), q);
    assert.ok(Math.abs(Math.abs(back[0]) - 1) < 1e-9);
  }
});

test("eigenvalues and axes rebuild the matrix", () => {
  const upper = [4, 1, -0.5, 3, 0.7, 2];
  const { values, axes } = eigenSymmetric3(upper);
  const pairs = [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]];
  assertNear(pairs.map(([i, j]) => values.reduce((sum, value, k) => sum + value * axes[k][i] * axes[k][j], 0)), upper, 1e-12);
});
