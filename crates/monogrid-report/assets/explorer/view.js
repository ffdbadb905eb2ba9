// The view in three dimensions: camera, layers, picking and measuring. Drawn when something changes, not all the time.
import { BufferAttribute, Matrix4, OrbitControls, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3, WebGLRenderer } from 'three';
import { Group, coarseLayer, cubesLayer, freeLayer, frustaLayer, lineLayer, linksLayer, markAt, pointsLayer, sharedUniforms, surfaceLayer } from 'explorer/layers';
import { bar, extent, length, places, quantiles } from 'explorer/data';
import { isDark } from 'explorer/colours';
import { glbOf, piecesOf } from 'explorer/model';

// A frame that takes longer than this while the view moves is drawn with less.
const SLOW_MS = 45;
// Share of points and cubes that is always drawn.
const LEAST_SHARE = 0.04;
// Points and cubes that a computer without a graphics card draws twenty times a second.
const AFFORDABLE = 60000;
// Triangles that it draws as often.
const AFFORDABLE_TRIANGLES = 20000;
// With fewer cells than this the cloud says more, and is shown at once.
const FEW_CELLS = 5000;
// Share of what there is to see that may be out of view on each side at first.
const LONE = 0.005;
// Longest bar of a length, px.
const MAX_BAR = 140;
// Pixels of a computer without a graphics card along each side, of those it draws at rest, while the view moves.
const COARSE = 0.5;
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
    this.ruler = document.getElementById('ruler');
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: 'high-performance' });
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(45, 1, 1, 10);
    this.camera.up.set(0, 0, 1);
    this.surround(...extent(data));
    this.edit = data.edit ?? {};
    this.controls = this.turned();
    this.shared = sharedUniforms(this.heights());
    this.layers = this.build();
    this.marks = new Group();
    this.place = new Group();
    this.scene.add(this.marks, this.place, ...Object.values(this.layers).map((layer) => layer.object));
    this.picked = [];
    // sides of points, px of the page
    this.dots = 2;
    this.mustHurry = this.hasNoGraphicsCard();
    this.movingShare = this.mustHurry ? Math.min(1, AFFORDABLE / this.amount()) : 1;
    this.isMoving = false;
    this.wasMoving = false;
    this.listen();
    this.resize();
    this.isHidden = () => false;
    if (this.edit.hidden?.length) this.hide();
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
    const { occupied, path } = this.data;
    const heights = places(occupied?.count ? { occupied } : this.data).map((place) => place[2]);
    if (heights.length) return quantiles(heights.filter((height) => height <= most), 0.02, 0.98);
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
      layers.cells = { object, on: false };
    }
    if (points?.count) {
      this.points = pointsLayer(points, this.shared);
      layers.cloud = { object: this.points.layer, on: false };
    }
    if (surface) {
      this.surface = { exact: surfaceLayer(surface, this.shared, () => this.draw()), quick: null };
      const object = new Group();
      object.add(this.surface.exact);
      layers.surface = { object, on: false };
    }
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
  // Shows only what lies on one side of a place along an axis; `side` 0 shows what is above it.
  cut(axis, side, place) {
    const { shownLow, shownHigh } = this.shared;
    (side ? shownHigh : shownLow).value[axis] = Math.min(Math.max(place, -1e30), 1e30);
    this.draw();
  }

  // From the axes of the map to those that are shown, z up, as somebody has turned them.
  turn() {
    const [x, y, z] = (this.edit.turn ?? [0, 0, 0]).map((degrees) => (degrees * Math.PI) / 180);
    const about = (axis, angle) => new Matrix4()[`makeRotation${axis}`](angle);
    return about('Z', z).multiply(about('Y', y)).multiply(about('X', x));
  }

  // Controls of a camera whose up is what is shown as up.
  turned() {
    this.controls?.dispose();
    this.camera.up.set(0, 0, 1).transformDirection(this.turn().transpose());
    const controls = new OrbitControls(this.camera, this.canvas);
    controls.zoomToCursor = true;
    controls.addEventListener('start', () => (this.isMoving = true));
    controls.addEventListener('end', () => this.restSoon());
    controls.addEventListener('change', () => this.draw());
    return controls;
  }

  // Turns what is shown about the axes of the map, degrees.
  turnTo(turn) {
    this.edit.turn = turn;
    this.controls = this.turned();
    this.lookFrom('corner');
  }

  // Hides the pieces of the surface that are to be hidden.
  hide() {
    const { surface } = this.data;
    if (!surface) return;
    const { geometry } = this.surface.exact;
    this.allTriangles ??= geometry.index.array;
    const hidden = new Set(this.edit.hidden);
    this.pieces ??= piecesOf(surface);
    this.isHidden = (triangle) => hidden.has(this.pieces[surface.triangles[3 * triangle]]);
    const kept = this.allTriangles.filter((_, i) => !this.isHidden(Math.floor(i / 3)));
    geometry.setIndex(new BufferAttribute(kept, 1));
    this.layers.surface.object.remove(this.surface.quick);
    this.surface.quick = null;
    this.draw();
  }

  // The surface as it is shown, as glTF; null where nothing of it is.
  model() {
    const { geometry } = this.surface.exact;
    const { low, step, texture } = this.data.surface;
    const raw = geometry.getAttribute('place');
    const turn = this.turn();
    const place = (vertex) => {
      const at = [raw.getX(vertex), raw.getY(vertex), raw.getZ(vertex)].map((value, axis) => low[axis] + step * value);
      if (!this.isShown(at)) return null;
      const { x, y, z } = new Vector3(...at).applyMatrix4(turn);
      return [x, z, -y];
    };
    return glbOf(geometry, texture, place, this.data.unit);
  }

  // Gives up what it holds: another one takes its place.
  end() {
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  // The ways to show what was mapped, the best first: one layer, its colours, and what they mean.
  modes() {
    const { occupied, points, surface } = this.data;
    const filmed = { title: 'colour: as filmed' };
    const [low, high] = this.shared.heights.value.map((height) => length(height, this.data.unit));
    const height = { title: 'height', scale: 'rainbow', from: low, to: high };
    const found = [];
    const add = (name, layer, mode, legend, cut) => found.push({ name, layer, mode, legend, cut });
    if (surface) add('surface', 'surface', 0, filmed);
    if (occupied?.count) {
      const { cut } = this.data;
      if (occupied.colours) add('cells by colour', 'cells', 0, filmed, cut);
      add('cells by height', 'cells', 1, height, cut);
      add('cells by probability', 'cells', 2, { title: 'occupied with probability', scale: 'rainbow', from: '0.5', to: '1' }, cut);
    }
    if (points) {
      add('points', 'cloud', 0, filmed);
      add('points by height', 'cloud', 1, height);
      add('points by confidence', 'cloud', 2, { title: 'depth', scale: 'trust', from: 'uncertain', to: 'certain' });
    }
    // few cells and no surface: the points say more
    if (!surface && points && !(occupied?.count > FEW_CELLS)) found.unshift(found.splice(found.findIndex(({ name }) => name === 'points'), 1)[0]);
    return found;
  }

  showAs({ layer, mode }) {
    for (const name of ['surface', 'cells', 'cloud']) {
      const known = this.layers[name];
      if (known) known.object.visible = known.on = name === layer;
    }
    if (layer === 'cells') this.cubes.uniforms.mode.value = mode;
    if (layer === 'cloud') this.points.uniforms.mode.value = mode;
    this.draw();
  }
  sizePoints(size) {
    this.dots = size;
    this.sharpen(1);
    this.draw();
  }

  // From above the side from which it was filmed: what the camera did not see has no surface.
  lookFrom(where) {
    const direction = { corner: [...this.filmedFrom(), 0.7], above: [0, -0.001, 1.25], front: [-1.2, 0, 0.1] }[where];
    const back = new Vector3(...direction).transformDirection(this.turn().transpose());
    const right = this.camera.up.clone().cross(back).normalize();
    const up = back.clone().cross(right);
    const { across, upwards, distance } = this.fit(right, up, back);
    const target = new Vector3(...this.centre).addScaledVector(right, across).addScaledVector(up, upwards);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.controls.target.copy(target);
    this.controls.update();
    this.draw();
  }

  // Where the cameras were as seen from what they filmed, level; a corner where that is nowhere.
  filmedFrom() {
    const sum = (this.data.keyframes ?? []).reduce((sum, { pose }) => sum.sub(new Vector3(pose[2], pose[6], pose[10])), new Vector3());
    const { x, y } = sum.applyMatrix4(this.turn());
    const size = Math.hypot(x, y);
    return size > 0.1 * this.data.keyframes.length ? [x / size, y / size] : [-0.65, -0.76];
  }

  // What is in view at first: the path, and some of what there is to see within the box and below the cut; its corners where there is nothing yet.
  toFit() {
    const [low, high] = this.box;
    const top = Math.max(low[2], Math.min(high[2], this.data.cut ?? Infinity));
    const path = (this.data.path ?? []).map((p) => p.slice(1, 4));
    const isInside = (place) => place.every((value, i) => value >= low[i] && value <= (i === 2 ? top : high[i]));
    const seen = places(this.data, 5000).filter(isInside);
    if (path.length + seen.length > 1) return { path, seen };
    const corners = [...Array(8).keys()].map((k) => [k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? top : low[2]]);
    return { path: corners, seen: [] };
  }

  // From how far away, and how far beside the centre, all of it just fills the picture. A point at (x, y, z) of the camera's axes, z towards
  // it, is seen where |x - across| <= tan (distance - z): each side bounds distance and place by one point.
  fit(right, up, back) {
    const fromCentre = (place) => new Vector3(...place).sub(new Vector3(...this.centre));
    const { path, seen } = this.toFit();
    const [always, mostly] = [path.map(fromCentre), seen.map(fromCentre)];
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const along = (axis, tangent) => {
      // but for a few of them: lone pieces far away must not make the rest small
      const side = (sign) => {
        const reach = (places, share) => (places.length ? quantiles(places.map((p) => sign * p.dot(axis) + tangent * p.dot(back)), 0, share)[1] : -Infinity);
        return Math.max(reach(always, 1), reach(mostly, 1 - LONE));
      };
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
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.sharpen(1);
    this.draw();
  }

  // Draws with so many of the pixels along each side that the screen has.
  sharpen(share) {
    this.renderer.setPixelRatio(share * Math.min(devicePixelRatio, 2));
    this.shared.pixelsPerUnit.value = (0.5 * this.canvas.height) / Math.tan((this.camera.fov * Math.PI) / 360);
    if (this.points) this.points.uniforms.size.value = Math.max(1, this.dots * this.renderer.getPixelRatio());
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
    if (this.surface) {
      if (isQuick && !this.surface.quick) this.surface.quick = this.coarse();
      this.surface.exact.visible = !isQuick;
      if (this.surface.quick) this.surface.quick.visible = isQuick;
    }
    if (isQuick !== this.isCoarse) this.sharpen(isQuick ? COARSE : 1);
    this.isCoarse = isQuick;
  }

  // What is shown of the surface, in fewer triangles.
  coarse() {
    const { surface } = this.data;
    const shown = surface.triangles.filter((_, i) => !this.isHidden(Math.floor(i / 3)));
    const layer = coarseLayer(surface, shown, AFFORDABLE_TRIANGLES, this.shared);
    this.layers.surface.object.add(layer);
    return layer;
  }

  render() {
    this.renderer.setClearColor(isDark() ? 0x16181b : 0xf6f6f3);
    this.renderer.render(this.scene, this.camera);
    this.measureBar();
  }

  // A bar as long as a round length at the place that the view turns around.
  measureBar() {
    const distance = this.camera.position.distanceTo(this.controls.target);
    const pixels = this.shared.pixelsPerUnit.value / this.renderer.getPixelRatio() / distance;
    const { size, text } = bar(MAX_BAR / pixels, this.data.unit);
    this.ruler.firstChild.style.width = `${size * pixels}px`;
    this.ruler.lastChild.textContent = text;
  }

  // What lies under the pointer: the nearest cell, or the nearest point close to the ray.
  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    const caster = new Raycaster();
    caster.setFromCamera(at, this.camera);
    const origin = caster.ray.origin.toArray();
    const direction = caster.ray.direction.toArray();
    const found = this.pickSurface(origin, direction) ?? this.pickCell(origin, direction) ?? this.pickPoint(origin, direction);
    if (!found) return;
    if (this.isHiding && found.triangle !== undefined) {
      this.pieces ??= piecesOf(this.data.surface);
      this.edit.hidden = [...(this.edit.hidden ?? []), this.pieces[this.data.surface.triangles[3 * found.triangle]]];
      this.hide();
      return;
    }
    this.picked = this.picked.length === 2 ? [found] : [...this.picked, found];
    this.marks.clear();
    for (const { point } of this.picked) this.marks.add(markAt(point, 0.02 * this.radius, 0xff00aa));
    if (this.picked.length === 2) this.marks.add(lineLayer(this.picked.map((p) => p.point), 0xff00aa));
    this.say(this.describePicked(), this.picked.map(({ point }) => point));
    this.draw();
  }

  isShown(place) {
    const { shownLow, shownHigh } = this.shared;
    return place.every((value, axis) => value >= shownLow.value[axis] && value <= shownHigh.value[axis]);
  }

  // The nearest triangle that faces the ray (Möller and Trumbore, Fast, minimum storage ray-triangle intersection, 1997).
  pickSurface(origin, direction) {
    const { surface } = this.data;
    if (!this.layers.surface?.object.visible) return null;
    const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let best = null;
    for (let i = 0; i < surface.triangles.length; i += 3) {
      if (this.isHidden(i / 3)) continue;
      const [a, b, c] = [0, 1, 2].map((k) => surface.at(surface.triangles[i + k]));
      const [ab, ac, from] = [minus(b, a), minus(c, a), minus(origin, a)];
      const across = cross(direction, ac);
      const facing = dot(ab, across);
      if (facing === 0 || (facing < 0 && !surface.bothSides)) continue;
      const u = dot(from, across) / facing;
      const over = cross(from, ab);
      const v = dot(direction, over) / facing;
      const along = dot(ac, over) / facing;
      if (u < 0 || v < 0 || u + v > 1 || along <= 0 || (best && along >= best.along)) continue;
      const point = origin.map((value, k) => value + along * direction[k]);
      if (this.isShown(point)) best = { along, point, triangle: i / 3 };
    }
    return best && { point: best.point, text: 'surface', triangle: best.triangle };
  }

  pickCell(origin, direction) {
    const { occupied } = this.data;
    if (!this.layers.cells?.object.visible) return null;
    let best = null;
    for (let i = 0; i < occupied.count; i++) {
      const centre = occupied.at(i);
      if (!this.isShown(centre)) continue;
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
      if (!this.isShown(point)) continue;
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
      lines.push(`distance ${length(Math.hypot(...across), this.data.unit)}, of it ${length(Math.abs(this.camera.up.dot(new Vector3(...across))), this.data.unit)} in height`);
    } else {
      lines.push('pick a second one to measure the distance');
    }
    return lines.join('\n');
  }
}
