"""Saving a bundle in MLflow's model format: models from code with ONNX artifacts, no pickle."""

import shutil
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from cspace.bundle import BundleSpec
from cspace.bundle.files import SPEC_FILE, read_files
from cspace.errors import BundleIntegrityError

# Where the bundle lies inside the saved model.
BUNDLE_PATH = "artifacts/bundle"
MODEL_CODE = Path(__file__).parents[1] / "pyfunc_model.py"
DEFAULT_COUNT = 300
_REQUIREMENTS = ("numpy", "onnx", "onnxruntime", "pillow", "pydantic")


def read_spec(bundle_folder: Path, digest: str) -> BundleSpec:
    """Verify a bundle's sums and digest, and read what it says about itself.

    Raises:
        BundleIntegrityError: the folder is damaged or has another digest.
    """
    files = read_files(bundle_folder)
    if files.digest != digest:
        raise BundleIntegrityError(
            "the bundle is not the one that is to be registered",
            expected=f"digest {digest}",
            got=files.digest,
        )
    return BundleSpec.from_json(files.contents[SPEC_FILE])


def save_model(
    bundle_folder: Path, spec: BundleSpec, work_folder: Path, model_id: str, metadata: Mapping[str, str]
) -> Path:
    """Write the model's folder into ``work_folder`` and return it.

    Args:
        bundle_folder: a sound bundle.
        spec: its description.
        work_folder: empty, of the caller.
        model_id: of MLflow's logged model, which the folder names as its own.
        metadata: shown with the model.
    """
    import mlflow.pyfunc  # noqa: PLC0415 - needs pandas, which serving does not have
    from mlflow.models import Model  # noqa: PLC0415

    # The saved artifact takes the name of its folder.
    staged = work_folder / "bundle"
    shutil.copytree(bundle_folder, staged)
    target = work_folder / "model"
    mlflow.pyfunc.save_model(
        target,
        python_model=str(MODEL_CODE),
        artifacts={"bundle": str(staged)},
        mlflow_model=Model(model_uuid=model_id, model_id=model_id),
        signature=_signature(spec),
        input_example=_example(spec),
        pip_requirements=[f"{name}=={version(name)}" for name in _REQUIREMENTS],
        metadata=dict(metadata),
    )
    return target


def _example(spec: BundleSpec) -> Any:
    import pandas as pd  # noqa: PLC0415 - as above

    blank = spec.world.blank_picture()
    ends = {name: [[0.0] * spec.dim] for name in spec.endpoints}
    return pd.DataFrame({"image": [blank], **ends}), {"n": DEFAULT_COUNT, "seed": 0}


def _signature(spec: BundleSpec) -> Any:
    from mlflow.models.signature import ModelSignature  # noqa: PLC0415 - as above
    from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema, TensorSpec  # noqa: PLC0415
    from mlflow.types.schema import Array  # noqa: PLC0415

    columns: list[ColSpec | TensorSpec] = [ColSpec(DataType.binary, "image")]
    columns += [ColSpec(Array(DataType.double), name) for name in spec.endpoints]
    params = [ParamSpec("n", DataType.long, DEFAULT_COUNT), ParamSpec("seed", DataType.long, 0)]
    samples = TensorSpec(np.dtype(np.float32), (-1, -1, spec.dim))
    return ModelSignature(Schema(columns), Schema([samples]), ParamSchema(params))
