"""Files of strangers, changed by chance: read, or refused by a typed error, within their reader's limits.

``python -m tests.training.data.mutants KIND FIRST_SEED COUNT`` tries so many mutants of one of ``KINDS`` in
bounded workers, and prints what came of them. No file outside a mutant's folder is opened or quoted.
"""

import importlib
import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import trimesh
from lxml import etree
from rosbags.rosbag2 import StoragePlugin

from cspace import bounded_worker
from cspace.errors import CspaceError, ServiceError
from cspace.view_file import pack_view
from cspace.worlds.spatial import world
from cspace.worlds.spatial.camera import encode_depth
from cspace.worlds.spatial.diagnosis import pose_findings
from tests.cspace.worlds.spatial.test_camera_forms import CAMERA_VALUES, DEPTH
from tests.space_bundle import WORLD
from tests.training.data.test_recordings import BASE, STATE, only_file, usual
from tests.training.robots.descriptions import TWO_LINKS
from training.data import recordings
from training.data.recordings import RecordingOptions, import_recording
from training.robots import spheres
from training.robots.description import read_description
from training.robots.importing import import_robot
from training.robots.spheres import Allowances

LIMITS = bounded_worker.Limits(memory_bytes=2**30, cpu_s=600, wall_s=900.0, file_bytes=2**26)
MOST_S, BATCH, SECRET = 30.0, 500, "secret-7f3a"
OBJ = b"v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
URDF = TWO_LINKS.replace('<box size="0.04 0.06 0.1"/>', '<mesh filename="tip.obj" scale="1 1 1"/>')
URDF = URDF.replace('<cylinder radius="0.05" length="0.3"/>', '<sphere radius="0.05"/>').partition("?>")[2]
SRDF = '<robot name="two"><disable_collisions link1="base" link2="lower" reason="Never"/></robot>'
XACRO = URDF.replace(">", ' xmlns:xacro="http://www.ros.org/wiki/xacro">', 1).replace("0.12", "${0.24 / 2}")
CORNER = trimesh.load_mesh(trimesh.util.wrap_as_stream(OBJ), file_type="obj")
MESHES = {"obj": OBJ} | {end: CORNER.export(file_type=end) for end in ("stl", "ply", "dae")}
NUMBERS = (
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e-308",
    "1e999",
    "nan",
    "-inf",
    "x",
    "1_0",
    "1,5",
    "100",
    "2000000000",
)
NAMES = (
    "base",
    "hand",
    "elbow",
    "fixed",
    "floating",
    "revolute",
    "a b",
    "%s",
    "\u202e",
    "",
    "1 2",
    "x" * 5000,
)
PATHS = (
    "{out}/secret.obj", "../out/secret.obj", "file://{out}/secret.obj", "%2e%2e/out/secret.obj", "link.obj",
    "%252e%252e/out/secret.obj", "package://../out/secret.obj", "package://out/secret.obj", "pipe.obj",
    "/dev/zero", "/etc/passwd", "http://127.0.0.1:9/secret.obj",
)  # fmt: skip
LAUGHS = "".join(f'<!ENTITY x{n + 1} "{f"&x{n};" * 10}">' for n in range(9))
DOCTYPES = (
    '<!DOCTYPE robot [<!ENTITY x SYSTEM "file://{out}/secret.obj">]>',
    '<!DOCTYPE robot [<!ENTITY % p SYSTEM "{out}/secret.obj">%p;]>',
    f'<!DOCTYPE robot [<!ENTITY x0 "aaaaaaaaaa">{LAUGHS}<!ENTITY x "&x9;">]>',
)
SNIPPETS = (
    '<a b="${9**9**9}"/>', '<a b="${[0] * 10**9}"/>', '<a b="${().__class__}"/>', '<a b="$(env HOME)"/>',
    "<a b=\"${open('{out}/secret.obj').read()}\"/>", "<a b=\"${xacro.load_yaml('{out}/secret.obj')}\"/>",
    '<a b="$(eval 9**9**9)"/>', '<a b="$(find out)"/>', '<xacro:include filename="{out}/secret.obj"/>',
    '<xacro:include filename="pipe.obj"/>', '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    '<xacro:property name="p" value="${p}"/><a b="${p}"/>', '<xacro:if value="${x}"><a/></xacro:if>',
)  # fmt: skip
ENDLESS = "(WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r) SELECT x FROM r)"
STATEMENTS = (
    "UPDATE topics SET name = NULL",
    "UPDATE topics SET type = 'sensor_msgs/msg/Image'",
    "DELETE FROM topics WHERE id = 2",
    "UPDATE messages SET timestamp = 'x'",
    "UPDATE messages SET data = zeroblob(9000000)",
    "UPDATE messages SET data = 'text'",
    "DROP TABLE schema",
    "UPDATE message_definitions SET encoded_message_definition = 'string[] data'",
    f"ALTER TABLE topics RENAME TO a; CREATE VIEW topics AS SELECT a.* FROM a, {ENDLESS}",  # noqa: S608
)
Rng, Read = random.Random, Callable[[], object]


def damaged(rng: Rng, data: bytes) -> bytes:
    """Bytes that are changed, dropped, put in, repeated or cut off."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, size = rng.randrange(len(found) or 1), rng.choice((1, 2, 4, 64, 4096))
        more = rng.choice((b"", rng.randbytes(size), b"\xff" * size, bytes(found[at : at + size]) * 3))
        end = rng.choice((at, at + len(more), len(found)))
        found[at:end] = more
    return bytes(found)


def other(rng: Rng, out: str) -> str:
    """Another number, name or path."""
    return rng.choice((rng.choice(NUMBERS), rng.choice(NUMBERS), rng.choice((*NAMES, *PATHS)))).replace(
        "{out}", out
    )


def changed_words(rng: Rng, data: bytes, out: str) -> bytes:
    """A text with other words."""
    words = data.decode(errors="replace").split(" ")
    for _ in range(rng.choice((1, 2, 4))):
        words[rng.randrange(len(words))] = other(rng, out)
    return " ".join(words).encode(errors="replace")


def changed_xml(rng: Rng, text: str | bytes, out: str) -> bytes:
    """XML with elements, attributes, entities or bytes changed."""
    root = etree.fromstring(text)
    for _ in range(rng.choice((0, 1, 1, 2, 4))):
        element = rng.choice(list(root.iter(etree.Element)))
        key, parent, step = rng.choice([*element.keys(), None]), element.getparent(), rng.randrange(8)
        if key is not None and step < 4:
            words = element.get(key).split() or [""]
            words[rng.randrange(len(words))] = other(rng, out)
            element.set(key, " ".join(words))
        elif key is not None and step == 4:
            del element.attrib[key]
        elif parent is None:
            element.tag = rng.choice(("robot", "sdf", "{a}robot"))
        elif step == 5:
            parent.extend(deepcopy(element) for _ in range(rng.choice((1, 2, 200))))
        elif step == 6:
            parent.remove(element)
        else:
            element.tag = rng.choice(("link", "mesh", "box", "origin", "mimic", "limit"))
    data: bytes = etree.tostring(root)
    if rng.random() < 0.1:
        data = rng.choice(DOCTYPES).replace("{out}", out).encode() + data.replace(b">", b">&x;", 3)
    return damaged(rng, data) if rng.random() < 0.1 else data


def urdf(rng: Rng, folder: Path, out: str) -> Read:
    return _robot(folder / "two.urdf", changed_xml(rng, URDF, out))


def xacro(rng: Rng, folder: Path, out: str) -> Read:
    more = rng.choice((rng.choice(SNIPPETS), "")).replace("{out}", out)
    path = folder / "two.xacro"
    path.write_bytes(changed_xml(rng, XACRO.replace("<joint", more + "<joint", 1), out))
    # What becomes of a description has its own mutants.
    return lambda: read_description(path, {}, {})


def srdf(rng: Rng, folder: Path, out: str) -> Read:
    (folder / "two.srdf").write_bytes(changed_xml(rng, SRDF, out))
    return _robot(folder / "two.urdf", URDF.encode())


def mesh(rng: Rng, folder: Path, out: str) -> Read:
    end = rng.choice(list(MESHES))
    change = rng.choice((changed_words, changed_xml)) if end == "dae" else changed_words
    (folder / f"mutant.{end}").write_bytes(
        damaged(rng, MESHES[end]) if rng.random() < 0.5 else change(rng, MESHES[end], out)
    )
    return _robot(folder / "two.urdf", URDF.replace("tip.obj", f"mutant.{end}").encode())


def _robot(path: Path, data: bytes) -> Read:
    path.write_bytes(data)
    return lambda: import_robot(path, tip="gripper", allowances=Allowances(0.05, 0.05))


def recording(rng: Rng, folder: Path, out: str) -> Read:
    del out
    bag, step = usual(), rng.randrange(4)
    plugin = rng.choice((StoragePlugin.MCAP, StoragePlugin.SQLITE3)) if step else StoragePlugin.SQLITE3
    if step > 1:
        _, messages = bag.topics[rng.choice(list(bag.topics))]
        at = rng.randrange(len(messages))
        messages[at] = changed_message(rng, messages[at])
    written = None
    # A value that its field does not take.
    with suppress(Exception):
        written = bag.write(folder / "bag", plugin)
    ending = ".mcap" if plugin == StoragePlugin.MCAP else ".db3"
    path = only_file(written or usual().write(folder / "whole", plugin), ending)
    if step == 0:
        with closing(sqlite3.connect(path)) as base, suppress(sqlite3.Error):
            base.executescript(rng.choice(STATEMENTS))
    elif step == 1:
        path.write_bytes(damaged(rng, path.read_bytes()))
    options = RecordingOptions(base=BASE, every_s=0.0)
    return lambda: import_recording(path, folder / "import", world=WORLD, options=options)


def changed_message(rng: Rng, value: Any) -> Any:
    """A message, or a value in one, with another value somewhere."""
    if is_dataclass(value):
        name = rng.choice([one.name for one in fields(value) if not one.name.startswith("__")])
        return replace(value, **{name: changed_message(rng, getattr(value, name))})  # type: ignore[type-var]
    if isinstance(value, np.ndarray):
        extremes = (0, 1, 255) if value.dtype.kind == "u" else (np.nan, np.inf, 1e308, -1e308, 0.0)
        found = value.copy()
        found[: rng.choice((1, len(found)))] = rng.choice(extremes)
        return rng.choice((found, found[1:], np.concatenate([found, found])))
    if isinstance(value, list):
        return rng.choice(([changed_message(rng, one) for one in value], value * 300, value[1:]))
    if isinstance(value, str):
        return rng.choice((*NAMES, "32FC1", "mono8", BASE, "world"))
    return (
        rng.choice((0.0, 1e308, np.nan)) if isinstance(value, float) else rng.choice((0, 1, 255, 2**31 - 1))
    )


def view(rng: Rng, folder: Path, out: str) -> Read:
    del folder, out
    data = pack_view([encode_depth(DEPTH)], [CAMERA_VALUES], list(STATE))
    mutant = damaged(rng, data) if rng.random() < 0.5 else _changed_head(rng, data)
    return lambda: WORLD.examine_picture(mutant)


def _changed_head(rng: Rng, data: bytes) -> bytes:
    """A view file with another value somewhere in its line of JSON."""
    head, _, rest = data.partition(b"\n")
    values = json.loads(head.removeprefix(b"cspace-view 1 "))
    place, key = values, rng.choice(list(values))
    while isinstance(place[key], dict | list) and place[key] and rng.random() < 0.8:
        place = place[key]
        key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
    place[key] = rng.choice(
        (*map(float, ("0", "-1", "1e300", "65535")), 2**63, "x", None, True, [], {}, [[[]]])
    )
    return b"cspace-view 1 " + json.dumps(values).encode() + b"\n" + rest


class Forked:
    """A worker of ``bounded`` that is a fork of this process, whose libraries are there already."""

    def __init__(self, command: list[str], **_pipes: Any) -> None:
        del command
        (read, self._in), (self._out, results), (self._err, printed) = os.pipe(), os.pipe(), os.pipe()
        self._pid = os.fork()
        if not self._pid:
            try:
                for number, pipe in enumerate((read, results, printed)):
                    os.dup2(pipe, number)
                os.closerange(3, 64)
                sys.stdin = os.fdopen(0, closefd=False)
                bounded_worker._main()
            finally:
                os._exit(1)
        for pipe in (read, results, printed):
            os.close(pipe)
        self.stdin, self.stdout = os.fdopen(self._in, "wb"), os.fdopen(self._out, "rb")
        self.stderr = os.fdopen(self._err, "rb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_details: object) -> None:
        self.stdout.close()
        self.stderr.close()

    def wait(self) -> int:
        pid, self._pid = self._pid, 0
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

    def kill(self) -> None:
        if self._pid:
            os.kill(self._pid, signal.SIGKILL)


KINDS = {one.__name__: one for one in (urdf, xacro, srdf, mesh, recording, view)}


def try_mutants(kind: str, first: int, count: int) -> dict[str, Any]:
    """What came of mutants: outcomes, faults, and the longest time of one in s; runs in a bounded worker."""
    # Fewer points than for a robot that is used.
    spheres._GRID_POINTS, spheres._FRESH_POINTS = 2000, 2000
    if kind == "xacro":
        importlib.import_module("xacro")
        subprocess.Popen = Forked  # type: ignore[misc,assignment]
    outcomes: Counter[str] = Counter()
    faults, slowest = [], (0.0, first)
    with tempfile.TemporaryDirectory() as temporary:
        top = Path(temporary).resolve()
        out, reached = top / "out", top / "reached"
        out.mkdir()
        (out / "secret.obj").write_text(f"a: {SECRET}\n")

        def watch(event: str, details: tuple[Any, ...]) -> None:
            if event == "open" and os.path.realpath(str(details[0])).startswith(f"{out}/"):
                # A folder, which a fork that may write no file can leave as well.
                reached.mkdir(exist_ok=True)

        sys.addaudithook(watch)
        for number in range(first, first + count):
            folder = top / f"m{number}"
            folder.mkdir()
            (folder / "tip.obj").write_bytes(OBJ)
            (folder / "link.obj").symlink_to(out / "secret.obj")
            os.mkfifo(folder / "pipe.obj")
            read = KINDS[kind](random.Random(number), folder, str(out))  # noqa: S311
            # The diagnosis of pictures takes most of the time, and has its own mutants.
            recordings._DIAGNOSED = 1 if number % 10 == 0 else 0
            world.pose_findings = pose_findings if number % 10 == 0 else lambda *_: ()
            began = sum(os.times()[:4])
            outcome, said = _outcome(read)
            slowest = max(slowest, (round(sum(os.times()[:4]) - began, 2), number))
            outcomes[outcome] += 1
            if outcome == "fault" or SECRET in said or reached.exists():
                faults.append(f"{number}: {said[:300]}, reached: {reached.exists()}")
                shutil.rmtree(reached, ignore_errors=True)
    return {"outcomes": outcomes, "faults": faults, "slowest": slowest}


def _outcome(read: Read) -> tuple[str, str]:
    """What came of a file, and what was said of it."""
    try:
        read()
    except ServiceError:
        raise
    except CspaceError as error:
        return "refused", str(error)
    except (MemoryError, RecursionError):
        return "at a limit", ""
    except Exception as error:  # noqa: BLE001 - whatever comes is what is looked for
        return "fault", repr(error)
    return "read", ""


def run(kind: str, first: int, count: int) -> dict[str, Any]:
    """The same in bounded workers, as many mutants in each as fit its limits."""
    outcomes: Counter[str] = Counter()
    faults, slowest = [], [0.0, first]
    for start in range(first, first + count, BATCH):
        size = min(BATCH, first + count - start)
        what = f"{kind} {start} to {start + size}"
        found = bounded_worker.call(
            try_mutants, kind, start, size, limits=LIMITS, what=what, error=ServiceError
        )
        outcomes.update(found["outcomes"])
        faults += found["faults"]
        slowest = max(slowest, found["slowest"])
    return {"outcomes": dict(outcomes), "faults": faults, "slowest": slowest}


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])), indent=1))  # noqa: T201
