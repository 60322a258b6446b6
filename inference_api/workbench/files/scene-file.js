// Files that are opened or dropped: a picture of one's own, or a scene file.

/** @import {Workbench} from "./main.js" */

import { ask } from "./api.js";
import { toBase64 } from "./picture.js";
import { MAX_DISCS } from "./state.js";

// The API takes no larger body, and base64 makes four letters of three bytes.
const MAX_FILE = 5 * 1024 * 1024;

/** @param {Workbench} bench @param {File} file */
export async function openFile(bench, file) {
  if (file.size > MAX_FILE) {
    const expected = "a PNG of 16 to 2048 pixels a side, or a scene file";
    return bench.messages.refuse("The file is too large", `${file.name} has more than 5 MiB`, expected);
  }
  if (!/\.(ya?ml|json)$/i.test(file.name)) {
    return bench.change({ picture: toBase64(new Uint8Array(await file.arrayBuffer())) });
  }
  try {
    // A server with the ground truth reads YAML, too, and the line that is wrong.
    const ours = () => new Response(file).json().catch(() => null);
    showScene(bench, bench.about.truth ? await ask("workbench/scene-file", { text: await file.text() }) : await ours());
  } catch (error) {
    bench.messages.failed(error);
  }
}

/** @param {Workbench} bench @param {any} values  As a scene file has them. */
function showScene(bench, values) {
  const { messages, robot, models } = bench;
  const rows = Array.isArray(values?.obstacles) && values.obstacles.length <= MAX_DISCS ? values.obstacles : [null];
  const discs = rows.map((/** @type {any} */ one) => ({ x: one?.x_m, y: one?.y_m, r: one?.radius_m ?? 1 }));
  const ends = [values?.start, values?.goal].filter((end) => end !== undefined);
  const good =
    discs.every((/** @type {any} */ { x, y, r }) => [x, y, r].every(Number.isFinite) && r > 0) &&
    ends.every((end) => Array.isArray(end) && end.every(Number.isFinite));
  if (!good || !values.robot || !robot) {
    const expected = `robot, at most ${MAX_DISCS} obstacles, start and goal in JSON; YAML where the server has the ground truth`;
    return messages.refuse("Not a scene file", "The page cannot read it", expected);
  }
  const planar = models.filter((model) => model.world?.kind === "planar");
  const fitting = [bench.listed, ...planar].find((model) => model && isRobot(model.world.robot, values.robot));
  if (!fitting) {
    const own = JSON.stringify(values.robot);
    return messages.refuse("No model for the file’s robot", own, `a robot as ${JSON.stringify(bench.listed?.world.robot)}, or a model of the file’s robot on this server`);
  }
  const model = fitting === bench.listed ? bench.state.model : fitting.reference;
  const { start = bench.state.start, goal = bench.state.goal } = values;
  messages.clear();
  bench.showScene({ discs, start, goal, model });
}

/** Whether what a file says of its robot holds for a model's. @param {any} known @param {any} given */
function isRobot(known, given) {
  const same = (/** @type {string} */ name) => JSON.stringify(given[name] || null) === JSON.stringify(known[name] || null);
  return Object.keys(given).every(same);
}
