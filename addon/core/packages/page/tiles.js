// Tiles of textures: AVIF files that show a part of a texture, of which later ones replace earlier ones.

const MAX_DECODERS = 4; // at once
const PAUSE = 8, MAX_PAUSE = 50; // after a tile, relative to the time that it took to be shown, and in milliseconds
const FIELDS = [["textures", 1], ["tiles", 2], ["headers", 1], ["sizes", 4], ["firsts", 1], ["lasts", 1]]; // bytes, as in increments.py
const MIN_SIDE = 32; // as in tile_pyramid.py
export const ROW_BYTES = 10;

/** The table of increments from its byte planes: arrays of `count` numbers, and `ends`, their offsets in textures.bin. Throws if it refers to
 * what the manifest does not have. */
export function readIncrements(planes, manifest) {
  const count = manifest.increment_count, table = {};
  if (planes.length !== ROW_BYTES * count) throw new RangeError("size of the table");
  let offset = 0;
  for (const [name, width] of FIELDS) {
    const values = (table[name] = new Uint32Array(count));
    for (let plane = 0; plane < width; plane++, offset += count) {
      for (let i = 0; i < count; i++) values[i] += planes[offset + i] * 256 ** plane;
    }
  }
  const tileCounts = manifest.textures.map((texture) => listLevels(texture).reduce((sum, [rows, columns]) => sum + rows * columns, 0));
  const stateCount = manifest.errors.states.length;
  let state = -1; // each adds increments
  table.ends = new Array(count);
  let end = manifest.first_increment;
  for (let i = 0; i < count; i++) {
    const texture = table.textures[i];
    if (!(table.tiles[i] < tileCounts[texture]) || table.headers[i] >= manifest.textures[texture].headers.length) throw new RangeError("tile");
    if (table.firsts[i] - state > 1 || table.firsts[i] < state || !(table.firsts[i] <= table.lasts[i] && table.lasts[i] < stateCount)) throw new RangeError("state");
    state = table.firsts[i];
    table.ends[i] = end += table.sizes[i];
  }
  if (count && state !== stateCount - 1) throw new RangeError("state");
  if (end !== manifest.files["textures.bin"][0]) throw new RangeError("size of textures.bin");
  return table;
}

/** Rows and columns of tiles of the levels of a texture of the manifest, see TilePyramid in tile_pyramid.py. */
export function listLevels({ width, height, tile_size: side }) {
  const levels = [[Math.ceil(height / side), Math.ceil(width / side)]];
  while (Math.max(...levels.at(-1)) > 1) levels.push(levels.at(-1).map((count) => Math.ceil(count / 2)));
  for (let half = side / 2; half % 1 === 0 && half >= MIN_SIDE; half /= 2) levels.push([1, 1]);
  return levels;
}

/** Left and top border and side, in pixels of the texture, of a tile. */
export function locateTile(texture, number) {
  const levels = listLevels(texture);
  let level = 0;
  for (; number >= levels[level][0] * levels[level][1]; level++) number -= levels[level][0] * levels[level][1];
  const columns = levels[level][1];
  const side = texture.tile_size * 2 ** Math.min(level, levels.findIndex(([rows, columns]) => rows * columns === 1));
  return { left: (number % columns) * side, top: Math.floor(number / columns) * side, side };
}

/** The AVIF file of a header and a payload, see avif_files.py. */
export function joinFile(header, payload) {
  const sizes = new DataView(new ArrayBuffer(12));
  sizes.setUint32(0, payload.length);
  sizes.setUint32(4, payload.length + 8);
  sizes.setUint32(8, 0x6d646174); // mdat
  return new Blob([header, sizes, payload], { type: "image/avif" });
}

/** Decodes tiles in the background and passes (texture index, place of `locateTile`, ImageBitmap) to `show`, which closes the bitmap, in the
 * order of the increments, or of the latest ones where they come in another. */
export class TileDecoder {
  constructor(manifest, show) {
    this.textures = manifest.textures;
    this.headers = manifest.textures.map((texture) => texture.headers.map(bytesOfHex));
    this.shown = manifest.textures.map(() => []); // what `repeat` needs
    Object.assign(this, { show, waiting: [], running: 0, last: Promise.resolve(), failures: 0 });
  }

  /** Whether nothing waits to be decoded. */
  get isIdle() {
    return !this.waiting.length && !this.running;
  }

  /** Show increment `order`, a tile of a texture with these bytes. */
  add(order, texture, number, header, payload) {
    const tile = { order, texture, place: locateTile(this.textures[texture], number), header, payload };
    if (this.shown[texture].some((other) => other.order > order && contains(other.place, tile.place))) return;
    const isHidden = (other) => other.texture === texture && other.order < order && contains(tile.place, other.place);
    this.shown[texture] = this.shown[texture].filter((other) => !isHidden(other));
    this.waiting = this.waiting.filter((other) => !isHidden(other));
    this.shown[texture].push(tile);
    this.#enqueue([tile]);
    // What is over parts of it has to be shown again.
    this.#enqueue(this.shown[texture].filter((other) => other.order > order && contains(tile.place, other.place)));
  }

  /** Decode all tiles again, for a renderer that has lost its textures. */
  repeat() {
    for (const tiles of this.shown) this.#enqueue(tiles.toSorted((a, b) => a.order - b.order));
  }

  #enqueue(tiles) {
    this.waiting = this.waiting.filter((tile) => !tiles.includes(tile)).concat(tiles);
    while (this.waiting.length && this.running < MAX_DECODERS) this.#decode(this.waiting.shift());
  }

  async #decode(tile) {
    this.running++;
    const file = joinFile(this.headers[tile.texture][tile.header], tile.payload);
    const bitmap = createImageBitmap(file, { colorSpaceConversion: "none" });
    bitmap.catch(() => {}); // reported when its turn comes
    await (this.last = this.last.then(() => this.#showNext(tile, bitmap)));
    this.running--;
    this.#enqueue([]);
  }

  async #showNext(tile, promise) {
    try {
      const bitmap = await promise, start = performance.now();
      this.show(tile.texture, tile.place, bitmap);
      const pause = Math.min(PAUSE * (performance.now() - start), MAX_PAUSE); // for requests and input; meanwhile tiles come that replace waiting ones
      if (pause > 1) await new Promise((resolve) => setTimeout(resolve, pause));
    } catch (error) {
      if (!(error instanceof DOMException)) throw error;
      this.failures++; // a damaged tile: the rest is shown nevertheless
    }
  }
}

/** Whether the part of a texture that `inner` covers is in that of `outer`. */
function contains(outer, inner) {
  return ["left", "top"].every((border) => outer[border] <= inner[border] && inner[border] + inner.side <= outer[border] + outer.side);
}

function bytesOfHex(text) {
  return Uint8Array.from(text.match(/../g), (pair) => parseInt(pair, 16));
}
