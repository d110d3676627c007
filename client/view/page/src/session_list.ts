// SPDX-License-Identifier: Apache-2.0
// The sessions that may be opened.
import { byId, element } from "./dom";
import type { SessionRow } from "./protocol";

const MAX_SHOWN = 500;

export class SessionList {
  private readonly root = byId("session-list", HTMLElement);
  private shown = "";

  constructor(private readonly open: (name: string) => void) {}

  draw(sessions: readonly SessionRow[], source: string): void {
    const key = JSON.stringify(sessions);
    if (key === this.shown) return;
    this.shown = key;
    if (sessions.length === 0) {
      this.root.replaceChildren(element("div", "empty", `The server ${source} has no session. Start one with evpose replay or evpose stream; it appears here.`));
      return;
    }
    const head = element("div", "session head", ...["session", "state", "objects", "created"].map((text, i) => element("span", i > 1 ? "minor" : "", text)));
    const rows = sessions.slice(0, MAX_SHOWN).map((session) => this.row(session));
    if (sessions.length > MAX_SHOWN) rows.push(element("div", "empty", `and ${sessions.length - MAX_SHOWN} more: give the name of one to evpose view`));
    this.root.replaceChildren(head, ...rows);
  }

  private row({ name, state, objects, create_time }: SessionRow): HTMLElement {
    const row = element(
      "button",
      "session",
      element("span", "name", name),
      element("span", "", state),
      element("span", "minor", objects.join(", ")),
      element("span", "minor", create_time),
    );
    row.title = name;
    row.addEventListener("click", () => {
      this.open(name);
    });
    return row;
  }
}
