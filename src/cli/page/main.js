// The page: what is shown is a state; the state is in the address, so that a link gives the same view.
import * as source from "./source.js";
import { Spectrum } from "./spectrum.js";
import { View } from "./scene.js";

const $ = (id) => document.getElementById(id);
const COLOURS = ["#d8cbb4", "#4c8fb8", "#c8643c", "#6a9a4c", "#8d6bb0", "#c9a13b", "#4aa69c", "#a85577"];
/** A level with at most so many cells is shown before a finer one. */
const FEW_CELLS = 1 << 18;
/** Samples along the longer side of a slice: while the plane moves, and when it rests. */
const COARSE = 160;
const FINE = 512;

const state = {
  archive: 0,
  field: null,
  step: undefined,
  surfaces: [],
  active: 0,
  level: 0,
  cap: false,
  clip: null,
  place: 0.5,
  flip: false,
  slice: true,
  by: null,
  map: "viridis",
  range: null,
  region: null,
  box: true,
  axes: true,
  theme: "",
};
let archives = [];
let maps = {};
let view;
let spectrum;
let nextName = 0;
/** Whether the address says where the camera is. */
let isPlaced = false;

const archive = () => archives[state.archive];
/** The names of the fields, where each step has several. */
function names() {
  const all = archive().steps;
  const isOne = new Set(all.map((s) => s.number)).size === all.length;
  return isOne ? [] : [...new Set(all.map((s) => s.field))];
}
/** The steps; those of the field that is chosen, where each step has several. */
const steps = () => (names().length ? archive().steps.filter((s) => s.field === state.field) : archive().steps);
const stepInfo = () => steps().find((s) => s.number === state.step) ?? steps()[0];
/** The step whose field colours show: that of the surfaces, or another field of the archive. */
function colourInfo() {
  const isIt = names().length ? (s) => s.number === state.step && s.field === state.by : (s) => s.number === state.by;
  return archive().steps.find(isIt) ?? stepInfo();
}
/** The steps that are fields of their own, where surfaces can have their colours. */
function fields() {
  const isField = new Set(steps().map((s) => s.field)).size === steps().length && steps().length > 1;
  return isField ? steps() : [];
}

/** The fields that can colour the surfaces: their names, and what `by` is of each. */
function colourChoices() {
  const several = names().map((name) => ({ name, value: name }));
  return several.length ? several : fields().map((s) => ({ name: s.field, value: s.number }));
}

/** The levels of a pyramid, the finest first; none of another archive. */
const levels = () => archive().pyramid ?? [];

/** The level that is shown until the chosen one is there: a coarser one, where that has many cells. */
function levelBefore() {
  const few = levels().find(({ level, cells }) => level >= state.level && cells <= FEW_CELLS);
  return few && few.level > state.level ? few.level : null;
}

/** The field that colours surfaces, as the server takes it. */
const colourOf = () =>
  state.by !== null && names().length ? { colour: state.step, colour_field: state.by } : { colour: state.by };

/** Whether the steps follow each other in time. */
const isSeries = () => steps().length > 1 && !fields().length;

// ---- words

/** A number with so many digits, without zeros at its end. */
function digits(value, count = 4) {
  if (value === undefined || value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e7)) return value.toExponential(count - 1).replace(/\.?0+e/, "e");
  return Number(value.toPrecision(count)).toLocaleString("en", { maximumFractionDigits: 8 });
}

/** A number with the unit behind it, where that is known. */
const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);

/** The unit of an area ("²") or a volume ("³"). */
function power(unit, exponent) {
  if (!unit) return undefined;
  return /^\p{L}+$/u.test(unit) ? unit + exponent : `(${unit})${exponent}`;
}
const whole = (value) => Math.round(value).toLocaleString("en");

function bytes(value) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let n = 0;
  while (value >= 1024 && n + 1 < units.length) [value, n] = [value / 1024, n + 1];
  return `${digits(value, 3)} ${units[n]}`;
}

function say(text) {
  const message = $("message");
  message.classList.remove("loading");
  message.hidden = !text;
  message.textContent = text;
}

const failed = (error) => {
  if (error.name !== "AbortError") say(error.message);
};

// ---- the address

function toAddress() {
  const p = new URLSearchParams();
  if (state.archive) p.set("archive", state.archive);
  if (names().length) p.set("field", state.field);
  if (steps().length > 1) p.set("step", state.step);
  for (const s of state.surfaces) {
    p.append("iso", [s.isovalue, s.colour.slice(1), s.opacity].join("_"));
  }
  if (state.active) p.set("active", state.active);
  if (state.level) p.set("level", state.level);
  if (state.cap) p.set("cap", 1);
  if (state.clip !== null) p.set("clip", ["xyz"[state.clip], state.place, state.flip ? 1 : 0, state.slice ? 1 : 0].join("_"));
  if (state.by !== null) p.set("by", state.by);
  if (state.map !== "viridis") p.set("map", state.map);
  if (state.range) p.set("range", state.range.join("_"));
  if (state.region) p.set("region", state.region.flat().join("_"));
  if (!state.box) p.set("box", 0);
  if (!state.axes) p.set("axes", 0);
  if (state.theme) p.set("theme", state.theme);
  p.set("camera", view.camera6.map((x) => Number(x.toPrecision(7))).join("_"));
  history.replaceState(null, "", `#${p}`);
}

/** Takes what is well-formed in the address; the rest stays as it is. Returns the camera. */
function fromAddress() {
  const p = new URLSearchParams(location.hash.slice(1));
  const numbers = (text, count) => {
    const all = (text ?? "").split("_").map(Number);
    return all.length === count && all.every(Number.isFinite) ? all : null;
  };
  const n = Number(p.get("archive") ?? 0);
  if (Number.isInteger(n) && n >= 0 && n < archives.length) state.archive = n;
  setField(p.get("field"));
  const number = Number(p.get("step") ?? NaN);
  state.step = (steps().find((s) => s.number === number) ?? steps()[0]).number;
  state.surfaces = p.getAll("iso").slice(0, 8).flatMap((text) => {
    const [isovalue, colour, opacity] = text.split("_");
    const good = Number.isFinite(Number(isovalue)) && /^[0-9a-f]{6}$/i.test(colour ?? "");
    return good ? [newSurface(Number(isovalue), `#${colour}`, Math.min(1, Math.max(0.05, Number(opacity) || 1)))] : [];
  });
  const active = Number(p.get("active") ?? 0);
  if (Number.isInteger(active) && active >= 0 && active < state.surfaces.length) state.active = active;
  setLevel(p.get("level"));
  state.cap = p.get("cap") === "1";
  const [axis, place, flip, slice] = (p.get("clip") ?? "").split("_");
  if (["x", "y", "z"].includes(axis) && Number(place) >= 0 && Number(place) <= 1) {
    Object.assign(state, { clip: "xyz".indexOf(axis), place: Number(place), flip: flip === "1", slice: slice !== "0" });
  }
  const by = colourChoices().find(({ value }) => String(value) === p.get("by"));
  state.by = by ? by.value : null;
  if (maps[p.get("map")]) state.map = p.get("map");
  state.range = numbers(p.get("range"), 2);
  const region = numbers(p.get("region"), 6);
  state.region = region && [region.slice(0, 2), region.slice(2, 4), region.slice(4)];
  state.box = p.get("box") !== "0";
  state.axes = p.get("axes") !== "0";
  if (["light", "dark"].includes(p.get("theme"))) state.theme = p.get("theme");
  return numbers(p.get("camera"), 6);
}

// ---- surfaces

function newSurface(isovalue, colour, opacity = 1) {
  return { name: nextName++, isovalue, colour, opacity, found: null, request: null, wanted: false, key: "" };
}

/** What decides a surface, as the server takes it. */
function parameters(isovalues) {
  const roi = roiOf(state.region);
  const { step, field, level } = state;
  return { isovalues, step, field, level: level || null, roi, cap: state.cap && !roi, ...colourOf() };
}

function roiOf(region) {
  const box = boxOf(region);
  const end = (x) => (Number.isFinite(x) ? x : "");
  return box && `world:${box.map(([lo, hi]) => `${end(lo)}:${end(hi)}`).join(",")}`;
}

/** The box of a region in the world, without an end where it reaches that of the domain. */
function boxOf(region) {
  if (!region || view.bounds.isEmpty()) return undefined;
  const { min, max } = view.bounds;
  return region.map((ends, a) => {
    const [lo, hi] = ends.map((t) => min.getComponent(a) + t * (max.getComponent(a) - min.getComponent(a)));
    return [ends[0] > 0 ? lo : -Infinity, ends[1] < 1 ? hi : Infinity];
  });
}

/** A surface that takes this long, in ms, gives way to a newer wish. */
const LONG = 150;

/** Stops a surface for a newer wish, if it takes long, and part of it was seen: so something moves under a slider. */
function giveWay(surface) {
  const isLong = surface.seen && performance.now() - surface.start > LONG;
  if (source.canStop && surface.wanted && isLong) surface.request.abort();
}

/**
 * Fetches a surface if what decides it has changed, and shows its parts as they come, or a coarse level before it.
 * While one request is under way, only the last wish waits.
 */
async function fetchSurface(surface) {
  const wish = parameters(surface.isovalue);
  const key = JSON.stringify([state.archive, wish]);
  if (surface.key === key) return;
  if (surface.request) {
    surface.wanted = true;
    giveWay(surface);
    return;
  }
  const request = new AbortController();
  const start = performance.now();
  const moment = momentKey(state.step);
  const times = {};
  Object.assign(surface, { key, request, start, seen: false });
  const before = levelBefore();
  // The values of another field come last: surfaces without their colours do not replace those that have them. Nor do
  // parts of a level replace all of a coarser one.
  const isShownWhole = before !== null || (wish.colour !== null && surface.found);
  const box = boxOf(state.region);
  const part = (found) => {
    if (surface.removed || isShownWhole || request.signal.aborted) return;
    found.box = box;
    view.show(surface.name, found, surface);
    if (!surface.seen) view.drawn().then(() => (times.first ??= performance.now() - start));
    surface.seen = true;
    giveWay(surface);
  };
  try {
    if (before !== null) {
      const coarse = await source.surface(state.archive, { ...wish, level: before }, request.signal);
      if (surface.removed) return;
      view.show(surface.name, Object.assign(coarse, { box }), surface);
      view.drawn().then(() => (times.first ??= performance.now() - start));
      surface.seen = true;
      if (surface.wanted) {
        surface.key = "";
        return;
      }
    }
    const found = await source.surface(state.archive, wish, request.signal, part);
    if (surface.removed) return;
    view.show(surface.name, Object.assign(found, { box }), surface);
    view.drawn().then(() => {
      times.whole = performance.now() - start;
      times.first ??= times.whole;
      if (state.surfaces[state.active] === surface) tellStatistics();
    });
    Object.assign(surface, { found, times, moment, area: areaOf(found) });
    say(found.report.surfaces[0].outside_range ? `The isovalue ${digits(surface.isovalue)} is outside of the field's range.` : "");
    if (view.bounds.isEmpty()) {
      view.boundsOf(found);
      if (!isPlaced) view.reset();
    }
    if (state.surfaces[state.active] === surface) tellStatistics();
    document.body.dataset.shown = String(Number(document.body.dataset.shown ?? 0) + 1);
  } catch (error) {
    failed(error);
    surface.key = "";
  } finally {
    surface.request = null;
    if (surface.wanted) {
      surface.wanted = false;
      fetchSurface(surface);
    }
  }
}

function fetchAll() {
  return Promise.all(state.surfaces.map(fetchSurface));
}

/** The archive and the step that a report is of. */
function momentKey(number) {
  return JSON.stringify([state.archive, number, state.field]);
}

/** The volume inside of a surface, in words: none before the spectrum of its step is there. */
function volumeInside({ found, moment }, unit) {
  if (spectrum.moment !== moment) return "…";
  const volume = spectrum.at(found.report.surfaces[0].isovalue, "volume");
  return volume === undefined ? "–" : `≈ ${withUnit(digits(volume), power(unit, "³"))}`;
}

/** The area of the triangles. */
function areaOf({ vertices, triangles }) {
  const [v, t] = [vertices.used, triangles.used];
  let sum = 0;
  for (let n = 0; n < t.length; n += 3) {
    const [a, b, c] = [6 * t[n], 6 * t[n + 1], 6 * t[n + 2]];
    const [ux, uy, uz] = [v[b] - v[a], v[b + 1] - v[a + 1], v[b + 2] - v[a + 2]];
    const [wx, wy, wz] = [v[c] - v[a], v[c + 1] - v[a + 1], v[c + 2] - v[a + 2]];
    sum += Math.hypot(uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx);
  }
  return sum / 2;
}

function setIsovalue(value) {
  const surface = state.surfaces[state.active];
  surface.isovalue = value;
  fetchSurface(surface);
  drawControls();
}

/** A value within the range, with no more digits than a slider has. */
function settle(value) {
  const [lo, hi] = stepInfo().range ?? [value, value];
  const unit = (hi - lo) / 1e4;
  if (!(unit > 0)) return value;
  const power = 10 ** Math.floor(Math.log10(unit));
  return Number((Math.round(Math.min(hi, Math.max(lo, value)) / power) * power).toPrecision(10));
}

// ---- controls

function listSurfaces() {
  const list = $("surfaces");
  list.replaceChildren(
    ...state.surfaces.map((s, n) => {
      const item = document.createElement("li");
      const make = (type, label, properties) => {
        const input = Object.assign(document.createElement("input"), { type, ...properties });
        input.setAttribute("aria-label", `${label} of surface ${n + 1}`);
        item.append(input);
        return input;
      };
      make("radio", "Choice", { name: "active", checked: n === state.active }).addEventListener("change", () => {
        state.active = n;
        drawControls();
        tellStatistics();
      });
      make("color", "Colour", { value: s.colour }).addEventListener("input", (event) => {
        s.colour = event.target.value;
        view.paint(s.name, s);
        drawControls();
      });
      make("number", "Isovalue", { value: s.isovalue, step: "any" }).addEventListener("change", (event) => {
        if (event.target.value === "" || !Number.isFinite(event.target.valueAsNumber)) return;
        state.active = n;
        setIsovalue(event.target.valueAsNumber);
        listSurfaces();
      });
      make("range", "Opacity", { min: 0.05, max: 1, step: 0.05, value: s.opacity }).addEventListener("input", (event) => {
        s.opacity = event.target.valueAsNumber;
        view.paint(s.name, s);
        toAddress();
      });
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: "×" });
      button.setAttribute("aria-label", `Remove surface ${n + 1}`);
      button.disabled = state.surfaces.length === 1;
      button.addEventListener("click", () => removeSurface(n));
      item.append(button);
      return item;
    }),
  );
  $("add").disabled = state.surfaces.length >= COLOURS.length;
}

function removeSurface(n) {
  const [surface] = state.surfaces.splice(n, 1);
  surface.removed = true;
  surface.request?.abort();
  view.remove(surface.name);
  state.active = Math.min(state.active, state.surfaces.length - 1);
  listSurfaces();
  drawControls();
  tellStatistics();
}

/** Sets the controls by the state, and the address. */
function drawControls() {
  const surface = state.surfaces[state.active];
  const [lo, hi] = stepInfo().range ?? [0, 1];
  $("isovalue").value = hi > lo ? (surface.isovalue - lo) / (hi - lo) : 0;
  $("isovalue").setAttribute("aria-valuetext", withUnit(digits(surface.isovalue), stepInfo().unit));
  $("of-values").textContent = stepInfo().unit ? ` in ${stepInfo().unit}` : "";
  const numbers = document.querySelectorAll("#surfaces input[type=number]");
  state.surfaces.forEach((s, n) => {
    if (numbers[n] && document.activeElement !== numbers[n]) numbers[n].value = s.isovalue;
  });
  spectrum.draw(state.surfaces.map(({ isovalue, colour }) => ({ isovalue, colour })));
  toAddress();
}

/** The region that is seen: that of interest, and the side of the plane. */
function clippedRegion() {
  if (state.clip === null) return state.region;
  const region = (state.region ?? [[0, 1], [0, 1], [0, 1]]).map((r) => [...r]);
  const range = region[state.clip];
  if (state.flip) range[0] = Math.max(range[0], state.place);
  else range[1] = Math.min(range[1], state.place);
  return region;
}

function tellStatistics() {
  const surface = state.surfaces[state.active];
  const lines = [];
  if (surface?.found) {
    const { report, milliseconds } = surface.found;
    const { length } = archive().units;
    lines.push(
      ["triangles", whole(report.triangles)],
      ["vertices", whole(report.vertices)],
      ["area", withUnit(digits(surface.area), power(length, "²"))],
      ["volume inside", volumeInside(surface, length)],
      ["extraction", `${digits(milliseconds, 3)} ms`],
      ["until drawn", `${digits(surface.times.whole, 3)} ms`],
      ["first part", `${digits(surface.times.first, 3)} ms`],
      ["bytes read", bytes(report.bytes_read)],
    );
  }
  const error = stepInfo().error ?? archive().error;
  if (error) {
    const [rms, max] = Array.isArray(error) ? error : [error.rms, error.max];
    const { unit } = stepInfo();
    lines.push(["error of the field, RMS", withUnit(digits(rms), unit)], ["error, largest", withUnit(digits(max), unit)]);
  }
  $("statistics").replaceChildren(
    ...lines.flatMap(([name, value]) => [
      Object.assign(document.createElement("dt"), { textContent: name }),
      Object.assign(document.createElement("dd"), { textContent: value }),
    ]),
  );
}

// ---- the plane

let sliceRequest = null;
let sliceWanted = null;

/** The rectangle of the plane within the bounds. */
function rectangle() {
  const { min, max } = view.bounds;
  const size = max.clone().sub(min);
  const [a, b] = [(state.clip + 1) % 3, (state.clip + 2) % 3];
  const origin = min.toArray();
  origin[state.clip] += state.place * size.getComponent(state.clip);
  const [u, v] = [[0, 0, 0], [0, 0, 0]];
  u[a] = size.getComponent(a);
  v[b] = size.getComponent(b);
  return { origin, u, v };
}

/** Fetches the slice, coarse or fine; while one is under way only the last wish waits. */
async function fetchSlice(most) {
  if (state.clip === null || !state.slice || view.bounds.isEmpty()) {
    view.setSlice(null);
    return;
  }
  if (sliceRequest) {
    sliceWanted = most;
    return;
  }
  const { origin, u, v } = rectangle();
  const lengths = [Math.hypot(...u), Math.hypot(...v)];
  const size = lengths.map((l) => Math.max(2, Math.round((most * l) / Math.max(...lengths))));
  const each = (vector, count) => vector.map((x) => x / (count - 1)).join(",");
  const shown = colourInfo();
  const field = names().length ? shown.field : null;
  const wish = { step: shown.number, field, origin: origin.join(","), u: each(u, size[0]), v: each(v, size[1]), size: size.join(",") };
  sliceRequest = new AbortController();
  try {
    const found = await source.slice(state.archive, wish, sliceRequest.signal);
    if (state.clip !== null) showSlice({ origin, u, v, ...found });
    document.body.dataset.slices = String(Number(document.body.dataset.slices ?? 0) + 1);
  } catch (error) {
    failed(error);
  } finally {
    sliceRequest = null;
    if (sliceWanted !== null) {
      const next = sliceWanted;
      sliceWanted = null;
      fetchSlice(next);
    } else if (most === COARSE) {
      fetchSlice(FINE);
    }
  }
}

let shownSlice = null;

function showSlice(slice = shownSlice) {
  shownSlice = slice;
  const range = state.range ?? colourInfo().range ?? [0, 1];
  if (slice && state.clip !== null && state.slice) view.setSlice({ ...slice, colours: maps[state.map], range });
}

/** A grid with coordinates has no corners: its bounds are asked for when a plane or a region needs them. */
async function needBounds() {
  const it = archive();
  if (it.corners || it.bounds) return;
  // One question, for as many wishes as come meanwhile.
  it.asked ??= source.bounds(state.archive).finally(() => (it.asked = undefined));
  it.bounds = await it.asked;
  if (archive() === it) view.setBounds(it.bounds);
}

async function setClip() {
  try {
    if (state.clip !== null) await needBounds();
  } catch (error) {
    failed(error);
  }
  const { min, max } = view.bounds;
  if (state.clip === null || view.bounds.isEmpty()) {
    view.setClip(null);
    view.setSlice(null);
  } else {
    const [lo, hi] = [min.getComponent(state.clip), max.getComponent(state.clip)];
    view.setClip(state.clip, lo + state.place * (hi - lo), state.flip);
    fetchSlice(COARSE);
  }
  const enable = (ids, on) => {
    for (const id of ids) {
      $(id).disabled = !on;
      $(id).style.opacity = on ? 1 : 0.4;
    }
  };
  enable(["flip", "slice", "place"], state.clip !== null);
  enable(["map", "low", "high", "bar"], state.clip !== null || state.by !== null);
  drawControls();
}

/** Paints the surfaces by the colour map and its range, or each with its own colour. */
function setColours() {
  const range = state.range ?? colourInfo().range ?? [0, 1];
  view.setField(state.by === null ? null : { colours: maps[state.map], range });
  for (const s of state.surfaces) view.paint(s.name, s);
}

function drawBar() {
  const { field, unit } = colourInfo();
  const title = field ? `Colours of ${field}` : "Colours of the field";
  document.querySelector("#colours h2").textContent = unit ? `${title} in ${unit}` : title;
  const bar = $("bar");
  [bar.width, bar.height] = [256, 1];
  const c = bar.getContext("2d");
  const image = c.createImageData(256, 1);
  maps[state.map].forEach(([r, g, b], n) => image.data.set([r, g, b, 255], 4 * n));
  c.putImageData(image, 0, 0);
  const [lo, hi] = state.range ?? colourInfo().range ?? [0, 1];
  if (document.activeElement !== $("low")) $("low").value = Number(lo.toPrecision(6));
  if (document.activeElement !== $("high")) $("high").value = Number(hi.toPrecision(6));
}

// ---- steps

/** Chooses a field by its name, where each step has several: the first unless it is one of them. */
function setField(name) {
  const all = names();
  state.field = all.includes(name) ? name : (all[0] ?? null);
}

let playing = false;

async function setStep(number) {
  state.step = number;
  const n = steps().findIndex((s) => s.number === number);
  $("step").value = n;
  const { time, field } = stepInfo();
  const moment = time === null || time === undefined ? `step ${number}` : `t = ${withUnit(digits(time), archive().units.time)}`;
  $("now").textContent = fields().length ? field : moment;
  $("step").setAttribute("aria-valuetext", $("now").textContent);
  if (state.clip !== null) fetchSlice(COARSE);
  const surfaces = fetchAll();
  drawControls();
  drawBar();
  await fetchSpectrum();
  // Of these, only the curve and the suggestions wait for the spectrum.
  drawSuggestions();
  drawControls();
  await surfaces;
}

/** Fetches the spectrum of the step, and tells the numbers that wait for it. */
async function fetchSpectrum() {
  const moment = momentKey(state.step);
  let report = null;
  try {
    report = await source.spectrum(state.archive, state.step, state.field);
  } catch (error) {
    failed(error);
  }
  // Another step may have been chosen meanwhile.
  if (moment !== momentKey(state.step)) return;
  Object.assign(spectrum, { report, moment });
  tellStatistics();
}

async function play() {
  playing = !playing;
  $("play").textContent = playing ? "❚❚" : "▶";
  $("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  while (playing) {
    const n = steps().findIndex((s) => s.number === state.step);
    const start = performance.now();
    await setStep(steps()[(n + 1) % steps().length].number);
    // A step stays for a moment, also where surfaces come at once.
    await new Promise((done) => setTimeout(done, Math.max(40, 100 - (performance.now() - start))));
  }
}

function drawSuggestions() {
  const all = spectrum.report?.suggestions ?? [];
  $("suggestions").replaceChildren(
    ...all.map(({ isovalue }) => {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: digits(isovalue) });
      button.addEventListener("click", () => setIsovalue(isovalue));
      return button;
    }),
  );
}

/** Chooses a level by its number: the finest unless there is one of it. */
function setLevel(number) {
  const level = levels().find((l) => String(l.level) === String(number));
  state.level = level ? level.level : 0;
}

function listLevels() {
  $("of-level").hidden = levels().length < 2;
  const name = ({ level, nodes, rms }) => {
    const error = rms === null || rms === undefined ? "" : `, error ${withUnit(digits(rms, 2), stepInfo().unit)}`;
    return new Option(`${level}: ${nodes.join(" × ")}${error}`, level);
  };
  $("level").replaceChildren(...levels().map(name));
  $("level").value = state.level;
}

// ---- archives

async function setArchive(camera) {
  const it = archive();
  $("archive").value = state.archive;
  $("facts").textContent = `${it.dims.join(" × ")} ${it.scalar}, ${whole(it.points)} points, ${bytes(it.bytes)}`;
  document.title = `${it.name} – isospan`;
  view.lengthUnit = it.units.length;
  view.setDomain(it.corners);
  it.bounds = undefined;
  $("of-field").hidden = !names().length;
  $("field").replaceChildren(...names().map((name) => new Option(name, name)));
  $("field").value = state.field ?? "";
  listLevels();
  $("coloured").hidden = !colourChoices().length;
  $("by").replaceChildren(new Option("their own colours", ""), ...colourChoices().map((c) => new Option(c.name, c.value)));
  $("by").value = state.by ?? "";
  // Fields are chosen; only a series plays.
  $("time").hidden = steps().length < 2;
  $("play").hidden = !isSeries();
  $("time").querySelector("h2").textContent = isSeries() ? "Time" : "Field";
  $("step").setAttribute("aria-label", isSeries() ? "Time step" : "Field");
  $("step").max = steps().length - 1;
  isPlaced = Boolean(camera);
  try {
    if (state.clip !== null || state.region) await needBounds();
  } catch (error) {
    failed(error);
  }
  if (camera) view.camera6 = camera;
  else view.reset();
  if (!state.surfaces.length) {
    const [lo, hi] = stepInfo().range ?? [0, 1];
    // Those of the archive are of its first field.
    const suggestions = state.field === (names()[0] ?? null) ? it.suggestions : [];
    const best = suggestions?.[0]?.isovalue ?? settle(lo + 0.5 * (hi - lo));
    state.surfaces = [newSurface(best, COLOURS[0])];
  }
  listSurfaces();
  drawRegion();
  setColours();
  await setStep(state.step ?? steps()[0].number);
  setClip();
}

function drawRegion() {
  const rows = ["x", "y", "z"].map((name, a) => {
    const row = Object.assign(document.createElement("div"), { className: "axis" });
    row.append(name);
    for (const end of [0, 1]) {
      const input = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 1, step: 0.01 });
      input.value = state.region?.[a][end] ?? end;
      input.setAttribute("aria-label", `${end ? "Highest" : "Lowest"} ${name} of the region`);
      input.addEventListener("input", async () => {
        try {
          await needBounds();
        } catch (error) {
          failed(error);
          return;
        }
        const region = (state.region ?? [[0, 1], [0, 1], [0, 1]]).map((r) => [...r]);
        region[a][end] = input.valueAsNumber;
        if (region[a][1] - region[a][0] < 0.01) region[a][1 - end] = Math.min(1, Math.max(0, region[a][end] + (end ? -0.01 : 0.01)));
        state.region = region.every(([lo, hi]) => lo <= 0 && hi >= 1) ? null : region;
        fetchAll();
        drawControls();
      });
      row.append(input);
    }
    return row;
  });
  $("ranges").replaceChildren(...rows);
}

function setTheme() {
  document.documentElement.dataset.theme = state.theme;
  view.draw();
  spectrum.draw();
}

function listen() {
  const on = (id, kind, act) => $(id).addEventListener(kind, act);
  on("archive", "change", () => {
    state.surfaces.forEach((s) => (s.removed = true));
    state.surfaces.forEach((s) => view.remove(s.name));
    Object.assign(state, { archive: Number($("archive").value), surfaces: [], active: 0, region: null, range: null, clip: null, by: null });
    setField(null);
    setLevel(0);
    state.step = steps()[0].number;
    $("clip").value = "";
    setArchive();
  });
  on("field", "change", () => {
    state.surfaces.forEach((s) => (s.removed = true));
    state.surfaces.forEach((s) => view.remove(s.name));
    Object.assign(state, { surfaces: [], active: 0, range: null });
    setField($("field").value);
    state.step = stepInfo().number;
    setArchive(view.camera6);
  });
  on("isovalue", "input", () => {
    const [lo, hi] = stepInfo().range ?? [0, 1];
    setIsovalue(settle(lo + $("isovalue").valueAsNumber * (hi - lo)));
  });
  on("add", "click", () => {
    const used = state.surfaces.map((s) => s.colour);
    const colour = COLOURS.find((c) => !used.includes(c)) ?? COLOURS[0];
    const suggested = (spectrum.report?.suggestions ?? []).map((s) => s.isovalue);
    const value = suggested.find((v) => !state.surfaces.some((s) => s.isovalue === v)) ?? state.surfaces[state.active].isovalue;
    state.surfaces.push(newSurface(value, colour));
    // Surfaces of lower isovalues lie around the others, which are seen through them.
    const inner = Math.max(...state.surfaces.map((s) => s.isovalue));
    for (const s of state.surfaces) {
      if (s.opacity === 1 && s.isovalue < inner) s.opacity = 0.45;
      view.paint(s.name, s);
    }
    state.active = state.surfaces.length - 1;
    listSurfaces();
    fetchAll();
    drawControls();
  });
  on("level", "change", () => {
    setLevel($("level").value);
    fetchAll();
    toAddress();
  });
  on("cap", "change", () => {
    state.cap = $("cap").checked;
    fetchAll();
    drawControls();
  });
  on("clip", "change", () => {
    state.clip = $("clip").value ? "xyz".indexOf($("clip").value) : null;
    setClip();
  });
  on("flip", "change", () => {
    state.flip = $("flip").checked;
    setClip();
  });
  on("slice", "change", () => {
    state.slice = $("slice").checked;
    setClip();
  });
  on("place", "input", () => {
    state.place = $("place").valueAsNumber;
    setClip();
  });
  on("by", "change", () => {
    state.by = colourChoices().find(({ value }) => String(value) === $("by").value)?.value ?? null;
    state.range = null;
    setColours();
    drawBar();
    fetchAll();
    setClip();
  });
  on("map", "change", () => {
    state.map = $("map").value;
    drawBar();
    showSlice();
    setColours();
    toAddress();
  });
  for (const id of ["low", "high"]) {
    on(id, "change", () => {
      const range = [$("low").valueAsNumber, $("high").valueAsNumber];
      state.range = range.every(Number.isFinite) && range[0] < range[1] ? range : null;
      drawBar();
      showSlice();
      setColours();
      toAddress();
    });
  }
  on("whole", "click", () => {
    state.region = null;
    drawRegion();
    fetchAll();
    drawControls();
  });
  on("play", "click", play);
  on("step", "input", () => setStep(steps()[$("step").valueAsNumber].number));
  on("box", "change", () => {
    state.box = view.showBox = $("box").checked;
    if (view.box) view.box.visible = state.box;
    view.draw();
    toAddress();
  });
  on("axes", "change", () => {
    state.axes = view.showAxes = $("axes").checked;
    view.draw();
    toAddress();
  });
  on("reset", "click", () => {
    view.reset();
    toAddress();
  });
  on("theme", "click", () => {
    const dark = state.theme ? state.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    state.theme = dark ? "light" : "dark";
    setTheme();
    toAddress();
  });
  on("link", "click", async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      say("");
    } catch {
      say("The browser does not allow copying; the address line has the link.");
    }
  });
  on("png", "click", savePicture);
  for (const format of ["glb", "stl", "ply"]) {
    on(format, "click", () => saveSurfaces(format));
  }
  addEventListener("keydown", key);
  addEventListener("resize", () => spectrum.draw());
}

function save(blob, ending) {
  const link = Object.assign(document.createElement("a"), {
    href: URL.createObjectURL(blob),
    download: `${archive().name.replace(/\.isospan$/, "")}.${ending}`,
  });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

async function savePicture() {
  const { backgroundColor, color } = getComputedStyle(document.body);
  const { field, unit } = colourInfo();
  const shows = state.by !== null || (state.clip !== null && state.slice);
  const legend = shows && {
    bar: $("bar"),
    title: unit ? `${field} in ${unit}` : field,
    ends: [$("low").value, $("high").value],
  };
  save(await view.png(backgroundColor, color, legend), "png");
}

/** Saves what is seen: all isovalues, in the region and on the side of the plane. */
async function saveSurfaces(format) {
  const roi = roiOf(clippedRegion());
  const isovalues = [...new Set(state.surfaces.map((s) => s.isovalue))].join(",");
  $(format).disabled = true;
  try {
    const colours = state.by === null ? {} : { ...colourOf(), map: state.map, range: state.range ?? undefined };
    const { step, field, level } = state;
    const wish = { isovalues, step, field, level: level || null, roi, cap: state.cap && !roi, format, ...colours };
    save(await source.file(state.archive, wish), format);
    say("");
  } catch (error) {
    failed(error);
  } finally {
    $(format).disabled = false;
  }
}

function key(event) {
  const typing = event.target.matches?.("input[type=number], select");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  const [lo, hi] = stepInfo().range ?? [0, 1];
  const move = (share) => setIsovalue(settle(state.surfaces[state.active].isovalue + share * (hi - lo)));
  const step = (by) => {
    const n = steps().findIndex((s) => s.number === state.step) + by;
    if (steps()[n]) setStep(steps()[n].number);
  };
  const acts = {
    "[": () => move(-0.005),
    "]": () => move(0.005),
    "{": () => move(-0.0005),
    "}": () => move(0.0005),
    ",": () => step(-1),
    ".": () => step(1),
    c: () => {
      state.clip = state.clip === null ? 2 : null;
      $("clip").value = state.clip === null ? "" : "xyz"[state.clip];
      setClip();
    },
    r: () => $("reset").click(),
    p: savePicture,
    "+": () => view.zoom(1 / 1.1),
    "-": () => view.zoom(1.1),
  };
  // Arrows move sliders and lists where those have the focus.
  if (!event.target.matches?.("input")) {
    Object.assign(acts, {
      ArrowLeft: () => view.turn(-5, 0),
      ArrowRight: () => view.turn(5, 0),
      ArrowUp: () => view.turn(0, 5),
      ArrowDown: () => view.turn(0, -5),
    });
  }
  if (event.key === " " && !event.target.matches?.("button, input, a") && isSeries()) acts[" "] = play;
  if (!acts[event.key]) return;
  event.preventDefault();
  acts[event.key]();
}

async function begin() {
  view = new View($("scene"), $("overlay"), toAddress);
  spectrum = new Spectrum($("spectrum"), (value) => setIsovalue(settle(value)));
  [archives, maps] = await Promise.all([source.archives(), source.colourMaps()]);
  $("archive").replaceChildren(...archives.map((a, n) => new Option(a.name, n)));
  $("map").replaceChildren(...Object.keys(maps).map((name) => new Option(name, name)));
  const camera = fromAddress();
  // The controls say what the address says.
  $("cap").checked = state.cap;
  $("clip").value = state.clip === null ? "" : "xyz"[state.clip];
  for (const [id, value] of Object.entries({ flip: state.flip, slice: state.slice, box: state.box, axes: state.axes })) $(id).checked = value;
  $("place").value = state.place;
  $("map").value = state.map;
  [view.showBox, view.showAxes] = [state.box, state.axes];
  listen();
  setTheme();
  await setArchive(camera);
  if ($("message").classList.contains("loading")) say("");
  document.body.dataset.ready = "1";
}

begin().catch(failed);
