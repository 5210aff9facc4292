// The chosen track over its life, where nobody knows how many targets there are: share, existence, statistic, error.

import { decades, lines, tested } from "./plot.js";
import { fixed, percent, short } from "./text.js";

export const LIFE = {
  name: "track",
  title: "Track",
  rows: ["Share %", "Exists", "Statistic", "Error km"],
  isNone: (track, t) => `Track ${track} is not there in dwell ${t}`,
  goesOn: (dwell, track, known) => dwell.t > known && dwell.targets.some((one) => one.target === track),
  range: (data) => [data.t[0] - 1, Math.max(data.t.at(-1), data.t[0] + 20) + 1],
  scale(shape, data) {
    Object.assign(shape.yaxis2, { range: [0, 1.04], tickvals: [0, 0.5, 1] });
    Object.assign(shape.yaxis4, decades(data.error_km));
  },
  facts: (one) => [
    ["Share", percent(one.share), "%"],
    ["Exists", percent(one.existence), one.modes ? `%, turns ${percent(one.modes[1], 0)} %, hard ${percent(one.modes[2], 0)} %` : "%"],
    ["Since", String(one.born_t), "dwell"],
    ["Error", fixed(one.error_km, 2), one.follows === null ? "km" : `km, of target ${one.follows}`],
  ],
  traces(data) {
    const line = lines(data);
    return [
      line(data.share.map((share) => 100 * share), 1),
      line(data.existence, 2),
      ...tested(data, 3),
      line(data.error_km, 4),
    ];
  },
  words: (data, last) => `Track ${data.target} from dwell ${data.t[0]} to ${data.t[last]}: existence ${fixed(data.existence[last], 2)}, error ${short(data.error_km[last])} km. The table of tracks has the numbers of each dwell.`,
};
