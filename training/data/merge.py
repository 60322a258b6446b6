"""Several data sets of one world as one, so that a data set can grow."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset import Dataset, require_room, write_dataset
from cspace.errors import DatasetError


def merge(parts: Sequence[Dataset], folder: Path) -> Dataset:
    """Write the scenarios of all parts, in their order; one that an earlier one shows already is left out.

    Scenarios are the same if their pictures are, and their geometry where it is known. The parts are of the
    same world, split and kinds of files.
    """
    first = parts[0]
    for part in parts[1:]:
        _require_alike(first, part)
    require_room(folder, sum(array.nbytes for part in parts for array in part.arrays.values()))
    kept = _new_rows([_digests(part) for part in parts])
    pairs = [(part, int(row)) for part, rows in zip(parts, kept, strict=True) for row in rows]
    extras = [part.extra_images for part in parts if part.extra_images is not None]
    return write_dataset(
        folder,
        world=first.world,
        images=_joined(parts, kept, "images"),
        free=[part.free_of(row) for part, row in pairs],
        collision=None if first.collision is None else [part.collision_of(row) for part, row in pairs],
        attributes={name: [part.attribute_of(name, row) for part, row in pairs] for name in first.attributes},
        scenes={name: _joined(parts, kept, name) for name in _geometry(first)} or None,
        extra_images=_distinct(np.concatenate(extras)) if extras else None,
        generator=_provenance(parts, kept),
    )


def _require_alike(first: Dataset, part: Dataset) -> None:
    if "paths" in first.arrays:
        raise DatasetError(f"{first.folder} holds paths", expected="data sets of configurations")

    def alike(what: str, ours: object, theirs: object) -> None:
        if ours != theirs:
            raise DatasetError(
                f"{part.folder} is of {what} than {first.folder}", expected=str(ours), got=str(theirs)
            )

    alike("another world", first.world.to_dict(), part.world.to_dict())
    # Scenarios of evaluations must not come among those that are learned from.
    split = first.manifest.generator.get("split"), part.manifest.generator.get("split")
    if None not in split:
        alike("another split", *split)
    names = [sorted(set(one.arrays) - {"extra_images"}) for one in (first, part)]
    alike("other files", *names)
    for name in ("images", *_geometry(first)):
        alike(f"other shapes of {name}.npy", first.arrays[name].shape[1:], part.arrays[name].shape[1:])


def _geometry(part: Dataset) -> list[str]:
    return [name for name in part.world.scene_files if name in part.arrays]


def _digests(part: Dataset) -> list[bytes]:
    """One of each scenario, by its picture and its geometry."""
    arrays_of_scenario = [part.images, *(part.arrays[name] for name in _geometry(part))]
    return [
        hashlib.sha256(b"".join(rows[row].tobytes() for rows in arrays_of_scenario)).digest()
        for row in range(part.scenario_count)
    ]


def _new_rows(digests: Sequence[Sequence[bytes]]) -> list[NDArray[np.int64]]:
    """Of each part, the rows that no earlier row of any part equals."""
    seen: set[bytes] = set()
    found = []
    for part in digests:
        rows = []
        for row, digest in enumerate(part):
            if digest not in seen:
                seen.add(digest)
                rows.append(row)
        found.append(np.array(rows, dtype=np.int64))
    return found


def _joined(parts: Sequence[Dataset], kept: Sequence[NDArray[np.int64]], name: str) -> NDArray[Any]:
    return np.concatenate([part.arrays[name][rows] for part, rows in zip(parts, kept, strict=True)])


def _distinct(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    (rows,) = _new_rows([[hashlib.sha256(image.tobytes()).digest() for image in images]])
    return images[rows]


def _provenance(parts: Sequence[Dataset], kept: Sequence[NDArray[np.int64]]) -> dict[str, Any]:
    """Where every part comes from; split and first seed in front where all parts were generated."""
    generators = [dict(part.manifest.generator) for part in parts]
    merged = [
        {
            "folder": part.folder.name,
            "digest": part.digest,
            "scenarios": len(rows),
            "left_out": part.scenario_count - len(rows),
            "generator": generator,
        }
        for part, rows, generator in zip(parts, kept, generators, strict=True)
    ]
    splits = [generator["split"] for generator in generators if "split" in generator]
    seeded = all(part.generator_seed is not None for part in parts)
    return {
        **({"split": splits[0]} if splits else {}),
        **({"seed": parts[0].generator_seed} if seeded else {}),
        "merged": merged,
    }
