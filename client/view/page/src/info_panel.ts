// SPDX-License-Identifier: Apache-2.0
// The objects with their states, the pose of the selected one, and the health of the session.
import { byId, element, setText } from "./dom";
import { fixed, seconds, withPrefix } from "./format";
import { objectColour, type Palette } from "./palette";
import { DEGREES } from "./rotation";
import { COLUMN, STATES, type ObjectTrack, type Store } from "./store";

export interface DisplayFigures {
  framesPerSecond: number;
  imagesDrawn: number;
  imageEvents: number;
  imageSpanUs: number;
  imagesSkipped: number;
}

type Row = readonly [key: string, value: string, extra?: string];

export class InfoPanel {
  private readonly objects = byId("objects", HTMLElement);
  private readonly pose = byId("pose", HTMLElement);
  private readonly health = byId("health", HTMLElement);
  private objectRows: HTMLElement[] = [];
  private shape = "";

  constructor(
    private readonly store: Store,
    private colours: Palette,
    private readonly select: (id: string) => void,
  ) {}

  setColours(colours: Palette): void {
    this.colours = colours;
    this.shape = "";
  }

  draw(instantUs: number, figures: DisplayFigures): void {
    this.drawObjects(instantUs);
    this.drawPose(instantUs);
    fillValues(this.health, this.healthRows(figures));
  }

  private drawObjects(instantUs: number): void {
    const tracks = [...this.store.objects.values()];
    const shape = JSON.stringify(tracks.map(({ info }) => info));
    if (shape !== this.shape) {
      this.shape = shape;
      this.objectRows = tracks.map((track) => this.objectRow(track));
      this.objects.replaceChildren(...this.objectRows);
    }
    tracks.forEach((track, i) => {
      const row = this.objectRows[i]!;
      const style = this.colours.states[track.stateAt(instantUs)];
      row.classList.toggle("selected", track.info.id === this.store.selected);
      const state = row.children[2] as HTMLElement;
      setText(state, `${style.symbol} ${style.label}`);
      state.style.color = style.colour;
      const size = track.info.diameter_m > 0 ? `, ${Number(track.info.diameter_m.toPrecision(4))} m across` : "";
      row.title = `${track.info.model}${size}${track.health?.detail ? `: ${track.health.detail}` : ""}`;
    });
  }

  private objectRow(track: ObjectTrack): HTMLElement {
    const number = element("span", "number", String(track.index + 1));
    number.style.background = objectColour(this.colours, track.index);
    const row = element("button", "object", number, element("span", "name", track.info.id), element("span", "state"));
    row.addEventListener("click", () => {
      this.select(track.info.id);
    });
    return row;
  }

  private drawPose(instantUs: number): void {
    const track = this.store.objects.get(this.store.selected);
    const row = track?.rowAt(instantUs) ?? -1;
    const { dataset } = this.pose;
    dataset["object"] = track?.info.id ?? "";
    if (!track || row < 0) {
      for (const name of ["tUs", "seq", "state", "p", "q"]) dataset[name] = "";
      fillValues(this.pose, [["pose", "none yet"]]);
      return;
    }
    const value = (column: number) => track.poses.at(column, row);
    const values = (column: number, count: number) => Array.from({ length: count }, (_, i) => value(column + i));
    dataset["tUs"] = String(value(COLUMN.t));
    dataset["seq"] = String(value(COLUMN.seq));
    dataset["state"] = STATES[value(COLUMN.state)]!;
    dataset["p"] = values(COLUMN.p, 3).join(" ");
    dataset["q"] = values(COLUMN.q, 4).join(" ");
    const twoSigma = (column: number, scale: number, digits: number, unit: string) =>
      Number.isFinite(value(column)) ? `± ${fixed(2 * scale * value(column), digits)} ${unit}` : "";
    const rows: Row[] = ["x", "y", "z"].map((axis, i): Row =>
      [`position ${axis}`, `${fixed(value(COLUMN.p + i), 4)} m`, twoSigma(COLUMN.sigma + i, 1000, 2, "mm")]);
    ["x", "y", "z"].forEach((axis, i) => {
      rows.push([`rotation ${axis}`, `${fixed(value(COLUMN.rotation + i) * DEGREES, 2)}°`, twoSigma(COLUMN.sigma + 3 + i, DEGREES, 2, "°")]);
    });
    rows.push(["speed", `${fixed(value(COLUMN.speed), 3)} m/s`, `${fixed(value(COLUMN.turnRate) * DEGREES, 0)} °/s`]);
    rows.push(["explained", `${fixed(100 * value(COLUMN.explained), 0)} %`, `${seconds(value(COLUMN.t))} s`]);
    track.alternativesAt(row).forEach(({ p, llr }, i) => {
      rows.push([`alternative ${i + 1}`, `log ratio ${fixed(llr, 1)}`, `at ${p.map((x) => fixed(x, 3)).join(", ")} m`]);
    });
    if (track.health?.detail && track.stateAt(instantUs) !== "tracking") rows.push(["detail", track.health.detail]);
    fillValues(this.pose, rows);
  }

  private healthRows(figures: DisplayFigures): Row[] {
    const rows: Row[] = [];
    const { health } = this.store;
    if (health) {
      rows.push(["event rate", `${withPrefix(health.event_rate_hz)}ev/s`, ""]);
      rows.push(["latency", `${fixed(health.latency_ms.p50, 1)} ms`, `p99 ${fixed(health.latency_ms.p99, 1)}`]);
      rows.push(["poses", `${fixed(health.pose_rate_hz, 0)} /s`, `load ${fixed(100 * health.real_time_ratio, 0)} %`]);
      rows.push(["unused events", withPrefix(health.dropped + health.skipped).trim(), `${withPrefix(health.decode_faults).trim()} faults`]);
    }
    rows.push(["image", `${withPrefix(figures.imageEvents)}ev`, `${fixed(figures.imageSpanUs / 1000, 1)} ms`]);
    rows.push(["display", `${fixed(figures.framesPerSecond, 0)} /s`, `${figures.imagesSkipped} skipped`]);
    return rows;
  }
}

/** Fills a grid of three columns; reuses its elements. */
function fillValues(root: HTMLElement, rows: readonly Row[]): void {
  root.className = "values";
  const wanted = rows.flatMap(([key, value, extra]): [string, string][] =>
    extra === undefined ? [["key", key], ["value wide", value]] : [["key", key], ["value", value], ["extra", extra]]);
  while (root.children.length > wanted.length) root.lastChild?.remove();
  wanted.forEach(([className, text], i) => {
    const node = root.children[i] ?? root.appendChild(element("span"));
    if (node.className !== className) node.className = className;
    setText(node, text);
  });
}
