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

const CRC = Uint32Array.from({ length: 256 }, (_, value) => {
  let crc = value;
  for (let bit = 0; bit < 8; bit += 1) crc = crc & 1 ? 0xedb88320 ^ (crc >>> 1) : crc >>> 1;
  return crc;
});

/**
 * A PNG of 8 bits a channel without alpha: signature, header, pixels, end, and nothing else. Its pixels are not
 * compressed, which is done at once; what is taken along is, see smallPng.
 * @param {Uint8ClampedArray<ArrayBuffer>} pixels  RGBA of a square.
 */
export function encodePng(pixels) {
  return assembled(pixels, stored(linesOf(pixels)));
}

/** The same, compressed. @param {Uint8ClampedArray<ArrayBuffer>} pixels */
export async function smallPng(pixels) {
  const packed = new Blob([linesOf(pixels)]).stream().pipeThrough(new CompressionStream("deflate"));
  return assembled(pixels, new Uint8Array(await new Response(packed).arrayBuffer()));
}

/** Lines of red, green and blue, each after a byte that says: no filter. @param {Uint8ClampedArray<ArrayBuffer>} pixels */
function linesOf(pixels) {
  const side = Math.sqrt(pixels.length / 4);
  const lines = new Uint8Array(side * (3 * side + 1));
  for (let row = 0, to = 0; row < side; row += 1) {
    to += 1;
    for (let column = 0; column < side; column += 1) {
      const from = 4 * (row * side + column);
      for (let channel = 0; channel < 3; channel += 1) lines[to++] = pixels[from + channel];
    }
  }
  return lines;
}

/** In zlib's form, as it is. @param {Uint8Array} data */
function stored(data) {
  const most = 65535;
  const blocks = Math.ceil(data.length / most);
  const bytes = new Uint8Array(2 + data.length + 5 * blocks + 4);
  const view = new DataView(bytes.buffer);
  bytes.set([0x78, 0x01]);
  for (let block = 0; block < blocks; block += 1) {
    const part = data.subarray(block * most, (block + 1) * most);
    const at = 2 + block * (most + 5);
    bytes[at] = block + 1 === blocks ? 1 : 0;
    view.setUint16(at + 1, part.length, true);
    view.setUint16(at + 3, ~part.length & 0xffff, true);
    bytes.set(part, at + 5);
  }
  let [low, high] = [1, 0];
  for (const byte of data) {
    low = (low + byte) % 65521;
    high = (high + low) % 65521;
  }
  view.setUint32(bytes.length - 4, high * 65536 + low);
  return bytes;
}

/** @param {Uint8ClampedArray<ArrayBuffer>} pixels @param {Uint8Array<ArrayBuffer>} packed */
function assembled(pixels, packed) {
  const side = Math.sqrt(pixels.length / 4);
  const header = new DataView(new ArrayBuffer(13));
  header.setUint32(0, side);
  header.setUint32(4, side);
  header.setUint8(8, 8);
  header.setUint8(9, 2);
  const parts = [
    Uint8Array.of(137, 80, 78, 71, 13, 10, 26, 10),
    chunk("IHDR", new Uint8Array(header.buffer)),
    chunk("IDAT", packed),
    chunk("IEND", new Uint8Array(0)),
  ];
  const bytes = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    bytes.set(part, at);
    at += part.length;
  }
  return bytes;
}

/**
 * @param {string} name
 * @param {Uint8Array} data
 */
function chunk(name, data) {
  const bytes = new Uint8Array(12 + data.length);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, data.length);
  for (let at = 0; at < 4; at += 1) bytes[4 + at] = name.charCodeAt(at);
  bytes.set(data, 8);
  let crc = 0xffffffff;
  for (const byte of bytes.subarray(4, 8 + data.length)) crc = CRC[(crc ^ byte) & 255] ^ (crc >>> 8);
  view.setUint32(8 + data.length, (crc ^ 0xffffffff) >>> 0);
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
