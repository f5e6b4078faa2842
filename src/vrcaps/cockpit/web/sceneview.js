// The 3D scene in its frame: only its drawing is shown, with directions and a scale bar over it.

import { $, setText, setHidden } from "./dom.js";

// The frame's own panels and messages are hidden: only elements around its canvas are shown.
const STYLE = "body *:not(:has(canvas)):not(canvas) { display: none !important; }";
const WORLD = [["x", "#ff9a5c"], ["y", "#4fd1a5"], ["z", "#7cbcff"]];
const PATIENT = [["L", "R"], ["P", "A"], ["S", "I"]];
const SHORTEST_PX = 50;
const WATCHED_MS = 250, EVERY_MS = 1000;

export class SceneView {
  /** onKey(event) handles keys pressed in the frame; it returns true if the scene must not see them. */
  constructor(connection, onKey) {
    this.connection = connection;
    this.frame = $("scene");
    this.drawn = "";
    this.frame.addEventListener("load", () => this.prepare(onKey));
    setInterval(() => this.watchFrames(), EVERY_MS);
  }

  open(client) {
    this.frame.src = `/scene/${client}`;
  }

  prepare(onKey) {
    const inside = this.frame.contentWindow, page = this.frame.contentDocument;
    if (!page || this.frame.src === "about:blank") return;
    const style = page.createElement("style");
    style.textContent = STYLE;
    page.head.append(style);
    for (const type of ["keydown", "keyup"]) {
      inside.addEventListener(type, (event) => { if (onKey(event)) event.stopImmediatePropagation(); }, true);
    }
    inside.addEventListener("blur", () => dispatchEvent(new Event("blur")));
  }

  /** Draw directions and scale of a viewpoint. */
  show(viewpoint) {
    const has = Boolean(viewpoint);
    setHidden($("scale"), !has);
    if (!has) return;
    this.viewpoint = viewpoint;
    const height = this.frame.clientHeight, text = JSON.stringify([viewpoint, height]);
    if (text === this.drawn) return;
    this.drawn = text;
    this.drawScale(viewpoint.height / Math.max(height, 1));
    this.drawTriad(viewpoint);
  }

  drawScale(metersPerPixel) {
    const shortest = SHORTEST_PX * metersPerPixel, power = 10 ** Math.floor(Math.log10(shortest));
    const size = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= shortest);
    $("scale-bar").style.width = `${size / metersPerPixel}px`;
    const name = size >= 1 ? `${size.toFixed(0)} m` : size >= 0.01 ? `${(100 * size).toFixed(0)} cm` : `${(1000 * size).toFixed(size < 0.001 ? 1 : 0)} mm`;
    setText($("scale-text"), name);
    $("scale").setAttribute("aria-label", `Scale bar: ${name}`);
  }

  drawTriad({ world, patient }) {
    const canvas = $("triad"), pen = canvas.getContext("2d"), middle = canvas.width / 2;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    const parts = [];
    patient.forEach((axis, k) => PATIENT[k].forEach((name, end) => {
      const sign = end === 0 ? 1 : -1;
      parts.push({ name, at: axis.map((part) => sign * part), reach: 92, color: "#eef2f6", width: 2, size: 25 });
    }));
    world.forEach((axis, k) => parts.push({ name: WORLD[k][0], at: axis, reach: 52, color: WORLD[k][1], width: 6, size: 24 }));
    parts.sort((one, other) => one.at[2] - other.at[2]);
    for (const { name, at, reach, color, width, size } of parts) {
      const x = middle + reach * at[0], y = middle - reach * at[1];
      pen.globalAlpha = at[2] < -0.3 ? 0.5 : 1;
      pen.strokeStyle = pen.fillStyle = color;
      pen.lineWidth = width;
      pen.beginPath();
      pen.moveTo(middle, middle);
      pen.lineTo(x, y);
      pen.stroke();
      pen.globalAlpha = 1;
      pen.font = `600 ${size}px system-ui, sans-serif`;
      pen.lineWidth = 6;
      pen.strokeStyle = "#14171c";
      const over = 1 + 15 / reach;
      const textX = middle + reach * over * at[0], textY = middle - reach * over * at[1];
      if (Math.hypot(at[0], at[1]) < 0.35 && reach > 60) continue; // towards or away from the viewer
      pen.strokeText(name, textX, textY);
      pen.fillText(name, textX, textY);
    }
  }

  /** Direction of the patient nearest to an axis of the world, such as "left"; empty before it is known. */
  directionOf(axis, sign) {
    if (!this.viewpoint) return "";
    const names = [["left", "right"], ["back", "front"], ["head", "feet"]];
    const { world, patient } = this.viewpoint;
    const along = patient.map((each) => sign * each.reduce((sum, part, k) => sum + part * world[axis][k], 0));
    const best = along.map(Math.abs).indexOf(Math.max(...along.map(Math.abs)));
    return Math.abs(along[best]) > 0.9 ? names[best][along[best] > 0 ? 0 : 1] : "";
  }

  /** Report how many frames this browser draws, so that the scene is updated less often if they are few. */
  watchFrames() {
    if (document.hidden || this.isWatching) return;
    this.isWatching = true;
    const began = performance.now();
    let count = 0;
    const draw = () => {
      count += 1;
      const passed = performance.now() - began;
      if (passed < WATCHED_MS) requestAnimationFrame(draw);
      else {
        this.isWatching = false;
        this.connection.post("report-frame-rate", { rate: Math.min(1e4, (1000 * count) / passed) });
      }
    };
    requestAnimationFrame(draw);
  }
}
