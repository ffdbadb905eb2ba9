// From the blocks of the page to typed arrays. The layout of a block is described where it is written: explorer/cells.rs, cloud.rs, mesh.rs.

function bytesOf(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

// The numbers in the page are little-endian, as every computer with a browser is.
function integersOf(base64) {
  return new Uint16Array(bytesOf(base64).buffer);
}

// A deterministic shuffle: the first n of the order are an even sample of all, for any n.
export function evenOrder(count) {
  const order = new Uint32Array(count);
  for (let i = 0; i < count; i++) order[i] = i;
  let state = 1;
  for (let i = count - 1; i > 0; i--) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const j = Math.floor((state / 4294967296) * (i + 1));
    const kept = order[i];
    order[i] = order[j];
    order[j] = kept;
  }
  return order;
}

// Share of what was filmed, on each side, that does not decide what is in view.
const FAR = 0.02;

// Cubes of one kind: four integers each; `centre` and `edge` give lengths.
export class Cubes {
  constructor(base64, cells, colours) {
    this.raw = integersOf(base64);
    // three bytes each, of those that are occupied
    this.colours = colours ? bytesOf(colours) : null;
    this.count = this.raw.length / 4;
    this.unit = cells.edge;
    this.first = cells.first;
  }
  edge(i) {
    return this.unit * 2 ** (this.raw[4 * i + 3] >> 8);
  }
  probability(i) {
    return (this.raw[4 * i + 3] & 255) / 255;
  }
  at(i) {
    const half = this.edge(i) / 2;
    return [0, 1, 2].map((axis) => (this.raw[4 * i + axis] + this.first[axis]) * this.unit + half);
  }
}

// Points: four integers each.
export class Points {
  constructor(cloud) {
    this.raw = integersOf(cloud.points);
    this.count = this.raw.length / 4;
    this.low = cloud.low;
    this.step = cloud.step;
    this.measured = cloud.count[1];
    // three bytes each; none where all are grey
    this.colours = cloud.colours ? bytesOf(cloud.colours) : null;
    this.order = evenOrder(this.count);
  }
  at(i) {
    return [0, 1, 2].map((axis) => this.low[axis] + this.step * this.raw[4 * i + axis]);
  }
}

// A mesh: four integers per vertex, three bytes of colour, three indices per triangle.
export class Surface {
  constructor(mesh) {
    this.raw = integersOf(mesh.vertices);
    this.count = this.raw.length / 4;
    this.colours = bytesOf(mesh.colours);
    this.triangles = new Uint32Array(bytesOf(mesh.triangles).buffer);
    this.low = mesh.low;
    this.step = mesh.step;
    this.bothSides = mesh.both_sides;
    this.texture = mesh.texture;
  }
  at(i) {
    return [0, 1, 2].map((axis) => this.low[axis] + this.step * this.raw[4 * i + axis]);
  }
}

// What the page holds, with its blocks unpacked.
export function unpacked(scene) {
  const { cells, cloud, mesh } = scene;
  return {
    ...scene,
    occupied: cells ? new Cubes(cells.occupied, cells, cells.colours) : null,
    free: cells ? new Cubes(cells.free, cells) : null,
    points: cloud ? new Points(cloud) : null,
    surface: mesh ? new Surface(mesh) : null,
  };
}

// The values at two shares of the sorted ones.
export function quantiles(values, low, high) {
  if (values.length === 0) return [0, 1];
  const sorted = Float64Array.from(values).sort();
  const at = (share) => sorted[Math.round(share * (sorted.length - 1))];
  return [at(low), at(high)];
}

// Some places of what there is to see: of the surface, which has no lone cells far away, else of what was measured.
export function places({ occupied, points, surface }, most = 20000) {
  const source = [surface, points, occupied].find((known) => known?.count);
  const found = [];
  const every = Math.max(1, Math.floor((source?.count ?? 0) / most));
  for (let i = 0; i < (source?.count ?? 0); i += every) found.push(source.at(i));
  return found;
}

// Where there is something to see, but for a few things far away: lower and upper corner.
export function extent(data) {
  const seen = places(data);
  const path = data.path.map((p) => p.slice(1));
  const axes = [0, 1, 2].map((axis) => {
    const along = (list) => list.map((place) => place[axis]);
    const ranges = [quantiles(along(seen.length ? seen : path), FAR, 1 - FAR)];
    // the camera is always in view
    if (path.length) ranges.push(quantiles(along(path), 0, 1));
    return [Math.min(...ranges.map((range) => range[0])), Math.max(...ranges.map((range) => range[1]))];
  });
  return [axes.map((a) => a[0]), axes.map((a) => a[1])];
}

const unitName = (value, unit) => (unit === 'm' ? 'm' : value === 1 ? 'map unit' : 'map units');

export function length(value, unit) {
  const digits = Math.abs(value) >= 100 ? 1 : Math.abs(value) >= 1 ? 2 : 3;
  return `${value.toFixed(digits)} ${unitName(value, unit)}`;
}

// The largest round length within one, and what a bar of it is called.
export function bar(most, unit) {
  const power = 10 ** Math.floor(Math.log10(most));
  const size = Number(([5, 2, 1].find((n) => n * power <= most) * power).toPrecision(1));
  return { size, text: `${size} ${unitName(size, unit)}${unit === 'm' ? '' : ' (unknown scale)'}` };
}
