// SPDX-License-Identifier: Apache-2.0
// The picture: events of the last milliseconds, and above them the edges of the objects at the pose of that instant.
import { CellAccumulator } from "./cells";
import { beginDrawing, BoxSize, byId, context2d, element, setText } from "./dom";
import { objectColour, type Palette } from "./palette";
import { KIND_CONTOUR, KIND_PAINTED, packedCells, type EventImage, type Outline } from "./protocol";
import { knownState, type Store } from "./store";

const MAX_ZOOM = 16;
/** Pixels: two segments with ends at most this far apart are drawn as one line, so that its dashes continue. */
const JOIN_PX = 0.75;

export class EventsView {
  image: EventImage | null = null;
  windowMs = 33;
  showOverlay = true;
  showTruth = true;
  private readonly stage = byId("stage", HTMLElement);
  private readonly box: BoxSize;
  private readonly cells = byId("cells", HTMLCanvasElement);
  private readonly overlay = byId("overlay", HTMLCanvasElement);
  private readonly message = byId("stage-message", HTMLElement);
  private readonly accumulator = new CellAccumulator();
  private pixels: ImageData | null = null;
  private zoom = 1;
  private offset = { x: 0, y: 0 };
  /** The places of the fingers on the stage, by their pointers. */
  private readonly touches = new Map<number, Point>();

  constructor(
    private readonly store: Store,
    private colours: Palette,
    private readonly requestDraw: () => void,
  ) {
    this.setColours(colours);
    this.box = new BoxSize(this.stage, requestDraw);
    this.listenToPointer();
  }

  setColours(colours: Palette): void {
    this.colours = colours;
    this.accumulator.setColours(colours.cells);
    this.drawLegend();
  }

  reset(): void {
    this.image = null;
    this.accumulator.clear();
    const camera = this.store.scene?.camera;
    if (camera) this.stage.style.aspectRatio = `${camera.width} / ${camera.height}`;
    this.resetZoom();
    this.drawLegend();
  }

  resetZoom(): void {
    this.zoom = 1;
    this.offset = { x: 0, y: 0 };
    this.zoomAt(1, 0, 0);
  }

  /** Takes over the events of an image. Throws if it is damaged. */
  async add(image: EventImage): Promise<void> {
    const packed = await packedCells(image);
    this.accumulator.add(packed, image.width, image.height, image.toUs, this.store.isRecording);
    this.image = image;
  }

  draw(): void {
    this.message.hidden = this.image !== null;
    if (!this.image) {
      setText(this.message, this.store.isRecording ? "The recording is being read." : "No event image yet: waiting for events of the session.");
      return;
    }
    this.drawCells(this.image);
    this.drawOverlay(this.image);
  }

  private drawCells(image: EventImage): void {
    const { width, height } = image;
    if (this.pixels?.width !== width || this.pixels.height !== height) {
      this.pixels = new ImageData(width, height);
      this.cells.width = width;
      this.cells.height = height;
    }
    this.accumulator.paint(new Uint32Array(this.pixels.data.buffer), this.windowMs * 1000);
    context2d(this.cells).putImageData(this.pixels, 0, 0);
    // Cells at the right and lower edges may reach beyond the sensor.
    const camera = this.store.scene?.camera;
    const [sx, sy] = camera ? [(width * image.cellPx) / camera.width, (height * image.cellPx) / camera.height] : [1, 1];
    this.cells.style.transform = `translate(${this.offset.x}px, ${this.offset.y}px) scale(${this.zoom * sx}, ${this.zoom * sy})`;
  }

  private drawOverlay(image: EventImage): void {
    const context = beginDrawing(this.overlay, this.box);
    const camera = this.store.scene?.camera;
    if (!camera || !this.showOverlay) return;
    // CSS pixels of the stage per pixel of the sensor; (0, 0) is the centre of the sensor's first pixel.
    const scale = (this.box.width / camera.width) * this.zoom;
    const place = { scale, x: this.offset.x + 0.5 * scale, y: this.offset.y + 0.5 * scale };
    context.lineCap = "round";
    context.lineJoin = "round";
    const outlines = image.outlines.filter((outline) => !outline.truth);
    for (const outline of outlines) this.drawOutline(context, outline, place);
    for (const outline of image.outlines) {
      if (outline.truth && this.showTruth) this.drawTruth(context, outline, place);
    }
    for (const outline of outlines) this.drawTag(context, outline, place);
  }

  private drawTruth(context: CanvasRenderingContext2D, outline: Outline, place: Placement): void {
    tracePath(context, outline, place, () => true);
    strokePath(context, this.colours.truth, 1, [3, 5]);
  }

  private drawOutline(context: CanvasRenderingContext2D, outline: Outline, place: Placement): void {
    const { colour, dash } = this.colours.states[knownState(outline.state)];
    const track = this.store.objects.get(outline.object);
    tracePath(context, outline, place, (kind) => kind !== KIND_PAINTED);
    if (this.store.objects.size > 1 && track) {
      context.globalAlpha = 0.45;
      strokePath(context, objectColour(this.colours, track.index), 8);
      context.globalAlpha = 1;
    }
    strokePath(context, this.colours.casing, 4);
    strokePath(context, colour, 2, dash);
    if (!outline.kinds.includes(KIND_PAINTED)) return;
    tracePath(context, outline, place, (kind) => kind === KIND_PAINTED);
    strokePath(context, this.colours.casing, 3);
    strokePath(context, colour, 1.25, dash);
  }

  /** The number and state of the object, above its outline: only if there are several. */
  private drawTag(context: CanvasRenderingContext2D, outline: Outline, place: Placement): void {
    const track = this.store.objects.get(outline.object);
    if (!track || this.store.objects.size < 2 || outline.segments.length === 0) return;
    let top = Infinity;
    let x = 0;
    for (let i = 0; i < outline.segments.length; i += 2) {
      if (outline.segments[i + 1]! < top) [x, top] = [outline.segments[i]!, outline.segments[i + 1]!];
    }
    const style = this.colours.states[knownState(outline.state)];
    const text = `${track.index + 1}  ${outline.object.slice(0, 24)}  ${style.symbol} ${style.label}`;
    context.font = "600 11px system-ui, 'Liberation Sans', 'DejaVu Sans', sans-serif";
    const width = context.measureText(text).width + 14;
    const left = Math.min(Math.max(place.x + place.scale * x - width / 2, 2), this.box.width - width - 2);
    const upper = Math.max(place.y + place.scale * top - 26, 2);
    context.fillStyle = this.colours.panel;
    context.strokeStyle = objectColour(this.colours, track.index);
    context.lineWidth = 1.5;
    context.beginPath();
    context.roundRect(left, upper, width, 18, 9);
    context.fill();
    context.stroke();
    context.fillStyle = this.colours.text;
    context.textBaseline = "middle";
    context.fillText(text, left + 7, upper + 9.5);
  }

  private drawLegend(): void {
    const legend = byId("legend", HTMLElement);
    const items: HTMLElement[] = [];
    for (const state of ["tracking", "degraded", "ambiguous"] as const) {
      const style = this.colours.states[state];
      items.push(element("span", "", this.lineSample(style.colour, style.dash), `${style.symbol} ${style.label}`));
    }
    if (this.store.scene?.has_truth === true) items.push(element("span", "", this.lineSample(this.colours.truth, [3, 5]), "truth"));
    const hex = (abgr: number) => `rgb(${abgr & 255} ${(abgr >> 8) & 255} ${(abgr >> 16) & 255})`;
    items.push(element("span", "", this.lineSample(hex(this.colours.cells.on), [], 7), "ON"));
    items.push(element("span", "", this.lineSample(hex(this.colours.cells.off), [], 7), "OFF"));
    legend.replaceChildren(...items);
  }

  private lineSample(colour: string, dash: number[], width = 2): HTMLCanvasElement {
    const canvas = element("canvas");
    canvas.width = 52;
    canvas.height = 20;
    const context = context2d(canvas);
    context.scale(2, 2);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(width > 2 ? 13 : 1, 5);
    context.lineTo(width > 2 ? 21 : 25, 5);
    context.stroke();
    return canvas;
  }

  private listenToPointer(): void {
    this.stage.addEventListener("wheel", (event) => {
      event.preventDefault();
      const box = this.stage.getBoundingClientRect();
      this.zoomAt(Math.exp(-event.deltaY * 0.002), event.clientX - box.left, event.clientY - box.top);
    }, { passive: false });
    this.stage.addEventListener("dblclick", () => {
      this.resetZoom();
    });
    this.stage.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch") this.touches.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    for (const type of ["pointerup", "pointercancel"] as const) {
      this.stage.addEventListener(type, (event) => {
        this.touches.delete(event.pointerId);
      });
    }
    this.stage.addEventListener("pointermove", (event) => {
      if (event.pointerType === "touch") {
        this.moveFinger(event);
      } else if ((event.buttons & 1) !== 0) {
        this.move(event.movementX, event.movementY);
      }
    });
  }

  /** One finger moves the picture; two enlarge it by the change of their distance, about the point between them. */
  private moveFinger(event: PointerEvent): void {
    const before = this.touches.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    this.touches.set(event.pointerId, now);
    const others = [...this.touches].filter(([id]) => id !== event.pointerId);
    if (others.length > 1) return;
    const share = others.length === 1 ? 0.5 : 1;
    this.move(share * (now.x - before.x), share * (now.y - before.y));
    for (const [, other] of others) {
      const distance = Math.hypot(before.x - other.x, before.y - other.y);
      const box = this.stage.getBoundingClientRect();
      const factor = distance > 0 ? Math.hypot(now.x - other.x, now.y - other.y) / distance : 1;
      this.zoomAt(factor, (now.x + other.x) / 2 - box.left, (now.y + other.y) / 2 - box.top);
    }
  }

  private move(x: number, y: number): void {
    this.offset.x += x;
    this.offset.y += y;
    this.zoomAt(1, 0, 0);
  }

  private zoomAt(factor: number, x: number, y: number): void {
    const zoom = Math.min(Math.max(this.zoom * factor, 1), MAX_ZOOM);
    const keep = (offset: number, at: number, size: number) =>
      Math.min(0, Math.max(size * (1 - zoom), at - ((at - offset) * zoom) / this.zoom));
    this.offset = { x: keep(this.offset.x, x, this.box.width), y: keep(this.offset.y, y, this.box.height) };
    this.zoom = zoom;
    // A finger scrolls the page over the whole picture, and moves an enlarged one.
    this.stage.style.touchAction = zoom > 1 ? "none" : "pan-y";
    this.requestDraw();
  }
}

interface Point {
  x: number;
  y: number;
}

interface Placement {
  scale: number;
  x: number;
  y: number;
}

/** Sets the path of the context to the segments of an outline whose kind is wanted. */
function tracePath(
  context: CanvasRenderingContext2D, { segments, kinds }: Outline, { scale, x, y }: Placement, isWanted: (kind: number) => boolean,
): void {
  let lastX = NaN;
  let lastY = NaN;
  context.beginPath();
  for (let i = 0; i < kinds.length; ++i) {
    if (kinds[i]! > KIND_CONTOUR || !isWanted(kinds[i]!)) continue;
    const [x1, y1, x2, y2] = [segments[4 * i]!, segments[4 * i + 1]!, segments[4 * i + 2]!, segments[4 * i + 3]!];
    if (!(Math.abs(x1 - lastX) < JOIN_PX && Math.abs(y1 - lastY) < JOIN_PX)) context.moveTo(x + scale * x1, y + scale * y1);
    context.lineTo(x + scale * x2, y + scale * y2);
    [lastX, lastY] = [x2, y2];
  }
}

function strokePath(context: CanvasRenderingContext2D, colour: string, width: number, dash: number[] = []): void {
  context.setLineDash(dash);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
  context.setLineDash([]);
}
