// Bytes that the browser keeps, so that another visit does not ask for them again: parts of files under URLs that name file, content and place.

import { subtract } from "./byte_intervals.js";

const NAME = "farfield-packages";

export class ByteStore {
  constructor(cache, base) {
    Object.assign(this, { cache, base, kept: {} });
  }

  /** What the browser keeps of the package in the folder `base`, or null if it keeps nothing, as for pages without encryption. */
  static async open(base) {
    const cache = await globalThis.caches?.open(NAME).catch(() => null);
    return cache ? new ByteStore(cache, base) : null;
  }

  /** Put what is kept of `file`, a PartialFile, into it, and forget what is of another one of this name. */
  async read(file) {
    for (const request of await this.cache.keys(new URL(file.name, this.base), { ignoreSearch: true })) {
      const [, version, start, end] = /\?(\w+)-(\d+)-(\d+)$/.exec(request.url) ?? [];
      const response = version === file.version && +end <= file.size ? await this.cache.match(request) : null;
      const bytes = response && new Uint8Array(await response.arrayBuffer());
      if (bytes?.length === end - start) file.put(+start, bytes);
      else await this.cache.delete(request);
    }
    this.kept[file.name] = file.intervals;
  }

  /** Keep what `file` has received since. */
  async write(file) {
    const added = subtract(file.intervals, this.kept[file.name]);
    this.kept[file.name] = file.intervals;
    for (const [start, end] of added) {
      await this.cache.put(`${file.locate(this.base)}-${start}-${end}`, new Response(file.bytes.slice(start, end)));
    }
  }
}
