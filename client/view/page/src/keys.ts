// SPDX-License-Identifier: Apache-2.0
// Keyboard control and its table in the help.
import { byId, element } from "./dom";

export interface Command {
  /** KeyboardEvent.key of each key, with "Shift+" in front for arrows. */
  keys: string[];
  /** How the help shows the keys. */
  shown: string[];
  text: string;
  run: (key: string) => void;
}

export class Keys {
  private readonly dialog = byId("help", HTMLDialogElement);

  constructor(private readonly commands: readonly Command[]) {
    const table = byId("help-table", HTMLTableElement);
    for (const { shown, text } of [...commands, { shown: ["?"], text: "this table" }]) {
      const cell = element("td");
      shown.forEach((key, i) => {
        cell.append(...(i > 0 ? [" "] : []), element("kbd", "", key));
      });
      table.append(element("tr", "", cell, element("td", "", text)));
    }
    byId("help-button", HTMLButtonElement).addEventListener("click", () => {
      this.toggleHelp();
    });
    byId("help-close", HTMLButtonElement).addEventListener("click", () => {
      this.dialog.close();
    });
    document.addEventListener("keydown", (event) => {
      this.onKey(event);
    });
  }

  private toggleHelp(): void {
    if (this.dialog.open) this.dialog.close();
    else this.dialog.showModal();
  }

  private onKey(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "?") {
      event.preventDefault();
      this.toggleHelp();
      return;
    }
    if (this.dialog.open) return;
    // Selections and buttons that have the focus keep the space and the keys with names that they use; characters remain commands.
    const { target } = event;
    if (target instanceof HTMLSelectElement && (event.key === " " || event.key.length > 1)) return;
    if (target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter")) return;
    const isArrow = event.key.startsWith("Arrow");
    const key = isArrow && event.shiftKey ? `Shift+${event.key}` : event.key;
    const command = this.commands.find(({ keys }) => keys.includes(key));
    if (!command) return;
    event.preventDefault();
    command.run(key);
  }
}
