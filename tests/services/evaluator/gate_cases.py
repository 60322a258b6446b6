"""Measured rows of candidates, rivals and earlier champions, made from a seed, for the gate."""

from dataclasses import dataclass

import numpy as np

from cspace.worlds import examples, simulator_of

COUNT = 60
LEVELS = {"uniform": (0.7, 0.95, 1.0), "real": (1.0, 0.97, 0.0), "sampler": (0.9, 0.9, 0.2)}
SHIFTS = (-0.02, -0.004, 0.0, 0.0, 0.004, 0.02)


@dataclass(frozen=True)
class Case:
    """What the gate is given: measured rows, and the metrics of champions that are not measured."""

    number: int
    world: object
    path: bool
    ours: list
    rivals: dict
    recorded: list
    against: int | None


def cases():
    """All of them, planar and in space, of samplers and of path models."""
    return [_case(number) for number in range(COUNT)]


def _case(number):
    rng = np.random.default_rng([31, number])
    world = examples()["panda" if number % 5 == 4 else "two-link"]
    path = number % 6 == 5
    scenes, problems = int(rng.choice([3, 5, 12, 30])), int(rng.choice([5, 15]))
    base = rng.normal(0.0, 0.03, scenes)
    families = dict.fromkeys((simulator_of(world).families.decisive, "uniform"))

    def one():
        rows = []
        if not path:
            rows += _scenes(rng, base, head=rng.random() < 0.7)
        if path or rng.random() < 0.8:
            rows += _problems(rng, families, problems, path=path)
        return rows

    ours = one()
    if rng.random() < 0.1:
        rivals = {"the shipped model": ours}
    else:
        rivals = {f"version {n}, a rival": one() for n in range(int(rng.integers(0, 3)))}
    if path and any(not rows for rows in rivals.values()):
        rivals = {}
    recorded = [
        (
            n,
            {
                "precision": 0.9,
                "coverage": 0.9,
                "edr": 0.2,
                "planning_success": 0.9,
                "narrow_edge_checks_ratio": 1.5,
            },
        )
        for n in range(int(rng.integers(0, 3)))
    ]
    recorded = [(n, {k: v + rng.normal(0.0, 0.03) for k, v in metrics.items()}) for n, metrics in recorded]
    return Case(number, world, path, ours, rivals, recorded, 1 if rivals else None)


def _scenes(rng, base, *, head):
    """Rows (task, family, index, seed, sampler, metric, part, value) of uniform scenes."""
    rows, shift = [], rng.choice(SHIFTS, 3) * (1.0, 1.0, 2.0)
    served, thin = rng.choice(SHIFTS), rng.random() < 0.2
    weak = -0.22 if rng.random() < 0.1 else 0.0
    if rng.random() < 0.1:
        shift = shift + np.array([-0.2, -0.2, 0.3])
    for index, level in enumerate(base):
        values = {}
        for sampler, (precision, coverage, energy) in LEVELS.items():
            of = shift if sampler == "sampler" else np.zeros(3)
            noise = rng.normal(0.0, 0.004, 3) if sampler == "sampler" else np.zeros(3)
            values[sampler] = (
                min(1.0, precision + level + of[0] + noise[0]),
                min(1.0, coverage + of[1] + noise[1] + (weak if sampler == "sampler" else 0.0)),
                energy * (1.0 + level) - of[2] + noise[2],
            )
        if head:
            for name, value in (("accuracy", 0.98), ("acceptance", 0.8)):
                rows.append(("head", "uniform", index, 0, "", name, 0, value))
            rows += [
                ("head", "uniform", index, 0, "", "near", part, value) for part, value in enumerate((40, 50))
            ]
            bins = (
                [100.0] * 15
                + [100.0 * (k + 0.5) / 15 for k in range(15)]
                + [100.0 * k // 15 for k in range(15)]
            )
            rows += [("head", "uniform", index, 0, "", "calibration", part, v) for part, v in enumerate(bins)]
            if not (thin and index % 3 == 0):
                first = values["sampler"]
                values["confident"] = (min(1.0, first[0] + 0.05 + served), first[1] - 0.01, first[2] + 0.02)
        for sampler, found in values.items():
            named = dict(zip(("precision", "coverage", "energy"), found, strict=True))
            named |= {"knn_precision": 0.9, "knn_recall": 0.9}
            rows += [
                ("reconstruction", "uniform", index, 0, sampler, metric, 0, float(value))
                for metric, value in named.items()
            ]
    return rows


def _problems(rng, families, count, *, path):
    rows, skill = [], rng.choice([0.5, 0.8, 1.0, 1.3])
    success = rng.choice([0.8, 0.95, 1.0])
    filtered = rng.random() < 0.5
    for family in families:
        for index in range(count):
            # The uniform samples' runs are the same for every model.
            base = np.random.default_rng([7, index])
            checks = int(base.integers(50, 400))
            runs = {
                "uniform": (base.random() < 0.9, checks),
                "learned": (rng.random() < success, int(checks * skill * rng.uniform(0.7, 1.3))),
            }
            if filtered or path:
                runs["confident"] = (rng.random() < success, int(checks * skill))
            for sampler, (solved, cost) in runs.items():
                key = ("planning", family, index, 11 + index, sampler)
                rows.append((*key, "success", 0, float(solved)))
                for metric, value in (
                    ("iterations", cost),
                    ("edge_checks", cost),
                    ("solve_time_s", cost * 1e-5),
                ):
                    rows += [(*key, metric, 0, float(value)), (*key, metric, 1, float(solved))]
                if solved:
                    rows.append((*key, "length_rad", 0, 3.0))
                if sampler == "learned":
                    rows.append((*key, "sampling_time_s", 0, 0.01))
    return rows
