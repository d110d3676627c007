// SPDX-License-Identifier: Apache-2.0
// Event images with the age of each cell: live images contain the events since the previous image, and are accumulated here.

export interface CellColours {
  /** The colour of a cell without events, 0xAABBGGRR (the byte order of ImageData on little-endian machines). */
  background: number;
  on: number;
  off: number;
  both: number;
}

const AGE_STEPS = 64;
/** The share of its colour that the oldest event of the window keeps. */
const OLDEST_SHARE = 0.3;
const NEVER = -0x80000000;
const REBASE_US = 0x40000000;

function mix(colour: number, background: number, share: number): number {
  let result = 0xff000000;
  for (const shift of [0, 8, 16]) {
    const from = (background >>> shift) & 0xff;
    result |= Math.round(from + share * (((colour >>> shift) & 0xff) - from)) << shift;
  }
  return result >>> 0;
}

export class CellAccumulator {
  width = 0;
  height = 0;
  private kinds = new Uint8Array(0);
  /** Microseconds since baseUs. */
  private times = new Int32Array(0);
  private baseUs = 0;
  private lastUs = 0;
  private palette = new Uint32Array(4 * AGE_STEPS);

  setColours(colours: CellColours): void {
    const kinds = [colours.background, colours.on, colours.off, colours.both];
    for (let kind = 0; kind < 4; ++kind) {
      for (let age = 0; age < AGE_STEPS; ++age) {
        const share = 1 - ((1 - OLDEST_SHARE) * age) / (AGE_STEPS - 1);
        this.palette[kind * AGE_STEPS + age] = mix(kinds[kind]!, colours.background, share);
      }
    }
  }

  clear(): void {
    this.kinds.fill(0);
    this.times.fill(NEVER);
  }

  /** Adds an image of packed cells with two bits each. If `replaces` is true, older events are removed. */
  add(packed: Uint8Array, width: number, height: number, toUs: number, replaces: boolean): void {
    const count = width * height;
    if (width !== this.width || height !== this.height) {
      this.width = width;
      this.height = height;
      this.kinds = new Uint8Array(count);
      this.times = new Int32Array(count).fill(NEVER);
    }
    // Times go back if another recording or another session begins.
    if (replaces || toUs < this.lastUs || toUs - this.baseUs > REBASE_US) {
      this.clear();
      this.baseUs = toUs;
    }
    this.lastUs = toUs;
    const time = toUs - this.baseUs;
    for (let i = 0; i < packed.length; ++i) {
      let four = packed[i]!;
      for (let cell = 4 * i; four !== 0 && cell < count; ++cell, four >>= 2) {
        const kind = four & 3;
        if (kind === 0) continue;
        this.kinds[cell] = kind;
        this.times[cell] = time;
      }
    }
  }

  /** Writes the colours of the events of the last `windowUs` before the last image's end. */
  paint(pixels: Uint32Array, windowUs: number): void {
    const { kinds, times, palette } = this;
    const now = this.lastUs - this.baseUs;
    const oldest = now - windowUs;
    const scale = (AGE_STEPS - 1) / Math.max(windowUs, 1);
    const background = palette[0]!;
    for (let i = 0; i < kinds.length; ++i) {
      const kind = kinds[i]!;
      const time = times[i]!;
      pixels[i] = kind !== 0 && (time > oldest || time === now) ? palette[kind * AGE_STEPS + (((now - time) * scale) | 0)]! : background;
    }
  }
}
