// Puts the parts of the explorer together: what is chosen in one is shown in the others.
import { RAINBOW } from 'explorer/colours';
import { unpacked, length } from 'explorer/data';
import { KeyframeView } from 'explorer/keyframe';
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
    view.cut(Math.max(shown[0], -1e30), Math.min(shown[1], 1e30));
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

// The command that makes the distance of two places a true length. A page that was opened as a file knows the folder of its run.
function offerScale(places, { unit }) {
  const form = byId('rescale');
  form.hidden = unit === 'm' || places.length < 2;
  if (form.hidden) return;
  const folder = location.protocol === 'file:' ? decodeURIComponent(location.pathname.replace(/\/[^/]*$/, '')) : 'RUN';
  const quoted = (name) => (/^[\w./-]+$/.test(name) ? name : `'${name.replaceAll("'", "'\\''")}'`);
  const ends = places.map((place) => place.map((value) => value.toFixed(4)).join(':'));
  const input = element('input', { type: 'number', min: 0, step: 'any', ariaLabel: 'true length in metres' });
  const command = element('code');
  const tell = () => {
    const known = Number(input.value) > 0;
    command.textContent = known ? `monogrid rescale ${quoted(folder)} --scale-from distance:${ends}=${input.value}m --out ${quoted(`${folder}-metres`)}` : '';
  };
  input.addEventListener('input', tell);
  form.replaceChildren(element('label', {}, 'true length between them ', input, ' m'), command);
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

function start() {
  for (const form of document.querySelectorAll('form')) form.addEventListener('submit', (event) => event.preventDefault());
  const begun = performance.now();
  const data = unpacked(JSON.parse(byId('scene').textContent));
  byId('explorer').hidden = false;
  let view = null;
  try {
    view = new View(byId('view3d'), data, (text, places) => {
      byId('picked').textContent = text;
      byId('picked').hidden = false;
      offerScale(places, data);
    });
    controlView(view, data);
  } catch (error) {
    byId('stage').hidden = true;
    byId('switches').hidden = true;
    byId('no-webgl').hidden = false;
    byId('no-webgl').title = String(error);
  }
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

start();
