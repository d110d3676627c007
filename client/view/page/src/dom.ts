// SPDX-License-Identifier: Apache-2.0
// Elements are built from text nodes only, so that names from a server never become markup.

export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  className = "",
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const result = document.createElement(tag);
  if (className !== "") result.className = className;
  result.append(...children);
  return result;
}

export function byId<T extends HTMLElement>(id: string, type: new () => T): T {
  const found = document.getElementById(id);
  if (!(found instanceof type)) throw new Error(`index.html has no ${type.name} with the id ${id}`);
  return found;
}

export function setText(node: Node, text: string): void {
  if (node.textContent !== text) node.textContent = text;
}

export function context2d(canvas: HTMLCanvasElement): CanvasRenderingContext2D {
  const context = canvas.getContext("2d");
  if (!context) throw new Error("the browser has no 2D canvas");
  return context;
}

/** The size of an element, CSS pixels. It is kept, because reading it from the element makes the browser lay out the page. */
export class BoxSize {
  width: number;
  height: number;

  constructor(
    readonly node: HTMLElement,
    onChange: () => void,
  ) {
    this.width = node.clientWidth;
    this.height = node.clientHeight;
    new ResizeObserver(() => {
      this.width = node.clientWidth;
      this.height = node.clientHeight;
      onChange();
    }).observe(node);
  }
}

export function pixelRatio(): number {
  return Math.min(window.devicePixelRatio || 1, 2);
}

/** Gives a canvas the size of its box in pixels of the screen, and clears it; the context's unit is the CSS pixel. */
export function beginDrawing(canvas: HTMLCanvasElement, box: { width: number; height: number }): CanvasRenderingContext2D {
  const ratio = pixelRatio();
  const width = Math.max(1, Math.round(box.width * ratio));
  const height = Math.max(1, Math.round(box.height * ratio));
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const context = context2d(canvas);
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}
