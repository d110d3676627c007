// SPDX-License-Identifier: Apache-2.0
// Light or dark: as the system, unless chosen otherwise on this page.
import { byId } from "./dom";
import { palette, type Palette } from "./palette";

const STORAGE_KEY = "evpose-theme";

export class Theme {
  private readonly system = matchMedia("(prefers-color-scheme: dark)");

  constructor(private readonly onChange: (colours: Palette) => void) {
    this.apply();
    byId("theme-button", HTMLButtonElement).addEventListener("click", () => {
      this.toggle();
    });
    this.system.addEventListener("change", () => {
      this.changed();
    });
  }

  private get isDark(): boolean {
    const chosen = localStorage.getItem(STORAGE_KEY);
    return chosen === null ? this.system.matches : chosen === "dark";
  }

  get colours(): Palette {
    return palette(this.isDark);
  }

  toggle(): void {
    const chosen = this.isDark ? "light" : "dark";
    // If the choice equals the theme of the system, the page follows the system from then on.
    if ((chosen === "dark") === this.system.matches) localStorage.removeItem(STORAGE_KEY);
    else localStorage.setItem(STORAGE_KEY, chosen);
    this.changed();
  }

  private changed(): void {
    this.apply();
    this.onChange(this.colours);
  }

  private apply(): void {
    document.documentElement.dataset["theme"] = this.isDark ? "dark" : "light";
  }
}
