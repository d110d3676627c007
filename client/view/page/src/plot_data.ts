// SPDX-License-Identifier: Apache-2.0
// The series of the plots, in the form that uPlot takes: columns of equal length, null where a line is interrupted.
import type { Quaternion } from "./protocol";
import type { Series } from "./ring";
import { ContinuousRotation, DEGREES } from "./rotation";
import { COLUMN, TRUTH_COLUMN, type ObjectTrack } from "./store";

export type Column = (number | null)[];

/** The rows `from` to `to` of a series, at most about `limit` of them; -1 marks a gap before the row that follows. */
export function selectRows(series: Series, from: number, to: number, limit: number, gapUs: number): number[] {
  // Every stride-th row, counted from the first row ever added, so that the selection does not flicker as the window moves.
  const stride = Math.max(1, Math.ceil((to - from) / limit));
  const rows: number[] = [];
  let previousUs = NaN;
  for (let row = from + ((stride - ((series.removed + from) % stride)) % stride); row < to; row += stride) {
    const time = series.at(0, row);
    if (time - previousUs > gapUs * stride) rows.push(-1);
    rows.push(row);
    previousUs = time;
  }
  return rows;
}

/** Times in seconds; a gap gets the time in the middle. */
export function timeColumn(series: Series, rows: readonly number[]): number[] {
  return rows.map((row, i) => (row >= 0 ? series.at(0, row) : (series.at(0, rows[i - 1]!) + series.at(0, rows[i + 1]!)) / 2) / 1e6);
}

export function valueColumn(series: Series, rows: readonly number[], column: number, map: (value: number) => number = (value) => value): Column {
  return rows.map((row) => {
    const value = row >= 0 ? map(series.at(column, row)) : NaN;
    return Number.isFinite(value) ? value : null;
  });
}

/** Three components with their limits of 2 sigma: value, upper, lower for each. */
export function withTwoSigma(series: Series, rows: readonly number[], first: number, sigma: number, map: (value: number, i: number) => number): Column[] {
  return [0, 1, 2].flatMap((i) => [0, 2, -2].map((factor) =>
    rows.map((row) => {
      if (row < 0) return null;
      const value = series.at(first + i, row);
      const result = map(factor === 0 ? value : value + factor * series.at(sigma + i, row), i);
      return Number.isFinite(result) ? result : null;
    })));
}

export interface Reference {
  /** Subtracted from positions, m. */
  origin: readonly number[];
  /** 1000 for millimetres. */
  scale: number;
}

export function positionColumns(track: ObjectTrack, rows: readonly number[], reference: Reference): Column[] {
  return withTwoSigma(track.poses, rows, COLUMN.p, COLUMN.sigma, (value, i) => (value - reference.origin[i]!) * reference.scale);
}

export function rotationColumns(track: ObjectTrack, rows: readonly number[]): Column[] {
  return withTwoSigma(track.poses, rows, COLUMN.rotation, COLUMN.sigma + 3, (value) => value * DEGREES);
}

/** Truth: times (s), three positions, three components of the rotation relative to the first pose of the estimate (degrees). */
export function truthColumns(track: ObjectTrack, reference: Reference): { times: number[]; position: Column[]; rotation: Column[] } {
  const { truth, poses } = track;
  const rows = Array.from({ length: truth.length }, (_, i) => i);
  const quaternion = (series: Series, column: number, row: number) => [0, 1, 2, 3].map((i) => series.at(column + i, row)) as Quaternion;
  const rotation = new ContinuousRotation();
  if (poses.length > 0) rotation.next(quaternion(poses, COLUMN.q, 0));
  const vectors = rows.map((row) => rotation.next(quaternion(truth, TRUTH_COLUMN.q, row)));
  return {
    times: timeColumn(truth, rows),
    position: [0, 1, 2].map((i) => valueColumn(truth, rows, TRUTH_COLUMN.p + i, (value) => (value - reference.origin[i]!) * reference.scale)),
    rotation: [0, 1, 2].map((i) => vectors.map((vector) => vector[i]! * DEGREES)),
  };
}
