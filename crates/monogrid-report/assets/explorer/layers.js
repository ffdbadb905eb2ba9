// The layers of the view in three dimensions. Cubes and points are drawn from the integers of the page; heights are cut by
// the graphics card, so that a slider costs nothing.
import {
  BufferGeometry,
  Float32BufferAttribute,
  Group,
  InterleavedBuffer,
  InterleavedBufferAttribute,
  BufferAttribute,
  Line,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  Points as PointsObject,
  ShaderMaterial,
  Texture,
  Vector3,
} from 'three';
import { RAINBOW_SHADER } from 'explorer/colours';
import { evenOrder } from 'explorer/data';

// What all layers share: the corners of the box that is shown, heights of the colour scale, size of the picture.
export function sharedUniforms(heights) {
  return {
    shownLow: { value: [-1e30, -1e30, -1e30] },
    shownHigh: { value: [1e30, 1e30, 1e30] },
    heights: { value: heights },
    pixelsPerUnit: { value: 1 },
  };
}

const OUTSIDE = 'gl_Position = vec4(2.0, 2.0, 2.0, 1.0);';

const SHOWN = `
  uniform vec3 shownLow, shownHigh;
  bool isShown(vec3 place) { return all(greaterThanEqual(place, shownLow)) && all(lessThanEqual(place, shownHigh)); }`;

// Faces of cubes by the axis of their normal and its side; corners go around a face.
const FACES = [0, 1, 2].flatMap((axis) => [0, 1].map((side) => ({ axis, side })));

// Which faces of a cube can be seen: those with no cube of the same size beside them. Inside of walls nothing is drawn.
function visibleFaces(cubes) {
  const name = (x, y, z, level) => ((x * 65537 + y) * 65537 + z) * 17 + level;
  const known = new Set();
  const { raw, count } = cubes;
  const nameOf = (i, offset) => {
    const level = raw[4 * i + 3] >> 8;
    const place = [0, 1, 2].map((k) => raw[4 * i + k] + offset[k] * 2 ** level);
    return name(...place, level);
  };
  for (let i = 0; i < count; i++) known.add(nameOf(i, [0, 0, 0]));
  const found = [];
  for (let i = 0; i < count; i++) {
    FACES.forEach(({ axis, side }, face) => {
      const offset = [0, 0, 0];
      offset[axis] = side ? 1 : -1;
      if (!known.has(nameOf(i, offset))) found.push(i * 6 + face);
    });
  }
  return found;
}

// Four corners for every visible face. Not instanced: computers without a graphics card draw instances one by one.
function facesGeometry(cubes) {
  const faces = visibleFaces(cubes);
  const cell = new Uint16Array(faces.length * 16);
  const corner = new Uint8Array(faces.length * 16);
  const colour = new Uint8Array(faces.length * 12);
  const index = new Uint32Array(faces.length * 6);
  faces.forEach((name, k) => {
    const cube = Math.floor(name / 6);
    const { axis, side } = FACES[name % 6];
    [[0, 0], [1, 0], [1, 1], [0, 1]].forEach(([a, b], n) => {
      const at = 16 * k + 4 * n;
      cell.set(cubes.raw.subarray(4 * cube, 4 * cube + 4), at);
      if (cubes.colours) colour.set(cubes.colours.subarray(3 * cube, 3 * cube + 3), 12 * k + 3 * n);
      corner[at + axis] = side;
      corner[at + ((axis + 1) % 3)] = a;
      corner[at + ((axis + 2) % 3)] = b;
      corner[at + 3] = 2 * axis + side;
    });
    // counter-clockwise as seen from outside
    const order = side ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2];
    index.set(order.map((n) => 4 * k + n), 6 * k);
  });
  const geometry = new BufferGeometry();
  const cells = new BufferAttribute(cell, 4);
  geometry.setAttribute('cell', cells);
  geometry.setAttribute('corner', new BufferAttribute(corner, 4));
  geometry.setAttribute('colour', new BufferAttribute(colour, 3, true));
  geometry.setAttribute('position', cells);
  geometry.setIndex(new BufferAttribute(index, 1));
  return geometry;
}

// `mode` 0: colour, 1: height, 2: probability.
const CUBE_PLACE = `
  uniform vec3 first;
  uniform float unit;
  uniform vec2 heights;
  uniform float mode;
  attribute vec4 cell;
  attribute vec3 colour;
  varying vec3 tint;
  ${RAINBOW_SHADER}
  float edgeOf() { return unit * exp2(floor(cell.w / 256.0)); }
  vec3 centreOf(float edge) { return (cell.xyz + first) * unit + 0.5 * edge; }
  vec3 colourOf(vec3 centre) {
    float probability = mod(cell.w, 256.0) / 255.0;
    float height = (centre.z - heights.x) / max(heights.y - heights.x, 1e-9);
    return mode < 0.5 ? colour : rainbow(mode < 1.5 ? height : 2.0 * probability - 1.0);
  }
  ${SHOWN}`;

const PLAIN = `
  varying vec3 tint;
  void main() { gl_FragColor = vec4(tint, 1.0); }`;

// Cubes as cubes, and the same as square dots for slow computers while the view moves.
export function cubesLayer(cubes, shared) {
  const uniforms = {
    ...shared,
    first: { value: new Vector3(...cubes.first) },
    unit: { value: cubes.unit },
    mode: { value: 1 },
    // dots become larger when only some of them are drawn
    growth: { value: 1 },
  };
  const faces = new ShaderMaterial({
    uniforms,
    fragmentShader: PLAIN,
    vertexShader: `${CUBE_PLACE}
      attribute vec4 corner;
      void main() {
        float edge = edgeOf();
        vec3 centre = centreOf(edge);
        if (!isShown(centre)) { ${OUTSIDE} return; }
        // lit from above and from one side
        float light = corner.w < 1.5 ? 0.80 : corner.w < 3.5 ? 0.64 : corner.w < 4.5 ? 0.5 : 1.0;
        tint = colourOf(centre) * light;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(centre + (corner.xyz - 0.5) * edge, 1.0);
      }`,
  });
  const dots = new ShaderMaterial({
    uniforms,
    fragmentShader: PLAIN,
    vertexShader: `${CUBE_PLACE}
      uniform float pixelsPerUnit, growth;
      void main() {
        float edge = edgeOf();
        vec3 centre = centreOf(edge);
        if (!isShown(centre)) { ${OUTSIDE} return; }
        tint = colourOf(centre) * 0.85;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(centre, 1.0);
        gl_PointSize = max(1.0, 1.2 * growth * edge * pixelsPerUnit / gl_Position.w);
      }`,
  });
  return { exact: meshOf(facesGeometry(cubes), faces), quick: dotsOf(cubes, dots), uniforms };
}

function meshOf(geometry, material) {
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}

function dotsOf(cubes, material) {
  const geometry = new BufferGeometry();
  const cells = new InterleavedBufferAttribute(new InterleavedBuffer(cubes.raw, 4), 4, 0);
  geometry.setIndex(new BufferAttribute(evenOrder(cubes.count), 1));
  geometry.setAttribute('cell', cells);
  geometry.setAttribute('colour', new BufferAttribute(cubes.colours ?? new Uint8Array(3 * cubes.count), 3, true));
  // three.js asks for the number of points here
  geometry.setAttribute('position', cells);
  const dots = new PointsObject(geometry, material);
  dots.frustumCulled = false;
  return dots;
}

// Free cells: small translucent dots at their centres.
export function freeLayer(cubes, shared) {
  const material = new ShaderMaterial({
    uniforms: {
      ...shared,
      first: { value: new Vector3(...cubes.first) },
      unit: { value: cubes.unit },
      mode: { value: 1 },
    },
    transparent: true,
    depthWrite: false,
    fragmentShader: 'void main() { gl_FragColor = vec4(0.35, 0.65, 0.95, 0.35); }',
    vertexShader: `${CUBE_PLACE}
      uniform float pixelsPerUnit;
      void main() {
        float edge = edgeOf();
        vec3 centre = centreOf(edge);
        if (!isShown(centre)) { ${OUTSIDE} return; }
        gl_Position = projectionMatrix * viewMatrix * vec4(centre, 1.0);
        gl_PointSize = clamp(0.35 * edge * pixelsPerUnit / gl_Position.w, 1.0, 12.0);
      }`,
  });
  return dotsOf(cubes, material);
}

// Measured points; `mode` 0: colour or grey level, 1: height, 2: confidence.
export function pointsLayer(points, shared) {
  const geometry = new BufferGeometry();
  const place = new InterleavedBufferAttribute(new InterleavedBuffer(points.raw, 4), 4, 0);
  geometry.setAttribute('place', place);
  geometry.setAttribute('position', place);
  if (points.colours) geometry.setAttribute('colour', new BufferAttribute(points.colours, 3, true));
  geometry.setIndex(new BufferAttribute(points.order, 1));
  const uniforms = {
    ...shared,
    low: { value: new Vector3(...points.low) },
    stepLength: { value: points.step },
    mode: { value: 0 },
    size: { value: 2 },
  };
  const material = new ShaderMaterial({
    uniforms,
    fragmentShader: PLAIN,
    vertexShader: `
      uniform vec3 low;
      uniform vec2 heights;
      uniform float stepLength, mode, size;
      attribute vec4 place;
      ${points.colours ? 'attribute vec3 colour;' : ''}
      varying vec3 tint;
      ${RAINBOW_SHADER}
      ${SHOWN}
      void main() {
        vec3 point = (modelMatrix * vec4(low + stepLength * place.xyz, 1.0)).xyz;
        if (!isShown(point)) { ${OUTSIDE} return; }
        float height = (point.z - heights.x) / max(heights.y - heights.x, 1e-9);
        float confidence = floor(place.w / 256.0) / 255.0;
        tint = mode < 0.5 ? ${points.colours ? 'colour' : 'vec3(mod(place.w, 256.0) / 255.0)'}
             : mode < 1.5 ? rainbow(height)
             : mix(vec3(0.8, 0.2, 0.15), vec3(0.2, 0.65, 0.3), confidence);
        gl_Position = projectionMatrix * viewMatrix * vec4(point, 1.0);
        gl_PointSize = size;
      }`,
  });
  const layer = new PointsObject(geometry, material);
  layer.frustumCulled = false;
  return { layer, uniforms };
}

// The surface in its colours, lit a little so that its shape is seen; from behind it is not there, so that one looks into a room.
export function surfaceLayer(surface, shared, redraw) {
  const { texture } = surface;
  const material = surfaceMaterial(surface, shared);
  if (texture) showPicture(texture, material, redraw);
  return meshOf(texture ? facesOf(surface) : verticesOf(surface, surface.triangles), material);
}

// At most so many of these triangles, by vertices that become one with those near them, in the colours of the vertices.
export function coarseLayer(surface, triangles, most, shared) {
  const { raw, count } = surface;
  const highest = raw.reduce((best, value, i) => (i % 4 < 3 && value > best ? value : best), 1);
  const first = new Uint32Array(count);
  for (let cell = highest / 256; triangles.length > 3 * most; cell *= 1.25) {
    const known = new Map();
    for (let i = 0; i < count; i++) {
      const [x, y, z] = [0, 1, 2].map((axis) => Math.floor(raw[4 * i + axis] / cell));
      const name = (x * 1024 + y) * 1024 + z;
      if (!known.has(name)) known.set(name, i);
      first[i] = known.get(name);
    }
    const kept = [];
    for (let i = 0; i < triangles.length; i += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => first[triangles[i + k]]);
      if (a !== b && b !== c && c !== a) kept.push(a, b, c);
    }
    triangles = Uint32Array.from(kept);
  }
  return meshOf(verticesOf(surface, triangles), surfaceMaterial({ ...surface, texture: null }, shared));
}

function surfaceMaterial(surface, shared) {
  const { texture } = surface;
  return new ShaderMaterial({
    uniforms: {
      ...shared,
      low: { value: new Vector3(...surface.low) },
      stepLength: { value: surface.step },
      filmed: { value: null },
      // of the picture of a textured one, once it is decoded
      hasPicture: { value: 0 },
    },
    // one side or both, as three.js numbers them
    side: surface.bothSides ? 2 : 0,
    vertexShader: `
      uniform vec3 low;
      uniform float stepLength;
      attribute vec4 place;
      attribute vec3 colour;
      ${texture ? 'attribute vec2 on;' : ''}
      varying vec3 tint, point;
      varying vec2 at;
      ${SHOWN}
      void main() {
        point = low + stepLength * place.xyz;
        tint = colour;
        at = ${texture ? 'on' : 'vec2(0.0)'};
        if (!isShown(point)) { ${OUTSIDE} return; }
        gl_Position = projectionMatrix * viewMatrix * vec4(point, 1.0);
      }`,
    fragmentShader: `
      uniform sampler2D filmed;
      uniform float hasPicture;
      varying vec3 tint, point;
      varying vec2 at;
      void main() {
        vec3 normal = normalize(cross(dFdx(point), dFdy(point)));
        float light = 0.8 + 0.2 * abs(dot(normal, normalize(vec3(0.3, 0.5, 0.8))));
        gl_FragColor = vec4(hasPicture > 0.5 ? texture2D(filmed, at).rgb : tint * light, 1.0);
      }`,
  });
}

function showPicture(texture, material, redraw) {
  const image = new Image();
  image.onload = () => {
    const picture = new Texture(image);
    // rows from above, and nothing of the blocks beside
    picture.flipY = false;
    picture.generateMipmaps = false;
    picture.minFilter = picture.magFilter = LINEAR;
    picture.needsUpdate = true;
    material.uniforms.filmed.value = picture;
    material.uniforms.hasPicture.value = 1;
    redraw();
  };
  image.src = `data:image/jpeg;base64,${texture.image}`;
}

// three.js' number of it
const LINEAR = 1006;

function verticesOf(surface, triangles) {
  const geometry = new BufferGeometry();
  const place = new InterleavedBufferAttribute(new InterleavedBuffer(surface.raw, 4), 4, 0);
  geometry.setAttribute('place', place);
  geometry.setAttribute('position', place);
  geometry.setAttribute('colour', new BufferAttribute(surface.colours, 3, true));
  geometry.setIndex(new BufferAttribute(triangles, 1));
  return geometry;
}

// Two triangles are a face, with four vertices of its own: where they are on the picture is told in surface/texture.rs.
function facesOf({ raw, colours, triangles, texture: { block, columns, size } }) {
  const count = triangles.length / 6;
  const place = new Uint16Array(16 * count);
  const colour = new Uint8Array(12 * count);
  const on = new Float32Array(8 * count);
  const index = new Uint32Array(6 * count);
  for (let face = 0; face < count; face++) {
    const corners = [triangles[6 * face], triangles[6 * face + 1], triangles[6 * face + 2], triangles[6 * face + 5]];
    const [left, top] = [(face % columns) * block + 0.5, Math.floor(face / columns) * block + 0.5];
    corners.forEach((corner, k) => {
      const vertex = 4 * face + k;
      place.set(raw.subarray(4 * corner, 4 * corner + 4), 4 * vertex);
      colour.set(colours.subarray(3 * corner, 3 * corner + 3), 3 * vertex);
      on[2 * vertex] = (left + (k === 1 || k === 2 ? block - 1 : 0)) / size[0];
      on[2 * vertex + 1] = (top + (k > 1 ? block - 1 : 0)) / size[1];
    });
    index.set([0, 1, 2, 0, 2, 3].map((k) => 4 * face + k), 6 * face);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute('place', new BufferAttribute(place, 4));
  geometry.setAttribute('position', geometry.getAttribute('place'));
  geometry.setAttribute('colour', new BufferAttribute(colour, 3, true));
  geometry.setAttribute('on', new BufferAttribute(on, 2));
  geometry.setIndex(new BufferAttribute(index, 1));
  return geometry;
}

export function lineLayer(points, colour) {
  return new Line(positions(points), new LineBasicMaterial({ color: colour }));
}

function positions(points) {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new Float32BufferAttribute(points.flat(), 3));
  return geometry;
}

// Corners of the pyramid between a keyframe's centre and its image at a depth.
function pyramid({ pose }, camera, depth) {
  const [fx, fy, cx, cy] = camera.intrinsics;
  const [width, height] = camera.size;
  const place = (x, y, z) => [0, 1, 2].map((r) => pose[4 * r] * x + pose[4 * r + 1] * y + pose[4 * r + 2] * z + pose[4 * r + 3]);
  const corner = (u, v) => place(((u - cx) / fx) * depth, ((v - cy) / fy) * depth, depth);
  return { apex: place(0, 0, 0), corners: [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)] };
}

function pyramidLines(keyframe, camera, depth) {
  const { apex, corners } = pyramid(keyframe, camera, depth);
  return corners.flatMap((corner, i) => [apex, corner, corner, corners[(i + 1) % 4]]);
}

export function frustaLayer(keyframes, camera, depth, colour) {
  const lines = keyframes.flatMap((keyframe) => pyramidLines(keyframe, camera, depth));
  return new LineSegments(positions(lines), new LineBasicMaterial({ color: colour }));
}

export function linksLayer(keyframes, links, colour) {
  const centre = ({ pose }) => [pose[3], pose[7], pose[11]];
  const lines = links.flatMap(([a, b]) => [centre(keyframes[a]), centre(keyframes[b])]);
  return new LineSegments(positions(lines), new LineBasicMaterial({ color: colour }));
}

// A small cross with three arms.
export function markAt(point, arm, colour) {
  const lines = [0, 1, 2].flatMap((axis) =>
    [-arm, arm].map((reach) => point.map((value, k) => (k === axis ? value + reach : value))),
  );
  const material = new LineBasicMaterial({ color: colour, depthTest: false });
  const mark = new LineSegments(positions(lines), material);
  mark.renderOrder = 1;
  return mark;
}

export { Group };
