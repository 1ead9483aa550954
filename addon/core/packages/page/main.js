// The page: shows a package while it loads.

import { fetchManifest, Loader } from "./loader.js";
import { explain } from "./network.js";
import { Orbit } from "./orbit.js";
import { Renderer } from "./renderer.js";
import { buildSurface } from "./surface.js";

const LIMITS = [1, 2, 5, 10, 20, 60]; // seconds
const FRAME_MILLISECONDS = 100; // between two looks at the numbers
const element = (id) => document.getElementById(id);
element("late").remove();
const base = findPackage();
const historyKey = `farfield-rate ${base?.origin}`;

let loader = null, renderer = null, isRequested = false, isSettled = false;
let levels = []; // received surfaces, by level
const first = fetchPackage(); // before all other work
first.catch(() => {}); // `load` reports it
const session = { start: 0, firstImage: null, problems: [] };

const orbit = new Orbit(element("view"), () => {
  serve();
  requestDraw();
});

/** The URL of the folder of the package, null where the address names none. */
function findPackage() {
  try {
    const url = new URL(new URLSearchParams(location.search).get("package") ?? "./", location.href);
    if (!url.pathname.endsWith("/")) url.pathname += "/";
    return url;
  } catch {
    return null;
  }
}

/** Load what the size on screen needs. */
function serve() {
  if (!loader?.serve(findPixels())) return;
  isSettled = false;
  showStatus();
}

function findPixels() {
  const { width, height } = element("view");
  return orbit.pixels(width, height);
}

async function fetchPackage() {
  if (!base) throw new Error("The address names no package.");
  return fetchManifest(base);
}

/** Draw with the next frame of the screen. */
function requestDraw() {
  if (isRequested || !renderer?.materials) return;
  isRequested = true;
  requestAnimationFrame(() => {
    isRequested = false;
    const isFree = !renderer.isBusy, isCurrent = isFree && renderer.draw(orbit, isSettled);
    if (isFree && renderer.mesh) session.firstImage ??= (performance.now() - session.start) / 1000;
    if (!isCurrent) requestDraw();
  });
}

function resize() {
  const canvas = element("view"), scale = Math.min(devicePixelRatio, 2);
  [canvas.width, canvas.height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(Math.round(side * scale), 1));
  serve();
  requestDraw();
}

function report(sentence) {
  if (!session.problems.includes(sentence)) session.problems.push(sentence);
  showStatus();
}

function showStatus(result = "") {
  element("status").textContent = [...session.problems, result].join(" ").trim();
}

/** Load the package from the beginning. coming: a promise of its manifest. isNew: without what the browser keeps. */
async function load(coming = fetchPackage(), start = performance.now(), isNew = true) {
  try {
    await show(coming, start, isNew);
  } catch (error) {
    loader?.stop();
    report(explain(error));
  }
}

async function show(coming, start, isNew) {
  loader?.stop();
  Object.assign(session, { start, firstImage: null, problems: [] });
  isSettled = false;
  levels = [];
  showStatus();
  const manifest = await coming;
  fillChoices(manifest);
  const options = {
    limit: Number(element("limit").value), refines: element("refine").checked, pixels: findPixels(), rate: readHistory(),
    simulatedRate: Number(element("bandwidth").value), isNew, start,
  };
  orbit.frame(manifest.bounds);
  loader = new Loader(base, manifest, options, {
    level(mesh, counts, index) {
      levels[index] = { surface: buildSurface(mesh), counts };
      element("levels").options[index + 1].disabled = false;
      showLevel();
    },
    tile(texture, place, bitmap) {
      renderer.setTile(texture, place, bitmap);
      bitmap.close();
      requestDraw();
    },
    problem: report,
  });
  loader.start(); // first: requests are under way while textures are created
  document.title = element("name").textContent = manifest.name;
  renderer.start(manifest);
  if (renderer.isReduced) report("The graphics processor limits the resolution of textures.");
}

function fillChoices(manifest) {
  const limit = element("limit"), current = limit.value || manifest.time_limit;
  const limits = [...new Set([...LIMITS, manifest.time_limit])].sort((a, b) => a - b);
  limit.replaceChildren(...limits.map((seconds) => new Option(`${seconds} s`, seconds)));
  limit.value = current;
  const choice = element("levels");
  choice.replaceChildren(choice.options[0], ...manifest.levels.map((level, index) => {
    const option = new Option(`${index}: ${sum(level.triangle_counts).toLocaleString()} triangles`, index);
    option.disabled = true;
    return option;
  }));
  choice.value = -1;
}

function showLevel() {
  const chosen = Number(element("levels").value), index = chosen < 0 ? levels.length - 1 : chosen;
  if (!levels[index]) return;
  renderer.setSurface(levels[index].surface, levels[index].counts);
  element("level").textContent = `${index} of ${loader.manifest.levels.length - 1}`;
  element("triangles").textContent = sum(levels[index].counts).toLocaleString();
  requestDraw();
}

function showMeasures() {
  if (!loader || isSettled) return;
  const { bytes, total, rate, ended, deviation, difference } = loader.measures;
  element("progress").value = bytes / total;
  element("bytes").textContent = `${formatBytes(bytes)} of ${formatBytes(total)}`;
  element("rate").textContent = `${((rate * 8) / 1e6).toFixed(1)} Mbit/s`;
  element("time").textContent = `${(loader.isFinished ? ended : loader.time).toFixed(2)} s`;
  element("deviation").textContent = "–";
  if (!loader.isFinished) return;
  isSettled = true;
  element("deviation").textContent = `${deviation > 0 ? "+" : ""}${deviation.toFixed(2)} s`;
  element("deviation").title = `Mean difference between planned and actual times of requests: ${difference.toFixed(3)} s`;
  if (loader.decoder.failures) report(`${loader.decoder.failures} times, a tile of a texture could not be decoded.`);
  if (!loader.options.simulatedRate && rate > 0) writeHistory(rate);
  showStatus(bytes < total ? "Stopped at the time limit." : loader.isComplete ? "Complete." : "Complete for this size on screen.");
  loader.keepReceived();
  requestDraw();
}

function readHistory() {
  try {
    return Number(localStorage.getItem(historyKey)) || 0;
  } catch {
    return 0; // the user does not allow pages to store anything
  }
}

function writeHistory(rate) {
  try {
    localStorage.setItem(historyKey, Math.round(rate));
  } catch {
    // see above
  }
}

function formatBytes(bytes) {
  return bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`;
}

function sum(values) {
  return values.reduce((total, value) => total + value, 0);
}

/** For tests and for embedding pages: what is shown, and control of the view. */
window.farfield = {
  session,
  get loader() { return loader; },
  get isFinished() { return isSettled; },
  get levels() { return levels; },
  /** The image as a data URL. */
  capture() {
    renderer.draw(orbit, true);
    return element("view").toDataURL();
  },
  orbit,
  load,
};

function createRenderer() {
  renderer = new Renderer(element("view"), () => {
    renderer.start(loader.manifest);
    showLevel();
    loader.decoder.repeat();
  });
  renderer.isLit = element("light").checked;
  new ResizeObserver(resize).observe(element("view"));
}

element("light").addEventListener("change", ({ target }) => {
  renderer.isLit = target.checked;
  requestDraw();
});
element("levels").addEventListener("change", showLevel);
element("refine").addEventListener("change", ({ target }) => {
  if (loader) loader.refines = target.checked;
  isSettled = false;
  showStatus();
});
element("restart").addEventListener("click", () => load());
for (const id of ["bandwidth", "limit"]) element(id).addEventListener("change", () => load());
document.addEventListener("visibilitychange", () => document.hidden && loader?.keepReceived());
setInterval(showMeasures, FRAME_MILLISECONDS);
try {
  createRenderer(); // while the manifest comes, not later: nobody would notice the responses to the first requests in time
  load(first, 0, false); // the user's wish began with the navigation to the page
} catch (error) {
  report(error.message);
}
