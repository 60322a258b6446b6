"""One run of the benchmark: a flat record that becomes a JSON line, and a row of the table."""

import json
import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Self, get_type_hints

from cspace.errors import EvaluationError


class Record:
    """A flat dataclass, annotated with what each column holds."""

    __slots__ = ()

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from all others."""
        raise NotImplementedError

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self), allow_nan=False)  # type: ignore[call-overload]

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


def descriptions(kind: type[Record]) -> dict[str, str]:
    """What each column of a kind of records holds."""
    return {name: hint.__metadata__[0] for name, hint in get_type_hints(kind, include_extras=True).items()}


@dataclass(frozen=True, slots=True)
class Run(Record):
    """One run, each column with what it holds."""

    protocol: Annotated[str, "families or paper"]
    family: Annotated[str, "of the problem"]
    problem: Annotated[int, "its number within family and split"]
    run: Annotated[int, "number of the run on this problem"]
    seed: Annotated[int, "of planner and sampler, the same for every arm of the run"]
    arm: Annotated[str, "name of the way to solve"]
    group: Annotated[str, "what the arm is there for"]
    planner: Annotated[str, "as OMPL names it; SampledRRTConnect is the project's own"]
    sampler: Annotated[str | None, "the learned sampler; empty for uniform samples"]
    learned_share: Annotated[float, "of learned samples among those drawn, while there are any"]
    samples_asked: Annotated[int, "of the sampler"]
    samples_got: Annotated[int, "from the sampler"]
    epsilon_sigma: Annotated[
        tuple[float, ...], "what the encoder's standard deviation was raised by, in equal shares"
    ]
    min_confidence: Annotated[float, "what the validity head had to score"]
    range_rad: Annotated[float, "of the planner, in OMPL's metric"]
    stop_at_first: Annotated[bool, "whether the search ended with its first solution"]
    iteration_limit: Annotated[int, "states drawn after which the search ended"]
    time_limit_s: Annotated[float, "wall time after which the search ended"]
    solved: Annotated[
        bool, "the path ends within 1e-6 rad of the goal and is free at ten times the resolution"
    ]
    reason: Annotated[str, "why the search ended, in words"]
    iterations: Annotated[int, "states drawn until the search ended"]
    edge_checks: Annotated[int, "motions checked until the search ended"]
    state_checks: Annotated[int, "states looked at, within motions and alone"]
    learned_drawn: Annotated[int, "states that came from the learned samples"]
    uniform_drawn: Annotated[int, "states that were uniform"]
    solve_s: Annotated[float, "wall time of the search, putting samples in order included"]
    state_check_s: Annotated[
        float, "what a look at a state takes on this problem, measured in a loop of the kernel alone"
    ]
    check_s: Annotated[float, "state_checks times state_check_s"]
    plan_s: Annotated[float, "the rest of solve_s: everything but the checks"]
    request_s: Annotated[float, "from asking for samples to having them; 0 for uniform ones"]
    decode_s: Annotated[float, "of the request, the sampler's reading of the picture"]
    encode_s: Annotated[float, "of the request, the latent"]
    generate_s: Annotated[float, "of the request, drawing and scoring"]
    server_s: Annotated[float, "of the request, all that the sampler tells of"]
    transport_s: Annotated[float, "of the request, the rest; 0 for a bundle in the planner's process"]
    total_s: Annotated[float, "request_s and solve_s"]
    length_rad: Annotated[float | None, "torus length of the path found last; empty without one"]
    first_iterations: Annotated[int | None, "iterations to the first solution; empty without one"]
    first_edge_checks: Annotated[int | None, "edge checks to the first solution"]
    first_s: Annotated[float | None, "search time to the first solution"]
    first_length_rad: Annotated[float | None, "torus length of the first solution"]
    cost_iterations: Annotated[
        tuple[int, ...], "of an optimising search, one entry an improvement: iterations"
    ]
    cost_edge_checks: Annotated[tuple[int, ...], "likewise: edge checks"]
    cost_s: Annotated[tuple[float, ...], "likewise: search time"]
    cost_length_rad: Annotated[tuple[float, ...], "likewise: torus length of the best path so far"]
    novelty: Annotated[float | None, "of the picture, as the sampler tells it"]
    bottleneck_rad: Annotated[
        float | None, "largest clearance at which start and goal stay connected; infinite becomes empty"
    ]

    @property
    def key(self) -> tuple[str, int, int, str]:
        """Family, problem, run and arm."""
        return self.family, self.problem, self.run, self.arm


DESCRIPTIONS = descriptions(Run)
"""What each column of ``runs.parquet`` holds."""


def finite(value: float) -> float | None:
    """The value, None where there is none: JSON knows neither infinity nor nan."""
    return float(value) if math.isfinite(value) else None
