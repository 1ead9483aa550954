// The best order of levels and states of the textures for an uncertain number of bytes: tests/packages/reference/streaming_path.py explains it, and has the same
// arithmetic in the same order.

import { measure, subtract } from "./byte_intervals.js";

const MIN_ERROR = 1e-6, STRIDE = 6, HEADERS = 400;
const STOPS = [0.3, 0.5, 0.6, 0.7, 0.77, 0.84, 0.9, 0.95, 1, 1.05, 1.1, 1.15, 1.2, 1.3, 1.5];
const { max, min } = Math;

/** What has been asked for of the textures: the last complete state, or -1, how many bytes each state lacks, and which. */
export function inspectTextures(plan, requested) {
  const missing = plan.states.map((state) => subtract(state, requested)), left = missing.map(measure);
  return { state: left.lastIndexOf(0), left, missing };
}

/** The increments, or parts of some, that lie in intervals of textures.bin. */
export function listIncrements(plan, intervals) {
  const found = [];
  let i = 0;
  for (let [start, end] of intervals) {
    while (start < end) {
      while (plan.ends[i] <= start) i++;
      found.push([start, (start = min(plan.ends[i], end))]);
    }
  }
  return found;
}

function estimateErrors(plan, { state, left }) {
  return plan.errors.map((row) => {
    const start = state >= 0 ? row[state] : 1;
    return row.reduce((best, error, other) => {
      return other > state ? min(best, start + (error - start) * (1 - left[other] / (state >= 0 ? plan.steps[state] : plan.sizes)[other])) : best;
    }, start);
  });
}

/** The level that the best path has asked for after `window` bytes, and the state of the textures that it goes to next. */
export function findPath(plan, level, textures, spent, remaining, budget, window) {
  const last = plan.errors[0].length - 1, present = estimateErrors(plan, textures);
  const meshes = [0, ...plan.levels.slice(level + 1).map(({ end }) => end - plan.levels[level + 1].end + remaining + HEADERS)];
  budget = min(budget, meshes.at(-1) + textures.left[last]);
  const stops = STOPS.map((stop) => budget * stop);
  const weights = stops.map((stop) => 1 / leastError(plan, plan.levels[level].end + spent + stop));
  let best = -1, found = [level, last];
  for (let state = min(textures.state + 1, last); state <= last; state++) {
    if (state < last && textures.left[state] > budget && listIncrements(plan, textures.missing[state]).some(([start, end]) => end - start > budget)) continue;
    const states = listStates(plan, textures, state), sizes = [0];
    states.forEach((other, i) => sizes.push(sizes[i] + HEADERS + (i ? plan.steps[states[i - 1]][other] : textures.left[other])));
    const errors = present.slice(level).map((error, row) => [error, ...states.map((other) => min(error, plan.errors[level + row][other]))]);
    const [cost, takesLevel] = findCosts(meshes, sizes, errors, stops, weights);
    if (best < 0 || cost < best) [best, found] = [cost, [level + walk(meshes, sizes, takesLevel, window), states[0] ?? last]];
    if (textures.left[state] > stops.at(-1)) break;
  }
  return found;
}

function listStates(plan, textures, state) {
  const last = plan.errors[0].length - 1, states = state > 0 && textures.state < 0 && plan.sizes[0] * STRIDE <= plan.sizes[state] ? [0] : [];
  if (textures.state < state) states.push(state);
  while (states.length && states.at(-1) < last) {
    const next = plan.sizes.findIndex((size, other) => other > states.at(-1) && size >= STRIDE * plan.sizes[states.at(-1)]);
    states.push(next < 0 ? last : next);
  }
  return states;
}

function findCosts(meshes, sizes, errors, stops, weights) {
  const rows = meshes.length - 1, last = sizes.length - 1, maximum = stops.at(-1), takesLevel = meshes.map(() => sizes.map(() => false));
  let costs;
  for (let row = rows; row >= 0; row--) {
    const finer = costs;
    costs = sizes.map(() => 0);
    for (let column = last; column >= 0; column--) {
      const start = meshes[row] + sizes[column], error = errors[row][column];
      if (start > maximum) continue;
      if (column < last) {
        const step = sizes[column + 1] - sizes[column];
        costs[column] = addCost(costs[column + 1], start, start + step, error, (errors[row][column + 1] - error) / step);
      }
      if (row < rows) {
        const cost = addCost(finer[column], start, meshes[row + 1] + sizes[column], error, 0);
        takesLevel[row][column] = column === last || cost < costs[column];
        if (takesLevel[row][column]) costs[column] = cost;
      } else if (column === last) costs[column] = addCost(0, start, 2 * maximum + 1, error, 0);
    }
  }
  return [costs[0], takesLevel];

  function addCost(cost, start, end, error, rise) {
    stops.forEach((stop, i) => {
      if (start <= stop && stop < end) cost += weights[i] * (error + (stop - start) * rise);
    });
    return cost;
  }
}

function walk(meshes, sizes, takesLevel, window) {
  let row = 0, column = 0;
  while (meshes[row] + sizes[column] < window) {
    if (takesLevel[row][column]) {
      if (row + column && meshes[row + 1] + sizes[column] > window) break;
      row++;
    } else if (column < sizes.length - 1) column++;
    else break;
  }
  return row;
}

function leastError(plan, count) {
  let least = 1;
  plan.errors.forEach((row, level) => row.forEach((error, state) => {
    if (plan.levels[level].end + plan.sizes[state] <= count) least = min(least, error);
  }));
  return max(least, MIN_ERROR);
}
