// SPDX-License-Identifier: Apache-2.0
// Rotations for plots and for the uncertainty ellipsoid.
import type { Quaternion, Vector3 } from "./protocol";

export const DEGREES = 180 / Math.PI;

/** a * b. */
export function multiply(a: Quaternion, b: Quaternion): Quaternion {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

export function conjugate(q: Quaternion): Quaternion {
  return [q[0], -q[1], -q[2], -q[3]];
}

/** The rotation vector (rad) of a unit quaternion, with an angle of at most pi. */
export function rotationVector(q: Quaternion): Vector3 {
  const sign = q[0] < 0 ? -1 : 1;
  const sine = Math.hypot(q[1], q[2], q[3]);
  if (sine < 1e-12) return [2 * sign * q[1], 2 * sign * q[2], 2 * sign * q[3]];
  const scale = (sign * 2 * Math.atan2(sine, sign * q[0])) / sine;
  return [scale * q[1], scale * q[2], scale * q[3]];
}

/** Of the rotation vectors that mean the same rotation as `vector`, the one nearest to `previous`. */
export function nearestRotationVector(vector: Vector3, previous: Vector3): Vector3 {
  const angle = Math.hypot(...vector);
  let axis: Vector3;
  if (angle > 1e-9) axis = [vector[0] / angle, vector[1] / angle, vector[2] / angle];
  else {
    const length = Math.hypot(...previous);
    if (length < Math.PI) return vector;
    axis = [previous[0] / length, previous[1] / length, previous[2] / length];
  }
  const along = axis[0] * previous[0] + axis[1] * previous[1] + axis[2] * previous[2];
  const turned = angle + 2 * Math.PI * Math.round((along - angle) / (2 * Math.PI));
  return [axis[0] * turned, axis[1] * turned, axis[2] * turned];
}

/** Rotation vectors of rotations relative to the first one, without jumps by whole turns. */
export class ContinuousRotation {
  private first: Quaternion | null = null;
  private previous: Vector3 = [0, 0, 0];

  reset(): void {
    this.first = null;
    this.previous = [0, 0, 0];
  }

  /** The rotation vector (rad) of q relative to the first q, on the left as the covariance is: q * first^-1. */
  next(q: Quaternion): Vector3 {
    this.first ??= q;
    this.previous = nearestRotationVector(rotationVector(multiply(q, conjugate(this.first))), this.previous);
    return this.previous;
  }
}

/** Eigenvalues and eigenvectors (columns of `axes`, a right-handed frame) of a symmetric 3x3 matrix given by its upper triangle. */
export function eigenSymmetric3(upper: readonly number[]): { values: Vector3; axes: Vector3[] } {
  const a = [
    [upper[0]!, upper[1]!, upper[2]!],
    [upper[1]!, upper[3]!, upper[4]!],
    [upper[2]!, upper[4]!, upper[5]!],
  ];
  const v = [
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
  ];
  // Jacobi rotations; three sweeps more than double precision needs.
  for (let sweep = 0; sweep < 10; ++sweep) {
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]] as const) jacobiRotate(a, v, p, q);
  }
  const axes = [0, 1, 2].map((i): Vector3 => [v[0]![i]!, v[1]![i]!, v[2]![i]!]);
  return { values: [a[0]![0]!, a[1]![1]!, a[2]![2]!], axes };
}

function jacobiRotate(a: number[][], v: number[][], p: number, q: number): void {
  if (a[p]![q] === 0) return;
  const angle = 0.5 * Math.atan2(2 * a[p]![q]!, a[q]![q]! - a[p]![p]!);
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const turn = (matrix: number[][], row: number, i: number, j: number) => {
    const [x, y] = [matrix[row]![i]!, matrix[row]![j]!];
    matrix[row]![i] = c * x - s * y;
    matrix[row]![j] = s * x + c * y;
  };
  for (let k = 0; k < 3; ++k) turn(a, k, p, q);
  for (let k = 0; k < 3; ++k) {
    const [x, y] = [a[p]![k]!, a[q]![k]!];
    a[p]![k] = c * x - s * y;
    a[q]![k] = s * x + c * y;
  }
  for (let k = 0; k < 3; ++k) turn(v, k, p, q);
}
