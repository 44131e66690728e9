// Where answers come from: the server that sent this page, or a worker of the page, for archives beside it. Addresses
// are relative, so that the server's token stays in front.
import { connect } from "./local.js";

const beside = document.querySelector('meta[name="isospan-archives"]');
const ask = beside ? connect(beside.content.split("\n")) : fetch;

/** Whether an answer that is no longer wanted stops: a worker must be able to wait for messages meanwhile. */
export const canStop = !beside || typeof WebAssembly.Suspending === "function";

/** What went wrong, in the server's words. */
async function refusal(response) {
  const text = (await response.text()).trim();
  return new Error(text || `${response.status} ${response.statusText}`);
}

async function json(address, signal) {
  const response = await ask(address, { signal });
  if (!response.ok) throw await refusal(response);
  return response.json();
}

function query(parameters) {
  const given = Object.entries(parameters).filter(([, v]) => v !== undefined && v !== null && v !== false);
  return new URLSearchParams(given.map(([k, v]) => [k, String(v)])).toString();
}

/** The archives, each with its steps, box, errors. */
export const archives = () => json("archives");

/** The contour spectrum of a step, and of one of its fields where it has several. */
export const spectrum = (archive, step, field) => json(`${archive}/spectrum?${query({ step, field })}`);

/** The least box of the world that holds the domain: two corners. */
export const bounds = (archive) => json(`${archive}/bounds`);

/** A surface file. */
export async function file(archive, parameters) {
  const response = await ask(`${archive}/export?${query(parameters)}`);
  if (!response.ok) throw await refusal(response);
  return response.blob();
}

/** Reads a stream piece by piece into buffers of known lengths. */
class Pieces {
  constructor(response) {
    this.reader = response.body.getReader();
    this.left = new Uint8Array(0);
  }

  /** Fills `bytes`. */
  async fill(bytes) {
    let at = 0;
    while (at < bytes.length) {
      if (this.left.length === 0) {
        const { done, value } = await this.reader.read();
        if (done) throw new Error("the answer ended early");
        this.left = value;
      }
      const count = Math.min(this.left.length, bytes.length - at);
      bytes.set(this.left.subarray(0, count), at);
      this.left = this.left.subarray(count);
      at += count;
    }
  }

  async json() {
    const length = new Uint8Array(4);
    await this.fill(length);
    const text = new Uint8Array(new DataView(length.buffer).getUint32(0, true));
    await this.fill(text);
    return JSON.parse(new TextDecoder().decode(text));
  }
}

/** Numbers that arrive part by part: the first `length` of `all`. */
class Growing {
  constructor(kind) {
    this.all = new kind(6 << 14);
    this.length = 0;
  }

  /** Room for so many more. */
  more(count) {
    const from = this.length;
    this.length += count;
    if (this.length > this.all.length) {
      const larger = new this.all.constructor(6 * Math.ceil(this.length / 4));
      larger.set(this.all.subarray(0, from));
      this.all = larger;
    }
    return this.all.subarray(from, this.length);
  }

  get used() {
    return this.all.subarray(0, this.length);
  }
}

const bytesOf = ({ buffer, byteOffset, byteLength }) => new Uint8Array(buffer, byteOffset, byteLength);

/**
 * One isosurface: `vertices` (position and normal, six floats each; positions count from `origin`, which is not 0 where
 * floats would not tell vertices apart), `triangles` (three numbers each), and `values` of
 * the field that `colour` names (null without one). `part(surface)` is called whenever some triangles have come: those
 * of the archive's chunks before `chunks`. `parts` has the number of triangles after each part; `changes` counts parts
 * that changed earlier vertices. While `preview` is true, what has come is not yet cut at the region, and is replaced as
 * a whole.
 */
export async function surface(archive, parameters, signal, part) {
  const response = await ask(`${archive}/surface?${query(parameters)}`, { signal });
  if (!response.ok) throw await refusal(response);
  const pieces = new Pieces(response);
  const found = { values: null, origin: [0, 0, 0], preview: false, changes: 0, report: null, milliseconds: 0 };
  const empty = () => ({ vertices: new Growing(Float32Array), triangles: new Growing(Uint32Array), parts: [], chunks: 0 });
  Object.assign(found, empty());
  while (!found.report) {
    const head = await pieces.json();
    if (head.error) throw new Error(head.error);
    if (head.report) {
      Object.assign(found, head, { chunks: Infinity });
    } else if (head.values !== undefined) {
      found.values = new Float64Array(head.values);
      await pieces.fill(bytesOf(found.values));
    } else {
      if (found.preview && !head.preview) Object.assign(found, empty());
      found.preview = head.preview;
      found.origin = head.origin;
      const { vertices, triangles } = found;
      await pieces.fill(bytesOf(vertices.more(6 * head.vertices)));
      const [numbers, changed] = [new Uint32Array(head.changed), new Float32Array(6 * head.changed)];
      await pieces.fill(bytesOf(numbers));
      await pieces.fill(bytesOf(changed));
      await pieces.fill(bytesOf(triangles.more(3 * head.triangles)));
      numbers.forEach((number, n) => vertices.all.set(changed.subarray(6 * n, 6 * n + 6), 6 * number));
      if (head.changed) found.changes += 1;
      found.chunks = head.chunks;
      found.parts.push({ chunks: head.chunks, triangles: triangles.length / 3 });
      part?.(found);
    }
  }
  return found;
}

/** Values of the field on a plane: NaN outside of the domain. */
export async function slice(archive, parameters, signal) {
  const response = await ask(`${archive}/slice?${query(parameters)}`, { signal });
  if (!response.ok) throw await refusal(response);
  const pieces = new Pieces(response);
  const { size } = await pieces.json();
  const values = new Float64Array(size[0] * size[1]);
  await pieces.fill(new Uint8Array(values.buffer));
  return { size, values };
}

/** Colour maps: name to 256 colours, three bytes each. */
export const colourMaps = () => json("colours");
