// Tiles of textures: progressive JPEG files of which more and more scans come.

const END_OF_IMAGE = new Uint8Array([0xff, 0xd9]);
const MAX_DECODERS = 4; // at once
const PAUSE = 8, MAX_PAUSE = 50; // of a decoder after a tile, relative to the time that the tile took to be shown, and in milliseconds
const FIELDS = [["textures", 1], ["tiles", 2], ["headers", 1], ["scans", 1], ["sizes", 4], ["gains", 2]]; // bytes, as in increments.py
export const ROW_BYTES = 11;

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
  table.ends = new Array(count);
  let end = manifest.first_increment;
  for (let i = 0; i < count; i++) {
    const texture = manifest.textures[table.textures[i]];
    if (table.tiles[i] >= countTiles(texture) || table.headers[i] >= texture.headers.length) throw new RangeError("tile");
    table.ends[i] = end += table.sizes[i];
  }
  if (end !== manifest.files["textures.bin"][0]) throw new RangeError("size of textures.bin");
  return table;
}

/** The number of tiles of a texture of the manifest. */
export function countTiles({ width, height, tile_size: side }) {
  return Math.ceil(width / side) * Math.ceil(height / side);
}

/** Decodes tiles in the background and passes (texture index, tile index, ImageBitmap) to `show`, which closes the bitmap. sideOf(texture index):
 * the side in pixels that bitmaps are to have, 0 for that of the tile. */
export class TileDecoder {
  constructor(manifest, show, sideOf) {
    this.headers = manifest.textures.map((texture) => texture.headers.map(bytesOfHex));
    this.tiles = manifest.textures.map(() => new Map());
    Object.assign(this, { show, sideOf, waiting: [], decoding: 0, failures: 0 });
  }

  /** Whether nothing waits to be decoded. */
  get isIdle() {
    return !this.waiting.length && !this.decoding;
  }

  /** Add `scans` (bytes) to a tile. */
  add(texture, index, header, scans) {
    let tile = this.tiles[texture].get(index);
    if (!tile) this.tiles[texture].set(index, (tile = { texture, index, parts: [this.headers[texture][header]], isWaiting: false }));
    tile.parts.push(scans);
    this.#enqueue(tile);
  }

  /** Decode all tiles again, for a renderer that has lost its textures. */
  repeat() {
    for (const tiles of this.tiles) tiles.forEach((tile) => this.#enqueue(tile));
  }

  #enqueue(tile) {
    if (!tile.isWaiting) this.waiting.push(tile);
    tile.isWaiting = true;
    if (this.decoding < MAX_DECODERS) this.#decodeWaiting();
  }

  async #decodeWaiting() {
    this.decoding++;
    while (this.waiting.length) {
      const position = this.waiting.findIndex((tile) => !tile.isDecoding);
      if (position < 0) break;
      const [tile] = this.waiting.splice(position, 1);
      tile.isWaiting = false;
      tile.isDecoding = true; // one after the other, or an older state could come last
      try {
        const file = new Blob([...tile.parts, END_OF_IMAGE], { type: "image/jpeg" });
        const side = this.sideOf(tile.texture), size = side ? { resizeWidth: side, resizeHeight: side, resizeQuality: "high" } : {};
        const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", ...size }), start = performance.now();
        this.show(tile.texture, tile.index, bitmap);
        const pause = Math.min(PAUSE * (performance.now() - start), MAX_PAUSE); // for requests and input; meanwhile more scans of waiting tiles come
        if (pause > 1) await new Promise((resolve) => setTimeout(resolve, pause));
      } catch (error) {
        if (!(error instanceof DOMException)) throw error;
        this.failures++; // a damaged tile: the rest is shown nevertheless
      } finally {
        tile.isDecoding = false;
      }
    }
    this.decoding--;
  }
}

function bytesOfHex(text) {
  return Uint8Array.from(text.match(/../g), (pair) => parseInt(pair, 16));
}
