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
  return { context, close: () => context.close().then(() => fs.rmSync(folder, { recursive: true, force: true })) };
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
  await page.waitForFunction(() => window.explorer, null, { timeout: 120000 }).catch(() => errors.push('no explorer'));
  // drawn twice: everything is on the screen
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
  return { page, errors, asked, seconds: (Date.now() - begun) / 1000 };
}

// Pictures per second while the view turns by itself: with the detail that a user gets, and with everything.
function turning(page, layers, isFull) {
  return page.evaluate(
    async ([layers, isFull]) => {
      const { view } = window.explorer;
      if (!view) return null;
      for (const [name, layer] of Object.entries(view.layers)) layer.object.visible = layers.includes(name);
      const adapt = view.adapt;
      if (isFull) view.adapt = () => view.setDetail(1, false);
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
      // so many pictures, or so long
      const turns = async (count, milliseconds) => {
        const begun = performance.now();
        let done = 0;
        for (; done < count && performance.now() - begun < milliseconds; done++) {
          turn();
          await new Promise(requestAnimationFrame);
        }
        return (1000 * done) / (performance.now() - begun);
      };
      await turns(20, 1500);
      const rate = await turns(60, 3000);
      view.adapt = adapt;
      view.restSoon();
      for (const layer of Object.values(view.layers)) layer.object.visible = layer.on;
      return { rate, share: view.mustHurry ? view.movingShare : 1 };
    },
    [layers, isFull],
  );
}

async function look(out, file) {
  const url = file.startsWith('http') ? file : `file://${path.resolve(file)}`;
  const name = file.startsWith('http') ? 'view' : path.basename(path.dirname(path.resolve(file))) + '-' + path.basename(file, '.html');
  const wide = await browser(1280, 900, 'light');
  const { page, errors, asked, seconds } = await open(wide.context, url);
  const shot = (what, options) => page.screenshot({ path: path.join(out, `${name}-${what}.png`), ...options });
  await shot('wide');
  const has = await page.evaluate(() => Object.keys(window.explorer?.view?.layers ?? {}));
  const rates = {};
  for (const layers of [['cloud', 'path'], ['cells', 'path'], ['cells', 'cloud', 'path']]) {
    if (!layers.every((layer) => has.includes(layer))) continue;
    const full = await turning(page, layers, true);
    const felt = await turning(page, layers, false);
    rates[layers.join('+')] = `${felt.rate.toFixed(1)}/s (everything: ${full.rate.toFixed(1)}/s)`;
  }
  await page.evaluate(() => {
    const { view } = window.explorer;
    if (!view?.layers.cloud) return;
    for (const [name, layer] of Object.entries(view.layers)) layer.object.visible = ['cloud', 'path', 'keyframes', 'links'].includes(name);
    view.draw();
  });
  await page.waitForTimeout(700);
  await shot('cloud');
  await page.evaluate(() => document.getElementById('timeline-part').scrollIntoView());
  await shot('below');
  await page.evaluate(() => window.scrollTo(0, 0));
  await shot('all', { fullPage: true });
  await wide.close();
  const narrow = await browser(380, 780, 'dark');
  const phone = await open(narrow.context, url);
  const width = await phone.page.evaluate(() => document.documentElement.scrollWidth);
  await phone.page.screenshot({ path: path.join(out, `${name}-phone.png`), fullPage: true });
  await narrow.close();
  const all = [...errors, ...phone.errors];
  console.log(JSON.stringify({ page: name, seconds, rates, phone_width: width, errors: all, asked: [...asked, ...phone.asked] }, null, 1));
  return all.length === 0 && width <= 380 && (file.startsWith('http') || asked.length + phone.asked.length === 0);
}

(async () => {
  const [out, ...files] = process.argv.slice(2);
  let isGood = true;
  for (const file of files) isGood = (await look(out, file)) && isGood;
  process.exit(isGood ? 0 : 1);
})();
