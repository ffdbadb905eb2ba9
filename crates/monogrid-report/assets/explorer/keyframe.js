// A keyframe: its image, and its depth as dots over it (red near, blue far), made from its points in the cloud.
import { quantiles } from 'explorer/data';
import { rainbow } from 'explorer/colours';

export class KeyframeView {
  constructor(canvas, caption, data) {
    this.canvas = canvas;
    this.caption = caption;
    this.data = data;
    this.withDepth = true;
    this.shown = null;
  }

  // The keyframe with a picture that is nearest in number: long runs do not carry all pictures.
  pictured(position) {
    const { keyframes } = this.data;
    for (let away = 0; away < keyframes.length; away++) {
      for (const i of [position - away, position + away]) if (keyframes[i]?.image) return keyframes[i];
    }
    return null;
  }

  async show(position) {
    this.position = position;
    const keyframe = this.pictured(position);
    if (!keyframe) return;
    this.shown = keyframe;
    const image = new Image();
    image.src = `data:image/jpeg;base64,${keyframe.image}`;
    await image.decode();
    if (this.shown !== keyframe) return;
    this.canvas.width = image.width;
    this.canvas.height = image.height;
    const context = this.canvas.getContext('2d');
    context.drawImage(image, 0, 0);
    const depths = this.depths(keyframe);
    if (this.withDepth) this.drawDepths(context, depths, image);
    const near = depths.length ? `, depths from ${quantiles(depths.map((d) => d[2]), 0.02, 0.98).map((z) => z.toPrecision(2)).join(' to ')}` : '';
    const instead = keyframe === this.data.keyframes[position] ? '' : ' (the nearest one with a picture)';
    const time = keyframe.time === undefined ? '' : `, ${keyframe.time.toFixed(1)} s`;
    this.caption.textContent = `keyframe ${keyframe.id}, frame ${keyframe.frame}${time}${instead}${near}`;
  }

  setDepth(on) {
    this.withDepth = on;
    if (this.shown) this.show(this.position);
  }

  // Column, row (px of the camera) and depth of its points.
  depths({ pose, points: [first, count] }) {
    const { points, camera } = this.data;
    if (!points || !camera) return [];
    const [fx, fy, cx, cy] = camera.intrinsics;
    const found = [];
    for (let i = first; i < first + count; i++) {
      const point = points.at(i);
      const from = [0, 1, 2].map((k) => point[k] - pose[4 * k + 3]);
      const [x, y, z] = [0, 1, 2].map((c) => pose[c] * from[0] + pose[4 + c] * from[1] + pose[8 + c] * from[2]);
      if (z > 0) found.push([(fx * x) / z + cx, (fy * y) / z + cy, z]);
    }
    return found;
  }

  drawDepths(context, depths, image) {
    const scale = image.width / this.data.camera.size[0];
    const [near, far] = quantiles(depths.map((d) => 1 / d[2]), 0.02, 0.98);
    for (const [u, v, z] of depths) {
      const [r, g, b] = rainbow((1 / z - near) / Math.max(far - near, 1e-9));
      context.fillStyle = `rgb(${r | 0},${g | 0},${b | 0})`;
      context.fillRect(u * scale - 0.5, v * scale - 0.5, 1.5, 1.5);
    }
  }
}
