// SPDX-License-Identifier: Apache-2.0
// Colours. Those of states and axes are Okabe and Ito's, which people with a colour vision deficiency can tell apart; a state has
// a line style and a symbol, and an object a number, as well.
import type { CellColours } from "./cells";
import type { ShownState } from "./store";

export interface StateStyle {
  label: string;
  symbol: string;
  colour: string;
  /** Lengths of dashes and gaps, px; empty: a solid line. */
  dash: number[];
}

export interface Palette {
  states: Record<ShownState, StateStyle>;
  objects: readonly string[];
  axes: readonly [string, string, string];
  cells: CellColours;
  casing: string;
  truth: string;
  text: string;
  mutedText: string;
  grid: string;
  panel: string;
  accent: string;
}

function states(colours: Record<ShownState, string>): Record<ShownState, StateStyle> {
  return {
    tracking: { label: "tracking", symbol: "●", colour: colours.tracking, dash: [] },
    degraded: { label: "degraded", symbol: "▲", colour: colours.degraded, dash: [9, 4] },
    ambiguous: { label: "ambiguous", symbol: "◆", colour: colours.ambiguous, dash: [2, 3] },
    lost: { label: "lost", symbol: "✕", colour: colours.lost, dash: [2, 8] },
    initializing: { label: "initializing", symbol: "○", colour: colours.initializing, dash: [2, 8] },
    none: { label: "no pose", symbol: "–", colour: colours.none, dash: [2, 8] },
  };
}

// ImageData is in the order R, G, B, A in memory.
function abgr(hex: string): number {
  const rgb = parseInt(hex.slice(1), 16);
  return (0xff000000 | ((rgb & 0xff) << 16) | (rgb & 0xff00) | (rgb >>> 16)) >>> 0;
}

function cells(background: string, on: string, off: string, both: string): CellColours {
  return { background: abgr(background), on: abgr(on), off: abgr(off), both: abgr(both) };
}

const DARK: Palette = {
  states: states({
    tracking: "#1fd6a0", degraded: "#f5b02e", ambiguous: "#e48fc0", lost: "#ff6b3d", initializing: "#9aa7b8", none: "#5d6878",
  }),
  objects: ["#5cc0f5", "#f0e442", "#a48bff", "#ff9db0", "#b3dd8a", "#d8a878", "#8fe3e8", "#c9c9d6"],
  axes: ["#ff7f50", "#22c493", "#5aa9f0"],
  cells: cells("#10151d", "#dfe6f0", "#3f78c4", "#93b3de"),
  casing: "rgba(6, 9, 14, 0.8)",
  truth: "#ff5ce1",
  text: "#e4e9f0", mutedText: "#93a0b2", grid: "#232c39", panel: "#151b25", accent: "#5cc0f5",
};

const LIGHT: Palette = {
  states: states({
    tracking: "#00875f", degraded: "#b87400", ambiguous: "#b0508a", lost: "#cf4a00", initializing: "#6b7787", none: "#a9b3c0",
  }),
  objects: ["#0a78c2", "#b39b00", "#6a48d7", "#d1426a", "#4f8f1c", "#8f5a24", "#0d8a92", "#5f5f70"],
  axes: ["#cf4a00", "#00875f", "#0a6ebd"],
  cells: cells("#ffffff", "#4a7fc9", "#1d2738", "#36507c"),
  casing: "rgba(255, 255, 255, 0.85)",
  truth: "#c400a6",
  text: "#18202b", mutedText: "#5b6675", grid: "#e3e8ee", panel: "#ffffff", accent: "#0a6ebd",
};

export function palette(isDark: boolean): Palette {
  return isDark ? DARK : LIGHT;
}

export function objectColour(colours: Palette, index: number): string {
  return colours.objects[index % colours.objects.length]!;
}
