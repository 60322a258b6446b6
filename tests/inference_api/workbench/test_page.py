"""The page at ``/``: what it is made of, under which policy, and which guards hold for it."""

import re
from pathlib import Path

from inference_api.keys import digest_of, make_key
from inference_api.settings import Protection
from inference_api.workbench.routes import FOLDER
from tests.inference_api.client import ApiClient
from tests.inference_api.workbench.conftest import StartBench

FILES = sorted(path.name for path in FOLDER.iterdir())
TYPES = {".js": "text/javascript", ".css": "text/css", ".html": "text/html", ".svg": "image/svg+xml"}


def text_of(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def test_the_page_comes_with_a_policy_that_lets_it_load_its_own_files_alone(bench: ApiClient) -> None:
    answer = bench.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    policy = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert {policy[name] for name in ("script-src", "style-src", "connect-src")} == {"'self'"}
    assert policy["frame-ancestors"] == "'none'"
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["referrer-policy"] == "no-referrer"


def test_every_file_of_the_page_is_served_as_what_it_is_and_asked_about_again(bench: ApiClient) -> None:
    for name in FILES:
        answer = bench.get(f"/workbench/files/{name}")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(TYPES[Path(name).suffix])
        assert answer.headers["cache-control"] == "no-cache"
        again = bench.get(f"/workbench/files/{name}", headers={"if-none-match": answer.headers["etag"]})
        assert again.status_code == 304
    for path in ("..%2fpage.py", "../page.py", ""):
        answer = bench.get(f"/workbench/files/{path}")
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"


def test_every_address_in_the_page_and_its_modules_is_a_file_that_ships_and_no_other_is_asked_for() -> None:
    page = text_of("index.html")
    assert re.findall(r"<script[^>]*>(.*?)</script>", page, re.DOTALL) == [""]
    assert re.findall(r"<style|\s(?:style|on\w+)=", page) == []
    named = set(re.findall(r'(?:src|href)="workbench/files/([^"]+)"', page))
    modules = {name for name in FILES if name.endswith(".js")}
    for module in modules:
        named |= set(re.findall(r'from "\./([^"]+)"', text_of(module)))
    assert modules == {name for name in named if name.endswith(".js")}
    assert named <= set(FILES)
    for name in FILES:
        # The name of a namespace, which nobody loads.
        addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+[^\s\"'`]*", text_of(name)))
        assert addresses <= {"http://www.w3.org/2000/svg"}, name


def test_with_keys_the_page_is_open_so_that_one_can_enter_a_key_and_the_rest_is_locked(
    start_bench: StartBench, tmp_path: Path
) -> None:
    key = make_key()
    keys = tmp_path / "keys"
    keys.write_text(f"bench:{digest_of(key)}\n")
    keys.chmod(0o600)
    api = start_bench(protection=Protection(keys_file=keys))
    opened = ("/", "/workbench/files/main.js")
    locked = ("/workbench/about", "/workbench/models", "/workbench/filesystem", "/models")
    assert [api.get(path).status_code for path in opened] == [200] * len(opened)
    assert [api.get(path).status_code for path in locked] == [401] * len(locked)
    assert api.post("/workbench/truth", json={"discs": []}).status_code == 401
    assert api.get("/workbench/about", headers={"authorization": f"Bearer {key}"}).status_code == 200


def test_the_page_answers_under_the_names_of_the_server_alone(bench: ApiClient) -> None:
    assert bench.get("/", headers={"host": "elsewhere.example"}).status_code == 421
    foreign = {"origin": "https://elsewhere.example"}
    assert bench.post("/workbench/truth", json={"discs": []}, headers=foreign).status_code == 403
