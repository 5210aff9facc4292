// The runs that there are: a table to choose from, and which of them is the newest.

import { Latest, ask } from "./api.js";
import { byId, make, put } from "./text.js";
import { link, view } from "./view.js";

const MOST = 300; // rows of the table
const PAGES = 50; // of a thousand runs
const EVERY_MS = 3000;

// The runs in the order in which they began. Of those that are known, only what may have changed is asked for again: from
// the first that goes on, or the last. If another one stands in its place now, others are gone, and all are asked for.
async function allRuns(known) {
  const goesOn = known.findIndex((row) => row.status === "running");
  const from = Math.max(0, goesOn < 0 ? known.length - 1 : goesOn);
  const rows = known.slice(0, from);
  for (let page = 0; page < PAGES; page += 1) {
    const answer = await ask(`/runs?offset=${rows.length}`);
    if (!page && from && answer.rows[0]?.run !== known[from].run) return allRuns([]);
    rows.push(...answer.rows);
    if (!answer.next) break;
  }
  return rows;
}

// What a page without a run begins with: one that goes on, else the last one.
export const newestOf = (rows) => rows.find((row) => row.status === "running") ?? rows[0] ?? null;

export class Runs {
  // `told(rows, problem)` is called with every answer.
  constructor(told) {
    this.known = [];
    this.rows = []; // newest first
    this.body = byId("run-table").tBodies[0];
    this.latest = new Latest(EVERY_MS, () => allRuns(this.known), (known, problem) => {
      if (known) [this.known, this.rows] = [known, known.toReversed()];
      if (view.view === "runs") this.draw(problem);
      told(this.rows, problem);
    });
    byId("find").addEventListener("input", () => this.draw(null));
  }

  refresh() {
    this.latest.want();
  }

  draw(problem) {
    const words = byId("find").value.toLowerCase().split(/\s+/).filter(Boolean);
    const text = (row) => `${row.run} ${row.scenario} ${row.strategy} ${row.seed} ${row.status}`.toLowerCase();
    const found = this.rows.filter((row) => words.every((word) => text(row).includes(word)));
    const goOn = this.rows.filter((row) => row.status === "running").length;
    put(byId("runs-caption"), problem ? `${problem.message}: this is what was there before` : `${this.rows.length} stored, ${goOn} live`);
    const focused = document.activeElement?.closest("tr")?.dataset.run;
    this.body.replaceChildren(...found.slice(0, MOST).map(rowOf));
    if (focused) this.body.querySelector(`tr[data-run="${CSS.escape(focused)}"] a`)?.focus();
    const left = found.length - MOST;
    put(byId("runs-more"), left > 0 ? `${left} more: narrow them down with Find.` : empty(found.length, this.rows.length, problem));
  }
}

function empty(found, all, problem) {
  if (found || problem) return "";
  return all ? "No run has these words." : "No run yet. In a terminal: cogradar run paper --keep";
}

function rowOf(row) {
  const line = make("tr");
  line.dataset.run = row.run;
  line.dataset.status = row.status;
  if (row.run === view.run) line.className = "chosen";
  const head = make("th");
  head.scope = "row";
  const anchor = make("a", "", row.run);
  anchor.href = link({ run: row.run, follows: false, view: "radar", dwell: null, target: null, zoom: 1, particles: false });
  anchor.dataset.run = row.run;
  head.append(anchor);
  line.append(head);
  const status = row.status === "running" ? "live" : row.status;
  const texts = [status + (row.reason ? `: ${row.reason}` : ""), row.scenario, row.strategy, String(row.seed), row.dwells === null ? `${row.t}, no end` : `${row.t} of ${row.dwells}`, String(row.targets)];
  for (const text of texts) line.append(make("td", "", text));
  return line;
}
