// The events of a run: a stream that comes back by itself, also after a restart of the service.

import { eventsOf } from "./api.js";

const AGAIN_MS = 1500;
const SILENT_MS = 25_000; // the service says something every 10 s

export class Feed {
  // `told` has dwell(data), acquisition(data), end(data), up(isUp).
  constructor(run, told) {
    Object.assign(this, { run, told, last: null, timer: 0, source: null });
    this.open();
  }

  open() {
    const source = new EventSource(eventsOf(this.run, this.last));
    this.source = source;
    source.onopen = () => this.heard(true);
    source.onmessage = (event) => {
      this.last = Number(event.lastEventId);
      this.heard(true);
      this.told.dwell(JSON.parse(event.data));
    };
    source.addEventListener("acquisition", (event) => {
      this.heard(true);
      this.told.acquisition(JSON.parse(event.data));
    });
    source.addEventListener("end", (event) => {
      this.close();
      this.told.end(JSON.parse(event.data));
    });
    source.onerror = () => {
      if (this.source !== source) return;
      this.told.up(false);
      if (source.readyState === EventSource.CLOSED) this.again(AGAIN_MS);
    };
    this.again(SILENT_MS);
  }

  heard() {
    this.told.up(true);
    this.again(SILENT_MS);
  }

  // A new stream, unless something is heard before.
  again(ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.source.close();
      this.told.check();
      this.open();
    }, ms);
  }

  close() {
    clearTimeout(this.timer);
    this.source.close();
    this.source = null;
  }
}
