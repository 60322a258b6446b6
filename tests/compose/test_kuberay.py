"""The manifests for Kubernetes: fields that exist, images and settings as in Compose."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from training.config import TrainConfig

# An older one and one of today.
KUBERNETES = ("1.29", "1.36")
FOLDER = Path(__file__).parents[2] / "docker" / "kuberay"
MANIFESTS = [
    (path.name, manifest)
    for path in sorted(FOLDER.glob("*.yaml"))
    for manifest in yaml.safe_load_all(path.read_text(encoding="utf-8"))
]
NAMES = [f"{file}:{manifest['kind']}" for file, manifest in MANIFESTS]


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    text = Path(__file__).with_name("kuberay-schema.yaml").read_text(encoding="utf-8")
    loaded = yaml.safe_load(text)
    jsonschema.Draft202012Validator.check_schema(loaded)
    return jsonschema.Draft202012Validator(loaded)


@pytest.fixture(scope="module")
def job() -> Mapping[str, Any]:
    (found,) = (manifest for _, manifest in MANIFESTS if manifest["kind"] == "RayJob")
    return dict(found)


def pods() -> Iterator[Mapping[str, Any]]:
    """The pod templates of all manifests."""
    for _, manifest in MANIFESTS:
        if manifest["kind"] == "Deployment":
            yield manifest["spec"]["template"]
        elif manifest["kind"] == "RayJob":
            cluster = manifest["spec"]["rayClusterSpec"]
            yield cluster["headGroupSpec"]["template"]
            yield from (group["template"] for group in cluster["workerGroupSpecs"])


def containers() -> list[Mapping[str, Any]]:
    return [container for pod in pods() for container in pod["spec"]["containers"]]


@pytest.mark.parametrize("version", KUBERNETES)
@pytest.mark.parametrize(
    "manifest",
    [manifest for _, manifest in MANIFESTS if manifest["kind"] != "RayJob"],
    ids=[name for name in NAMES if not name.endswith("RayJob")],
)
def test_kubernetes_knows_every_field(manifest: Mapping[str, Any], version: str) -> None:
    kubernetes_validate.validate(dict(manifest), version, strict=True)


@pytest.mark.parametrize("version", KUBERNETES)
def test_kubernetes_knows_every_field_of_the_pods(version: str) -> None:
    for template in pods():
        kubernetes_validate.validate({"apiVersion": "v1", "kind": "Pod", **template}, version, strict=True)


def test_the_operator_knows_every_field_of_the_job(
    schema: jsonschema.Draft202012Validator, job: Mapping[str, Any]
) -> None:
    error = jsonschema.exceptions.best_match(schema.iter_errors(job))
    assert error is None, f"{error.json_path}: {error.message}"


def test_the_cluster_runs_the_pinned_ray_with_a_token(job: Mapping[str, Any], root: Path) -> None:
    cluster = job["spec"]["rayClusterSpec"]
    assert f"ray=={cluster['rayVersion']}" in (root / "constraints.txt").read_text(encoding="utf-8").split()
    assert cluster["authOptions"]["mode"] == "token"


def test_the_job_trains_a_preset_that_there_is(job: Mapping[str, Any]) -> None:
    program, script, option, preset, naming, name = job["spec"]["entrypoint"].split()
    assert (program, option) == ("python", "--preset")
    # By its name a further attempt goes on with what the volume holds.
    assert (naming, name) == ("--job", job["metadata"]["name"])
    assert (FOLDER.parents[1] / script).is_file()
    assert preset in TrainConfig.presets()


def test_settings_are_those_that_the_compose_file_gives(services: Mapping[str, Any], root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    for container in containers():
        kind = "inference-api" if container["name"] == "inference-api" else "ray-head"
        assert container["image"].endswith(f"{kind.removesuffix('-head')}:{version}")
        given = {setting["name"]: setting.get("value") for setting in container["env"]}
        for name, value in services[kind]["environment"].items():
            # The operator hands Ray its token; the address of MLflow is printed where nobody looks.
            # The API has names, keys and neighbours of its own there, and keeps no outcomes.
            own = "RAY_AUTH", "MLFLOW_", "CSPACE_API_", "CSPACE_OUTCOMES", "CSPACE_TRUSTED_KEY"
            if not name.startswith(own):
                assert given[name] == value


def test_no_pod_runs_as_root_writes_to_its_root_or_holds_a_token_of_the_cluster() -> None:
    for pod in pods():
        assert pod["spec"]["securityContext"]["runAsNonRoot"] is True
        assert pod["spec"]["securityContext"]["runAsUser"] == 1000
        assert pod["spec"]["automountServiceAccountToken"] is False
    for container in containers():
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert container["resources"]["limits"]["memory"]


def policies() -> Iterator[Mapping[str, Any]]:
    return (manifest["spec"] for _, manifest in MANIFESTS if manifest["kind"] == "NetworkPolicy")


def test_every_pod_has_a_policy_of_the_network() -> None:
    selected = [policy["podSelector"]["matchLabels"] for policy in policies()]
    for pod in pods():
        labels = pod["metadata"]["labels"]
        assert [wanted.items() <= labels.items() for wanted in selected].count(True) == 1


def test_pods_reach_their_own_kind_names_and_the_tracking_server_alone() -> None:
    for policy in policies():
        assert set(policy["policyTypes"]) == {"Ingress", "Egress"}
        ports = {one["port"] for rule in policy["egress"] for one in rule.get("ports", [])}
        assert ports == {53, 5000}
        for rule in policy["egress"]:
            assert rule["to"]
            assert rule.get("ports") or rule["to"] == [{"podSelector": policy["podSelector"]}]


def test_rays_ports_are_open_to_its_nodes_and_the_jobs_api_to_submitter_and_operator(
    job: Mapping[str, Any],
) -> None:
    (ray,) = (
        policy for policy in policies() if policy["podSelector"]["matchLabels"] == {"app": "cspace-ray"}
    )
    among, jobs = ray["ingress"]
    assert among == {"from": [{"podSelector": ray["podSelector"]}]}
    assert [one["port"] for one in jobs["ports"]] == [8265]
    assert jobs["from"][0] == {"podSelector": {"matchLabels": {"job-name": job["metadata"]["name"]}}}
    assert all("podSelector" in one for one in jobs["from"])


def test_the_api_asks_for_keys() -> None:
    (api,) = (container for container in containers() if container["name"] == "inference-api")
    assert "--allow-unauthenticated" not in api["command"]
    assert "CSPACE_API_KEYS_FILE" in {setting["name"] for setting in api["env"]}
