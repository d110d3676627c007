// SPDX-License-Identifier: Apache-2.0
// Series of bounded length: when one is full, its oldest rows make room.

/** Rows of `columns` numbers, ordered by the first, which is a time. */
export class Series {
  /** Contiguous columns; the rows are those from `start` to `end`. */
  private readonly data: Float64Array[];
  private start = 0;
  private end = 0;
  /** Number of rows that have been removed at the front. */
  removed = 0;

  constructor(
    readonly columns: number,
    readonly capacity: number,
  ) {
    // Twice the capacity: rows are moved to the front once in `capacity` additions, and each column stays contiguous.
    this.data = Array.from({ length: columns }, () => new Float64Array(2 * capacity));
  }

  get length(): number {
    return this.end - this.start;
  }

  /** Adds a row. One whose time is not later than that of the last row replaces the rows from its time on. */
  push(row: readonly number[]): void {
    const times = this.data[0]!;
    if (this.length > 0 && row[0]! <= times[this.end - 1]!) this.end = this.start + this.lowerBound(row[0]!);
    if (this.end === times.length) {
      for (const column of this.data) column.copyWithin(0, this.start, this.end);
      this.end -= this.start;
      this.start = 0;
    }
    for (let i = 0; i < this.columns; ++i) this.data[i]![this.end] = row[i] ?? NaN;
    ++this.end;
    if (this.length > this.capacity) {
      ++this.start;
      ++this.removed;
    }
  }

  /** A view of the rows `from` to `to` of a column; invalid after the next push(). */
  column(index: number, from = 0, to = this.length): Float64Array {
    return this.data[index]!.subarray(this.start + from, this.start + to);
  }

  at(column: number, row: number): number {
    return this.data[column]![this.start + row]!;
  }

  /** The first row whose time is not before `time`. */
  lowerBound(time: number): number {
    const times = this.data[0]!;
    let low = this.start;
    let high = this.end;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle]! < time) low = middle + 1;
      else high = middle;
    }
    return low - this.start;
  }

  /** The last row whose time is not after `time`; -1 if there is none. */
  lastAt(time: number): number {
    const row = this.lowerBound(time);
    return row < this.length && this.at(0, row) === time ? row : row - 1;
  }
}
