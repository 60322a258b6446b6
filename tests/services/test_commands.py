import pytest

from cspace.errors import BundleError, ConfigError, ModelNotFoundError, ScenarioError
from services.commands import report_error


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ConfigError("no"), 2),
        (ModelNotFoundError("no"), 2),
        (ScenarioError("no"), 1),
        (BundleError("no"), 1),
    ],
)
def test_the_exit_code_is_that_of_the_errors_kind(error, code, capsys):
    assert report_error(error, ConfigError, ModelNotFoundError) == code
    assert capsys.readouterr() == ("", "error: no\n")


def test_a_program_tells_its_name(capsys):
    assert report_error(ConfigError("no"), program="search") == 1
    assert capsys.readouterr().err == "search: no\n"
