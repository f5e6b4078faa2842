// Gamepads: standard and own layouts, which the browser keeps by the pads' names.

const DEAD_ZONE = 0.12;
const LISTEN_MS = 10000; // for which a control waits to be assigned
const STORE = "vrcaps-pads";
const AXES = ["x", "y", "z", "tilt-x", "tilt-y", "turn-z"];
const ACTIONS = ["pause", "step", "snapshot", "policy"];
const stick = (axis, sign, rest = 0) => ({ axis, sign, rest });
const button = (number) => ({ button: number });
const STANDARD = {
  "x+": stick(0, 1), "x-": stick(0, -1), "y+": stick(1, -1), "y-": stick(1, 1),
  "z+": stick(3, -1), "z-": stick(3, 1), "tilt-x+": button(7), "tilt-x-": button(6),
  "tilt-y+": button(5), "tilt-y-": button(4), "turn-z+": stick(2, -1), "turn-z-": stick(2, 1),
  pause: button(0), step: button(1), snapshot: button(2), policy: button(3),
};

const beyondDeadZone = (size) => (size < DEAD_ZONE ? 0 : Math.min(1, (size - DEAD_ZONE) / (1 - DEAD_ZONE)));

function valueOf(pad, source) { // 0 to 1
  if (!source) return 0;
  if (source.button !== undefined) return (pad.buttons[source.button] || { value: 0 }).value;
  const size = (source.sign * ((pad.axes[source.axis] || 0) - source.rest)) / (1 - source.sign * source.rest);
  return beyondDeadZone(Math.max(0, size));
}

function isPressed(pad, source) {
  if (!source) return false;
  if (source.button !== undefined) return Boolean(pad.buttons[source.button] && pad.buttons[source.button].pressed);
  return valueOf(pad, source) > 0.5;
}

const restOf = (pad) => ({ axes: [...pad.axes], buttons: pad.buttons.map((each) => each.pressed) });

function movedFrom(pad, rest) { // what was pressed or pushed since; null if nothing
  const pressed = pad.buttons.findIndex((each, k) => each.pressed && !rest.buttons[k]);
  if (pressed >= 0) return button(pressed);
  const axis = pad.axes.findIndex((value, k) => Math.abs(value - rest.axes[k]) > 0.5);
  if (axis < 0) return null;
  return stick(axis, Math.sign(pad.axes[axis] - rest.axes[axis]), Math.round(rest.axes[axis]) + 0);
}

const isBeyond = (source, rest) => (pad) => // whether what was pushed to be assigned is still held
  Boolean(source && pad) && (source.button === undefined
    ? Math.abs(pad.axes[source.axis] - rest.axes[source.axis]) > 0.5
    : Boolean(pad.buttons[source.button] && pad.buttons[source.button].pressed));

function stored() {
  try { return JSON.parse(localStorage.getItem(STORE)) || {}; } catch { return {}; }
}

const nameOf = ({ axis, sign, button: number }) => (axis === undefined ? `button ${number}` : `axis ${axis} ${sign > 0 ? "+" : "−"}`);

export class Gamepads {
  constructor() {
    this.layouts = stored();
    this.pressed = {};
    this.listening = null;
    this.isMuted = false;
  }

  get pad() {
    return [...(navigator.getGamepads ? navigator.getGamepads() : [])].find((pad) => pad && pad.connected) || null;
  }

  // A pad of unknown layout drives nothing before it is assigned: its rest may be a full axis.
  layoutOf(pad) {
    return this.layouts[pad.id] || (pad.mapping === "standard" ? STANDARD : {});
  }

  keep(pad, layout) {
    this.layouts[pad.id] = layout;
    try { localStorage.setItem(STORE, JSON.stringify(this.layouts)); } catch { /* kept until the page is closed */ }
  }

  useStandard() {
    if (this.pad) this.keep(this.pad, STANDARD);
  }

  /** Assign the next button or stick that is used to a control. */
  assignNext(control) {
    if (!this.pad) return;
    this.listening = { control, rest: restOf(this.pad), until: performance.now() + LISTEN_MS };
    this.isMuted = true;
  }

  /** Axes and new actions now. */
  look() {
    const pad = this.pad;
    if (this.listening) this.listen(pad);
    else if (this.isMuted && !this.isHeld(pad)) this.isMuted = false; // it drives after it was let go
    const layout = pad ? this.layoutOf(pad) : {}, actions = [];
    for (const action of ACTIONS) {
      const isDown = Boolean(pad) && isPressed(pad, layout[action]);
      if (isDown && !this.pressed[action] && !this.isMuted) actions.push(action);
      this.pressed[action] = isDown;
    }
    const isDriving = pad && !this.isMuted;
    const axes = AXES.map((name) => (isDriving ? valueOf(pad, layout[`${name}+`]) - valueOf(pad, layout[`${name}-`]) : 0));
    return { axes, actions };
  }

  listen(pad) {
    const { control, rest, until } = this.listening;
    const source = pad && movedFrom(pad, rest);
    if (source) this.assign(pad, control, source);
    if (source || !pad || performance.now() > until) {
      this.listening = null;
      this.isHeld = isBeyond(source, rest);
    }
  }

  assign(pad, control, source) {
    const layout = { ...this.layoutOf(pad), [control]: source };
    const opposite = control.slice(0, -1) + (control.endsWith("+") ? "-" : "+");
    if (/[+-]$/.test(control) && source.axis !== undefined && source.rest === 0) {
      layout[opposite] = stick(source.axis, -source.sign); // a stick goes both ways
    }
    this.keep(pad, layout);
  }

  /** Name, layout as strings and the control that waits for assignment. */
  describe() {
    const pad = this.pad;
    if (!pad) return { name: "", layout: {}, listening: "", isKnown: true };
    const layout = this.layoutOf(pad);
    return {
      name: pad.id,
      layout: Object.fromEntries(Object.entries(layout).map(([control, source]) => [control, nameOf(source)])),
      listening: this.listening ? this.listening.control : "",
      isKnown: Object.keys(layout).length > 0,
    };
  }
}
