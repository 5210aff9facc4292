// What is shown, and its link: the address of the page always says it.

export const VIEWS = ["radar", "list", "machines", "runs"];
export const SPEEDS = [1, 2, 5, 10, 20];
export const ZOOMS = [1, 2, 4, 8, 16, 32];
const URL_EVERY_MS = 500; // browsers refuse an address that changes more often for long

const listeners = [];
let timer = 0;

const NEWEST = "newest"; // as the run of an address

// `beside`: a second run to compare with. `dwell` null: the newest. `follows`: the newest run, whichever that is; `run` is the one that is shown.
export const view = read();

function read() {
  const asked = new URLSearchParams(location.search);
  const count = (name) => (/^[1-9]\d{0,8}$/.test(asked.get(name) ?? "") ? Number(asked.get(name)) : null);
  const one = (name, allowed) => (allowed.includes(count(name)) ? count(name) : null);
  const run = asked.get("run");
  const follows = run === null || run === NEWEST;
  return {
    run: follows ? null : run,
    follows,
    dwell: count("dwell"),
    target: count("target"),
    view: VIEWS.includes(asked.get("view")) ? asked.get("view") : "radar",
    zoom: one("zoom", ZOOMS) ?? 1,
    speed: one("speed", SPEEDS),
    particles: asked.get("particles") === "1",
    beside: asked.get("beside"),
    north: asked.get("north") === "1",
  };
}

// The link to this view, with some of it changed.
export function link(changes = {}) {
  const shown = { ...view, ...changes };
  if (shown.follows && shown.dwell === null) shown.run = NEWEST; // with a dwell the address is of what is seen
  const query = new URLSearchParams();
  for (const name of ["run", "dwell", "target", "speed", "beside"]) if (shown[name] !== null) query.set(name, shown[name]);
  if (shown.view !== "radar") query.set("view", shown.view);
  if (shown.zoom !== 1) query.set("zoom", shown.zoom);
  if (shown.north) query.set("north", "1");
  if (shown.particles) query.set("particles", "1");
  const text = query.toString();
  return text ? `?${text}` : location.pathname;
}

// Another run or view is a step of the browser's history, the rest is not.
export function show(changes) {
  const changed = Object.keys(changes).filter((name) => view[name] !== changes[name]);
  if (!changed.length) return;
  const isChosen = !(changes.follows ?? view.follows); // and not moved on to
  const isStep = changed.some((name) => name === "view" || (name === "run" && view.run !== null && isChosen));
  if (isStep) flush();
  Object.assign(view, changes);
  if (isStep) history.pushState(null, "", link());
  else timer ||= setTimeout(flush, URL_EVERY_MS);
  for (const listener of listeners) listener(changed);
}

function flush() {
  clearTimeout(timer);
  timer = 0;
  if (link() !== location.search) history.replaceState(null, "", link());
}

export function onView(listener) {
  listeners.push(listener);
}

addEventListener("popstate", () => {
  clearTimeout(timer);
  timer = 0;
  const before = { ...view };
  Object.assign(view, read());
  const changed = Object.keys(view).filter((name) => view[name] !== before[name]);
  for (const listener of listeners) listener(changed);
});
