// SPDX-License-Identifier: Apache-2.0
// The 3D view, in the frame of the poses: axes, frustum of the camera, objects, trails, uncertainty of the selected object.
import {
  AmbientLight, Box3, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, Group, Line, LineBasicMaterial, LineDashedMaterial,
  LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, type Object3D, PerspectiveCamera, Quaternion as Rotation, Scene as Scene3,
  SphereGeometry, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { BoxSize, byId, pixelRatio, setText } from "./dom";
import { FrameAxes } from "./frame_axes";
import { objectColour, type Palette } from "./palette";
import type { Camera, Geometry, Quaternion } from "./protocol";
import { eigenSymmetric3 } from "./rotation";
import type { Series } from "./ring";
import { COLUMN, TRUTH_COLUMN, type ObjectTrack, type Store } from "./store";

const TRAIL_POSES = 600;
const MAX_ALTERNATIVES = 4;
/** The view contains the origin of the frame unless it is farther from the camera than this many times the objects. */
const MAX_ORIGIN_DISTANCE = 4;

interface ObjectModel {
  group: Group;
  edges: LineSegments<BufferGeometry, LineBasicMaterial>;
  surface: Mesh<BufferGeometry, MeshLambertMaterial>;
  truth: LineSegments<BufferGeometry, LineDashedMaterial>;
  alternatives: LineSegments<BufferGeometry, LineBasicMaterial>[];
  trail: Line<BufferGeometry, LineBasicMaterial>;
  diameterM: number;
}

export class SpaceView {
  /** False if WebGL does not start: the panel then says so. */
  readonly works: boolean;
  /** True if the processor computes the pictures: they are then drawn less often. */
  isSoftware = false;
  showTruth = true;
  private readonly node = byId("space", HTMLElement);
  private readonly box: BoxSize;
  private readonly info = byId("space-info", HTMLElement);
  private renderer!: WebGLRenderer;
  private controls!: OrbitControls;
  private readonly eye = new PerspectiveCamera(40, 1, 0.001, 1000);
  private readonly scene = new Scene3();
  /** Turns the frame of the poses into that of the renderer (y up, z towards the eye): y is down in the camera frame, and z is up in others. */
  private readonly root = new Group();
  private readonly camera = new Group();
  private readonly axes = new FrameAxes();
  private readonly light = new DirectionalLight(0xffffff, 2);
  private readonly ellipsoid = new Mesh(new SphereGeometry(1, 24, 16), new MeshBasicMaterial({ transparent: true, opacity: 0.35, depthTest: false }));
  private frustum: LineSegments<BufferGeometry, LineBasicMaterial> | null = null;
  private readonly models = new Map<string, ObjectModel>();
  private isViewSet = false;

  constructor(
    private readonly store: Store,
    private colours: Palette,
    requestDraw: () => void,
  ) {
    this.box = new BoxSize(this.node, requestDraw);
    this.works = this.start();
    if (!this.works) return;
    this.root.add(this.ellipsoid, this.camera, this.axes.group);
    this.scene.add(this.root, new AmbientLight(0xffffff, 1.2), this.light);
    this.controls = new OrbitControls(this.eye, this.renderer.domElement);
    this.controls.addEventListener("change", requestDraw);
    byId("view-button", HTMLButtonElement).addEventListener("click", () => {
      this.resetView();
      requestDraw();
    });
    this.setColours(colours);
  }

  private start(): boolean {
    const message = byId("space-message", HTMLElement);
    // three.js writes to the console before it throws. To keep the console clean, WebGL is tried without it first.
    const trial = document.createElement("canvas").getContext("webgl2");
    try {
      if (!trial) throw new Error("no WebGL 2");
      const names = trial.getExtension("WEBGL_debug_renderer_info");
      this.isSoftware = names !== null && /swiftshader|llvmpipe|software/i.test(String(trial.getParameter(names.UNMASKED_RENDERER_WEBGL)));
      trial.getExtension("WEBGL_lose_context")?.loseContext();
      this.renderer = new WebGLRenderer({ antialias: !this.isSoftware, alpha: true });
    } catch {
      setText(message, "This browser does not start WebGL 2, so there is no 3D view. Turn on hardware acceleration in its settings. All other views work.");
      message.hidden = false;
      byId("view-button", HTMLButtonElement).hidden = true;
      return false;
    }
    this.node.append(this.renderer.domElement);
    return true;
  }

  setColours(colours: Palette): void {
    this.colours = colours;
    if (!this.works) return;
    if (this.frustum) this.removeFrustum();  // It is drawn again, with the axes, in the new colours.
    for (const [id, model] of this.models) {
      const colour = objectColour(colours, this.store.objects.get(id)?.index ?? 0);
      model.surface.material.color.set(colour);
      // Above the surface, which has the colour of the object.
      model.trail.material.color.set(colour).lerp(new Color(colours.text), 0.6);
      model.edges.material.color.set(colours.text);
      model.truth.material.color.set(colours.truth);
      for (const alternative of model.alternatives) alternative.material.color.set(colours.states.ambiguous.colour);
    }
  }

  reset(): void {
    if (!this.works) return;
    for (const model of this.models.values()) this.remove(model);
    this.models.clear();
    this.isViewSet = false;
    this.removeFrustum();
    this.root.rotation.x = this.isCameraFrame ? Math.PI : -Math.PI / 2;
    this.root.updateMatrixWorld();
  }

  private get isCameraFrame(): boolean {
    const frame = this.store.scene?.frame;
    return !frame || (frame.pose_of === "object" && frame.camera === null);
  }

  private removeFrustum(): void {
    this.axes.clear();
    if (!this.frustum) return;
    this.camera.remove(this.frustum);
    this.frustum.geometry.dispose();
    this.frustum.material.dispose();
    this.frustum = null;
  }

  private remove(model: ObjectModel): void {
    for (const part of [model.surface, model.edges, model.truth, model.trail, ...model.alternatives]) {
      part.geometry.dispose();
      part.material.dispose();
    }
    this.root.remove(model.group, model.truth, model.trail, ...model.alternatives);
  }

  setGeometry(geometry: Geometry): void {
    if (!this.works) return;
    const previous = this.models.get(geometry.object);
    if (previous) this.remove(previous);
    const surface = new BufferGeometry();
    surface.setAttribute("position", new BufferAttribute(geometry.vertices, 3));
    surface.setIndex(new BufferAttribute(geometry.faces, 1));
    const lines = new BufferGeometry();
    lines.setAttribute("position", new BufferAttribute(geometry.edges, 3));
    const trail = new BufferGeometry();
    trail.setAttribute("position", new BufferAttribute(new Float32Array(3 * TRAIL_POSES), 3));
    const dash = geometry.diameterM / 30;
    const model: ObjectModel = {
      group: new Group(),
      surface: new Mesh(surface, new MeshLambertMaterial({
        flatShading: true, side: DoubleSide, transparent: true, opacity: 0.85, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
      })),
      edges: new LineSegments(lines, new LineBasicMaterial()),
      truth: new LineSegments(lines, new LineDashedMaterial({ dashSize: dash, gapSize: dash })),
      alternatives: Array.from({ length: MAX_ALTERNATIVES }, () => new LineSegments(lines, new LineBasicMaterial({ transparent: true, opacity: 0.6 }))),
      // A short trail lies within the surface.
      trail: new Line(trail, new LineBasicMaterial({ transparent: true, depthTest: false })),
      diameterM: geometry.diameterM,
    };
    model.trail.frustumCulled = false;
    model.trail.renderOrder = 1;
    model.truth.computeLineDistances();
    model.group.add(model.surface, model.edges);
    this.root.add(model.group, model.truth, model.trail, ...model.alternatives);
    this.models.set(geometry.object, model);
    this.setColours(this.colours);
  }

  draw(instantUs: number): void {
    if (!this.works) return;
    const { width, height } = this.box;
    if (width === 0 || height === 0) return;
    const ratio = pixelRatio();
    const canvas = this.renderer.domElement;
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height);
      this.eye.aspect = width / height;
      this.eye.updateProjectionMatrix();
    }
    this.placeCamera(instantUs);
    for (const [id, model] of this.models) {
      const track = this.store.objects.get(id);
      if (track) this.place(model, track, instantUs);
    }
    this.drawFrustum();
    this.drawEllipsoid(instantUs);
    if (!this.isViewSet) this.resetView();
    this.light.position.copy(this.eye.position);
    this.renderer.render(this.scene, this.eye);
    this.expose();
  }

  /** For tests: attributes that README.md lists. */
  private expose(): void {
    const numbers = (part: Object3D | undefined): string =>
      part?.visible ? [...part.position.toArray(), part.quaternion.w, part.quaternion.x, part.quaternion.y, part.quaternion.z].join(" ") : "";
    const { dataset } = this.node;
    dataset["frame"] = this.store.scene?.frame.name ?? "";
    dataset["camera"] = numbers(this.camera);
    dataset["object"] = numbers(this.models.get(this.store.selected)?.group);
  }

  private placeCamera(instantUs: number): void {
    const frame = this.store.scene?.frame;
    this.camera.visible = true;
    if (frame?.pose_of === "camera") {
      const track = this.store.objects.get(this.store.selected);
      const row = track?.rowAt(instantUs) ?? -1;
      this.camera.visible = track !== undefined && row >= 0 && isSeen(track, instantUs);
      if (track && row >= 0) setPose(this.camera, poseAt(track.poses, COLUMN.p, COLUMN.q, row));
    } else if (frame?.camera) {
      setPose(this.camera, poseOf(frame.camera.p, frame.camera.q));
    } else {
      setPose(this.camera, new Matrix4());
    }
  }

  /** Places a part of an object at a pose of the stream. */
  private put(part: Object3D, pose: Matrix4): void {
    // The pose of the camera in the frame of an object gives the object in that of the selected one.
    if (this.store.scene?.frame.pose_of === "camera") setPose(part, this.camera.matrix.clone().multiply(pose.invert()));
    else setPose(part, pose);
  }

  private place(model: ObjectModel, track: ObjectTrack, instantUs: number): void {
    const row = track.rowAt(instantUs);
    model.group.visible = row >= 0;
    const alternatives = row >= 0 && track.stateAt(instantUs) === "ambiguous" ? track.alternativesAt(row) : [];
    model.alternatives.forEach((lines, i) => {
      const alternative = alternatives[i];
      lines.visible = alternative !== undefined && this.camera.visible;
      if (alternative) this.put(lines, poseOf(alternative.p, alternative.q));
    });
    if (row >= 0) {
      this.put(model.group, poseAt(track.poses, COLUMN.p, COLUMN.q, row));
      model.group.visible = this.camera.visible && isSeen(track, instantUs);
    }
    this.placeTruth(model, track, instantUs);
    this.placeTrail(model, track, row);
  }

  private placeTruth(model: ObjectModel, track: ObjectTrack, instantUs: number): void {
    const row = track.truth.lastAt(instantUs);
    model.truth.visible = row >= 0 && this.showTruth && this.camera.visible;
    if (row >= 0) this.put(model.truth, poseAt(track.truth, TRUTH_COLUMN.p, TRUTH_COLUMN.q, row));
  }

  private placeTrail(model: ObjectModel, track: ObjectTrack, row: number): void {
    const first = Math.max(0, row + 1 - TRAIL_POSES);
    const attribute = model.trail.geometry.getAttribute("position") as BufferAttribute;
    for (let i = first; i <= row; ++i) {
      attribute.setXYZ(i - first, track.poses.at(COLUMN.p, i), track.poses.at(COLUMN.p + 1, i), track.poses.at(COLUMN.p + 2, i));
    }
    attribute.needsUpdate = true;
    model.trail.geometry.setDrawRange(0, row + 1 - first);
    // The trail of the camera is in the frame of one object.
    model.trail.visible = row >= 0 && (this.store.scene?.frame.pose_of !== "camera" || track.info.id === this.store.selected);
  }

  /** Position of the object that is shown and farthest from the camera; null if there is none. */
  private focus(): Vector3 | null {
    let farthest: Vector3 | null = null;
    const distance = (position: Vector3) => position.distanceTo(this.camera.position);
    for (const { group } of this.models.values()) {
      if (group.visible && (farthest === null || distance(group.position) > distance(farthest))) farthest = group.position;
    }
    return farthest;
  }

  private drawFrustum(): void {
    const { scene } = this.store;
    const focus = this.focus();
    if (this.frustum || !scene || !focus) return;
    const distance = focus.distanceTo(this.camera.position);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(frustumLines(scene.camera, 0.3 * distance), 3));
    this.frustum = new LineSegments(geometry, new LineBasicMaterial({ color: new Color(this.colours.mutedText) }));
    this.camera.add(this.frustum);
    this.axes.draw(scene.frame.name, 0.15 * distance, this.colours);
  }

  private drawEllipsoid(instantUs: number): void {
    const track = this.store.objects.get(this.store.selected);
    const model = this.models.get(this.store.selected);
    const row = track?.rowAt(instantUs) ?? -1;
    const covariance = track && row >= 0 ? [0, 1, 2, 3, 4, 5].map((i) => track.poses.at(COLUMN.covariance + i, row)) : [];
    this.ellipsoid.visible = covariance.length === 6 && covariance.every(Number.isFinite) && model?.group.visible === true;
    if (!this.ellipsoid.visible || !model || !track) {
      setText(this.info, "");
      return;
    }
    const { values, axes } = eigenSymmetric3(covariance);
    const radii = values.map((value) => 2 * Math.sqrt(Math.max(value, 0)));
    const largest = Math.max(...radii);
    // The uncertainty is far smaller than the object: it is enlarged by the power of ten that makes it visible.
    const factor = largest > 0 ? 10 ** Math.max(0, Math.floor(Math.log10((0.6 * model.diameterM) / largest))) : 1;
    const scaled = axes.map((axis, i) => new Vector3(...axis).multiplyScalar(Math.max(factor * radii[i]!, 1e-6)));
    this.ellipsoid.matrixAutoUpdate = false;
    const position = new Vector3().setFromMatrixPosition(poseAt(track.poses, COLUMN.p, COLUMN.q, row));
    this.ellipsoid.matrix.copy(new Matrix4().makeBasis(scaled[0]!, scaled[1]!, scaled[2]!).setPosition(position));
    this.ellipsoid.material.color.set(this.colours.states[track.stateAt(instantUs)].colour);
    setText(this.info, `2σ ellipsoid${factor > 1 ? ` × ${factor.toLocaleString("en")}` : ""}`);
  }

  /** The eye is beside and above the camera; camera, farthest object and the origin of the frame fill the view. */
  resetView(): void {
    if (!this.works) return;
    const focus = this.focus();
    this.isViewSet = focus !== null;
    const camera = this.camera.position;
    const shown = new Box3().setFromPoints([camera, focus ?? camera.clone().add(new Vector3(0, 0, 1))]);
    const origin = new Vector3();
    if (focus && camera.length() < MAX_ORIGIN_DISTANCE * focus.distanceTo(camera)) shown.expandByPoint(origin);
    let diameter = 0;
    for (const model of this.models.values()) diameter = Math.max(diameter, model.diameterM);
    const radius = 0.5 * shown.getSize(new Vector3()).length() + 0.5 * diameter;
    const halfAngle = (this.eye.fov / 2) * (Math.PI / 180);
    // In the camera frame, camera and object are beside each other: the width of the view needs room for both, the height for less.
    const distance = Math.max((this.isCameraFrame ? 0.65 : 1.1) * radius, (1.1 * radius) / this.eye.aspect) / Math.tan(halfAngle);
    this.controls.target.copy(this.root.localToWorld(shown.getCenter(new Vector3())));
    this.eye.position.set(0.8, 0.45, 0.4).normalize().multiplyScalar(distance).add(this.controls.target);
    this.eye.near = radius / 200;
    this.eye.far = radius * 100;
    this.eye.updateProjectionMatrix();
    this.controls.update();
  }
}

function isSeen(track: ObjectTrack, instantUs: number): boolean {
  const state = track.stateAt(instantUs);
  return state !== "lost" && state !== "initializing";
}

function poseOf(p: readonly number[], [w, x, y, z]: Quaternion): Matrix4 {
  return new Matrix4().compose(new Vector3().fromArray(p), new Rotation(x, y, z, w), new Vector3(1, 1, 1));
}

/** The pose in a row of a series, whose columns begin at these. */
function poseAt(series: Series, position: number, rotation: number, row: number): Matrix4 {
  const values = (first: number, count: number) => Array.from({ length: count }, (_, i) => series.at(first + i, row));
  return poseOf(values(position, 3), values(rotation, 4) as Quaternion);
}

function setPose(part: Object3D, pose: Matrix4): void {
  pose.decompose(part.position, part.quaternion, part.scale);
  part.updateMatrix();
}

function frustumLines(camera: Camera, depth: number): Float32Array {
  const corner = (u: number, v: number): number[] => [((u - camera.cx_px) / camera.fx_px) * depth, ((v - camera.cy_px) / camera.fy_px) * depth, depth];
  const [a, b, c, d] = [corner(0, 0), corner(camera.width, 0), corner(camera.width, camera.height), corner(0, camera.height)];
  const apex = [0, 0, 0];
  // A tick above the upper edge shows which way is up.
  const [l, t, r] = [corner(0.4 * camera.width, 0), corner(0.5 * camera.width, -0.15 * camera.height), corner(0.6 * camera.width, 0)];
  return new Float32Array([apex, a, apex, b, apex, c, apex, d, a, b, b, c, c, d, d, a, l, t, t, r].flat());
}
