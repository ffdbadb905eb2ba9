// Puts the parts of the explorer together: what is chosen in one is shown in the others.
import { RAINBOW } from 'explorer/colours';
import { extent, length, unpacked } from 'explorer/data';
import { KeyframeView } from 'explorer/keyframe';
import { inMetres, save } from 'explorer/model';
import { Plan } from 'explorer/plan';
import { Timeline } from 'explorer/timeline';
import { View } from 'explorer/view';

const byId = (id) => document.getElementById(id);

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function toggle(text, on, change) {
  const box = element('input', { type: 'checkbox', checked: on });
  box.addEventListener('change', () => change(box.checked));
  return element('label', {}, box, ` ${text}`);
}

function choice(text, values, change) {
  const select = element('select', { ariaLabel: text }, ...values.map((value) => element('option', { value, textContent: value })));
  select.addEventListener('change', () => change(select.value));
  return element('label', {}, `${text} `, select);
}

function slider(text, [low, high], value, change) {
  const input = element('input', { type: 'range', min: low, max: high, step: (high - low) / 400 || 1, value, ariaLabel: text });
  const says = element('output');
  const update = () => (says.textContent = change(Number(input.value)));
  input.addEventListener('input', update);
  says.textContent = change(value);
  return element('label', { className: 'slider' }, `${text} `, input, says);
}

function button(text, press) {
  const made = element('button', { type: 'button', textContent: text });
  made.addEventListener('click', press);
  return made;
}

// What is shown and in which colours, switches, heights and points of view of the view in three dimensions.
function controlView(view, data) {
  const [low, high] = view.heights(Infinity);
  const room = 0.25 * (high - low) + 1e-6;
  const range = [low - room, high + room];
  const shown = [-Infinity, Infinity];
  const cut = (side, open) => (height) => {
    shown[side] = (side ? height >= range[1] : height <= range[0]) ? open : height;
    view.cut(2, side, shown[side]);
    return Number.isFinite(shown[side]) ? length(height, data.unit) : 'off';
  };
  const above = slider('cut above', range, range[1], cut(1, Infinity));
  byId('cuts').append(above, slider('cut below', range, range[0], cut(0, -Infinity)));
  const modes = view.modes();
  const buttons = modes.map((mode) => button(mode.name, () => show(mode)));
  const show = (mode) => {
    buttons.forEach((made, i) => (made.ariaPressed = modes[i] === mode));
    view.showAs(mode);
    explain(mode.legend, data);
    const input = above.querySelector('input');
    input.value = Math.min(Math.max(mode.cut ?? range[1], range[0]), range[1]);
    input.dispatchEvent(new Event('input'));
  };
  byId('modes').append(...buttons);
  if (modes.length) show(modes[0]);
  const panel = byId('switches');
  for (const [key, layer] of Object.entries(view.layers)) if (layer.name) panel.append(toggle(layer.name, layer.on, (on) => view.show(key, on)));
  if (view.points) panel.append(choice('dots of', ['2', '1', '3', '5'], (size) => view.sizePoints(Number(size))));
  for (const where of ['corner', 'above', 'front']) panel.append(button(where, () => view.lookFrom(where)));
}

// Crops, turns and hides parts of what is shown, and saves what is left.
function offerEdit(view, data, scene) {
  const form = byId('edit');
  const { edit } = view;
  edit.box ??= [-Infinity, Infinity, -Infinity, Infinity].map((open) => Math.sign(open) * 1e30);
  const [low, high] = extent(data);
  ['x', 'y'].forEach((name, axis) => {
    const room = high[axis] - low[axis] + 1e-6;
    const range = [low[axis] - room, high[axis] + room];
    ['from', 'to'].forEach((word, side) => {
      const known = edit.box[2 * axis + side];
      const crop = (value) => {
        const isOpen = side ? value >= range[1] : value <= range[0];
        edit.box[2 * axis + side] = isOpen ? (side ? 1e30 : -1e30) : value;
        view.cut(axis, side, edit.box[2 * axis + side]);
        return isOpen ? 'off' : length(value, data.unit);
      };
      form.append(slider(`${name} ${word}`, range, Math.min(Math.max(known, range[0]), range[1]), crop));
    });
  });
  const turn = [...(edit.turn ?? [0, 0, 0])];
  ['x', 'y', 'z'].forEach((name, axis) => {
    const about = (degrees) => {
      const hasTurned = turn[axis] !== degrees;
      turn[axis] = degrees;
      if (hasTurned) view.turnTo([...turn]);
      return `${degrees.toFixed(0)}°`;
    };
    form.append(slider(`turn about ${name}`, [-180, 180], turn[axis], about));
  });
  const name = document.title.replace(/^monogrid: /, '').replace(/[^\w-]+/g, '-');
  if (data.surface) {
    const hiding = button('hide pieces: click them', () => (hiding.ariaPressed = view.isHiding = !view.isHiding));
    const all = button('hide nothing', () => {
      edit.hidden = [];
      view.hide();
    });
    const model = button('save the model (.glb)', () => {
      const bytes = view.model();
      if (bytes) save(bytes, `${name}.glb`, 'model/gltf-binary');
      byId('saved').textContent = !bytes
        ? 'nothing of the surface is shown: there is no model'
        : data.unit === 'm' ? 'saved in metres' : 'saved in map units: its true size is not known; click two places and type their distance';
    });
    form.append(hiding, all, model);
  }
  form.append(button('save this page', () => savePage({ ...scene, edit }, name)));
}

// The page as it was opened, with what it shows now.
function savePage(scene, name) {
  const page = PRISTINE.cloneNode(true);
  page.querySelector('#scene').textContent = JSON.stringify(scene).replaceAll('<', '\\u003c');
  save(`<!doctype html>${page.outerHTML}`, `${name}.html`, 'text/html');
}

// What the colours of the view mean.
function explain({ title, scale, from, to }, data) {
  const ramp = { rainbow: RAINBOW, trust: [[204, 51, 38], [51, 166, 77]] }[scale];
  const colours = ramp?.map((colour) => `rgb(${colour})`).join(',');
  const swatch = (style, name) => [element('i', { className: 'line', style }), name];
  byId('colours').replaceChildren(
    element('b', { textContent: title }),
    ...(ramp ? [` ${from} `, element('i', { className: 'ramp', style: `background:linear-gradient(to right,${colours})` }), ` ${to}`] : []),
    ...(data.path.length > 1 ? [...swatch('background:var(--ink)', 'path of the camera'), ...swatch('background:#1f9e77', 'its start'), ...swatch('background:#c7372f', 'its end')] : []),
  );
}

// Makes the distance of two places a true length: here, and by a command in all files of the run, whose folder a page that was opened as
// a file knows.
function offerScale(places, { unit }, scene) {
  const form = byId('rescale');
  form.hidden = unit === 'm' || places.length < 2;
  if (form.hidden) return;
  const folder = location.protocol === 'file:' ? decodeURIComponent(location.pathname.replace(/\/[^/]*$/, '')) : 'RUN';
  const quoted = (name) => (/^[\w./-]+$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`);
  const ends = places.map((place) => place.map((value) => value.toFixed(4)).join(':'));
  const input = element('input', { type: 'number', min: 0, step: 'any', ariaLabel: 'true length in metres' });
  const command = element('code');
  const distance = Math.hypot(...places[0].map((value, axis) => places[1][axis] - value));
  const here = button('use it here', () => show(inMetres(scene, Number(input.value) / distance)));
  const tell = () => {
    const known = Number(input.value) > 0 && distance > 0;
    here.disabled = !known;
    command.textContent = known ? `monogrid rescale ${quoted(folder)} --scale-from distance:${ends}=${input.value}m --out ${quoted(`${folder}-metres`)}` : '';
  };
  input.addEventListener('input', tell);
  tell();
  form.replaceChildren(element('label', {}, 'true length between them ', input, ' m'), here, element('span', { textContent: 'or, for all files of the run:' }), command);
}

function showPlan(data) {
  const plan = new Plan(byId('plan'), data);
  byId('plan-part').hidden = !data.plan && !data.occupied && data.path.length < 2;
  if (!data.occupied?.count) {
    plan.draw();
    return plan;
  }
  let low = Infinity;
  let high = -Infinity;
  for (let i = 0; i < data.occupied.count; i++) {
    const height = data.occupied.at(i)[2];
    low = Math.min(low, height);
    high = Math.max(high, height);
  }
  const edge = data.cells.edge;
  let isLayer = false;
  let height = data.path.length ? data.path[0][3] : (low + high) / 2;
  const update = () => plan.showLayer(isLayer ? height : null);
  const layer = slider('height', [low, high], Math.min(Math.max(height, low), high), (value) => {
    height = (Math.floor(value / edge) + 0.5) * edge;
    update();
    return length(height, data.unit);
  });
  layer.hidden = true;
  const [from, to] = data.plan?.band ?? [];
  const all = data.plan ? `heights from ${from.toFixed(2)} to ${length(to, data.unit)}` : 'all heights';
  const kinds = choice('show', [all, 'one layer of cells'], (kind) => {
    isLayer = kind !== all;
    layer.hidden = !isLayer;
    update();
  });
  byId('plan-controls').append(kinds, layer);
  return plan;
}

// The position in `keyframes` of the one that a frame was tracked on, or the one before it in time.
function keyframeOf(data, row) {
  const id = data.frames.keyframe[row];
  const exact = data.keyframes.findIndex((keyframe) => keyframe.id === id);
  if (exact >= 0) return exact;
  const frame = data.frames.index[row];
  const later = data.keyframes.findIndex((keyframe) => keyframe.frame > frame);
  return later < 0 ? data.keyframes.length - 1 : Math.max(0, later - 1);
}

function linkTimeline(data, view, plan, keyframeView) {
  const places = new Map(data.path.map(([frame, ...place]) => [frame, place]));
  const timeline = new Timeline(byId('timeline'), data.frames, (row) => choose(row));
  const choose = (row) => {
    timeline.show(row);
    byId('moment').textContent = timeline.describe(row, data.unit);
    const place = places.get(data.frames.index[row]);
    const position = keyframeOf(data, row);
    plan.mark(place ?? null);
    view?.markMoment(place, data.keyframes[position]);
    if (position >= 0) keyframeView.show(position);
  };
  byId('legend').append(
    ...data.frames.legend.flatMap(([name, colour]) => [element('i', { style: `background:${colour}` }), name]),
    element('i', { className: 'line', style: 'background:#2a7fc8' }), 'pixels that agree',
    element('i', { className: 'line', style: 'background:#c07a28' }), 'time per frame',
    ...(data.frames.error.length ? [element('i', { className: 'line', style: 'background:#b03a8c' }), 'distance from the true path'] : []),
  );
  // where to begin: the first moment at which something was wrong after the start, else the middle
  const wrong = data.frames.state.findIndex((state) => ['lost', 'in a fragment', 'degraded'].includes(data.frames.legend[state][0]));
  choose(wrong > 0 ? wrong : Math.floor(data.frames.index.length / 2));
  return choose;
}

function linkKeyframes(data, view, keyframeView, choose) {
  const step = (by) => {
    const next = Math.min(Math.max((keyframeView.position ?? 0) + by, 0), data.keyframes.length - 1);
    const row = data.frames ? data.frames.index.indexOf(data.keyframes[next].frame) : -1;
    if (row >= 0) choose(row);
    keyframeView.show(next);
    if (row < 0) view?.markMoment(null, data.keyframes[next]);
  };
  byId('keyframe-controls').append(
    button('earlier', () => step(-1)),
    button('later', () => step(1)),
    toggle('depth', true, (on) => keyframeView.setDepth(on)),
  );
  if (view) byId('keyframe-controls').append(button('look from here', () => view.lookFromKeyframe(data.keyframes[keyframeView.position ?? 0])));
}

// Shows a scene, in place of the one that was shown.
function show(scene) {
  const begun = performance.now();
  window.explorer?.view?.end?.();
  byId('explorer').replaceWith(PRISTINE.querySelector('#explorer').cloneNode(true));
  for (const form of document.querySelectorAll('form')) form.addEventListener('submit', (event) => event.preventDefault());
  const data = unpacked(scene);
  byId('explorer').hidden = false;
  let view = null;
  try {
    view = new View(byId('view3d'), data, (text, places) => {
      byId('picked').textContent = text;
      byId('picked').hidden = false;
      offerScale(places, data, { ...scene, edit: view.edit });
    });
    controlView(view, data);
    offerEdit(view, data, scene);
  } catch (error) {
    byId('stage').hidden = true;
    byId('switches').hidden = true;
    byId('no-webgl').hidden = false;
    byId('no-webgl').title = String(error);
  }
  const factor = scene.edit?.factor;
  byId('saved').textContent = factor ? `in metres here: one map unit is ${factor.toPrecision(4)} m; text and numbers beside this view are of the map unit` : '';
  const plan = showPlan(data);
  byId('keyframe-part').hidden = !data.keyframes.some((keyframe) => keyframe.image);
  byId('timeline-part').hidden = !data.frames;
  const keyframeView = new KeyframeView(byId('keyframe'), byId('keyframe-caption'), data);
  const choose = data.frames ? linkTimeline(data, view, plan, keyframeView) : () => {};
  if (data.keyframes.length) linkKeyframes(data, view, keyframeView, choose);
  if (!data.frames && data.keyframes.length) keyframeView.show(0);
  // for scripts/look.sh
  window.explorer = { view, data, choose, milliseconds: performance.now() - begun };
}

// The page before anything is shown: what is saved, and what begins anew.
const PRISTINE = document.documentElement.cloneNode(true);
show(JSON.parse(byId('scene').textContent));
