// The events of a run: a stream that comes back by itself, also after a restart of the service.

import { eventsOf } from "./api.js";

const AGAIN_MS = 1500;
const SILENT_MS = 10_000; // the service says something every 3 s

export class Feed {
  // `told` has dwell(data), acquisition(data), end(data), up(isUp), and check(), after which it is asked again.
  constructor(run, told) {
    Object.assign(this, { run, told, timer: 0, source: null, isClosed: false });
    this.open();
  }

  // Begins with the newest dwell, also after an outage: from where it broke off, the stream would stay behind. What is
  // missing of the picture is asked for by the part that draws it.
  open() {
    const source = new EventSource(eventsOf(this.run));
    this.source = source;
    source.onopen = () => this.heard();
    source.addEventListener("ping", () => this.heard());
    for (const [name, told] of [["message", "dwell"], ["acquisition", "acquisition"]]) {
      source.addEventListener(name, (event) => {
        this.heard();
        this.told[told](JSON.parse(event.data));
      });
    }
    source.addEventListener("end", (event) => {
      this.close();
      this.told.end(JSON.parse(event.data));
    });
    source.onerror = () => this.broke();
    // Not every end is an error. The launcher keeps the socket that metrics serves on, so while metrics is down a stream
    // that is not open yet waits there unanswered, and so it does for a service that is frozen: only time tells.
    this.wait(SILENT_MS, () => this.broke());
  }

  heard() {
    if (this.isClosed) return;
    this.wait(SILENT_MS, () => this.broke());
    this.told.up(true);
  }

  broke() {
    if (this.isClosed) return;
    this.source.close();
    this.wait(AGAIN_MS, async () => {
      await this.told.check(); // a stream of a run that is over would begin with its first dwell
      if (!this.isClosed) this.open();
    });
    this.told.up(false);
  }

  wait(ms, act) {
    clearTimeout(this.timer);
    this.timer = setTimeout(act, ms);
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
    this.source.close();
  }
}
