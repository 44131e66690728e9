// Where answers come from: the server that sent this page, or a worker of the page, for archives beside it. Addresses
// are relative, so that the server's token stays in front.
import { connect } from "./local.js";

const beside = document.querySelector('meta[name="isospan-archives"]');
const ask = beside ? connect(beside.content.split("\n")) : fetch;

/** Whether there are surface files: only a server writes them. */
export const hasFiles = !beside;

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

/** The contour spectrum of a step. */
export const spectrum = (archive, step) => json(`${archive}/spectrum?${query({ step })}`);

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

  /** Fills `bytes`; calls `grown` with the number of bytes there whenever some came. */
  async fill(bytes, grown = () => {}) {
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
      grown(at);
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

/**
 * One isosurface: `vertices` (position and normal, six floats each), `values` of the field that `colour` names (null
 * without one), and `triangles` (three numbers each).
 * `part(surface, triangles)` is called while triangles arrive.
 */
export async function surface(archive, parameters, signal, part) {
  const response = await ask(`${archive}/surface?${query(parameters)}`, { signal });
  if (!response.ok) throw await refusal(response);
  const pieces = new Pieces(response);
  const { report, milliseconds } = await pieces.json();
  const found = {
    report,
    milliseconds,
    vertices: new Float32Array(6 * report.vertices),
    values: Number.isInteger(parameters.colour) ? new Float32Array(report.vertices) : null,
    triangles: new Uint32Array(3 * report.triangles),
  };
  await pieces.fill(new Uint8Array(found.vertices.buffer));
  if (found.values) await pieces.fill(new Uint8Array(found.values.buffer));
  await pieces.fill(new Uint8Array(found.triangles.buffer), (bytes) => part?.(found, Math.floor(bytes / 12)));
  return found;
}

/** Values of the field on a plane: NaN outside of the domain. */
export async function slice(archive, parameters, signal) {
  const response = await ask(`${archive}/slice?${query(parameters)}`, { signal });
  if (!response.ok) throw await refusal(response);
  const pieces = new Pieces(response);
  const { size } = await pieces.json();
  const values = new Float32Array(size[0] * size[1]);
  await pieces.fill(new Uint8Array(values.buffer));
  return { size, values };
}

/** Colour maps: name to 256 colours, three bytes each. */
export const colourMaps = () => json("colours");
