// SPDX-License-Identifier: Apache-2.0
// The axes of the frame of the poses in the 3D view, with their names and that of the frame.
import { BufferAttribute, BufferGeometry, CanvasTexture, Color, Group, LineBasicMaterial, LineSegments, Sprite, SpriteMaterial } from "three";
import type { Palette } from "./palette";

const LABEL_WIDTH_PX = 256;
const LABEL_HEIGHT_PX = 48;
/** Height of a label, as a share of the distance from the eye. */
const LABEL_SIZE = 0.04;

export class FrameAxes {
  readonly group = new Group();

  /** Draws axes of this length, m, in the colours of the plots. */
  draw(name: string, lengthM: number, colours: Palette): void {
    this.clear();
    const ends = [0, 1, 2].map((axis) => [0, 1, 2].map((i) => (i === axis ? lengthM : 0)));
    const axisColours = [0, 1, 2].map((axis) => new Color(colours.axes[axis]).toArray());
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends.flatMap((end) => [0, 0, 0, ...end])), 3));
    geometry.setAttribute("color", new BufferAttribute(new Float32Array(axisColours.flatMap((colour) => [...colour, ...colour])), 3));
    this.group.add(new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true })));
    ["x", "y", "z"].forEach((label, axis) => {
      const [x, y, z] = ends[axis]!.map((value) => 1.15 * value);
      this.group.add(makeLabel(label, colours.axes[axis]!, [x!, y!, z!]));
    });
    this.group.add(makeLabel(name, colours.text, [-0.15 * lengthM, -0.15 * lengthM, -0.15 * lengthM]));
  }

  clear(): void {
    for (const part of this.group.children) {
      if (part instanceof LineSegments) {
        (part.geometry as BufferGeometry).dispose();
        (part.material as LineBasicMaterial).dispose();
      } else if (part instanceof Sprite) {
        part.material.map?.dispose();
        part.material.dispose();
      }
    }
    this.group.clear();
  }
}

function makeLabel(text: string, colour: string, [x, y, z]: [number, number, number]): Sprite {
  const canvas = document.createElement("canvas");
  canvas.width = LABEL_WIDTH_PX;
  canvas.height = LABEL_HEIGHT_PX;
  const context = canvas.getContext("2d")!;
  context.font = "32px system-ui, 'Liberation Sans', 'DejaVu Sans', sans-serif";
  context.fillStyle = colour;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, LABEL_WIDTH_PX / 2, LABEL_HEIGHT_PX / 2, LABEL_WIDTH_PX);
  const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), sizeAttenuation: false, depthTest: false }));
  sprite.scale.set((LABEL_SIZE * LABEL_WIDTH_PX) / LABEL_HEIGHT_PX, LABEL_SIZE, 1);
  sprite.position.set(x, y, z);
  return sprite;
}
