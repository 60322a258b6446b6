"""One run of the benchmark of plans: a flat record that becomes a JSON line, and a row of the table."""

from dataclasses import dataclass
from typing import Annotated

from services.evaluator.benchmark.runs.run import Record

# Of a problem whose start or goal collides, which nobody is asked to solve.
NO_PROBLEM = "start or goal collides"


@dataclass(frozen=True, slots=True)
class PlanRun(Record):
    """One run, each column with what it holds; empty where it does not fit the table of the arm."""

    table: Annotated[str, "without exact checks, or with exact checks"]
    source: Annotated[str, "where the problem comes from"]
    family: Annotated[str, "of the problem"]
    problem: Annotated[int, "its number within family and split"]
    pictures: Annotated[int, "by which the scene is seen; 0 for arms to which they do not matter"]
    run: Annotated[int, "number of the run on this problem"]
    arm: Annotated[str, "name of the way to plan"]
    sampler: Annotated[str | None, "the model that plans; empty for none"]
    status: Annotated[str, "solved; refused, without a way; timeout; or why a search with checks ended"]
    solved: Annotated[bool, "whether there is a way; with exact checks, one that is free"]
    confidence: Annotated[float | None, "that the whole way is free, as the model has it"]
    clearance_m: Annotated[
        float | None, "least of the way in truth, by spheres each 0.01 rad; 0 or less collides"
    ]
    meshes_free: Annotated[
        bool | None, "whether the way is free by meshes; empty where these are not installed"
    ]
    unseen: Annotated[float | None, "share of the arm that no picture shows, mean along the way"]
    length_rad: Annotated[float | None, "of the way, Euclidean"]
    search_s: Annotated[float, "looking for ways without exact checks"]
    score_s: Annotated[float, "of the model, asked about them"]
    request_s: Annotated[float, "all until the ways were there, the reading of the picture among it"]
    as_is: Annotated[bool | None, "whether one of the ways was free as it was"]
    state_checks: Annotated[int | None, "states looked at in truth"]
    edge_checks: Annotated[int | None, "motions checked in truth"]
    iterations: Annotated[int | None, "states drawn by RRT-Connect"]
    solve_s: Annotated[float | None, "wall time of the search with exact checks"]
    state_check_s: Annotated[float | None, "what a look at a state takes by spheres, on this problem"]
    mesh_check_s: Annotated[float | None, "the same by convex meshes; empty where these are not installed"]

    @property
    def key(self) -> tuple[str, int, int, int, str]:
        """Family, problem, pictures, run and arm."""
        return self.family, self.problem, self.pictures, self.run, self.arm
