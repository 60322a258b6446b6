import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest

from cspace.bundle import Bundle, GoldenCase, write_bundle
from cspace.errors import BundleIntegrityError, GoldenMismatchError
from tests.bundles import tiny_graphs, tiny_spec, write_tiny_bundle


def resign(folder: Path) -> None:
    names = sorted(path.name for path in folder.iterdir() if path.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (folder / "SHA256SUMS").write_text("".join(lines))


def flip_a_byte(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def test_the_digest_is_that_of_the_sums_and_tells_models_apart(tmp_path: Path, folder: Path) -> None:
    bundle = Bundle.load(folder)
    assert bundle.spec == tiny_spec()
    assert bundle.digest == hashlib.sha256((folder / "SHA256SUMS").read_bytes()).hexdigest()
    again, other = (
        Bundle.load(write_tiny_bundle(tmp_path / str(scale), validity=True, scale=scale)).digest
        for scale in (1.0, 2.0)
    )
    assert again == bundle.digest != other


@pytest.mark.parametrize("name", ["bundle.json", "generator.onnx", "golden.npz", "SHA256SUMS"])
def test_a_changed_or_missing_file_is_found(folder: Path, name: str) -> None:
    flip_a_byte(folder / name)
    with pytest.raises(BundleIntegrityError):
        Bundle.load(folder)
    (folder / name).unlink()
    with pytest.raises(BundleIntegrityError, match=name.replace(".", r"\.")):
        Bundle.load(folder)


@pytest.mark.parametrize("name", ["../outside.onnx", "/etc/passwd", "", "ü"])
def test_a_path_in_the_sums_is_refused(folder: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "outside.onnx").write_bytes(b"x")
    with (folder / "SHA256SUMS").open("a") as sums:
        sums.write(f"{hashlib.sha256(b'x').hexdigest()}  {name}\n")
    with pytest.raises(BundleIntegrityError, match="SHA256SUMS"):
        Bundle.load(folder)


def test_graphs_with_other_inputs_than_described_are_refused(tmp_path: Path) -> None:
    graphs = tiny_graphs(tiny_spec(kind="path"))
    with pytest.raises(BundleIntegrityError, match="start"):
        write_bundle(tmp_path / "bundle", tiny_spec(), graphs)
    assert list(tmp_path.iterdir()) == []


def test_a_graph_that_answers_otherwise_fails_its_golden_case(folder: Path) -> None:
    for name, data in tiny_graphs(tiny_spec(), validity=True, scale=1.001).items():
        (folder / f"{name}.onnx").write_bytes(data)
    resign(folder)
    with pytest.raises(GoldenMismatchError, match="mu"):
        Bundle.load(folder)


def golden_of(folder: Path) -> GoldenCase:
    return GoldenCase.from_npz((folder / "golden.npz").read_bytes())


@pytest.mark.parametrize(("shift", "refused"), [(5e-5, False), (2e-4, True), (2 * np.pi, False)])
def test_golden_samples_may_differ_by_1e_4_on_the_torus_and_no_more(
    folder: Path, shift: float, refused: bool
) -> None:
    case = golden_of(folder)
    moved = dataclasses.replace(case, samples=(case.samples + shift).astype(np.float32))
    (folder / "golden.npz").write_bytes(moved.to_npz())
    resign(folder)
    if refused:
        with pytest.raises(GoldenMismatchError, match="samples"):
            Bundle.load(folder)
    else:
        assert Bundle.load(folder).has_validity


def test_a_bundle_that_fails_its_own_golden_case_is_not_left_behind(folder: Path, tmp_path: Path) -> None:
    case = golden_of(folder)
    wrong = dataclasses.replace(case, samples=case.samples + np.float32(0.1), confidence=None)
    with pytest.raises(GoldenMismatchError):
        write_tiny_bundle(tmp_path / "new", golden=wrong)
    assert [path.name for path in tmp_path.iterdir()] == ["bundle"]
