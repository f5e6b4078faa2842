// Strip chart of one quantity: readable ticks, a minimum span, the current value in large digits.

import { element, fillSelect, setText } from "./dom.js";

const COLORS = ["#6cb8ff", "#ffb84d", "#4fd1a5", "#f28cc1"];
const AXIS = "#aab5c2", GRID = "#2b323c";
const FONT = "11px system-ui, sans-serif";
const LEFT = 40, BOTTOM = 17, TOP = 7, RIGHT = 6;

/** A step of 1, 2 or 5 times a power of ten, so that a span has at most so many steps. */
export function niceStep(span, most) {
  const raw = span / most, power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw - 1e-12 * power);
}

/** Limits of an axis around values, on whole steps and at least minSpan apart; not negative without need. */
export function axisOf(values, minSpan, most = 4) {
  let low = Infinity, high = -Infinity;
  for (const value of values) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
  if (low > high) [low, high] = [0, minSpan];
  const missing = Math.max(0, minSpan - (high - low));
  const isPositive = low >= 0;
  low -= missing / 2;
  high += missing / 2;
  if (isPositive && low < 0) [low, high] = [0, high - low];
  const step = niceStep(high - low, most);
  low = Math.floor(low / step + 1e-9) * step;
  high = Math.ceil(high / step - 1e-9) * step;
  const ticks = [];
  for (let k = 0; k <= Math.round((high - low) / step); k += 1) ticks.push(low + k * step);
  return { low, high, step, ticks };
}

export const formatTick = (value, step) => value.toFixed(Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9))));

export class Chart {
  /** quantities: {name, unit, minSpan, digits}; the chosen one is drawn by draw(). */
  constructor(figure, quantities, chosen) {
    this.quantities = quantities;
    const id = `${figure.id}-quantity`;
    this.select = element("select", { id, title: "Quantity of the chart" });
    fillSelect(this.select, quantities.map(({ name }, value) => ({ value, label: name })), chosen);
    this.digits = element("output", { className: "digits", textContent: "–" });
    this.unit = element("span");
    this.canvas = element("canvas", { role: "img" });
    const label = element("label", { className: "visually-hidden", htmlFor: id, textContent: "Quantity of the chart" });
    const value = element("span", { className: "value" }, this.digits, " ", this.unit);
    figure.replaceChildren(element("figcaption", {}, label, this.select, value), this.canvas);
    this.context = this.canvas.getContext("2d");
    this.select.addEventListener("change", () => this.onChange?.());
  }

  get index() { return Number(this.select.value); }

  /** Show the current value. */
  show(value) {
    const { unit, digits, name } = this.quantities[this.index];
    const text = Number.isFinite(value) && value !== null ? value.toFixed(digits) : "–";
    setText(this.digits, text);
    setText(this.unit, unit);
    const label = `${name}: ${text} ${unit}`;
    if (this.canvas.getAttribute("aria-label") !== label) this.canvas.setAttribute("aria-label", label);
  }

  /** Draw lines of values over times; from and to limit the time axis, mark is a time. */
  draw({ times, lines, from, to, mark = null, colors = COLORS }) {
    const canvas = this.canvas, scale = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (width < 60 || height < 30) return;
    if (canvas.width !== Math.round(width * scale)) canvas.width = Math.round(width * scale);
    if (canvas.height !== Math.round(height * scale)) canvas.height = Math.round(height * scale);
    const pen = this.context;
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = FONT;
    const y = axisOf(lines.flat(), this.quantities[this.index].minSpan, height > 90 ? 4 : 2);
    const xOf = (time) => LEFT + ((time - from) / Math.max(to - from, 1e-9)) * (width - LEFT - RIGHT);
    const yOf = (value) => TOP + ((y.high - value) / (y.high - y.low)) * (height - TOP - BOTTOM);
    this.axes(pen, { y, from, to, xOf, yOf, width, height });
    lines.forEach((line, k) => this.line(pen, times, line, colors[k % colors.length], xOf, yOf));
    if (mark !== null) {
      pen.strokeStyle = "#eef2f6";
      pen.lineWidth = 1;
      pen.beginPath();
      pen.moveTo(xOf(mark), TOP);
      pen.lineTo(xOf(mark), height - BOTTOM);
      pen.stroke();
    }
  }

  axes(pen, { y, from, to, xOf, yOf, width, height }) {
    pen.strokeStyle = GRID;
    pen.fillStyle = AXIS;
    pen.lineWidth = 1;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const tick of y.ticks) {
      const at = Math.round(yOf(tick)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, at);
      pen.lineTo(width - RIGHT, at);
      pen.stroke();
      pen.fillText(formatTick(tick, y.step), LEFT - 5, at);
    }
    const step = niceStep(to - from, Math.max(2, Math.floor((width - LEFT) / 52)));
    pen.textBaseline = "bottom";
    for (let time = Math.ceil(from / step - 1e-9) * step; time <= to + 1e-9; time += step) {
      const x = xOf(time), isLast = x > width - 24;
      pen.textAlign = isLast ? "right" : "center";
      pen.fillText(`${formatTick(time, step)} s`, isLast ? width - RIGHT : x, height);
    }
  }

  line(pen, times, values, color, xOf, yOf) {
    pen.strokeStyle = color;
    pen.lineWidth = 1.75;
    pen.lineJoin = "round";
    pen.beginPath();
    let isDrawing = false;
    for (let k = 0; k < times.length; k += 1) {
      if (values[k] === null || !Number.isFinite(values[k])) { isDrawing = false; continue; }
      if (isDrawing) pen.lineTo(xOf(times[k]), yOf(values[k]));
      else pen.moveTo(xOf(times[k]), yOf(values[k]));
      isDrawing = true;
    }
    pen.stroke();
  }
}
