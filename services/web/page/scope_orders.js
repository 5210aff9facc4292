// What is commanded, on the scope.

import { color } from "./palette.js";
import { radians, wedge } from "./scope_frame.js";

// Sectors and looks that the waveform of this dwell obeys, and the sector that is about to be commanded.
export function commanded(frame, { told }) {
  const { context } = frame;
  for (const { search: times, from, to } of told?.sectors ?? []) {
    if (times === "blank") hatched(frame, radians(from), radians(to));
    if (times === "double") twice(frame, radians(from), radians(to));
  }
  context.strokeStyle = context.fillStyle = color("accent");
  for (const { bearing } of told?.looks ?? []) {
    context.beginPath();
    wedge(frame, radians(bearing), radians(bearing));
    context.setLineDash([12, 4, 2, 4]);
    context.lineWidth = 2;
    context.stroke();
  }
  context.setLineDash([]);
  if (told?.isPaused) silent(frame);
  if (!told?.asked) return;
  context.beginPath();
  wedge(frame, radians(told.asked.from), radians(told.asked.to));
  context.globalAlpha = 0.15;
  context.fill();
  context.globalAlpha = 1;
  context.lineWidth = 2;
  context.stroke();
}

// Two bars and words, above all: nothing is radiated.
function silent({ context, width }) {
  context.save();
  context.fillStyle = color("alarm");
  for (const x of [-8, 2]) context.fillRect(width / 2 - 82 + x, 34, 6, 18);
  context.font = "bold 14px sans-serif";
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.fillText("Transmission paused", width / 2 - 66, 43);
  context.restore();
}

function hatched(frame, from, to) {
  const { context, width, height } = frame;
  context.save();
  context.beginPath();
  wedge(frame, from, to);
  context.strokeStyle = color("warn");
  context.lineWidth = 4; // half of it is cut off
  context.clip();
  context.stroke();
  context.lineWidth = 1;
  context.beginPath();
  for (let x = -height; x < width; x += 11) {
    context.moveTo(x, height);
    context.lineTo(x + height, 0);
  }
  context.globalAlpha = 0.6;
  context.stroke();
  context.restore();
}

// Two arcs along the edge.
function twice({ context, arc, reach, zoom }, from, to) {
  if (zoom > 1) return;
  context.strokeStyle = color("accent");
  context.lineWidth = 1.5;
  for (const inset of [4, 9]) {
    context.beginPath();
    arc(reach - inset, from, to);
    context.stroke();
  }
}
