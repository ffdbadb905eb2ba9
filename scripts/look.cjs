// Called by look.sh: one line of numbers and some pictures for every page.
const { chromium } = require('playwright-core');
const fs = require('fs');
const os = require('os');
const path = require('path');

const FLAGS = [
  '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
  '--disable-component-update', '--disable-sync', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
];

async function browser(width, height, colorScheme) {
  const folder = fs.mkdtempSync(path.join(os.tmpdir(), 'look-'));
  const context = await chromium.launchPersistentContext(folder, {
    executablePath: process.env.CHROMIUM,
    args: FLAGS,
    viewport: { width, height },
    colorScheme,
    timeout: 120000,
  });
  return { context, folder, close: () => context.close().then(() => fs.rmSync(folder, { recursive: true, force: true })) };
}

// Seconds of processor time of a browser until now, by the folder of its profile; Linux only.
function processorSeconds(folder) {
  const parents = new Map();
  const ticks = new Map();
  const mine = new Set();
  for (const pid of fs.readdirSync('/proc').filter((name) => /^\d+$/.test(name))) {
    try {
      const fields = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ').pop().split(' ');
      parents.set(pid, fields[1]);
      ticks.set(pid, Number(fields[11]) + Number(fields[12]));
      if (fs.readFileSync(`/proc/${pid}/cmdline`, 'utf8').includes(folder)) mine.add(pid);
    } catch {
      // it has ended meanwhile
    }
  }
  const isMine = (pid) => pid !== undefined && (mine.has(pid) || isMine(parents.get(pid)));
  return [...ticks].filter(([pid]) => isMine(pid)).reduce((sum, [, ticks]) => sum + ticks, 0) / 100;
}

// Opens a page; what it complains of and what it asks for beside itself.
async function open(context, url) {
  const page = await context.newPage();
  const errors = [];
  const asked = [];
  page.on('console', (message) => {
    const text = message.text();
    // measuring waits until a picture is drawn, which the driver complains of
    if (['error', 'warning'].includes(message.type()) && !text.includes('GPU stall due to ReadPixels')) errors.push(text);
  });
  page.on('pageerror', (error) => errors.push(String(error)));
  page.on('request', (request) => !request.url().startsWith('data:') && request.url() !== url && asked.push(request.url()));
  const begun = Date.now();
  await page.goto(url, { waitUntil: 'load', timeout: 120000 });
  // a run that came to nothing has no explorer; until the script runs, that name is the element's. The surface is there once its picture is
  await page.waitForFunction(() => {
    const view = window.explorer?.view;
    if (view === undefined) return !document.getElementById('explorer');
    return !window.explorer.data?.surface?.texture || view?.surface.exact.material.uniforms.hasPicture.value === 1;
  }, null, { timeout: 120000 }).catch(() => errors.push('no explorer'));
  // drawn twice: everything is on the screen
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  return { page, errors, asked, seconds: (Date.now() - begun) / 1000 };
}

// Pictures per second while the view turns by itself: with the detail that a user gets, and with everything.
async function turning(page, folder, layers, isFull) {
  await turn(page, layers, isFull, [20, isFull ? 2000 : 12000]);
  const before = processorSeconds(folder);
  const { done, seconds, share } = await turn(page, layers, isFull, [60, 5000]);
  const cost = (processorSeconds(folder) - before) / done;
  return `${(done / seconds).toFixed(1)}/s with ${(100 * share).toFixed(0)} %, ${cost.toFixed(3)} s of processor time each`;
}

// Turns the view by so many pictures, or so long.
function turn(page, layers, isFull, limits) {
  return page.evaluate(
    async ([layers, isFull, limits]) => {
      const { view } = window.explorer;
      if (!view) return null;
      for (const [name, layer] of Object.entries(view.layers)) layer.object.visible = layers.includes(name);
      const adapt = view.adapt;
      if (isFull) view.adapt = () => view.setDetail(1, false);
      clearTimeout(view.rest);
      view.isMoving = true;
      const gl = view.renderer.getContext();
      const pixel = new Uint8Array(4);
      const { target } = view.controls;
      const turn = () => {
        const [x, y] = [view.camera.position.x - target.x, view.camera.position.y - target.y];
        view.camera.position.x = target.x + x * Math.cos(0.05) - y * Math.sin(0.05);
        view.camera.position.y = target.y + x * Math.sin(0.05) + y * Math.cos(0.05);
        view.camera.lookAt(target);
        view.adapt(performance.now());
        view.render();
        // waits until it is drawn
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      };
      const [count, milliseconds] = limits;
      const begun = performance.now();
      let done = 0;
      for (; done < count && performance.now() - begun < milliseconds; done++) {
        turn();
        await new Promise(requestAnimationFrame);
      }
      const seconds = (performance.now() - begun) / 1000;
      view.adapt = adapt;
      view.restSoon();
      for (const layer of Object.values(view.layers)) layer.object.visible = layer.on;
      return { done, seconds, share: view.mustHurry && !isFull ? view.movingShare : 1 };
    },
    [layers, isFull, limits],
  );
}

async function look(out, file) {
  const url = file.startsWith('http') ? file : `file://${path.resolve(file)}`;
  const name = file.startsWith('http') ? 'view' : path.basename(path.dirname(path.resolve(file))) + '-' + path.basename(file, '.html');
  const wide = await browser(1280, 900, 'light');
  const { page, errors, asked, seconds } = await open(wide.context, url);
  const shot = (what, options) => page.screenshot({ path: path.join(out, `${name}-${what}.png`), ...options });
  await shot('wide');
  // what a visitor sees first: the surface, what its colours mean, and a bar of a length
  const first = await page.evaluate(() => {
    const text = (id) => document.getElementById(id)?.textContent ?? '';
    return { shown: document.querySelector('#modes [aria-pressed=true]')?.textContent, colours: text('colours'), bar: text('ruler') };
  });
  const hasSurface = await page.evaluate(() => Boolean(window.explorer?.data?.surface));
  if (hasSurface && first.shown !== 'surface') errors.push(`the first view is ${first.shown}`);
  const hasExplorer = await page.evaluate(() => Boolean(window.explorer));
  if (hasExplorer && !file.startsWith('http') && (!first.colours || !first.bar)) errors.push('no legend, or no bar');
  const has = await page.evaluate(() => Object.keys(window.explorer?.view?.layers ?? {}));
  const rates = {};
  for (const layers of [['surface', 'path'], ['cloud', 'path'], ['cells', 'path'], ['cells', 'cloud', 'path']]) {
    if (!layers.every((layer) => has.includes(layer))) continue;
    const name = layers.join(' + ');
    rates[name] = await turning(page, wide.folder, layers, false);
    rates[`${name}, everything`] = await turning(page, wide.folder, layers, true);
  }
  await page.evaluate(() => {
    const view = window.explorer?.view;
    if (!view?.layers.cloud) return;
    for (const [name, layer] of Object.entries(view.layers)) layer.object.visible = ['cloud', 'path', 'keyframes', 'links'].includes(name);
    view.draw();
  });
  await page.waitForTimeout(700);
  await shot('cloud');
  await page.evaluate(() => document.getElementById('timeline-part')?.scrollIntoView());
  await shot('below');
  await page.evaluate(() => window.scrollTo(0, 0));
  await shot('all', { fullPage: true });
  const narrow = await browser(380, 780, 'dark');
  const phone = await open(narrow.context, url);
  const width = await phone.page.evaluate(() => document.documentElement.scrollWidth);
  await phone.page.screenshot({ path: path.join(out, `${name}-phone.png`), fullPage: true });
  await narrow.close();
  const all = [...errors, ...phone.errors];
  const script_seconds = (await page.evaluate(() => window.explorer?.milliseconds ?? 0)) / 1000;
  console.log(JSON.stringify({ page: name, megabytes: file.startsWith('http') ? null : fs.statSync(file).size / 1e6, seconds, script_seconds, first, rates, phone_width: width, errors: all, asked: [...asked, ...phone.asked] }, null, 1));
  await wide.close();
  return all.length === 0 && width <= 380 && (file.startsWith('http') || asked.length + phone.asked.length === 0);
}

(async () => {
  const [out, ...files] = process.argv.slice(2);
  let isGood = true;
  for (const file of files) isGood = (await look(out, file)) && isGood;
  process.exit(isGood ? 0 : 1);
})();
