// Reads held keys and gamepads, and writes them into the page's text field as soon as they change.
if (!window.vrcapsBridge) {
  const MARK = "vrcaps:", ASK = "vrcaps-ask:";
  const DEAD_ZONE = 0.12;
  const REPEAT_MS = 250; // while an axis is held: the simulation stops the magnet if nothing comes
  const LOOK_MS = 33; // from one look at the gamepad, which tells nothing by itself, to the next
  const LISTEN_MS = 10000; // for which a control waits to be assigned
  const KEYS = {
    KeyD: [0, 1], KeyA: [0, -1], KeyW: [1, 1], KeyS: [1, -1], KeyR: [2, 1], KeyF: [2, -1],
    KeyI: [3, 1], KeyK: [3, -1], KeyL: [4, 1], KeyJ: [4, -1], KeyE: [5, 1], KeyQ: [5, -1],
  };
  const AXES = ["x", "y", "z", "tilt-x", "tilt-y", "turn-z"];
  const ACTIONS = ["pause", "step", "snapshot", "policy"];
  const stick = (axis, sign, rest = 0) => ({ axis, sign, rest });
  const button = (number) => ({ button: number });
  const STANDARD = { // of the browsers' standard gamepad
    "x+": stick(0, 1), "x-": stick(0, -1), "y+": stick(1, -1), "y-": stick(1, 1),
    "z+": stick(3, -1), "z-": stick(3, 1), "tilt-x+": button(7), "tilt-x-": button(6),
    "tilt-y+": button(5), "tilt-y-": button(4), "turn-z+": stick(2, -1), "turn-z-": stick(2, 1),
    pause: button(0), step: button(1), snapshot: button(2), policy: button(3),
  };
  const STORE = "vrcaps-pads"; // layouts by the pads' names, kept by the browser
  const bridge = {
    held: new Set(), slow: false, pressed: {}, actions: [], last: "", sent: 0,
    shown: "", asked: null, listening: null, isMuted: false,
  };
  window.vrcapsBridge = bridge;

  const isTyping = (event) => {
    const at = event.target;
    return at && (at.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(at.tagName));
  };
  window.addEventListener("keydown", (event) => {
    bridge.slow = event.shiftKey;
    if (!KEYS[event.code] || isTyping(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    bridge.held.add(event.code);
    look();
    event.stopImmediatePropagation(); // or the view would move, too
  }, true);
  window.addEventListener("keyup", (event) => {
    bridge.slow = event.shiftKey;
    bridge.held.delete(event.code);
    look();
  }, true);
  const letGo = () => bridge.held.clear();
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", letGo);

  const stored = () => {
    try { return JSON.parse(localStorage.getItem(STORE)) || {}; } catch { return {}; }
  };
  const layouts = stored();
  const keep = (pad, layout) => {
    layouts[pad.id] = layout;
    try { localStorage.setItem(STORE, JSON.stringify(layouts)); } catch { /* kept until the page is closed */ }
  };
  // A pad of unknown layout drives nothing before it is assigned: its rest may be a full axis.
  const layoutOf = (pad) => layouts[pad.id] || (pad.mapping === "standard" ? STANDARD : {});

  const beyondDeadZone = (size) => (size < DEAD_ZONE ? 0 : Math.min(1, (size - DEAD_ZONE) / (1 - DEAD_ZONE)));
  const valueOf = (pad, source) => { // 0 to 1
    if (!source) return 0;
    if (source.button !== undefined) return (pad.buttons[source.button] || { value: 0 }).value;
    const size = (source.sign * ((pad.axes[source.axis] || 0) - source.rest)) / (1 - source.sign * source.rest);
    return beyondDeadZone(Math.max(0, size));
  };
  const isPressed = (pad, source) => {
    if (!source) return false;
    if (source.button !== undefined) return Boolean(pad.buttons[source.button] && pad.buttons[source.button].pressed);
    return valueOf(pad, source) > 0.5;
  };
  const firstPad = () => [...(navigator.getGamepads ? navigator.getGamepads() : [])].find((pad) => pad && pad.connected);
  const padAxes = (pad, layout) => AXES.map((name) => valueOf(pad, layout[`${name}+`]) - valueOf(pad, layout[`${name}-`]));
  const notePressed = (pad, layout) => {
    for (const action of ACTIONS) {
      const isDown = Boolean(pad) && isPressed(pad, layout[action]);
      if (isDown && !bridge.pressed[action] && !bridge.isMuted) bridge.actions.push(action);
      bridge.pressed[action] = isDown;
    }
  };
  const axesNow = (pad, layout) => {
    const axes = pad && !bridge.isMuted ? padAxes(pad, layout) : [0, 0, 0, 0, 0, 0];
    for (const code of bridge.held) axes[KEYS[code][0]] += KEYS[code][1] * (bridge.slow ? 0.33 : 1);
    return axes.map((axis) => Math.round(1000 * Math.max(-1, Math.min(1, axis))) / 1000 + 0);
  };

  const restOf = (pad) => ({ axes: [...pad.axes], buttons: pad.buttons.map((each) => each.pressed) });
  const isBeyond = (source, rest) => (pad) => // whether what was pushed to be assigned is still held
    Boolean(source && pad) && (source.button === undefined
      ? Math.abs(pad.axes[source.axis] - rest.axes[source.axis]) > 0.5
      : Boolean(pad.buttons[source.button] && pad.buttons[source.button].pressed));
  const movedFrom = (pad, rest) => { // what was pressed or pushed since; null if nothing
    const pressed = pad.buttons.findIndex((each, k) => each.pressed && !rest.buttons[k]);
    if (pressed >= 0) return button(pressed);
    const axis = pad.axes.findIndex((value, k) => Math.abs(value - rest.axes[k]) > 0.5);
    if (axis < 0) return null;
    return stick(axis, Math.sign(pad.axes[axis] - rest.axes[axis]), Math.round(rest.axes[axis]) + 0);
  };
  const assign = (pad, control, source) => {
    const layout = { ...layoutOf(pad), [control]: source };
    const opposite = control.slice(0, -1) + (control.endsWith("+") ? "-" : "+");
    if (/[+-]$/.test(control) && source.axis !== undefined && source.rest === 0) {
      layout[opposite] = stick(source.axis, -source.sign); // a stick goes both ways
    }
    keep(pad, layout);
  };
  const hearAsk = (text, pad, now) => { // a control that is to be assigned, as the page's other field says
    const { number, control } = JSON.parse(text.slice(ASK.length));
    if (bridge.asked === null || number === 0) bridge.asked = number;
    if (number === bridge.asked) return;
    bridge.asked = number;
    bridge.shown = "";
    if (!pad) return;
    if (control === "standard") keep(pad, STANDARD);
    else Object.assign(bridge, { listening: { control, rest: restOf(pad), until: now + LISTEN_MS }, isMuted: true });
  };
  const listen = (pad, now) => {
    const { control, rest, until } = bridge.listening;
    const source = pad && movedFrom(pad, rest);
    if (source) assign(pad, control, source);
    if (source || !pad || now > until) Object.assign(bridge, { listening: null, shown: "", isHeld: isBeyond(source, rest) });
  };
  const layoutText = (pad, layout) => {
    const name = ({ axis, sign, button: number }) => (axis === undefined ? `button ${number}` : `axis ${axis} ${sign > 0 ? "+" : "−"}`);
    return Object.fromEntries(Object.entries(layout).map(([control, source]) => [control, name(source)]));
  };

  const fieldOf = (mark) => [...document.querySelectorAll("input")].find((field) => field.value.startsWith(mark));
  const hide = (field) => { // the field's row, label and all
    let row = field;
    while (row.parentElement && row.parentElement.querySelectorAll("input, button, img").length <= 1) row = row.parentElement;
    row.style.display = "none";
  };
  const write = (field, text) => { // as if typed, so that the page's library sends it
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field, text);
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };

  const look = () => {
    const field = fieldOf(MARK), ask = fieldOf(ASK);
    if (!field || !ask) return;
    hide(field);
    hide(ask);
    const pad = firstPad(), now = performance.now();
    hearAsk(ask.value, pad, now);
    if (bridge.listening) listen(pad, now);
    else if (bridge.isMuted && !bridge.isHeld(pad)) bridge.isMuted = false; // it drives after it was let go
    const layout = pad ? layoutOf(pad) : {};
    notePressed(pad, layout);
    const axes = axesNow(pad, layout);
    const said = { axes, pad: pad ? pad.id : "", standard: pad ? pad.mapping === "standard" : true };
    const shown = JSON.stringify([said.pad, layoutText(pad, layout), bridge.listening && bridge.listening.control]);
    if (shown !== bridge.shown) Object.assign(said, { layout: layoutText(pad, layout), listening: bridge.listening ? bridge.listening.control : "" });
    const text = JSON.stringify({ axes, pad: said.pad });
    const isHeld = axes.some((axis) => axis !== 0), isNews = text !== bridge.last || shown !== bridge.shown;
    if (!isNews && !bridge.actions.length && !(isHeld && now - bridge.sent > REPEAT_MS)) return;
    write(field, MARK + JSON.stringify({ ...said, actions: bridge.actions, at: Math.round(now) }));
    Object.assign(bridge, { last: text, sent: now, actions: [], shown });
  };
  setInterval(look, LOOK_MS);
}
