// Levels of meshes from the sections of mesh.bin. mesh/coding.py explains the sections, and tests/packages/reference decodes them in the same way.
//
//   let mesh = await decodeLevel(manifest, 0, sections)        // sections: Uint8Arrays by name
//   mesh = await decodeLevel(manifest, 1, sections, mesh)
// A level needs the coarser ones. If the positions of a level have not come, sections.positions is null, and its positions and those of finer
// levels are estimated. Decode these levels again when they are received.

const NEW = 0, RIGHT = 1, LEFT = 2, BOTH = 3, BOUNDARY = 4, OTHER = 5, CANDIDATE = 6; // symbols of edges of the border
const EXPLICIT_PARENT = 255, ADDED_WEDGE = 1, RING = 3;
const MAX_RATIO = 1032, MAX_LEB128_BYTES = 5, MAX_RESIDUAL_BYTES = 3; // of DEFLATE: bytes from one byte
const MIN_DETERMINANT = 1e-3, PASSES = 5, STEPS = 65535;

/** The content of a raw DEFLATE stream, which has `size` bytes. Throws RangeError if it is damaged or has others. */
export async function inflate(bytes, size) {
  const result = await inflateUpTo(bytes, size);
  check(result.length === size);
  return result;
}

async function inflateUpTo(bytes, maxSize) {
  const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
  const parts = [];
  let size = 0;
  const readPart = () => reader.read().catch(() => check(false));
  for (let part = await readPart(); !part.done; part = await readPart()) {
    size += part.value.length;
    if (size > maxSize) reader.cancel().catch(() => {});
    check(size <= maxSize);
    parts.push(part.value);
  }
  const result = new Uint8Array(size);
  for (let index = 0, offset = 0; index < parts.length; offset += parts[index++].length) result.set(parts[index], offset);
  return result;
}

function check(condition) {
  if (!condition) throw new RangeError("The mesh of the package is damaged.");
}

/** The mesh of level `index` of `manifest`: positions (3 V) of its vertices, wedges (W) their vertices, uvs (2 W), corners (3 T) wedges of
 * its triangles, those of one material after those of another, and parents (V). coarser: the mesh of the next coarser level.
 * Throws RangeError if it is damaged. */
export async function decodeLevel(manifest, index, sections, coarser) {
  const level = manifest.levels[index], known = coarser?.parents.length ?? 0, knownWedges = coarser?.wedges.length ?? 0;
  const triangles = level.triangle_counts.reduce((sum, count) => sum + count, 0);
  const added = level.vertex_count - known, addedWedges = level.wedge_count - knownWedges;
  check(triangles <= MAX_RATIO * sections.corners.length && 2 * addedWedges <= MAX_RATIO * sections.uvs.length);
  check(added >= 0 && addedWedges >= added);
  const [corners, codes, parents, uvPart, positionsPart] = await Promise.all([
    inflateUpTo(sections.corners, 4 + 3 * triangles * (1 + MAX_LEB128_BYTES)),
    inflateUpTo(sections.wedges, 3 * triangles * MAX_LEB128_BYTES),
    inflateUpTo(sections.parents, added * (1 + MAX_LEB128_BYTES)),
    inflateUpTo(sections.uvs, 2 * MAX_RESIDUAL_BYTES * addedWedges),
    sections.positions && inflateUpTo(sections.positions, 1 + 3 * MAX_RESIDUAL_BYTES * added),
  ]);
  check(corners.length >= 4);
  const symbolsEnd = 4 + new DataView(corners.buffer).getUint32(0, true), parentsEnd = parents.length ? added : 0;
  check(symbolsEnd <= corners.length && parentsEnd <= parents.length);
  const mesh = {
    corners: new Uint32Array(3 * triangles),
    wedges: extend(coarser?.wedges ?? new Uint32Array(0), level.wedge_count),
    nextWedges: extend(coarser?.nextWedges ?? new Uint32Array(0), level.wedge_count), // of the same vertex, in a ring
    firstWedges: extend(coarser?.firstWedges ?? new Uint32Array(0), level.vertex_count),
    parents: extend(coarser?.parents ?? new Int32Array(0), level.vertex_count),
    shortPositions: extend(coarser?.shortPositions ?? new Uint16Array(0), 3 * level.vertex_count),
    shortUvs: extend(coarser?.shortUvs ?? new Uint16Array(0), 2 * level.wedge_count),
    isExact: (coarser?.isExact ?? true) && Boolean(positionsPart),
  };
  const references = decodeTriangles(mesh, level, coarser, {
    symbols: corners.subarray(4, symbolsEnd),
    vertices: new IntegerReader(corners, symbolsEnd),
    codes: new IntegerReader(codes, 0),
    parentSymbols: parents.subarray(0, parentsEnd),
    parents: new IntegerReader(parents, parentsEnd),
  });
  addPredictions(mesh.shortUvs, knownWedges, 2, references.wedges, decodeResiduals(uvPart, 0, 2 * addedWedges), null);
  if (mesh.isExact) {
    const weights = positionsPart[0] === 1 ? findWeights(mesh, known, false) : null;
    addPredictions(mesh.shortPositions, known, 3, references.vertices, decodeResiduals(positionsPart, 1, 3 * added), weights);
  } else {
    estimatePositions(mesh, known);
  }
  mesh.positions = dequantize(mesh.shortPositions, manifest.bounds, manifest.steps[0]);
  mesh.uvs = dequantize(mesh.shortUvs, manifest.uv_bounds, manifest.steps[1]);
  return mesh;
}

function extend(values, size) {
  const result = new values.constructor(size);
  result.set(values);
  return result;
}

class IntegerReader {
  constructor(bytes, offset) {
    this.bytes = bytes;
    this.offset = offset;
  }

  read() {
    let value = 0;
    for (let scale = 1; scale < 2 ** (7 * MAX_LEB128_BYTES); scale *= 128) {
      check(this.offset < this.bytes.length);
      const byte = this.bytes[this.offset++];
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
    check(false);
  }

  readSigned() {
    return decodeSigned(this.read());
  }

  get isAtEnd() {
    return this.offset === this.bytes.length;
  }
}

const decodeSigned = (value) => (value % 2 ? -(value + 1) / 2 : value / 2);

/** `count` residuals: symbols from `offset` on, then extra bits, see sections.py. */
function decodeResiduals(bytes, offset, count) {
  const residuals = new Int16Array(count);
  let end = offset + count, bits = 0, bitCount = 0;
  check(end <= bytes.length);
  for (let index = 0; index < count; index++) {
    let number = bytes[offset + index];
    if (number >= 8) {
      const extra = (number >> 2) - 1;
      for (; bitCount < extra; bitCount += 8) bits |= bytes[end++] << bitCount;
      number = ((4 + (number & 3)) << extra) + (bits & ((1 << extra) - 1));
      check(number < 65536);
      bits >>>= extra;
      bitCount -= extra;
    }
    residuals[index] = (number >> 1) ^ -(number & 1);
  }
  check(end === bytes.length);
  return residuals;
}

/** The triangles around the vertices of a mesh, see coarse_fans.py. */
class CoarseFans {
  constructor({ corners, wedges }, vertexCount) {
    this.starts = new Uint32Array(vertexCount + 1);
    this.nexts = new Uint32Array(corners.length);
    this.thirds = new Uint32Array(corners.length);
    for (const wedge of corners) this.starts[wedges[wedge] + 1]++;
    for (let vertex = 0; vertex < vertexCount; vertex++) this.starts[vertex + 1] += this.starts[vertex];
    const slots = this.starts.slice();
    for (let corner = 0; corner < corners.length; corner++) {
      const slot = slots[wedges[corners[corner]]]++;
      this.nexts[slot] = wedges[corners[corner + (corner % 3 < 2 ? 1 : -2)]];
      this.thirds[slot] = wedges[corners[corner + (corner % 3 ? -1 : 2)]];
    }
  }

  findCandidate(index, first, second, apex) {
    if (index < 2) return index ? second : first;
    const begin = this.starts[first], end = this.starts[first + 1];
    if (index >= RING) {
      check(begin + index - RING < end);
      return this.nexts[begin + index - RING];
    }
    if (first !== second) for (let slot = begin; slot < end; slot++) if (this.nexts[slot] === second) return this.thirds[slot];
    return apex;
  }
}

/** Fill in the triangles, wedges and parents of `mesh`, see mesh/connectivity.py. Returns the references of its added vertices and
 * wedges: a value is predicted to be that of the first one plus that of the second one, minus that of the third one. */
function decodeTriangles({ corners, wedges, nextWedges, firstWedges, parents }, level, coarser, streams) {
  const { symbols, parentSymbols } = streams, { length } = corners;
  const known = coarser?.parents.length ?? 0, knownWedges = coarser?.wedges.length ?? 0;
  const fans = coarser && new CoarseFans(coarser, known);
  const references = new Uint32Array(3 * (parents.length - known)), wedgeReferences = new Uint32Array(3 * (wedges.length - knownWedges));
  const latest = firstWedges.slice(); // the wedge of each vertex that was met last
  const met = new Uint32Array(parents.length), isMet = new Uint8Array(parents.length);
  let vertexCount = known, wedgeCount = knownWedges, metCount = 0, lastKnown = 0, lastVertex = 0, lastWedge = 0;
  // Edges of the border: wedges of their start and end and of the corner opposite to them, in the triangle inside; neighbors in their loop.
  const [starts, ends, apexes, previous, following, stack] = Array.from({ length: 6 }, () => new Uint32Array(length));
  const isListed = new Uint8Array(length), outgoing = new Int32Array(parents.length).fill(-1);
  let symbolCount = 0, cornerCount = 0, edgeCount = 0, stackSize = 0;

  const findFamily = (vertex) => (vertex < known ? vertex : parents[vertex]);
  const findCandidate = (index, a, b, c) => {
    check(fans);
    return fans.findCandidate(index, findFamily(a), findFamily(b), findFamily(c));
  };
  const readParent = (a, b, c) => {
    const symbol = parentSymbols[vertexCount - known];
    if (symbol !== EXPLICIT_PARENT) return findCandidate(symbol, a, b, c);
    const parent = findFamily(a) + streams.parents.readSigned();
    check(parent >= 0 && parent < known);
    return parent;
  };
  const addWedge = (vertex, a, b, c) => {
    check(wedgeCount < wedges.length);
    const row = 3 * (wedgeCount - knownWedges);
    wedgeReferences[row] = a;
    wedgeReferences[row + 1] = b;
    wedgeReferences[row + 2] = c;
    wedges[wedgeCount] = vertex;
    return wedgeCount++;
  };
  const readWedge = (predicted, a, b, c) => {
    const code = streams.codes.read();
    let wedge = predicted;
    if (code === ADDED_WEDGE) {
      wedge = addWedge(wedges[predicted], a, b, c);
      nextWedges[wedge] = nextWedges[predicted];
      nextWedges[predicted] = wedge;
    } else {
      for (let step = ADDED_WEDGE; step < code; step++) {
        wedge = nextWedges[wedge];
        check(wedge !== predicted);
      }
    }
    latest[wedges[wedge]] = lastWedge = wedge;
    return wedge;
  };
  const readVertex = () => {
    const value = streams.vertices.read();
    if (value === 0) return vertexCount;
    if (value % 2) {
      const rank = metCount - (value + 1) / 2;
      check(rank >= 0);
      return met[rank];
    }
    const vertex = lastKnown + decodeSigned(value / 2 - 1);
    check(vertex >= 0 && vertex < known);
    return vertex;
  };
  /** The wedge of a vertex that may be met for the first time. a, b, c: vertices, and d, e, f: wedges from which it is predicted. */
  const meet = (vertex, a, b, c, d, e, f) => {
    let wedge;
    if (vertex === vertexCount) {
      check(vertex < parents.length);
      parents[vertex] = known ? readParent(a, b, c) : -1;
      const row = 3 * (vertex - known);
      references[row] = a;
      references[row + 1] = b;
      references[row + 2] = c;
      wedge = addWedge(vertexCount++, d, e, f);
      nextWedges[wedge] = firstWedges[vertex] = latest[vertex] = lastWedge = wedge;
    } else {
      wedge = readWedge(latest[vertex], d, e, f);
    }
    lastVertex = vertex;
    if (!isMet[vertex]) {
      isMet[vertex] = 1;
      met[metCount++] = vertex;
      if (vertex < known) lastKnown = vertex;
    }
    return wedge;
  };
  const addEdge = (start, end, apex) => {
    starts[edgeCount] = start;
    ends[edgeCount] = end;
    apexes[edgeCount] = apex;
    isListed[edgeCount] = 1;
    stack[stackSize++] = edgeCount;
    return (outgoing[wedges[start]] = edgeCount++);
  };
  const link = (edge, next) => {
    following[edge] = next;
    previous[next] = edge;
  };
  const addTriangle = (a, b, c) => {
    corners[cornerCount++] = a;
    corners[cornerCount++] = b;
    corners[cornerCount++] = c;
  };
  const meetNext = () => meet(readVertex(), lastVertex, lastVertex, lastVertex, lastWedge, lastWedge, lastWedge);
  const start = () => {
    const a = meetNext(), b = meetNext(), c = meetNext();
    addTriangle(a, b, c);
    const first = addEdge(b, a, c), second = addEdge(a, c, b), third = addEdge(c, b, a);
    link(first, second);
    link(second, third);
    link(third, first);
  };
  const examine = (edge) => {
    if (!isListed[edge]) return;
    check(symbolCount < symbols.length);
    const symbol = symbols[symbolCount++];
    if (symbol === BOUNDARY) return;
    const apex = apexes[edge], before = previous[edge], after = following[edge];
    const a = readWedge(starts[edge], lastWedge, lastWedge, lastWedge), b = readWedge(ends[edge], lastWedge, lastWedge, lastWedge);
    const isSmooth = a === starts[edge] && b === ends[edge]; // otherwise the edge is a seam
    const d = isSmooth ? a : b, f = isSmooth ? apex : b;
    isListed[edge] = 0;
    let c;
    if (symbol === BOTH || symbol === RIGHT) {
      c = readWedge(ends[after], d, b, f);
      isListed[after] = 0;
      if (symbol === BOTH) {
        isListed[before] = 0;
        link(previous[before], following[after]);
      } else {
        const beyond = following[after], added = addEdge(a, c, b);
        link(before, added);
        link(added, beyond);
      }
    } else if (symbol === LEFT) {
      c = readWedge(starts[before], d, b, f);
      isListed[before] = 0;
      const added = addEdge(c, b, a);
      link(previous[before], added);
      link(added, after);
    } else {
      const [u, v, w] = [wedges[a], wedges[b], wedges[apex]];
      const vertex = symbol === NEW ? vertexCount : symbol === OTHER ? readVertex() : findCandidate(symbol - CANDIDATE, u, v, w);
      check(symbol === NEW || vertex < vertexCount);
      c = meet(vertex, u, v, w, d, b, f);
      const metEdge = symbol === OTHER ? outgoing[vertex] : -1;
      const left = addEdge(a, c, b), right = addEdge(c, b, a);
      if (metEdge >= 0 && isListed[metEdge]) {
        const joined = previous[metEdge];
        link(left, metEdge);
        link(joined, right);
      } else {
        link(left, right);
      }
      link(before, left);
      link(right, after);
    }
    addTriangle(a, b, c);
  };

  for (let material = 0, end = 0; material < level.triangle_counts.length; material++) {
    end += 3 * level.triangle_counts[material];
    while (cornerCount < end) {
      if (stackSize) examine(stack[--stackSize]);
      else start();
    }
    stackSize = 0;
  }
  check(symbolCount === symbols.length && [streams.vertices, streams.codes, streams.parents].every((reader) => reader.isAtEnd));
  check(vertexCount === parents.length && wedgeCount === wedges.length);
  return { vertices: references, wedges: wedgeReferences };
}

/** Weights of the neighbors of the vertices from `known` on, by which texture coordinates predict positions, see mesh/positions.py. */
function findWeights({ corners, wedges, firstWedges, shortUvs: uvs }, known, hasLater) {
  const count = firstWedges.length - known, starts = new Uint32Array(count + 1);
  const forEachNeighbor = (use) => {
    for (let corner = 0; corner < corners.length; corner++) {
      const wedge = corners[corner], vertex = wedges[wedge];
      if (vertex < known || firstWedges[vertex] !== wedge) continue;
      const next = corners[corner + (corner % 3 < 2 ? 1 : -2)], third = corners[corner + (corner % 3 ? -1 : 2)];
      if (hasLater || wedges[next] < vertex) use(vertex - known, next);
      if (hasLater || wedges[third] < vertex) use(vertex - known, third);
    }
  };
  forEachNeighbor((row) => starts[row + 1]++);
  for (let row = 0; row < count; row++) starts[row + 1] += starts[row];
  const neighbors = new Uint32Array(starts[count]), weights = new Float64Array(starts[count]), isValid = new Uint8Array(count);
  const slots = starts.slice();
  forEachNeighbor((row, other) => (neighbors[slots[row]++] = other));
  for (let row = 0; row < count; row++) {
    const begin = starts[row], end = starts[row + 1], n = end - begin;
    const ownU = uvs[2 * firstWedges[known + row]], ownV = uvs[2 * firstWedges[known + row] + 1];
    let sumU = 0, sumV = 0, sumUU = 0, sumUV = 0, sumVV = 0;
    for (let slot = begin; slot < end; slot++) {
      const u = uvs[2 * neighbors[slot]] - ownU, v = uvs[2 * neighbors[slot] + 1] - ownV;
      sumU += u;
      sumV += v;
      sumUU += u * u;
      sumUV += u * v;
      sumVV += v * v;
    }
    const uu = n * sumUU - sumU * sumU, uv = n * sumUV - sumU * sumV, vv = n * sumVV - sumV * sumV;
    const determinant = uu * vv - uv * uv, trace = uu + vv;
    isValid[row] = determinant > MIN_DETERMINANT * (trace * trace);
    const gradientU = isValid[row] ? (vv * sumU - uv * sumV) / determinant : 0;
    const gradientV = isValid[row] ? (uu * sumV - uv * sumU) / determinant : 0;
    for (let slot = begin; slot < end; slot++) {
      const u = uvs[2 * neighbors[slot]] - ownU, v = uvs[2 * neighbors[slot] + 1] - ownV;
      weights[slot] = (1 - gradientU * (n * u - sumU) - gradientV * (n * v - sumV)) / n;
      neighbors[slot] = wedges[neighbors[slot]];
    }
  }
  return { starts, neighbors, weights, isValid };
}

/** Set values (columns each) from row `first` on: predictions by `weights` of neighbors where these are valid, otherwise by `references`, plus
 * residuals, modulo 65536. */
function addPredictions(values, first, columns, references, residuals, weights) {
  const count = references.length / 3;
  for (let row = 0; row < count; row++) {
    const a = columns * references[3 * row], b = columns * references[3 * row + 1], c = columns * references[3 * row + 2];
    const target = columns * (first + row);
    for (let column = 0; column < columns; column++) {
      let value = 0;
      if (weights?.isValid[row]) {
        for (let slot = weights.starts[row]; slot < weights.starts[row + 1]; slot++) {
          value += weights.weights[slot] * values[columns * weights.neighbors[slot] + column];
        }
        value = Math.floor(value + 0.5);
      } else if (a !== target) {
        value = values[a + column] + values[b + column] - values[c + column];
      }
      values[target + column] = value + residuals[column * count + row];
    }
  }
}

/** Estimate the positions of the vertices from `known` on, see missing_positions.py. */
function estimatePositions(mesh, known) {
  const { starts, neighbors, weights } = findWeights(mesh, known, true), { parents, shortPositions } = mesh;
  let current = Float64Array.from(shortPositions);
  for (let vertex = known; vertex < parents.length; vertex++) {
    for (let axis = 0; axis < 3; axis++) current[3 * vertex + axis] = known ? current[3 * parents[vertex] + axis] : (STEPS + 1) / 2;
  }
  for (let pass = 0; pass < PASSES; pass++) {
    const next = current.slice();
    for (let row = 0; row < parents.length - known; row++) {
      for (let axis = 0; axis < 3; axis++) {
        let value = 0;
        for (let slot = starts[row]; slot < starts[row + 1]; slot++) value += weights[slot] * current[3 * neighbors[slot] + axis];
        next[3 * (known + row) + axis] = value;
      }
    }
    current = next;
  }
  for (let index = 3 * known; index < current.length; index++) {
    shortPositions[index] = Math.min(Math.max(Math.floor(current[index] + 0.5), 0), STEPS);
  }
}

/** Values of 16-bit ones, 0 to `count` within the bounds [lowest, highest]. */
function dequantize(values, [low, high], count) {
  const steps = low.map((value, column) => (high[column] - value) / count), result = new Float32Array(values.length);
  for (let index = 0, column = 0; index < values.length; index++, column = (column + 1) % low.length) {
    result[index] = low[column] + values[index] * steps[column];
  }
  return result;
}
