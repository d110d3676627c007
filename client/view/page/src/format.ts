// SPDX-License-Identifier: Apache-2.0
// Numbers as text.

/** Sensor time in seconds. */
export function seconds(t_us: number, digits = 3): string {
  return (t_us / 1e6).toFixed(digits);
}

export function duration(us: number): string {
  if (!Number.isFinite(us)) return "";
  if (us < 1e6) return `${(us / 1e3).toFixed(us < 1e4 ? 1 : 0)} ms`;
  if (us < 120e6) return `${(us / 1e6).toFixed(2)} s`;
  const s = Math.round(us / 1e6);
  return `${Math.floor(s / 60)} min ${s % 60} s`;
}

/** A count or a rate with a prefix: 8.52 M. */
export function withPrefix(value: number): string {
  if (!Number.isFinite(value)) return "–";
  const rounded = Number(value.toPrecision(3));
  for (const [limit, prefix] of [[1e9, "G"], [1e6, "M"], [1e3, "k"]] as const) {
    if (Math.abs(rounded) >= limit) return `${(rounded / limit).toPrecision(3)} ${prefix}`;
  }
  return `${rounded} `;
}

export function fixed(value: number, digits: number): string {
  return Number.isFinite(value) ? value.toFixed(digits) : "–";
}
