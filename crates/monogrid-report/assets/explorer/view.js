// The view in three dimensions: camera, layers, picking and measuring. Drawn when something changes, not all the time.
import { OrbitControls, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from 'three';
import { Group, cubesLayer, freeLayer, frustaLayer, lineLayer, linksLayer, markAt, pointsLayer, sharedUniforms, surfaceLayer } from 'explorer/layers';
import { extent, length, quantiles } from 'explorer/data';
import { isDark } from 'explorer/colours';

// A frame that takes longer than this while the view moves is drawn with less.
const SLOW_MS = 45;
// Share of points and cubes that is always drawn.
const LEAST_SHARE = 0.04;
// Points and cubes that a computer without a graphics card draws twenty times a second.
const AFFORDABLE = 60000;
// With fewer cells than this the cloud says more, and is shown at once.
const FEW_CELLS = 5000;
// Milliseconds after which a view that no longer moves is drawn in full.
const REST_MS = 180;

// Distance along a ray at which it enters a box, if it does.
function entry(origin, direction, low, high) {
  let near = 0;
  let far = Infinity;
  for (let axis = 0; axis < 3; axis++) {
    const a = (low[axis] - origin[axis]) / direction[axis];
    const b = (high[axis] - origin[axis]) / direction[axis];
    near = Math.max(near, Math.min(a, b));
    far = Math.min(far, Math.max(a, b));
  }
  return near <= far ? near : null;
}

export class View {
  constructor(canvas, data, say) {
    this.canvas = canvas;
    this.data = data;
    this.say = say;
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: 'high-performance' });
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(45, 1, 1, 10);
    this.camera.up.set(0, 0, 1);
    this.surround(...extent(data));
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.zoomToCursor = true;
    this.shared = sharedUniforms(this.heights());
    this.layers = this.build();
    this.marks = new Group();
    this.place = new Group();
    this.scene.add(this.marks, this.place, ...Object.values(this.layers).map((layer) => layer.object));
    this.picked = [];
    this.mustHurry = this.hasNoGraphicsCard();
    this.movingShare = this.mustHurry ? Math.min(1, AFFORDABLE / this.amount()) : 1;
    this.isMoving = false;
    this.wasMoving = false;
    this.listen();
    this.resize();
    this.lookFrom('corner');
  }

  // What there is to see lies between these corners.
  surround(low, high) {
    this.box = [low, high];
    this.centre = low.map((value, i) => (value + high[i]) / 2);
    this.radius = Math.max(1e-6, Math.hypot(...low.map((value, i) => (high[i] - value) / 2)));
    this.camera.near = this.radius / 500;
    this.camera.far = this.radius * 50;
    this.camera.updateProjectionMatrix();
  }

  // Heights between which colours are spread: those of what is shown at first.
  heights(most = this.data.cut ?? Infinity) {
    const { occupied, points, path } = this.data;
    const take = (source, at) => {
      const every = Math.max(1, Math.floor(source.count / 20000));
      const values = [];
      for (let i = 0; i < source.count; i += every) values.push(at(i)[2]);
      return values.filter((height) => height <= most);
    };
    if (occupied?.count) return quantiles(take(occupied, (i) => occupied.centre(i)), 0.02, 0.98);
    if (points?.count) return quantiles(take(points, (i) => points.at(i)), 0.02, 0.98);
    return quantiles(path.map((p) => p[3]), 0, 1);
  }

  // Layers by name, with what a switch is called and whether it is on.
  build() {
    const { occupied, free, points, surface, keyframes, camera, links, path, reference } = this.data;
    const layers = {};
    if (occupied?.count) {
      this.cubes = cubesLayer(occupied, this.shared);
      const object = new Group();
      object.add(this.cubes.exact, this.cubes.quick);
      this.cubes.quick.visible = false;
      layers.cells = { name: `cells (${occupied.count.toLocaleString('en')})`, object, on: true };
    }
    if (points?.count) {
      this.points = pointsLayer(points, this.shared);
      layers.cloud = { name: `cloud (${points.count.toLocaleString('en')} points)`, object: this.points.layer, on: !(occupied?.count > FEW_CELLS) };
    }
    if (surface) layers.surface = { name: 'surface', object: surfaceLayer(surface, this.shared), on: false };
    if (free?.count) layers.free = { name: 'free space', object: freeLayer(free, this.shared), on: false };
    if (path.length > 1) {
      const line = lineLayer(path.map((p) => p.slice(1)), isDark() ? 0xf0f0f0 : 0x151515);
      const object = new Group();
      object.add(line);
      object.add(markAt(path[0].slice(1), 0.02 * this.radius, 0x1f9e77));
      object.add(markAt(path[path.length - 1].slice(1), 0.02 * this.radius, 0xc7372f));
      layers.path = { name: 'path', object, on: true };
    }
    if (reference.length > 1) layers.reference = { name: 'true path', object: lineLayer(reference, 0x999999), on: true };
    if (keyframes.length && camera) {
      this.frustumDepth = 0.06 * this.radius;
      layers.keyframes = { name: `keyframes (${keyframes.length})`, object: frustaLayer(keyframes, camera, 0.5 * this.frustumDepth, 0x3f7fc0), on: false };
    }
    if (links.length) layers.links = { name: `loops (${links.length})`, object: linksLayer(keyframes, links, 0xd9822b), on: false };
    for (const layer of Object.values(layers)) layer.object.visible = layer.on;
    return layers;
  }

  show(name, on) {
    this.layers[name].object.visible = on;
    this.draw();
  }
  cut(low, high) {
    this.shared.shownHeights.value = [low, high];
    this.draw();
  }
  colourCells(mode) {
    this.cubes.uniforms.byProbability.value = mode === 'probability' ? 1 : 0;
    this.draw();
  }
  colourPoints(mode) {
    // the first mode is what the points look like
    this.points.uniforms.mode.value = 1 + ['height', 'confidence'].indexOf(mode);
    this.draw();
  }
  sizePoints(size) {
    this.points.uniforms.size.value = size * this.renderer.getPixelRatio();
    this.draw();
  }

  lookFrom(where) {
    const direction = { corner: [-0.62, -0.72, 0.75], above: [0, -0.001, 1.25], front: [-1.2, 0, 0.1] }[where];
    const back = new Vector3(...direction).normalize();
    const right = new Vector3(0, 0, 1).cross(back).normalize();
    const up = back.clone().cross(right);
    const { across, upwards, distance } = this.fit(right, up, back);
    const target = new Vector3(...this.centre).addScaledVector(right, across).addScaledVector(up, upwards);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.controls.target.copy(target);
    this.controls.update();
    this.draw();
  }

  // What is in view at first: some of the cells, or points, and the path, within the box and below the cut; its corners where there is nothing yet.
  toFit() {
    const [low, high] = this.box;
    const top = Math.max(low[2], Math.min(high[2], this.data.cut ?? Infinity));
    const { occupied, points, path } = this.data;
    const places = (path ?? []).map((p) => p.slice(1, 4));
    const take = (source, at) => {
      const every = Math.max(1, Math.floor(source.count / 5000));
      for (let i = 0; i < source.count; i += every) places.push(at(i));
    };
    if (occupied?.count) take(occupied, (i) => occupied.centre(i));
    else if (points?.count) take(points, (i) => points.at(i));
    const isInside = (place) => place.every((value, i) => value >= low[i] && value <= (i === 2 ? top : high[i]));
    const inside = places.filter(isInside);
    if (inside.length > 1) return inside;
    return [...Array(8).keys()].map((k) => [k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? top : low[2]]);
  }

  // From how far away, and how far beside the centre, all of it just fills the picture. A point at (x, y, z) of the camera's axes, z towards
  // it, is seen where |x - across| <= tan (distance - z): each side bounds distance and place by one point.
  fit(right, up, back) {
    const offsets = this.toFit().map((place) => new Vector3(...place).sub(new Vector3(...this.centre)));
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const along = (axis, tangent) => {
      const side = (sign) => Math.max(...offsets.map((p) => sign * p.dot(axis) + tangent * p.dot(back)));
      const [above, below] = [side(1), side(-1)];
      return { place: (above - below) / 2, distance: (above + below) / (2 * tangent) };
    };
    const [x, y] = [along(right, half * this.camera.aspect), along(up, half)];
    return { across: x.place, upwards: y.place, distance: Math.max(1.05 * x.distance, 1.05 * y.distance, 0.1 * this.radius) };
  }

  // The camera of a keyframe as our own.
  lookFromKeyframe({ pose }) {
    const at = (depth) => new Vector3(...[0, 1, 2].map((r) => pose[4 * r + 3] + depth * pose[4 * r + 2]));
    this.camera.position.copy(at(-0.25 * this.radius)).add(new Vector3(0, 0, 0.08 * this.radius));
    this.controls.target.copy(at(0.5 * this.radius));
    this.controls.update();
    this.draw();
  }

  // Marks where the camera was in a frame, and the keyframe that belongs to it.
  markMoment(point, keyframe) {
    this.place.clear();
    if (point) this.place.add(markAt(point, 0.03 * this.radius, 0xff00aa));
    if (keyframe && this.data.camera) this.place.add(frustaLayer([keyframe], this.data.camera, this.frustumDepth, 0xff00aa));
    this.draw();
  }

  listen() {
    this.controls.addEventListener('start', () => (this.isMoving = true));
    this.controls.addEventListener('end', () => this.restSoon());
    this.controls.addEventListener('change', () => this.draw());
    let pressed = null;
    this.canvas.addEventListener('pointerdown', (event) => (pressed = [event.clientX, event.clientY]));
    this.canvas.addEventListener('pointerup', (event) => {
      const moved = pressed ? Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) : Infinity;
      if (moved < 5) this.pick(event);
    });
    this.canvas.addEventListener('wheel', () => this.restSoon(), { passive: true });
    new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.draw());
  }

  restSoon() {
    clearTimeout(this.rest);
    this.rest = setTimeout(() => {
      this.isMoving = false;
      this.draw();
    }, REST_MS);
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.shared.pixelsPerUnit.value = (0.5 * this.canvas.height) / Math.tan((this.camera.fov * Math.PI) / 360);
    this.draw();
  }

  // Draws before the next refresh of the screen.
  draw() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame((now) => {
      this.isWaiting = false;
      this.adapt(now);
      this.render();
    });
  }

  // Points and cubes together.
  amount() {
    return Math.max(1, (this.data.points?.count ?? 0) + (this.data.occupied?.count ?? 0));
  }

  hasNoGraphicsCard() {
    const context = this.renderer.getContext();
    const known = context.getExtension('WEBGL_debug_renderer_info');
    const name = context.getParameter(known ? known.UNMASKED_RENDERER_WEBGL : context.RENDERER);
    return /swiftshader|llvmpipe|software/i.test(String(name));
  }

  // A computer that is too slow gets dots for cubes and a share of the points while the view moves, and everything when it rests.
  adapt(now) {
    const took = now - this.lastDrawn;
    this.lastDrawn = now;
    if (!this.isMoving) {
      this.wasMoving = false;
      this.setDetail(1, false);
      return;
    }
    // the first frame of a movement says nothing: the view was at rest before
    if (this.wasMoving && took > SLOW_MS) {
      if (this.mustHurry) this.movingShare = Math.max(LEAST_SHARE, this.movingShare * Math.max(0.25, SLOW_MS / took));
      this.mustHurry = true;
    } else if (this.wasMoving && took < 0.5 * SLOW_MS) {
      this.movingShare = Math.min(1, this.movingShare * 1.1);
    }
    this.wasMoving = true;
    this.setDetail(this.mustHurry ? this.movingShare : 1, this.mustHurry);
  }

  setDetail(share, isQuick) {
    if (this.cubes) {
      const { exact, quick, uniforms } = this.cubes;
      exact.visible = !isQuick;
      quick.visible = isQuick;
      quick.geometry.setDrawRange(0, Math.ceil(share * this.data.occupied.count));
      uniforms.growth.value = Math.min(3, 1 / Math.sqrt(share));
    }
    if (this.points) this.points.layer.geometry.setDrawRange(0, Math.ceil(share * this.data.points.count));
  }

  render() {
    this.renderer.setClearColor(isDark() ? 0x16181b : 0xf6f6f3);
    this.renderer.render(this.scene, this.camera);
  }

  // What lies under the pointer: the nearest cell, or the nearest point close to the ray.
  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    const caster = new Raycaster();
    caster.setFromCamera(at, this.camera);
    const origin = caster.ray.origin.toArray();
    const direction = caster.ray.direction.toArray();
    const found = this.pickCell(origin, direction) ?? this.pickPoint(origin, direction);
    if (!found) return;
    this.picked = this.picked.length === 2 ? [found] : [...this.picked, found];
    this.marks.clear();
    for (const { point } of this.picked) this.marks.add(markAt(point, 0.02 * this.radius, 0xff00aa));
    if (this.picked.length === 2) this.marks.add(lineLayer(this.picked.map((p) => p.point), 0xff00aa));
    this.say(this.describePicked());
    this.draw();
  }

  isShown(height) {
    const [low, high] = this.shared.shownHeights.value;
    return height >= low && height <= high;
  }

  pickCell(origin, direction) {
    const { occupied } = this.data;
    if (!this.layers.cells?.object.visible) return null;
    let best = null;
    for (let i = 0; i < occupied.count; i++) {
      const centre = occupied.centre(i);
      if (!this.isShown(centre[2])) continue;
      const half = occupied.edge(i) / 2;
      const distance = entry(origin, direction, centre.map((c) => c - half), centre.map((c) => c + half));
      if (distance !== null && (!best || distance < best.distance)) best = { i, distance, point: centre };
    }
    if (!best) return null;
    const edge = length(occupied.edge(best.i), this.data.unit);
    return { point: best.point, text: `cell of ${edge}, occupied with probability ${occupied.probability(best.i).toFixed(2)}` };
  }

  pickPoint(origin, direction) {
    const { points } = this.data;
    if (!this.layers.cloud?.object.visible) return null;
    // a point counts as hit within six pixels
    const reach = (6 * this.renderer.getPixelRatio()) / this.shared.pixelsPerUnit.value;
    let best = null;
    for (let i = 0; i < points.count; i++) {
      const point = points.at(i);
      if (!this.isShown(point[2])) continue;
      const to = point.map((value, k) => value - origin[k]);
      const along = to[0] * direction[0] + to[1] * direction[1] + to[2] * direction[2];
      if (along <= 0 || (best && along > best.along)) continue;
      const across = Math.hypot(...to.map((value, k) => value - along * direction[k]));
      if (across < reach * along) best = { along, point };
    }
    return best && { point: best.point, text: 'measured point' };
  }

  describePicked() {
    const place = ({ point, text }) => `${text}, at (${point.map((value) => value.toFixed(2)).join(', ')})`;
    const lines = this.picked.map(place);
    if (this.picked.length === 2) {
      const [a, b] = this.picked.map((p) => p.point);
      const across = a.map((value, i) => b[i] - value);
      lines.push(`distance ${length(Math.hypot(...across), this.data.unit)}, of it ${length(Math.abs(across[2]), this.data.unit)} in height`);
    } else {
      lines.push('pick a second one to measure the distance');
    }
    return lines.join('\n');
  }
}
