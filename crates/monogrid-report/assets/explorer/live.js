// A run that goes on: asks what has changed, and shows it. Keyframes keep their points; when the graph moves them only their
// poses are sent.
import { Group, Matrix4, Vector3 } from 'three';
import { cubesLayer, lineLayer, markAt, pointsLayer, frustaLayer } from 'explorer/layers';
import { Cubes, Points, extent } from 'explorer/data';
import { isDark } from 'explorer/colours';
import { KeyframeView } from 'explorer/keyframe';
import { View } from 'explorer/view';

const ASK_EVERY_MS = 300;
// while somebody looks at what is around the camera
const ASK_OFTEN_MS = 150;
// a busy server may leave a question unanswered; after so many in a row there is none
const MAX_UNANSWERED = 5;
// Points of each keyframe that must be in view.
const OF_EACH = 40;
const byId = (id) => document.getElementById(id);

// What goes on in each state of tracking.
const DOING = {
  initialising: 'looking for depth: move the camera sideways',
  good: 'following the camera',
  degraded: 'following the camera, uncertain',
  fragment: 'mapping a part of its own, until a known place is seen',
  lost: 'lost: go back to what was seen before',
};

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
const nothing = { unit: '', keyframes: [], links: [], path: [], reference: [] };

// Rows of a pose and a unit as a matrix.
function matrixOf(rows, unit) {
  const r = (row, column) => rows[4 * row + column];
  const line = (row) => [unit * r(row, 0), unit * r(row, 1), unit * r(row, 2), r(row, 3)];
  return new Matrix4().set(...line(0), ...line(1), ...line(2), 0, 0, 0, 1);
}

class Live {
  constructor() {
    this.version = 0;
    this.unanswered = 0;
    this.path = [];
    this.keyframes = new Map();
    this.points = new Map();
    try {
      this.view = new View(byId('view3d'), nothing, () => {});
    } catch {
      byId('stage').hidden = true;
      byId('no-webgl').hidden = false;
    }
    this.build();
  }

  // Groups whose content is replaced, with their switches.
  build() {
    const [cells, large, local] = [new Group(), new Group(), new Group()];
    this.groups = { cells, 'large map': large, 'local map': local, cloud: new Group(), path: new Group(), camera: new Group() };
    this.view?.scene.add(...Object.values(this.groups));
    // in the order of the bits of a question
    this.asked = [cells, large, local];
    for (const group of this.asked) group.visible = false;
    local.matrixAutoUpdate = false;
    for (const [name, group] of Object.entries(this.groups)) {
      const box = document.createElement('input');
      box.type = 'checkbox';
      box.checked = group.visible;
      box.addEventListener('change', () => {
        group.visible = box.checked;
        this.view?.draw();
      });
      const label = document.createElement('label');
      label.append(box, ` ${name}`);
      byId('switches').append(label);
    }
    // the view follows the map until somebody turns it
    this.isFollowing = true;
    this.view?.controls.addEventListener('start', () => (this.isFollowing = false));
  }

  async ask() {
    let news;
    try {
      // relative: the address of the page holds a token
      const wanted = this.asked.reduce((bits, group, bit) => bits + (group.visible ? 1 << bit : 0), 0);
      const answer = await fetch(`live/${this.version}/${this.path.length}/${wanted}`);
      news = await answer.json();
      this.unanswered = 0;
    } catch {
      this.unanswered += 1;
      this.goOn(this.unanswered === MAX_UNANSWERED);
      return;
    }
    this.take(news);
    this.goOn(news.ended);
  }

  goOn(hasEnded) {
    if (hasEnded) byId('live-state').textContent = 'Tracking has ended: report.html shows the result as soon as the final maps are done.';
    else setTimeout(() => this.ask(), this.groups['local map'].visible ? ASK_OFTEN_MS : ASK_EVERY_MS);
  }

  take(news) {
    this.version = news.version;
    this.path.push(...news.path);
    this.say(news);
    for (const keyframe of news.keyframes) this.takeKeyframe(keyframe);
    for (const [id, unit, pose] of news.poses) this.keyframes.set(id, { unit, pose });
    if (this.view) this.draw(news);
    this.showImages(news);
  }

  say({ frames: [done, total], rate, frame }) {
    const of = total ? `frame ${done} of ${total}` : `frame ${done}`;
    const state = frame ? `${DOING[frame.state] ?? frame.state}${frame.reason ? ` (${frame.reason})` : ''}` : 'waiting for the first frame';
    byId('live-state').textContent = `${of} · ${rate.toFixed(0)} per second · ${this.keyframes.size} keyframes · ${state}`;
  }

  takeKeyframe(keyframe) {
    const known = this.points.get(keyframe.id);
    if (known) {
      this.groups.cloud.remove(known.layer);
      known.layer.geometry.dispose();
    }
    if (!this.view || keyframe.cloud.count[0] === 0) return;
    const points = new Points(keyframe.cloud);
    const { layer } = pointsLayer(points, this.view.shared);
    layer.matrixAutoUpdate = false;
    layer.visible = false;
    this.points.set(keyframe.id, { layer, points });
    this.groups.cloud.add(layer);
  }

  draw(news) {
    for (const [id, { layer }] of this.points) {
      const posed = this.keyframes.get(id);
      layer.visible = Boolean(posed);
      if (posed) layer.matrix.copy(matrixOf(posed.pose, posed.unit));
    }
    if (news.cells) this.replace('cells', this.cubes(news.cells));
    if (news.large) this.replace('large map', this.cubes(news.large));
    if (news.local) {
      // it is smooth by odometry, and shown where the map has the camera
      this.replace('local map', this.cubes(news.local.cells));
      if (news.local.pose) this.groups['local map'].matrix.copy(matrixOf(news.local.pose, 1));
    }
    if (news.path.length && this.path.length > 1) this.replace('path', [lineLayer(this.path.map((p) => p.slice(1)), isDark() ? 0xf0f0f0 : 0x151515)]);
    if (this.isFollowing) this.follow();
    const size = this.view.radius;
    if (news.frame?.pose) {
      const here = { pose: news.frame.pose };
      this.replace('camera', [frustaLayer([here], news.camera, 0.08 * size, 0xff00aa), markAt([3, 7, 11].map((i) => here.pose[i]), 0.02 * size, 0xff00aa)]);
    }
    this.view.draw();
  }

  cubes(cells) {
    return cells.count[0] ? [cubesLayer(new Cubes(cells.occupied, cells), this.view.shared).exact] : [];
  }

  replace(name, layers) {
    for (const old of [...this.groups[name].children]) {
      this.groups[name].remove(old);
      old.geometry.dispose();
      old.material.dispose();
    }
    this.groups[name].add(...layers);
  }

  // Brings the path and some points of every keyframe into view.
  follow() {
    const seen = [];
    for (const [id, { points }] of this.points) {
      const posed = this.keyframes.get(id);
      const matrix = posed && matrixOf(posed.pose, posed.unit);
      for (const i of posed ? points.order.subarray(0, OF_EACH) : []) seen.push(new Vector3(...points.at(i)).applyMatrix4(matrix).toArray());
    }
    if (seen.length + this.path.length < 2) return;
    this.view.data = { ...nothing, keyframes: [...this.keyframes.values()], path: this.path, points: { count: seen.length, at: (i) => seen[i] } };
    this.view.surround(...extent(this.view.data));
    this.view.shared.heights.value = this.view.heights();
    this.view.lookFrom('corner');
  }

  showImages({ frame, keyframes, camera }) {
    if (frame?.image) this.showFrame(frame, camera);
    const last = keyframes[keyframes.length - 1];
    if (!last) return;
    const points = new Points(last.cloud);
    const shown = { ...last, pose: IDENTITY, points: [0, points.count] };
    this.newest = { id: last.id, points };
    new KeyframeView(byId('keyframe'), byId('keyframe-caption'), { keyframes: [shown], points, camera }).show(0);
  }

  // The newest image, with the points of the newest keyframe where its pose has them.
  async showFrame({ image, pose }, camera) {
    const picture = new Image();
    picture.src = `data:image/jpeg;base64,${image}`;
    await picture.decode();
    const canvas = byId('live-image');
    canvas.width = picture.width;
    canvas.height = picture.height;
    const context = canvas.getContext('2d');
    context.drawImage(picture, 0, 0);
    const posed = this.newest && this.keyframes.get(this.newest.id);
    if (!pose || !posed) return;
    const cameraFromKeyframe = matrixOf(pose, 1).invert().multiply(matrixOf(posed.pose, posed.unit));
    const [fx, fy, cx, cy] = camera.intrinsics;
    const scale = picture.width / camera.size[0];
    context.fillStyle = '#30d060';
    for (let i = 0; i < this.newest.points.count; i += 8) {
      const { x, y, z } = new Vector3(...this.newest.points.at(i)).applyMatrix4(cameraFromKeyframe);
      if (z > 0) context.fillRect(((fx * x) / z + cx) * scale - 1, ((fy * y) / z + cy) * scale - 1, 2, 2);
    }
  }
}

const live = new Live();
live.ask();
window.explorer = { view: live.view, live };
