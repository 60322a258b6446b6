// The picture that the model sees, pixel by pixel as the training drew it, and its PNG.

/** @import {Camera, Disc, Robot} from "./geometry.js" */

import { jointPositions } from "./geometry.js";

const SUBSAMPLES = 8;

/** Much faster than Math.hypot, which guards against what is not here. @param {number} x @param {number} y */
const length = (x, y) => Math.sqrt(x * x + y * y);

/**
 * Red discs over the blue arm at angle zero on white ground, y up.
 * @param {Robot} robot
 * @param {Camera} camera
 * @param {Disc[]} discs
 * @returns {Uint8ClampedArray<ArrayBuffer>} RGBA, row by row from the top.
 */
export function render(robot, camera, discs) {
  const joints = jointPositions(robot, robot.links.map(() => 0));
  const width = (camera.right - camera.left) / camera.pixels;
  const height = (camera.top - camera.bottom) / camera.pixels;
  const reach = Math.hypot(width, height) / 2;

  /** @param {number} x @param {number} y */
  const toDisc = (x, y) => {
    let least = Infinity;
    for (const disc of discs) least = Math.min(least, length(x - disc.x, y - disc.y) - disc.r);
    return least;
  };

  /** @param {number} x @param {number} y */
  const toArm = (x, y) => {
    let least = Infinity;
    for (let link = 0; link + 1 < joints.length; link += 1) {
      const [from, to] = [joints[link], joints[link + 1]];
      const [dx, dy, px, py] = [to.x - from.x, to.y - from.y, x - from.x, y - from.y];
      const part = Math.min(1, Math.max(0, (px * dx + py * dy) / (dx * dx + dy * dy)));
      least = Math.min(least, length(px - part * dx, py - part * dy) - robot.halfWidth);
    }
    return least;
  };

  /** @param {number} left @param {number} top @returns {[number, number]} shares of discs and arm */
  const shares = (left, top) => {
    const disc = toDisc(left + width / 2, top - height / 2);
    const arm = toArm(left + width / 2, top - height / 2);
    if (disc <= -reach) return [1, 0];
    if (disc >= reach && Math.abs(arm) >= reach) return [0, arm < 0 ? 1 : 0];
    let [inDisc, inArm] = [0, 0];
    for (let row = 0; row < SUBSAMPLES; row += 1) {
      for (let column = 0; column < SUBSAMPLES; column += 1) {
        const x = left + ((column + 0.5) * width) / SUBSAMPLES;
        const y = top - ((row + 0.5) * height) / SUBSAMPLES;
        if (toDisc(x, y) <= 0) inDisc += 1;
        else if (toArm(x, y) <= 0) inArm += 1;
      }
    }
    return [inDisc / SUBSAMPLES ** 2, inArm / SUBSAMPLES ** 2];
  };

  const pixels = new Uint8ClampedArray(4 * camera.pixels ** 2);
  for (let row = 0; row < camera.pixels; row += 1) {
    for (let column = 0; column < camera.pixels; column += 1) {
      const [disc, arm] = shares(camera.left + column * width, camera.top - row * height);
      const ground = 255 * (1 - disc - arm);
      const at = 4 * (row * camera.pixels + column);
      pixels[at] = Math.floor(255 * disc + ground + 0.5);
      pixels[at + 1] = Math.floor(ground + 0.5);
      pixels[at + 2] = Math.floor(255 * arm + ground + 0.5);
      pixels[at + 3] = 255;
    }
  }
  return pixels;
}

/**
 * A PNG of 8 bits a channel without alpha: signature, header, pixels, end, and nothing else.
 * @param {Uint8ClampedArray<ArrayBuffer>} pixels  RGBA of a square.
 */
export async function encodePng(pixels) {
  const side = Math.sqrt(pixels.length / 4);
  const header = new DataView(new ArrayBuffer(13));
  header.setUint32(0, side);
  header.setUint32(4, side);
  header.setUint8(8, 8);
  header.setUint8(9, 2);
  const packing = new CompressionStream("deflate");
  const writer = packing.writable.getWriter();
  void writer.write(linesOf(pixels, side)).then(() => writer.close());
  const parts = [
    Uint8Array.of(137, 80, 78, 71, 13, 10, 26, 10),
    chunk("IHDR", new Uint8Array(header.buffer)),
    chunk("IDAT", new Uint8Array(await new Response(packing.readable).arrayBuffer())),
    chunk("IEND", new Uint8Array(0)),
  ];
  const bytes = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  parts.reduce((at, part) => (bytes.set(part, at), at + part.length), 0);
  return bytes;
}

/** Lines of red, green and blue, each after a byte that says: no filter. @param {Uint8ClampedArray} pixels @param {number} side */
function linesOf(pixels, side) {
  const lines = new Uint8Array(side * (3 * side + 1));
  for (let at = 0; at < side * side; at += 1) {
    const row = Math.floor(at / side);
    lines.set(pixels.subarray(4 * at, 4 * at + 3), 3 * at + row + 1);
  }
  return lines;
}

/** @param {string} name @param {Uint8Array} data */
function chunk(name, data) {
  const bytes = new Uint8Array(12 + data.length);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, data.length);
  bytes.set(new TextEncoder().encode(name), 4);
  bytes.set(data, 8);
  let crc = ~0;
  for (const byte of bytes.subarray(4, 8 + data.length)) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit += 1) crc = (crc >>> 1) ^ (crc & 1 && 0xedb88320);
  }
  view.setUint32(8 + data.length, ~crc >>> 0);
  return bytes;
}

/** @param {Uint8Array} bytes */
export function toBase64(bytes) {
  let text = "";
  for (const byte of bytes) text += String.fromCharCode(byte);
  return btoa(text);
}

/** @param {string} text @returns {Uint8Array<ArrayBuffer>} */
export function fromBase64(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}
