// SPDX-License-Identifier: Apache-2.0
// A gateway that plays a synthetic scene, for developing the page and for its tests (tests/view/page_test.py).
//   node dev/fake_gateway.mjs [--mode live|recording] [--objects 1..3] [--list] [--gone] [--truth] [--frame camera|base|object] [--noise EVENTS_PER_IMAGE] [--port PORT]
// With --frame, the same numbers are poses in this frame. With --gone, the session of the address has ended before the page is opened.
// It prints the address of the page. The tests ask it, by HTTP, for what it sent: /test/image, /test/pose, /test/figures; let
// it send a text or a damaged message to all pages: /test/text, /test/damage; and let it close all connections: /test/drop.
import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";
import { deflateSync } from "node:zlib";
import { CAMERA, eventCells, geometry, objects, outline, poseAt, stateAt, truthAt } from "./synthetic.mjs";
import { WebSocketPeer } from "./websocket.mjs";

const { values: options } = parseArgs({
  options: {
    mode: { type: "string", default: "live" },
    objects: { type: "string", default: "1" },
    list: { type: "boolean", default: false },
    gone: { type: "boolean", default: false },
    truth: { type: "boolean", default: false },
    frame: { type: "string", default: "camera" },
    noise: { type: "string", default: "1500" },
    port: { type: "string", default: "0" },
    dist: { type: "string", default: join(dirname(fileURLToPath(import.meta.url)), "../dist") },
  },
});
const KEY = "0123456789abcdef0123456789abcdef";
const IS_LIVE = options.mode === "live";
const OBJECTS = objects(Number(options.objects));
const START_US = 16_000_000;
const RECORDING = { from_us: START_US, to_us: START_US + 10_000_000 };
const POSE_STEP_US = 2000;
const MAX_OPEN_IMAGES = 2;
const startedMs = performance.now();

const FRAMES = {
  camera: { name: "camera", transform: "camera_from_object", pose_of: "object", camera: null },
  base: { name: "base", transform: "base_from_object", pose_of: "object", camera: { p: [0.2, -0.3, 1.1], q: [0.5, 0.5, -0.5, 0.5] } },
  object: { name: "object", transform: "object_from_camera", pose_of: "camera", camera: null },
};
const FILES = { "/": ["index.html", "text/html"], "/app.js": ["app.js", "text/javascript"], "/app.css": ["app.css", "text/css"], "/licenses.txt": ["licenses.txt", "text/plain"] };
const HEADERS = {
  "Content-Security-Policy":
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'",
  "X-Content-Type-Options": "nosniff",
  "Referrer-Policy": "no-referrer",
};

/** A binary message: the header, and the sections, each padded to a multiple of 4 bytes. */
function pack(header, sections) {
  const bytes = sections.map((section) => Buffer.from(section.buffer, section.byteOffset, section.byteLength));
  const text = Buffer.from(JSON.stringify({ ...header, sections: bytes.map(({ length }) => length) }));
  const pad = (length) => Buffer.alloc((4 - (length & 3)) & 3);
  const size = Buffer.alloc(4);
  size.writeUInt32LE(text.length);
  return Buffer.concat([size, text, pad(text.length), ...bytes.flatMap((section) => [section, pad(section.length)])]);
}

const viewers = new Set();
const figures = { images_sent: 0, images_skipped: 0, acknowledged: 0, connections: 0 };
let lastImage = null;

class Viewer {
  settings = { window_ms: 33, cell_px: 2, rate_hz: 30 };
  session = IS_LIVE && options.list ? "" : "sessions/bench-1";
  imageNumber = 0;
  open = new Set();
  imageUs = nowUs();
  poseUs = nowUs();
  states = new Map();
  instantUs = RECORDING.from_us;
  playing = false;
  speed = 1;
  tickMs = performance.now();
  isKnown = false;

  constructor(peer) {
    this.peer = peer;
    peer.onMessage = (message) => this.receive(message);
    peer.onClose = () => {
      viewers.delete(this);
      clearInterval(this.timer);
      clearInterval(this.healthTimer);
    };
  }

  receive(message) {
    if (!this.isKnown) {
      if (message.type !== "key" || message.key !== KEY) return this.peer.close(1008);
      this.isKnown = true;
      return this.start();
    }
    switch (message.type) {
      case "list": return this.sendSessions();
      case "open": this.session = message.session; return this.sendScene();
      case "settings": this.settings = message; if (!IS_LIVE) this.show(this.instantUs); return;
      case "ack": ++figures.acknowledged; this.open.delete(message.number); return;
      case "seek": this.playing = false; return this.show(message.t_us);
      case "step": this.playing = false; return this.show(this.instantUs + message.count * POSE_STEP_US);
      case "play": this.playing = true; this.speed = message.speed; return this.sendPosition();
      case "pause": this.playing = false; return this.sendPosition();
    }
  }

  start() {
    this.peer.sendText({
      type: "hello", mode: options.mode, title: IS_LIVE ? "" : "bench.raw", version: "0.1.0",
      source: IS_LIVE ? "127.0.0.1:50051" : "bench.raw", session: IS_LIVE ? this.session : "bench.raw",
    });
    if (options.gone) this.sendEnd("sessions/bench-1: there is no such session");
    else if (this.session !== "") this.sendScene();
    else this.sendSessions();
    this.timer = setInterval(() => this.tick(), 8);
    this.healthTimer = setInterval(() => this.sendHealth(), 500);
  }

  sendSessions() {
    const names = ["bench-1", "a session with a long name that does not fit in its column at all", "<b>cell 7</b>"];
    this.peer.sendText({
      type: "sessions",
      sessions: names.map((name, i) => ({ name: `sessions/${name}`, state: ["receiving", "waiting", "ended"][i], objects: OBJECTS.map(({ id }) => id), create_time: `2026-11-26 10:0${i}:17` })),
    });
  }

  sendEnd(reason) {
    this.session = "";
    this.peer.sendText({ type: "notice", level: "error", text: reason });
    this.peer.sendText({ type: "end", reason });
    this.sendSessions();
  }

  sendScene() {
    this.peer.sendText({
      type: "scene", session: IS_LIVE ? this.session : "bench.raw", camera: CAMERA, objects: OBJECTS, recording: IS_LIVE ? null : RECORDING,
      has_truth: options.truth, frame: FRAMES[options.frame],
    });
    OBJECTS.forEach(({ id, diameter_m }, index) => {
      const { vertices, faces, edges } = geometry(index);
      this.peer.sendBinary(pack({ type: "geometry", object: id, diameter_m }, [vertices, faces, edges]));
    });
    if (!IS_LIVE) {
      this.peer.sendText({ type: "range", ...RECORDING, complete: true, events: eventCounts() });
      this.sendRecording();
    }
  }

  sendRecording() {
    OBJECTS.forEach(({ id }, index) => {
      const [poses, truth] = [[], []];
      for (let t = RECORDING.from_us; t <= RECORDING.to_us; t += POSE_STEP_US) {
        const pose = poseAt(index, t, poses.length);
        if (pose) poses.push(pose);
        truth.push(truthAt(index, t));
        this.sendState(index, t);
      }
      this.peer.sendText({ type: "poses", object: id, poses });
      if (options.truth) this.peer.sendText({ type: "poses", object: id, truth: true, poses: truth });
    });
    this.show(this.instantUs);
  }

  sendState(index, t_us) {
    const { state, reason } = stateAt(index, t_us);
    if (this.states.get(index) === state) return;
    this.states.set(index, state);
    this.peer.sendText({ type: "state", object: OBJECTS[index].id, t_us, state, reason });
  }

  show(t_us) {
    this.instantUs = Math.min(Math.max(Math.round(t_us), RECORDING.from_us), RECORDING.to_us);
    this.sendPosition();
    const halfUs = Math.round(this.settings.window_ms * 500);
    this.sendImage(this.instantUs - halfUs, this.instantUs + halfUs, this.instantUs);
  }

  sendPosition() {
    this.peer.sendText({ type: "position", t_us: this.instantUs, playing: this.playing, speed: this.speed });
  }

  sendImage(fromUs, toUs, poseUs) {
    const { cell_px } = this.settings;
    const { width, height, cells, events } = eventCells(OBJECTS.length, fromUs, toUs, cell_px, Number(options.noise));
    const outlines = [];
    const sections = [];
    const addOutline = (index, pose, truth) => {
      const { segments, kinds } = outline(index, pose);
      outlines.push({ object: OBJECTS[index].id, state: pose.state, t_us: pose.t_us, segments: kinds.length, truth });
      sections.push(segments, kinds);
    };
    OBJECTS.forEach((_, index) => {
      const pose = poseAt(index, IS_LIVE ? poseUs : Math.floor(poseUs / POSE_STEP_US) * POSE_STEP_US, 0);
      if (options.truth) addOutline(index, truthAt(index, poseUs), true);
      if (pose) addOutline(index, pose, false);
    });
    const number = ++this.imageNumber;
    const isDeflated = number % 2 === 0;
    const header = { type: "image", number, t_us: poseUs, from_us: fromUs, to_us: toUs, cell_px, width, height, events, skipped: figures.images_skipped, encoding: isDeflated ? "zlib" : "packed", outlines };
    this.open.add(number);
    ++figures.images_sent;
    lastImage = { ...header, segments: sections.filter((_, i) => i % 2 === 0).map((section) => [...section]) };
    this.peer.sendBinary(pack(header, [isDeflated ? deflateSync(cells, { level: 1 }) : cells, ...sections]));
  }

  tick() {
    const passedUs = (performance.now() - this.tickMs) * 1000;
    this.tickMs = performance.now();
    if (this.session === "") return;
    if (IS_LIVE) return this.tickLive(nowUs());
    if (!this.playing) return;
    this.instantUs = Math.min(this.instantUs + passedUs * this.speed, RECORDING.to_us);
    if (this.instantUs === RECORDING.to_us) this.playing = false;
    if (this.open.size < MAX_OPEN_IMAGES) this.show(this.instantUs);
  }

  tickLive(now) {
    if (now - this.poseUs >= 16_000) {
      this.poseUs = now;
      OBJECTS.forEach(({ id }, index) => {
        this.sendState(index, now);
        const pose = poseAt(index, now, Math.floor(now / 1000));
        if (pose) this.peer.sendText({ type: "poses", object: id, poses: [pose] });
      });
    }
    if (now - this.imageUs < 1e6 / this.settings.rate_hz) return;
    if (this.open.size >= MAX_OPEN_IMAGES) {
      ++figures.images_skipped;
      return;
    }
    this.sendImage(this.imageUs, now, now);
    this.imageUs = now;
  }

  sendHealth() {
    if (!IS_LIVE || this.session === "") return;
    const now = nowUs();
    this.peer.sendText({
      type: "health", t_us: now, event_rate_hz: 2.1e6 + 6e5 * Math.sin(now / 2e6), latency_ms: { p50: 1.05 + 0.2 * Math.sin(now / 1e6), p99: 1.9 + 0.5 * Math.sin(now / 7e5) },
      pose_rate_hz: 1000, real_time_ratio: 0.16, dropped: 0, skipped: 0, decode_faults: 0, link: { ...figures, unacknowledged: this.open.size },
      objects: OBJECTS.map(({ id }, index) => ({ id, state: stateAt(index, now).state, detail: stateAt(index, now).reason, explained: 0.86, losses: 0 })),
    });
  }
}

/** Numbers of events of the recording: its rate rises from 1 to 3 Mev/s. */
function eventCounts() {
  const step_us = 8192;
  const counts = Array.from({ length: Math.ceil((RECORDING.to_us - RECORDING.from_us) / step_us) }, (_, i) => Math.round(step_us * (1 + (2e6 * i * step_us) / (RECORDING.to_us - RECORDING.from_us) / 1e6)));
  return { from_us: RECORDING.from_us, step_us, counts };
}

function nowUs() {
  return START_US + Math.round((performance.now() - startedMs) * 1000);
}

function answerTest(url) {
  switch (url.pathname) {
    case "/test/image": return lastImage;
    case "/test/figures": return { ...figures, viewers: viewers.size };
    case "/test/pose": {
      const t_us = Number(url.searchParams.get("t_us"));
      return poseAt(OBJECTS.findIndex(({ id }) => id === url.searchParams.get("object")), t_us, Number(url.searchParams.get("seq")));
    }
    case "/test/drop":
      for (const viewer of viewers) viewer.peer.destroy();
      return {};
    case "/test/text":
      for (const viewer of viewers) viewer.peer.sendText(JSON.parse(url.searchParams.get("message")));
      return {};
    case "/test/damage":
      for (const viewer of viewers) viewer.peer.sendBinary(Buffer.from([9, 0, 0, 0, 1, 2, 3]));
      return {};
    default: return undefined;
  }
}

const server = createServer(async (request, response) => {
  const url = new URL(request.url, "http://localhost");
  const answer = answerTest(url);
  if (answer !== undefined) {
    response.writeHead(200, { "Content-Type": "application/json" }).end(JSON.stringify(answer));
    return;
  }
  const file = FILES[url.pathname];
  if (!file) {
    response.writeHead(404, HEADERS).end();
    return;
  }
  response.writeHead(200, { ...HEADERS, "Content-Type": `${file[1]}; charset=utf-8` }).end(await readFile(join(options.dist, file[0])));
});
server.on("upgrade", (request, socket) => {
  ++figures.connections;
  viewers.add(new Viewer(new WebSocketPeer(request, socket)));
});
server.listen(Number(options.port), "127.0.0.1", () => {
  console.log(`http://127.0.0.1:${server.address().port}/#${KEY}`);
});
