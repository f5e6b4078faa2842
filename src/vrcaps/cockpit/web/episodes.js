// Page of one or two recorded episodes.

import { Connection } from "./connection.js";
import { Chart } from "./chart.js";
import { $, element, fillSelect, setDisabled, setHidden, setText, show, touch } from "./dom.js";
import { SceneSettings } from "./scenesettings.js";
import { SceneView } from "./sceneview.js";
import { notify, roving, sendFrom, setUpTabs } from "./shell.js";

let setup = null, status = {}, client = 0, charts = [], urls = {}, drawn = "";

const connection = new Connection({
  setup: begin,
  status: (values, viewpoint) => { status = values; showStatus(); scene.show(viewpoint); },
  notice: notify,
  image: showImage,
  online: (isOnline) => setHidden($("offline"), isOnline),
});
const COMMANDS = { KeyP: "play", KeyN: "next", KeyB: "previous", KeyC: "frame-capsule", KeyV: "frame-all" };
const scene = new SceneView(connection, takeKey);
const sceneSettings = new SceneSettings(connection);

function takeKey(event) {
  const { target, code } = event;
  if (event.type !== "keydown" || !COMMANDS[code] || event.ctrlKey || event.metaKey || event.altKey || target?.tagName === "SELECT") return false;
  const button = $(COMMANDS[code]);
  if (!button.disabled) button.click();
  return true;
}

function begin(values, number) {
  setup = values;
  if (client !== number) scene.open(number);
  client = number;
  $("frame").max = String(Math.max(values.times.length - 1, 1));
  fillSelect($("speed"), values.speeds, 1);
  fillSelect($("camera"), values.cameras);
  fillSelect($("channel"), values.channels);
  fillSelect($("alignment"), values.alignments);
  setHidden($("estimate"), !values.hasEstimate);
  $("estimate-color").style.background = values.estimateColor;
  $("cameras").replaceChildren(...values.episodes.map(({ name, color, folder }, k) => {
    const mark = element("i", { className: "swatch" });
    mark.style.background = color;
    const caption = element("p", { className: "note", title: folder }, mark, name, " ", element("span", { id: `caption-${k}` }));
    return element("div", { className: "panel camera" }, element("img", { id: `image-${k}`, className: "image", alt: `Image of the episode ${name}` }),
      element("div", { className: "caption" }, caption));
  }));
  charts = [0, 1].map((k) => {
    const chart = new Chart($(`chart-${k}`), values.charts, charts[k]?.index ?? k);
    chart.onChange = () => { drawn = ""; showCharts(); };
    return chart;
  });
  sceneSettings.begin(values);
}

function showImage(kind, blob) {
  const k = kind === "camera" ? 0 : 1, image = $(`image-${k}`), before = urls[k];
  if (!image) return;
  urls[k] = URL.createObjectURL(blob);
  image.src = urls[k];
  if (before) image.decode().catch(() => {}).finally(() => URL.revokeObjectURL(before));
}

function showStatus() {
  if (!setup) return;
  const { frame, isPlaying, captions } = status, label = isPlaying ? "Stop" : "Play", play = $("play");
  if (play.getAttribute("aria-label") !== label) {
    play.setAttribute("aria-label", label);
    play.title = `${label} (P)`;
    play.querySelector("use").setAttribute("href", `symbols.svg#${isPlaying ? "pause" : "play"}`);
  }
  show($("frame"), frame);
  setText($("time"), setup.times[frame].toFixed(2));
  setText($("frame-text"), `frame ${frame} of ${setup.times.length - 1}`);
  setDisabled($("previous"), frame <= 0);
  setDisabled($("next"), frame >= setup.times.length - 1);
  captions.forEach((text, k) => setText($(`caption-${k}`), text));
  show($("speed"), status.speed);
  show($("camera"), status.camera);
  show($("channel"), status.channel);
  show($("alignment"), status.alignment);
  setText($("estimate-text"), status.estimate);
  sceneSettings.show(status);
  showCharts();
}

function showCharts() {
  if (!setup || status.frame === undefined) return;
  const key = [status.frame, status.alignment, innerWidth, innerHeight].join();
  if (key === drawn) return;
  drawn = key;
  const times = setup.times, error = status.estimateErrors;
  for (const chart of charts) {
    const { lines, isEstimate } = setup.charts[chart.index];
    const shown = isEstimate ? [error ?? []] : lines;
    chart.show(shown[0][status.frame]);
    const colors = isEstimate ? [setup.estimateColor] : setup.episodes.map(({ color }) => color);
    chart.draw({ times, lines: shown, from: times[0], to: times.at(-1), mark: times[status.frame], colors });
  }
}

function select(frame) {
  sendFrom(null, connection, "select-frame", { frame: Math.max(0, Math.min(setup.times.length - 1, frame)) });
}

$("play").addEventListener("click", () => sendFrom($("play"), connection, status.isPlaying ? "pause" : "resume"));
$("previous").addEventListener("click", () => select(status.frame - 1));
$("next").addEventListener("click", () => select(status.frame + 1));
$("frame").addEventListener("input", () => { touch($("frame")); select(Number($("frame").value)); });
$("speed").addEventListener("change", () => { touch($("speed")); sendFrom(null, connection, "set-speed", { speed: Number($("speed").value) }); });
for (const id of ["camera", "channel"]) $(id).addEventListener("change", () => { touch($(id)); sendFrom(null, connection, "set-camera", { camera: $("camera").value, channel: $("channel").value }); });
$("alignment").addEventListener("change", () => { touch($("alignment")); sendFrom(null, connection, "align", { alignment: $("alignment").value }); });
for (const target of ["capsule", "all"]) $(`frame-${target}`).addEventListener("click", () => sendFrom($(`frame-${target}`), connection, "frame-view", { target }));
addEventListener("keydown", takeKey);
addEventListener("resize", showCharts);
setUpTabs();
roving($("run"), [$("play"), $("previous"), $("next")]);
