"""What the project asks of its compose file and images beyond the specification."""

import os
import re
import subprocess
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

OWN_IMAGE = "cspace-sampler/"
SETTING = re.compile(r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?(?::\+[^}]*)?\}")
DOCKERFILES = sorted((Path(__file__).parents[2] / "docker").glob("*.Dockerfile"))


MIB = {"m": 1, "g": 1024}


def memory_mib(service: Mapping[str, Any]) -> int:
    """The limit of a service by default, in MiB."""
    limit = SETTING.sub(lambda found: found["default"], service["mem_limit"])
    return int(limit[:-1]) * MIB[limit[-1]]


def test_ports_are_published_on_loopback_and_the_edges_alone_elsewhere_if_asked(
    services: Mapping[str, Any],
) -> None:
    published = {name: service["ports"] for name, service in services.items() if "ports" in service}
    assert set(published) == {"edge", "mlflow", "ray-head"}
    for name, (port,) in published.items():
        address = r"\$\{CSPACE_BIND_ADDRESS:-127\.0\.0\.1\}" if name == "edge" else r"127\.0\.0\.1"
        assert re.fullmatch(address + r":\$\{CSPACE_\w+_PORT:-\d+\}:\d+", port)


OWN = {"POSTGRES_PASSWORD": "own", "RAY_TOKEN": "own", "KEYS_FILE": "/keys"}


@pytest.mark.parametrize(
    ("address", "changed", "refused"),
    [
        *((address, {"RAY_TOKEN": ""}, None) for address in ("", "127.0.0.2", "[::1]")),
        *(
            (address, {"RAY_TOKEN": ""}, "CSPACE_RAY_TOKEN")
            for address in ("192.0.2.7", "[::]", "1127.0.0.1")
        ),
        ("192.0.2.7", {"POSTGRES_PASSWORD": ""}, "CSPACE_POSTGRES_PASSWORD"),
        ("192.0.2.7", {"KEYS_FILE": ""}, "CSPACE_API_KEYS_FILE"),
        ("192.0.2.7", {}, None),
    ],
)
def test_secrets_that_everybody_knows_are_refused_beyond_loopback(
    services: Mapping[str, Any], address: str, changed: Mapping[str, str], refused: str | None
) -> None:
    check = services["exposure-check"]
    given = {"BIND_ADDRESS": address, **OWN, **changed}
    # As Compose fills the settings in: an empty one gets the default.
    environment = {
        name: given[name] or SETTING.fullmatch(written)["default"]  # type: ignore[index]
        for name, written in check["environment"].items()
    }
    (script,) = check["command"]
    outcome = subprocess.run(
        [*check["entrypoint"], script.replace("$$", "$")],
        env={"PATH": os.environ["PATH"], **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    assert outcome.returncode == (0 if refused is None else 1)
    assert outcome.stderr == "" if refused is None else f"set {refused} to" in outcome.stderr


def test_nothing_starts_before_that_check(services: Mapping[str, Any]) -> None:
    for name in services:
        waited, before = {name}, set[str]()
        while waited != before:
            before = waited
            waited = waited | {other for one in waited for other in services[one].get("depends_on", {})}
        assert "exposure-check" in waited


def test_a_container_reaches_its_neighbours_alone(
    compose_file: Mapping[str, Any], services: Mapping[str, Any]
) -> None:
    networks = {name: set(service.get("networks", [])) for name, service in services.items()}
    assert networks.pop("exposure-check") == set()
    assert all(networks.values())

    def neighbours(name: str) -> set[str]:
        return {other for other, joined in networks.items() if other != name and joined & networks[name]}

    assert neighbours("inference-api") == {"edge", "mlflow-reader"}
    assert neighbours("postgres") == {"mlflow", "mlflow-migrate"}
    assert neighbours("outcomes") == {"mlflow", "mlflow-reader"}
    assert neighbours("ray-worker") == {"ray-head", "mlflow", "train", "evaluate"}
    published = set().union(*(networks[name] for name, service in services.items() if "ports" in service))
    for name, network in compose_file["networks"].items():
        assert (network or {}).get("internal", False) is (name in {"api", "tracking", "database"})
    assert published >= {"door", "cluster"}
    # The API's has no way out.
    assert networks["inference-api"] == {"api"}


def test_what_callers_report_is_open_to_the_api_and_its_upload_alone(services: Mapping[str, Any]) -> None:
    mounts = {name: " ".join(service.get("volumes", [])) for name, service in services.items()}
    assert {name for name, mounted in mounts.items() if "outcomes" in mounted} == {
        "inference-api",
        "outcomes",
    }
    # It writes tables and figures, for which the API's image has no packages.
    assert services["outcomes"]["image"] == services["ray-head"]["image"]


def test_every_long_running_service_has_a_health_check_and_a_restart_policy(
    long_running: Mapping[str, Any],
) -> None:
    for service in long_running.values():
        assert service["healthcheck"]["test"][0] == "CMD"
        assert service["restart"] == "unless-stopped"
    assert "/health/live" in " ".join(long_running["inference-api"]["healthcheck"]["test"])


def test_every_dependency_waits_for_health_or_for_the_end_of_a_one_shot_service(
    services: Mapping[str, Any], one_shot: set[str]
) -> None:
    for service in services.values():
        for name, condition in service.get("depends_on", {}).items():
            awaited = "service_completed_successfully" if name in one_shot else "service_healthy"
            assert condition == {"condition": awaited}


def test_no_service_gains_rights_writes_to_its_root_or_starts_processes_without_end(
    services: Mapping[str, Any],
) -> None:
    for service in services.values():
        assert 0 < service["pids_limit"] <= 4096
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert service["cap_drop"] == ["ALL"]
        assert service["read_only"] is True
        # Own images end without root; the database's would start with it.
        assert service["image"].startswith(OWN_IMAGE) or service["user"] != "root"


def test_all_that_runs_at_the_same_time_fits_into_8_gib(
    services: Mapping[str, Any], long_running: Mapping[str, Any], one_shot: set[str]
) -> None:
    # The one-shot services end before MLflow starts, which all that is larger waits for.
    jobs = [memory_mib(service) for service in services.values() if "profiles" in service]
    assert sum(map(memory_mib, long_running.values())) + max(jobs) <= 8 * 1024
    assert sum(memory_mib(services[name]) for name in one_shot) <= memory_mib(services["mlflow"])


def test_images_are_pinned_and_own_ones_carry_the_version(services: Mapping[str, Any], root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    for service in services.values():
        name, _, tag = service["image"].partition(":")
        assert tag == version if name.startswith(OWN_IMAGE) else tag not in {"", "latest"}


def test_ray_asks_for_a_token_wherever_it_runs(services: Mapping[str, Any]) -> None:
    own = [name for name, service in services.items() if service["image"].startswith(OWN_IMAGE + "ray")]
    # The upload reaches no cluster.
    assert services["outcomes"]["networks"] == ["tracking"]
    nodes = [services[name] for name in own if name != "outcomes"]
    assert len(nodes) == 4
    for node in nodes:
        assert node["environment"]["RAY_AUTH_MODE"] == "token"
        assert node["environment"]["RAY_AUTH_TOKEN"]


def test_the_example_settings_are_the_file_s_settings_with_its_defaults(root: Path) -> None:
    text = (root / "docker-compose.yml").read_text(encoding="utf-8")
    # In order of the default, for a file of keys that is not there is mounted as an empty one.
    found = sorted(
        ((match["name"], match["default"] or "") for match in SETTING.finditer(text)), reverse=True
    )
    used = dict(found)
    lines = (root / ".env.example").read_text(encoding="utf-8").splitlines()
    documented = dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))
    assert documented == used


DIGEST = r"@sha256:[0-9a-f]{64}"


@pytest.mark.parametrize("dockerfile", DOCKERFILES, ids=lambda path: path.name)
def test_dockerfiles_build_on_a_base_by_digest_and_end_without_root(dockerfile: Path) -> None:
    text = dockerfile.read_text(encoding="utf-8")
    assert "# syntax" not in text
    ((name, base),) = re.findall(r"^ARG (\w+_IMAGE)=(\S+)$", text, re.MULTILINE)
    expected = "debian:bookworm-slim" if dockerfile.stem == "nginx" else "python:3.11-slim-bookworm"
    assert re.fullmatch(expected + DIGEST, base)
    assert re.findall(r"^FROM (\S+)", text, re.MULTILINE) == [f"${{{name}}}"]
    assert re.findall(r"^USER (\S+)", text, re.MULTILINE)[-1] == "1000"


@pytest.mark.parametrize("dockerfile", DOCKERFILES, ids=lambda path: path.name)
def test_images_take_wheels_with_hashes_and_torch_alone_from_another_index(dockerfile: Path) -> None:
    text = dockerfile.read_text(encoding="utf-8").replace("\\\n", "")
    installs = [line for line in re.split(r"\n| && |;", text) if "pip install" in line]
    assert all("--only-binary :all: --no-deps" in line for line in installs)
    without = [line for line in installs if "--require-hashes -r /tmp/" not in line]
    assert len(without) == (dockerfile.stem == "ray")
    assert all("--index-url" in line and "torch==" in line for line in without)


@pytest.mark.parametrize("name", ["api", "mlflow", "ray", "torch"])
def test_what_the_images_install_has_the_pinned_versions(root: Path, name: str) -> None:
    pins = set((root / "constraints.txt").read_text(encoding="utf-8").splitlines())
    text = (root / "docker" / f"{name}.txt").read_text(encoding="utf-8")
    found = set(re.findall(r"^(\S+==\S+) \\$", text, re.MULTILINE))
    assert found
    assert found <= pins


def test_the_api_image_holds_no_training(root: Path) -> None:
    text = (root / "docker" / "api.Dockerfile").read_text(encoding="utf-8")
    assert re.findall(r"-r /tmp/(\S+)", text) == ["api.txt"]
    assert not re.search(r"^(torch|ray|mlflow)==", (root / "docker/api.txt").read_text("utf-8"), re.MULTILINE)
    assert "COPY training" not in text
