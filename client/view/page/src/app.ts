// SPDX-License-Identifier: Apache-2.0
// Wires the connection, the store and the views, and draws at most once per frame of the screen.
import { Connection, type Receiver, type Status } from "./connection";
import { byId, element, setText } from "./dom";
import { EventsView } from "./events_view";
import { duration, withPrefix } from "./format";
import { InfoPanel } from "./info_panel";
import { Keys, type Command } from "./keys";
import type { Palette } from "./palette";
import { Plots } from "./plots";
import type { EventImage, Geometry, Hello, Scene, TextMessage } from "./protocol";
import { SessionList } from "./session_list";
import { Choice } from "./settings";
import { SpaceView } from "./space_view";
import { Store } from "./store";
import { Theme } from "./theme";
import { Timeline } from "./timeline";
import { Transport } from "./transport";

/** Images are made between two slices of events, so that a few per cent fewer come than were asked for: at least 30 are wanted. */
const RATE_HZ = 32;
/** Lists and plots of a live session are drawn less often than images. */
const SLOW_PERIOD_MS = 160;
const LIST_PERIOD_MS = 2000;
const NOTICE_MS = 8000;

const STATUS_TEXT: Record<Status, string> = {
  connecting: "connecting",
  connected: "connected",
  retrying: "connection lost, trying again",
  full: "Too many pages are open: this one tries again.",
  refused: "This page was refused: open the address that evpose view printed last.",
  "no-key": "The address has no key: open the whole address that evpose view printed, with the part after #.",
};

export class App implements Receiver {
  private readonly store = new Store();
  private readonly theme: Theme;
  private readonly connection: Connection;
  private readonly events: EventsView;
  private readonly space: SpaceView;
  private readonly plots: Plots;
  private readonly timeline: Timeline;
  private readonly info: InfoPanel;
  private readonly transport: Transport;
  private readonly sessionList: SessionList;
  private readonly windowMs: Choice;
  private readonly cellPx: Choice;
  private readonly spanS: Choice;
  private readonly data = document.documentElement.dataset;
  /** The session that was opened; opened again after a lost connection. */
  private session = "";
  private isFrozen = false;
  private decoding: Promise<void> = Promise.resolve();
  /** Numbers of images that were decoded and are not drawn yet. */
  private undrawn: number[] = [];
  private imagesDrawn = 0;
  private drawTimes: number[] = [];
  private errors = 0;
  private frameRequest = 0;
  private slowDueMs = 0;
  private resumeUs: number | null = null;

  constructor() {
    const draw = () => {
      this.requestFrame();
    };
    const seek = (t_us: number) => {
      this.transport.seek(t_us);
    };
    this.theme = new Theme((colours) => {
      this.setColours(colours);
    });
    const { colours } = this.theme;
    this.connection = new Connection(location.hash.slice(1), this);
    this.events = new EventsView(this.store, colours, draw);
    this.space = new SpaceView(this.store, colours, draw);
    this.plots = new Plots(this.store, colours, seek, draw);
    this.timeline = new Timeline(this.store, colours, seek, draw);
    this.info = new InfoPanel(this.store, colours, (id) => {
      this.select(id);
    });
    this.transport = new Transport(this.store, (request) => {
      this.connection.send(request);
    });
    this.sessionList = new SessionList((name) => {
      this.open(name);
    });
    const send = () => {
      this.sendSettings();
    };
    this.windowMs = new Choice("window-select", [1, 2, 5, 10, 20, 33, 50, 100, 200, 500], "ms", 33, send);
    this.cellPx = new Choice("cell-select", [1, 2, 4], "px", 2, send);
    this.spanS = new Choice("span-select", [5, 10, 20, 60], "s", 20, draw);
    new Keys(this.commands());
    this.listen();
  }

  start(): void {
    setFavicon(this.theme.colours.accent);
    this.data["webgl"] = this.space.works ? "yes" : "no";
    this.data["imagesDrawn"] = "0";
    this.data["errors"] = "0";
    this.onStatus("connecting", "");
    this.connection.open();
    setInterval(() => {
      if (!byId("chooser", HTMLElement).hidden) this.connection.send({ type: "list" });
    }, LIST_PERIOD_MS);
    setInterval(() => {
      this.requestFrame();
    }, SLOW_PERIOD_MS);
  }

  private listen(): void {
    byId("sessions-button", HTMLButtonElement).addEventListener("click", () => {
      this.showSessions();
    });
    byId("reload-button", HTMLButtonElement).addEventListener("click", () => {
      this.connection.send({ type: "list" });
    });
    byId("relative-button", HTMLButtonElement).addEventListener("click", () => {
      this.toggleRelative();
    });
    this.nameFrame();
  }

  private commands(): Command[] {
    const toggle = (what: "showOverlay" | "showTruth") => {
      this.events[what] = !this.events[what];
      this.plots.showTruth = this.space.showTruth = this.events.showTruth;
      this.redraw();
    };
    return [
      { keys: [" "], shown: ["space"], text: "recording: play or pause; live: freeze the page, and go on", run: () => { this.playOrFreeze(); } },
      { keys: ["ArrowLeft", "ArrowRight"], shown: ["←", "→"], text: "previous or next pose", run: (key) => { this.transport.step(key === "ArrowLeft" ? -1 : 1); } },
      { keys: ["Shift+ArrowLeft", "Shift+ArrowRight"], shown: ["shift ←", "shift →"], text: "ten poses back or on", run: (key) => { this.transport.step(key.endsWith("Left") ? -10 : 10); } },
      { keys: ["Home", "End"], shown: ["home", "end"], text: "beginning or end of the recording", run: (key) => { this.transport.toEnd(key === "End"); } },
      { keys: ["+", "=", "-"], shown: ["+", "-"], text: "play faster or slower", run: (key) => { this.transport.changeSpeed(key === "-" ? -1 : 1); } },
      { keys: ["[", "]"], shown: ["[", "]"], text: "events of a shorter or longer time", run: (key) => { this.windowMs.change(key === "[" ? -1 : 1); } },
      { keys: [",", "."], shown: [",", "."], text: "live: plots of a shorter or longer time", run: (key) => { this.spanS.change(key === "," ? -1 : 1); } },
      { keys: ["1", "2", "3", "4", "5", "6", "7", "8", "9"], shown: ["1", "…", "9"], text: "select the object with this number", run: (key) => { this.selectNumber(Number(key)); } },
      { keys: ["o"], shown: ["o"], text: "edges of the objects on or off", run: () => { toggle("showOverlay"); } },
      { keys: ["t"], shown: ["t"], text: "truth on or off", run: () => { toggle("showTruth"); } },
      { keys: ["p"], shown: ["p"], text: "plot positions from the first pose, or in the frame of the 3D view", run: () => { this.toggleRelative(); } },
      { keys: ["r"], shown: ["r"], text: "reset zoom and 3D view", run: () => { this.events.resetZoom(); this.space.resetView(); this.redraw(); } },
      { keys: ["l"], shown: ["l"], text: "live: list of the sessions", run: () => { this.showSessions(); } },
      { keys: ["d"], shown: ["d"], text: "light or dark", run: () => { this.theme.toggle(); } },
    ];
  }

  // Receiver.

  onStatus(status: Status, reason: string): void {
    this.data["connection"] = status;
    const node = byId("connection", HTMLElement);
    setText(node, STATUS_TEXT[status]);
    node.title = reason;
    node.classList.toggle("bad", status !== "connected" && status !== "connecting");
    if (status === "retrying" && this.store.isRecording) this.resumeUs = this.instantUs;
  }

  onMessage(message: TextMessage): void {
    switch (message.type) {
      case "hello": this.onHello(message); break;
      case "sessions": this.store.sessions = message.sessions; break;
      case "scene": this.onScene(message); break;
      case "poses": this.store.addPoses(message.object, message.poses, message.truth === true); break;
      case "state": this.store.addState(message); break;
      case "health": this.store.addHealth(message); break;
      case "position": this.store.position = message; break;
      case "range": this.store.setRange(message); break;
      case "notice": this.notice(message.level, message.text); break;
      case "end": this.onEnd(message.reason); break;
    }
    this.requestFrame();
  }

  onImage(image: EventImage): void {
    this.decoding = this.decoding
      .then(() => this.events.add(image))
      .catch((error: unknown) => {
        this.onError(String(error));
      })
      .then(() => {
        this.undrawn.push(image.number);
        this.requestFrame();
      });
  }

  onGeometry(geometry: Geometry): void {
    const info = this.store.objects.get(geometry.object)?.info;
    // A server that did not know the model has sent its vertices.
    if (info && !(info.diameter_m > 0)) info.diameter_m = geometry.diameterM;
    this.space.setGeometry(geometry);
    this.requestFrame();
  }

  onError(text: string): void {
    this.data["errors"] = String(++this.errors);
    this.notice("error", text);
  }

  private onHello(hello: Hello): void {
    this.store.hello = hello;
    setText(byId("title", HTMLElement), hello.mode === "live" ? hello.source : hello.title || hello.source);
    byId("title", HTMLElement).title = `evpose ${hello.version}, ${hello.source}`;
    byId("sessions-button", HTMLElement).hidden = hello.mode !== "live";
    this.data["mode"] = hello.mode;
    this.undrawn = [];
    this.sendSettings();
    if (hello.mode !== "live") return;
    // After a lost connection the page opens the session that it has shown, which may differ from that of the gateway.
    if (this.session === "") this.session = hello.session;
    else if (this.session !== hello.session) this.connection.send({ type: "open", session: this.session });
    if (this.session === "") this.showSessions();
  }

  private onEnd(reason: string): void {
    this.store.ended = reason;
    if (this.store.scene) return;
    // Nothing has been shown yet. For a session, a notice with the reason has been received as well.
    if (this.store.isRecording) this.notice("error", reason);
    else this.showSessions();
  }

  private onScene(scene: Scene): void {
    this.store.setScene(scene);
    this.session = scene.session;
    this.isFrozen = false;
    this.events.reset();
    this.space.reset();
    this.plots.reset();
    this.nameFrame();
    this.data["session"] = scene.session;
    byId("chooser", HTMLElement).hidden = true;
    byId("viewer", HTMLElement).hidden = false;
    byId("span-label", HTMLElement).hidden = scene.recording !== null;
    if (!this.store.isRecording) setText(byId("title", HTMLElement), `${this.store.hello?.source ?? ""}  ${scene.session}`);
    if (this.resumeUs !== null) this.transport.seek(this.resumeUs);
    this.resumeUs = null;
  }

  // Commands.

  private open(name: string): void {
    this.session = name;
    this.connection.send({ type: "open", session: name });
  }

  private showSessions(): void {
    if (this.store.isRecording || !this.store.hello) return;
    byId("viewer", HTMLElement).hidden = true;
    byId("chooser", HTMLElement).hidden = false;
    this.connection.send({ type: "list" });
    this.requestFrame();
  }

  private select(id: string): void {
    this.store.selected = id;
    this.redraw();
  }

  private selectNumber(number: number): void {
    const track = [...this.store.objects.values()][number - 1];
    if (track) this.select(track.info.id);
  }

  private playOrFreeze(): void {
    if (this.store.isRecording) this.transport.toggle();
    else if (this.store.scene) this.isFrozen = !this.isFrozen;
    this.redraw();
  }

  private toggleRelative(): void {
    this.plots.isRelative = !this.plots.isRelative;
    this.nameFrame();
    this.redraw();
  }

  /** Names the frame of the poses where they are shown. */
  private nameFrame(): void {
    const { name, transform } = this.store.scene?.frame ?? { name: "camera", transform: "" };
    setText(byId("relative-button", HTMLElement), this.plots.isRelative ? "from first pose" : `${name} frame`);
    setText(byId("pose-transform", HTMLElement), transform);
  }

  private sendSettings(): void {
    this.events.windowMs = this.windowMs.value;
    this.connection.send({ type: "settings", window_ms: this.windowMs.value, cell_px: this.cellPx.value, rate_hz: RATE_HZ });
    this.redraw();
  }

  private setColours(colours: Palette): void {
    for (const view of [this.events, this.space, this.plots, this.timeline, this.info]) view.setColours(colours);
    this.redraw();
  }

  private notice(level: "info" | "error", text: string): void {
    const node = element("div", `notice ${level}`, text);
    const notices = byId("notices", HTMLElement);
    notices.append(node);
    while (notices.children.length > 4) notices.firstChild?.remove();
    setTimeout(() => {
      node.remove();
    }, NOTICE_MS);
  }

  // Drawing.

  private redraw(): void {
    this.slowDueMs = 0;
    this.requestFrame();
  }

  private requestFrame(): void {
    this.frameRequest ||= requestAnimationFrame((nowMs) => {
      this.frameRequest = 0;
      this.frame(nowMs);
    });
  }

  /** The instant that all views show, microseconds. */
  private get instantUs(): number {
    if (this.store.isRecording) return this.events.image?.t_us ?? this.store.position?.t_us ?? 0;
    return this.store.newestUs;
  }

  private frame(nowMs: number): void {
    if (!byId("chooser", HTMLElement).hidden) {
      this.sessionList.draw(this.store.sessions, this.store.hello?.source ?? "");
      return;
    }
    if (!this.store.scene) return;
    const drawn = this.undrawn;
    this.undrawn = [];
    if (!this.isFrozen) this.drawViews(nowMs, drawn.length > 0);
    for (const number of drawn) this.connection.send({ type: "ack", number });
    if (drawn.length > 0) this.transport.imageShown();
    this.drawBadge();
  }

  private drawViews(nowMs: number, hasImage: boolean): void {
    const instantUs = this.instantUs;
    this.events.draw();
    if (hasImage) {
      ++this.imagesDrawn;
      this.drawTimes.push(nowMs);
    }
    while (this.drawTimes.length > 0 && this.drawTimes[0]! < nowMs - 1000) this.drawTimes.shift();
    const isSlowDue = nowMs >= this.slowDueMs;
    if (isSlowDue || (hasImage && !this.space.isSoftware)) this.space.draw(instantUs);
    if (isSlowDue || (this.store.isRecording && hasImage)) {
      this.slowDueMs = nowMs + SLOW_PERIOD_MS;
      this.drawSlow(instantUs);
    }
    this.expose(instantUs);
  }

  private drawSlow(instantUs: number): void {
    const recording = this.store.recordedRange;
    this.plots.spanS = this.spanS.value;
    const newestUs = this.store.newestUs;
    this.plots.draw(newestUs, recording ? instantUs : null);
    const fromUs = recording?.from_us ?? this.store.liveFromUs(this.spanS.value);
    this.timeline.draw(fromUs, recording?.to_us ?? newestUs, recording ? instantUs : null);
    const image = this.events.image;
    this.info.draw(instantUs, {
      framesPerSecond: this.drawTimes.length,
      imagesDrawn: this.imagesDrawn,
      imageEvents: image?.events ?? NaN,
      imageSpanUs: image ? image.toUs - image.fromUs : NaN,
      imagesSkipped: image?.skipped ?? 0,
    });
    this.transport.draw(instantUs);
    setText(byId("plots-object", HTMLElement), this.store.objects.size > 1 ? this.store.selected : "");
    if (image) setText(byId("events-info", HTMLElement), `${withPrefix(image.events)}ev in ${duration(image.toUs - image.fromUs)}`);
  }

  private drawBadge(): void {
    const badge = byId("live-badge", HTMLElement);
    badge.hidden = false;
    badge.classList.toggle("frozen", this.isFrozen);
    const mode = this.store.isRecording ? "recording" : "live";
    setText(badge, this.isFrozen ? "frozen, space goes on" : this.store.ended === null ? mode : `ended: ${this.store.ended}`);
  }

  /** The state of the page for tests: attributes of the root element, which README.md lists. */
  private expose(instantUs: number): void {
    const image = this.events.image;
    this.data["instantUs"] = String(instantUs);
    this.data["playing"] = String(this.store.position?.playing === true);
    this.data["imagesDrawn"] = String(this.imagesDrawn);
    if (!image) return;
    this.data["imageNumber"] = String(image.number);
    this.data["imageTUs"] = String(image.t_us);
    this.data["imageFromUs"] = String(image.fromUs);
    this.data["imageToUs"] = String(image.toUs);
  }
}

/** An icon from a blob: URL, which the page's policy allows; no file and no request for one. */
function setFavicon(colour: string): void {
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16"><path fill="none" stroke="${colour}" stroke-width="1.6" d="M8 1l6 3.5v7L8 15l-6-3.5v-7zM2 4.5L8 8l6-3.5M8 8v7"/></svg>`;
  const link = element("link");
  link.rel = "icon";
  link.href = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
  document.head.append(link);
}
