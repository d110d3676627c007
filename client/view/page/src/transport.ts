// SPDX-License-Identifier: Apache-2.0
// Moving through a recording: scrubber, single steps, play at 0.001 to 10 times the speed.
import { byId, element, setText } from "./dom";
import { seconds } from "./format";
import type { Request } from "./protocol";
import type { Store } from "./store";

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];
const SCRUBBER_STEPS = 100000;
/** Time after which a seek is given up if no image has been drawn for it. */
const SEEK_TIMEOUT_MS = 1000;

export class Transport {
  private readonly scrubber = byId("scrubber", HTMLInputElement);
  private readonly speedSelect = byId("speed-select", HTMLSelectElement);
  private readonly playButton = byId("play-button", HTMLButtonElement);
  private speed = 1;
  /** The instant of the latest request; null once its image has arrived. */
  private awaitedUs: number | null = null;
  private nextUs: number | null = null;
  private timer = 0;
  private isDragging = false;

  constructor(
    private readonly store: Store,
    private readonly send: (request: Request) => void,
  ) {
    for (const speed of SPEEDS) this.speedSelect.append(element("option", "", `${speed}×`));
    this.speedSelect.selectedIndex = SPEEDS.indexOf(1);
    this.speedSelect.addEventListener("change", () => {
      this.setSpeed(this.speedSelect.selectedIndex);
    });
    this.playButton.addEventListener("click", () => {
      this.toggle();
    });
    byId("back-button", HTMLButtonElement).addEventListener("click", () => {
      this.step(-1);
    });
    byId("forward-button", HTMLButtonElement).addEventListener("click", () => {
      this.step(1);
    });
    this.scrubber.addEventListener("input", () => {
      this.isDragging = true;
      this.seek(this.scrubbedUs());
    });
    this.scrubber.addEventListener("change", () => {
      this.isDragging = false;
    });
  }

  private scrubbedUs(): number {
    const range = this.store.recordedRange;
    return range ? Math.round(range.from_us + (Number(this.scrubber.value) / SCRUBBER_STEPS) * (range.to_us - range.from_us)) : 0;
  }

  /** Requests the picture of an instant. While one is awaited, only the newest further request is kept. */
  seek(t_us: number): void {
    const range = this.store.recordedRange;
    if (!range) return;
    const target = Math.min(Math.max(t_us, range.from_us), range.to_us);
    if (this.awaitedUs !== null) {
      this.nextUs = target;
      return;
    }
    this.awaitedUs = target;
    this.send({ type: "seek", t_us: target });
    this.timer = setTimeout(() => {
      this.imageShown();
    }, SEEK_TIMEOUT_MS);
  }

  /** Sends the request that waits, because an image has been drawn or was given up. */
  imageShown(): void {
    if (this.awaitedUs === null) return;
    clearTimeout(this.timer);
    this.awaitedUs = null;
    const next = this.nextUs;
    this.nextUs = null;
    if (next !== null) this.seek(next);
  }

  step(count: number): void {
    if (this.store.range) this.send({ type: "step", count });
  }

  toggle(): void {
    const { position, range, recordedRange } = this.store;
    if (!range || !recordedRange) return;
    if (position?.playing) {
      this.send({ type: "pause" });
      return;
    }
    // A play ends with the last event: after the end, the recording is played from its beginning.
    if (range.complete && position && position.t_us >= range.to_us) this.send({ type: "seek", t_us: recordedRange.from_us });
    this.send({ type: "play", speed: this.speed });
  }

  /** Chooses the next faster (1) or slower (-1) speed. */
  changeSpeed(by: number): void {
    this.setSpeed(this.speedSelect.selectedIndex + by);
  }

  toEnd(isEnd: boolean): void {
    const range = this.store.recordedRange;
    if (range) this.seek(isEnd ? range.to_us : range.from_us);
  }

  private setSpeed(index: number): void {
    const chosen = Math.min(Math.max(index, 0), SPEEDS.length - 1);
    this.speedSelect.selectedIndex = chosen;
    this.speed = SPEEDS[chosen]!;
    if (this.store.position?.playing) this.send({ type: "play", speed: this.speed });
  }

  draw(instantUs: number): void {
    const range = this.store.recordedRange;
    byId("transport", HTMLElement).hidden = !range;
    if (!range) return;
    const isPlaying = this.store.position?.playing === true;
    this.playButton.classList.toggle("playing", isPlaying);
    if (!this.isDragging) this.scrubber.value = String(Math.round((SCRUBBER_STEPS * (instantUs - range.from_us)) / Math.max(1, range.to_us - range.from_us)));
    const reading = this.store.range?.complete === false ? `, read to ${seconds(this.store.range.to_us, 1)} s` : "";
    setText(byId("instant", HTMLElement), `${seconds(instantUs, 4)} s${reading}`);
  }
}
