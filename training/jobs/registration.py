"""Bundles that no job made, as versions of registered models."""

from cspace.bundle import Bundle
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, EXPERIMENT, TAG_STAGE, recorded_name
from services.registry.connection import connect
from services.registry.entities import ID
from training.jobs.job import world_tag

ALIASES = (ALIAS_CHALLENGER, ALIAS_CHAMPION)


def register_untrained(bundle: Bundle, uri: str, model: str, alias: str, stage: str) -> str:
    """Make a bundle the next version of a model, by a run that holds its settings; ``name/version``."""
    tracking, registry = connect(uri)
    provenance = bundle.spec.provenance
    tags = {TAG_STAGE: stage, **world_tag(bundle.spec.world, recorded_name(provenance.config))}
    # The same bundle is registered once, however often it is given.
    key = f"{stage}/{model}/{bundle.digest}"
    with tracking.start(EXPERIMENT, f"{model}, untrained, {ID}", tags=tags, key=key) as run:
        run.params(dict(provenance.config))
        version = registry.register(
            model,
            bundle.folder,
            run.run_id,
            bundle.digest,
            {
                "data_digest": provenance.data_digest or "",
                "source_digest": provenance.config["source_digest"],
            },
            alias=alias,
        )
    return str(version)
