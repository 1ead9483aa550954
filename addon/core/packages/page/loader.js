// Loads a package within a time limit: asks for what the controller decides, checks it, and passes on levels and tiles as they come.

import { measure, subtract } from "./byte_intervals.js";
import { addTable, begin, buildPlan, decide, estimateRate, findTarget, isFinished, limitPlan, meanDifference, takeKept } from "./controller.js";
import { ByteStore } from "./byte_store.js";
import { decodeLevel, inflate } from "./mesh_decoding.js";
import { crc32, DamageError, explain, openRange, PartialFile, Connection } from "./network.js";
import { readIncrements, ROW_BYTES, TileDecoder } from "./tiles.js";

const FORMAT = "farfield-package", VERSION = 4;
const MESH = "mesh.bin", TEXTURES = "textures.bin";
const REFERENCES = ["parents", "wedges", "uvs", "corners"], SECTIONS = [...REFERENCES, "positions"];
const TICK_SECONDS = 0.05;
const MANIFEST_TRIES = 3, MANIFEST_SECONDS = 15;
const MAX_FILE_BYTES = 2 ** 31, MAX_INCREMENTS = 2 ** 20, MAX_SIDE = 65536; // as in manifest.py

/** Fetch the manifest of the package in the folder `base` (URL). Throws an Error with a sentence for the user. */
export async function fetchManifest(base) {
  const url = new URL("manifest.json", base);
  let manifest;
  for (let attempt = 1; ; attempt++) {
    try {
      const response = await fetch(url, { cache: "no-cache", signal: AbortSignal.timeout(MANIFEST_SECONDS * 1000) });
      if (!response.ok) throw new Error(`The server answers ${response.status} for ${url}.`);
      manifest = await response.json();
      break;
    } catch (error) {
      if (error instanceof SyntaxError) throw new DamageError("manifest.json");
      if (attempt === MANIFEST_TRIES) throw new Error(`${url} cannot be loaded. ${error.message}`);
    }
  }
  if (manifest?.format !== FORMAT) throw new Error("manifest.json is not that of a package of Farfield.");
  if (manifest.version !== VERSION) throw new Error(`The package has version ${manifest.version} of the format; this page reads ${VERSION}.`);
  checkManifest(manifest);
  return manifest;
}

function checkManifest(manifest) {
  try {
    const { levels, materials, textures, errors, first_increment: first } = manifest;
    const isSize = (value, low = 0, high = MAX_FILE_BYTES) => Number.isInteger(value) && value >= low && value <= high;
    const areNumbers = (values, count) => values.length === count && values.every(Number.isFinite);
    const isBox = ([low, high], count) => areNumbers(low, count) && areNumbers(high, count);
    const files = [MESH, TEXTURES].map((name) => manifest.files[name]), sizes = files.map(([size]) => size);
    const fits = ([offset, size], end) => isSize(offset) && isSize(size) && offset + size <= end;
    const isFine = files.every(([size, digest]) => isSize(size) && /^\w*$/.test(digest)) && isSize(first, 0, sizes[1]) && fits(manifest.increments, first) &&
      isSize(manifest.increment_count, 0, Math.min(sizes[1] - first, MAX_INCREMENTS)) && levels.length && materials.length && manifest.time_limit > 0 &&
      levels.every((level) => SECTIONS.every((name) => fits(level[name], sizes[0])) && isSize(level.vertex_count) && isSize(level.wedge_count) &&
        level.triangle_counts.length === materials.length && level.triangle_counts.every((count) => isSize(count))) &&
      areNumbers(errors.levels, levels.length) && isSize(errors.states.length, 1, Math.min(Math.max(manifest.increment_count, 1), 64)) && areNumbers(errors.states, errors.states.length) && errors.exponent >= 1 &&
      areNumbers(manifest.state_pixels, errors.states.length) && isBox(manifest.bounds, 3) && isBox(manifest.uv_bounds, 2) &&
      areNumbers(manifest.steps, 2) && manifest.mirrors.every((url) => /^https?:$/.test(new URL(url).protocol)) &&
      materials.every(({ textures: used, base_color: color, shading }) => Object.values(used).every((index) => textures[index]) && areNumbers(color, 4) &&
        areNumbers(shading.emission, 3) && areNumbers([shading.roughness, shading.metallic, shading.normal_scale, shading.alpha_cutoff], 4)) &&
      textures.every(({ width, height, tile_size: side, headers }) => [width, height, side].every((value) => isSize(value, 1, MAX_SIDE)) &&
        Math.ceil(width / side) * Math.ceil(height / side) <= MAX_SIDE && headers.every((header) => /^(\w\w)+$/.test(header)));
    if (!isFine) throw new RangeError();
  } catch {
    throw new DamageError("manifest.json");
  }
}

/** One run of loading a package.
 *
 * events: {level(mesh, counts, index), tile(texture, place, bitmap), problem(sentence)}, see `decodeLevel` and `TileDecoder`. options: {limit
 * (seconds, for the first picture), refines (whether more is asked for after the limit, until the size on screen is served), pixels (the
 * size of the object on screen), rate (bytes per second that the connection had before, or 0), simulatedRate (bytes per second, or 0),
 * isNew (whether bytes that the browser keeps do not count), start (performance.now() in ms)}. */
export class Loader {
  constructor(base, manifest, options, events) {
    const urls = [base, ...manifest.mirrors].map((url) => new URL(url, base));
    Object.assign(this, { urls, manifest, options, events, shown: -1, wanted: -1, exact: 0, passed: 0, tasks: 0, table: null,
      isWhole: false, isStopped: false, isTableWanted: false, ended: 0, rate: 0, picture: null, store: null });
    this.files = Object.fromEntries([MESH, TEXTURES].map((name) => [name, new PartialFile(name, manifest.files[name])]));
    this.connection = new Connection(options.simulatedRate);
    this.requests = new Map(); // AbortControllers by id
    this.decoder = new TileDecoder(manifest, events.tile);
    this.meshes = [];
    this.work = Promise.resolve(); // sections are decoded one after the other
    this.#setPlan(buildPlan(manifest), findTarget(manifest, options.pixels));
    const { limit, rate } = options;
    this.state = begin(this.plan, { limit, rate, servers: urls.length });
  }

  /** Begin to load, with what the browser has kept. */
  async start() {
    if (!this.options.isNew && !this.options.simulatedRate) await this.#readKept().catch(() => {});
    if (!this.isStopped) this.#run();
  }

  async #readKept() {
    this.store = await ByteStore.open(this.urls[0]);
    if (!this.store) return;
    for (const file of Object.values(this.files)) await this.store.read(file);
    this.state = takeKept(this.whole, this.state, this.files[MESH].intervals, this.files[TEXTURES].intervals);
    this.#setPlan(this.whole, [Math.max(this.target[0], this.whole.levels.findIndex(({ end }) => end >= this.state.mesh)), this.target[1]]);
    this.#pass();
  }

  /** Let the browser keep what is received. */
  async keepReceived() {
    if (!this.store || this.options.simulatedRate) return;
    for (const file of Object.values(this.files)) await this.store.write(file).catch(() => {}); // it has no room
  }

  /** Load what an object with so many pixels on screen needs. Returns whether that is more than before. */
  serve(pixels) {
    const wanted = findTarget(this.manifest, pixels).map((index, i) => Math.max(index, this.target[i]));
    if (wanted.every((index, i) => index === this.target[i])) return false;
    this.#setPlan(this.whole, wanted);
    if (!this.isStopped && this.timer) this.#run();
    return true;
  }

  /** whole: the plan of the package. target: the level and the state of the textures that are needed. */
  #setPlan(whole, target) {
    Object.assign(this, { whole, target, plan: limitPlan(whole, ...target, this.state?.keepsRefining) });
  }

  #run() {
    clearInterval(this.timer);
    clearTimeout(this.alarm);
    this.alarm = setTimeout(() => this.#decide({}), Math.max(this.options.limit - this.time, 0) * 1000);
    this.timer = setInterval(() => (this.isFinished ? clearInterval(this.timer) : this.#decide({})), TICK_SECONDS * 1000);
    this.#decide({});
  }

  /** End all requests. */
  stop() {
    this.isStopped = true;
    clearInterval(this.timer);
    clearTimeout(this.alarm);
    for (const request of this.requests.values()) request.abort();
  }

  /** Seconds since the user's wish. */
  get time() {
    return (performance.now() - this.options.start) / 1000;
  }

  /** Whether all that will be requested is received and decoded. */
  get isFinished() {
    const isHere = this.isWhole ? this.ended > 0 : isFinished(this.plan, this.state);
    return isHere && !this.tasks && this.decoder.isIdle;
  }

  /** Numbers to show: received bytes, those when the size on screen is served, bytes per second, seconds until the last response before the
   * limit, its deviation from the limit, Lambda of the paper. */
  get measures() {
    const [mesh, textures] = [MESH, TEXTURES].map((name) => this.files[name]), received = measure(textures.intervals);
    const bytes = measure(mesh.intervals) + received;
    let left = measure(subtract([[0, this.plan.levels.at(-1).end]], mesh.intervals));
    left += this.plan.ends ? measure(subtract(this.plan.states.at(-1), textures.intervals)) : textures.size - received;
    const ended = this.isWhole ? this.ended || this.time : (this.picture ?? this.state.ended);
    const rate = this.isWhole ? bytes / ended : this.rate;
    return { bytes, total: bytes + left, rate, ended, deviation: ended - this.options.limit, difference: meanDifference(this.state) };
  }

  /** Go on after the limit, or not. */
  set refines(value) {
    this.options.refines = value;
    if (!value) this.state = { ...this.state, keepsRefining: false };
    this.#setPlan(this.whole, this.target);
    this.#run();
  }

  /** Whether everything of the package is received. */
  get isComplete() {
    const { levels, state_pixels: states } = this.manifest;
    return this.isWhole || (this.target[0] === levels.length - 1 && this.target[1] === states.length - 1);
  }

  #decide(event) {
    if (this.isStopped || this.isWhole) return;
    let requests, aborted;
    [this.state, requests, aborted] = decide(this.plan, this.state, { time: this.time, ...event });
    if (event.received) this.rate = this.urls.reduce((sum, _, index) => sum + estimateRate(this.state, index, 1), 0);
    for (const id of aborted) this.requests.get(id)?.abort();
    for (const request of requests) this.#send(request);
    const { limit, refines } = this.options;
    if (!refines || this.state.keepsRefining || this.time < limit || !isFinished(this.plan, this.state)) return;
    this.picture = this.state.ended; // the first one; from here on in the background
    this.state = { ...this.state, keepsRefining: true };
    this.#setPlan(this.whole, this.target);
    this.#decide({});
  }

  async #send({ id, server, file: name, start, end }) {
    const file = this.files[name], abort = new AbortController();
    this.requests.set(id, abort);
    try {
      const { isWhole, parts } = await this.#open(file, server, start, end, abort.signal);
      if (isWhole && end - start < file.size) return await this.#takeWhole(file, parts, server, abort);
      this.#decide({ id, received: 0 });
      for await (const [offset, part] of parts) {
        file.put(offset, part);
        this.#decide({ id, received: offset + part.length - start });
        this.#pass();
      }
    } catch (error) {
      if (this.isStopped || abort.signal.aborted) return;
      if (error instanceof DamageError || this.isWhole) this.#fail(error);
      else {
        this.events.problem(error.message); // and ask again
        this.#decide({ id, failed: true });
      }
    } finally {
      this.requests.delete(id);
    }
  }

  /** Load both files from beginning to end: the server does not know ranges. */
  async #takeWhole(file, parts, server, abort) {
    if (this.isWhole) return;
    this.isWhole = true;
    this.requests.forEach((request) => request !== abort && request.abort());
    this.events.problem("This server sends whole files only, so the time limit cannot be kept.");
    await this.#keep(file, parts);
    const other = Object.values(this.files).find((item) => item !== file);
    await this.#keep(other, (await this.#open(other, server, 0, other.size, abort.signal)).parts);
    this.ended = this.time;
  }

  #open(file, server, start, end, signal) {
    const priority = this.state.keepsRefining ? "low" : "auto";
    return openRange(file.locate(this.urls[server]), file, start, end, this.connection, { signal, priority, isOwn: !server });
  }

  async #keep(file, parts) {
    for await (const [offset, part] of parts) {
      file.put(offset, part);
      this.#pass();
    }
  }

  /** Pass on what has become complete. */
  #pass() {
    const { manifest } = this, textures = this.files[TEXTURES];
    if (!this.isTableWanted && textures.read(manifest.increments)) {
      this.isTableWanted = true;
      this.#do(() => this.#readTable());
    }
    if (this.table) this.#passIncrements();
    let level = -1, exact = 0; // the decoder estimates missing positions
    while (level + 1 < manifest.levels.length && this.#isHere(level + 1, level < 0 ? SECTIONS : REFERENCES)) level++;
    while (exact <= level && this.#isHere(exact, SECTIONS)) exact++;
    if (level <= this.wanted && exact <= this.exact) return;
    [this.wanted, this.exact] = [level, exact];
    this.#do(() => this.#showLevel(level));
  }

  #isHere(level, names) {
    return names.every((name) => this.files[MESH].read(this.manifest.levels[level][name]));
  }

  /** Pass on the received increments, also those behind gaps in the file: each shows its part of a texture by itself. */
  #passIncrements() {
    const { table } = this, file = this.files[TEXTURES];
    const end = Math.max(...file.intervals.map((interval) => interval[1]));
    for (let i = this.passed; i < table.ends.length && table.ends[i] <= end; i++) {
      const payload = table.isPassed[i] ? null : file.read([table.ends[i] - table.sizes[i], table.sizes[i]]);
      if (!payload) continue;
      this.decoder.add(i, table.textures[i], table.tiles[i], table.headers[i], payload);
      table.isPassed[i] = 1;
    }
    while (table.isPassed[this.passed]) this.passed++;
  }

  async #readTable() {
    const content = await this.#check(this.files[TEXTURES], this.manifest.increments);
    const planes = await inflate(content, ROW_BYTES * this.manifest.increment_count);
    this.table = readIncrements(planes, this.manifest);
    this.table.isPassed = new Uint8Array(this.table.ends.length);
    const whole = addTable(this.whole, this.table);
    const kept = whole.states.findLastIndex((state) => !subtract(state, this.state.requested).length); // of another visit
    this.#setPlan(whole, [this.target[0], Math.max(this.target[1], kept)]);
    this.#passIncrements();
    this.#decide({});
  }

  async #showLevel(index) {
    const firstEstimate = this.meshes.findIndex((mesh) => !mesh.isExact);
    if (firstEstimate >= 0) this.meshes.length = firstEstimate;
    for (let level = this.meshes.length; level <= index; level++) {
      const sections = {}, hasPositions = this.#isHere(level, SECTIONS);
      for (const name of hasPositions ? SECTIONS : REFERENCES) {
        sections[name] = await this.#check(this.files[MESH], this.manifest.levels[level][name]);
      }
      this.meshes.push(await decodeLevel(this.manifest, level, sections, this.meshes[level - 1]));
      if (this.isStopped) return;
      this.shown = level;
      this.events.level(this.meshes[level], this.manifest.levels[level].triangle_counts, level);
    }
  }

  /** The bytes of a section, after asking for them again if they are damaged. */
  async #check(file, section) {
    const [offset, size, expected] = section;
    for (let attempt = 0; crc32(file.read(section)) !== expected; attempt++) {
      if (attempt === this.urls.length) throw new DamageError(file.name);
      const server = this.urls.length - 1 - attempt; // mirrors first: the damage came from somewhere
      await this.#keep(file, (await this.#open(file, server, offset, offset + size, new AbortController().signal)).parts);
    }
    return file.read(section);
  }

  /** Run `task` after those before; its failure ends the run. */
  #do(task) {
    this.tasks++;
    this.work = this.work.then(task).catch((error) => this.#fail(error)).finally(() => this.tasks--);
  }

  #fail(error) {
    if (this.isStopped) return;
    this.stop();
    this.events.problem(explain(error));
  }
}
