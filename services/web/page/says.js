// What the page says in words: how the run is, whether the service answers, and what to do where there is nothing.

import { byId, make, put } from "./text.js";

const KEPT = 3; // events to be read

export function badge(kind, text) {
  const node = byId("connection");
  if (node.dataset.kind !== kind) node.dataset.kind = kind;
  put(node, text);
}

export function heading(radar) {
  const rate = radar.rate_hz ? `${radar.rate_hz} Hz` : "lockstep";
  put(byId("heading"), `${radar.scenario} · ${radar.strategy} · seed ${radar.seed} · ${rate}`);
  byId("heading").title = radar.run;
  document.title = `${radar.scenario} ${radar.strategy} ${radar.seed} – cogradar`;
}

export function noHeading() {
  put(byId("heading"), "");
  byId("heading").title = "";
  document.title = "cogradar";
}

// What the line across the page could say: the first of these that there is.
const notices = { outage: null, measured: null, dwell: null, alarm: null, begun: null };

// One kind of line across the page; `act` is a button's text and what it does. Without text it goes.
export function notice(kind, text, act = null) {
  notices[kind] = text ? [text, act] : null;
  line(...(Object.values(notices).find(Boolean) ?? [null, null]));
}

function line(text, act) {
  const node = byId("notice");
  if (node.dataset.text === (text ?? "")) return;
  node.dataset.text = text ?? "";
  node.hidden = !text;
  node.replaceChildren();
  if (!text) return;
  node.append(make("span", "", text));
  if (!act) return;
  const button = make("button", "", act[0]);
  button.type = "button";
  button.addEventListener("click", act[1]);
  node.append(button);
}

// Over the scope, where there is no picture yet.
export function empty(text) {
  const node = byId("empty");
  node.hidden = !text;
  put(node, text ?? "");
}

// A line that is read aloud once, and stays for the eyes; `kind`: alarm, good, or neither.
export function event(text, kind) {
  const node = byId("event");
  node.append(make("span", kind, text));
  while (node.children.length > KEPT) node.firstChild.remove();
}

export function noEvents(isUnknown) {
  byId("event").replaceChildren();
  byId("event").setAttribute("aria-label", isUnknown ? "Tracks confirmed and ended" : "Tracks lost and found again");
}
