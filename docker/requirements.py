"""Print the requirements of extras of pyproject.toml: an image layer that depends on them alone.

The project's own client is not asked for by its name, but by what it needs.
"""

import pathlib
import sys
import tomllib

CLIENT = "cspace-client"


def project(folder: str) -> dict:
    """The table ``project`` of a folder's pyproject.toml."""
    return tomllib.loads(pathlib.Path(folder, "pyproject.toml").read_text(encoding="utf-8"))["project"]


main = project(".")
found = [*main["dependencies"]]
for extra in sys.argv[1:]:
    for package in main["optional-dependencies"][extra]:
        found += project("clients/python")["dependencies"] if package == CLIENT else [package]
sys.stdout.write("\n".join([*found, ""]))
