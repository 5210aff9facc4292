// The orders of a run that goes on: what was commanded, by whom, and since or from which dwell.

import { Latest, ask, runPath } from "./api.js";
import { byId, make } from "./text.js";

const EVERY_MS = 1000;

export class Orders {
  constructor() {
    this.list = byId("orders");
    this.latest = new Latest(EVERY_MS, (run) => ask(`${runPath(run)}/commands?state=open`), (answer) => this.draw(answer?.rows ?? []));
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
    this.list.hidden = !rows.length;
    this.list.replaceChildren(...rows.map((row) => {
      const item = make("li", row.state === "in force" ? "" : "pending");
      const since = `${row.state === "pending" ? "from" : "since"} dwell ${row.t ?? "–"}`;
      const awaits = row.state === "awaits the allocator" ? `, ${row.state}` : "";
      item.append(make("b", "", row.action), ` ${since}, ${row.by}${awaits}`);
      return item;
    }));
  }
}
