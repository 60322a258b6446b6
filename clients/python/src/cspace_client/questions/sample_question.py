"""``POST /sample`` as clients ask it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cspace_client.questions.npy_body import NPY, max_body_bytes, read_samples
from cspace_client.questions.question import Question
from cspace_client.questions.sample_head import SampleHead, read_head
from cspace_client.samples import MAX_SAMPLES, PLAIN, SampleBatch, Wanted


@dataclass(frozen=True, slots=True, eq=False)
class SampleQuestion(Question[SampleBatch]):
    """A request for samples.

    Args:
        query: what is asked; its robot and what has to be confirmed are the question's.
    """

    path: ClassVar[str] = "/sample"
    media_type: ClassVar[str] = NPY

    query: Wanted

    def own_fields(self) -> dict[str, Any]:
        """What the endpoint takes for granted is left to it."""
        query = self.query
        fields: dict[str, Any] = {"n": str(query.n), "seed": str(query.seed)}
        if query.min_confidence is not None:
            fields["min_confidence"] = repr(query.min_confidence)
        if query.epsilon_sigma != PLAIN:
            fields["epsilon_sigma"] = [repr(value) for value in query.epsilon_sigma]
        for name, angles in (("start", query.start), ("goal", query.goal)):
            if angles is not None:
                fields[name] = json.dumps(angles)
        return fields

    def read(self, headers: Mapping[str, str]) -> "SampleReading":
        """See :class:`cspace_client.questions.question.Question`."""
        return SampleReading(self.query, read_head(headers, self.query, self.model))


@dataclass(frozen=True, slots=True)
class SampleReading:
    """See :class:`cspace_client.questions.question.Reading`."""

    query: Wanted
    head: SampleHead

    @property
    def limit_bytes(self) -> int:
        """Of so many samples; a server refuses more than it may be asked for."""
        return max_body_bytes(min(self.query.n, MAX_SAMPLES))

    def conclude(self, body: bytes, round_trip_s: float) -> SampleBatch:
        """The batch."""
        head, model = self.head, self.head.model
        return SampleBatch(
            samples=read_samples(body, self.query.n - head.shortfall, model.space),
            model_name=model.model_name,
            model_version=model.model_version,
            digest=model.digest,
            seed=head.seed,
            shortfall=head.shortfall,
            round_trip_s=round_trip_s,
            novelty=model.novelty,
            timing=head.timing,
            robot=model.robot,
            alias_confirmed=model.alias_confirmed,
            acceptance=head.acceptance,
            space=model.space,
            warnings=model.warnings,
        )
