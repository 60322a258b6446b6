// Space: frames of an arm, poses of cameras, and where things are on the page.

/** @typedef {[number, number, number]} Vector  m. */
/** @typedef {number[][]} Matrix  Rows of 4 x 4. */
/** @typedef {{xyz_m: number[], rpy_rad: number[]}} Frame */
/**
 * @typedef {{joints: {axis: number[], origin: Frame, limits_rad: number[] | null, name: string}[],
 *   parts: {link: number, spheres_m: number[][]}[], tool: Frame, name: string}} SerialArm
 */

const SAME = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];

/** @param {Matrix} a @param {Matrix} b @returns {Matrix} */
function times(a, b) {
  return a.map((row) => [0, 1, 2, 3].map((column) => row.reduce((sum, value, at) => sum + value * b[at][column], 0)));
}

/** The rotation about an axis. @param {number[]} axis @param {number} angle @returns {Matrix} */
function turn([x, y, z], angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const t = 1 - c;
  return [
    [t * x * x + c, t * x * y - s * z, t * x * z + s * y, 0],
    [t * x * y + s * z, t * y * y + c, t * y * z - s * x, 0],
    [t * x * z - s * y, t * y * z + s * x, t * z * z + c, 0],
    [0, 0, 0, 1],
  ];
}

/** @param {Frame} frame @returns {Matrix} */
function matrixOf({ xyz_m: place, rpy_rad: [roll, pitch, yaw] }) {
  const turned = times(times(turn([0, 0, 1], yaw), turn([0, 1, 0], pitch)), turn([1, 0, 0], roll));
  return turned.map((row, at) => (at < 3 ? [row[0], row[1], row[2], place[at]] : row));
}

/** @param {Matrix} pose @param {number[]} point @returns {Vector} */
export function moved(pose, [x, y, z]) {
  const [a, b, c] = pose;
  return [
    a[0] * x + a[1] * y + a[2] * z + a[3],
    b[0] * x + b[1] * y + b[2] * z + b[3],
    c[0] * x + c[1] * y + c[2] * z + c[3],
  ];
}

/**
 * Frames of the links, the base first, the tool last.
 * @param {SerialArm} arm
 * @param {number[]} configuration  rad.
 * @returns {Matrix[]}
 */
export function frames(arm, configuration) {
  const found = [SAME];
  arm.joints.forEach((joint, at) => {
    found.push(times(times(found[at], matrixOf(joint.origin)), turn(joint.axis, configuration[at])));
  });
  found.push(times(found[found.length - 1], matrixOf(arm.tool)));
  return found;
}

/** @param {Vector} a @param {Vector} b @returns {Vector} */
export const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {number[]} a @param {number[]} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vector} a @param {Vector} b @returns {Vector} */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vector} a @returns {Vector} */
function unit(a) {
  const length = Math.hypot(...a) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
}

/** A place on the sphere about another. @param {Vector} about @param {number} side @param {number} up @param {number} away @returns {Vector} */
export function around(about, side, up, away) {
  return [
    about[0] + away * Math.cos(up) * Math.cos(side),
    about[1] + away * Math.cos(up) * Math.sin(side),
    about[2] + away * Math.sin(up),
  ];
}

/** The pose of a camera at one place that looks at another: x right, y down, z forward. @param {Vector} from @param {Vector} at @returns {Matrix} */
export function looking(from, at) {
  const ahead = unit(minus(at, from));
  const right = unit([ahead[1], -ahead[0], 0]);
  const down = cross(ahead, right);
  return [0, 1, 2].map((row) => [right[row], down[row], ahead[row], from[row]]).concat([[0, 0, 0, 1]]);
}
