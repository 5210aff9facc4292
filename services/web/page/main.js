// The page: its views, its buttons and keys, and the run that it begins with.

import { Alarms } from "./alarms.js";
import { listen } from "./keys.js";
import { isDark, onTheme, setTheme } from "./palette.js";
import { Charts } from "./charts.js";
import { Command } from "./command.js";
import { Compare } from "./compare.js";
import { Machines } from "./machines.js";
import { Orders } from "./orders.js";
import { Radar } from "./radar.js";
import { Runs, newestOf } from "./runs.js";
import * as says from "./says.js";
import { Session } from "./session.js";
import { byId, put } from "./text.js";
import { mark } from "./wide.js";
import { VIEWS, ZOOMS, link, onView, show, view } from "./view.js";

const LOOK_MS = 3000; // for runs that begin

const charts = new Charts((t) => session.player.seek(t));
const orders = new Orders(() => radar.redraw());
const command = new Command(() => radar.redraw(), () => Boolean(session.row) && !session.player.isRunning);
const radar = new Radar(charts, orders, command);
const session = new Session(radar, () => command.draw());
const machines = new Machines();
new Alarms(session);
const compare = new Compare((t) => session.player.seek(t), () => runs.rows);
const runs = new Runs(listed);

function listed(rows, problem) {
  if (problem) {
    if (view.run === null) session.disconnected(problem.message);
    else session.unanswered(problem);
    return;
  }
  session.answered();
  const newest = newestOf(rows);
  if (view.run === null && newest) {
    show({ run: newest.run }); // with the dwell of the address, if it has one
    return;
  }
  const isGone = view.run !== null && !session.player.isRunning && !rows.some((row) => row.run === view.run);
  const movesOn = view.follows && newest && newest.run !== view.run && view.dwell === null && !session.player.isRunning;
  if (movesOn || (view.follows && newest && isGone)) {
    show({ run: newest.run, dwell: null });
    return;
  }
  if (isGone) session.gone();
  if (view.run === null) {
    says.badge("gone", "No run yet");
    says.notice("outage", null);
    says.empty("No run yet. In a terminal: cogradar run paper --keep");
  }
  const hasBegun = newest?.status === "running" && newest.run !== view.run && !session.player.isRunning;
  says.notice("begun", hasBegun ? `A run has begun: ${newest.run}.` : null, hasBegun ? ["Watch it", () => watch(newest.run, true)] : null);
}

function watch(run, follows = false) {
  says.notice("begun", null);
  show({ run, follows, dwell: null, target: null, zoom: 1, particles: false, view: "radar" });
}

function target(step) {
  const numbers = radar.dwell?.targets.map((one) => one.target) ?? [];
  if (!numbers.length) return;
  const at = numbers.indexOf(view.target);
  show({ target: numbers[(at + (at < 0 && step < 0 ? 0 : step) + numbers.length) % numbers.length] });
}

function zoom(step) {
  if (step > 0 && view.target === null) target(1);
  show({ zoom: ZOOMS[Math.min(Math.max(ZOOMS.indexOf(view.zoom) + step, 0), ZOOMS.length - 1)] });
}

function particles() {
  if (view.target === null) target(1);
  show({ particles: !view.particles });
}

function seek(steps) {
  session.player.seek(session.player.t + steps);
}

function theme() {
  setTheme(isDark() ? "light" : "dark");
}

function views() {
  document.body.dataset.view = view.view;
  for (const name of VIEWS) byId(name).hidden = view.view !== name;
  links();
  machines.watch(view.view === "machines", view.run);
  if (view.view === "runs") runs.draw(null);
  compare.show(view.run, view.beside, view.view === "runs");
}

function links() {
  for (const anchor of document.querySelectorAll("[data-view-link]")) {
    const name = anchor.dataset.viewLink;
    anchor.href = link({ view: name });
    if (name === view.view) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  put(byId("zoom"), `${view.zoom}×`);
  byId("north").setAttribute("aria-pressed", String(view.north));
  byId("zoom-out").disabled = view.zoom === 1;
}

onView((changed) => {
  const isRun = changed.includes("run");
  if (isRun) orders.open(view.run);
  if (isRun && view.run !== null) session.open(view.run);
  if (view.run === null && (isRun || changed.includes("follows"))) runs.refresh();
  if (!isRun && changed.includes("dwell") && session.dwells) {
    if (view.dwell === null && session.player.mode !== "live") session.player.live();
    else if (view.dwell !== null && view.dwell !== session.player.t) session.player.seek(view.dwell);
  }
  if (changed.includes("speed") && view.speed) session.setSpeed(view.speed);
  if (changed.includes("view") || changed.includes("beside") || isRun) views();
  else links();
  if (isRun || changed.includes("target")) command.draw();
  radar.redraw();
});

// Links of the page are views of it; with a modifier they open elsewhere as ever.
document.addEventListener("click", (event) => {
  const anchor = event.target.closest("a[data-run], a[data-view-link]");
  if (!anchor || event.button || event.ctrlKey || event.metaKey || event.shiftKey) return;
  event.preventDefault();
  if (anchor.dataset.run) watch(anchor.dataset.run);
  else show({ view: anchor.dataset.viewLink });
});

byId("theme").addEventListener("click", theme);
byId("help-open").addEventListener("click", () => byId("help").showModal());
byId("zoom-in").addEventListener("click", () => zoom(1));
byId("zoom-out").addEventListener("click", () => zoom(-1));
byId("particles").addEventListener("click", particles);
byId("north").addEventListener("click", () => show({ north: !view.north }));
byId("snapshot").addEventListener("click", () => radar.snapshot());
byId("film").addEventListener("click", () => radar.film());
byId("scope").addEventListener("wheel", (event) => {
  if (!event.ctrlKey && document.activeElement === document.body && innerWidth < 900) return;
  event.preventDefault();
  zoom(event.deltaY < 0 ? 1 : -1);
}, { passive: false });

// A target by its number; of tracks that come and go, whose numbers grow, that of a row of the table.
const toTarget = (event) => {
  const shown = radar.dwell?.targets ?? [];
  const one = radar.radar?.is_unknown ? shown[Number(event.key) - 1] : shown.find((found) => found.target === Number(event.key));
  if (one) show({ target: one.target });
};
const to = (name) => () => show({ view: name });
listen({
  " ": () => session.toggle(), ArrowLeft: (e) => seek(e.shiftKey ? -10 : -1), ArrowRight: (e) => seek(e.shiftKey ? 10 : 1),
  Home: () => session.player.seek(1), End: () => session.player.live(), l: () => session.player.live(),
  ",": () => session.faster(-1), ".": () => session.faster(1), digit: toTarget, j: () => target(1), k: () => target(-1),
  Escape: () => (command.mode ? command.turn(null) : show({ target: null, zoom: 1, particles: false })), "+": () => zoom(1), "-": () => zoom(-1),
  0: () => show({ zoom: 1 }), p: particles, c: () => command.toggle(),
  n: () => byId("north").hidden || show({ north: !view.north }),
  s: () => command.aim("sector"), o: () => command.aim("look"), g: to("radar"), t: to("list"), m: to("machines"), r: to("runs"), d: theme,
  "?": () => byId("help").showModal(),
});

function themed() {
  put(byId("theme"), isDark() ? "Light" : "Dark");
  session.timeline.draw();
}

onTheme(themed);
themed();
for (const place of document.querySelectorAll(".scroll")) mark(place);
views();
orders.open(view.run);
if (view.run !== null) session.open(view.run);
runs.refresh();
setInterval(() => {
  if (!document.hidden) orders.watch(session.player.isRunning);
  if (!document.hidden && (view.view === "runs" || !session.player.isRunning)) runs.refresh();
  if (!document.hidden && view.view === "runs") compare.show(view.run, view.beside, true);
}, LOOK_MS);
