// Reads held keys and gamepads, and writes them into the page's text field as soon as they change.
if (!window.vrcapsBridge) {
  const MARK = "vrcaps:";
  const DEAD_ZONE = 0.12;
  const REPEAT_MS = 250; // while an axis is held: the simulation stops the magnet if nothing comes
  const KEYS = {
    KeyD: [0, 1], KeyA: [0, -1], KeyW: [1, 1], KeyS: [1, -1], KeyR: [2, 1], KeyF: [2, -1],
    KeyI: [3, 1], KeyK: [3, -1], KeyL: [4, 1], KeyJ: [4, -1], KeyE: [5, 1], KeyQ: [5, -1],
  };
  const BUTTONS = { 0: "pause", 1: "step", 2: "snapshot", 3: "policy" };
  const bridge = { held: new Set(), slow: false, pressed: {}, actions: [], last: "", sent: 0 };
  window.vrcapsBridge = bridge;

  const isTyping = (event) => {
    const at = event.target;
    return at && (at.isContentEditable || /^(INPUT|TEXTAREA|SELECT)$/.test(at.tagName));
  };
  window.addEventListener("keydown", (event) => {
    bridge.slow = event.shiftKey;
    if (!KEYS[event.code] || isTyping(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    bridge.held.add(event.code);
    event.stopImmediatePropagation(); // or the view would move, too
  }, true);
  window.addEventListener("keyup", (event) => {
    bridge.slow = event.shiftKey;
    bridge.held.delete(event.code);
  }, true);
  const letGo = () => bridge.held.clear();
  window.addEventListener("blur", letGo);
  document.addEventListener("visibilitychange", letGo);

  const beyondDeadZone = (value) => {
    const size = Math.abs(value || 0);
    return size < DEAD_ZONE ? 0 : Math.sign(value) * Math.min(1, (size - DEAD_ZONE) / (1 - DEAD_ZONE));
  };
  const firstPad = () => [...(navigator.getGamepads ? navigator.getGamepads() : [])].find((pad) => pad && pad.connected);
  const padAxes = (pad) => {
    const [x, y, turn, lift] = [0, 1, 2, 3].map((k) => beyondDeadZone(pad.axes[k]));
    const value = (k) => (pad.buttons[k] ? pad.buttons[k].value : 0);
    return [x, -y, -lift, value(7) - value(6), value(5) - value(4), -turn];
  };
  const notePressed = (pad) => {
    for (const [number, action] of Object.entries(BUTTONS)) {
      const isDown = Boolean(pad && pad.buttons[number] && pad.buttons[number].pressed);
      if (isDown && !bridge.pressed[number]) bridge.actions.push(action);
      bridge.pressed[number] = isDown;
    }
  };
  const axesNow = (pad) => {
    const axes = pad ? padAxes(pad) : [0, 0, 0, 0, 0, 0];
    for (const code of bridge.held) axes[KEYS[code][0]] += KEYS[code][1] * (bridge.slow ? 0.33 : 1);
    return axes.map((axis) => Math.round(1000 * Math.max(-1, Math.min(1, axis))) / 1000 + 0);
  };
  const findField = () => [...document.querySelectorAll("input")].find((field) => field.value.startsWith(MARK));
  const hide = (field) => { // the field's row, label and all
    let row = field;
    while (row.parentElement && row.parentElement.querySelectorAll("input, button, img").length <= 1) row = row.parentElement;
    row.style.display = "none";
  };
  const write = (field, text) => { // as if typed, so that the page's library sends it
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(field, text);
    field.dispatchEvent(new Event("input", { bubbles: true }));
  };

  setInterval(() => {
    const field = findField();
    if (!field) return;
    hide(field);
    const pad = firstPad();
    notePressed(pad);
    const axes = axesNow(pad);
    const said = { axes, pad: pad ? pad.id : "", standard: pad ? pad.mapping === "standard" : true };
    const text = JSON.stringify(said), now = performance.now();
    const isHeld = axes.some((axis) => axis !== 0);
    if (text === bridge.last && !bridge.actions.length && !(isHeld && now - bridge.sent > REPEAT_MS)) return;
    write(field, MARK + JSON.stringify({ ...said, actions: bridge.actions, at: Math.round(now) }));
    Object.assign(bridge, { last: text, sent: now, actions: [] });
  }, 33);
}
