// Small helpers for elements.

export const $ = (id) => document.getElementById(id);

/** Create an element with properties, attributes (keys with a dash, and role) and children. */
export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (key.includes("-") || key === "role" || key === "for") made.setAttribute(key, value);
    else made[key] = value;
  }
  made.append(...children);
  return made;
}

export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function setHidden(node, isHidden) {
  if (node.hidden !== isHidden) node.hidden = isHidden;
}

export function setDisabled(node, isDisabled) {
  if (node.disabled !== isDisabled) node.disabled = isDisabled;
}

/** Options of a list: strings, or objects with value and label; keeps the selection if it still exists. */
export function fillSelect(select, options, chosen = select.value) {
  const wanted = options.map((each) => (typeof each === "object" ? each : { value: each, label: labelOf(each) }));
  const key = JSON.stringify(wanted);
  if (select.dataset.options !== key) {
    select.dataset.options = key;
    select.replaceChildren(...wanted.map(({ value, label }) => element("option", { value, textContent: label })));
  }
  const values = wanted.map(({ value }) => String(value));
  select.value = values.includes(String(chosen)) ? String(chosen) : values[0] ?? "";
}

export const labelOf = (name) => String(name).replaceAll("_", " ");

/** True while a person changes a control, so that a status does not overwrite it. */
export function isInUse(control) {
  return performance.now() - Number(control.dataset.touched ?? -1e9) < 1500;
}

export function touch(control) {
  control.dataset.touched = String(performance.now());
}

/** Show a value in a control unless a person is changing it. */
export function show(control, value) {
  if (isInUse(control)) return;
  if (control.type === "checkbox") {
    if (control.checked !== value) control.checked = value;
  } else if (control.value !== String(value)) control.value = String(value);
}

/** A row with a labeled slider; returns the row. */
export function sliderRow({ id, label, hint, max, value, attributes = {} }) {
  const input = element("input", { type: "range", id, min: 0, max, step: 1, value, title: hint, ...attributes });
  const output = element("output", { for: id, textContent: String(value) });
  input.addEventListener("input", () => setText(output, input.value));
  const row = element("div", { className: "row" }, element("label", { htmlFor: id, textContent: label }), input, output);
  return { row, input, output };
}
