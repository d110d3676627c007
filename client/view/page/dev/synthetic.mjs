// SPDX-License-Identifier: Apache-2.0
// A synthetic scene for the fake gateway: convex objects on smooth paths, their visible edges, events along these, and states
// that repeat every 12 s. Everything is a function of the time, so that an instant looks the same each time.

export const CAMERA = { width: 1280, height: 720, fx_px: 1700, fy_px: 1700, cx_px: 640, cy_px: 360 };

const PRISM_SIDES = 6;

function box([a, b, c]) {
  const vertices = [];
  for (let i = 0; i < 8; ++i) vertices.push([(i & 1 ? a : -a) / 2, (i & 2 ? b : -b) / 2, (i & 4 ? c : -c) / 2]);
  return solid(vertices, [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]);
}

function prism(radius, height) {
  const vertices = [];
  for (const z of [-height / 2, height / 2]) {
    for (let i = 0; i < PRISM_SIDES; ++i) {
      const angle = (2 * Math.PI * i) / PRISM_SIDES;
      vertices.push([radius * Math.cos(angle), radius * Math.sin(angle), z]);
    }
  }
  const ring = Array.from({ length: PRISM_SIDES }, (_, i) => i);
  const sides = ring.map((i) => [i, (i + 1) % PRISM_SIDES, PRISM_SIDES + ((i + 1) % PRISM_SIDES), PRISM_SIDES + i]);
  return solid(vertices, [[...ring].reverse(), ring.map((i) => PRISM_SIDES + i), ...sides]);
}

/** A convex solid; the corners of each polygon are in counterclockwise order, seen from outside. */
function solid(vertices, polygons) {
  const edges = new Map();
  polygons.forEach((polygon, face) => {
    polygon.forEach((a, i) => {
      const b = polygon[(i + 1) % polygon.length];
      const key = a < b ? `${a} ${b}` : `${b} ${a}`;
      if (!edges.has(key)) edges.set(key, { a, b, faces: [] });
      edges.get(key).faces.push(face);
    });
  });
  const faces = polygons.flatMap((polygon) => polygon.slice(2).map((c, i) => [polygon[0], polygon[i + 1], c]));
  const diameter_m = 2 * Math.max(...vertices.map((v) => Math.hypot(...v)));
  return { vertices, polygons, edges: [...edges.values()], faces, diameter_m };
}

const SOLIDS = [box([0.16, 0.1, 0.07]), prism(0.06, 0.05), box([0.08, 0.08, 0.08])];
const NAMES = ["gearbox", "hex nut", "cube"];

export function objects(count) {
  return SOLIDS.slice(0, count).map(({ diameter_m }, i) => ({ id: NAMES[i], model: `models/${NAMES[i].replace(" ", "-")}`, diameter_m }));
}

export function geometry(index) {
  const { vertices, faces, edges, diameter_m } = SOLIDS[index];
  return {
    diameter_m,
    vertices: new Float32Array(vertices.flat()),
    faces: new Uint32Array(faces.flat()),
    edges: new Float32Array(edges.flatMap(({ a, b }) => [...vertices[a], ...vertices[b]])),
  };
}

function motion(index, t) {
  const s = 2 * Math.PI * t + 2 * index;
  const p = [
    [0.05, -0.13, 0.15][index] + 0.03 * Math.sin(0.5 * s),
    [0.0, 0.05, -0.06][index] + 0.02 * Math.sin(0.37 * s + 1),
    [0.55, 0.62, 0.7][index] + 0.05 * Math.sin(0.21 * s),
  ];
  const v = [0.4 + 0.5 * Math.sin(0.3 * s), 0.7 + 0.4 * t * (index === 1 ? 1 : 0) + 0.5 * Math.sin(0.23 * s), 0.3 * Math.sin(0.41 * s)];
  const angle = Math.hypot(...v);
  const k = Math.sin(angle / 2) / angle;
  return { p, q: [Math.cos(angle / 2), k * v[0], k * v[1], k * v[2]] };
}

function rotate([w, x, y, z], [a, b, c]) {
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
}

/** The state of an object at a time of the period of 12 s. */
export function stateAt(index, t_us) {
  const t = ((t_us / 1e6 + 3.7 * index) % 12 + 12) % 12;
  if (t < 0.4) return { state: "initializing", reason: "no region of the image has more events than the noise" };
  if (t >= 3 && t < 3.7) return { state: "degraded", reason: "the events support 31 % of the visible edges" };
  if (t >= 6 && t < 6.6) return { state: "lost", reason: "the events contradict the pose: explained share 0.12 for 40 ms" };
  if (t >= 8.5 && t < 9.2) return { state: "ambiguous", reason: "two poses explain the events" };
  return { state: "tracking", reason: "" };
}

export function truthAt(index, t_us) {
  return { t_us, seq: 0, state: "tracking", ...motion(index, t_us / 1e6) };
}

/** The pose of an object, or null while it has none. */
export function poseAt(index, t_us, seq) {
  const { state } = stateAt(index, t_us);
  if (state === "lost" || state === "initializing") return null;
  const [before, here] = [motion(index, t_us / 1e6 - 1e-4), motion(index, t_us / 1e6)];
  const wide = state === "tracking" ? 1 : 4;
  const noise = (i) => wide * (random(t_us * 7 + i) - 0.5);
  const p = here.p.map((x, i) => x + 4e-4 * noise(i) * (i === 2 ? 3 : 1));
  const pose = {
    t_us, seq, state, p, q: here.q,
    sigma: [2e-4, 2e-4, 6e-4, 0.004, 0.004, 0.003].map((x) => x * wide),
    cov3: [4e-8, 1e-8, 3e-8, 5e-8, -2e-8, 3.6e-7].map((x) => x * wide * wide),
    v: here.p.map((x, i) => (x - before.p[i]) / 1e-4),
    w: [1, 2, 3].map((i) => (2 * (here.q[i] - before.q[i])) / 1e-4),
    explained: Math.min(1, (state === "tracking" ? 0.86 : 0.45) + 0.08 * noise(9)),
  };
  if (state === "ambiguous") pose.alternatives = [{ p: here.p, q: [here.q[3], here.q[2], here.q[1], here.q[0]], llr: -2.1 }];
  return pose;
}

/** Visible edges in pixels of the sensor: x1, y1, x2, y2 of each, and their kinds. */
export function outline(index, { p, q }) {
  const { vertices, polygons, edges } = SOLIDS[index];
  const seen = vertices.map((v) => rotate(q, v).map((x, i) => x + p[i]));
  const image = seen.map(([x, y, z]) => [(CAMERA.fx_px * x) / z + CAMERA.cx_px, (CAMERA.fy_px * y) / z + CAMERA.cy_px]);
  const isFront = polygons.map((polygon) => {
    let area = 0;
    polygon.forEach((a, i) => {
      const [[x1, y1], [x2, y2]] = [image[a], image[polygon[(i + 1) % polygon.length]]];
      area += x1 * y2 - x2 * y1;
    });
    // With y down, corners that are counterclockwise from outside are clockwise in numbers: their area is negative.
    return area < 0;
  });
  const visible = edges.filter(({ faces }) => faces.some((face) => isFront[face]));
  return {
    segments: new Float32Array(visible.flatMap(({ a, b }) => [...image[a], ...image[b]])),
    kinds: new Uint8Array(visible.map(({ faces }) => (faces.every((face) => isFront[face]) ? 0 : 3))),
  };
}

/** A pseudo-random number in [0, 1) for an integer or a time. */
export function random(seed) {
  let x = Math.imul(Math.floor(seed) ^ 0x9e3779b9, 0x85ebca6b);
  x = Math.imul(x ^ (x >>> 13), 0xc2b2ae35);
  return ((x ^ (x >>> 16)) >>> 0) / 4294967296;
}

/** Packed cells of the events between two times, and their number: along the edges, and `noise` more anywhere. */
export function eventCells(count, fromUs, toUs, cellPx, noise) {
  const width = Math.ceil(CAMERA.width / cellPx);
  const height = Math.ceil(CAMERA.height / cellPx);
  const cells = new Uint8Array(Math.ceil((width * height) / 4));
  let events = 0;
  const add = (x, y, kind) => {
    const [column, row] = [Math.round(x / cellPx), Math.round(y / cellPx)];
    if (!(column >= 0 && column < width && row >= 0 && row < height)) return;
    const cell = row * width + column;
    cells[cell >> 2] |= kind << (2 * (cell & 3));
    ++events;
  };
  let seed = Math.floor(toUs / 1000) * 131;
  const next = () => random(++seed);
  const steps = Math.max(1, Math.min(8, Math.round((toUs - fromUs) / 4000)));
  for (let index = 0; index < count; ++index) {
    for (let step = 0; step < steps; ++step) {
      const { segments } = outline(index, motion(index, (toUs - ((step + next()) / steps) * (toUs - fromUs)) / 1e6));
      for (let i = 0; i < segments.length; i += 4) {
        const [x1, y1, x2, y2] = segments.subarray(i, i + 4);
        const n = Math.hypot(x2 - x1, y2 - y1) * 0.4;
        const kind = (i / 4 + index) % 2 === 0 ? 1 : 2;
        for (let k = 0; k < n; ++k) {
          const a = next();
          add(x1 + a * (x2 - x1) + next() - 0.5, y1 + a * (y2 - y1) + next() - 0.5, next() < 0.93 ? kind : 3 - kind);
        }
      }
    }
  }
  for (let i = 0; i < noise; ++i) add(next() * CAMERA.width, next() * CAMERA.height, next() < 0.6 ? 1 : 2);
  return { width, height, cells, events };
}
