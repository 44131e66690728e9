// The contour spectrum: area over the isovalue, with marks.

/** Draws it and tells which isovalue is chosen on it. */
export class Spectrum {
  constructor(canvas, chosen) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.report = null;
    /** The archive and the step that the report is of. */
    this.moment = null;
    this.marks = [];
    const choose = (event) => {
      if (!this.report?.range || (event.type === "pointermove" && event.buttons !== 1)) return;
      const box = canvas.getBoundingClientRect();
      const [lo, hi] = this.report.range;
      const at = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
      chosen(lo + at * (hi - lo), event.type === "pointerup");
    };
    for (const kind of ["pointerdown", "pointermove", "pointerup"]) canvas.addEventListener(kind, choose);
  }

  /** A quantity of the knots at an isovalue, linear between them. */
  at(isovalue, name) {
    const knots = this.report?.knots ?? [];
    const next = knots.findIndex((k) => k.isovalue >= isovalue);
    if (next < 0) return undefined;
    const [a, b] = [knots[Math.max(0, next - 1)], knots[next]];
    if (b.isovalue === a.isovalue) return b[name];
    return a[name] + ((isovalue - a.isovalue) / (b.isovalue - a.isovalue)) * (b[name] - a[name]);
  }

  /** `marks`: isovalue and colour of each surface. */
  draw(marks = this.marks) {
    this.marks = marks;
    const { canvas, context: c } = this;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    c.setTransform(scale, 0, 0, scale, 0, 0);
    const style = getComputedStyle(canvas);
    const [ink, soft] = [style.color, style.caretColor];
    const { range, knots, suggestions } = this.report ?? {};
    if (!range || !knots?.length) return;
    const [lo, hi] = range;
    const x = (v) => (hi > lo ? ((v - lo) / (hi - lo)) * width : width / 2);
    const most = Math.max(...knots.map((k) => k.area), Number.MIN_VALUE);
    // Areas differ by orders of magnitude: their square roots are drawn.
    const y = (area) => height - 4 - Math.sqrt(area / most) * (height - 12);
    c.beginPath();
    c.moveTo(x(knots[0].isovalue), height);
    for (const k of knots) c.lineTo(x(k.isovalue), y(k.area));
    c.lineTo(x(knots[knots.length - 1].isovalue), height);
    c.closePath();
    c.fillStyle = soft;
    c.fill();
    c.strokeStyle = ink;
    c.lineWidth = 1;
    for (const s of suggestions ?? []) {
      c.beginPath();
      c.arc(x(s.isovalue), 5, 3, 0, 2 * Math.PI);
      c.fillStyle = ink;
      c.fill();
    }
    for (const { isovalue, colour } of marks) {
      c.beginPath();
      c.moveTo(x(isovalue), 0);
      c.lineTo(x(isovalue), height);
      c.strokeStyle = ink;
      c.lineWidth = 3;
      c.stroke();
      c.strokeStyle = colour;
      c.lineWidth = 1.5;
      c.stroke();
    }
  }
}
