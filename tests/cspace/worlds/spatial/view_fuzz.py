"""View files, cameras and rows of configurations, changed by chance: answered, or refused by typed errors.

``python -m tests.cspace.worlds.spatial.view_fuzz FIRST_SEED COUNT`` tries so many and prints what came of it.
Where information was only removed (pixels without a reading, a camera turned away, fewer pixels or pictures),
the answer must not be surer: see :func:`surer`.
"""

import json
import random
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.bundle.samples import fitted_configurations
from cspace.errors import InputError
from cspace.simulator import Split
from cspace.view_file import pack_view
from cspace.worlds import simulator_of
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.camera import looking
from cspace.worlds.spatial.sensor import grid_of
from cspace.worlds.spatial.view import DepthView, write_view
from cspace.worlds.spatial.visibility import lookup
from cspace.worlds.spatial.world import SpatialWorld
from inference_api.settings import PRETRAINED_FOLDER
from tests.cspace.worlds.spatial.test_camera_forms import npy, placed, tiff

NUMBERS = (0, 1, -1, 0.5, -0.0, 1e-300, 1e300, 1e9, 2**31, 2**63, 10**18, 63.5, 255, 65535)
VALUES = (*NUMBERS, "", "x", "1", None, True, [], {}, [0], [[[]]], [[0.0] * 4] * 4)
DTYPES = ("<f4", "<f8", "<i4", "<u2", "?", "<c8", "U3")
# Voxels for what is tried often, m.
COARSE_M = 0.05
# Of 100 mutants, so many with information removed are held against the shipped model as well.
JUDGED_EVERY = 10
MARGIN = 0.02
Rng = random.Random


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What an answer says of configurations.

    Args:
        unseen: (n,) share of the arm in unseen space.
        confidence: (n,) of the shipped model; None where it was not asked.
        novelty: likewise.
        codes: of the warnings.
    """

    unseen: NDArray[np.floating]
    confidence: NDArray[np.floating] | None
    novelty: float
    codes: frozenset[str]


class Subject:
    """A world whose cameras are changed, and the shipped model of its arm.

    Args:
        scenes: how many originals.
    """

    def __init__(self, scenes: int = 12) -> None:
        self.bundle = Bundle.load(PRETRAINED_FOLDER.with_name("pretrained_panda"))
        self.fine: SpatialWorld = self.bundle.spec.world  # type: ignore[assignment]
        self.arm: SerialArm = self.fine.body
        self.coarse = replace(self.fine, sensor=replace(self.fine.sensor, grid=grid_of(self.arm, COARSE_M)))
        simulator: Any = simulator_of(self.fine)
        self.views = [self._smaller(scene.view()) for scene in simulator.scenes(Split.DEMO, 11, scenes)]
        rows = self.fine.space.sample_uniform(np.random.default_rng(0), 96)
        self.rows = rows.astype(np.float32)
        self._centres = self.arm.sphere_centres_m(rows)

    def answer(self, view: DepthView, *, judged: bool) -> Seen:
        """What is answered to a view.

        Raises:
            InputError: it is refused.
        """
        world = self.fine if judged else self.coarse
        read = world.examined(view)
        codes = frozenset(one.code for one in read.findings)
        if judged:
            picture = self.bundle.prepare(read.images[0])
            confidence, unseen = self.bundle.predict(picture, self.rows)
            assert unseen is not None and picture.novelty is not None  # noqa: PT018
            return Seen(unseen, confidence, picture.novelty, codes)
        volumes = self.arm.spheres_m()[:, 3] ** 3
        unseen = lookup(read.images[0], world.sensor.grid, self._centres).unseen @ (volumes / volumes.sum())
        return Seen(unseen, None, world.least_novelty(read.images[0]), codes)

    @staticmethod
    def _smaller(view: DepthView) -> DepthView:
        return strided(view, 2)


def strided(view: DepthView, step: int) -> DepthView:
    """Every so many pixels of each picture, along both sides."""
    pictures = tuple(np.ascontiguousarray(one[::step, ::step]) for one in view.pictures)
    cameras = tuple(
        replace(
            camera,
            fx=camera.fx / step,
            fy=camera.fy / step,
            cx=camera.cx / step,
            cy=camera.cy / step,
            width=picture.shape[1],
            height=picture.shape[0],
        )
        for picture, camera in zip(pictures, view.cameras, strict=True)
    )
    return replace(view, pictures=pictures, cameras=cameras)


def without_pixels(rng: Rng, view: DepthView) -> DepthView:
    """Some pixels read nothing: here and there, a rectangle, or all in a range of depths."""
    number = rng.randrange(len(view.pictures))
    picture = view.pictures[number].copy()
    draw, kind = np.random.default_rng(rng.randrange(2**32)), rng.randrange(3)
    if kind == 0:
        picture[draw.random(picture.shape) < rng.uniform(0.01, 0.95)] = rng.choice((0, 65535))
    elif kind == 1:
        row, column = (rng.randrange(side) for side in picture.shape)
        picture[row : row + rng.randint(1, 64), column : column + rng.randint(1, 64)] = rng.choice((0, 65535))
    else:
        low, high = sorted(np.quantile(picture[picture > 0], [rng.random(), rng.random()]))
        picture[(picture >= low) & (picture <= high)] = 0
    return with_picture(view, number, picture)


def with_picture(view: DepthView, number: int, picture: NDArray[np.uint16]) -> DepthView:
    """The view with another picture."""
    pictures = [*view.pictures]
    pictures[number] = picture
    return replace(view, pictures=tuple(pictures))


def turned_away(rng: Rng, view: DepthView) -> DepthView:
    """One camera looks from where it is to somewhere away from the arm."""
    number = rng.randrange(len(view.cameras))
    cameras = [*view.cameras]
    place = cameras[number].matrix[:3, 3]
    away = place + place * (1.0, 1.0, 0.0) + np.array([rng.uniform(-0.3, 0.3) for _ in range(3)])
    cameras[number] = replace(
        cameras[number], pose=tuple(map(tuple, looking(place, away, rng.uniform(-3.0, 3.0)).tolist()))
    )
    return replace(view, cameras=tuple(cameras))


def fewer_pixels(rng: Rng, view: DepthView) -> DepthView:
    """Every second or third pixel, or a part that is cut out."""
    if rng.random() < 0.5:
        return strided(view, rng.choice((2, 3)))
    pictures, cameras = [], []
    for picture, camera in zip(view.pictures, view.cameras, strict=True):
        height, width = picture.shape
        top, left = rng.randrange(height - 16), rng.randrange(width - 16)
        cut = picture[top : rng.randint(top + 16, height), left : rng.randint(left + 16, width)]
        pictures.append(np.ascontiguousarray(cut))
        at = {"cx": camera.cx - left, "cy": camera.cy - top}
        cameras.append(replace(camera, **at, width=cut.shape[1], height=cut.shape[0]))
    return replace(view, pictures=tuple(pictures), cameras=tuple(cameras))


def fewer_pictures(rng: Rng, view: DepthView) -> DepthView:
    """Without one of several."""
    kept = list(range(len(view.pictures)))
    if len(kept) > 1:
        kept.remove(rng.choice(kept))
    pictures, cameras = (tuple(all_[one] for one in kept) for all_ in (view.pictures, view.cameras))
    return replace(view, pictures=pictures, cameras=cameras)


REMOVED: tuple[Callable[[Rng, DepthView], DepthView], ...] = (
    without_pixels,
    turned_away,
    fewer_pixels,
    fewer_pictures,
)


def surer(before: Seen, after: Seen) -> bool:
    """Whether an answer is surer than one from more information, by more than :data:`MARGIN`.

    It is if more of the arm counts as seen to be free, or if configurations are held to be free with more
    confidence, and nothing that the answer says takes it back: no further warning, and for the confidence
    neither a higher unseen share nor a higher novelty. A single confidence may rise where an obstacle is no
    longer seen, so means over all configurations are compared.
    """
    warned = bool(after.codes - before.codes)
    seen_freer = float((before.unseen - after.unseen).mean()) > MARGIN
    if before.confidence is None or after.confidence is None:
        return seen_freer and not warned
    rises = float((after.confidence - before.confidence).mean()) > MARGIN
    uncertain = float((after.unseen - before.unseen).mean()) > 1e-3 or after.novelty > before.novelty
    return (seen_freer or (rises and not uncertain)) and not warned


def in_other_forms(rng: Rng, view: DepthView) -> bytes:
    """A view file of floats and messages of ROS, with lenses that bend a little."""
    pictures, cameras = [], []
    for picture, camera in zip(view.pictures, view.cameras, strict=True):
        metres = np.where(picture == 0, np.nan, picture / 1000.0).astype(np.float32)
        packing = rng.choice((None, "tiff_lzw", "tiff_adobe_deflate"))
        pictures.append(npy(metres) if rng.random() < 0.5 else tiff(metres, compression=packing))
        k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
        info = {"k": k, "width": camera.width, "height": camera.height, "distortion_model": "plumb_bob"}
        info["d"] = [rng.uniform(-0.1, 0.1), 0.0, 0.0, rng.choice((0.0, 0.001)), 0.0]
        text = rng.random() < 0.5
        cameras.append({"camera_info": json.dumps(info) if text else info, "pose": placed(camera.matrix)})
    return pack_view(pictures, cameras, None if view.state is None else list(view.state))


def damaged(rng: Rng, data: bytes) -> bytes:
    """A view file with bytes changed, or another value in its line."""
    if rng.random() < 0.5:
        line, _, rest = data.removeprefix(b"cspace-view 1 ").partition(b"\n")
        values = json.loads(line)
        place: Any = values
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = rng.choice(keys)
            if isinstance(place[key], dict | list) and place[key] and rng.random() < 0.8:
                place = place[key]
                continue
            place[key] = rng.choice(VALUES)
            break
        if rng.random() < 0.2:
            values["depth_scale_m"] = rng.choice(VALUES)
        return b"cspace-view 1 " + json.dumps(values).encode() + b"\n" + rest
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, size = rng.randrange(len(found) or 1), rng.choice((1, 1, 2, 4, 64))
        if rng.random() < 0.5:
            found[at : at + size] = rng.randbytes(size)
        elif rng.random() < 0.5:
            del found[at : at + size]
        else:
            del found[at:]
    return bytes(found)


def other_rows(rng: Rng, rows: NDArray[np.float32]) -> NDArray[Any]:
    """Rows of configurations of another unit, type or shape, or with wrong numbers among them."""
    found: NDArray[Any] = rows[: rng.randint(0, 8)].astype(np.float64)
    for _ in range(rng.choice((0, 1, 2))):
        if found.size:
            found.flat[rng.randrange(found.size)] = rng.choice((np.nan, np.inf, 1e300, 7.0, -400.0, 1e-9))
    kind = rng.randrange(4)
    if kind == 0:
        found = np.degrees(found)
    elif kind == 1:
        found = found[:, : rng.randrange(8)]
    elif kind == 2:
        with np.errstate(all="ignore"):
            found = found.astype(rng.choice(DTYPES))
    return found


def run(subject: Subject, seed: int, count: int) -> Counter[str]:
    """Try so many mutants.

    Returns:
        How many of each kind were answered, refused, and were surer.

    Raises:
        Exception: whatever is no typed error of the project, with the mutant's seed as a note.
    """
    known: dict[tuple[int, bool], Seen] = {}
    found: Counter[str] = Counter()
    for number in range(seed, seed + count):
        rng = Rng(number)
        try:
            found[_try(subject, rng, number, known)] += 1
        except Exception as error:
            error.add_note(f"mutant {number}")
            raise
    return found


def _try(subject: Subject, rng: Rng, number: int, known: dict[tuple[int, bool], Seen]) -> str:
    which, kind = rng.randrange(len(subject.views)), number % 5
    view = subject.views[which]
    try:
        if kind == 0:
            fitted = fitted_configurations(other_rows(rng, subject.rows), subject.bundle.spec)
            assert subject.fine.space.contains(fitted).all()
            return "rows answered"
        if kind < 3:
            whole = write_view(view) if kind == 1 else in_other_forms(rng, view)
            image = subject.coarse.examine_picture(damaged(rng, whole)).images[0]
            assert image.shape == subject.coarse.sensor.picture_shape
            return "files answered"
        change, judged = rng.choice(REMOVED), number // 5 % JUDGED_EVERY == 0
        after = subject.answer(change(rng, view), judged=judged)
    except InputError:
        return f"{('rows', 'files', 'files', 'removed', 'removed')[kind]} refused"
    if (which, judged) not in known:
        known[which, judged] = subject.answer(view, judged=judged)
    outcome = "surer" if surer(known[which, judged], after) else "answered"
    return f"{change.__name__}{' judged' if judged else ''} {outcome}"


if __name__ == "__main__":
    for outcome, times in sorted(run(Subject(), int(sys.argv[1]), int(sys.argv[2])).items()):
        print(f"{times:7d}  {outcome}")  # noqa: T201
