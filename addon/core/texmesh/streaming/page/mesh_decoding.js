// Levels of meshes from the sections of mesh.bin. ../mesh_coding.py describes the sections, and decodes them in the same way.

const NEW = 0, RIGHT = 1, LEFT = 2, BOTH = 3, BOUNDARY = 4, OTHER = 5, CANDIDATE = 6; // symbols of edges of the border
const TOLD_PARENT = 255;
const ADDED_WEDGE = 1;
const RING = 3;
const MAX_RATIO = 1032; // of DEFLATE
const MAX_LEB128_BYTES = 5;
const MIN_DETERMINANT = 1e-3;
const ESTIMATION_PASSES = 5;
const SECTIONS = ["corners", "wedges", "parents", "positions", "uvs"];

function check(condition) {
  if (!condition) throw new Error("The mesh of the package is damaged; export the package again, or copy it again.");
}

// Returns what the raw DEFLATE stream `bytes` contains, at most `maxSize` bytes.
export async function inflate(bytes, maxSize) {
  const reader = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw")).getReader();
  const parts = [];
  let size = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    size += value.length;
    if (size > maxSize) {
      reader.cancel();
      check(false);
    }
    parts.push(value);
  }
  const result = new Uint8Array(size);
  let offset = 0;
  for (const part of parts) {
    result.set(part, offset);
    offset += part.length;
  }
  return result;
}

class IntegerReader {
  constructor(bytes, offset) {
    this.bytes = bytes;
    this.offset = offset;
  }

  read() {
    let value = this.bytes[this.offset++];
    if (value < 128) return value;
    value &= 127;
    for (let scale = 128; ; scale *= 128) {
      check(this.offset < this.bytes.length && scale < 2 ** 35);
      const byte = this.bytes[this.offset++];
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
  }

  get isAtEnd() {
    return this.offset === this.bytes.length;
  }
}

const decodeSigned = (value) => (value % 2 ? -(value + 1) / 2 : value / 2);

// The triangles around the vertices of a level, see ../coarse_fans.py.
class CoarseFans {
  constructor(triangles, wedgeVertices, vertexCount) {
    this.starts = new Int32Array(vertexCount + 1);
    this.nexts = new Int32Array(triangles.length);
    this.thirds = new Int32Array(triangles.length);
    for (const wedge of triangles) this.starts[wedgeVertices[wedge] + 1]++;
    for (let vertex = 0; vertex < vertexCount; vertex++) this.starts[vertex + 1] += this.starts[vertex];
    const ends = this.starts.slice();
    for (let corner = 0; corner < triangles.length; corner++) {
      const first = corner - (corner % 3);
      const slot = ends[wedgeVertices[triangles[corner]]]++;
      this.nexts[slot] = wedgeVertices[triangles[first + ((corner + 1) % 3)]];
      this.thirds[slot] = wedgeVertices[triangles[first + ((corner + 2) % 3)]];
    }
  }

  findCandidate(index, first, second, apex) {
    if (index === 0) return first;
    if (index === 1) return second;
    const end = this.starts[first + 1];
    if (index === 2) {
      if (first !== second) {
        for (let slot = this.starts[first]; slot < end; slot++) if (this.nexts[slot] === second) return this.thirds[slot];
      }
      return apex;
    }
    const slot = this.starts[first] + index - RING;
    check(slot < end);
    return this.nexts[slot];
  }
}

// Decodes the levels of `manifest`, coarsest first.
export class MeshDecoder {
  constructor(manifest) {
    this.manifest = manifest;
    this.levels = []; // of each decoded level: what its positions follow from
    this.vertexCount = this.wedgeCount = 0;
    this.triangles = new Int32Array(0);
    for (const name of ["wedgeVertices", "nextWedges", "parents", "firstWedges"]) this[name] = new Int32Array(0);
    this.positions = new Uint16Array(0);
    this.uvs = new Uint16Array(0);
  }

  // Decodes the next level. sections: Uint8Arrays by name. If `positions` has not come, it is null, and positions are estimated.
  async add(sections) {
    const level = this.manifest.levels[this.levels.length];
    const triangleCount = level.triangle_counts.reduce((sum, count) => sum + count, 0);
    const added = level.vertex_count - this.vertexCount;
    const addedWedges = level.wedge_count - this.wedgeCount;
    check(triangleCount <= MAX_RATIO * sections.corners.length && 4 * addedWedges <= MAX_RATIO * sections.uvs.length);
    const limits = [4 + 3 * triangleCount * (1 + MAX_LEB128_BYTES), 3 * triangleCount * MAX_LEB128_BYTES, added * (1 + MAX_LEB128_BYTES)];
    const names = SECTIONS.slice(0, 3);
    const [corners, codes, parents, uvResiduals] = await Promise.all([
      ...names.map((name, index) => inflate(sections[name], limits[index])),
      inflate(sections.uvs, 4 * addedWedges),
    ]);
    check(corners.length >= 4 && uvResiduals.length === 4 * addedWedges);
    const symbolCount = new DataView(corners.buffer).getUint32(0, true);
    const parentCount = parents.length ? added : 0;
    check(4 + symbolCount <= corners.length && parentCount <= parents.length);
    const known = { vertices: this.vertexCount, wedges: this.wedgeCount };
    this._grow(level.vertex_count, level.wedge_count);
    const streams = {
      symbols: corners.subarray(4, 4 + symbolCount),
      vertices: new IntegerReader(corners, 4 + symbolCount),
      codes: new IntegerReader(codes, 0),
      parentSymbols: parents.subarray(0, parentCount),
      parents: new IntegerReader(parents, parentCount),
    };
    const references = this._decodeTriangles(level, triangleCount, streams);
    addPredictions(this.uvs, known.wedges, 2, references.wedges, uvResiduals);
    this.levels.push({ known: known.vertices, count: level.vertex_count, triangles: this.triangles, references: references.vertices, residuals: null });
    if (sections.positions) await this.setPositions(this.levels.length - 1, sections.positions);
  }

  // Decodes the section `positions` of a level that has been added.
  async setPositions(index, bytes) {
    const { known, count } = this.levels[index];
    const size = 1 + 6 * (count - known);
    const residuals = await inflate(bytes, size);
    check(residuals.length === size);
    this.levels[index].residuals = residuals;
  }

  // Returns typed arrays of the last level that was added: positions, normals and uvs of its wedges, indices of its triangles, and the
  // number of the first index and of the indices of each material.
  build() {
    this._reconstructPositions();
    const { bounds, uv_bounds: uvBounds, levels } = this.manifest;
    const vertices = dequantize(this.positions, bounds);
    const normals = computeNormals(vertices, this.triangles, this.wedgeVertices);
    let first = 0;
    const groups = levels[this.levels.length - 1].triangle_counts.map((count, material) => {
      const group = { material, first, count: 3 * count };
      first += 3 * count;
      return group;
    });
    return {
      positions: gather(vertices, this.wedgeVertices),
      normals: gather(normals, this.wedgeVertices),
      uvs: dequantize(this.uvs, uvBounds),
      indices: new Uint32Array(this.triangles),
      groups,
    };
  }

  _grow(vertexCount, wedgeCount) {
    const grow = (values, size) => {
      const result = new values.constructor(size);
      result.set(values);
      return result;
    };
    for (const name of ["wedgeVertices", "nextWedges"]) this[name] = grow(this[name], wedgeCount);
    for (const name of ["parents", "firstWedges"]) this[name] = grow(this[name], vertexCount);
    this.positions = grow(this.positions, 3 * vertexCount);
    this.uvs = grow(this.uvs, 2 * wedgeCount);
  }

  _decodeTriangles(level, triangleCount, streams) {
    const { wedgeVertices, nextWedges, parents, firstWedges } = this;
    const { symbols } = streams;
    const knownCount = this.vertexCount;
    const knownWedges = this.wedgeCount;
    const fans = new CoarseFans(this.triangles, wedgeVertices, knownCount);
    const vertexReferences = new Int32Array(3 * (level.vertex_count - knownCount));
    const wedgeReferences = new Int32Array(3 * (level.wedge_count - knownWedges));
    const triangles = new Int32Array(3 * triangleCount);
    const latest = firstWedges.slice();
    const met = new Int32Array(level.vertex_count);
    const isMet = new Uint8Array(level.vertex_count);
    const outgoing = new Int32Array(level.vertex_count).fill(-1);
    const [starts, ends, apexes, previous, following, stack] = Array.from({ length: 6 }, () => new Int32Array(3 * triangleCount));
    const isListed = new Uint8Array(3 * triangleCount);
    let vertexCount = knownCount, wedgeCount = knownWedges, metCount = 0;
    let lastKnown = 0, lastVertex = 0, lastWedge = 0;
    let symbolCount = 0, cornerCount = 0, edgeCount = 0, stackSize = 0;

    const findFamily = (vertex) => (vertex < knownCount ? vertex : parents[vertex]);
    const findCandidate = (index, a, b, c) => {
      check(knownCount > 0);
      return fans.findCandidate(index, findFamily(a), findFamily(b), findFamily(c));
    };
    const addWedge = (vertex, a, b, c) => {
      check(wedgeCount < level.wedge_count);
      wedgeReferences.set([a, b, c], 3 * (wedgeCount - knownWedges));
      wedgeVertices[wedgeCount] = vertex;
      return wedgeCount++;
    };
    const readParent = (a, b, c) => {
      const symbol = streams.parentSymbols[vertexCount - knownCount];
      if (symbol !== TOLD_PARENT) return findCandidate(symbol, a, b, c);
      const parent = findFamily(a) + decodeSigned(streams.parents.read());
      check(parent >= 0 && parent < knownCount);
      return parent;
    };
    // Adds a vertex predicted from the vertices a, b, c, with a wedge predicted from the wedges d, e, f.
    const addVertex = (a, b, c, d, e, f) => {
      check(vertexCount < level.vertex_count);
      parents[vertexCount] = knownCount ? readParent(a, b, c) : -1;
      vertexReferences.set([a, b, c], 3 * (vertexCount - knownCount));
      const wedge = addWedge(vertexCount, d, e, f);
      nextWedges[wedge] = firstWedges[vertexCount] = latest[vertexCount] = lastWedge = wedge;
      vertexCount++;
      return wedge;
    };
    const readWedge = (predicted, a, b, c) => {
      const code = streams.codes.read();
      let wedge = predicted;
      if (code === ADDED_WEDGE) {
        wedge = addWedge(wedgeVertices[predicted], a, b, c);
        nextWedges[wedge] = nextWedges[predicted];
        nextWedges[predicted] = wedge;
      } else if (code) {
        check(code > 0); // not NaN, behind the end
        for (let step = ADDED_WEDGE; step < code; step++) {
          wedge = nextWedges[wedge];
          check(wedge !== predicted);
        }
      }
      latest[wedgeVertices[wedge]] = lastWedge = wedge;
      return wedge;
    };
    const readVertex = () => {
      const value = streams.vertices.read();
      if (value === 0) return vertexCount;
      if (value % 2) {
        const rank = metCount - 1 - (value - 1) / 2;
        check(rank >= 0);
        return met[rank];
      }
      const vertex = lastKnown + decodeSigned(value / 2 - 1);
      check(vertex >= 0 && vertex < knownCount);
      return vertex;
    };
    const markMet = (vertex) => {
      lastVertex = vertex;
      if (isMet[vertex]) return;
      isMet[vertex] = 1;
      met[metCount++] = vertex;
      if (vertex < knownCount) lastKnown = vertex;
    };
    const addEdge = (start, end, apex) => {
      const edge = edgeCount++;
      starts[edge] = start;
      ends[edge] = end;
      apexes[edge] = apex;
      isListed[edge] = 1;
      outgoing[wedgeVertices[start]] = edge;
      stack[stackSize++] = edge;
      return edge;
    };
    const link = (edge, next) => {
      following[edge] = next;
      previous[next] = edge;
    };
    const addTriangle = (a, b, c) => {
      triangles[cornerCount++] = a;
      triangles[cornerCount++] = b;
      triangles[cornerCount++] = c;
    };
    const start = () => {
      const [a, b, c] = [0, 1, 2].map(() => {
        const vertex = readVertex();
        const isNew = vertex === vertexCount;
        const [v, w] = [lastVertex, lastWedge];
        const wedge = isNew ? addVertex(v, v, v, w, w, w) : readWedge(latest[vertex], w, w, w);
        markMet(vertex);
        return wedge;
      });
      addTriangle(a, b, c);
      const first = addEdge(b, a, c), second = addEdge(a, c, b), third = addEdge(c, b, a);
      link(first, second);
      link(second, third);
      link(third, first);
    };
    // Returns the third wedge of a triangle whose vertex the border does not tell.
    const attach = (symbol, a, b, apex, isSmooth) => {
      const [d, e, f] = isSmooth ? [a, b, apex] : [b, b, b];
      const [u, v, w] = [wedgeVertices[a], wedgeVertices[b], wedgeVertices[apex]];
      let vertex = vertexCount, wedge;
      if (symbol === NEW) {
        wedge = addVertex(u, v, w, d, e, f);
      } else {
        vertex = symbol === OTHER ? readVertex() : findCandidate(symbol - CANDIDATE, u, v, w);
        check(vertex < vertexCount);
        wedge = readWedge(latest[vertex], d, e, f);
      }
      markMet(vertex);
      return wedge;
    };
    const examine = (edge) => {
      if (!isListed[edge]) return;
      check(symbolCount < symbols.length);
      const symbol = symbols[symbolCount++];
      if (symbol === BOUNDARY) return;
      const apex = apexes[edge], before = previous[edge], after = following[edge];
      const a = readWedge(starts[edge], lastWedge, lastWedge, lastWedge);
      const b = readWedge(ends[edge], lastWedge, lastWedge, lastWedge);
      const isSmooth = a === starts[edge] && b === ends[edge];
      isListed[edge] = 0;
      if (symbol === RIGHT || symbol === LEFT || symbol === BOTH) {
        const [d, e, f] = isSmooth ? [a, b, apex] : [lastWedge, lastWedge, lastWedge];
        const c = readWedge(symbol === LEFT ? starts[before] : ends[after], d, e, f);
        if (symbol === BOTH) {
          isListed[after] = isListed[before] = 0;
          link(previous[before], following[after]);
        } else if (symbol === RIGHT) {
          isListed[after] = 0;
          const added = addEdge(a, c, b), beyond = following[after];
          link(before, added);
          link(added, beyond);
        } else {
          isListed[before] = 0;
          const added = addEdge(c, b, a);
          link(previous[before], added);
          link(added, after);
        }
        addTriangle(a, b, c);
        return;
      }
      const c = attach(symbol, a, b, apex, isSmooth);
      const metEdge = symbol === OTHER ? outgoing[wedgeVertices[c]] : -1;
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
      addTriangle(a, b, c);
    };

    let end = 0;
    for (const count of level.triangle_counts) {
      end += 3 * count;
      while (cornerCount < end) {
        if (stackSize) examine(stack[--stackSize]);
        else start();
      }
      stackSize = 0;
    }
    check(streams.vertices.isAtEnd && streams.codes.isAtEnd && streams.parents.isAtEnd && symbolCount === symbols.length);
    check(vertexCount === level.vertex_count && wedgeCount === level.wedge_count);
    this.vertexCount = vertexCount;
    this.wedgeCount = wedgeCount;
    this.triangles = triangles;
    return { vertices: vertexReferences, wedges: wedgeReferences };
  }

  // Positions of all levels, from the first one whose positions have come since the last time.
  _reconstructPositions() {
    let isExact = true;
    for (const level of this.levels) {
      if (level.residuals) {
        const kind = level.residuals[0], residuals = level.residuals.subarray(1);
        const affine = kind ? this._findWeights(level, false) : null;
        addPredictions(this.positions, level.known, 3, level.references, residuals, affine, isExact);
      } else {
        isExact = false;
        this._estimate(level);
      }
    }
  }

  // Weights of neighbors by which texture coordinates predict positions, see ../position_prediction.py.
  _findWeights({ triangles, known, count }, hasLater) {
    const { wedgeVertices, firstWedges, uvs } = this;
    const starts = new Int32Array(count - known + 1);
    const forEachNeighbor = (use) => {
      for (let corner = 0; corner < triangles.length; corner++) {
        const wedge = triangles[corner], vertex = wedgeVertices[wedge];
        if (vertex < known || firstWedges[vertex] !== wedge) continue;
        const first = corner - (corner % 3);
        for (let offset = 1; offset < 3; offset++) {
          const other = triangles[first + ((corner + offset) % 3)];
          if (hasLater || wedgeVertices[other] < vertex) use(vertex - known, other);
        }
      }
    };
    forEachNeighbor((row) => starts[row + 1]++);
    for (let row = 0; row < count - known; row++) starts[row + 1] += starts[row];
    const wedges = new Int32Array(starts[count - known]), weights = new Float64Array(wedges.length);
    const isValid = new Uint8Array(count - known);
    const slots = starts.slice();
    forEachNeighbor((row, other) => (wedges[slots[row]++] = other));
    for (let row = 0; row < count - known; row++) {
      const wedge = firstWedges[known + row], n = starts[row + 1] - starts[row];
      let sumU = 0, sumV = 0, sumUU = 0, sumUV = 0, sumVV = 0;
      for (let slot = starts[row]; slot < starts[row + 1]; slot++) {
        const u = uvs[2 * wedges[slot]] - uvs[2 * wedge], v = uvs[2 * wedges[slot] + 1] - uvs[2 * wedge + 1];
        sumU += u;
        sumV += v;
        sumUU += u * u;
        sumUV += u * v;
        sumVV += v * v;
      }
      const uu = n * sumUU - sumU * sumU, uv = n * sumUV - sumU * sumV, vv = n * sumVV - sumV * sumV;
      const determinant = uu * vv - uv * uv, trace = uu + vv;
      isValid[row] = determinant > MIN_DETERMINANT * (trace * trace) ? 1 : 0;
      const slopeU = isValid[row] ? (vv * sumU - uv * sumV) / determinant : 0;
      const slopeV = isValid[row] ? (uu * sumV - uv * sumU) / determinant : 0;
      for (let slot = starts[row]; slot < starts[row + 1]; slot++) {
        const u = uvs[2 * wedges[slot]] - uvs[2 * wedge], v = uvs[2 * wedges[slot] + 1] - uvs[2 * wedge + 1];
        weights[slot] = (1 - slopeU * (n * u - sumU) - slopeV * (n * v - sumV)) / n;
        wedges[slot] = wedgeVertices[wedges[slot]];
      }
    }
    return { starts, neighbors: wedges, weights, isValid };
  }

  // Estimates positions that have not come from those of neighbors and from texture coordinates, see ../missing_positions.py.
  _estimate(level) {
    const { starts, neighbors, weights } = this._findWeights(level, true);
    const { known, count } = level;
    let current = Float64Array.from(this.positions.subarray(0, 3 * count));
    for (let vertex = known; vertex < count; vertex++) {
      for (let axis = 0; axis < 3; axis++) current[3 * vertex + axis] = vertex && known ? current[3 * this.parents[vertex] + axis] : 32768;
    }
    for (let pass = 0; pass < ESTIMATION_PASSES; pass++) {
      const next = current.slice();
      for (let row = 0; row < count - known; row++) {
        for (let axis = 0; axis < 3; axis++) {
          let total = 0;
          for (let slot = starts[row]; slot < starts[row + 1]; slot++) total += weights[slot] * current[3 * neighbors[slot] + axis];
          next[3 * (known + row) + axis] = total;
        }
      }
      current = next;
    }
    for (let index = 3 * known; index < 3 * count; index++) this.positions[index] = clamp(Math.floor(current[index] + 0.5));
  }
}

const clamp = (value) => Math.min(Math.max(value, 0), 65535);

// Sets values (N, columns) from row `first` on: first + second - third of the references, or a weighted mean of neighbors where that is
// valid, plus residuals in byte planes. Values are modulo 65536 if those of coarser levels are exact, otherwise they are clamped.
function addPredictions(values, first, columns, references, residuals, affine = null, isExact = true) {
  const count = references.length / 3;
  for (let row = 0; row < count; row++) {
    const a = references[3 * row], b = references[3 * row + 1], c = references[3 * row + 2];
    for (let column = 0; column < columns; column++) {
      let value = 0;
      if (affine && affine.isValid[row]) {
        for (let slot = affine.starts[row]; slot < affine.starts[row + 1]; slot++) {
          value += affine.weights[slot] * values[affine.neighbors[slot] * columns + column];
        }
        value = Math.floor(value + 0.5);
      } else if (a !== first + row) {
        value = values[a * columns + column] + values[b * columns + column] - values[c * columns + column];
      }
      const zigzag = residuals[2 * column * count + row] | (residuals[(2 * column + 1) * count + row] << 8);
      value += (zigzag >> 1) ^ -(zigzag & 1);
      values[(first + row) * columns + column] = isExact ? value % 65536 : clamp(value);
    }
  }
}

// Returns Float32 values of 16-bit ones within bounds [lowest, highest].
function dequantize(values, [low, high]) {
  const steps = low.map((value, column) => (high[column] - value) / 65535);
  const result = new Float32Array(values.length);
  for (let index = 0; index < values.length; ) {
    for (let column = 0; column < low.length; column++, index++) result[index] = low[column] + values[index] * steps[column];
  }
  return result;
}

// Returns unit normals of vertices: sums of those of their triangles, weighted by area.
function computeNormals(vertices, triangles, wedgeVertices) {
  const sums = new Float64Array(vertices.length);
  for (let corner = 0; corner < triangles.length; corner += 3) {
    const a = 3 * wedgeVertices[triangles[corner]], b = 3 * wedgeVertices[triangles[corner + 1]], c = 3 * wedgeVertices[triangles[corner + 2]];
    const ux = vertices[b] - vertices[a], uy = vertices[b + 1] - vertices[a + 1], uz = vertices[b + 2] - vertices[a + 2];
    const vx = vertices[c] - vertices[a], vy = vertices[c + 1] - vertices[a + 1], vz = vertices[c + 2] - vertices[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const vertex of [a, b, c]) {
      sums[vertex] += x;
      sums[vertex + 1] += y;
      sums[vertex + 2] += z;
    }
  }
  const normals = new Float32Array(vertices.length);
  for (let index = 0; index < sums.length; index += 3) {
    const x = sums[index], y = sums[index + 1], z = sums[index + 2];
    const length = Math.sqrt(x * x + y * y + z * z) || 1;
    normals[index] = x / length;
    normals[index + 1] = y / length;
    normals[index + 2] = z / length;
  }
  return normals;
}

// Returns the values (3 each) of the vertices of wedges.
function gather(values, wedgeVertices) {
  const result = new Float32Array(3 * wedgeVertices.length);
  for (let wedge = 0; wedge < wedgeVertices.length; wedge++) {
    const vertex = 3 * wedgeVertices[wedge];
    result[3 * wedge] = values[vertex];
    result[3 * wedge + 1] = values[vertex + 1];
    result[3 * wedge + 2] = values[vertex + 2];
  }
  return result;
}
