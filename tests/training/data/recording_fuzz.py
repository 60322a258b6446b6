"""Recordings of ROS 2, changed by chance: imported, or refused by typed errors.

``python -m tests.training.data.recording_fuzz FIRST_SEED COUNT`` tries so many mutants and prints what came
of them, within the limits of :mod:`tests.training.robots.description_fuzz`.
"""

import sqlite3
import struct
import sys
import tempfile
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.serde import SerdeError

from cspace.dataset import open_dataset
from cspace.view_file import unpack_view
from tests.space_bundle import WORLD
from tests.training.data.test_recordings import (
    BASE,
    KINDS,
    STATIC,
    TYPES,
    Recorder,
    image,
    info,
    joints,
    only_file,
    transforms,
)
from tests.training.robots.description_fuzz import NAMES, Found, Place, Rng, damaged
from training.data.recordings import RecordingOptions, import_recording

OPTIONS = RecordingOptions(base=BASE, every_s=0.0, time_limit_s=60.0)
COUNTED = "WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r LIMIT {most}) "
ENDLESS = COUNTED.format(most=-1)
# ruff: noqa: S608 # the statements are the mutants' own
STATEMENTS = (
    "UPDATE topics SET name = '{text}'",
    "UPDATE topics SET type = 'sensor_msgs/msg/Image' WHERE id = {n}",
    "UPDATE topics SET id = {n} + 9 WHERE id = {n}",
    "UPDATE topics SET offered_qos_profiles = '{text}'",
    "DELETE FROM topics WHERE id = {n}",
    "UPDATE messages SET timestamp = {n} - timestamp",
    "UPDATE messages SET timestamp = 'x' WHERE id = {n}",
    "UPDATE messages SET topic_id = {n}",
    "UPDATE messages SET data = zeroblob({n}000000) WHERE id = {n}",
    "UPDATE messages SET data = 'text' WHERE id = {n}",
    "UPDATE messages SET data = {n}.5",
    "DELETE FROM messages WHERE id = {n}",
    "DROP TABLE messages",
    "UPDATE schema SET schema_version = {n}",
    "DROP TABLE schema",
    "UPDATE message_definitions SET encoding = '{text}'",
    COUNTED.format(most=20_000)
    + "INSERT INTO topics SELECT x + 99, 't' || x, 'a/msg/B', 'cdr', '', '' FROM r",
    "ALTER TABLE topics RENAME TO a; CREATE VIEW topics AS SELECT a.* FROM a",
    f"ALTER TABLE topics RENAME TO a; CREATE VIEW topics AS SELECT a.* FROM a, ({ENDLESS} SELECT x FROM r)",
    f"DROP TABLE schema; CREATE VIEW schema AS {ENDLESS} SELECT max(x) AS schema_version FROM r",
    (
        "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS "
        "(zeroblob(900000000))); INSERT INTO messages VALUES(1, {n}, 1)"
    ),
)
Message = tuple[str, str, Any]


def usual() -> list[Message]:
    """Two pictures with all that belongs to them: topics, kinds and messages."""
    found = [("/tf_static", "tf_static", transforms(0.0, *STATIC))]
    for at in (0.0, 0.1):
        found += [("/d/camera_info", "info", info(at)), ("/d/image", "image", image(at))]
        found += [("/joint_states", "joints", joints(at)), ("/joint_states", "joints", joints(at + 0.01))]
    return found


def changed(rng: Rng, message: Any) -> Any:
    """A message with one field of it, or of those in it, changed."""
    name = rng.choice([one for one in message.__dataclass_fields__ if not one.startswith("__")])
    return replace(message, **{name: other(rng, getattr(message, name))})


def other(rng: Rng, value: Any) -> Any:
    """Another value for a field."""
    if hasattr(value, "__dataclass_fields__"):
        return changed(rng, value)
    if isinstance(value, list):
        found = [other(rng, one) if rng.random() < 0.5 else one for one in value]
        return rng.choice((found, found, value * 2, value[1:] or value, value * 300))
    if isinstance(value, str):
        return rng.choice(("", "x" * 9999, "32FC1", "16UC1", "mono8", "bgr8", "é\0", BASE, "world", *NAMES))
    if isinstance(value, np.ndarray):
        found, small = value.copy(), (0, 1, 255)
        if found.size:
            extremes = small if found.dtype == np.uint8 else (np.nan, np.inf, 1e308, -1e308, 1e-308, 0.0, 7.0)
            found.flat[rng.randrange(found.size)] = rng.choice(extremes)
        return rng.choice((found, found, found[1:], np.concatenate([found, found])))
    if isinstance(value, float):
        return rng.choice((0.0, -1.0, 1e308, np.nan, np.inf, 1e-308, 0.7))
    return rng.choice((0, 1, 2, 15, 16, 48, 255, value % 256, 255 if value < 256 else 2**31 - 1))


def recording(rng: Rng, place: Place) -> Path:
    """A recording with its messages, its tables, or the bytes of either changed."""
    messages, way = usual(), rng.randrange(6)
    for _ in range(rng.choice((1, 1, 2)) if way < 4 else 0):
        at, step = rng.randrange(len(messages)), rng.randrange(10)
        topic, kind, message = messages[at]
        if step < 7:
            # Arrays of one length have no other.
            with suppress(SerdeError, struct.error, OverflowError):
                TYPES.serialize_cdr(made := changed(rng, message), KINDS[kind])
                messages[at] = (topic, kind, made)
        elif step == 7:
            # Not that of another kind.
            messages[at] = (f"{rng.choice(('', '/tf', '/é', '/d/image/'))}{kind}", kind, message)
        elif step == 8:
            del messages[at]
        else:
            rng.shuffle(messages)
    recorder, tables = Recorder(), way == 5 or rng.random() < 0.5
    for topic, kind, message in messages:
        recorder.add(topic, kind, message)
    plugin = StoragePlugin.SQLITE3 if tables else StoragePlugin.MCAP
    mode = CompressionMode.NONE if tables or rng.random() < 0.5 else CompressionMode.STORAGE
    path = only_file(recorder.write(place.folder / "bag", plugin, mode), ".db3" if tables else ".mcap")
    if way == 5:
        with closing(sqlite3.connect(path)) as base:
            base.executescript(rng.choice(STATEMENTS).format(n=rng.randrange(1, 10), text=rng.choice(NAMES)))
            base.commit()
    elif way == 4:
        path.write_bytes(damaged(rng, path.read_bytes()))
    elif way == 3:
        # In a message, for the readers of a file to go on.
        data, raw = path.read_bytes(), bytes(TYPES.serialize_cdr(messages[-1][2], KINDS[messages[-1][1]]))
        path.write_bytes(
            data.replace(raw[4:], damaged(rng, raw[4:])[: len(raw) - 4].ljust(len(raw) - 4, b"\1"))
        )
    return path


def outcome(source: Path, folder: Path) -> str:
    """Import a recording, and read what is written of it."""
    found = import_recording(source, folder, world=WORLD, options=OPTIONS)
    views = [unpack_view(one.read_bytes()) for one in sorted((folder / "views").iterdir())]
    dataset = open_dataset(folder / "data", verify=True)
    assert len(views) == len(dataset.images) == found.views > 0
    for number in range(found.views):
        assert WORLD.space.contains(dataset.free_of(number)).all()
    return f"{found.views} views"


def run(seed: int, count: int) -> Found:
    """Try so many mutants."""
    found = Found()
    with tempfile.TemporaryDirectory() as top:
        place = Place(Path(top).resolve())
        recorder = Recorder()
        for topic, kind, message in usual():
            recorder.add(topic, kind, message)
        # Compiles what has to be.
        assert outcome(recorder.write(place.fresh() / "bag"), place.folder / "out") == "2 views"
        for number in range(seed, seed + count):
            place.fresh()
            found.judge(number, partial(outcome, recording(Rng(number), place), place.folder / "out"), place)
    return found


if __name__ == "__main__":
    print(run(int(sys.argv[1]), int(sys.argv[2])))  # noqa: T201
