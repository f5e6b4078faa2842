// Page of a drive.

import { Connection } from "./connection.js";
import { Chart } from "./chart.js";
import { $, element, fillSelect, setDisabled, setHidden, setText, show, sliderRow, touch } from "./dom.js";
import { Gamepads } from "./gamepad.js";
import { Keys, showPad } from "./keys.js";
import { NewDriveForm } from "./newdrive.js";
import { SceneSettings } from "./scenesettings.js";
import { SceneView } from "./sceneview.js";
import { Tour, confirmed, copyButton, notify, roving, sendFrom, setUpTabs } from "./shell.js";

const TOUR = [
  { target: "camera-panel", title: "The capsule's view", text: "The live image of the capsule's camera. At its top: whether the magnet holds the capsule, and what limits the magnet." },
  { target: "keys-move", title: "Drive with keys", text: "Hold these keys, on the keyboard or here, to move, turn and tilt the magnet. A gamepad works, too, and so do the arrows at the magnet in the scene." },
  { target: "scene-panel", title: "The scene", text: "Organ, capsule, magnet and patient, with the patient's directions and a scale. Drag to look around; C frames the capsule." },
  { target: "run", title: "Time", text: "Pause, go on by single frames, or reset to the first frame. Everything you do is saved each second." },
  { target: "record", title: "Record an episode", text: "Renders the drive so far as an episode with images and labels, while you drive on. All other settings are in the tabs at the side. H shows this tour again." },
];

let setup = null, status = {}, client = 0, rows = [], urls = {}, optimistic = {};

const connection = new Connection({
  setup: (values, number) => begin(values, number),
  status: (values, viewpoint) => { status = values; showStatus(); scene.show(viewpoint); keys.label((axis, sign) => scene.directionOf(axis, sign)); },
  notice: notify,
  image: showImage,
  online: (isOnline) => setHidden($("offline"), isOnline),
});
const pads = new Gamepads();
const press = (id) => () => { const button = $(id); if (!button.disabled && !button.hidden) button.click(); };
const keys = new Keys({
  post: (axes) => connection.post("steer", { axes }),
  pads,
  commands: {
    KeyP: press("pause"), KeyN: press("step"), KeyB: press("save-snapshot"), KeyT: press("start-policy"), KeyX: press("stop-magnet"),
    KeyC: press("frame-capsule"), KeyV: press("frame-all"), KeyH: press("help"),
  },
  onAction: (action) => ({ pause: press("pause"), step: press("step"), snapshot: press("save-snapshot"), policy: press("start-policy"), refused })[action](),
});
const scene = new SceneView(connection, (event) => keys.take(event));
const sceneSettings = new SceneSettings(connection);
const newDrive = new NewDriveForm(connection);
const tour = new Tour(TOUR);
let charts = [], refusedAt = -1e9;

function refused() {
  if (performance.now() - refusedAt < 5000) return;
  refusedAt = performance.now();
  notify("Another browser drives. Choose 'Take control' to take over.", true);
}

function begin(values, number) {
  setup = values;
  rows = values.history;
  optimistic = {};
  if (client !== number) scene.open(number);
  client = number;
  setText($("folder"), values.folder);
  fillSelect($("speed"), values.speeds, 1);
  fillSelect($("camera"), values.cameras.map(({ name }) => name));
  setHidden($("camera"), values.cameras.length < 2);
  fillSelect($("channel"), values.channels);
  fillSelect($("policy"), values.policies.length ? values.policies : [{ value: "", label: "none for coils" }]);
  fillSelect($("posture"), values.postures, values.posture);
  fillSelect($("light"), values.lights);
  fillSelect($("imaging"), values.imagings);
  fillSelect($("pad-control"), Object.entries(values.controls).map(([value, label]) => ({ value, label })));
  setText($("max-severity"), String(values.maxSeverity));
  buildEffects();
  buildSegments();
  buildCoils();
  charts = [0, 1].map((k) => {
    const chart = new Chart($(`chart-${k}`), values.quantities, charts[k]?.index ?? k);
    chart.onChange = drawCharts;
    return chart;
  });
  sceneSettings.begin(values);
  newDrive.begin(values.newDrive, values.maxSeverity);
  tour.startOnce();
}

function buildEffects() {
  $("effects").replaceChildren(...setup.liveEffects.map(({ name, label, hint }) => {
    const { row, input } = sliderRow({ id: `effect-${name}`, label, hint, max: setup.maxSeverity, value: 0, attributes: { "data-driver": "" } });
    input.dataset.effect = name;
    input.addEventListener("change", () => { touch(input); sendRendering(input); });
    return row;
  }));
}

function buildSegments() {
  $("segments").replaceChildren(...setup.segments.map(({ name, start, end }) => {
    const part = element("li", { textContent: name, title: name });
    Object.assign(part.style, { left: `${100 * start}%`, width: `${100 * (end - start)}%` });
    return part;
  }));
}

function buildCoils() {
  const { coils } = setup, has = coils.length > 0, name = (magnet, other) => (has ? other : magnet);
  setHidden($("coils"), !has);
  setText($("coils-max"), has ? `${Math.max(...coils.map((coil) => coil.maxCurrent))} A` : "");
  $("coil-rows").replaceChildren(...coils.map((coil, k) => {
    const label = element("label", { htmlFor: `coil-${k + 1}` }, element("span", { className: "visually-hidden", textContent: "Set current of coil " }), String(k + 1), element("span", { className: "visually-hidden", textContent: " in ampere" }));
    return element("tr", {}, element("th", { scope: "row" }, label), element("td", {}, ...coilSlider(coil, k)), element("td", {}), element("td", {}));
  }));
  setText($("limited"), name("Magnet", "Coils"));
  setText($("keys-move-text"), name("Move, turn", "Pull, torque"));
  setText($("shift-text"), name("slow", "weak"));
  setText($("keys-tilt-text"), name("Tilt", "Torque"));
  setText($("stop-magnet-text"), name("Stop the magnet", "Switch the coils off"));
  $("keys-move").setAttribute("aria-label", name("Move and turn the magnet", "Pull and turn the capsule by the coils"));
  $("keys-tilt").setAttribute("aria-label", name("Tilt the magnet", "Tilt the capsule by the coils"));
}

/** Slider of a coil's current; while it moves, one command at a time is on its way. */
function coilSlider({ maxCurrent }, k) {
  const input = element("input", { type: "range", id: `coil-${k + 1}`, min: -maxCurrent, max: maxCurrent, step: maxCurrent / 60, value: 0, "data-driver": "", "aria-describedby": "coils-hint" });
  let sent = null, isBusy = false;
  const send = async () => {
    if (isBusy || sent === input.value) return;
    isBusy = true;
    sent = input.value;
    const answer = await sendFrom(input, connection, "set-current", { coil: k + 1, current: Number(input.value) });
    isBusy = false;
    if (answer.error) delete input.dataset.touched;
    else send();
  };
  input.addEventListener("input", () => { touch(input); setText(input.nextElementSibling, amperes(input.value)); send(); });
  input.addEventListener("change", () => { sent = null; send(); });
  return [input, element("output", { for: input.id, textContent: amperes(0) })];
}

const amperes = (value) => `${Number(value).toFixed(1)} A`;

function showCoils() {
  const rows = $("coil-rows").children;
  (status.coils ?? []).slice(0, rows.length).forEach(([current, temperature], k) => {
    const { maxCurrent, maxTemperature } = setup.coils[k], [, set, actual, degrees] = rows[k].children, [slider, value] = set.children;
    show(slider, status.setCurrents[k]);
    setText(value, amperes(slider.value));
    slider.setAttribute("aria-valuetext", amperes(slider.value));
    setText(actual, amperes(current));
    setText(degrees, `${temperature.toFixed(1)} of ${maxTemperature} °C`);
    actual.classList.toggle("warn", Math.abs(current) > 0.95 * maxCurrent);
    degrees.classList.toggle("warn", temperature > 0.9 * maxTemperature);
  });
}

function couplingText(isLost) {
  if (setup.hasMagnet !== false) return isLost ? `Magnet lost: ${status.lost}` : "Magnet coupled";
  if (isLost) return `Coils too weak: ${status.lost}`;
  const most = Math.max(0, ...(status.coils ?? []).map(([current]) => Math.abs(current)));
  return most < 0.05 ? "Coils off" : `Coils on, up to ${most.toFixed(1)} A`;
}

function sendRendering(changed) {
  touch(changed);
  const effects = [...document.querySelectorAll("[data-effect]")].map(({ dataset, value }) => ({ name: dataset.effect, severity: Number(value) }));
  sendFrom(null, connection, "set-rendering", { light: $("light").value, imaging: $("imaging").value, always_shadows: $("always-shadows").checked, effects });
}

function showImage(kind, blob) {
  const image = $(kind === "map" ? "map" : "camera-image"), before = urls[kind];
  urls[kind] = URL.createObjectURL(blob);
  image.src = urls[kind];
  if (before) image.decode().catch(() => {}).finally(() => URL.revokeObjectURL(before));
  if (kind === "camera") setHidden($("camera-waiting"), true);
}

function showStatus() {
  if (!setup) return;
  const isDriver = status.driver === client;
  showBar(isDriver);
  showCamera();
  showValues();
  const has = (list) => list && list.length > 0;
  const snapshots = status.snapshots ?? [];
  fillSelect($("snapshot"), has(snapshots) ? snapshots : [{ value: "", label: "none yet" }], $("snapshot").value || snapshots.at(-1));
  keys.isEnabled = isDriver;
  for (const control of document.querySelectorAll("[data-driver]")) {
    const hasNoObject = (control.id === "rewind" || control.id === "snapshot") ? !has(snapshots)
      : control.id === "reset" ? !(status.frame > 0)
      : control.id === "stop-magnet" ? !status.isSteering
      : ["policy", "start-policy", "goal"].includes(control.id) ? !setup.policies.length
      : control.id === "flush" ? !status.hasContents
      : control.id === "record" || control.id === "start-drive" ? status.isBusy || status.isSettling !== false
      : false;
    setDisabled(control, !isDriver || hasNoObject);
  }
  keys.buttons.forEach((each) => setDisabled(each, !isDriver));
  setText($("start-policy-text"), status.policy ? "Stop the policy" : "Start the policy");
  show($("light"), status.light);
  show($("imaging"), status.imaging);
  show($("always-shadows"), status.alwaysShadows);
  for (const slider of document.querySelectorAll("[data-effect]")) {
    show(slider, status.effects[slider.dataset.effect]);
    setText(slider.nextElementSibling, slider.value);
  }
  sceneSettings.show(status);
  showRecording();
}

function isPaused() {
  const { paused, until } = optimistic;
  return paused !== undefined && performance.now() < until && paused !== status.isPaused ? paused : Boolean(status.isPaused);
}

function showBar(isDriver) {
  setText($("time"), (status.time ?? 0).toFixed(1));
  const images = `${(status.achievedSpeed ?? 0).toFixed(2)} × real time`;
  setText($("pace"), status.isSettling !== false ? "the capsule settles …" : isPaused() ? "paused" : images);
  const label = isPaused() ? "Resume" : "Pause", pause = $("pause");
  if (pause.getAttribute("aria-label") !== label) {
    pause.setAttribute("aria-label", label);
    pause.title = `${label} (P)`;
    pause.querySelector("use").setAttribute("href", `symbols.svg#${isPaused() ? "play" : "pause"}`);
  }
  show($("speed"), status.speed);
  const who = status.policy ? `Policy ${status.policy} drives` : isDriver ? "You drive" : status.driver === null ? "No one drives" : `Browser ${status.driver} drives`;
  setText($("driver"), who);
  setHidden($("take-control"), isDriver);
}

function showCamera() {
  const isLost = Boolean(status.lost), coupling = $("coupling");
  coupling.classList.toggle("lost", isLost);
  setText($("coupling-text"), couplingText(isLost));
  showCoils();
  setHidden($("limit"), !status.limit);
  setText($("limit-text"), status.limit || "");
  setText($("image-rate"), `${Math.round(status.imageRate)} images/s${status.leavesOutShadows ? ", no shadows" : ""}`);
  show($("camera"), status.camera);
  show($("channel"), status.channel);
}

function showValues() {
  setText($("coverage"), status.coverage.toFixed(1));
  const [x, y] = status.mapPlace, dot = $("map-dot");
  Object.assign(dot.style, { left: `${100 * x}%`, top: `${100 * y}%` });
  setText($("segment"), status.segment ? `in: ${status.segment}` : "");
  for (const part of $("segments").children) part.classList.toggle("here", part.textContent === status.segment);
  const time = status.time ?? 0, last = rows.at(-1);
  if (last && time < last[0]) rows = rows.filter((row) => row[0] < time);
  if (status.isSettling === false && (!rows.length || time - rows.at(-1)[0] >= 0.1)) rows.push([time, ...status.readings]);
  while (rows.length && time - rows[0][0] > setup.chartSpan) rows.shift();
  charts.forEach((chart) => chart.show(status.readings[chart.index]));
}

function drawCharts() {
  const to = Math.max(status.time ?? 0, setup ? Math.min(setup.chartSpan, 10) : 10), from = Math.max(0, to - (setup?.chartSpan ?? 60));
  const times = rows.map((row) => row[0]);
  charts.forEach((chart, k) => chart.draw({ times, lines: [rows.map((row) => row[chart.index + 1])], from, to, colors: [["#6cb8ff", "#ffb84d"][k]] }));
}

function showRecording() {
  const { state, done = 0, total = 0, folder = "", error = "" } = status.recording ?? { state: "none" };
  const key = JSON.stringify(status.recording), panel = $("recording");
  if (panel.dataset.key === key) return;
  panel.dataset.key = key;
  setHidden(panel, state === "none");
  const isEnd = state === "complete" || state === "failed";
  setText($("recording-text"), { running: total ? `Recording frame ${done} of ${total}` : "Preparing the recording …", complete: `Episode recorded: ${total} of ${total} frames`, failed: `Not recorded: ${error}` }[state] ?? "");
  Object.assign($("recording-progress"), { max: Math.max(total, 1), value: done });
  setHidden($("recording-progress"), isEnd);
  setHidden($("recording-folder"), !folder);
  setText($("recording-path"), folder);
  setHidden($("copy-view"), state !== "complete");
  setHidden($("recording-close"), !isEnd);
}

function bind(id, command, fields = () => ({}), ask = null) {
  const button = $(id);
  button.addEventListener("click", async () => {
    if (ask && !(await confirmed(ask()))) return;
    sendFrom(button, connection, command, fields());
  });
}

function bindAll() {
  $("pause").addEventListener("click", () => {
    const paused = !isPaused();
    optimistic = { paused, until: performance.now() + 1000 };
    showBar(status.driver === client);
    sendFrom($("pause"), connection, paused ? "pause" : "resume");
  });
  bind("step", "step-frame");
  bind("reset", "reset", undefined, () => ({ title: "Reset to the first frame?", text: `The drive so far, ${(status.time ?? 0).toFixed(1)} s with its snapshots, is discarded.`, yes: "Reset" }));
  bind("take-control", "take-control");
  bind("record", "record");
  bind("stop-magnet", "stop-magnet");
  bind("save-snapshot", "save-snapshot");
  bind("rewind", "rewind", () => ({ snapshot: $("snapshot").value }), () => ({ title: `Rewind to ${$("snapshot").value}?`, text: "What you did after this snapshot, and later snapshots, are discarded.", yes: "Rewind" }));
  $("start-policy").addEventListener("click", () => {
    if (status.policy) sendFrom($("start-policy"), connection, "stop-magnet");
    else sendFrom($("start-policy"), connection, "start-policy", { policy: $("policy").value, goal: Number($("goal").value) });
  });
  bind("turn", "turn-patient", () => ({ posture: $("posture").value }));
  bind("insufflate", "insufflate", () => ({ factor: Number($("insufflation").value) }));
  bind("flush", "flush");
  bind("phase-three", "start-phase-three");
  bind("frame-capsule", "frame-view", () => ({ target: "capsule" }));
  bind("frame-all", "frame-view", () => ({ target: "all" }));
  $("speed").addEventListener("change", () => { touch($("speed")); sendFrom(null, connection, "set-speed", { speed: Number($("speed").value) }); });
  for (const id of ["camera", "channel"]) $(id).addEventListener("change", () => { touch($(id)); sendFrom(null, connection, "set-camera", { camera: $("camera").value, channel: $("channel").value }); });
  for (const id of ["light", "imaging", "always-shadows"]) $(id).addEventListener("change", () => sendRendering($(id)));
  $("goal").addEventListener("input", () => setText($("goal-value"), `${Math.round(100 * $("goal").value)} %`));
  $("insufflation").addEventListener("input", () => setText($("insufflation-value"), `${Number($("insufflation").value).toFixed(2)} ×`));
  $("pad-assign").addEventListener("click", () => pads.assignNext($("pad-control").value));
  $("pad-standard").addEventListener("click", () => pads.useStandard());
  $("help").addEventListener("click", () => tour.start());
  $("recording-close").addEventListener("click", () => setHidden($("recording"), true));
  copyButton($("copy-folder"), () => setup.folder);
  copyButton($("copy-view"), () => `vrcaps view ${status.recording.folder}`);
}

setUpTabs();
roving($("run"), [$("pause"), $("step"), $("reset")]);
bindAll();
setInterval(drawCharts, 250);
setInterval(() => { if (setup) showPad(pads.describe(), setup.controls); }, 100);
addEventListener("resize", drawCharts);
