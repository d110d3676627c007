// SPDX-License-Identifier: Apache-2.0
// The plots of the selected object and of the session, with a shared time axis and cursor.
import uPlot from "uplot";
import { byId, element, setText } from "./dom";
import { fixed } from "./format";
import type { Palette } from "./palette";
import { positionColumns, rotationColumns, selectRows, timeColumn, truthColumns, valueColumn, type Column, type Reference } from "./plot_data";
import { DEGREES } from "./rotation";
import { COLUMN, type ObjectTrack, type Store } from "./store";

const LIVE_ROWS = 700;
const RECORDED_ROWS = 20480;
const AXIS_WIDTH_PX = 46;
const HEALTH_GAP_US = 5e6;

interface Line {
  label: string;
  colour: string;
}

interface Definition {
  title: string;
  unit: string;
  lines: Line[];
  /** Each line is followed by its upper and lower limit. */
  hasBands: boolean;
  digits: number;
  /** Smallest range of the vertical axis. */
  minSpan: number;
  fromZero: boolean;
}

interface Plot {
  definition: Definition;
  uplot: uPlot;
  box: HTMLElement;
  values: HTMLElement[];
  mark: HTMLElement;
}

type Data = [number[], ...Column[]];

export class Plots {
  showTruth = true;
  isRelative = true;
  /** Time that live plots show, s. */
  spanS = 20;
  private plots: Plot[] = [];
  private readonly root = byId("plots", HTMLElement);
  private isSettingScale = false;
  /** The part of the recording that the user has chosen, s. New plots show it, too. */
  private zoomS: { min: number; max: number } | null = null;
  private shape = "";
  private dataKey = "";
  private cursorS: number | null = null;

  constructor(
    private readonly store: Store,
    private colours: Palette,
    private readonly seek: (t_us: number) => void,
    private readonly requestDraw: () => void,
  ) {
    new ResizeObserver(() => {
      this.fit();
    }).observe(this.root);
  }

  setColours(colours: Palette): void {
    this.colours = colours;
    this.shape = "";
  }

  reset(): void {
    this.zoomS = null;
    this.shape = "";
  }

  private get hasTruth(): boolean {
    return this.store.scene?.has_truth === true && this.showTruth;
  }

  private definitions(): Definition[] {
    const axes = (labels: string[]) => labels.map((label, i) => ({ label, colour: this.colours.axes[i]! }));
    const one = (title: string, unit: string, label: string, digits: number, minSpan: number): Definition =>
      ({ title, unit, lines: [{ label, colour: this.colours.accent }], hasBands: false, digits, minSpan, fromZero: true });
    const pose = [
      { title: "Position", unit: this.isRelative ? "mm, ±2σ" : "m, ±2σ", lines: axes(["x", "y", "z"]),
        hasBands: true, digits: this.isRelative ? 1 : 4, minSpan: this.isRelative ? 0.5 : 5e-4, fromZero: false },
      { title: "Rotation", unit: "°, ±2σ", lines: axes(["x", "y", "z"]), hasBands: true, digits: 2, minSpan: 0.2, fromZero: false },
      one("Speed", "m/s", "", 3, 0.01),
      one("Turn rate", "°/s", "", 1, 1),
      one("Explained", "share of events", "", 2, 1),
    ];
    const eventRate = one("Event rate", "Mev/s", "", 2, 0.1);
    if (this.store.isRecording) return this.store.eventRates.length > 0 ? [...pose, eventRate] : pose;
    return [
      ...pose,
      eventRate,
      { title: "Latency", unit: "ms", lines: [{ label: "p50", colour: this.colours.axes[2] }, { label: "p99", colour: this.colours.axes[0] }], hasBands: false,
        digits: 1, minSpan: 1, fromZero: true },
    ];
  }

  /** Draws all plots; `instantUs` is the instant of a recording, or null. */
  draw(toUs: number, instantUs: number | null): void {
    const track = this.store.objects.get(this.store.selected);
    const shape = JSON.stringify([this.store.scene?.session, this.isRelative, this.hasTruth, this.store.isRecording, this.store.eventRates.length > 0]);
    if (shape !== this.shape) this.create(shape);
    const key = `${this.store.version} ${this.store.selected} ${toUs} ${this.spanS} ${shape}`;
    if (key !== this.dataKey && track) this.fill(track, toUs);
    this.dataKey = key;
    this.placeMarks(instantUs);
    this.showValues(instantUs);
  }

  private fill(track: ObjectTrack, toUs: number): void {
    const { poses } = track;
    const isRecording = this.store.isRecording;
    const fromUs = isRecording ? -Infinity : this.store.liveFromUs(this.spanS);
    const rows = selectRows(poses, Math.max(0, poses.lastAt(fromUs)), poses.length, isRecording ? RECORDED_ROWS : LIVE_ROWS, track.gapUs);
    const times = timeColumn(poses, rows);
    const reference: Reference = this.isRelative && track.origin ? { origin: track.origin, scale: 1000 } : { origin: [0, 0, 0], scale: 1 };
    const truth = this.hasTruth ? truthColumns(track, reference) : null;
    const withTruth = (columns: Column[], truths: Column[] | undefined): Data =>
      truth && truths ? (uPlot.join([[times, ...columns], [truth.times, ...truths]] as uPlot.AlignedData[]) as Data) : [times, ...columns];
    const data: Data[] = [
      withTruth(positionColumns(track, rows, reference), truth?.position),
      withTruth(rotationColumns(track, rows), truth?.rotation),
      [times, valueColumn(poses, rows, COLUMN.speed)],
      [times, valueColumn(poses, rows, COLUMN.turnRate, (value) => value * DEGREES)],
      [times, valueColumn(poses, rows, COLUMN.explained)],
    ];
    if (!isRecording) data.push(...this.healthData(fromUs));
    else if (this.plots.length > data.length) data.push(this.recordedRates());
    const range = isRecording ? this.store.recordedRange : { from_us: fromUs, to_us: toUs };
    const shownS = this.zoomS ?? (range && { min: range.from_us / 1e6, max: range.to_us / 1e6 });
    this.isSettingScale = true;
    this.plots.forEach((plot, i) => {
      plot.uplot.batch(() => {
        plot.uplot.setData(data[i] as uPlot.AlignedData, false);
        if (shownS) plot.uplot.setScale("x", shownS);
      });
    });
    this.isSettingScale = false;
  }

  private healthData(fromUs: number): Data[] {
    const health = this.store.healthSeries;
    const rows = selectRows(health, Math.max(0, health.lastAt(fromUs)), health.length, LIVE_ROWS, HEALTH_GAP_US);
    const times = timeColumn(health, rows);
    return [
      [times, valueColumn(health, rows, 1, (value) => value / 1e6)],
      [times, valueColumn(health, rows, 2), valueColumn(health, rows, 3)],
    ];
  }

  private recordedRates(): Data {
    const rates = this.store.eventRates;
    const rows = Array.from({ length: rates.length }, (_, i) => i);
    return [timeColumn(rates, rows), valueColumn(rates, rows, 1, (value) => value / 1e6)];
  }

  private create(shape: string): void {
    this.shape = shape;
    this.dataKey = "";  // The new plots are empty.
    for (const plot of this.plots) plot.uplot.destroy();
    const definitions = this.definitions();
    this.plots = [];
    this.root.replaceChildren();
    definitions.forEach((definition, i) => {
      const values = definition.lines.map((line) => {
        const value = element("span", "key");
        value.style.color = line.colour;
        return value;
      });
      const head = element("div", "plot-head", element("b", "", definition.title), element("span", "unit", definition.unit), element("span", "spring"), ...values);
      const box = element("div", "plot-box");
      const isLast = i === definitions.length - 1;
      this.root.append(element("div", isLast ? "plot last" : "plot", head, box));
      const mark = element("div", "instant-mark");
      const uplot = new uPlot(this.options(definition, isLast, i < 2), [[], ...this.series(definition, i < 2).map(() => [])] as uPlot.AlignedData, box);
      uplot.over.append(mark);
      this.listen(uplot);
      this.plots.push({ definition, uplot, box, values, mark });
    });
    this.fit();
  }

  private series(definition: Definition, canHaveTruth: boolean): uPlot.Series[] {
    const result: uPlot.Series[] = [];
    for (const { colour } of definition.lines) {
      result.push({ stroke: colour, width: 1.5, points: { show: false } });
      if (definition.hasBands) result.push({ width: 0, points: { show: false } }, { width: 0, points: { show: false } });
    }
    if (this.hasTruth && canHaveTruth) {
      for (let i = 0; i < 3; ++i) result.push({ stroke: this.colours.truth, width: 1, dash: [2, 5], points: { show: false } });
    }
    return result;
  }

  private options(definition: Definition, isLast: boolean, canHaveTruth: boolean): uPlot.Options {
    const { mutedText, grid } = this.colours;
    const font = "10px system-ui, 'Liberation Sans', 'DejaVu Sans', sans-serif";
    const axis = { stroke: mutedText, grid: { stroke: grid, width: 1 }, ticks: { show: false }, font };
    return {
      width: 100, height: 50, legend: { show: false }, padding: [6, 10, 6, 0],
      series: [{}, ...this.series(definition, canHaveTruth)],
      bands: definition.hasBands ? [0, 1, 2].map((i) => ({ series: [3 * i + 2, 3 * i + 3] as [number, number], fill: `${definition.lines[i]!.colour}3d` })) : [],
      scales: { x: { time: false }, y: { range: (_, min, max) => verticalRange(definition, min, max) } },
      axes: [
        { ...axis, size: isLast ? 22 : 0, gap: 4, space: 56, values: isLast ? (_, ticks) => ticks.map((tick) => `${Number(tick.toFixed(6))} s`) : () => [] },
        { ...axis, size: AXIS_WIDTH_PX, gap: 4, space: 14, values: (_, ticks) => ticks.map((tick) => String(Number(tick.toPrecision(6)))) },
      ],
      cursor: {
        sync: { key: "evpose", scales: ["x", null] }, y: false, points: { show: false },
        drag: { x: this.store.isRecording, y: false, setScale: true, dist: 4 },
      },
      hooks: {
        setCursor: [(u) => {
          this.cursorS = u.cursor.left !== undefined && u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null;
          this.requestDraw();
        }],
        setScale: [(u, scale) => {
          if (scale === "x") this.shareScale(u);
        }],
      },
    };
  }

  /** Gives the other plots the range that was chosen in one of them. */
  private shareScale(from: uPlot): void {
    if (this.isSettingScale) return;
    const { min, max } = from.scales["x"] ?? {};
    if (min == null || max == null) return;
    this.zoomS = { min, max };
    this.setScale(this.zoomS, from);
  }

  /** Sets the range of the other plots. In a batch the hook of setScale runs at once, otherwise only after this function. */
  private setScale(rangeS: { min: number; max: number }, except: uPlot | null): void {
    this.isSettingScale = true;
    for (const { uplot } of this.plots) {
      if (uplot === except) continue;
      uplot.batch(() => {
        uplot.setScale("x", rangeS);
      });
    }
    this.isSettingScale = false;
  }

  private listen(uplot: uPlot): void {
    let pressedAt = 0;
    uplot.over.addEventListener("pointerdown", (event) => {
      pressedAt = event.clientX;
    });
    uplot.over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressedAt) > 3) return;
      this.seek(Math.round(uplot.posToVal(event.offsetX, "x") * 1e6));
    });
    uplot.over.addEventListener("dblclick", () => {
      const range = this.store.recordedRange;
      if (range) this.setScale({ min: range.from_us / 1e6, max: range.to_us / 1e6 }, null);
      this.zoomS = null;
    });
  }

  private placeMarks(instantUs: number | null): void {
    for (const { uplot, mark } of this.plots) {
      const left = instantUs === null ? -1 : uplot.valToPos(instantUs / 1e6, "x");
      mark.hidden = !(left >= 0 && left <= uplot.over.clientWidth);
      mark.style.transform = `translateX(${left}px)`;
    }
  }

  /** The values beside the titles: at the mouse, else at the instant, else the last ones. */
  private showValues(instantUs: number | null): void {
    const time = this.cursorS ?? (instantUs === null ? Infinity : instantUs / 1e6);
    for (const { definition, uplot, values } of this.plots) {
      const times = uplot.data[0];
      const row = time === Infinity ? times.length - 1 : lastAt(times, time);
      values.forEach((node, i) => {
        const value = uplot.data[definition.hasBands ? 3 * i + 1 : i + 1]?.[row];
        const { label } = definition.lines[i]!;
        setText(node, `${label} ${value == null ? "–" : fixed(value, definition.digits)}`.trim());
      });
    }
  }

  private fit(): void {
    for (const { uplot, box } of this.plots) {
      const [width, height] = [box.clientWidth, box.clientHeight];
      if (width > 0 && height > 0 && (uplot.width !== width || uplot.height !== height)) uplot.setSize({ width, height });
    }
  }
}

function verticalRange(definition: Definition, min: number | null, max: number | null): [number, number] {
  let low = min ?? 0;
  let high = max ?? 0;
  if (definition.fromZero) return [0, Math.max(1.08 * high, definition.minSpan)];
  const pad = Math.max(0.08 * (high - low), (definition.minSpan - (high - low)) / 2);
  low -= pad;
  high += pad;
  return [low, high];
}

function lastAt(times: ArrayLike<number>, time: number): number {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}
