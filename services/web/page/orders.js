// The commands of the run: those that are open, in a list; and of a dwell those that its waveform obeys, to be drawn.

import { Latest, ask, runPath } from "./api.js";
import { byId, make } from "./text.js";

const EVERY_MS = 1000;
const PAGES = 20; // of a thousand commands

async function allOf(run) {
  const rows = [];
  for (let page = 0; page < PAGES; page += 1) {
    const answer = await ask(`${runPath(run)}/commands?offset=${rows.length}`);
    rows.push(...answer.rows);
    if (!answer.next) break;
  }
  return rows;
}

export class Orders {
  // `came()` is called when commands of the run are known that were not before.
  constructor(came) {
    Object.assign(this, { list: byId("orders"), run: null, known: new Map(), asked: new Set() });
    this.latest = new Latest(EVERY_MS, (run) => ask(`${runPath(run)}/commands?state=open`), (answer) => answer && this.draw(answer.rows));
    this.all = new Latest(EVERY_MS, allOf, (rows, problem, run) => {
      if (run !== this.run) return;
      if (problem) {
        this.asked.clear(); // with the next dwell again
        return;
      }
      for (const row of rows) this.known.set(row.n, row);
      came();
    });
  }

  open(run) {
    if (run === this.run) return;
    Object.assign(this, { run, known: new Map(), asked: new Set() });
    this.latest.forget();
    this.all.forget();
    this.draw([]);
  }

  // Those that are open of the run that goes on; of one that is over, the list is of the dwell that is shown.
  watch(isRunning) {
    if (isRunning && this.run !== null) this.latest.want(this.run);
    else if (!isRunning) this.latest.forget();
    this.isRunning = isRunning;
  }

  // The rows of the commands that a dwell obeys, as far as they are known; the others are asked for, once each.
  of(dwell) {
    const numbers = dwell?.orders ?? [];
    if (numbers.some((n) => !this.known.has(n) && !this.asked.has(n))) {
      for (const n of numbers) this.asked.add(n);
      this.all.want(this.run);
    }
    const rows = numbers.map((n) => this.known.get(n)).filter(Boolean);
    if (!this.isRunning && this.isRunning !== undefined) this.draw(rows.map((row) => ({ ...row, state: "in force" })));
    return rows;
  }

  draw(rows) {
    const key = JSON.stringify(rows.map(({ n, state, t, reason }) => [n, state, t, reason]));
    if (key === this.key) return; // a list that is read aloud says what is new
    this.key = key;
    this.list.hidden = !rows.length;
    this.list.replaceChildren(...rows.map((row) => {
      const item = make("li", row.state === "in force" ? "" : "pending");
      const since = `${row.state === "pending" ? "from" : "since"} dwell ${row.t ?? "–"}`;
      const awaits = { "awaits the allocator": `, ${row.state}`, "not met": `, not met: ${row.reason}` }[row.state] ?? "";
      item.append(make("b", "", row.action), ` ${since}, ${row.by}${awaits}`);
      return item;
    }));
  }
}

// What is drawn of rows of commands: sectors and looks, in degrees from the boresight, and whether nothing is radiated.
export function directions(rows) {
  const found = { sectors: [], looks: [], isPaused: false };
  for (const { action } of rows) {
    const [kind, ...words] = action.split(" ");
    if (kind === "sector") found.sectors.push({ search: words[0], from: Number(words[1]), to: Number(words[2]) });
    if (kind === "pause") found.isPaused = true;
    if (kind === "look") found.looks.push({ bearing: Number(words[0]) });
  }
  return found;
}
