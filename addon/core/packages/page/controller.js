// Decides which bytes of a package to ask for next, so that sending ends at the time limit. tests/packages/reference/controller.py is
// the same function, explains it, and has the same arithmetic in the same order: both decide alike bit for bit, as a test checks.
//
//   let job = buildJob(manifest)      // the parsed manifest.json
//   let state = begin(job, {limit, rate, servers, patience, keepsRefining})
//   [state, requests, aborted] = decide(job, state, {time, id, received, failed})
//
// Times are seconds since the user's wish. Call `decide` with {time} at first, about 20 times per second, and at the limit; and for request
// `id` with {time, id, received: 0} when its headers come, {time, id, received} when bytes come (received: bytes of this response altogether;
// the last byte ends it), or {time, id, failed: true}. Send `requests`, [{id, server, file, start, end}, ...]: bytes [start, end) of a file
// from server `server` (0: the page's folder, then the mirrors), and abort those whose ids are in `aborted`; keep what has come of them: only
// the rest is asked for again. When the table of increments has come, go on with job = addTable(job, table).
// To read: state.ended - limit (deviation Pi), and the functions below.

import { insert, measure, subtract } from "./byte_intervals.js";
import { findPath, inspectTextures, listIncrements } from "./sending_path.js";

const MESH = "mesh.bin", TEXTURES = "textures.bin";
const DEFAULT_RATE = 250000, DEFAULT_DELAY = 0.1, PRIOR_SECONDS = 0.1;
const FAST = 0.3, SLOW = 2, GRACE = 0.1, FRACTION = 1 / 3, MAX_REQUEST = 1, FIRST_REQUEST = 0.3, LEAD = 1.5, EXCESS = 1.2, MEASURED = 0.2, MAX_PARTS = 3, PARTS = 2, MAX_GAP = 300;
const SMALLEST = 15000, LATE = 0.3, TWICE = 2, MIN_SAVING = 0.2, SILENCE = 0.5, MIN_PAUSE = 0.25, MAX_PAUSE = 16, MIN_RATE = 1000, ENDLESS = 1e9;
const { abs, floor, max, min } = Math;

/** What `manifest` has to send. */
export function buildJob(manifest) {
  const levels = manifest.levels.map((level) => {
    const sections = [level.positions, level.parents, level.wedges, level.uvs, level.corners];
    return { file: MESH, start: min(...sections.map(([start]) => start)), end: max(...sections.map(([start, size]) => start + size)) };
  });
  const [start, size] = manifest.increments, isTextured = manifest.increment_count > 0;
  const first = [levels[0], ...(isTextured ? [{ file: TEXTURES, start, end: start + size }] : [])];
  const job = { first, levels, errors: tabulateErrors(manifest.errors), begin: manifest.first_increment, ends: null };
  return isTextured ? job : addTable(job, { sizes: [], firsts: [], lasts: [] });
}

function tabulateErrors({ levels, states, exponent }) {
  const combine = (level, state) => (level ** exponent + state ** exponent) ** (1 / exponent);
  return levels.map((level) => states.map((state) => min(combine(level, state), 1)));
}

/** `job` with its increments: arrays of their bytes, and of the first and the last state that has each. */
export function addTable(job, { sizes, firsts, lasts }) {
  const empty = job.errors[0].map(() => 0), states = empty.map(() => []), totals = [...empty], steps = empty.map(() => [...empty]), ends = [];
  let end = job.begin;
  sizes.forEach((size, i) => {
    const start = end;
    ends.push((end += size));
    for (let state = firsts[i]; state <= lasts[i]; state++) {
      const last = states[state].at(-1);
      if (last?.[1] === start) last[1] = end;
      else states[state].push([start, end]);
      totals[state] += size;
      for (let earlier = 0; earlier < firsts[i]; earlier++) steps[earlier][state] += size;
    }
  });
  return { ...job, ends, states, sizes: totals, steps };
}

/** The state before the first request. limit, patience: seconds; rate: bytes per second that the user's line had before, or 0. */
export function begin(job, { limit, rate = 0, servers = 1, patience = 0, keepsRefining = false }) {
  const bytes = (rate || DEFAULT_RATE) * PRIOR_SECONDS;
  const server = { bytes, seconds: PRIOR_SECONDS, slowBytes: bytes, slowSeconds: PRIOR_SECONDS, delay: DEFAULT_DELAY };
  Object.assign(server, { measured: 0, mark: 0, heard: 0, failures: 0, failed: 0, until: 0 });
  return {
    limit, patience, keepsRefining, servers: Array.from({ length: servers }, () => ({ ...server })), time: 0, flights: [],
    pending: [...job.first], nextId: 0, mesh: job.levels[0].end, asked: [], ended: 0, difference: 0, latest: 0, responses: 0,
  };
}

/** The state after `event`, the requests to send, and the ids of those to abort. */
export function decide(job, before, { time, id = -1, received = 0, failed = false }) {
  const copy = (items) => items.map((item) => ({ ...item }));
  const state = { ...before, servers: copy(before.servers), flights: copy(before.flights), pending: [...before.pending] };
  state.time = max(state.time, time);
  const heard = state.flights.find((flight) => flight.id === id);
  if (heard) hear(job, state, heard, received, failed);
  const isOver = state.time >= state.limit + state.patience && !state.keepsRefining;
  const aborted = [];
  for (const flight of [...state.flights].reverse()) { // the newest first
    const silent = isSilent(state, flight);
    if (silent) pause(state, flight);
    if (silent || (!isFirst(job, flight) && (isOver || isExcess(state, flight)))) {
      owe(job, state, flight);
      aborted.push(flight.id);
    }
  }
  const requests = [];
  while (ask(job, state, requests, aborted));
  return [state, requests, aborted];
}

/** Whether no response is waited for and nothing will be asked for anymore. */
export function isFinished(job, state) {
  if (state.flights.length || state.pending.some((span) => isFirst(job, span))) return false;
  if (state.time >= state.limit && !state.keepsRefining) return true;
  return job.ends !== null && !subtract(job.states.at(-1), state.asked).length && !state.pending.length && state.mesh === job.levels.at(-1).end;
}

/** The finest level that has come with all coarser ones, or -1. */
export function receivedLevel(job, state) {
  const missing = [...state.pending, ...state.flights].filter((span) => span.file === MESH);
  return levelUpTo(job, min(state.mesh, ...missing.map(({ start, received = 0 }) => start + received)));
}

/** Lambda (eq. 9 of the paper), seconds. */
export function meanDifference(state) {
  return (state.difference - state.latest) / max(state.responses - 1, 1);
}

/** The bytes per second of a server that are to be expected for the next `horizon` seconds. */
export function estimateRate(state, index, horizon) {
  const server = state.servers[index];
  const isOpen = state.flights.some((flight) => flight.isOpen && flight.server === index);
  const gap = isOpen ? max(0, state.time - server.mark - GRACE) : 0;
  const fast = server.bytes / (server.seconds + gap);
  const slow = server.slowBytes / (server.slowSeconds + gap);
  return (fast * FAST + slow * horizon) / (FAST + horizon);
}

/** The finest level that ends at `offset` at most, or -1. */
function levelUpTo(job, offset) {
  return job.levels.filter(({ end }) => end <= offset).length - 1;
}

function hear(job, state, flight, received, failed) {
  if (failed) {
    pause(state, flight);
    owe(job, state, flight);
    return;
  }
  const server = state.servers[flight.server];
  const isBusy = state.flights.some((other) => other.isOpen && other.server === flight.server);
  const size = flight.end - flight.start;
  received = min(max(received, flight.received), size);
  let fresh = received - flight.received;
  if (!flight.isOpen) {
    flight.isOpen = true;
    server.delay += (state.time - flight.asked - server.delay) * (server.measured ? 0.25 : 1);
  }
  if (!isBusy) [server.mark, fresh] = [state.time, 0]; // bytes that come with the headers took a time that nobody measured
  learn(server, fresh, state.time - server.mark);
  server.mark = flight.heard = server.heard = state.time;
  flight.received = received;
  if (received === size) {
    state.flights = state.flights.filter((other) => other !== flight);
    state.latest = abs(state.time - flight.due);
    state.difference += state.latest;
    state.responses += 1;
    state.ended = state.time;
    server.failures = 0;
  }
}

function learn(server, count, seconds) {
  const fast = FAST / (FAST + seconds), slow = SLOW / (SLOW + seconds);
  server.bytes = server.bytes * fast + count;
  server.seconds = server.seconds * fast + seconds;
  server.slowBytes = server.slowBytes * slow + count;
  server.slowSeconds = server.slowSeconds * slow + seconds;
  server.measured += seconds;
}

function isSilent(state, flight) {
  const server = state.servers[flight.server];
  const since = max(flight.heard, min(server.heard, flight.due));
  const patience = max(SILENCE, 4 * server.delay) * (state.servers.length === 1 ? 2 << min(server.failures, 3) : 1);
  return state.time - since > (server.measured ? patience : 2 * patience); // connecting takes longer
}

function findSlow(state, index, start, rate) {
  let slow = null, most = MIN_SAVING;
  if (!state.servers[index].measured) return slow;
  state.servers.forEach((server, other) => {
    let busy = 0;
    const theirs = line(state, other)[2];
    for (const flight of state.flights) {
      if (flight.server !== other || other === index) continue;
      const left = flight.end - flight.start - flight.received;
      const begins = flight.isOpen ? busy : max(busy, flight.asked + server.delay - state.time);
      busy = begins + left / theirs;
      const saving = busy - TWICE * (start + left / rate);
      if (saving > most && state.time + busy > flight.due + LATE) [slow, most] = [flight, saving];
    }
  });
  return slow;
}

function isExcess(state, flight) {
  const isAlone = state.flights.every((other) => other.server !== flight.server || other.id >= flight.id);
  if (isAlone || flight.file === MESH || state.keepsRefining) return false;
  return line(state, flight.server)[0] > EXCESS * max(state.limit - state.time, 0);
}

function pause(state, flight) {
  const server = state.servers[flight.server];
  if (state.time < server.until) return; // one of several requests that fail together
  server.failed = state.time;
  server.until = state.time + min(MIN_PAUSE * (1 << (2 * min(server.failures, 3))), MAX_PAUSE);
  server.failures += 1;
}

function isPaused(state, index) {
  const server = state.servers[index];
  const isNeeded = state.servers.every((other) => state.time < other.until);
  return state.time < server.until && !(isNeeded && state.time >= server.failed + MIN_PAUSE);
}

function owe(job, state, flight) {
  state.flights = state.flights.filter((other) => other !== flight);
  const { file, end } = flight, rest = { file, start: flight.start + flight.received, end };
  if (file === TEXTURES && !isFirst(job, rest)) state.asked = subtract(state.asked, [[rest.start, end]]);
  else state.pending.unshift(rest);
}

function isFirst(job, span) {
  return job.first.some((first) => span.file === first.file && first.start <= span.start && span.start < first.end);
}

function ask(job, state, requests, aborted) {
  const owesFirst = state.servers.length === 1 && state.pending.some((span) => isFirst(job, span));
  const lines = [];
  state.servers.forEach((server, index) => {
    const [busy, rest, rate] = line(state, index);
    if (!isPaused(state, index) && (owesFirst || busy <= LEAD * server.delay)) lines.push([max(busy, server.delay), index, rest, rate]);
  });
  lines.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  for (const [start, server, rest, rate] of lines) {
    const slow = findSlow(state, server, start, rate);
    if (slow) {
      owe(job, state, slow);
      aborted.push(slow.id);
    }
    const span = take(job, state, rest, rate, state.servers[server]);
    if (!span) continue;
    const due = state.time + start + (span.end - span.start) / rate;
    const id = state.nextId++;
    state.flights.push({ id, server, ...span, asked: state.time, due, heard: state.time, received: 0, isOpen: false });
    requests.push({ id, server, ...span });
    return true;
  }
  return false;
}

function line(state, index) {
  const isRefining = state.keepsRefining && state.time >= state.limit;
  const left = isRefining ? ENDLESS : max(state.limit - state.time, 0);
  const rate = max(estimateRate(state, index, left), MIN_RATE);
  const { delay } = state.servers[index];
  let busy = 0;
  for (const flight of state.flights) {
    if (flight.server !== index) continue;
    const begins = flight.isOpen ? busy : max(busy, flight.asked + delay - state.time);
    busy = begins + (flight.end - flight.start - flight.received) / rate;
  }
  return [busy, isRefining ? left : left - max(busy, delay), rate];
}

function take(job, state, rest, rate, server) {
  const longest = server.measured >= MEASURED ? MAX_REQUEST : FIRST_REQUEST, isAlone = state.servers.length === 1;
  const owedFirst = state.pending.findIndex((span) => isFirst(job, span));
  if (owedFirst >= 0) {
    const { start, end } = state.pending[owedFirst];
    return cut(state, owedFirst, isAlone ? end : min(end, start + floor(longest * rate)));
  }
  if (rest <= 0 || job.ends === null) return null;
  const shortest = state.patience || !isAlone ? server.delay : max(server.delay, SMALLEST / rate), possible = rest * rate;
  const wanted = rest <= shortest ? possible : max(min(rest * FRACTION, longest), shortest) * rate;
  const [span, position] = choose(job, state, wanted), { file, start } = span;
  let { end } = span;
  if ((file === MESH || !isAlone) && end - start > min(MAX_PARTS * wanted, possible)) end = start + floor(min(PARTS * wanted, possible));
  if (end === start) return null;
  if (position >= 0) return cut(state, position, end);
  if (file === MESH) state.mesh = end;
  else state.asked = insert(state.asked, start, end);
  return { file, start, end };
}

function choose(job, state, wanted) {
  let owed = 0, offset = state.mesh;
  for (const { start, end } of state.pending) [owed, offset] = [owed + end - start, min(offset, start)];
  const level = levelUpTo(job, offset);
  if (level + 1 < job.levels.length) owed += max(job.levels[level + 1].end - state.mesh, 0);
  const textures = inspectTextures(job, state.asked), budget = budgetOf(state);
  const [next, target] = findPath(job, level, textures, measure(state.asked), owed, budget, wanted);
  if (next === level || (!state.asked.length && textures.state < 0)) { // something of the textures first
    return [missingSpan(job, state, textures.missing[target], wanted, budget), -1];
  }
  return state.pending.length ? [state.pending[0], 0] : [{ file: MESH, start: state.mesh, end: job.levels[next].end }, -1];
}

function cut(state, position, end) {
  const span = state.pending[position];
  state.pending.splice(position, 1, ...(end < span.end ? [{ ...span, start: end }] : []));
  return { ...span, end };
}

function missingSpan(job, state, missing, wanted, possible) {
  let first = job.begin, last = first;
  for (const [start, end] of listIncrements(job, missing)) {
    if (first === last) {
      if (end - start <= possible) [first, last] = [start, end];
    } else if (end - first > wanted || start - last > MAX_GAP || state.asked.some((item) => item[0] < start && item[1] > last)) break;
    else last = end;
  }
  return { file: TEXTURES, start: first, end: last };
}

function budgetOf(state) {
  return state.servers.reduce((sum, _, index) => {
    const [, rest, rate] = line(state, index);
    return isPaused(state, index) ? sum : sum + max(rest, 0) * rate;
  }, 0);
}
