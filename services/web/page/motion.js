// Where a track is and how it flies, of its estimate in km and km/s: x along the boresight, y to its right.

export const placeOf = ({ x_hat: x, y_hat: y }) => (x === null ? null : { range: Math.hypot(x, y), angle: Math.atan2(y, x) });

// m/s; null without an estimate.
export const speedOf = ({ vx_hat: vx, vy_hat: vy }) => (vx === null || vx === undefined ? null : 1000 * Math.hypot(vx, vy));

// Radians from the boresight, clockwise.
export const headingOf = ({ vx_hat: vx, vy_hat: vy }) => (vx === null || vx === undefined ? null : Math.atan2(vy, vx));

// An angle from the boresight in degrees: -180 to 180 without a site; with one from true north, 0 to 360.
export function degrees(radians, radar) {
  if (radians === null || radians === undefined) return null;
  const angle = (radians * 180) / Math.PI;
  return radar.site ? (((angle + radar.site.boresight_deg) % 360) + 360) % 360 : angle;
}
