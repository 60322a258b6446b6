"""What the page tells of models beside ``GET /models``: figures, decisions, lineage, links."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from urllib.parse import quote

from pydantic import BaseModel

from cspace.bundle import Provenance
from cspace.errors import RegistryError
from inference_api.models.store import ModelStore
from services.registry.entities import ModelVersion, is_model_name
from services.registry.promotion import Decision, decisions_of

# What is told of tags: where a version comes from. Anybody may write others.
_LINEAGE = ("preset", "seed", "data_digest", "git_commit")
_MAX_TEXT = 200
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


Rows = list[tuple[str, str]]


class ModelStory(BaseModel):
    """A model's figures and where it comes from, in words.

    Args:
        reference: as in ``GET /models``.
        rows: headline figures, where it comes from, and what was decided about it, the oldest first.
            Figures are those of the last decision, from validation scenarios; of shipped models those of
            the bundle.
        further: figures with a path in their name, which are parts of something larger.
        link: to the version's page in MLflow.
    """

    reference: str
    rows: Rows
    further: Rows
    link: str | None


class Stories(BaseModel):
    """What the page tells of models.

    Args:
        models: the versions of a model, and the shipped ones.
        champions: when the alias went to which version and why, the latest first. Of versions that were
            deleted nothing is known.
    """

    models: list[ModelStory]
    champions: Rows


def stories(store: ModelStore, name: str | None, pages: str | None) -> Stories:
    """Of the versions of a model, None for the default one, and of the shipped models.

    Args:
        store: where models are.
        name: of the registered model.
        pages: where browsers find MLflow.
    """
    wanted = name if name is not None and is_model_name(name) else store.model_name
    versions = store.versions(wanted)
    registered = [_version(version, pages) for version in versions]
    promoted = [one for version in versions for one in _decisions(version) if one.promoted]
    latest_first = sorted(promoted, key=lambda one: one.created_ms, reverse=True)
    return Stories(
        models=registered + [_shipped(one.name, one.spec.provenance) for one in store.shipped],
        champions=[(_when(one.created_ms), f"version {one.version}{_reasons(one)}") for one in latest_first],
    )


def _version(version: ModelVersion, pages: str | None) -> ModelStory:
    decisions = _decisions(version)
    figures = decisions[-1].metrics if decisions else {}
    tags = {name: version.tags.get(name) for name in _LINEAGE}
    link = f"{pages}/#/models/{quote(version.name, safe='')}/versions/{version.number}" if pages else None
    decision_rows = [
        (_when(one.created_ms), f"{'promoted' if one.promoted else 'not promoted'}{_reasons(one)}")
        for one in decisions
    ]
    return _story(str(version), version.created_ms, figures, tags, decision_rows, link)


def _story(
    reference: str,
    made: int | str | None,
    figures: Mapping[str, float],
    lineage: Mapping[str, str | None],
    decision_rows: Rows,
    link: str | None,
) -> ModelStory:
    shown = [(name, (name.replace("_", " "), f"{value:.4g}")) for name, value in figures.items()]
    comes_from = [(name.replace("_", " "), text[:_MAX_TEXT]) for name, text in lineage.items() if text]
    return ModelStory(
        reference=reference,
        rows=[row for name, row in shown if "/" not in name]
        + ([("made", _when(made))] if made else [])
        + comes_from
        + decision_rows,
        further=[row for name, row in shown if "/" in name],
        link=link,
    )


def _reasons(decision: Decision) -> str:
    against = f" against version {decision.against}" if decision.against else ""
    return f"{against}: {'; '.join(decision.reasons)}"


def _when(moment: int | str) -> str:
    """Of milliseconds since 1970, or ISO 8601; what is neither as it is."""
    try:
        date = (
            datetime.fromisoformat(moment)
            if isinstance(moment, str)
            else _EPOCH + timedelta(milliseconds=moment)
        )
    except (ValueError, OverflowError):
        return str(moment)
    return f"{date.astimezone(UTC):%Y-%m-%d %H:%M} UTC"


def _decisions(version: ModelVersion) -> Sequence[Decision]:
    try:
        return decisions_of(version)
    except RegistryError:
        # Somebody else wrote an entry; the page does without.
        return ()


def _shipped(name: str, provenance: Provenance) -> ModelStory:
    lineage = {
        "command": provenance.command,
        "data_digest": provenance.data_digest,
        "git_commit": provenance.git_commit,
    }
    return _story(name, provenance.created, provenance.metrics, lineage, [], None)
