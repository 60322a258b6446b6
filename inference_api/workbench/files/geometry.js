// The plane and the joint space: where links are, and how angles wrap.

/**
 * @typedef {number[]} Configuration  An angle in rad for each joint.
 * @typedef {"start" | "goal"} End  Of a path.
 * @typedef {{x: number, y: number, r: number}} Disc  Centre and radius in m.
 * @typedef {{x: number, y: number}} Point  In m.
 * @typedef {{links: number[], halfWidth: number, low: number[], high: number[], circle: boolean[]}} Robot
 * @typedef {{left: number, right: number, bottom: number, top: number}} Camera
 */

const TURN = 2 * Math.PI;

/** An angle in [-pi, pi). @param {number} angle */
function wrap(angle) {
  const turned = (angle + Math.PI) % TURN;
  return (turned < 0 ? turned + TURN : turned) - Math.PI;
}

/** Ends of the links, base first, tip last. @param {Robot} robot @param {Configuration} configuration */
export function jointPositions(robot, configuration) {
  let [x, y, heading] = [0, 0, 0];
  const found = [{ x, y }];
  robot.links.forEach((length, joint) => {
    heading += configuration[joint];
    x += length * Math.cos(heading);
    y += length * Math.sin(heading);
    found.push({ x, y });
  });
  return found;
}

/** The angle at which a link points to a place. @param {Robot} robot @param {Configuration} configuration @param {number} joint @param {Point} place */
export function pointedAt(robot, configuration, joint, place) {
  const base = jointPositions(robot, configuration)[joint];
  const before = configuration.slice(0, joint).reduce((sum, angle) => sum + angle, 0);
  return Math.atan2(place.y - base.y, place.x - base.x) - before;
}

/** A configuration within the joint limits. @param {Robot} robot @param {Configuration} configuration */
export const bound = (robot, configuration) =>
  robot.links.map((_, joint) => {
    const [angle, low, high] = [configuration[joint] ?? 0, robot.low[joint], robot.high[joint]];
    if (robot.circle[joint]) return wrap(angle);
    return Math.min(high, Math.max(low, angle > high || angle < low ? wrap(angle) : angle));
  });

/** The shortest motion between configurations. @param {Robot} robot @param {Configuration} from @param {Configuration} to */
export const difference = (robot, from, to) =>
  robot.links.map((_, joint) => (robot.circle[joint] ? wrap(to[joint] - from[joint]) : to[joint] - from[joint]));

/** The configuration at a share of a path's length. @param {Robot} robot @param {Configuration[]} path @param {number} share */
export function along(robot, path, share) {
  const steps = path.slice(1).map((to, at) => difference(robot, path[at], to));
  const lengths = steps.map((step) => Math.hypot(...step));
  let left = share * lengths.reduce((sum, length) => sum + length, 0);
  for (let at = 0; at < steps.length; at += 1) {
    if (left <= lengths[at] || at === steps.length - 1) {
      const part = lengths[at] > 0 ? Math.min(1, left / lengths[at]) : 0;
      return bound(robot, path[at].map((angle, joint) => angle + part * steps[at][joint]));
    }
    left -= lengths[at];
  }
  return path[0];
}

/** An angle for people. @param {number} angle */
export const degrees = (angle) => `${Math.round((angle * 180) / Math.PI)}°`.replace("-", "−");
