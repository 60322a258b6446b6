import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCKED = (
    "torch",
    "lightning",
    "ray",
    "sklearn",
    "numba",
    "scipy",
    "ompl",
    "gudhi",
    "matplotlib",
    "pandas",
    "onnx",
)

CODE = """
import sys
import warnings

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ImportError(f"{{name}} is not installed here")

warnings.simplefilter("error")
sys.meta_path.insert(0, Refuse())
import os, threading
before = dict(os.environ)
import inference_api.__main__, inference_api.routes.sample, inference_api.served_models
from inference_api.app import create_app
assert threading.active_count() == 1
assert dict(os.environ) == before
assert not os.listdir(".")
from pathlib import Path
from inference_api.settings import ApiSettings
import numpy as np
from tests.inference_api.client import running
from cspace.files import encode_png

settings = ApiSettings(model_cache=Path({cache!r}), pretrained_model=Path({bundle!r}))
with running(create_app(settings)) as api:
    image = encode_png(np.zeros((48, 48, 3), np.uint8))
    answer = api.post("/sample", files={{"image": image}}, data={{"n": "3"}})
    ends = {{"start": "0 0", "goal": "1 0"}}
    refused = api.post("/plan", files={{"image": image}}, data=ends)
assert answer.status_code == 200, answer.text
assert refused.status_code == 501, refused.text
loaded = sorted({{name.partition(".")[0] for name in sys.modules}} & {{*{blocked!r}, "mlflow"}})
assert not loaded, loaded
print("served", len(answer.json()["samples"]))
"""


def test_the_api_does_nothing_when_it_is_imported_and_serves_without_the_training_frameworks(
    tmp_path: Path, bundles: dict[str, Path]
) -> None:
    code = CODE.format(blocked=BLOCKED, cache=str(tmp_path / "cache"), bundle=str(bundles["scored"]))
    (tmp_path / "empty").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path / "empty",
        env={"PYTHONPATH": str(ROOT), "HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "served 3\n", done.stderr
