"""Table and figure of the comparison of clusters, from its results."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.lines import read
from services.evaluator.evaluation.tables import markdown
from services.evaluator.statistics import (
    Interval,
    difference_interval,
    mean_interval,
    ratio_of_sums_interval,
)


def grouped(out: Path):
    """Results by (joints, arm, look-ups): array (seeds, scenarios, 3), and uniform's by joints."""
    rows = read(out / "results.jsonl")
    uniform = {
        int(r["key"].split("|")[1]): np.array(r["rows"]) for r in rows if r["key"].startswith("uniform")
    }
    groups, seconds = {}, {}
    for row in rows:
        if row["key"].startswith("uniform"):
            continue
        arm, lookups, joints, seed, _ = row["key"].split("|")
        key = (int(joints), arm, lookups == "True")
        groups.setdefault(key, {})[int(seed)] = np.array(row["rows"])
        seconds.setdefault(key, []).append(row["seconds"])
    stacked = {key: np.stack([by[seed] for seed in sorted(by)]) for key, by in groups.items()}
    return stacked, uniform, {key: float(np.median(value)) for key, value in seconds.items()}


# With more joints than this, balls about samples cover nothing, and k-NN recall is told for coverage.
COVERED_JOINTS = 3
PRECISION, COVERAGE, ENERGY, RECALL = range(4)


def spread_of(joints: int) -> tuple[int, str]:
    """The measure that tells how much of the free space samples reach: its column and its name."""
    return (COVERAGE, "coverage") if joints <= COVERED_JOINTS else (RECALL, "k-NN recall")


def summary(values: np.ndarray, uniform: np.ndarray, joints: int) -> dict[str, object]:
    """Mean over seeds by scenario, intervals over scenarios, standard deviation over seeds."""
    rng = np.random.default_rng(0)
    mean, spread = values.mean(axis=0), spread_of(joints)[0]
    ratios = values[:, :, 2].sum(axis=1) / uniform[:, 2].sum()
    return {
        "precision": mean_interval(mean[:, 0], rng),
        "coverage": mean_interval(mean[:, spread], rng),
        "edr": ratio_of_sums_interval(mean[:, 2], uniform[:, 2], rng),
        "sd": (values[:, :, 0].mean(axis=1).std(), values[:, :, spread].mean(axis=1).std(), ratios.std()),
        "seeds": len(values),
    }


def gained(values: np.ndarray, single: np.ndarray) -> Interval:
    """Precision less that of the single network with the same look-ups, in pairs of scenarios."""
    seeds = min(len(values), len(single))
    means = (group[:seeds, :, 0].mean(axis=0) for group in (values, single))
    return difference_interval(*means, np.random.default_rng(0))


def write_report(out: Path) -> None:
    """``table.md`` and ``clusters.png`` in the folder of the results."""
    groups, uniform, seconds = grouped(out)
    spreads = ", ".join(dict.fromkeys(spread_of(joints)[1] for joints, _, _ in groups))
    names = ["joints", "form", "look-ups", "seeds", "precision", "over single", spreads, "EDr", "seed sd"]
    rows = [[*names, "s on one core"]]
    order = list(dict.fromkeys(arm for _, arm, _ in groups))
    found = {}
    for key in sorted(groups, key=lambda key: (key[0], key[2], order.index(key[1]))):
        joints, arm, lookups = key
        values, one = groups[key], summary(groups[key], uniform[joints], joints)
        found[key] = one
        single = groups.get((joints, "single", lookups))
        deviation = " / ".join(f"{value:.3f}" for value in one["sd"])
        rows.append(
            [
                str(joints),
                arm,
                "yes" if lookups else "no",
                str(one["seeds"]),
                f"{one['precision']:.3f}",
                "" if single is None or arm == "single" else f"{gained(values, single):+.3f}",
                f"{one['coverage']:.3f}",
                f"{one['edr']:.3f}",
                deviation,
                f"{seconds[key]:.0f}",
            ]
        )
    (out / "table.md").write_text(markdown(rows) + "\n", encoding="utf-8")
    _figure(found).savefig(out / "clusters.png", dpi=110)
    print(markdown(rows))


def _figure(found) -> Figure:
    arms = list(dict.fromkeys(arm for _, arm, _ in found))
    joints = sorted({key[0] for key in found})
    figure = Figure(figsize=(11, 0.33 * len(arms) * len(joints) + 1.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(joints), 3, squeeze=False, sharey=True)
    for line, dim in zip(axes, joints, strict=True):
        for panel, (name, title) in zip(
            line,
            (("precision", "precision"), ("coverage", spread_of(dim)[1]), ("edr", "EDr (0 is perfect)")),
            strict=True,
        ):
            for lookups, colour, shift in ((False, "tab:blue", 0.13), (True, "tab:orange", -0.13)):
                present = [
                    (i, found[dim, a, lookups][name])
                    for i, a in enumerate(arms)
                    if (dim, a, lookups) in found
                ]
                x = np.array([value.estimate for _, value in present])
                spread = np.array([[v.estimate - v.low, v.high - v.estimate] for _, v in present]).T
                y = np.array([len(arms) - i + shift for i, _ in present])
                label = "look-ups" if lookups else "latent alone"
                panel.errorbar(x, y, xerr=spread, fmt="o", ms=4, color=colour, label=label, capsize=2, lw=1)
            panel.set_yticks(range(len(arms), 0, -1), arms)
            panel.grid(visible=True, alpha=0.3)
            panel.set_title(f"{dim} joints: {title}", fontsize=10)
            if name == "edr":
                panel.set_xscale("log")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure
