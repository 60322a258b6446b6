"""The names under which runs and models are found."""

MODEL_NAME = "cspace-sampler"
PATH_MODEL_NAME = "path-sampler"
EXPERIMENT = "cspace-sampler"
ALIAS_CHALLENGER = "challenger"
ALIAS_CHAMPION = "champion"

TAG_DIGEST = "digest"
# On a run: what :meth:`services.registry.tracking.port.Tracking.start` finds it by.
TAG_KEY = "cspace.key"
