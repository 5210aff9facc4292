// The orders of a run that goes on: what was commanded, by whom, and since or from which dwell.

import { Latest, ask, runPath } from "./api.js";
import { byId, make } from "./text.js";

const EVERY_MS = 1000;

export class Orders {
  constructor() {
    this.list = byId("orders");
    this.latest = new Latest(EVERY_MS, (run) => ask(`${runPath(run)}/commands`), (answer) => this.draw(answer?.rows ?? []));
  }

  // Of this run; null: of none.
  watch(run) {
    if (run !== null) {
      this.latest.want(run);
      return;
    }
    this.latest.forget();
    this.draw([]);
  }

  draw(rows) {
    const shown = rows.filter(({ state }) => state === "in force" || state === "pending");
    this.list.hidden = !shown.length;
    this.list.replaceChildren(...shown.map((row) => {
      const item = make("li", row.state === "pending" ? "pending" : "");
      const since = `${row.state === "pending" ? "from" : "since"} dwell ${row.t ?? "–"}`;
      item.append(make("b", "", row.action), ` ${since}, ${row.by}`);
      return item;
    }));
  }
}
