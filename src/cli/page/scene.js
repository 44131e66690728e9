// What is seen: surfaces, the box, a clipping plane with a slice, axes and a scale bar. Drawn when something changes.
import {
  Box3, BufferAttribute, BufferGeometry, ClampToEdgeWrapping, Color, DataTexture, DirectionalLight, DoubleSide,
  FloatType, HemisphereLight, InterleavedBuffer, InterleavedBufferAttribute, LineBasicMaterial, LineSegments,
  LinearFilter, Mesh, MeshStandardMaterial, NearestFilter, OrbitControls, PerspectiveCamera, Plane, RGBAFormat,
  RedFormat, Scene, ShaderMaterial, SRGBColorSpace, UnsignedByteType, Vector2, Vector3, WebGLRenderer,
} from "./three.js";

const SLICE_VERTEX = `
  varying vec2 at;
  void main() {
    at = uv;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;
// Values are interpolated here: not every device filters textures of floats.
const SLICE_FRAGMENT = `
  uniform sampler2D values;
  uniform sampler2D colours;
  uniform vec2 size;
  uniform vec2 range;
  varying vec2 at;
  void main() {
    vec2 place = at * (size - 1.0);
    ivec2 low = ivec2(clamp(floor(place), vec2(0.0), size - 1.0));
    ivec2 high = min(low + 1, ivec2(size) - 1);
    vec2 t = place - vec2(low);
    float a = texelFetch(values, low, 0).r;
    float b = texelFetch(values, ivec2(high.x, low.y), 0).r;
    float c = texelFetch(values, ivec2(low.x, high.y), 0).r;
    float d = texelFetch(values, high, 0).r;
    float value = mix(mix(a, b, t.x), mix(c, d, t.x), t.y);
    if (isnan(value)) value = texelFetch(values, ivec2(round(place)), 0).r;
    if (isnan(value)) discard;
    float share = clamp((value - range.x) / max(range.y - range.x, 1e-30), 0.0, 1.0);
    gl_FragColor = vec4(texture2D(colours, vec2(share * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb, 1.0);
    #include <colorspace_fragment>
  }`;

/** A length of 1, 2 or 5 times a power of ten, at most `most`. */
function round(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return power * (most >= 5 * power ? 5 : most >= 2 * power ? 2 : 1);
}

/** A surface on the device, while it arrives and after. */
class Layer {
  constructor(found) {
    this.found = found;
    this.mesh = new Mesh(new BufferGeometry(), new MeshStandardMaterial({ side: DoubleSide, roughness: 0.65, metalness: 0 }));
    this.mesh.frustumCulled = false;
    this.sent = { vertices: 0, triangles: 0, changes: 0 };
  }

  /** Takes what has arrived since the last time. */
  update() {
    const { vertices, triangles, changes } = this.found;
    const { geometry } = this.mesh;
    // Matrices are of doubles: far from 0 they keep the digits that the device has not.
    this.mesh.position.fromArray(this.found.origin);
    if (this.buffer?.array !== vertices.all || geometry.index.array !== triangles.all) {
      // They have moved to where there is more room.
      geometry.dispose();
      this.buffer = new InterleavedBuffer(vertices.all, 6);
      geometry.setAttribute("position", new InterleavedBufferAttribute(this.buffer, 3, 0));
      geometry.setAttribute("normal", new InterleavedBufferAttribute(this.buffer, 3, 3));
      geometry.setIndex(new BufferAttribute(triangles.all, 1));
    } else {
      const renew = (buffer, from, to) => {
        if (to > from) buffer.addUpdateRange(from, to - from);
        buffer.needsUpdate = to > from;
      };
      renew(this.buffer, changes > this.sent.changes ? 0 : this.sent.vertices, vertices.length);
      renew(geometry.index, this.sent.triangles, triangles.length);
    }
    this.sent = { vertices: vertices.length, triangles: triangles.length, changes };
  }

  /** Draws the triangles of the archive's chunks from this one on. Returns whether there are some. */
  drawFrom(chunk) {
    const before = this.found.parts.filter((part) => part.chunks <= chunk).at(-1)?.triangles ?? 0;
    this.mesh.geometry.setDrawRange(3 * before, this.sent.triangles - 3 * before);
    return this.sent.triangles > 3 * before;
  }

  dispose() {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }
}

/** Gives vertices the colours of their values; grey where there is none. */
function colourVertices(geometry, values, { colours, range: [lo, hi] }) {
  const linear = (rgb) => new Color().setRGB(...rgb.map((c) => c / 255), SRGBColorSpace).toArray();
  const [table, none] = [colours.map(linear), linear([128, 128, 128])];
  const all = new Float32Array(3 * values.length);
  const scale = 256 / Math.max(hi - lo, 1e-30);
  for (let n = 0; n < values.length; n++) {
    const place = (values[n] - lo) * scale;
    all.set(Number.isNaN(place) ? none : table[Math.min(255, Math.max(0, Math.floor(place)))], 3 * n);
  }
  geometry.setAttribute("color", new BufferAttribute(all, 3));
}

export class View {
  /** `changed` is called after the camera moved. */
  constructor(canvas, overlay, changed) {
    this.canvas = canvas;
    this.overlay = overlay;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.renderer.localClippingEnabled = true;
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(35, 1, 0.1, 100);
    this.camera.up.set(0, 0, 1);
    this.scene.add(new HemisphereLight(0xffffff, 0x8a8f96, 1.6), this.camera);
    const lamp = new DirectionalLight(0xffffff, 1.9);
    lamp.position.set(-0.6, 0.8, 1);
    this.camera.add(lamp);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    this.controls.addEventListener("end", changed);
    this.changed = changed;
    this.surfaces = new Map();
    this.bounds = new Box3();
    this.plane = null;
    this.field = null;
    this.showBox = this.showAxes = true;
    this.lengthUnit = undefined;
    this.waiting = false;
    this.afterDrawing = [];
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    this.renderer.setPixelRatio(scale);
    this.renderer.setSize(width, height, false);
    this.overlay.width = Math.round(width * scale);
    this.overlay.height = Math.round(height * scale);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Draws before the next frame, once. */
  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => this.drawNow());
  }

  drawNow() {
    this.waiting = false;
    const distance = this.camera.position.distanceTo(this.controls.target);
    const size = this.bounds.isEmpty() ? 1 : this.bounds.getSize(new Vector3()).length();
    this.camera.near = Math.max(distance - size, size * 1e-3);
    this.camera.far = distance + 2 * size;
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    this.drawOverlay();
    for (const act of this.afterDrawing.splice(0)) act();
  }

  /** Waits until what is shown now was handed to the device. */
  drawn() {
    this.draw();
    return new Promise((done) => this.afterDrawing.push(done));
  }

  /** The domain: eight corners, or none. */
  setDomain(corners) {
    if (this.box) this.scene.remove(this.box);
    this.box = null;
    this.bounds.makeEmpty();
    if (!corners) return;
    for (const c of corners) this.bounds.expandByPoint(new Vector3(...c));
    const edges = [];
    const from = (corner) => corner.map((x, a) => x - corners[0][a]);
    for (let n = 0; n < 8; n++) {
      for (const bit of [1, 2, 4]) if (!(n & bit)) edges.push(...from(corners[n]), ...from(corners[n | bit]));
    }
    const lines = new BufferGeometry();
    lines.setAttribute("position", new BufferAttribute(new Float32Array(edges), 3));
    this.box = new LineSegments(lines, new LineBasicMaterial({ color: 0x808890 }));
    this.box.visible = this.showBox;
    this.box.position.fromArray(corners[0]);
    this.scene.add(this.box);
    this.draw();
  }

  /** Looks at all of the domain, or of the surfaces where the domain has no box. */
  reset() {
    if (this.bounds.isEmpty()) return;
    const middle = this.bounds.getCenter(new Vector3());
    const radius = this.bounds.getSize(new Vector3()).length() / 2;
    const half = Math.atan(Math.tan((this.camera.fov * Math.PI) / 360) * Math.min(1, this.camera.aspect));
    const toward = new Vector3(0.55, -0.75, 0.4).normalize();
    this.controls.target.copy(middle);
    this.camera.position.copy(middle).addScaledVector(toward, radius / Math.sin(half));
    this.controls.update();
    this.draw();
  }

  /** Turns the camera around what it looks at, in degrees to the right and up; never over the poles. */
  turn(right, up) {
    const { camera, controls } = this;
    const offset = camera.position.clone().sub(controls.target).applyAxisAngle(camera.up, (right * Math.PI) / 180);
    const [least, most] = [0.02, Math.PI - 0.02];
    const polar = offset.angleTo(camera.up);
    const wanted = Math.min(most, Math.max(least, polar - (up * Math.PI) / 180));
    const axis = new Vector3().crossVectors(camera.up, offset).normalize();
    offset.applyAxisAngle(axis, wanted - polar);
    this.place(offset);
  }

  /** Multiplies the distance of the camera from what it looks at. */
  zoom(factor) {
    this.place(this.camera.position.clone().sub(this.controls.target).multiplyScalar(factor));
  }

  place(offset) {
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.draw();
    this.changed();
  }

  /** The camera as six numbers, and back. */
  get camera6() {
    return [...this.camera.position.toArray(), ...this.controls.target.toArray()];
  }

  set camera6(numbers) {
    this.camera.position.fromArray(numbers);
    this.controls.target.fromArray(numbers, 3);
    this.controls.update();
    this.draw();
  }

  /**
   * Shows what has arrived of a surface in place of what had its name. Of that, the parts stay that are not yet
   * replaced: chunks come in order.
   */
  show(name, found, style) {
    const layers = this.surfaces.get(name) ?? [];
    if (layers[0]?.found !== found) {
      layers.unshift(new Layer(found));
      this.scene.add(layers[0].mesh);
    }
    layers[0].update();
    let past = 0;
    const kept = layers.filter((layer, n) => {
      const isSeen = layer.drawFrom(past) || n === 0;
      past = Math.max(past, layer.found.chunks);
      if (!isSeen) this.drop(layer);
      return isSeen;
    });
    this.surfaces.set(name, kept);
    this.paint(name, style);
  }

  paint(name, { colour, opacity }) {
    for (const layer of this.surfaces.get(name) ?? []) {
      const { geometry, material } = layer.mesh;
      const field = layer.found.values && this.field;
      if (field && layer.field !== field) colourVertices(geometry, layer.found.values, field);
      layer.field = field;
      material.vertexColors = Boolean(field);
      material.color = new Color(field ? 0xffffff : colour);
      material.opacity = opacity;
      material.transparent = opacity < 1;
      material.depthWrite = opacity >= 1;
      material.clippingPlanes = this.planesOf(layer);
      material.needsUpdate = true;
      layer.mesh.renderOrder = opacity < 1 ? 1 : 0;
    }
    this.draw();
  }

  /** The planes that cut a surface; a preview is cut at the region of interest here, which the finished one ends at. */
  planesOf({ found }) {
    const planes = this.plane ? [this.plane] : [];
    if (!found.preview || !found.box) return planes;
    found.box.forEach(([lo, hi], a) => {
      if (lo > -Infinity) planes.push(new Plane(new Vector3().setComponent(a, 1), -lo));
      if (hi < Infinity) planes.push(new Plane(new Vector3().setComponent(a, -1), hi));
    });
    return planes;
  }

  /** The colours of values at vertices: a table of 256 colours, and the values at its ends; or none. */
  setField(field) {
    this.field = field;
  }

  remove(name) {
    for (const layer of this.surfaces.get(name) ?? []) this.drop(layer);
    this.surfaces.delete(name);
    this.draw();
  }

  drop(layer) {
    this.scene.remove(layer.mesh);
    layer.dispose();
  }

  /** The bounds of a domain that is no box: its lowest and its highest corner. */
  setBounds([lo, hi]) {
    this.bounds.set(new Vector3(...lo), new Vector3(...hi));
    this.draw();
  }

  /** Where a surface alone says how large the domain is. */
  boundsOf(found) {
    const vertices = found.vertices.used;
    const [point, origin] = [new Vector3(), new Vector3(...found.origin)];
    for (let n = 0; n < vertices.length; n += 6) {
      this.bounds.expandByPoint(point.fromArray(vertices, n).add(origin));
    }
  }

  /** Hides what is beyond a plane of an axis, 0 to 2; none for null. */
  setClip(axis, place, flip) {
    if (axis === null) {
      this.plane = null;
    } else {
      const sign = flip ? -1 : 1;
      const normal = new Vector3().setComponent(axis, -sign);
      this.plane = new Plane(normal, sign * place);
    }
    for (const layer of [...this.surfaces.values()].flat()) {
      layer.mesh.material.clippingPlanes = this.planesOf(layer);
      layer.mesh.material.needsUpdate = true;
    }
    this.draw();
  }

  /** The field on a rectangle: its corner and sides in the world, values, a table of 256 colours, a range. */
  setSlice(slice) {
    if (!slice) {
      if (this.slice) this.slice.visible = false;
      this.draw();
      return;
    }
    const { origin, u, v, size, values, colours, range } = slice;
    if (!this.slice) {
      const material = new ShaderMaterial({
        vertexShader: SLICE_VERTEX,
        fragmentShader: SLICE_FRAGMENT,
        side: DoubleSide,
        uniforms: { values: {}, colours: {}, size: { value: new Vector2() }, range: { value: new Vector2() } },
      });
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(12), 3));
      geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]), 2));
      geometry.setIndex([0, 1, 2, 2, 1, 3]);
      this.slice = new Mesh(geometry, material);
      this.slice.frustumCulled = false;
      this.scene.add(this.slice);
    }
    const { position } = this.slice.geometry.attributes;
    for (let n = 0; n < 4; n++) {
      for (let a = 0; a < 3; a++) {
        position.array[3 * n + a] = (n & 1 ? u[a] : 0) + (n & 2 ? v[a] : 0);
      }
    }
    position.needsUpdate = true;
    this.slice.position.fromArray(origin);
    const { uniforms } = this.slice.material;
    if (uniforms.values.of !== values) {
      uniforms.values.value?.dispose();
      // Less one of them: large values that differ little are one number of a texture.
      const base = values.find(Number.isFinite) ?? 0;
      const less = Float32Array.from(values, (value) => value - base);
      const texture = new DataTexture(less, size[0], size[1], RedFormat, FloatType);
      texture.minFilter = texture.magFilter = NearestFilter;
      texture.needsUpdate = true;
      uniforms.values = { value: texture, of: values, base };
    }
    if (uniforms.colours.of !== colours) {
      uniforms.colours.value?.dispose();
      const bytes = new Uint8Array(colours.flatMap((c) => [...c, 255]));
      const texture = new DataTexture(bytes, 256, 1, RGBAFormat, UnsignedByteType);
      texture.colorSpace = SRGBColorSpace;
      texture.minFilter = texture.magFilter = LinearFilter;
      texture.wrapS = ClampToEdgeWrapping;
      texture.needsUpdate = true;
      uniforms.colours = { value: texture, of: colours };
    }
    uniforms.size.value.set(...size);
    uniforms.range.value.set(...range.map((end) => end - uniforms.values.base));
    this.slice.material.uniformsNeedUpdate = true;
    this.slice.visible = true;
    this.draw();
  }

  /** Axes and the scale bar. */
  drawOverlay() {
    const c = this.overlay.getContext("2d");
    const scale = this.renderer.getPixelRatio();
    c.setTransform(scale, 0, 0, scale, 0, 0);
    c.clearRect(0, 0, this.overlay.width, this.overlay.height);
    if (!this.showAxes || this.bounds.isEmpty()) return;
    const { clientWidth: width, clientHeight: height } = this.overlay;
    const ink = getComputedStyle(this.overlay).color;
    c.font = "12px system-ui, sans-serif";
    c.lineWidth = 2;
    const [x, y, length] = [40, height - 40, 26];
    const axes = ["x", "y", "z"].map((name, a) => {
      const v = new Vector3().setComponent(a, 1).applyQuaternion(this.camera.quaternion.clone().invert());
      return { name, v, colour: ["#d1483e", "#3f9142", "#3b6fd4"][a] };
    });
    for (const { name, v, colour } of axes.sort((a, b) => a.v.z - b.v.z)) {
      c.strokeStyle = c.fillStyle = colour;
      c.beginPath();
      c.moveTo(x, y);
      c.lineTo(x + length * v.x, y - length * v.y);
      c.stroke();
      c.textAlign = "center";
      c.fillText(name, x + (length + 9) * v.x, y - (length + 9) * v.y + 4);
    }
    // World units of a pixel, at the point that is looked at.
    const distance = this.camera.position.distanceTo(this.controls.target);
    const pixel = (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / Math.max(height, 1);
    const bar = round(Math.min(140, width / 3) * pixel);
    const [right, bottom] = [width - 16, height - 16];
    c.strokeStyle = c.fillStyle = ink;
    c.beginPath();
    c.moveTo(right - bar / pixel, bottom - 5);
    c.lineTo(right - bar / pixel, bottom);
    c.lineTo(right, bottom);
    c.lineTo(right, bottom - 5);
    c.stroke();
    c.textAlign = "right";
    const words = Number(bar.toPrecision(1)).toString();
    c.fillText(this.lengthUnit ? `${words} ${this.lengthUnit}` : words, right, bottom - 9);
  }

  /** The picture, with axes, scale and, where given, a bar of colours, on the page's background. */
  async png(background, ink, legend) {
    this.drawNow();
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = [this.canvas.width, this.canvas.height];
    const c = picture.getContext("2d");
    c.fillStyle = background;
    c.fillRect(0, 0, picture.width, picture.height);
    c.drawImage(this.canvas, 0, 0);
    c.drawImage(this.overlay, 0, 0, picture.width, picture.height);
    if (legend) drawLegend(c, picture, ink, legend);
    return new Promise((done) => picture.toBlob(done, "image/png"));
  }
}

/** Draws a bar of colours with its title and the values at its ends, at the top on the left. */
function drawLegend(c, picture, ink, { bar, title, ends }) {
  const em = Math.round(picture.height / 45);
  const [left, top, width] = [em, em, Math.min(12 * em, picture.width - 2 * em)];
  c.font = `${em}px sans-serif`;
  c.fillStyle = ink;
  c.textBaseline = "top";
  c.fillText(title, left, top);
  c.drawImage(bar, left, top + 1.4 * em, width, em);
  c.textAlign = "left";
  c.fillText(ends[0], left, top + 2.7 * em);
  c.textAlign = "right";
  c.fillText(ends[1], left + width, top + 2.7 * em);
}
