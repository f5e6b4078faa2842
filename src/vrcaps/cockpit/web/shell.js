// Parts of both pages: tabs, buttons that send commands, confirmation, messages, tour.

import { $, element, setText, setHidden } from "./dom.js";

const TOAST_MS = 6000;
const MAX_TOASTS = 3;

/** Arrow keys, Home and End move the focus within a group of buttons, of which one is in the tab order. */
export function roving(group, buttons, onMove = () => {}) {
  const select = (chosen) => buttons.forEach((each) => { each.tabIndex = each === chosen ? 0 : -1; });
  select(buttons[0]);
  group.addEventListener("focusin", (event) => { if (buttons.includes(event.target)) select(event.target); });
  group.addEventListener("keydown", (event) => {
    const at = buttons.indexOf(event.target), steps = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 };
    if (at < 0 || event.ctrlKey || event.metaKey || event.altKey) return;
    let to = { Home: 0, End: buttons.length - 1 }[event.key];
    if (event.key in steps) {
      to = at;
      do to = (to + steps[event.key] + buttons.length) % buttons.length; while (buttons[to].disabled && to !== at);
    }
    if (to === undefined) return;
    event.preventDefault();
    buttons[to].focus();
    onMove(buttons[to]);
  });
}

export function setUpTabs() {
  for (const list of document.querySelectorAll("[role=tablist]")) {
    const tabs = [...list.querySelectorAll("[role=tab]")];
    const select = (tab) => {
      for (const each of tabs) {
        each.setAttribute("aria-selected", String(each === tab));
        setHidden($(each.getAttribute("aria-controls")), each !== tab);
      }
      tab.scrollIntoView({ block: "nearest", inline: "nearest" });
    };
    roving(list, tabs, select);
    for (const tab of tabs) tab.addEventListener("click", () => select(tab));
  }
}

export function notify(text, isError = false) {
  const toasts = $("toasts");
  const toast = element("p", { className: isError ? "toast error" : "toast", textContent: text });
  if (isError) toast.setAttribute("role", "alert");
  toasts.append(toast);
  while (toasts.children.length > MAX_TOASTS) toasts.firstChild.remove();
  setTimeout(() => toast.remove(), TOAST_MS);
}

/** Ask before something is lost; resolves to true if the person agrees. */
export function confirmed({ title, text, yes }) {
  const dialog = $("confirm");
  setText($("confirm-title"), title);
  setText($("confirm-text"), text);
  setText($("confirm-yes"), yes);
  dialog.returnValue = "cancel";
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
  });
}

/** Mark a button as pressed at once, send its command, and show an error. */
export async function sendFrom(button, connection, command, fields = {}) {
  button?.classList.add("sent");
  const answer = await connection.send(command, fields);
  button?.classList.remove("sent");
  if (answer.error && !answer.field) notify(answer.error, true);
  return answer;
}

export function copyButton(button, text) {
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(text());
      notify("Copied.");
    } catch {
      notify(text());
    }
  });
}

const TOUR_STORE = "vrcaps-tour";

/** A tour of the page: steps of target (ID), title and text; starts by itself the first time. */
export class Tour {
  constructor(steps) {
    this.steps = steps;
    this.step = 0;
    this.dialog = $("tour");
    $("tour-next").addEventListener("click", () => this.go(1));
    $("tour-back").addEventListener("click", () => this.go(-1));
    $("tour-skip").addEventListener("click", () => this.end());
    this.dialog.addEventListener("keydown", (event) => { if (event.key === "Escape") this.end(); });
    addEventListener("resize", () => { if (this.dialog.open) this.place(); });
  }

  startOnce() {
    try {
      if (localStorage.getItem(TOUR_STORE)) return;
    } catch { return; }
    this.start();
  }

  start() {
    this.before = document.activeElement;
    this.step = 0;
    if (!this.dialog.open) this.dialog.show();
    this.draw();
  }

  go(by) {
    this.step += by;
    if (this.step >= this.steps.length) this.end();
    else this.draw();
  }

  draw() {
    const { title, text } = this.steps[this.step], isLast = this.step === this.steps.length - 1;
    setText($("tour-step"), `Step ${this.step + 1} of ${this.steps.length}`);
    setText($("tour-title"), title);
    setText($("tour-text"), text);
    setText($("tour-next"), isLast ? "Done" : "Next");
    $("tour-back").disabled = this.step === 0;
    setHidden($("tour-skip"), isLast);
    this.place();
    $("tour-next").focus();
  }

  place() {
    document.querySelectorAll(".spot").forEach((each) => each.classList.remove("spot"));
    const target = $(this.steps[this.step].target), box = target.getBoundingClientRect();
    target.classList.add("spot");
    const { offsetWidth: width, offsetHeight: height } = this.dialog;
    const right = box.right + 14 + width < innerWidth ? box.right + 14 : Math.max(8, box.left + 14);
    const isBelow = box.height < 90 && box.bottom + height + 20 < innerHeight;
    const left = isBelow ? Math.min(Math.max(8, box.left), innerWidth - width - 8) : right;
    const top = isBelow ? box.bottom + 12 : Math.min(Math.max(60, box.top + 30), innerHeight - height - 12);
    Object.assign(this.dialog.style, { left: `${left}px`, top: `${top}px` });
  }

  end() {
    document.querySelectorAll(".spot").forEach((each) => each.classList.remove("spot"));
    this.dialog.close();
    try { localStorage.setItem(TOUR_STORE, "seen"); } catch { /* asked again next time */ }
    this.before?.focus?.();
  }
}
