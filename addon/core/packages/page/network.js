// Requests for byte ranges, and which bytes of the package's files are received.

import { insert } from "./byte_intervals.js";

const VERSION_LENGTH = 16; // digits of the SHA-256, as in files.py
const STEP_SECONDS = 0.02; // in which a simulated connection delivers bytes

/** The received part of a file: its bytes, and their intervals [start, end) in ascending order. */
export class PartialFile {
  constructor(name, [size, digest]) {
    Object.assign(this, { name, size, version: digest.slice(0, VERSION_LENGTH), bytes: null, intervals: [] });
  }

  /** Its URL in the folder `base`. Contents have URLs of their own, so that caches may keep them for ever. */
  locate(base) {
    return new URL(`${this.name}?${this.version}`, base);
  }

  /** Keep `part`, which begins at `offset`. */
  put(offset, part) {
    this.bytes ??= new Uint8Array(this.size); // once a server has confirmed the size
    this.bytes.set(part, offset);
    this.intervals = insert(this.intervals, offset, offset + part.length);
  }

  /** The end of the received bytes without a gap from `offset` on. */
  endFrom(offset) {
    const interval = this.intervals.find(([start, end]) => start <= offset && offset < end);
    return interval ? interval[1] : offset;
  }

  /** The bytes of a section [offset, size], or null if some are missing. */
  read([offset, size]) {
    if (!size) return new Uint8Array(0);
    return this.endFrom(offset) >= offset + size ? this.bytes.subarray(offset, offset + size) : null;
  }
}

/** A connection that delivers at most `rate` bytes per second; 0: as many as come. All requests share it. */
export class Connection {
  constructor(rate) {
    Object.assign(this, { rate, free: 0 });
  }

  /** Pass `bytes` on in parts as the connection delivers them. */
  async *deliver(bytes, signal) {
    const step = this.rate ? Math.max(Math.floor(this.rate * STEP_SECONDS), 1) : bytes.length;
    for (let offset = 0; offset < bytes.length; offset += step) {
      const part = bytes.subarray(offset, offset + step);
      if (this.rate) {
        const now = performance.now() / 1000;
        this.free = Math.max(this.free, now) + part.length / this.rate;
        await new Promise((resolve) => setTimeout(resolve, (this.free - now) * 1000));
        signal.throwIfAborted();
      }
      yield part;
    }
  }
}

/** Ask for bytes [start, end) of `file` at `url`. options: {signal, isOwn (whether the server is that of the page), priority}. Returns whether the server sends the whole file instead, because it does not know ranges,
 * and `parts`, an iterator of [offset, bytes]. Both throw if the response fails, is too short, or is of a file of another size. */
export async function openRange(url, file, start, end, connection, { signal, isOwn = false, priority = "auto" }) {
  // Browsers let requests for parts of one URL wait for each other where they may store them; `ByteStore` keeps the bytes instead. Caches on
  // the way may answer: the URL names the content. Other servers need not allow the header that says so.
  const headers = { Range: `bytes=${start}-${end - 1}`, ...(isOwn && { "Cache-Control": "max-age=31536000" }) };
  const response = await fetch(url, { headers, cache: "no-store", priority, signal }).catch((error) => {
    signal.throwIfAborted();
    throw new Error(`${url} cannot be loaded. Its server may forbid other pages, or compress what it must send in ranges. (${error.message})`);
  });
  const isWhole = response.status === 200;
  const range = /^bytes (\d+)-(\d+)\/(\d+)$/.exec(response.headers.get("Content-Range") ?? "");
  if (!isWhole && response.status !== 206) throw new Error(`The server answers ${response.status} for ${url}.`);
  const length = isWhole && !response.headers.has("Content-Encoding") ? response.headers.get("Content-Length") : null;
  const isOther = range ? +range[1] !== start || +range[3] !== file.size : length !== null && +length !== file.size;
  if (isOther) throw new DamageError(file.name);
  return { isWhole, parts: readParts(response.body.getReader(), file, isWhole ? [0, file.size] : [start, end], connection, signal) };
}

async function* readParts(reader, file, [offset, end], connection, signal) {
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      if (offset + value.length > end) throw new DamageError(file.name);
      for await (const part of connection.deliver(value, signal)) {
        yield [offset, part];
        offset += part.length;
      }
    }
  } finally {
    reader.cancel().catch(() => {});
  }
  if (offset < end) throw new Error(`The response for ${file.name} is too short.`);
}

/** A file is not the one that the manifest describes. */
export class DamageError extends Error {
  constructor(name) {
    super(`"${name}" is damaged or of another package. Export the package again, or copy it again.`);
  }
}

/** The sentence about an error: contents that make no sense are damage. */
export const explain = (error) => (error instanceof TypeError || error instanceof RangeError ? new DamageError("The package") : error).message;

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  for (let bit = 0; bit < 8; bit++) byte = byte & 1 ? (byte >>> 1) ^ 0xedb88320 : byte >>> 1;
  return byte;
});

/** CRC-32 as in zlib. */
export function crc32(bytes) {
  let value = -1;
  for (let i = 0; i < bytes.length; i++) value = CRC_TABLE[(value ^ bytes[i]) & 255] ^ (value >>> 8);
  return (value ^ -1) >>> 0;
}
