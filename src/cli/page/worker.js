// Answers the page's questions where there is no server: the queries as WebAssembly, and files beside this one by ranges.
"use strict";

const decoder = new TextDecoder();
const encoder = new TextEncoder();
let code;
let wasm;
let wrong = "";
let names = [];
let ready;

// Places in memory are numbers of 32 bits without a sign.
const bytesAt = (at, length) => new Uint8Array(wasm.memory.buffer, at >>> 0, length >>> 0);
const textAt = (at, length) => decoder.decode(bytesAt(at, length));

/** The program, which is compressed whether or not the server says so. */
async function load() {
  const response = await fetch(new URL("isospan.wasm.gz", location.href));
  if (!response.ok) throw new Error(`isospan.wasm.gz: the web server answers ${response.status} ${response.statusText}`);
  const bytes = new Uint8Array(await response.arrayBuffer());
  const packed = bytes[0] === 0x1f && bytes[1] === 0x8b;
  const plain = packed ? new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")) : bytes;
  return WebAssembly.compile(packed ? await new Response(plain).arrayBuffer() : plain);
}

/** Bytes of files that are kept because the server sends them whole, at most. */
const MOST_WHOLE = 256 << 20;
const whole = new Map();
let wholeBytes = 0;
/** Whether the server gives the last bytes of a file when asked for so many, and any range at all. */
let [knowsEnds, knowsRanges] = [true, true];

/** Asks the server for a file; waits, as a worker may. */
function request(method, name, range) {
  const it = new XMLHttpRequest();
  it.open(method, new URL(name.split("/").map(encodeURIComponent).join("/"), location.href), false);
  it.responseType = "arraybuffer";
  if (range) it.setRequestHeader("Range", range);
  it.send();
  if (it.status !== 200 && it.status !== 206 && !(range?.startsWith("bytes=-") && it.status === 416)) {
    throw Object.assign(new Error(`the web server answers ${it.status} ${it.statusText}`), { status: it.status });
  }
  return it;
}

/** Bytes of a file, where they begin in it, and its length; the last ones where `from` is negative. */
function range(name, from, to) {
  const part = (file) => {
    const [first, past] = from < 0 ? [Math.max(0, file.length + from), file.length] : [from, to];
    return { bytes: file.subarray(first, past), first, length: file.length };
  };
  if (whole.has(name)) return part(whole.get(name));
  if (from < 0 && !knowsEnds) {
    const length = Number(request("HEAD", name).getResponseHeader("Content-Length"));
    if (!knowsRanges && wholeBytes + length > MOST_WHOLE) {
      throw new Error("the web server sends whole files: for an archive of this size it must answer range requests");
    }
    [from, to] = [Math.max(0, length + from), length];
  }
  const it = request("GET", name, from < 0 ? `bytes=${from}` : `bytes=${from}-${to - 1}`);
  const bytes = new Uint8Array(it.response);
  if (it.status === 206) {
    const found = /^bytes (\d+)-\d+\/(\d+)$/.exec(it.getResponseHeader("Content-Range") ?? "");
    if (!found) throw new Error("the web server does not say which bytes it sends");
    return { bytes, first: Number(found[1]), length: Number(found[2]) };
  }
  if (from >= 0) knowsRanges = false;
  else knowsEnds = false;
  // Such a server takes the end of a file for a place that it does not have.
  if (it.status === 416) return range(name, from, to);
  whole.set(name, bytes);
  wholeBytes += bytes.length;
  return part(bytes);
}

/** Whether WebAssembly can wait for a promise. */
const canWait = typeof WebAssembly.Suspending === "function" && typeof WebAssembly.promising === "function";
/** Whether the page no longer wants the answer that is under way. */
let stopped = false;
const turn = new MessageChannel();

/** Lets messages in, then says whether one of them asked to stop. */
function pause() {
  return new Promise((done) => {
    turn.port1.onmessage = () => done(Number(stopped));
    turn.port2.postMessage(null);
  });
}

/** What WebAssembly asks of the page: see tools/viewer/core/src/host.rs. */
const page = {
  fetch(nameAt, nameLength, from, to, out, room, place) {
    const tell = (numbers) => new Float64Array(wasm.memory.buffer, place >>> 0, 3).set(numbers);
    try {
      const { bytes, first, length } = range(textAt(nameAt, nameLength), from, to);
      if (bytes.length > room >>> 0) throw new Error("the web server sends more than it was asked for");
      bytesAt(out, bytes.length).set(bytes);
      tell([length, first, first + bytes.length]);
      return bytes.length;
    } catch (error) {
      tell([error.status ?? 0, 0, 0]);
      return -encoder.encodeInto(error.message, bytesAt(out, room)).written;
    }
  },
  piece(at, length) {
    const { buffer } = bytesAt(at, length).slice();
    postMessage({ piece: buffer }, [buffer]);
  },
  // A promise: other messages come meanwhile. Where the browser cannot wait for it, an answer goes on to its end.
  stopped: canWait ? new WebAssembly.Suspending(pause) : () => 0,
  failed(at, length) {
    wrong = textAt(at, length);
  },
  now: () => performance.now(),
};

/** Calls a function that takes a text; returns its status, maybe later. */
function call(name, text) {
  [wrong, stopped] = ["", false];
  const bytes = encoder.encode(text);
  const at = wasm.room(bytes.length);
  bytesAt(at, bytes.length).set(bytes);
  return canWait ? WebAssembly.promising(wasm[name])() : wasm[name]();
}

async function start() {
  code ??= await load();
  wasm = (await WebAssembly.instantiate(code, { page })).exports;
  if ((await call("open", names.join("\n"))) !== 200) throw new Error(wrong);
}

onmessage = async ({ data }) => {
  if (data.stop) {
    stopped = true;
    return;
  }
  if (data.names) {
    names = data.names;
    ready = start();
    // It is told with the first answer.
    ready.catch(() => {});
    return;
  }
  try {
    await ready;
    const status = await call("answer", data.address);
    postMessage({ status, text: wrong });
  } catch (error) {
    const trap = error instanceof WebAssembly.RuntimeError || error instanceof RangeError;
    const text = trap ? wrong || `this takes more memory than a page has (${error.message})` : error.message;
    postMessage({ status: 500, text });
    // What was in memory may be wrong.
    ready = start();
    ready.catch(() => {});
  }
};
