"""The bundle as an MLflow model: MLflow runs this file when it loads a version, so no object is ever pickled.

    mlflow.pyfunc.load_model("models:/cspace-sampler/1").predict(frame, params={"n": 300, "seed": 7})

``frame`` has the column ``image`` with PNG bytes, and for path models ``start`` and ``goal`` (rad). The
answer is float32 (rows, n, d) rad, not filtered; row i is sampled with ``seed + i``.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mlflow.models import set_model
from mlflow.pyfunc.model import PythonModel
from numpy.typing import NDArray

from cspace.bundle import Bundle

DEFAULT_COUNT = 300


class BundleModel(PythonModel):
    """Samples from the bundle in the artifact ``bundle``."""

    def load_context(self, context: Any) -> None:
        """Load and verify the bundle."""
        self._bundle = Bundle.load(Path(context.artifacts["bundle"]))

    # MLflow passes the context only where it is asked for, which its own annotation does not say.
    def predict(  # type: ignore[override]
        self, model_input: pd.DataFrame, params: dict[str, Any] | None = None
    ) -> NDArray[np.float32]:
        """Configurations for each row's picture."""
        chosen = params or {}
        count, seed = int(chosen.get("n", DEFAULT_COUNT)), int(chosen.get("seed", 0))
        rows = model_input.to_dict(orient="records")
        return np.stack([self._sample(row, count, seed + index) for index, row in enumerate(rows)])

    def _sample(self, row: dict[str, Any], count: int, seed: int) -> NDArray[np.float32]:
        bundle = self._bundle
        image = bundle.spec.world.read_picture(row["image"])
        ends = {name: row[name] for name in bundle.spec.endpoints}
        return bundle.sample(image, count, seed, min_confidence=0.0, **ends).samples


set_model(BundleModel())
