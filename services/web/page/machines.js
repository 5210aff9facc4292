// The machine room: every process, how it does, and which tracks it owns; and what changed.

import { Latest, ask } from "./api.js";
import { glyph } from "./palette.js";
import { byId, bytes, fixed, make, put, short } from "./text.js";

const EVERY_MS = 1500;
const MARKED_MS = 12_000; // a track that moved, a process that went
const KEPT = 30; // moves to be read
const pair = (a, b, digits = 1) => (a === null && b === null ? "–" : `${fixed(a, digits)} · ${fixed(b, digits)}`);
const COLUMNS = [
  ["Process", null, (p) => p.name || `no ${p.role}`],
  ["State", null, (p) => stateOf(p)],
  ["Dwells", "per s", (p) => fixed(p.dwells_per_s)],
  ["Whole dwell", "ms, p50 · p99", (p) => pair(p.dwell_p50_ms, p.dwell_p99_ms)],
  ["Own work", "ms, p50 · p99", (p) => pair(p.handling_p50_ms, p.handling_p99_ms)],
  ["Margin to deadline", "ms, p50 · p99", (p) => pair(p.margin_p50_ms, p.margin_p99_ms)],
  ["Front end", "ms, p50 · p99", (p) => pair(p.front_end_p50_ms, p.front_end_p99_ms)],
  ["Late", null, (p) => count(p.late)],
  ["Stale", null, (p) => count(p.stale)],
  ["Sent again", null, (p) => count(p.redelivered)],
  ["Dropped", null, (p) => count(p.dropped)],
  ["CPU", "s", (p) => short(p.cpu_seconds)],
  ["Memory", "MiB", (p) => bytes(p.rss_bytes)],
];
function stateOf(process) {
  if (!process.alive) return process.name ? "○ gone" : "○ not running";
  if (!process.answers) return "● up, too busy to answer";
  if (process.starting) return "● starting";
  return process.full ? "● cannot write, runs held" : "● up";
}
const keyOf = (process) => `${process.role}/${process.name}`; // of a role without a process: without a name
const count = (value) => (value === null || value === undefined ? "–" : String(Math.round(value)));

export class Machines {
  constructor() {
    Object.assign(this, { seen: new Map(), owner: new Map(), moved: new Map(), timer: 0, run: null });
    this.latest = new Latest(EVERY_MS, () => ask("/processes"), (answer, problem) => this.answered(answer, problem));
    const head = make("tr");
    for (const [name, unit] of COLUMNS) {
      const cell = make("th", "", name);
      cell.scope = "col";
      if (unit) cell.append(make("br"), make("small", "", unit));
      head.append(cell);
    }
    byId("processes").tHead.append(head);
  }

  // Asks as long as it is looked at.
  watch(isWatched, run) {
    if (run !== this.run) {
      this.run = run;
      this.owner.clear();
    }
    clearInterval(this.timer);
    if (!isWatched) return;
    const look = () => document.hidden || this.latest.want();
    look();
    this.timer = setInterval(look, EVERY_MS);
  }

  answered(answer, problem) {
    if (!answer) {
      const text = problem.status === 503 ? `${problem.message}. This service reads a store alone; the processes are seen while services run: cogradar run paper --keep` : `${problem.message}; trying again`;
      put(byId("machines-caption"), text);
      return;
    }
    const now = performance.now();
    this.note(answer.processes, now);
    const all = [...this.seen.values()].map((one) => one.process);
    const up = all.filter((one) => one.alive).length;
    const gone = all.filter((one) => !one.alive && one.name).length;
    put(byId("machines-caption"), `${up} up${gone ? `, ${gone} gone` : ""}; p50: half of the dwells, p99: the worst of a hundred`);
    this.table(all);
    this.owners(answer.owners[this.run] ?? null, all, now);
  }

  // What came, went, or was started again between two looks. One that is gone stays for a while.
  note(processes, now) {
    const isFirst = this.seen.size === 0;
    const here = new Set();
    for (const process of processes) {
      const key = keyOf(process);
      here.add(key);
      const before = this.seen.get(key);
      if (process.alive && !before?.process.alive && !isFirst) this.say(`${process.name} is up`, false);
      if (!process.alive && before?.process.alive) this.say(`${process.name} is gone`, true);
      const began = process.began_utc_s ?? before?.began ?? null;
      if (before?.process.alive && before.began !== null && before.began !== began) this.say(`${process.name} was restarted`, true);
      this.seen.set(key, { process, began, since: process.alive ? now : before?.since ?? now });
    }
    for (const [key, one] of this.seen) {
      if (here.has(key)) continue;
      if (one.process.alive) this.say(`${one.process.name} is gone`, true);
      Object.assign(one.process, { alive: false, answers: false });
      if (!one.process.name || now - one.since > 5 * MARKED_MS) this.seen.delete(key);
    }
  }

  table(all) {
    const body = byId("processes").tBodies[0];
    while (body.rows.length > all.length) body.lastChild.remove();
    all.forEach((process, i) => {
      const row = body.rows[i] ?? body.insertRow();
      row.className = process.alive ? "" : "gone";
      COLUMNS.forEach(([, , text], j) => {
        let cell = row.cells[j];
        if (!cell) {
          cell = make(j ? "td" : "th");
          if (!j) cell.scope = "row";
          row.append(cell);
        }
        put(cell, process.answers || j < 2 ? text(process) : "–");
      });
    });
  }

  owners(owners, all, now) {
    const node = byId("owners");
    if (!owners) {
      node.replaceChildren(make("p", "muted", this.run ? "This run is over, or does not run on these services: its tracks have no owner." : "No run."));
      return;
    }
    const owned = Object.entries(owners).map(([track, name]) => [Number(track), name]);
    for (const [track, name] of owned) {
      const before = this.owner.get(track);
      if (before !== undefined && before !== name) {
        this.moved.set(track, now);
        this.say(`track ${track}: ${before ?? "no owner"} → ${name ?? "no owner"}`, false);
      }
      this.owner.set(track, name);
    }
    const planners = all.filter((one) => one.role === "planner" && one.name);
    node.replaceChildren(...planners.map(({ name, alive, starting }) => {
      const box = make("div", alive ? "owner" : "owner gone");
      box.dataset.planner = name;
      box.append(make("h3", "", alive ? `${name}${starting ? ": starting" : ""}` : `${name}: gone`));
      const list = make("ul");
      for (const [track, owner] of owned) {
        if (owner !== name) continue;
        const item = make("li", now - (this.moved.get(track) ?? -MARKED_MS) < MARKED_MS ? "moved" : "");
        item.append(glyph(track), String(track));
        list.append(item);
      }
      box.append(list.children.length ? list : make("p", "muted", "no track"));
      return box;
    }));
  }

  say(text, isAlarm) {
    const line = make("li", isAlarm ? "alarm" : "", `${new Date().toLocaleTimeString()}  ${text}`);
    byId("moves").prepend(line);
    while (byId("moves").children.length > KEPT) byId("moves").lastChild.remove();
  }
}
