"""What the workbench tells of models beside ``GET /models``: figures, decisions, lineage, links."""

from collections.abc import Sequence
from urllib.parse import quote

from pydantic import BaseModel

from cspace.bundle import Provenance
from cspace.errors import RegistryError
from inference_api.models.store import ModelStore
from services.registry.models.port import ModelVersion
from services.registry.promotion import Decision, decisions_of
from services.registry.references import is_model_name

# What is told of tags: where a version comes from. Anybody may write others.
_LINEAGE = ("preset", "seed", "data_digest", "git_commit")
_MAX_TEXT = 200


class Decided(BaseModel):
    """An entry of a version's log of decisions."""

    promoted: bool
    reasons: list[str]
    against: int | None
    created_ms: int


class ModelStory(BaseModel):
    """A model's figures and where it comes from.

    Args:
        reference: as in ``GET /models``.
        created: ISO 8601, or milliseconds since 1970 as text; None where nobody knows.
        figures: of the last decision, from validation scenarios; of shipped models those of the bundle.
        decisions: the oldest first.
        lineage: by name.
        link: to the version's page in MLflow.
    """

    reference: str
    created: str | None
    figures: dict[str, float]
    decisions: list[Decided]
    lineage: dict[str, str]
    link: str | None


def stories(store: ModelStore, name: str | None, pages: str | None) -> list[ModelStory]:
    """Of the versions of a model, None for the default one, and of the shipped models.

    Args:
        store: where models are.
        name: of the registered model.
        pages: where browsers find MLflow.
    """
    wanted = name if name is not None and is_model_name(name) else store.model_name
    told = [_version(version, pages) for version in store.versions(wanted)]
    return told + [_shipped(one.name, one.spec.provenance) for one in store.shipped]


def _version(version: ModelVersion, pages: str | None) -> ModelStory:
    decisions = _decisions(version)
    lineage = {name: version.tags[name][:_MAX_TEXT] for name in _LINEAGE if name in version.tags}
    link = f"{pages}/#/models/{quote(version.name, safe='')}/versions/{version.number}" if pages else None
    return ModelStory(
        reference=str(version),
        created=str(version.created_ms),
        figures=dict(decisions[-1].metrics) if decisions else {},
        decisions=[
            Decided(
                promoted=one.promoted,
                reasons=list(one.reasons),
                against=one.against,
                created_ms=one.created_ms,
            )
            for one in decisions
        ],
        lineage=lineage,
        link=link,
    )


def _decisions(version: ModelVersion) -> Sequence[Decision]:
    try:
        return decisions_of(version)
    except RegistryError:
        # Somebody else wrote an entry; the page does without.
        return ()


def _shipped(name: str, provenance: Provenance) -> ModelStory:
    lineage = {
        "command": provenance.command,
        "data_digest": provenance.data_digest or "",
        "git_commit": provenance.git_commit or "",
    }
    return ModelStory(
        reference=name,
        created=provenance.created or None,
        figures=dict(provenance.metrics),
        decisions=[],
        lineage={key: text[:_MAX_TEXT] for key, text in lineage.items() if text},
        link=None,
    )
