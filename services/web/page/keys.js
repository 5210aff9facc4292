// The keyboard: every button's short cut. The help lists them.

import { byId } from "./text.js";

// `acts` maps keys to what they do. Keys that an element in focus uses itself are left to it.
export function listen(acts) {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || byId("help").open) return;
    const on = event.target.closest?.("input, select, textarea, button, a");
    if (on?.matches("input[type=search], textarea")) return;
    const isSlider = on?.matches("input[type=range]");
    if (on && event.key === " " && !isSlider) return;
    if (on?.matches("select") && (event.key.startsWith("Arrow") || /^\d$/.test(event.key))) return;
    const isPlace = event.target.closest?.(".scroll") && ["Home", "End"].includes(event.key);
    const act = isPlace ? null : acts[event.key] ?? (/^[1-9]$/.test(event.key) ? acts.digit : null);
    if (!act) return;
    event.preventDefault();
    act(event);
  });
}
