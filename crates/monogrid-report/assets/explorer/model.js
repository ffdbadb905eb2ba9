// A surface as others open it: binary glTF of what is shown of it, turned as it is shown, y up; and files that the page offers.

const [FLOAT, BYTE, INTEGER] = [5126, 5121, 5125];

// The first vertex of the piece that each vertex belongs to: pieces share no vertex.
export function piecesOf({ triangles, count }) {
  const piece = new Uint32Array(count);
  for (let i = 0; i < count; i++) piece[i] = i;
  const first = (i) => {
    while (piece[i] !== i) i = piece[i] = piece[piece[i]];
    return i;
  };
  for (let i = 0; i < triangles.length; i++) {
    const [a, b] = [first(triangles[i]), first(triangles[i - (i % 3)])];
    piece[Math.max(a, b)] = Math.min(a, b);
  }
  for (let i = 0; i < count; i++) piece[i] = first(i);
  return piece;
}

// `geometry` is that of the surface as it is drawn, `place` says where one of its vertices is, or null where that is cut away.
export function glbOf(geometry, texture, place, unit) {
  const source = geometry.index.array;
  const number = new Map();
  const [positions, others, index] = [[], [], []];
  const attribute = geometry.getAttribute(texture ? 'on' : 'colour');
  const take = (vertex, at) => {
    if (!number.has(vertex)) {
      number.set(vertex, number.size);
      positions.push(...at);
      const each = attribute.itemSize;
      for (let k = 0; k < each; k++) others.push(attribute.array[each * vertex + k]);
      // colours are aligned to four bytes
      if (!texture) others.push(255);
    }
    index.push(number.get(vertex));
  };
  for (let i = 0; i < source.length; i += 3) {
    const corners = [source[i], source[i + 1], source[i + 2]];
    const places = corners.map(place);
    if (places.every(Boolean)) corners.forEach((vertex, k) => take(vertex, places[k]));
  }
  if (!index.length) return null;
  const ends = (pick, first) => [0, 1, 2].map((axis) => positions.reduce((best, value, i) => (i % 3 === axis ? pick(best, value) : best), first));
  const rounded = Float32Array.from(positions);
  const [low, high] = [ends(Math.min, Infinity), ends(Math.max, -Infinity)].map((values) => [...Float32Array.from(values)]);
  const parts = [rounded, texture ? Float32Array.from(others) : Uint8Array.from(others), Uint32Array.from(index)];
  if (texture) parts.push(Uint8Array.from(atob(texture.image), (letter) => letter.charCodeAt(0)));
  let offset = 0;
  const bufferViews = parts.map(({ byteLength }, k) => {
    const view = { buffer: 0, byteOffset: offset, byteLength, ...(k < 3 ? { target: k < 2 ? 34962 : 34963 } : {}) };
    offset += Math.ceil(byteLength / 4) * 4;
    return view;
  });
  const count = number.size;
  const accessors = [
    { bufferView: 0, componentType: FLOAT, count, type: 'VEC3', min: low, max: high },
    texture ? { bufferView: 1, componentType: FLOAT, count, type: 'VEC2' } : { bufferView: 1, componentType: BYTE, normalized: true, count, type: 'VEC4' },
    { bufferView: 2, componentType: INTEGER, count: index.length, type: 'SCALAR' },
  ];
  // what was filmed holds its light already
  const UNLIT = 'KHR_materials_unlit';
  const scene = {
    asset: { version: '2.0', generator: 'monogrid', extras: { unit } },
    extensionsUsed: [UNLIT],
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, [texture ? 'TEXCOORD_0' : 'COLOR_0']: 1 }, indices: 2, material: 0 }] }],
    materials: [{ doubleSided: true, pbrMetallicRoughness: texture ? { baseColorTexture: { index: 0 } } : {}, extensions: { [UNLIT]: {} } }],
    ...(texture ? { images: [{ bufferView: 3, mimeType: 'image/jpeg' }], textures: [{ source: 0 }] } : {}),
    buffers: [{ byteLength: offset }],
    bufferViews,
    accessors,
  };
  const text = new TextEncoder().encode(JSON.stringify(scene));
  const length = Math.ceil(text.length / 4) * 4;
  const bytes = new Uint8Array(28 + length + offset).fill(32, 20, 20 + length);
  new Uint32Array(bytes.buffer, 0, 5).set([0x46546c67, 2, bytes.length, length, 0x4e4f534a]);
  bytes.set(text, 20);
  new Uint32Array(bytes.buffer, 20 + length, 2).set([offset, 0x004e4942]);
  parts.forEach((part, k) => bytes.set(new Uint8Array(part.buffer), 28 + length + bufferViews[k].byteOffset));
  return bytes;
}

// Offers bytes or text as a file.
export function save(content, name, type) {
  const url = URL.createObjectURL(new Blob([content], { type }));
  Object.assign(document.createElement('a'), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60000);
}

// A scene with all its lengths times a factor, which makes metres of them.
export function inMetres(scene, factor) {
  const times = (values) => values.map((value) => value * factor);
  const grid = (grid) => grid && { ...grid, low: times(grid.low), step: grid.step * factor };
  const { cells, cloud, mesh, plan, keyframes, path, reference, frames, cut, edit } = scene;
  return {
    ...scene,
    unit: 'm',
    cells: cells && { ...cells, edge: cells.edge * factor },
    cloud: grid(cloud),
    mesh: grid(mesh),
    plan: plan && { ...plan, low: times(plan.low), size: times(plan.size), band: times(plan.band) },
    keyframes: keyframes.map((keyframe) => ({ ...keyframe, pose: keyframe.pose.map((value, i) => (i % 4 === 3 ? value * factor : value)) })),
    path: path.map(([frame, ...place]) => [frame, ...times(place)]),
    reference: reference.map(times),
    frames: frames && { ...frames, error: frames.error.map((error) => (error < 0 ? error : error * factor)) },
    cut: typeof cut === 'number' ? cut * factor : cut,
    edit: { ...edit, box: edit?.box && times(edit.box), factor: (edit?.factor ?? 1) * factor },
  };
}
