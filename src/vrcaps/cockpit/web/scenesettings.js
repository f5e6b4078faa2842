// Display settings of the scene, shared by both pages.

import { $, element, fillSelect, setDisabled, setHidden, setText, show, touch } from "./dom.js";
import { sendFrom } from "./shell.js";

const IDS = ["coloring", "opacity", "cut", "cut-fraction", "has-lines", "has-patient"];

export class SceneSettings {
  constructor(connection) {
    for (const id of IDS) {
      const control = $(id);
      control.addEventListener(control.type === "range" ? "input" : "change", () => {
        IDS.forEach((each) => touch($(each)));
        this.label();
        sendFrom(null, connection, "set-scene", this.values());
      });
    }
  }

  begin({ colorings, cuts, hasMagnet = true }) {
    fillSelect($("coloring"), colorings);
    fillSelect($("cut"), cuts);
    setHidden($("has-lines").parentElement, !hasMagnet);
  }

  values() {
    return {
      coloring: $("coloring").value, opacity: Number($("opacity").value), cut: $("cut").value,
      cut_fraction: Number($("cut-fraction").value), has_lines: $("has-lines").checked, has_patient: $("has-patient").checked,
    };
  }

  show({ scene, legend }) {
    if (!scene) return;
    show($("coloring"), scene.coloring);
    show($("opacity"), scene.opacity);
    show($("cut"), scene.cut);
    show($("cut-fraction"), scene.cut_fraction);
    show($("has-lines"), scene.has_lines);
    show($("has-patient"), scene.has_patient);
    this.label();
    const list = $("legend"), key = JSON.stringify(legend);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    list.replaceChildren(...legend.map(([color, text]) => {
      const mark = element("i");
      mark.style.background = `rgb(${color.join()})`;
      return element("li", {}, mark, text);
    }));
  }

  label() {
    setText($("opacity-value"), `${Math.round(100 * $("opacity").value)} %`);
    const isAcross = ["x", "y", "z"].includes($("cut").value);
    setDisabled($("cut-fraction"), !isAcross);
    setText($("cut-fraction-value"), isAcross ? `${Math.round(100 * $("cut-fraction").value)} %` : "–");
  }
}
