"""An evaluation for readers: Markdown, JSON with every row, and a table for terminals."""

import json
from collections.abc import Sequence
from dataclasses import asdict

from cspace.worlds import robot_digest, workshop_of
from services.evaluator.evaluation.budget import JUDGED, planned
from services.evaluator.evaluation.comparison import Comparison
from services.evaluator.evaluation.tables import (
    aligned,
    comparison_table,
    markdown,
    occupancy_table,
    planning_table,
    reconstruction_table,
    scene_family_table,
    topology_table,
)
from services.evaluator.evaluation.units import Evaluation, Setting, planner_of
from services.evaluator.measures.nearest import NEIGHBOURS

RECONSTRUCTION_NOTE = (
    "Precision is the exact collision-free share. k-NN precision and recall (Kynkaanniemi et al. 2019) are "
    "shares inside the other group's manifold, a union of balls on the torus that reach as far as neighbour "
    f"{NEIGHBOURS}; the row real is what two real samples of this size have of each other."
)
FAMILY_NOTE = (
    "Only the uniform scenarios decide. {} EDr is relative to uniform samples on the same scenarios."
)
COMPARISON_NOTE = (
    "Both on the same scenes and problems with the same seeds. The gain is above 0 where the version is "
    "better, with the limits of the paired difference by bootstrap; of edge checks it is the share saved. As "
    "served: filtered at the model's own threshold."
)
PLANNING_NOTE = (
    "RRT, range {0.range_rad} rad, resolution {0.resolution_rad} rad a joint, at most "
    "{0.max_iterations} iterations. Medians, the 90th percentile in brackets; a run without success "
    "is censored and ranks last, and a value with > is a lower bound. The saved factor is uniform's median "
    "over learned's, the filter factor learned's over that of the samples that pass the validity head (below "
    "1 the filter costs work), paired; time is without drawing the samples."
)
OCCUPANCY_NOTE = (
    "On uniform configurations, told free at a confidence of 0.5. The row confident above holds as many "
    "samples as the others: further ones are drawn until enough reach the bundle's threshold, and accepted "
    "is the share that does. The row is missing where in some scenario too few do."
)
TOPOLOGY_NOTE = (
    "The floor is the same score between two real samples. gsc_boundary takes both complements from the "
    "points, gsc_true the real one from its collision states. The scores are blind to position: read them "
    "with precision and coverage."
)


def to_json(evaluation: Evaluation) -> str:
    """Everything, down to the rows behind the summaries."""
    told = asdict(evaluation) | {"planner": asdict(planner_of(evaluation.setting.world))}
    for split in JUDGED:
        # Drawn again from the seed by whoever wants them.
        del told[split]["problems"]
    return json.dumps(told, indent=1)


def judged_on(setting: Setting) -> str:
    """In one line the scenes by which a version is judged: world, families, how many, seed."""
    world, budget = setting.world, setting.budget
    there = [workshop_of(world).count(split) or budget.scenarios for split in JUDGED]
    validation, test = (min(budget.scenarios, count) for count in there)
    uniform = f"{validation} validation and {test} test scenes of the family uniform, "
    problems = f"{budget.validation_problems} validation and {budget.test_problems} test problems"
    known = workshop_of(world).families
    return (
        f"judged on scenes of the {world.kind} world with {known.drawn} (robot {robot_digest(world)[:12]}, "
        f"{world.dim} joints): {'' if setting.paths else uniform}{problems} of each family "
        f"({', '.join(planned(known))}), seed {setting.seed}"
    )


def to_markdown(
    evaluation: Evaluation, title: str, reasons: Sequence[str], comparisons: Sequence[Comparison] = ()
) -> str:
    """The report: scenes, decision, comparisons, reconstruction, planning, topology."""
    budget, world = evaluation.setting.budget, evaluation.setting.world
    workshop = workshop_of(world)
    scenes = judged_on(evaluation.setting)
    parts = [f"# {title}", f"{scenes[0].upper()}{scenes[1:]}.", "## Decision"]
    parts.append("\n".join(f"- {reason}" for reason in reasons))
    for one in comparisons:
        heading = f"## Beside {one.rival}, validation (decides)"
        parts += [heading, markdown(comparison_table(one)), COMPARISON_NOTE]
    for name, split in (("validation", evaluation.validation), ("test", evaluation.test)):
        role = "decides" if name == "validation" else "reported only"
        if split.reconstruction is not None:
            parts += [
                f"## Reconstruction, {name} ({role})",
                markdown(reconstruction_table(split)),
                f"Gain in precision over uniform: {split.reconstruction.precision_gain:.3f}.",
                RECONSTRUCTION_NOTE,
            ]
        if split.families:
            heading = f"## Reconstruction by family, {name} (reported only)"
            parts += [
                heading,
                markdown(scene_family_table(split)),
                FAMILY_NOTE.format(workshop.families.note),
            ]
        if head := occupancy_table(split, workshop.measures.near_contact_m):
            parts += [f"## Validity head, {name}", markdown(head), OCCUPANCY_NOTE]
        if split.planning:
            parts += [
                f"## Planning, {name} ({role})",
                markdown(planning_table(split.planning)),
                PLANNING_NOTE.format(planner_of(world)),
            ]
    if evaluation.topology:
        parts += ["## Topology, test (reported only)", markdown(topology_table(evaluation)), TOPOLOGY_NOTE]
    scenes = f"{budget.scenarios} scenarios a split, {budget.samples} samples each"
    if evaluation.validation.reconstruction is None:
        scenes = f"{budget.validation_problems} validation and {budget.test_problems} test problems a family"
    parts.append(
        f"Seed {evaluation.setting.seed}, {scenes}; intervals of 95 % by bootstrap over scenarios, exact for "
        "success rates."
    )
    return "\n\n".join(parts) + "\n"


def terminal_table(evaluation: Evaluation, comparisons: Sequence[Comparison] = ()) -> str:
    """The deciding numbers as aligned text."""
    splits = (("validation", evaluation.validation), ("test", evaluation.test))
    near_contact_m = workshop_of(evaluation.setting.world).measures.near_contact_m
    tables = [(name, reconstruction_table(split)) for name, split in splits]
    tables += [(f"by family, {name}", scene_family_table(split)) for name, split in splits]
    tables += [(f"validity head, {name}", occupancy_table(split, near_contact_m)) for name, split in splits]
    if evaluation.validation.planning:
        tables.append(("planning, validation", planning_table(evaluation.validation.planning)))
    if evaluation.topology:
        tables.append(("topology, test", topology_table(evaluation)))
    tables += [(f"beside {one.rival}, validation", comparison_table(one)) for one in comparisons]
    return "\n\n".join(f"{name}\n{aligned(table)}" for name, table in tables if table)
