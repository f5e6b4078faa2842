// Form of the next drive; an error is shown at its field.

import { $, fillSelect, setHidden, setText, sliderRow } from "./dom.js";
import { confirmed, sendFrom } from "./shell.js";

const FIELDS = ["organ", "seed", "lesions", "capsule", "capsule_file", "magnet", "arm", "coils"];

export class NewDriveForm {
  constructor(connection) {
    this.connection = connection;
    $("new-drive").addEventListener("submit", (event) => { event.preventDefault(); this.submit(); });
    for (const name of FIELDS) $(`new-${name}`).addEventListener("input", () => this.clear());
  }

  begin(values, maxSeverity) {
    this.before = values;
    const own = (list, current) => (list.includes(current) || !current ? list : [{ value: "", label: current }, ...list]);
    fillSelect($("new-organ"), own(values.organs, values.organ), values.organ);
    fillSelect($("new-capsule"), own(values.capsules, values.capsule), values.capsule);
    fillSelect($("new-magnet"), own(values.magnets, values.magnet), values.magnet);
    fillSelect($("new-arm"), own(values.arms, values.arm), values.arm);
    fillSelect($("new-coils"), own(values.coilArrays, values.coils), values.coils);
    $("new-seed").value = values.seed;
    $("new-lesions").value = $("new-capsule_file").value = "";
    this.sliders = values.severities.map(({ name, label, hint, severity }) => {
      const made = sliderRow({ id: `new-severity-${name}`, label, hint, max: maxSeverity, value: severity, attributes: { "data-driver": "" } });
      return { name, severity, ...made };
    });
    $("new-severities").replaceChildren(...this.sliders.map(({ row }) => row));
    this.clear();
  }

  clear() {
    setHidden($("new-error"), true);
    for (const name of FIELDS) {
      $(`new-${name}`).removeAttribute("aria-invalid");
      $(`new-${name}`).removeAttribute("aria-describedby");
    }
  }

  fail(field, text) {
    const control = $(`new-${field}`), error = $("new-error");
    setText(error, text);
    setHidden(error, false);
    if (!control) return;
    control.setAttribute("aria-invalid", "true");
    control.setAttribute("aria-describedby", "new-error");
    control.closest(".row").after(error);
    control.focus();
  }

  async submit() {
    this.clear();
    const seed = Number($("new-seed").value || "0");
    if (!Number.isInteger(seed) || seed < 0 || seed > 2147483647) {
      this.fail("seed", `Seed is ${$("new-seed").value}. Allowed: a whole number from 0 to 2147483647.`);
      return;
    }
    const isSure = await confirmed({ title: "Start a new drive?", text: "The current drive ends. It is saved in its folder.", yes: "Start a new drive" });
    if (!isSure) return;
    const severities = this.sliders.filter(({ input, severity }) => Number(input.value) !== severity)
      .map(({ name, input }) => ({ name, severity: Number(input.value) }));
    const organ = $("new-organ").value;
    const { error, field } = await sendFrom($("start-drive"), this.connection, "new-drive", {
      organ: organ === this.before.organ ? "" : organ, seed, severities,
      lesions: $("new-lesions").value.trim(), capsule: $("new-capsule").value, capsule_file: $("new-capsule_file").value.trim(),
      magnet: $("new-magnet").value, arm: $("new-arm").value, coils: $("new-coils").value,
    });
    if (error && field) this.fail(field, error);
  }
}
