// SPDX-License-Identifier: Apache-2.0
// The states of each object over time: a bar, and the list of changes with their reasons.
import { beginDrawing, BoxSize, byId, element, setText } from "./dom";
import { duration, seconds } from "./format";
import { objectColour, type Palette } from "./palette";
import type { Change, ObjectTrack, ShownState, Store } from "./store";

const ROW_PX = 20;
const LABEL_PX = 24;
const AXIS_PX = 16;
const MAX_LISTED = 200;

interface Span {
  track: ObjectTrack;
  change: Change;
  endUs: number;
}

export class Timeline {
  private readonly canvas = byId("timeline", HTMLCanvasElement);
  private readonly box: BoxSize;
  private readonly tip = byId("timeline-tip", HTMLElement);
  private readonly list = byId("changes", HTMLElement);
  private readonly info = byId("timeline-info", HTMLElement);
  private fromUs = 0;
  private toUs = 1;
  private listKey = "";

  constructor(
    private readonly store: Store,
    private colours: Palette,
    private readonly seek: (t_us: number) => void,
    requestDraw: () => void,
  ) {
    this.box = new BoxSize(this.canvas, requestDraw);
    for (const type of ["pointermove", "pointerdown"] as const) {
      this.canvas.addEventListener(type, (event) => {
        this.showTip(event);
      });
    }
    // A finger leaves when it is lifted: its tip stays until it touches something else.
    this.canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "touch") this.tip.hidden = true;
    });
    document.addEventListener("pointerdown", (event) => {
      if (event.target !== this.canvas) this.tip.hidden = true;
    });
    this.canvas.addEventListener("click", (event) => {
      const time = this.timeAt(event.offsetX);
      if (time !== null) this.seek(time);
    });
  }

  setColours(colours: Palette): void {
    this.colours = colours;
    this.listKey = "";
  }

  draw(fromUs: number, toUs: number, instantUs: number | null): void {
    this.fromUs = fromUs;
    this.toUs = Math.max(toUs, fromUs + 1);
    const tracks = [...this.store.objects.values()];
    const height = `${ROW_PX * Math.max(tracks.length, 1) + AXIS_PX}px`;
    if (this.canvas.style.height !== height) this.canvas.style.height = height;
    const context = beginDrawing(this.canvas, this.box);
    context.font = "11px system-ui, 'Liberation Sans', 'DejaVu Sans', sans-serif";
    context.textBaseline = "middle";
    tracks.forEach((track, row) => {
      this.drawRow(context, track, row);
    });
    this.drawAxis(context, tracks.length);
    if (instantUs !== null) {
      context.fillStyle = this.colours.accent;
      context.fillRect(this.xOf(instantUs) - 0.75, 0, 1.5, ROW_PX * tracks.length + 3);
    }
    this.drawList(tracks);
  }

  private xOf(t_us: number): number {
    const width = this.box.width - LABEL_PX;
    return LABEL_PX + (width * (t_us - this.fromUs)) / (this.toUs - this.fromUs);
  }

  private timeAt(x: number): number | null {
    if (x < LABEL_PX || this.store.objects.size === 0) return null;
    return Math.round(this.fromUs + ((x - LABEL_PX) / (this.box.width - LABEL_PX)) * (this.toUs - this.fromUs));
  }

  private drawRow(context: CanvasRenderingContext2D, track: ObjectTrack, row: number): void {
    const y = ROW_PX * row;
    context.fillStyle = objectColour(this.colours, track.index);
    context.beginPath();
    context.arc(9, y + ROW_PX / 2, 8, 0, 2 * Math.PI);
    context.fill();
    context.fillStyle = this.colours.panel;
    context.textAlign = "center";
    context.fillText(String(track.index + 1), 9, y + ROW_PX / 2 + 0.5);
    context.fillStyle = this.colours.grid;
    context.fillRect(LABEL_PX, y + 3, this.box.width - LABEL_PX, ROW_PX - 6);
    for (const { change, endUs } of spans(track, this.toUs)) {
      if (endUs < this.fromUs || change.t_us > this.toUs || change.state === "none") continue;
      const from = Math.max(this.xOf(change.t_us), LABEL_PX);
      const to = Math.max(this.xOf(endUs), from + 1.5);
      this.drawSpan(context, change.state, from, to, y);
    }
  }

  /** The height and hatching of a span, besides its colour, tell the states apart. */
  private drawSpan(context: CanvasRenderingContext2D, state: ShownState, from: number, to: number, y: number): void {
    const style = this.colours.states[state];
    const top = { tracking: 3, degraded: 6, ambiguous: 6, initializing: 11, lost: 3, none: 3 }[state];
    context.fillStyle = style.colour;
    context.fillRect(from, y + top, to - from, ROW_PX - 3 - top);
    if (state === "tracking" || state === "degraded") return;
    context.save();
    context.beginPath();
    context.rect(from, y + top, to - from, ROW_PX - 3 - top);
    context.clip();
    context.strokeStyle = this.colours.panel;
    context.lineWidth = 2;
    context.beginPath();
    for (let x = from - (from % 7) - 20; x < to; x += 7) {
      context.moveTo(x, y + ROW_PX);
      context.lineTo(x + ROW_PX, y);
    }
    context.stroke();
    context.restore();
    const text = `${style.symbol} ${style.label}`;
    const width = context.measureText(text).width;
    if (to - from < width + 16) return;
    context.fillStyle = this.colours.panel;
    context.fillRect((from + to - width) / 2 - 4, y + 4, width + 8, ROW_PX - 8);
    context.fillStyle = style.colour;
    context.textAlign = "center";
    context.fillText(text, (from + to) / 2, y + ROW_PX / 2 + 0.5);
  }

  private drawAxis(context: CanvasRenderingContext2D, rows: number): void {
    const y = ROW_PX * Math.max(rows, 1) + AXIS_PX / 2 + 1;
    const span = (this.toUs - this.fromUs) / 1e6;
    const wanted = span / Math.max(2, Math.floor((this.box.width - LABEL_PX) / 90));
    const power = 10 ** Math.floor(Math.log10(wanted));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= wanted) ?? 10 * power;
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    context.fillStyle = this.colours.mutedText;
    context.textAlign = "center";
    for (let t = Math.ceil(this.fromUs / 1e6 / step) * step; t <= this.toUs / 1e6; t += step) {
      const x = this.xOf(t * 1e6);
      const text = `${t.toFixed(digits)} s`;
      const half = context.measureText(text).width / 2;
      context.fillRect(x - 0.5, y - AXIS_PX / 2 - 1, 1, 3);
      if (x - half > LABEL_PX - 10 && x + half < this.box.width) context.fillText(text, x, y + 2);
    }
  }

  private drawList(tracks: readonly ObjectTrack[]): void {
    const changes = tracks.flatMap((track) => spans(track, this.store.recordedRange?.to_us ?? Infinity));
    changes.sort((a, b) => b.change.t_us - a.change.t_us);
    const shown = changes.slice(0, MAX_LISTED);
    const key = shown.map(({ track, change, endUs }) => `${track.index} ${change.t_us} ${change.state} ${change.reason} ${endUs}`).join("\n");
    if (key === this.listKey) return;
    this.listKey = key;
    const losses = changes.filter(({ change }) => change.state === "lost").length;
    setText(this.info, `${losses} ${losses === 1 ? "loss" : "losses"}`);
    this.list.replaceChildren(...shown.map((span) => this.listRow(span)));
    if (shown.length === 0) this.list.replaceChildren(element("div", "empty", "No state has been reported yet."));
  }

  private listRow({ track, change, endUs }: Span): HTMLElement {
    const style = this.colours.states[change.state];
    const state = element("span", "state", `${style.symbol} ${style.label}`);
    state.style.color = style.colour;
    const row = element(
      this.store.isRecording ? "button" : "div",
      "change",
      element("span", "numbers", `${seconds(change.t_us)} s`),
      element("span", "", `${track.index + 1}  ${track.info.id}`),
      state,
      element("span", "numbers duration", endUs === Infinity ? "" : duration(endUs - change.t_us)),
      element("span", "reason", change.reason),
    );
    row.title = change.reason;
    if (this.store.isRecording) {
      row.addEventListener("click", () => {
        this.seek(change.t_us);
      });
    }
    return row;
  }

  private showTip(event: PointerEvent): void {
    const time = this.timeAt(event.offsetX);
    const track = [...this.store.objects.values()][Math.floor(event.offsetY / ROW_PX)];
    const span = track && time !== null ? spans(track, this.toUs)[track.log.indexAt(time)] : undefined;
    this.tip.hidden = span === undefined;
    if (!span) return;
    const { label, symbol } = this.colours.states[span.change.state];
    const reason = span.change.reason === "" ? "" : `: ${span.change.reason}`;
    setText(this.tip, `${span.track.info.id}, ${seconds(span.change.t_us)} s, for ${duration(span.endUs - span.change.t_us)}: ${symbol} ${label}${reason}`);
    this.tip.style.left = `${Math.min(event.offsetX + 14, Math.max(0, this.box.width - 240))}px`;
    this.tip.style.top = `${event.offsetY + 16}px`;
  }
}

/** The spans of the states of an object; the last one lasts until `endUs`. */
function spans(track: ObjectTrack, endUs: number): Span[] {
  const { changes } = track.log;
  return changes.map((change, i) => ({ track, change, endUs: changes[i + 1]?.t_us ?? endUs }));
}
