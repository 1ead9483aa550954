// Decides which bytes of a package to ask for next, so that sending ends at the time limit. tests/packages/reference/controller.py is
// the same function, explains it, and has the same arithmetic in the same order: both decide alike bit for bit, as a test checks.
//
//   let plan = buildPlan(manifest)      // the parsed manifest.json
//   plan = limitPlan(plan, ...findTarget(manifest, pixels))      // after each change of the plan; the limits may grow, not shrink
//   let state = begin(plan, {limit, rate, servers, patience, keepsRefining})
//   [state, requests, aborted] = decide(plan, state, {time, id, received, failed})
//
// Times are seconds since the user's wish. Call `decide` with {time} at first, about 20 times per second, and at the limit; and for request
// `id` with {time, id, received: 0} when its headers come, {time, id, received} when bytes come (received: bytes of this response altogether;
// the last byte ends it), or {time, id, failed: true}. Send `requests`, [{id, server, file, start, end}, ...]: bytes [start, end) of a file
// from server `server` (0: the page's folder, then the mirrors), and abort those whose ids are in `aborted`; keep their received bytes: only
// the rest is asked for again. When the table of increments is received, go on with plan = addTable(plan, table).
// To read: state.ended - limit (deviation Pi), and the functions below.

import { insert, measure, subtract } from "./byte_intervals.js";
import { findPath, inspectTextures, listIncrements } from "./streaming_path.js";

const MESH = "mesh.bin", TEXTURES = "textures.bin";
const DEFAULT_RATE = 250000, DEFAULT_DELAY = 0.1, PRIOR_SECONDS = 0.1;
const FAST = 0.3, SLOW = 2, GRACE = 0.1, FRACTION = 1 / 3, MAX_REQUEST = 1, FIRST_REQUEST = 0.3, LEAD = 1.5, EXCESS = 1.2, MEASURED = 0.2, MAX_PARTS = 3, PARTS = 2, MAX_GAP = 300;
const SMALLEST = 15000, LATE = 0.3, TWICE = 2, MIN_SAVING = 0.2, SILENCE = 0.5, MIN_PAUSE = 0.25, MAX_PAUSE = 16, MIN_RATE = 1000, ENDLESS = 1e9;
const { abs, floor, max, min } = Math;

/** What `manifest` has to send. */
export function buildPlan(manifest) {
  const levels = manifest.levels.map((level) => {
    const sections = [level.positions, level.parents, level.wedges, level.uvs, level.corners];
    return { file: MESH, start: min(...sections.map(([start]) => start)), end: max(...sections.map(([start, size]) => start + size)) };
  });
  const [start, size] = manifest.increments, isTextured = manifest.increment_count > 0;
  const first = [levels[0], ...(isTextured ? [{ file: TEXTURES, start, end: start + size }] : [])];
  const plan = { first, levels, errors: tabulateErrors(manifest.errors), begin: manifest.first_increment, ends: null };
  return isTextured ? plan : addTable(plan, { sizes: [], firsts: [], lasts: [] });
}

function tabulateErrors({ levels, states, exponent }) {
  const combine = (level, state) => (level ** exponent + state ** exponent) ** (1 / exponent);
  return levels.map((level) => states.map((state) => min(combine(level, state), 1)));
}

/** `plan` with its increments: arrays of their bytes, and of the first and the last state that has each. */
export function addTable(plan, { sizes, firsts, lasts }) {
  const empty = plan.errors[0].map(() => 0), states = empty.map(() => []), totals = [...empty], steps = empty.map(() => [...empty]), ends = [];
  let end = plan.begin;
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
  return { ...plan, ends, states, sizes: totals, steps };
}

/** The coarsest level and the first state of the textures that look right where the object has so many pixels in the image. */
export function findTarget({ levels, state_pixels: states }, pixels) {
  return [levels.map((level) => level.pixels), states].map((sizes) => {
    const index = sizes.findIndex((size) => size >= pixels);
    return index < 0 ? sizes.length - 1 : index;
  });
}

/** `plan` up to a level and a state of the textures. isDirect: without the states before, which would only be replaced. */
export function limitPlan(plan, level, state, isDirect = false) {
  const limit = (items) => items.slice(isDirect ? state : 0, state + 1);
  const limited = { ...plan, levels: plan.levels.slice(0, level + 1), errors: plan.errors.slice(0, level + 1).map(limit) };
  return plan.ends ? { ...limited, states: limit(plan.states), sizes: limit(plan.sizes), steps: limit(plan.steps).map(limit) } : limited;
}

/** `state` without what the browser has kept from another visit: intervals of both files. */
export function takeKept(plan, state, mesh, textures) {
  const pending = state.pending.flatMap(({ file, start, end }) =>
    subtract([[start, end]], file === MESH ? mesh : textures).map(([first, last]) => ({ file, start: first, end: last })));
  const begin = mesh.find(([start]) => start <= plan.levels[0].start);
  return { ...state, pending, mesh: max(state.mesh, begin ? begin[1] : 0), requested: subtract(textures, [[0, plan.begin]]) };
}

/** The state before the first request. limit, patience: seconds; rate: bytes per second that the user's connection had before, or 0. */
export function begin(plan, { limit, rate = 0, servers = 1, patience = 0, keepsRefining = false }) {
  const bytes = (rate || DEFAULT_RATE) * PRIOR_SECONDS;
  const server = {
    bytes, seconds: PRIOR_SECONDS, slowBytes: bytes, slowSeconds: PRIOR_SECONDS, delay: DEFAULT_DELAY,
    measured: 0, mark: 0, lastResponse: 0, failures: 0, failed: 0, until: 0,
  };
  return {
    limit, patience, keepsRefining, servers: Array.from({ length: servers }, () => ({ ...server })), time: 0, inFlight: [],
    pending: [...plan.first], nextId: 0, mesh: plan.levels[0].end, requested: [], ended: 0, difference: 0, latest: 0, responses: 0,
  };
}

/** The state after `event`, the requests to send, and the ids of those to abort. */
export function decide(plan, before, { time, id = -1, received = 0, failed = false }) {
  const copy = (items) => items.map((item) => ({ ...item }));
  const state = { ...before, servers: copy(before.servers), inFlight: copy(before.inFlight), pending: [...before.pending] };
  state.time = max(state.time, time);
  const answered = state.inFlight.find((request) => request.id === id);
  if (answered) onResponse(plan, state, answered, received, failed);
  const isOver = state.time >= state.limit + state.patience && !state.keepsRefining;
  const aborted = [];
  for (const request of [...state.inFlight].reverse()) { // the newest first
    const silent = isSilent(state, request);
    if (silent) pause(state, request);
    if (silent || (!isFirst(plan, request) && (isOver || isExcess(state, request)))) {
      requeue(plan, state, request);
      aborted.push(request.id);
    }
  }
  const requests = [];
  while (nextRequest(plan, state, requests, aborted));
  return [state, requests, aborted];
}

/** Whether no response is waited for and nothing will be asked for anymore. */
export function isFinished(plan, state) {
  if (state.inFlight.length || state.pending.some((span) => isFirst(plan, span))) return false;
  if (state.time >= state.limit && !state.keepsRefining) return true;
  return plan.ends !== null && !subtract(plan.states.at(-1), state.requested).length && !state.pending.length && state.mesh === plan.levels.at(-1).end;
}

/** The finest received level of which all coarser ones are received, or -1. */
export function receivedLevel(plan, state) {
  const missing = [...state.pending, ...state.inFlight].filter((span) => span.file === MESH);
  return levelUpTo(plan, min(state.mesh, ...missing.map(({ start, received = 0 }) => start + received)));
}

/** Lambda (eq. 9 of the paper), seconds. */
export function meanDifference(state) {
  return (state.difference - state.latest) / max(state.responses - 1, 1);
}

/** The bytes per second of a server that are to be expected for the next `horizon` seconds. */
export function estimateRate(state, index, horizon) {
  const server = state.servers[index];
  const isOpen = state.inFlight.some((request) => request.isOpen && request.server === index);
  const gap = isOpen ? max(0, state.time - server.mark - GRACE) : 0;
  const fast = server.bytes / (server.seconds + gap);
  const slow = server.slowBytes / (server.slowSeconds + gap);
  return (fast * FAST + slow * horizon) / (FAST + horizon);
}

/** The finest level that ends at `offset` at most, or -1. */
function levelUpTo(plan, offset) {
  return plan.levels.filter(({ end }) => end <= offset).length - 1;
}

function onResponse(plan, state, request, received, failed) {
  if (failed) {
    pause(state, request);
    requeue(plan, state, request);
    return;
  }
  const server = state.servers[request.server];
  const isBusy = state.inFlight.some((other) => other.isOpen && other.server === request.server);
  const size = request.end - request.start;
  received = min(max(received, request.received), size);
  let fresh = received - request.received;
  if (!request.isOpen) {
    request.isOpen = true;
    server.delay += (state.time - request.sent - server.delay) * (server.measured ? 0.25 : 1);
  }
  if (!isBusy) [server.mark, fresh] = [state.time, 0]; // bytes that come with the headers took a time that nobody measured
  measureRate(server, fresh, state.time - server.mark);
  server.mark = request.lastResponse = server.lastResponse = state.time;
  request.received = received;
  if (received === size) {
    state.inFlight = state.inFlight.filter((other) => other !== request);
    state.latest = abs(state.time - request.due);
    state.difference += state.latest;
    state.responses += 1;
    state.ended = state.time;
    server.failures = 0;
  }
}

function measureRate(server, count, seconds) {
  const fast = FAST / (FAST + seconds), slow = SLOW / (SLOW + seconds);
  server.bytes = server.bytes * fast + count;
  server.seconds = server.seconds * fast + seconds;
  server.slowBytes = server.slowBytes * slow + count;
  server.slowSeconds = server.slowSeconds * slow + seconds;
  server.measured += seconds;
}

function isSilent(state, request) {
  const server = state.servers[request.server];
  const since = max(request.lastResponse, min(server.lastResponse, request.due));
  const patience = max(SILENCE, 4 * server.delay) * (state.servers.length === 1 ? 2 << min(server.failures, 3) : 1);
  return state.time - since > (server.measured ? patience : 2 * patience); // connecting takes longer
}

function findSlow(state, index, start, rate) {
  let slow = null, most = MIN_SAVING;
  if (!state.servers[index].measured) return slow;
  state.servers.forEach((server, other) => {
    let busy = 0;
    const theirs = lookAhead(state, other)[2];
    for (const request of state.inFlight) {
      if (request.server !== other || other === index) continue;
      const left = request.end - request.start - request.received;
      const begins = request.isOpen ? busy : max(busy, request.sent + server.delay - state.time);
      busy = begins + left / theirs;
      const saving = busy - TWICE * (start + left / rate);
      if (saving > most && state.time + busy > request.due + LATE) [slow, most] = [request, saving];
    }
  });
  return slow;
}

function isExcess(state, request) {
  const isAlone = state.inFlight.every((other) => other.server !== request.server || other.id >= request.id);
  if (isAlone || request.file === MESH || state.keepsRefining) return false;
  return lookAhead(state, request.server)[0] > EXCESS * max(state.limit - state.time, 0);
}

function pause(state, request) {
  const server = state.servers[request.server];
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

function requeue(plan, state, request) {
  state.inFlight = state.inFlight.filter((other) => other !== request);
  const { file, end } = request, rest = { file, start: request.start + request.received, end };
  if (file === TEXTURES && !isFirst(plan, rest)) state.requested = subtract(state.requested, [[rest.start, end]]);
  else state.pending.unshift(rest);
}

function isFirst(plan, span) {
  return plan.first.some((first) => span.file === first.file && first.start <= span.start && span.start < first.end);
}

function nextRequest(plan, state, requests, aborted) {
  const needsFirst = state.servers.length === 1 && state.pending.some((span) => isFirst(plan, span));
  const free = [];
  state.servers.forEach((server, index) => {
    const [busy, rest, rate] = lookAhead(state, index);
    if (!isPaused(state, index) && (needsFirst || busy <= LEAD * server.delay)) free.push([max(busy, server.delay), index, rest, rate]);
  });
  free.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  for (const [start, server, rest, rate] of free) {
    const slow = findSlow(state, server, start, rate);
    if (slow) {
      requeue(plan, state, slow);
      aborted.push(slow.id);
    }
    const span = allocate(plan, state, rest, rate, state.servers[server]);
    if (!span) continue;
    const due = state.time + start + (span.end - span.start) / rate;
    const id = state.nextId++;
    state.inFlight.push({ id, server, ...span, sent: state.time, due, lastResponse: state.time, received: 0, isOpen: false });
    requests.push({ id, server, ...span });
    return true;
  }
  return false;
}

function lookAhead(state, index) {
  const isRefining = state.keepsRefining && state.time >= state.limit;
  const left = isRefining ? ENDLESS : max(state.limit - state.time, 0);
  const rate = max(estimateRate(state, index, left), MIN_RATE);
  const { delay } = state.servers[index];
  let busy = 0;
  for (const request of state.inFlight) {
    if (request.server !== index) continue;
    const begins = request.isOpen ? busy : max(busy, request.sent + delay - state.time);
    busy = begins + (request.end - request.start - request.received) / rate;
  }
  return [busy, isRefining ? left : left - max(busy, delay), rate];
}

function allocate(plan, state, rest, rate, server) {
  const longest = server.measured >= MEASURED ? MAX_REQUEST : FIRST_REQUEST, isAlone = state.servers.length === 1;
  const first = state.pending.findIndex((span) => isFirst(plan, span));
  if (first >= 0) {
    const { start, end } = state.pending[first];
    return cut(state, first, isAlone ? end : min(end, start + floor(longest * rate)));
  }
  if (rest <= 0 || plan.ends === null) return null;
  const shortest = state.patience || !isAlone ? server.delay : max(server.delay, SMALLEST / rate), possible = rest * rate;
  const wanted = rest <= shortest ? possible : max(min(rest * FRACTION, longest), shortest) * rate;
  const [span, position] = choose(plan, state, wanted), { file, start } = span;
  let { end } = span;
  if ((file === MESH || !isAlone) && end - start > min(MAX_PARTS * wanted, possible)) end = start + floor(min(PARTS * wanted, possible));
  if (end === start) return null;
  if (position >= 0) return cut(state, position, end);
  if (file === MESH) state.mesh = end;
  else state.requested = insert(state.requested, start, end);
  return { file, start, end };
}

function choose(plan, state, wanted) {
  let remaining = 0, offset = state.mesh;
  for (const { start, end } of state.pending) [remaining, offset] = [remaining + end - start, min(offset, start)];
  const level = levelUpTo(plan, offset);
  if (level + 1 < plan.levels.length) remaining += max(plan.levels[level + 1].end - state.mesh, 0);
  const textures = inspectTextures(plan, state.requested), budget = budgetOf(state);
  const [next, target] = findPath(plan, level, textures, measure(state.requested), remaining, budget, wanted);
  if (next === level || (!state.requested.length && textures.state < 0)) { // something of the textures first
    return [missingSpan(plan, state, textures.missing[target], wanted, budget), -1];
  }
  return state.pending.length ? [state.pending[0], 0] : [{ file: MESH, start: state.mesh, end: plan.levels[next].end }, -1];
}

function cut(state, position, end) {
  const span = state.pending[position];
  state.pending.splice(position, 1, ...(end < span.end ? [{ ...span, start: end }] : []));
  return { ...span, end };
}

function missingSpan(plan, state, missing, wanted, possible) {
  let first = plan.begin, last = first;
  for (const [start, end] of listIncrements(plan, missing)) {
    if (first === last) {
      if (end - start <= possible) [first, last] = [start, end];
    } else if (end - first > wanted || start - last > MAX_GAP || state.requested.some((item) => item[0] < start && item[1] > last)) break;
    else last = end;
  }
  return { file: TEXTURES, start: first, end: last };
}

function budgetOf(state) {
  return state.servers.reduce((sum, _, index) => {
    const [, rest, rate] = lookAhead(state, index);
    return isPaused(state, index) ? sum : sum + max(rest, 0) * rate;
  }, 0);
}
