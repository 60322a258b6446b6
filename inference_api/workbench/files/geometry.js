// The plane and the joint space: where links are, and how angles go round.

/**
 * @typedef {number[]} Configuration  An angle in rad for each joint.
 * @typedef {"start" | "goal"} End  Of a path.
 * @typedef {{x: number, y: number, r: number}} Disc  Centre and radius in m.
 * @typedef {{x: number, y: number}} Point  In m.
 * @typedef {{links: number[], halfWidth: number, low: number[], high: number[], circle: boolean[]}} Robot
 * @typedef {{left: number, right: number, bottom: number, top: number, pixels: number}} Camera
 */

const TURN = 2 * Math.PI;

/**
 * An angle in [-pi, pi).
 * @param {number} angle
 */
export function wrap(angle) {
  const turned = (angle + Math.PI) % TURN;
  return (turned < 0 ? turned + TURN : turned) - Math.PI;
}

/**
 * Ends of the links, the base first, the tip last.
 * @param {Robot} robot
 * @param {Configuration} configuration
 * @returns {Point[]}
 */
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

/**
 * The angle of a joint at which its link points to a place.
 * @param {Robot} robot
 * @param {Configuration} configuration
 * @param {number} joint
 * @param {Point} place
 */
export function pointedAt(robot, configuration, joint, place) {
  const base = jointPositions(robot, configuration)[joint];
  const before = configuration.slice(0, joint).reduce((sum, angle) => sum + angle, 0);
  return Math.atan2(place.y - base.y, place.x - base.x) - before;
}

/**
 * A configuration within the limits: circles are wrapped, other joints stopped.
 * @param {Robot} robot
 * @param {Configuration} configuration
 */
export function bound(robot, configuration) {
  return robot.links.map((_, joint) => {
    const angle = configuration[joint] ?? 0;
    if (robot.circle[joint]) return wrap(angle);
    const inside = angle > robot.high[joint] || angle < robot.low[joint] ? wrap(angle) : angle;
    return Math.min(robot.high[joint], Math.max(robot.low[joint], inside));
  });
}

/**
 * The path from one configuration to another, the shorter side round circles.
 * @param {Robot} robot
 * @param {Configuration} from
 * @param {Configuration} to
 */
export function difference(robot, from, to) {
  return robot.links.map((_, joint) => {
    const step = to[joint] - from[joint];
    return robot.circle[joint] ? wrap(step) : step;
  });
}

/**
 * The configuration a share of a path's length along it.
 * @param {Robot} robot
 * @param {Configuration[]} path
 * @param {number} share  0 to 1.
 */
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

/**
 * An angle for people.
 * @param {number} angle
 */
export function degrees(angle) {
  return `${Math.round((angle * 180) / Math.PI)}°`.replace("-", "−");
}
