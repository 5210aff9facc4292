// Commands to the run that is shown: buttons, a line of words as `cogradar command` takes them, the pointer on the scope.
// All of it becomes words, which are sent in one way.

import { Problem, ask, commanderOf, post, runPath } from "./api.js";
import { byId, put } from "./text.js";
import { view } from "./view.js";

const KEPT_AS = "commander"; // until the tab is closed
const FORGET = [401, 403]; // answers to a token that is none

export class Command {
  // `turned()` is called when the scope has something else to show: `asked` is the sector that is written down. `isOver()`
  // says whether the run that is shown has ended.
  constructor(turned, isOver) {
    Object.assign(this, { isOver, panel: byId("command"), mode: null, asked: null, isBusy: false, isDragging: false, turned });
    this.words = byId("command-words");
    byId("command-open").addEventListener("click", () => this.toggle());
    this.panel.addEventListener("keydown", (event) => this.key(event));
    byId("token-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.enter(byId("token").value.trim());
    });
    byId("token-forget").addEventListener("click", () => this.forget());
    byId("command-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.send(this.words.value.trim());
    });
    byId("power-set").addEventListener("click", () => this.send(`power ${share("power")}`));
    for (const button of this.panel.querySelectorAll("[data-search]")) {
      button.addEventListener("click", () => this.send(`sector ${button.dataset.search} ${value("sector-from")} ${value("sector-to")}`));
    }
    for (const id of ["sector-from", "sector-to"]) byId(id).addEventListener("input", () => this.mark());
    byId("sector-drag").addEventListener("click", () => this.turn("sector"));
    byId("look-aim").addEventListener("click", () => this.turn("look"));
    byId("look-send").addEventListener("click", () => this.look());
    byId("priority-set").addEventListener("click", () => this.send(`priority ${view.target} ${value("priority")}`));
    byId("accuracy-set").addEventListener("click", () => this.send(`accuracy ${view.target} ${value("accuracy")}`));
    byId("accuracy-none").addEventListener("click", () => this.send(`accuracy ${view.target} none`));
    byId("pause").addEventListener("click", () => this.send(`pause ${byId("pause-dwells").value}`.trim()));
    byId("resume").addEventListener("click", () => this.send("resume"));
    byId("drop").addEventListener("click", () => this.send(`drop ${view.target}`));
    byId("end").addEventListener("click", () => this.send("end"));
    byId("end-dialog").addEventListener("close", ({ target }) => {
      if (target.returnValue === "end") this.deliver(this.ending, "end");
      target.returnValue = "";
    });
    const scope = byId("scope");
    scope.addEventListener("pointercancel", () => Object.assign(this, { isDragging: false }));
    this.scope = scope;
  }

  get token() {
    return sessionStorage.getItem(KEPT_AS) ?? "";
  }

  toggle(isOpen = this.panel.hidden) {
    this.panel.hidden = !isOpen;
    byId("command-open").setAttribute("aria-expanded", String(isOpen));
    this.turn(null);
    this.draw();
    if (isOpen && !this.isOver()) (this.token ? this.words : byId("token")).focus();
    else byId("command-open").focus();
  }

  // A token opens the panel once the service has said whose it is.
  async enter(token) {
    this.say("", "The token is checked …");
    try {
      const { name } = await commanderOf(token);
      sessionStorage.setItem(KEPT_AS, token);
      byId("token").value = "";
      this.say("good", `You command as ${name}.`);
      this.draw();
      this.words.focus();
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      this.say("bad", `${error.message}.`);
      byId("token").select();
    }
  }

  draw() {
    const isOver = this.isOver();
    const held = this.panel.contains(document.activeElement);
    byId("command-over").hidden = !isOver;
    byId("token-form").hidden = Boolean(this.token) || isOver;
    byId("command-acts").hidden = !this.token || isOver;
    if (isOver && this.mode) this.turn(null);
    if (isOver && held) byId("command-open").focus();
    put(byId("command-title"), view.run === null ? "Command" : `Command ${view.run}`);
    const drop = byId("drop");
    drop.disabled = view.target === null;
    for (const id of ["priority-set", "accuracy-set", "accuracy-none"]) byId(id).disabled = view.target === null;
    put(byId("track-title"), view.target === null ? "Chosen track" : `Track ${view.target}`);
    put(drop, view.target === null ? "Drop the chosen track" : `Drop track ${view.target}`);
    if (this.token && !this.panel.hidden) this.describe();
    this.mark();
  }

  // The service says itself which words it takes.
  async describe() {
    if (this.isDescribed) return;
    this.isDescribed = true;
    try {
      const { components } = await ask("/openapi.json");
      const words = components.schemas.CommandDocument.properties.action.anyOf.find((one) => one.type === "string");
      put(byId("command-forms"), words.description);
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      this.isDescribed = false;
    }
  }

  // What the pointer does on the scope: "sector" or "look"; again, or null: as ever.
  turn(mode) {
    this.mode = mode === this.mode ? null : mode;
    this.isDragging = false;
    for (const [id, name] of [["sector-drag", "sector"], ["look-aim", "look"]]) byId(id).setAttribute("aria-pressed", String(this.mode === name));
    this.scope.classList.toggle("aims", this.mode !== null);
    this.mark();
  }

  // A key that needs the panel opens it.
  aim(mode) {
    if (this.panel.hidden) this.toggle(true);
    if (this.token && !this.isOver()) this.turn(mode);
  }

  key(event) {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    if (this.mode) this.turn(null);
    else this.toggle(false);
  }

  // What the pointer did on the scope, at this angle from the boresight. Returns whether it was for a command.
  pointed(kind, angle) {
    if (!this.mode || (kind !== "up" && angle === null)) return this.mode !== null;
    const degrees = angle === null ? null : Math.round((1800 * angle) / Math.PI) / 10;
    if (this.mode === "look") {
      if (kind === "up" && degrees !== null) {
        byId("look-bearing").value = degrees;
        this.look();
        this.turn(null);
      }
      return true;
    }
    if (kind === "down") Object.assign(this, { isDragging: true, began: degrees });
    if (this.isDragging && degrees !== null) {
      byId("sector-from").value = Math.min(this.began, degrees);
      byId("sector-to").value = Math.max(this.began, degrees);
    }
    if (kind === "up") this.isDragging = false;
    this.mark();
    return true;
  }

  // The sector that is written down, to be drawn on the scope.
  mark() {
    const [from, to] = [byId("sector-from").valueAsNumber, byId("sector-to").valueAsNumber];
    const isOne = !this.panel.hidden && Boolean(this.token) && from < to && from >= -90 && to <= 90;
    this.asked = isOne ? { from, to } : null;
    this.turned();
  }

  look() {
    this.send(`look ${value("look-bearing")} ${value("look-dwells")} ${share("look-share")}`);
  }

  // Commands the run that is shown now; the end of a run is asked for twice.
  send(words) {
    if (!words) return;
    if (words !== "end") {
      this.deliver(view.run, words);
      return;
    }
    this.ending = view.run;
    put(byId("end-text"), `End run ${view.run}? It cannot go on afterwards.`);
    byId("end-dialog").showModal();
  }

  async deliver(run, words) {
    if (this.isBusy || run === null) {
      this.say("bad", run === null ? "There is no run to command." : `${words}: not sent, the last command has no answer yet.`);
      return;
    }
    this.isBusy = true;
    this.say("", `${words}: asked …`);
    try {
      const row = await post(`${runPath(run)}/commands`, { action: words }, this.token);
      const from = row.t === null ? `scan ${row.k}` : `dwell ${row.t}`;
      this.say("good", `${row.action}: granted from ${from} on.`);
      if (this.words.value.trim() === words) this.words.value = ""; // it would be sent twice
    } catch (error) {
      if (!(error instanceof Problem)) throw error;
      this.say("bad", `${words}: ${error.message}.`);
      if (FORGET.includes(error.status)) this.forget();
    } finally {
      this.isBusy = false;
    }
  }

  forget() {
    sessionStorage.removeItem(KEPT_AS);
    this.turn(null);
    this.draw();
    byId("token").focus();
  }

  say(kind, text) {
    const node = byId("command-answer");
    node.dataset.kind = kind;
    put(node, text);
  }
}

const value = (id) => byId(id).value.trim() || "?"; // the parser says what is missing
const share = (id) => (byId(id).value.trim() ? String(Number((byId(id).valueAsNumber / 100).toFixed(4))) : "?");
