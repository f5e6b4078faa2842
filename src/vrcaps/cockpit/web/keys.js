// Keys that drive and keys of commands, on the keyboard and on the image (touch).

import { $, setText } from "./dom.js";
import { roving } from "./shell.js";

const REPEAT_MS = 250; // while an axis is held: the simulation stops the magnet if nothing comes
const LOOK_MS = 33;
const SLOW = 0.33;
const KEYS = {
  KeyD: [0, 1, "Move"], KeyA: [0, -1, "Move"], KeyW: [1, 1, "Move"], KeyS: [1, -1, "Move"], KeyR: [2, 1, "Move"], KeyF: [2, -1, "Move"],
  KeyI: [3, 1, "Tilt"], KeyK: [3, -1, "Tilt"], KeyL: [4, 1, "Tilt"], KeyJ: [4, -1, "Tilt"], KeyE: [5, 1, "Turn"], KeyQ: [5, -1, "Turn"],
};

const isTyping = ({ target }) => Boolean(target && (target.isContentEditable || target.tagName === "TEXTAREA" || target.tagName === "SELECT"
  || (target.tagName === "INPUT" && !["range", "checkbox", "button"].includes(target.type))));
const isModal = () => Boolean(document.querySelector("dialog:modal"));

export class Keys {
  /** post(axes) sends axes; commands are functions by the code of their key. */
  constructor({ post, commands, pads, onAction }) {
    Object.assign(this, { post, commands, pads, onAction, held: new Set(), slow: false, last: "", sent: 0, isEnabled: true });
    addEventListener("keydown", (event) => { if (this.take(event)) event.preventDefault(); });
    addEventListener("keyup", (event) => this.take(event));
    const letGo = () => { this.held.clear(); this.look(); };
    addEventListener("blur", letGo);
    document.addEventListener("visibilitychange", letGo);
    this.buttons = [...document.querySelectorAll(".keys [data-code]")];
    this.buttons.forEach((each) => this.bindButton(each));
    for (const group of document.querySelectorAll(".keys")) roving(group, [...group.querySelectorAll("button")]);
    setInterval(() => this.look(), LOOK_MS);
  }

  /** Handle a key; return whether nothing else may handle it. */
  take(event) {
    this.slow = event.shiftKey;
    if (event.type === "keyup") {
      const was = this.held.delete(event.code);
      if (was) this.look();
      return false;
    }
    if (isTyping(event) || isModal() || event.ctrlKey || event.metaKey || event.altKey) return false;
    if (KEYS[event.code]) {
      if (this.isEnabled) this.held.add(event.code);
      this.look();
      return true;
    }
    const command = this.commands[event.code];
    if (!command) return false;
    if (!event.repeat) command();
    return true;
  }

  bindButton(key) {
    const { code } = key.dataset;
    const press = (event) => {
      if (!this.isEnabled) return;
      if (event.pointerId !== undefined) key.setPointerCapture(event.pointerId);
      this.held.add(code);
      this.look();
    };
    const release = () => { this.held.delete(code); this.look(); };
    key.addEventListener("pointerdown", press);
    for (const type of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) key.addEventListener(type, release);
    key.addEventListener("contextmenu", (event) => event.preventDefault());
    key.addEventListener("keydown", (event) => { if (event.code === "Space" || event.code === "Enter") { event.preventDefault(); press(event); } });
    key.addEventListener("keyup", (event) => { if (event.code === "Space" || event.code === "Enter") release(); });
  }

  /** Names of the keys, with the patient's directions. */
  label(directionOf) {
    for (const key of this.buttons) {
      const [axis, sign, verb] = KEYS[key.dataset.code], letter = key.dataset.code.slice(3);
      const place = axis < 3 ? directionOf(axis, sign) : "";
      const towards = `${sign > 0 ? "+" : "−"}${"xyz"[axis % 3]}`;
      const text = axis >= 3 ? `${verb} about ${towards}` : axis === 2 ? `${verb} ${sign > 0 ? "up" : "down"}` : `${verb} to ${towards}`;
      const full = `${letter}: ${text}${place ? ` (patient's ${place})` : ""}`;
      if (key.title !== full) {
        key.title = full;
        key.setAttribute("aria-label", full);
      }
    }
  }

  look() {
    const { axes, actions } = this.pads.look();
    if (!this.isEnabled) {
      this.held.clear();
      if (actions.length || axes.some((axis) => axis !== 0)) this.onAction("refused");
      axes.fill(0);
      actions.length = 0;
    }
    for (const code of this.held) axes[KEYS[code][0]] += KEYS[code][1] * (this.slow ? SLOW : 1);
    for (const key of this.buttons) key.classList.toggle("down", this.held.has(key.dataset.code));
    actions.forEach((action) => this.onAction(action));
    const rounded = axes.map((axis) => Math.round(1000 * Math.max(-1, Math.min(1, axis))) / 1000 + 0);
    const text = rounded.join(), now = performance.now(), isHeld = rounded.some((axis) => axis !== 0);
    const isFirst = this.last === "" && !isHeld;
    if (!isFirst && (text !== this.last || (isHeld && now - this.sent > REPEAT_MS))) {
      this.post(rounded);
      this.last = text;
      this.sent = now;
    }
  }
}

/** Table of a gamepad's layout. */
export function showPad({ name, layout, listening, isKnown }, controls) {
  setText($("pad-name"), name ? name.slice(0, 40) : "none detected");
  const hint = $("pad-hint");
  if (listening) setText(hint, `Move the stick or press the button for: ${controls[listening]}.`);
  else if (!name) setText(hint, "Press one of its buttons, so that the browser detects it.");
  else setText(hint, isKnown ? "Choose a function and assign another control, if you like." : "Its layout is unknown: assign its sticks to use it.");
  $("pad-assign").disabled = $("pad-standard").disabled = !name;
  const table = $("pad-table");
  table.hidden = !name;
  const rows = Object.entries(controls).map(([control, label]) => `${label}\t${layout[control] ?? "–"}`);
  if (table.dataset.rows === rows.join("\n")) return;
  table.dataset.rows = rows.join("\n");
  table.tBodies[0].replaceChildren(...rows.map((row) => {
    const line = document.createElement("tr");
    for (const cell of row.split("\t")) line.insertCell().textContent = cell;
    return line;
  }));
}
