"""The page at ``/``: what it is made of, under which policy, and which guards hold for it."""

import re
from pathlib import Path

import pytest

from inference_api.auth import digest_of
from inference_api.workbench.routes import FOLDER
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi

FILES = sorted(path.name for path in FOLDER.iterdir())
TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html", ".svg": "image/svg+xml"}


@pytest.fixture
def bench(start_api: StartApi) -> ApiClient:
    return start_api(api_workbench=True)


def test_the_policy_lets_the_page_load_its_own_files_alone(bench: ApiClient) -> None:
    answer = bench.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    policy = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert {policy[name] for name in ("script-src", "style-src", "connect-src")} == {"'self'"}
    assert policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in answer.headers["content-security-policy"]


def test_every_file_of_the_page_is_served_and_revalidated(bench: ApiClient) -> None:
    for name in FILES:
        answer = bench.get(f"/workbench/files/{name}")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(TYPES[Path(name).suffix])
        assert answer.headers["cache-control"] == "no-cache"
        again = bench.get(f"/workbench/files/{name}", headers={"if-none-match": answer.headers["etag"]})
        assert again.status_code == 304
    for path in ("..%2froutes.py", "../routes.py", ""):
        assert bench.get(f"/workbench/files/{path}").status_code == 404


def test_the_page_names_files_that_ship_and_no_other_address() -> None:
    texts = {name: (FOLDER / name).read_text(encoding="utf-8") for name in FILES}
    page = texts["index.html"]
    assert re.findall(r"<script[^>]*>(.*?)</script>", page, re.DOTALL) == [""]
    assert re.findall(r"<style|\s(?:style|on\w+)=", page) == []
    named = set(re.findall(r'(?:src|href)="workbench/files/([^"]+)"', page))
    for text in texts.values():
        named |= set(re.findall(r'from "\./([^"]+)"', text))
        # The name of a namespace, which nobody loads.
        addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"'`]*", text))
        assert addresses <= {"http://www.w3.org/2000/svg"}
    assert named | {"index.html"} == set(FILES)


def test_with_keys_only_the_page_is_open(start_api: StartApi, tmp_path: Path) -> None:
    key = "csk_of-this-test"
    keys = tmp_path / "keys"
    keys.write_text(f"bench:{digest_of(key)}\n")
    keys.chmod(0o600)
    api = start_api(api_workbench=True, api_keys_file=keys)
    assert [api.get(path).status_code for path in ("/", "/workbench/files/main.js")] == [200, 200]
    assert [api.get(path).status_code for path in ("/workbench/about", "/models")] == [401, 401]
    assert api.post("/workbench/truth", json={"discs": []}).status_code == 401
    assert api.get("/workbench/about", headers={"authorization": f"Bearer {key}"}).status_code == 200


def test_other_hosts_and_origins_are_refused(bench: ApiClient) -> None:
    assert bench.get("/", headers={"host": "elsewhere.example"}).status_code == 400
    foreign = {"origin": "https://elsewhere.example"}
    assert bench.post("/workbench/truth", json={"discs": []}, headers=foreign).status_code == 403


def test_scenes_are_served_on_request_only(start_api: StartApi) -> None:
    api = start_api()
    assert api.get("/").status_code == 200
    assert api.get("/workbench/about").json()["truth"] is False
    for route in ("truth", "picture"):
        assert api.post(f"/workbench/{route}", json={"discs": []}).status_code == 404
