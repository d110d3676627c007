// SPDX-License-Identifier: Apache-2.0
import assert from "node:assert/strict";
import { test } from "node:test";
import { deflateSync } from "node:zlib";
import { decodeBinary, packedCells } from "../src/protocol";

function pack(header, sections) {
  const text = new TextEncoder().encode(JSON.stringify({ ...header, sections: sections.map((section) => section.byteLength) }));
  const padded = (length) => (length + 3) & ~3;
  const size = padded(4 + text.length) + sections.reduce((sum, section) => sum + padded(section.byteLength), 0);
  const data = new Uint8Array(size);
  new DataView(data.buffer).setUint32(0, text.length, true);
  data.set(text, 4);
  let offset = padded(4 + text.length);
  for (const section of sections) {
    data.set(new Uint8Array(section.buffer, section.byteOffset, section.byteLength), offset);
    offset += padded(section.byteLength);
  }
  return data.buffer;
}

// 3 x 3 cells: 3 bytes, so that the next section begins after padding.
const CELLS = new Uint8Array([0b11100100, 0b00000001, 0b00000010]);
const OUTLINE = { object: "cube", state: "tracking", t_us: 1500, segments: 2, truth: false };
const HEADER = {
  type: "image", number: 7, t_us: 1500, from_us: 1000, to_us: 2000, cell_px: 2, width: 3, height: 3, events: 9, skipped: 4, encoding: "packed",
  outlines: [OUTLINE],
};
const SEGMENTS = new Float32Array([1.5, 2, 3, 4, 5, 6, 7, 8]);
const KINDS = new Uint8Array([0, 3]);

test("an image with its outline is decoded", async () => {
  const image = decodeBinary(pack(HEADER, [CELLS, SEGMENTS, KINDS]));
  assert.equal(image.number, 7);
  assert.equal(image.t_us, 1500);
  assert.deepEqual([image.fromUs, image.toUs, image.cellPx, image.events, image.skipped], [1000, 2000, 2, 9, 4]);
  assert.deepEqual(await packedCells(image), CELLS);
  assert.equal(image.outlines.length, 1);
  assert.deepEqual([...image.outlines[0].segments], [...SEGMENTS]);
  assert.deepEqual([...image.outlines[0].kinds], [0, 3]);
  assert.equal(image.outlines[0].truth, false);
});

test("compressed cells are inflated", async () => {
  const image = decodeBinary(pack({ ...HEADER, encoding: "zlib" }, [new Uint8Array(deflateSync(CELLS)), SEGMENTS, KINDS]));
  assert.deepEqual(await packedCells(image), CELLS);
});

test("cells of another number than the header says are refused", async () => {
  const long = decodeBinary(pack({ ...HEADER, encoding: "zlib" }, [new Uint8Array(deflateSync(new Uint8Array(1 << 20))), SEGMENTS, KINDS]));
  await assert.rejects(packedCells(long), /more cells than its header says/);
  const short = decodeBinary(pack(HEADER, [CELLS.subarray(1), SEGMENTS, KINDS]));
  await assert.rejects(packedCells(short), /2 bytes of cells instead of 3/);
});

test("damaged compressed cells are refused", async () => {
  const damaged = new Uint8Array(deflateSync(CELLS));
  damaged[0] ^= 0xff;
  await assert.rejects(packedCells(decodeBinary(pack({ ...HEADER, encoding: "zlib" }, [damaged, SEGMENTS, KINDS]))));
});

test("a message that is cut at any byte is refused", () => {
  const data = pack(HEADER, [CELLS, SEGMENTS, KINDS]);
  // The last section has 2 bytes of padding, which may be missing.
  for (let length = 0; length < data.byteLength - 2; ++length) assert.throws(() => decodeBinary(data.slice(0, length)), Error, `${length} bytes`);
});

test("false sizes are refused", () => {
  for (const [header, sections] of [
    [{ ...HEADER, width: 1e9 }, [CELLS, SEGMENTS, KINDS]],
    [{ ...HEADER, width: -3 }, [CELLS, SEGMENTS, KINDS]],
    [{ ...HEADER, to_us: "2000" }, [CELLS, SEGMENTS, KINDS]],
    [{ ...HEADER, encoding: "lz4" }, [CELLS, SEGMENTS, KINDS]],
    [{ ...HEADER, outlines: [{ ...OUTLINE, segments: 3 }] }, [CELLS, SEGMENTS, KINDS]],
    [HEADER, [CELLS, SEGMENTS.subarray(1), KINDS]],
  ]) {
    assert.throws(() => decodeBinary(pack(header, sections)), /damaged/);
  }
});

test("a geometry is decoded, and one with a face of missing vertices is refused", () => {
  const header = { type: "geometry", object: "cube", diameter_m: 0.3 };
  const vertices = new Float32Array(9).fill(0.1);
  const edges = new Float32Array([0, 0, 0, 1, 1, 1]);
  const geometry = decodeBinary(pack(header, [vertices, new Uint32Array([0, 1, 2]), edges]));
  assert.deepEqual([geometry.object, geometry.diameterM, geometry.vertices.length, [...geometry.faces]], ["cube", 0.3, 9, [0, 1, 2]]);
  assert.throws(() => decodeBinary(pack(header, [vertices, new Uint32Array([0, 1, 3]), edges])), /vertex that does not exist/);
});

test("a message of an unknown type is skipped", () => {
  assert.equal(decodeBinary(pack({ type: "later" }, [])), null);
});
