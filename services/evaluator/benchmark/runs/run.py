"""One run of the benchmark: a flat record that becomes a JSON line, and a row of the table."""

import json
import math
from dataclasses import asdict, dataclass, fields
from typing import Any, Self

from cspace.errors import EvaluationError

DESCRIPTIONS = {
    "protocol": "families or paper",
    "family": "of the problem",
    "problem": "its number within family and split",
    "run": "number of the run on this problem",
    "seed": "of planner and sampler, the same for every arm of the run",
    "arm": "name of the way to solve",
    "group": "what the arm is there for",
    "planner": "as OMPL names it; SampledRRTConnect is the project's own",
    "sampler": "the learned sampler; empty for uniform samples",
    "learned_share": "of learned samples among those drawn, while there are any",
    "samples_asked": "of the sampler",
    "samples_got": "from the sampler",
    "epsilon_sigma": "what the encoder's standard deviation was raised by, in equal shares",
    "min_confidence": "what the validity head had to score",
    "range_rad": "of the planner, in OMPL's metric",
    "stop_at_first": "whether the search ended with its first solution",
    "iteration_limit": "states drawn after which the search ended",
    "time_limit_s": "wall time after which the search ended",
    "solved": "the path ends within 1e-6 rad of the goal and is free at ten times the resolution",
    "reason": "why the search ended, in words",
    "iterations": "states drawn until the search ended",
    "edge_checks": "motions checked until the search ended",
    "state_checks": "states looked at, within motions and alone",
    "learned_drawn": "states that came from the learned samples",
    "uniform_drawn": "states that were uniform",
    "solve_s": "wall time of the search, putting samples in order included",
    "state_check_s": "what a look at a state takes on this problem, measured in a loop of the kernel alone",
    "check_s": "state_checks times state_check_s",
    "plan_s": "the rest of solve_s: everything but the checks",
    "request_s": "from asking for samples to having them; 0 for uniform ones",
    "decode_s": "of the request, the sampler's reading of the picture",
    "encode_s": "of the request, the latent",
    "generate_s": "of the request, drawing and scoring",
    "server_s": "of the request, all that the sampler tells of",
    "transport_s": "of the request, the rest; 0 for a bundle in the planner's process",
    "total_s": "request_s and solve_s",
    "length_rad": "torus length of the path found last; empty without one",
    "first_iterations": "iterations to the first solution; empty without one",
    "first_edge_checks": "edge checks to the first solution",
    "first_s": "search time to the first solution",
    "first_length_rad": "torus length of the first solution",
    "cost_iterations": "of an optimising search, one entry an improvement: iterations",
    "cost_edge_checks": "likewise: edge checks",
    "cost_s": "likewise: search time",
    "cost_length_rad": "likewise: torus length of the best path so far",
    "novelty": "of the picture, as the sampler tells it",
    "bottleneck_rad": "largest clearance at which start and goal stay connected; infinite becomes empty",
}
"""What each column of ``runs.parquet`` holds."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run; see ``DESCRIPTIONS``."""

    protocol: str
    family: str
    problem: int
    run: int
    seed: int
    arm: str
    group: str
    planner: str
    sampler: str | None
    learned_share: float
    samples_asked: int
    samples_got: int
    epsilon_sigma: tuple[float, ...]
    min_confidence: float
    range_rad: float
    stop_at_first: bool
    iteration_limit: int
    time_limit_s: float
    solved: bool
    reason: str
    iterations: int
    edge_checks: int
    state_checks: int
    learned_drawn: int
    uniform_drawn: int
    solve_s: float
    state_check_s: float
    check_s: float
    plan_s: float
    request_s: float
    decode_s: float
    encode_s: float
    generate_s: float
    server_s: float
    transport_s: float
    total_s: float
    length_rad: float | None
    first_iterations: int | None
    first_edge_checks: int | None
    first_s: float | None
    first_length_rad: float | None
    cost_iterations: tuple[int, ...]
    cost_edge_checks: tuple[int, ...]
    cost_s: tuple[float, ...]
    cost_length_rad: tuple[float, ...]
    novelty: float | None
    bottleneck_rad: float | None

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Family, problem, run and arm."""
        return self.family, self.problem, self.run, self.arm

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self), allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Read one line.

        Raises:
            EvaluationError: it holds no run.
        """
        try:
            found: dict[str, Any] = json.loads(line)
            lists = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
            return cls(**{**found, **lists})
        except (ValueError, TypeError) as error:
            raise EvaluationError(
                "a line of the runs can not be read", expected="the columns of this release", got=line[:80]
            ) from error


COLUMNS = tuple(field.name for field in fields(Run))


def finite(value: float) -> float | None:
    """The value, None where there is none: JSON knows neither infinity nor nan."""
    return float(value) if math.isfinite(value) else None
