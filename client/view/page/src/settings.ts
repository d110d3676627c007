// SPDX-License-Identifier: Apache-2.0
// The choices of the toolbar: a select element whose options are numbers, also changed by keys.
import { byId, element } from "./dom";

export class Choice {
  private readonly select: HTMLSelectElement;

  constructor(
    id: string,
    private readonly values: readonly number[],
    unit: string,
    initial: number,
    onChange: () => void,
  ) {
    this.select = byId(id, HTMLSelectElement);
    for (const value of values) this.select.append(element("option", "", `${value} ${unit}`));
    this.select.selectedIndex = values.indexOf(initial);
    this.select.addEventListener("change", onChange);
  }

  get value(): number {
    return this.values[this.select.selectedIndex]!;
  }

  /** Chooses the next larger (1) or smaller (-1) value. */
  change(by: number): void {
    const index = Math.min(Math.max(this.select.selectedIndex + by, 0), this.values.length - 1);
    if (index === this.select.selectedIndex) return;
    this.select.selectedIndex = index;
    this.select.dispatchEvent(new Event("change"));
  }
}
